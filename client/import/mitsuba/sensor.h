/* sensor: Mitsuba's camera, film, sampler and integrator, which become the scene's record. */
#ifndef LIGHTMILL_MITSUBA_SENSOR_H
#define LIGHTMILL_MITSUBA_SENSOR_H

#include "client/import/mitsuba/property.h"

/* Reads a sensor with its film and its sampler into m->record. */
result_t sensor_read(mitsuba_t *m, element_t *sensor);
/* Reads an integrator. */
result_t sensor_integrator(mitsuba_t *m, element_t *integrator);

#endif
