/* scene_quadric: quadrics as user geometry of Embree, which asks for their boxes and crossings. */
#include "worker/render/scene/scene_internal.h"

static void bounds_of_quadric(const struct RTCBoundsFunctionArguments *arguments)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    float low[3], high[3];
    quadric_bounds(geometry->quadric, low, high);
    *arguments->bounds_o = (struct RTCBounds){.lower_x = low[0],
                                              .lower_y = low[1],
                                              .lower_z = low[2],
                                              .upper_x = high[0],
                                              .upper_y = high[1],
                                              .upper_z = high[2]};
}

/* Distance along the lane's ray to the first crossing that counts, or a negative number. */
static float lane_distance(const geometry_t *geometry, const struct RTCIntersectContext *context,
                           const float *rays, unsigned n, unsigned i, bool shadow)
{
    hit_t hit = lane_hit(rays, n, i);
    float near = rays[RAY_NEAR * n + i], far = hit.distance, distances[2];
    int count = quadric_crossings(geometry->quadric, hit.origin, hit.direction, distances);
    bool opaque = alpha_is_opaque(&geometry->shape->alpha) &&
                  (!shadow || (!geometry->border && alpha_is_opaque(&geometry->shape->shadow_alpha)));
    hit.instance_id = context->instID[0];
    for (int k = 0; k < count; k++) {
        if (!(distances[k] > near && distances[k] < far)) continue;
        hit.distance = distances[k];
        hit.primitive = (uint32_t)k; /* draws another number at the far side */
        if (opaque || alpha_stops(geometry, &hit, shadow)) return distances[k];
        if (shadow && geometry->border)
            shadow_crosses(context, ((const uint32_t *)rays)[RAY_ID * n + i], geometry, &hit);
    }
    return -1;
}

static void intersect_quadric(const struct RTCIntersectFunctionNArguments *arguments)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    float *rays = (float *)arguments->rayhit, *hit_floats = rays + RAY_ROWS * n;
    unsigned *hit_ids = (unsigned *)hit_floats;
    for (unsigned i = 0; i < n; i++) {
        if (arguments->valid[i] != -1) continue;
        float t = lane_distance(geometry, arguments->context, rays, n, i, false);
        if (t < 0) continue;
        rays[RAY_FAR * n + i] = t;
        hit_floats[HIT_U * n + i] = hit_floats[HIT_V * n + i] = 0;
        hit_ids[HIT_PRIMITIVE * n + i] = arguments->primID;
        hit_ids[HIT_GEOMETRY * n + i] = arguments->geomID;
        hit_ids[HIT_INSTANCE * n + i] = arguments->context->instID[0];
    }
}

static void occlude_quadric(const struct RTCOccludedFunctionNArguments *arguments)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    float *rays = (float *)arguments->ray;
    for (unsigned i = 0; i < n; i++)
        if (arguments->valid[i] == -1 && lane_distance(geometry, arguments->context, rays, n, i, true) >= 0)
            rays[RAY_FAR * n + i] = -INFINITY;
}

RTCGeometry scene_new_quadric(const scene_t *scene)
{
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry, 1);
    rtcSetGeometryBoundsFunction(geometry, bounds_of_quadric, NULL);
    rtcSetGeometryIntersectFunction(geometry, intersect_quadric);
    rtcSetGeometryOccludedFunction(geometry, occlude_quadric);
    return geometry;
}
