/* renderer: from (scene, unit) to (eye tile, splats). It knows nothing of sockets, processes or other units.
 */
#ifndef LIGHTMILL_RENDERER_H
#define LIGHTMILL_RENDERER_H

#include "common/film/batch.h"
#include "common/scene/scene_blob.h"

#include <stdatomic.h>

/* A scene ready to trace: immutable once made, shared by all threads. */
typedef struct renderer renderer_t;

/* Builds the Embree scene and the tables. `blob` and its bytes must outlive the renderer; `settings` have
 * passed job_settings_check. The build itself runs on one thread, so that the tree, and with it every bit of
 * the image, is the same on machines with other core counts. */
result_t renderer_new(const scene_blob_t *blob, const job_settings_t *settings, renderer_t **renderer);
/* Makes the plan ready that units of its pass are rendered by, of a job that learns. Threads may render units
 * of other passes meanwhile; not more than one at a time may call this. What the plan points to is copied. */
void renderer_plan(renderer_t *renderer, const learning_plan_t *plan);
/* Bytes that a renderer of this scene takes beside the blob, roughly. */
uint64_t renderer_memory(const scene_blob_t *blob, const job_settings_t *settings);
/* Frees the renderer and sets *renderer to NULL. */
void renderer_destroy(renderer_t **renderer);

/* Renders one unit (valid for the job) into `result`, which it resets first. In a job that learns the unit
 * lies within one pass, whose plan, if it has one, was made ready. Reentrant: each thread brings its own
 * result. Sets the calling thread's FTZ/DAZ flags. When *cancel becomes true it gives up soon and returns
 * false; the result is then to be thrown away. */
bool renderer_unit(const renderer_t *renderer, const unit_t *unit, unit_result_t *result,
                   const atomic_bool *cancel);

#endif
