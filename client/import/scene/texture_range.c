/* texture_range: see texture_range.h. */
#include "client/import/scene/texture_range.h"

#include "client/import/scene/scene_images.h"

static rgb_t value_of(const scene_builder_t *scene, const blob_value_t *value, bool most);

static rgb_t at_most(rgb_t c, float bound)
{
    return vec3(fminf(c.x, bound), fminf(c.y, bound), fminf(c.z, bound));
}

/* Of the inputs from the first on: the largest, or the mean. */
static rgb_t any_of(const scene_builder_t *scene, const blob_texture_t *texture, int count, bool most)
{
    rgb_t sum = {0, 0, 0};
    for (int i = 0; i < count; ++i) {
        rgb_t v = value_of(scene, &texture->inputs[i], most);
        sum = most ? vec3(fmaxf(sum.x, v.x), fmaxf(sum.y, v.y), fmaxf(sum.z, v.z)) : v_add(sum, v);
    }
    return most ? sum : v_scale(sum, 1 / (float)count);
}

static rgb_t image_of(const scene_builder_t *scene, const blob_texture_t *texture, bool most)
{
    rgb_t v = most ? scene_image_most(scene, texture->image) : scene_image_average(scene, texture->image);
    switch (texture->channel) {
    case CHANNEL_RGB:
        break;
    case CHANNEL_R:
        v = vec3(v.x, v.x, v.x);
        break;
    case CHANNEL_G:
        v = vec3(v.y, v.y, v.y);
        break;
    case CHANNEL_B:
        v = vec3(v.z, v.z, v.z);
        break;
    default: { /* a mixture of the channels, and alpha */
        float grey = texture->channel == CHANNEL_A ? 1 : most ? v_max(v) : (v.x + v.y + v.z) / 3;
        v = vec3(grey, grey, grey);
    }
    }
    v = v_mul(v, value_of(scene, &texture->inputs[0], most));
    if (texture->flags & TEXTURE_INVERT) v = most ? vec3(1, 1, 1) : v_sub(vec3(1, 1, 1), at_most(v, 1));
    return texture->flags & TEXTURE_UNIT ? at_most(v, 1) : v;
}

static rgb_t texture_of(const scene_builder_t *scene, const blob_texture_t *texture, bool most)
{
    float amount = most ? 1 : 0.5f;
    switch (texture->kind) {
    case TEXTURE_IMAGE:
        return image_of(scene, texture, most);
    case TEXTURE_SCALE:
        return v_mul(value_of(scene, &texture->inputs[0], most), value_of(scene, &texture->inputs[1], most));
    case TEXTURE_MIX:
    case TEXTURE_DIRECTION_MIX:
    case TEXTURE_CHECKERBOARD:
    case TEXTURE_DOTS:
        return any_of(scene, texture, 2, most);
    case TEXTURE_BILERP:
        return any_of(scene, texture, 4, most);
    default:
        return vec3(amount, amount, amount);
    }
}

static rgb_t value_of(const scene_builder_t *scene, const blob_value_t *value, bool most)
{
    const blob_texture_t *textures = blob_builder_records(scene->blob, BLOB_SECTION_TEXTURES);
    if (value->texture == 0) return value->factor;
    return v_mul(value->factor, texture_of(scene, &textures[value->texture - 1], most));
}

rgb_t scene_value_most(const scene_builder_t *scene, const blob_value_t *value)
{
    return value_of(scene, value, true);
}

rgb_t scene_value_mean(const scene_builder_t *scene, const blob_value_t *value)
{
    return value_of(scene, value, false);
}
