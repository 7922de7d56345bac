/* render_here: renders a job in this process and thread, without any farm: what the tests of the renderer
 * need. */
#ifndef LIGHTMILL_RENDER_HERE_H
#define LIGHTMILL_RENDER_HERE_H

#include "common/film/film.h"
#include "common/scene/blob_builder.h"
#include "worker/render/renderer.h"

/* Renders all samples of a job. Fails the running test when anything goes wrong; the caller frees the film.
 */
film_t *render_here(const scene_blob_t *blob, const job_settings_t *settings);

/* The same in two steps: what a worker does, and what it takes to send and to merge that. The first fills the
 * batch, the second frees it. */
void render_batch_here(const scene_blob_t *blob, const job_settings_t *settings, batch_t *batch);
film_t *film_of_batch(batch_t *batch);

/* Makes a renderer ready for a pass of a job, if it learns: `lessons` are those of a film or a batch that has
 * all of the passes that teach it. */
void plan_here(renderer_t *renderer, const job_settings_t *settings, uint32_t pass, const int64_t *lessons);

/* How a planned job went. */
typedef struct {
    uint32_t rounds;
    double samples; /* a pixel, in the mean */
    double error;   /* as next_round estimated it at the end */
    float *shown;   /* the numbers of samples of the pixels, schedule_show_samples; the caller frees them */
} planned_t;

/* Renders a planned job (job_is_planned), round by round, as the farm does: in units of about `unit_samples`
 * pixel samples, every `stride`-th of those that are to be had first. Neither may change a bit. */
film_t *render_planned(const scene_blob_t *blob, const job_settings_t *settings, uint64_t unit_samples,
                       size_t stride, planned_t *planned);

/* A small scene under construction: a world of meshes and spheres. */
typedef struct {
    blob_builder_t *builder;
    uint8_t *bytes;
    scene_blob_t blob;
} test_scene_t;

/* Begins a scene whose camera sits at `eye` and looks down +z with the given field of view (degrees). */
test_scene_t test_scene_begin(vec3_t eye, float fov, int resolution);
/* Adds a material and returns its index. */
uint32_t test_scene_material(test_scene_t *scene, blob_material_t material);
/* Adds an axis-aligned box seen from inside (normals inward); `radiance` black for one that does not emit. */
void test_scene_room(test_scene_t *scene, vec3_t low, vec3_t high, uint32_t material, rgb_t radiance);
/* Adds a rectangle with corner p and sides e1, e2; it emits along e1 x e2. */
void test_scene_rectangle(test_scene_t *scene, vec3_t p, vec3_t e1, vec3_t e2, uint32_t material,
                          rgb_t radiance);
void test_scene_sphere(test_scene_t *scene, vec3_t centre, float radius, uint32_t material, rgb_t radiance);
/* Makes the blob; `scene->blob` is valid until test_scene_end. */
void test_scene_finish(test_scene_t *scene);
void test_scene_end(test_scene_t *scene);

#endif
