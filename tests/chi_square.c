/* chi_square: see chi_square.h. */
#include "tests/chi_square.h"

#include <math.h>

/* Upper regularised incomplete gamma function Q(a, x), by series or continued fraction (Abramowitz and
 * Stegun 6.5.29 and 6.5.31). */
static double gamma_upper(double a, double x)
{
    if (x <= 0) return 1;
    double scale = exp(a * log(x) - x - lgamma(a));
    if (x < a + 1) {
        double term = 1 / a, sum = term;
        for (int n = 1; n < 10000 && fabs(term) > 1e-15 * fabs(sum); n++) sum += term *= x / (a + n);
        return 1 - scale * sum;
    }
    /* Lentz' method. */
    double b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
    for (int i = 1; i < 10000; i++) {
        double an = -i * (i - a);
        b += 2;
        d = 1 / (an * d + b);
        c = b + an / c;
        h *= c * d;
        if (fabs(c * d - 1) < 1e-15) break;
    }
    return scale * h;
}

double chi_square_tail(double x, double freedom)
{
    return gamma_upper(freedom / 2, x / 2);
}

double chi_square_p(const double *observed, const double *expected, size_t cells, double draws)
{
    double statistic = 0, pooled_observed = 0, pooled_expected = 0, seen = 0, predicted = 0;
    size_t used = 0;
    for (size_t i = 0; i < cells; i++) {
        seen += observed[i];
        predicted += expected[i];
        if (expected[i] < 5) {
            pooled_observed += observed[i];
            pooled_expected += expected[i];
            continue;
        }
        double difference = observed[i] - expected[i];
        statistic += difference * difference / expected[i];
        used++;
    }
    /* What was not drawn into any cell, and what the density says of it. */
    pooled_observed += draws - seen;
    pooled_expected += fmax(0, draws - predicted);
    if (pooled_expected >= 5) {
        double difference = pooled_observed - pooled_expected;
        statistic += difference * difference / pooled_expected;
        used++;
    } else if (pooled_observed > 40) {
        return 0;
    }
    return used < 2 ? 1 : chi_square_tail(statistic, (double)used - 1);
}
