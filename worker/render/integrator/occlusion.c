/* occlusion: ambient occlusion: how much of the hemisphere over what the camera sees is open. A sample draws
 * one direction with density cos / pi about the geometric normal on the camera's side, and brings the scene's
 * occlusion radiance where nothing lies within the scene's occlusion distance (blob_scene_t); so a pixel is
 * that radiance times the cosine-weighted share of open directions. What escapes from the camera is black.
 * Lights do not matter, nor what materials do with light (pbrt-v3 and v4's integrator of this name).
 */
#include "worker/render/integrator/subpath.h"
#include "worker/render/sampling/warp.h"

static const roulette_t roulette = {.from = 1, .most = 1};

/* Beyond the scene, in any direction. */
static float beyond_everything(const scene_t *scene, vec3_t p)
{
    vec3_t centre;
    float radius;
    scene_bounds(scene, &centre, &radius);
    return v_length(v_sub(p, centre)) + 2 * float_max(radius, 1e-3f);
}

static vec3_t open_direction(const sample_t *sample, const vertex_t *z)
{
    vec3_t n = z->surface.ng, s, t;
    if (v_dot(n, z->wo) < 0) n = v_neg(n);
    v_frame(n, &s, &t);
    vec3_t d = warp_cosine_hemisphere(sample_2d(sample, z->dimension + DIMENSION_SCATTER));
    return v_mad(v_mad(v_scale(n, d.z), d.x, s), d.y, t);
}

static rgb_t occlusion_sample(sample_t *sample)
{
    const setup_t *setup = sample->setup;
    const blob_scene_t *record = scene_blob(setup->scene)->scene;
    const medium_t vacuum = {{0, 0, 0}, 0};
    vertex_t z;
    walk_t walk = walk_from_camera(sample, roulette);
    if (sample->eye_weight == 0) return vec3(0, 0, 0);
    walk_arrive(&walk, sample, &z);
    if (z.kind == VERTEX_SKY) return vec3(0, 0, 0);
    vertex_shade(&z, sample, false);
    vertex_first_hit(&z, sample, walk.origin);
    float distance = float_min(record->occlusion_distance, beyond_everything(setup->scene, vertex_point(&z)));
    vec3_t w = open_direction(sample, &z), from = vertex_exit(&z, w);
    return transmit(sample, from, v_mad(from, distance, w), vacuum, distance, false,
                    record->occlusion_radiance);
}

const integrator_ops_t integrator_ao = {.sample = occlusion_sample, .traces_light = false};
