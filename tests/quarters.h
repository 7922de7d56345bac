/* quarters: the quarters of a small picture, as a test compares what several integrators make of one scene.
 */
#ifndef LIGHTMILL_QUARTERS_H
#define LIGHTMILL_QUARTERS_H

#include "common/scene/scene_blob.h"

enum { QUARTERS = 4 };

/* The means of their reds, left to right and top to bottom, and their standard errors. */
typedef struct {
    double mean[QUARTERS], error[QUARTERS];
} quarters_t;

/* Renders the scene, whose film has an even number of pixels both ways. Fails the running test when samples
 * are dropped. */
quarters_t quarters_of(const scene_blob_t *blob, integrator_t integrator, uint32_t spp);

/* Fails the running test unless they are the same within 4.5 standard errors, which are less than `most` of
 * the mean of b. */
void quarters_expect_same(const char *what, const quarters_t *a, const quarters_t *b, double most);

#endif
