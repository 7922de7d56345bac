/* polygon: faces of many corners as triangles. */
#ifndef LIGHTMILL_POLYGON_H
#define LIGHTMILL_POLYGON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/vec.h"

/* Cuts a polygon of 3 <= `count` < 2^32 - 1 corners, about flat, into count - 2 triangles, of which
 * `triangles` gets the corners' numbers, wound as the polygon is: the fan 0 1 2, 0 2 3 and so on where it is
 * convex, otherwise by cutting off ears (Meisters 1975, "Polygons Have Ears"). The polygon may touch itself.
 *
 * An ear is compared with all hollow corners, so the work grows with the square of the count. *patience is
 * how many corners may be looked at, and falls by those that were. Once it is 0, and where there is no ear,
 * because the polygon crosses itself, the rest becomes a fan; false when that covers what it should not. */
bool polygon_cut(const vec3_t *corners, size_t count, uint32_t *triangles, uint64_t *patience);

#endif
