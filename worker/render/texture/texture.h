/* texture: the value of a blob's textures at a point.
 *
 * Textures are functions of the point alone, the same for eye and light subpaths: images are looked up
 * bilinearly at their finest level, and the pixel filter over many samples does the rest (docs/renderer.md
 * says why). A new texture is one function and one entry in the table in texture.c.
 */
#ifndef LIGHTMILL_TEXTURE_H
#define LIGHTMILL_TEXTURE_H

#include "common/scene/scene_blob.h"

typedef struct textures textures_t;

/* What textures may depend on. */
typedef struct {
    vec2_t uv, uv2;
    vec3_t p, n; /* in the world; n: shading normal of unit length */
    blob_colour_t colour;
} texture_point_t;

/* Tables for the textures of a blob, which must outlive them. */
textures_t *textures_new(const scene_blob_t *blob);
/* Frees the tables and sets *textures to NULL. */
void textures_destroy(textures_t **textures);

/* The texture with this index at a point. */
rgb_t textures_eval(const textures_t *textures, uint32_t index, const texture_point_t *at);
/* One image at (s, t), t downwards: texel (i, j) has its centre at ((i + 0.5) / width, (j + 0.5) / height).
 */
rgb_t textures_image(const textures_t *textures, uint32_t image, wrap_t wrap_s, wrap_t wrap_t, vec2_t st);
void textures_size(const textures_t *textures, uint32_t image, uint32_t *width, uint32_t *height);
/* One texel, decoded; x and y inside the image. */
rgb_t textures_texel(const textures_t *textures, uint32_t image, uint32_t x, uint32_t y);

static inline rgb_t textures_value(const textures_t *textures, const blob_value_t *value,
                                   const texture_point_t *at)
{
    return value->texture == 0 ? value->factor
                               : v_mul(value->factor, textures_eval(textures, value->texture - 1, at));
}

#endif
