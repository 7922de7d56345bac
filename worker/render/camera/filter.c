/* filter: tabulated separable pixel filters (see filter.h). */
#include "worker/render/camera/filter.h"

#include "worker/render/sampling/interval.h"

/* Mitchell and Netravali 1988, "Reconstruction Filters in Computer Graphics", equation 8; |x| <= 2. */
static double mitchell(double b, double c, double x)
{
    double x2 = x * x, x3 = x2 * x;
    if (x > 1)
        return ((-b - 6 * c) * x3 + (6 * b + 30 * c) * x2 + (-12 * b - 48 * c) * x + (8 * b + 24 * c)) / 6;
    return ((12 - 9 * b - 6 * c) * x3 + (-18 + 12 * b + 6 * c) * x2 + (6 - 2 * b)) / 6;
}

static double sinc(double x)
{
    return fabs(x) < 1e-5 ? 1 : sin(M_PI * x) / (M_PI * x);
}

/* Value at |x| <= radius, not normalised. The gaussian is lowered to reach zero at its radius, as pbrt's. */
static double raw_value(const blob_filter_t *kind, double radius, double x)
{
    double first = (double)kind->parameters[0], second = (double)kind->parameters[1];
    switch ((filter_kind_t)kind->kind) {
    case FILTER_TRIANGLE:
        return radius - fabs(x);
    case FILTER_GAUSSIAN: {
        double scale = -0.5 / (first * first);
        return exp(scale * x * x) - exp(scale * radius * radius);
    }
    case FILTER_MITCHELL:
        return mitchell(first, second, 2 * fabs(x) / radius);
    case FILTER_SINC: /* Lanczos' window, tau lobes wide */
        return sinc(x) * sinc(x / first);
    case FILTER_BOX:
        break;
    }
    return 1;
}

static void axis_init(filter_axis_t *axis, const blob_filter_t *kind, float radius)
{
    double sum = 0, absolute = 0, width = 2.0 * (double)radius / FILTER_TABLE, values[FILTER_TABLE];
    for (int i = 0; i < FILTER_TABLE; i++) {
        values[i] = raw_value(kind, (double)radius, -(double)radius + (i + 0.5) * width);
        sum += values[i];
        absolute += fabs(values[i]);
    }
    axis->radius = radius;
    axis->is_pixel = kind->kind == FILTER_BOX && radius == 0.5f;
    double cumulative = 0;
    for (int i = 0; i < FILTER_TABLE; i++) {
        axis->density[i] = (float)(fabs(values[i]) / (absolute * width));
        axis->weight[i] = (float)(copysign(absolute, values[i]) / sum);
        axis->cumulative[i] = (float)(cumulative / absolute);
        cumulative += fabs(values[i]);
    }
    axis->cumulative[FILTER_TABLE] = 1;
}

void filter_init(filter_t *filter, const blob_filter_t *kind)
{
    axis_init(&filter->x, kind, kind->radius_x);
    axis_init(&filter->y, kind, kind->radius_y);
}

float filter_sample(const filter_axis_t *axis, float u, float *weight)
{
    *weight = 1;
    if (axis->is_pixel) return u - 0.5f;
    uint32_t bin = interval_find(axis->cumulative, FILTER_TABLE, u);
    float span = axis->cumulative[bin + 1] - axis->cumulative[bin];
    float in_bin = span > 0 ? (u - axis->cumulative[bin]) / span : 0.5f;
    *weight = axis->weight[bin];
    return axis->radius * (2 * ((float)bin + in_bin) / FILTER_TABLE - 1);
}

/* The bin of an offset, or -1. */
static int bin_of(const filter_axis_t *axis, float offset)
{
    float bin = (offset / axis->radius + 1) * (0.5f * FILTER_TABLE);
    return bin >= 0 && bin < FILTER_TABLE ? (int)bin : -1;
}

float filter_value(const filter_axis_t *axis, float offset)
{
    int bin = bin_of(axis, offset);
    return bin < 0 ? 0 : axis->density[bin] * axis->weight[bin];
}

int filter_choose_pixel(const filter_axis_t *axis, float position, float u, float *weight)
{
    int own = (int)floorf(position);
    *weight = 1;
    if (axis->is_pixel) return own;
    int first = (int)floorf(position - axis->radius), last = (int)floorf(position + axis->radius);
    float sum = 0;
    for (int i = first; i <= last; i++) sum += fabsf(filter_value(axis, position - ((float)i + 0.5f)));
    *weight = sum;
    float left = u * sum;
    int chosen = own;
    for (int i = first; i <= last; i++) {
        float value = filter_value(axis, position - ((float)i + 0.5f));
        if (value == 0) continue;
        chosen = i;
        *weight = copysignf(sum, value);
        if (left < fabsf(value)) break;
        left -= fabsf(value);
    }
    return chosen;
}
