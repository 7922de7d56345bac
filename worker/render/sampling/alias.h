/* alias: choosing one of n things in proportion to given weights in constant time (Walker 1974, Vose 1991).
 */
#ifndef LIGHTMILL_ALIAS_H
#define LIGHTMILL_ALIAS_H

#include <stdint.h>

typedef struct {
    float keep;     /* probability of staying in this bin */
    uint32_t other; /* the bin to go to else */
} alias_bin_t;

typedef struct {
    uint32_t count;
    alias_bin_t *bins;
    double total; /* of the weights */
} alias_t;

/* Builds the table from `count` weights >= 0. With no positive weight the table is empty (count 0). */
void alias_init(alias_t *alias, const double *weights, uint32_t count);
void alias_free(alias_t *alias);
/* Picks a bin with one uniform number, which is stretched to [0, 1) again for further use. */
uint32_t alias_sample(const alias_t *alias, float *u);

#endif
