/* texture_internal: what the files of the texture module share and nobody else needs. */
#ifndef LIGHTMILL_TEXTURE_INTERNAL_H
#define LIGHTMILL_TEXTURE_INTERNAL_H

#include "worker/render/texture/texture.h"
#include "worker/render/texture/texture_blocks.h"

#include <stdint.h>

/* Linear values of the 256 codes of an 8-bit image. */
typedef struct {
    float gamma; /* as in blob_image_t */
    float linear[256];
} decode_table_t;

typedef struct {
    const uint32_t *words;       /* the texels, in the blob */
    const decode_table_t *table; /* of 8-bit formats, else NULL */
    texture_blocks_t *blocks;    /* of the scene, or NULL: the kernel reads without help */
    uint32_t format;             /* texels_t */
    uint32_t width, height;
} image_view_t;

struct textures {
    const scene_blob_t *blob;
    image_view_t *images;     /* one for each of the blob's */
    decode_table_t *tables;   /* one for each gamma, ascending */
    texture_blocks_t *blocks; /* NULL when images are few */
};

/* Coordinates beyond this are cut off: all floats there are even whole numbers, and fit an int. */
#define COORDINATE_LIMIT 0x1p30f

/* A coordinate that is safe to convert to an integer; NaN gives -COORDINATE_LIMIT, which is as good as 0 for
 * what repeats. */
static inline float coordinate_limit(float x)
{
    return float_min(float_max(x, -COORDINATE_LIMIT), COORDINATE_LIMIT);
}

/* Makes the views and tables of all images. */
void images_init(textures_t *textures);

/* How an image is read. */
typedef struct {
    wrap_t wrap_s, wrap_t;
    bool nearest;
    channel_t channel;
} image_lookup_t;

/* A channel of an image at (s, t), t downwards; single channels are greys. */
rgb_t image_lookup(const image_view_t *image, const image_lookup_t *how, vec2_t st);
/* A channel of a colour; CHANNEL_A gives 1. */
rgb_t rgb_channel(rgb_t colour, channel_t channel);

#endif
