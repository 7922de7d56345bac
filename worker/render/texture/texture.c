/* texture: see texture.h. One function for each kind of texture; what it means is said in blob_format.h. */
#include "worker/render/texture/noise.h"
#include "worker/render/texture/texture_internal.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>

/* Octaves of noise beyond these are too fine and too faint to matter, and take time. */
enum { OCTAVES_MAX = 64 };

textures_t *textures_new(const scene_blob_t *blob)
{
    textures_t *textures = mem_zalloc(1, sizeof *textures);
    textures->blob = blob;
    images_init(textures);
    return textures;
}

void textures_destroy(textures_t **textures)
{
    if (*textures == NULL) return;
    free((*textures)->images);
    free((*textures)->tables);
    texture_blocks_free((*textures)->blocks);
    free(*textures);
    *textures = NULL;
}

/* ---- where to look ------------------------------------------------------------------------------------- */

static vec3_t map_matrix(const float m[2][3], vec2_t uv)
{
    return vec3(m[0][0] * uv.x + m[0][1] * uv.y + m[0][2], m[1][0] * uv.x + m[1][1] * uv.y + m[1][2], 0);
}

static vec3_t map_spherical(vec3_t q)
{
    q = v_normalize(q);
    float phi = atan2f(q.y, q.x);
    return vec3(acosf(float_clamp(q.z, -1, 1)) * INV_PI_F, (phi < 0 ? phi + TWO_PI_F : phi) / TWO_PI_F, 0);
}

static vec3_t map_cylindrical(vec3_t q)
{
    return vec3((PI_F + atan2f(q.y, q.x)) / TWO_PI_F, q.z, 0);
}

static vec3_t map(const blob_texture_t *texture, const texture_point_t *at)
{
    vec3_t q;
    switch (texture->mapping) {
    case MAPPING_UV2:
        return map_matrix(texture->matrix, at->uv2);
    case MAPPING_PLANAR:
        q = xform_point(&texture->texture_from_world, at->p);
        return vec3(q.x, q.y, 0);
    case MAPPING_SPHERICAL:
        return map_spherical(xform_point(&texture->texture_from_world, at->p));
    case MAPPING_CYLINDRICAL:
        return map_cylindrical(v_normalize(xform_point(&texture->texture_from_world, at->p)));
    case MAPPING_CYLINDER:
        return map_cylindrical(xform_point(&texture->texture_from_world, at->p));
    case MAPPING_POINT:
        return xform_point(&texture->texture_from_world, at->p);
    default:
        return map_matrix(texture->matrix, at->uv);
    }
}

/* A point of texture space, of which the 2D textures look at x and y: small enough for integers. */
static vec3_t coordinates(const blob_texture_t *texture, const texture_point_t *at)
{
    vec3_t st = map(texture, at);
    return vec3(coordinate_limit(st.x), coordinate_limit(st.y), coordinate_limit(st.z));
}

/* ---- kinds --------------------------------------------------------------------------------------------- */

static rgb_t input(const textures_t *textures, const blob_texture_t *texture, int k,
                   const texture_point_t *at)
{
    return textures_value(textures, &texture->inputs[k], at);
}

static rgb_t grey(float value)
{
    return vec3(value, value, value);
}

static rgb_t blend(rgb_t a, rgb_t b, rgb_t amount)
{
    return v_add(v_mul(v_sub(grey(1), amount), a), v_mul(amount, b));
}

static rgb_t eval_image(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    image_lookup_t how = {t->wrap_s, t->wrap_t, (t->flags & TEXTURE_NEAREST) != 0, t->channel};
    vec3_t st = coordinates(t, at);
    rgb_t value = image_lookup(&textures->images[t->image - 1], &how, (vec2_t){st.x, st.y});
    value = v_mul(input(textures, t, 0, at), value);
    if ((t->flags & TEXTURE_INVERT) != 0)
        value = vec3(float_max(1 - value.x, 0), float_max(1 - value.y, 0), float_max(1 - value.z, 0));
    if ((t->flags & TEXTURE_UNIT) != 0)
        value = vec3(float_min(value.x, 1), float_min(value.y, 1), float_min(value.z, 1));
    return value;
}

static rgb_t eval_scale(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    return v_mul(input(textures, t, 0, at), input(textures, t, 1, at));
}

static rgb_t eval_mix(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    return blend(input(textures, t, 0, at), input(textures, t, 1, at), input(textures, t, 2, at));
}

static rgb_t eval_direction_mix(const textures_t *textures, const blob_texture_t *t,
                                const texture_point_t *at)
{
    float amount = fabsf(v_dot(at->n, vec3(t->parameters[0], t->parameters[1], t->parameters[2])));
    return blend(input(textures, t, 0, at), input(textures, t, 1, at), grey(amount));
}

static rgb_t eval_bilerp(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    vec3_t st = coordinates(t, at);
    rgb_t zero = blend(input(textures, t, 0, at), input(textures, t, 2, at), grey(st.x)); /* along t = 0 */
    rgb_t one = blend(input(textures, t, 1, at), input(textures, t, 3, at), grey(st.x));
    return blend(zero, one, grey(st.y));
}

static rgb_t eval_uv(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    (void)textures;
    vec3_t st = coordinates(t, at);
    return vec3(st.x - floorf(st.x), st.y - floorf(st.y), 0);
}

static rgb_t eval_checkerboard(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    vec3_t st = coordinates(t, at);
    int odd = ((int)floorf(st.x) ^ (int)floorf(st.y) ^ (int)floorf(st.z)) & 1;
    return input(textures, t, odd, at);
}

