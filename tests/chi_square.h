/* chi_square: does a sampling routine draw from the density that it claims? A test of Pearson's kind over a
 * grid. */
#ifndef LIGHTMILL_CHI_SQUARE_H
#define LIGHTMILL_CHI_SQUARE_H

#include <stdbool.h>
#include <stddef.h>

/* Compares counts observed with counts expected, pooling cells that expect fewer than 5. Returns the
 * probability of a deviation at least this large if the two agree; 0 where something was drawn that has no
 * density. `cells` numbers each; `expected` need not sum to the draws: a remainder (draws that failed) is one
 * more cell. */
double chi_square_p(const double *observed, const double *expected, size_t cells, double draws);

/* The upper tail of the chi-square distribution: P(X >= x) with `freedom` degrees of freedom. */
double chi_square_tail(double x, double freedom);

#endif
