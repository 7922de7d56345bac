/* shape: Mitsuba's shapes, their groups and instances. */
#ifndef LIGHTMILL_MITSUBA_SHAPE_H
#define LIGHTMILL_MITSUBA_SHAPE_H

#include "client/import/mitsuba/property.h"

/* Adds a shape of the world, or an instance of a group, to the scene. */
result_t shape_add(mitsuba_t *m, element_t *shape);

#endif
