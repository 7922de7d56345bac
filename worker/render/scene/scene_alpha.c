/* scene_alpha: surfaces that let rays through: with probability 1 - alpha, decided by a hash of the ray and
 * of what it hits, so that the answer is a function of these alone; pictures all rays but the camera's; and
 * borders of media those of shadows.
 */
#include "common/sampler.h"
#include "worker/render/scene/scene_internal.h"

#include <string.h>

/* A uniform number that is a function of the ray and of what it hits alone. */
static float hit_number(const hit_t *hit, uint32_t shape)
{
    uint32_t words[9];
    memcpy(words, &hit->origin, sizeof hit->origin);
    memcpy(words + 3, &hit->direction, sizeof hit->direction);
    words[6] = hit->primitive;
    words[7] = hit->instance_id;
    words[8] = shape;
    return sampler_float((uint32_t)sampler_mix_words(0, words, ARRAY_LENGTH(words)));
}

bool alpha_stops(const geometry_t *geometry, const hit_t *hit, bool shadow)
{
    const blob_shape_t *shape = geometry->shape;
    if (shadow && geometry->border) return false;
    if (alpha_is_opaque(&shape->alpha) && (!shadow || alpha_is_opaque(&shape->shadow_alpha))) return true;
    surface_t surface;
    surface_details_t details;
    if (!scene_fill_surface(geometry->scene, shape, hit, true, vec3(0, 0, 1), &surface)) return true;
    scene_details(geometry->scene, &surface, &details);
    texture_point_t at = {details.uv, details.uv2, surface.p, surface.ns, details.colour};
    float alpha = textures_value(geometry->scene->textures, &shape->alpha, &at).x;
    if (shape->flags & SHAPE_CUTOUT && alpha != 0) alpha = 1;
    if (shadow && !alpha_is_opaque(&shape->shadow_alpha)) {
        float more = textures_value(geometry->scene->textures, &shape->shadow_alpha, &at).x;
        alpha *= shape->flags & SHAPE_CUTOUT && more != 0 ? 1 : more;
    }
    uint32_t index = (uint32_t)(shape - geometry->scene->blob->shapes);
    return alpha >= 1 || (alpha > 0 && hit_number(hit, index) < alpha);
}

static void filter(const struct RTCFilterFunctionNArguments *arguments, bool shadow)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    const float *floats = (const float *)arguments->hit;
    const uint32_t *ids = (const uint32_t *)arguments->hit, *rays = (const uint32_t *)arguments->ray;
    for (unsigned i = 0; i < n; i++) {
        if (arguments->valid[i] != -1) continue;
        uint32_t id = rays[RAY_ID * n + i];
        if (geometry->picture && !(id & RAY_LOOK)) {
            arguments->valid[i] = 0;
            continue;
        }
        hit_t hit = lane_hit((const float *)arguments->ray, n, i);
        hit.place = (vec2_t){floats[HIT_U * n + i], floats[HIT_V * n + i]};
        hit.primitive = ids[HIT_PRIMITIVE * n + i];
        hit.instance_id = ids[HIT_INSTANCE * n + i];
        if (alpha_stops(geometry, &hit, shadow)) continue;
        arguments->valid[i] = 0;
        if (shadow && geometry->border) shadow_crosses(arguments->context, id, geometry, &hit);
    }
}

void alpha_filter_nearest(const struct RTCFilterFunctionNArguments *arguments)
{
    filter(arguments, false);
}

void alpha_filter_shadow(const struct RTCFilterFunctionNArguments *arguments)
{
    filter(arguments, true);
}
