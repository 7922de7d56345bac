/* scene_shadow: does anything lie between two points? */
#include "worker/render/scene/scene_internal.h"

/* Segments end just short of their target, which lies off its surface by more than that. */
static const float segment_end = 1.0f - 0x1p-20f;

bool scene_occluded(const scene_t *scene, vec3_t from, vec3_t to, float time, bool look)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    vec3_t d = v_sub(to, from);
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
    rtcOccluded1(scene->world, &context, &ray);
    return ray.tfar < 0;
}

/* Occlusion of a segment by itself: Embree's packets cost more. */
static uint32_t only_occluded(const scene_t *scene, const segments_t *s)
{
    vec3_t from = vec3(s->from[0][0], s->from[1][0], s->from[2][0]);
    return scene_occluded(scene, from, vec3(s->to[0][0], s->to[1][0], s->to[2][0]), s->time, s->look);
}

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

uint32_t scene_occluded_packet(const scene_t *scene, const segments_t *segments)
{
    if (segments->count == 1) return only_occluded(scene, segments);
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRay8 rays;
    _Alignas(32) int valid[SCENE_PACKET], lost[SCENE_PACKET] = {0};
    fill_axis(segments->from[0], segments->to[0], scene->reach, rays.org_x, rays.dir_x, lost);
    fill_axis(segments->from[1], segments->to[1], scene->reach, rays.org_y, rays.dir_y, lost);
    fill_axis(segments->from[2], segments->to[2], scene->reach, rays.org_z, rays.dir_z, lost);
    for (int i = 0; i < SCENE_PACKET; i++) {
        valid[i] = i < segments->count && lost[i] == 0 ? -1 : 0;
        rays.tnear[i] = 0, rays.tfar[i] = segment_end, rays.time[i] = segments->time;
        rays.mask[i] = 0xFFFFFFFFu, rays.id[i] = segments->look ? RAY_LOOK : RAY_PLAIN, rays.flags[i] = 0;
    }
    rtcOccluded8(valid, scene->world, &context, &rays);
    /* Where nobody can say what lies between, it is as good as occluded. */
    uint32_t occluded = 0;
    for (int i = 0; i < segments->count; i++) occluded |= (uint32_t)(lost[i] != 0 || rays.tfar[i] < 0) << i;
    return occluded;
}
