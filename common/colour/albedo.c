/* albedo: see albedo.h. s is the similarity parameter. */
#include "common/colour/albedo.h"

#include <math.h>

double colour_of_albedo(double albedo, double g)
{
    double s = sqrt((1 - albedo) / (1 - g * albedo));
    return (1 - s) * (1 - 0.139 * s) / (1 + 1.17 * s);
}

double albedo_of_colour(double colour, double g)
{
    double s = 4.09712 + 4.20863 * colour - sqrt(9.59217 + 41.6808 * colour + 17.7126 * colour * colour);
    return colour > 0 ? fmin((1 - s * s) / (1 - g * s * s), 1) : 0; /* which the rounded numbers miss */
}
