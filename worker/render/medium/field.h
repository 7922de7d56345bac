/* field: a number or a colour that varies over a box (blob_field_t): in cells, in bricks of cells, or a cloud
 * by its formula. Its numbers stay in the blob, which must outlive it.
 *
 * A place is what blob_field_t calls so: whole numbers are cells. */
#ifndef LIGHTMILL_FIELD_H
#define LIGHTMILL_FIELD_H

#include "common/scene/scene_blob.h"

typedef struct {
    const blob_field_t *record; /* NULL: there is none */
    const float *numbers;
    const uint32_t *bricks; /* NULL: not of FIELD_BRICKS */
    int cells[3];
    xform_t from_world;
} field_t;

/* One of the blob's fields; of the reference 0 there is none. */
field_t field_open(const scene_blob_t *blob, blob_ref_t ref);
/* The place of a point of the world; false outside of the box. */
bool field_place(const field_t *field, vec3_t point, float place[3]);

/* The number at a place of the box, of one channel. */
float field_number(const field_t *field, const float place[3]);
/* The colour, or the number as a grey. */
rgb_t field_colour(const field_t *field, const float place[3]);
/* The numbers at the corners of a cube between eight cells, of which this is the first. Not of a cloud. */
void field_corners(const field_t *field, const int first[3], float corners[8]);
/* What is interpolated between them, at a part of the cube. */
float field_between(const float corners[8], const float part[3]);

/* The largest number at places from one to another. */
float field_most(const field_t *field, const float low[3], const float high[3]);

#endif
