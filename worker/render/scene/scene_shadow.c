/* scene_shadow: does anything lie between two points? And which borders of media do?
 *
 * Borders stop no light, so Embree asks a filter about each of them on a shadow ray's way (scene_alpha.c,
 * scene_quadric.c). That notes it, and no ray of its own need look for it.
 */
#include "worker/render/scene/scene_internal.h"

/* Segments end just short of their target, which lies off its surface by more than that. */
static const float segment_end = 1.0f - 0x1p-20f;

/* What Embree hands on to the filters. */
typedef struct {
    struct RTCIntersectContext context; /* comes first */
    borders_t *borders;                 /* of the rays in the packet; NULL: nobody asks */
} shadow_t;

static shadow_t shadow_of(borders_t *borders)
{
    shadow_t shadow = {.borders = borders};
    rtcInitIntersectContext(&shadow.context);
    return shadow;
}

/* Makes room for a border where it belongs; -1 when it is not kept. */
static int make_room(borders_t *borders, float at)
{
    int i = int_min(borders->count++, BORDERS_KEPT);
    if (i == BORDERS_KEPT && !(at < borders->kept[--i].at)) return -1;
    for (; i > 0 && at < borders->kept[i - 1].at; i--) borders->kept[i] = borders->kept[i - 1];
    return i;
}

void shadow_crosses(const struct RTCIntersectContext *context, uint32_t id, const geometry_t *geometry,
                    const hit_t *hit)
{
    borders_t *borders = ((const shadow_t *)context)->borders;
    surface_t surface;
    if (borders == NULL || !alpha_stops(geometry, hit, false) ||
        !scene_fill_surface(geometry->scene, geometry->shape, hit, true, vec3(0, 0, 1), &surface))
        return;
    borders += id >> RAY_PLACE_SHIFT;
    int i = make_room(borders, hit->distance);
    if (i < 0) return;
    borders->kept[i].at = hit->distance;
    borders->kept[i].offset = surface.offset;
    borders->kept[i].behind = geometry->shape->media[v_dot(borders->direction, surface.ng) > 0];
}

/* ---- one ray ------------------------------------------------------------------------------------------- */

bool scene_crosses(const scene_t *scene, vec3_t from, vec3_t to, float time, bool look, borders_t *borders)
{
    vec3_t d = v_sub(to, from);
    shadow_t shadow = shadow_of(borders);
    if (borders != NULL) borders->direction = d, borders->count = 0;
    if (!scene_can_trace(scene, from) || !scene_can_trace(scene, d)) return true;
    struct RTCRay ray = {.org_x = from.x,
                         .org_y = from.y,
                         .org_z = from.z,
                         .tnear = 0,
                         .dir_x = d.x,
                         .dir_y = d.y,
                         .dir_z = d.z,
                         .time = time,
                         .tfar = segment_end,
                         .mask = 0xFFFFFFFFu,
                         .id = look ? RAY_LOOK : RAY_PLAIN};
    rtcOccluded1(scene->world, &shadow.context, &ray);
    return ray.tfar < 0;
}

/* ---- packets ------------------------------------------------------------------------------------------- */

/* One coordinate of a packet's rays; counts in *lost those beyond the reach. */
static inline void fill_axis(const float *from, const float *to, float reach, float *restrict origin,
                             float *restrict direction, int *restrict lost)
{
    for (int i = 0; i < SCENE_PACKET; i++) {
        float o = from[i], d = to[i] - o;
        origin[i] = o;
        direction[i] = d;
        lost[i] += (fabsf(o) < reach ? 0 : 1) + (fabsf(d) < reach ? 0 : 1);
    }
}

uint32_t scene_crosses_packet(const scene_t *scene, const segments_t *segments,
                              borders_t borders[SCENE_PACKET])
{
    if (segments->count == 1) /* Embree's packets cost more */
        return scene_crosses(scene, segments_from(segments, 0), segments_to(segments, 0), segments->time,
                             segments->look, borders);
    struct RTCRay8 rays;
    _Alignas(32) int valid[SCENE_PACKET], lost[SCENE_PACKET] = {0};
    fill_axis(segments->from[0], segments->to[0], scene->reach, rays.org_x, rays.dir_x, lost);
    fill_axis(segments->from[1], segments->to[1], scene->reach, rays.org_y, rays.dir_y, lost);
    fill_axis(segments->from[2], segments->to[2], scene->reach, rays.org_z, rays.dir_z, lost);
    for (uint32_t i = 0; i < SCENE_PACKET; i++) {
        valid[i] = (int)i < segments->count && lost[i] == 0 ? -1 : 0;
        rays.tnear[i] = 0, rays.tfar[i] = segment_end, rays.time[i] = segments->time;
        rays.mask[i] = 0xFFFFFFFFu, rays.flags[i] = 0;
        rays.id[i] = (segments->look ? RAY_LOOK : RAY_PLAIN) | i << RAY_PLACE_SHIFT;
    }
    for (int i = 0; i < segments->count; i++) {
        borders[i].direction = vec3(rays.dir_x[i], rays.dir_y[i], rays.dir_z[i]);
        borders[i].count = 0;
    }
    shadow_t shadow = shadow_of(borders);
    rtcOccluded8(valid, scene->world, &shadow.context, &rays);
    /* Where nobody can say what lies between, it is as good as occluded. */
    uint32_t occluded = 0;
    for (int i = 0; i < segments->count; i++) occluded |= (uint32_t)(lost[i] != 0 || rays.tfar[i] < 0) << i;
    return occluded;
}
