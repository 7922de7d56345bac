/* polygon: faces of many corners as triangles. */
#ifndef LIGHTMILL_POLYGON_H
#define LIGHTMILL_POLYGON_H

#include <stddef.h>
#include <stdint.h>

#include "common/vec.h"

/* Cuts a polygon of `count` >= 3 corners, about flat, into count - 2 triangles, of which `triangles` gets the
 * corners' numbers, wound as the polygon is: the fan 0 1 2, 0 2 3 and so on where it is convex, otherwise by
 * cutting off ears (Meisters 1975, "Polygons Have Ears"). Beyond 1024 corners, and where it crosses itself or
 * takes long, the rest is a fan whatever it looks like: the work grows with the count, not with its square.
 */
void polygon_cut(const vec3_t *corners, size_t count, uint32_t *triangles);

#endif
