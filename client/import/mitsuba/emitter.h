/* emitter: Mitsuba's lights that are no shapes. */
#ifndef LIGHTMILL_MITSUBA_EMITTER_H
#define LIGHTMILL_MITSUBA_EMITTER_H

#include "client/import/mitsuba/property.h"

/* Adds an emitter of the scene. */
result_t emitter_add(mitsuba_t *m, element_t *emitter);

#endif
