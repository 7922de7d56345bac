/* sensor: Mitsuba's camera, film, sampler and integrator, which become the scene's record. */
#ifndef LIGHTMILL_MITSUBA_SENSOR_H
#define LIGHTMILL_MITSUBA_SENSOR_H

#include "client/import/mitsuba/property.h"
#include "client/import/scene/scene_box.h"

/* Reads when its shutter opens and closes into m->shutter. */
result_t sensor_shutter(mitsuba_t *m, const element_t *sensor);
/* Reads a sensor with its film and its sampler into m->record. */
result_t sensor_read(mitsuba_t *m, element_t *sensor);
/* Mitsuba's sensor of a scene that has none: from -z, 45 degrees wide; `box` is about its shapes. */
result_t sensor_default(mitsuba_t *m, const box_t *box);
/* Reads an integrator; NULL: Mitsuba's default, direct light. */
result_t sensor_integrator(mitsuba_t *m, element_t *integrator);

#endif
