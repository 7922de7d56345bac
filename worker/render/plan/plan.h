/* plan: what the lessons of earlier passes make of a renderer's setup (common/film/learning.h, lessons.h):
 * where light subpaths start, how many samples have one, and where caustics are sought.
 */
#ifndef LIGHTMILL_RENDER_PLAN_H
#define LIGHTMILL_RENDER_PLAN_H

#include "common/film/learning.h"
#include "worker/render/integrator/caustics.h"
#include "worker/render/integrator/integrator.h"

typedef struct plan plan_t;

/* What a job that learns needs before its first sample: places for the lessons of lights, and how bright the
 * picture is where. The setup stays the caller's; `brightness` is for it to point to, and so is what is
 * returned: where caustics are, or NULL. */
caustics_t *plan_prepare(setup_t *setup, lights_t *lights, const integrator_ops_t *integrator,
                         float inverse_brightness[BRIGHTNESS_SIDE * BRIGHTNESS_SIDE]);
/* The setup of a pass whose plan this is. `setup` is the one that was prepared; it must outlive the plan. */
plan_t *plan_new(const setup_t *setup, const learning_plan_t *learned);
/* Frees the plan and sets *plan to NULL. */
void plan_destroy(plan_t **plan);
const setup_t *plan_setup(const plan_t *plan);

#endif