/* Cells of side 1 about whole coordinates; half of them have a dot, moved as far as fits. The offsets into
 * the noise are pbrt-v3's. */
static bool is_in_dot(float s, float t)
{
    const float radius = 0.35f, shift = 0.5f - 0.35f;
    float cell_s = floorf(s + 0.5f), cell_t = floorf(t + 0.5f);
    if (!(noise(vec3(cell_s + 0.5f, cell_t + 0.5f, 0.5f)) > 0)) return false;
    float ds = s - (cell_s + shift * noise(vec3(cell_s + 1.5f, cell_t + 2.8f, 0.5f)));
    float dt = t - (cell_t + shift * noise(vec3(cell_s + 4.5f, cell_t + 9.8f, 0.5f)));
    return ds * ds + dt * dt < radius * radius;
}

static rgb_t eval_dots(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    vec3_t st = coordinates(t, at);
    return input(textures, t, is_in_dot(st.x, st.y) ? 0 : 1, at);
}

static int octaves(const blob_texture_t *t)
{
    return (int)float_clamp(t->parameters[0], 0, OCTAVES_MAX);
}

static rgb_t eval_fbm(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    (void)textures;
    return grey(noise_fbm(coordinates(t, at), octaves(t), t->parameters[1]));
}

static rgb_t eval_wrinkled(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    (void)textures;
    return grey(noise_turbulence(coordinates(t, at), octaves(t), t->parameters[1]));
}

/* Waves whose height follows a coarser noise, the strength of the wind; pbrt-v3's numbers. */
static rgb_t eval_windy(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    (void)textures;
    vec3_t p = coordinates(t, at);
    float wind = noise_fbm(v_scale(p, 0.1f), 3, 0.5f), waves = noise_fbm(p, 6, 0.5f);
    return grey(fabsf(wind) * waves);
}

/* A point on the Bezier segments c[i] .. c[i + 3], each a sixth of 0 <= t <= 1; the colours and the factor
 * 1.5 are pbrt's. pbrt-v3 alone stays on the first two segments, whose extrapolation reaches reflectances
 * above 20: a slip that pbrt-v2 and pbrt-v4 do not have, nor do we. */
static rgb_t marble_colour(float t)
{
    static const vec3_t c[] = {{0.58f, 0.58f, 0.6f}, {0.58f, 0.58f, 0.6f}, {0.58f, 0.58f, 0.6f},
                               {0.5f, 0.5f, 0.5f},   {0.6f, 0.59f, 0.58f}, {0.58f, 0.58f, 0.6f},
                               {0.58f, 0.58f, 0.6f}, {0.2f, 0.2f, 0.33f},  {0.58f, 0.58f, 0.6f}};
    enum { SEGMENTS = ARRAY_LENGTH(c) - 3 };
    t *= SEGMENTS;
    int first = (int)float_min(float_max(floorf(t), 0), SEGMENTS - 1);
    t -= (float)first;
    float s = 1 - t;
    rgb_t sum = v_scale(c[first], s * s * s);
    sum = v_mad(sum, 3 * s * s * t, c[first + 1]);
    sum = v_mad(sum, 3 * s * t * t, c[first + 2]);
    return v_scale(v_mad(sum, t * t * t, c[first + 3]), 1.5f);
}

static rgb_t eval_marble(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    (void)textures;
    vec3_t p = v_scale(coordinates(t, at), t->parameters[2]);
    float layer = p.y + t->parameters[3] * noise_fbm(p, octaves(t), t->parameters[1]);
    return marble_colour(0.5f + 0.5f * sinf(layer));
}

static rgb_t eval_channel(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    return rgb_channel(input(textures, t, 0, at), t->channel);
}

static rgb_t eval_threshold(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    return grey(input(textures, t, 0, at).x >= t->parameters[0] ? 1 : 0);
}

static rgb_t eval_colour(const textures_t *textures, const blob_texture_t *t, const texture_point_t *at)
{
    (void)textures;
    const blob_colour_t *c = &at->colour;
    return t->channel == CHANNEL_A ? grey(c->a) : rgb_channel(vec3(c->r, c->g, c->b), t->channel);
}

typedef rgb_t (*texture_eval_t)(const textures_t *textures, const blob_texture_t *texture,
                                const texture_point_t *at);

static const texture_eval_t kinds[TEXTURE_KIND_END] = {
    [TEXTURE_IMAGE] = eval_image,
    [TEXTURE_SCALE] = eval_scale,
    [TEXTURE_MIX] = eval_mix,
    [TEXTURE_DIRECTION_MIX] = eval_direction_mix,
    [TEXTURE_BILERP] = eval_bilerp,
    [TEXTURE_UV] = eval_uv,
    [TEXTURE_CHECKERBOARD] = eval_checkerboard,
    [TEXTURE_DOTS] = eval_dots,
    [TEXTURE_FBM] = eval_fbm,
    [TEXTURE_WRINKLED] = eval_wrinkled,
    [TEXTURE_WINDY] = eval_windy,
    [TEXTURE_MARBLE] = eval_marble,
    [TEXTURE_CHANNEL] = eval_channel,
    [TEXTURE_THRESHOLD] = eval_threshold,
    [TEXTURE_COLOUR] = eval_colour,
};

rgb_t textures_eval(const textures_t *textures, uint32_t index, const texture_point_t *at)
{
    const blob_texture_t *texture = &textures->blob->textures[index];
    rgb_t value = kinds[texture->kind](textures, texture, at);
    /* Numbers that overflowed, from absurd parameters alone, must not reach the film. */
    return v_is_finite(value) ? value : vec3(0, 0, 0);
}
