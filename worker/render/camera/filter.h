/* filter: the pixel filter, by importance sampling.
 *
 * An eye sample takes its place on the film from the pixel's centre and an offset drawn from the normalised
 * filter, and then counts fully for that pixel alone (Ernst et al. 2006, "Filter Importance Sampling"): tiles
 * never overlap. Where a filter is negative, the absolute value is drawn from and the sample counts with a
 * sign and the factor integral |f| / integral f. A splat falls where it falls; it is given to one of the
 * pixels in reach, chosen in proportion to the filter's value there, with the sum of these values as weight,
 * so that both estimate the same filtered image.
 */
#ifndef LIGHTMILL_FILTER_H
#define LIGHTMILL_FILTER_H

#include "common/scene/scene_blob.h"

enum { FILTER_TABLE = 1024 };

/* One axis of a separable filter over [-radius, radius], constant in each bin: the density of its absolute
 * value, and the factor that makes of it the normalised filter. */
typedef struct {
    float radius;
    bool is_pixel;                      /* a box that is the pixel itself */
    float density[FILTER_TABLE];        /* per pixel, of |f| */
    float weight[FILTER_TABLE];         /* the factor: density times weight integrates to one */
    float cumulative[FILTER_TABLE + 1]; /* 0 to 1 */
} filter_axis_t;

typedef struct {
    filter_axis_t x, y;
} filter_t;

/* How far from a pixel's centre a splat can still count for it, in pixels. */
static inline float filter_reach(const filter_t *filter)
{
    return float_max(filter->x.radius, filter->y.radius);
}

void filter_init(filter_t *filter, const blob_filter_t *kind);
/* An offset from the pixel's centre, in pixels, drawn from the axis' density; *weight receives the factor for
 * the sample. */
float filter_sample(const filter_axis_t *axis, float u, float *weight);
/* The normalised filter at an offset from the centre, per pixel. */
float filter_value(const filter_axis_t *axis, float offset);
/* Chooses the pixel along one axis that takes a splat at `position` (pixel i spans [i, i + 1)); *weight
 * receives the factor for the splat. The pixel may lie outside the film. */
int filter_choose_pixel(const filter_axis_t *axis, float position, float u, float *weight);

#endif
