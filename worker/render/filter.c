/* filter: tabulated separable pixel filters (see filter.h). */
#include "worker/render/filter.h"

/* Value at |x| <= radius, not normalised. The gaussian is lowered to reach zero at its radius, as pbrt's. */
static double filter_value(const blob_filter_t *kind, double radius, double x)
{
    switch ((filter_kind_t)kind->kind) {
    case FILTER_TRIANGLE:
        return radius - fabs(x);
    case FILTER_GAUSSIAN: {
        double scale = -0.5 / ((double)kind->gaussian_sigma * (double)kind->gaussian_sigma);
        return exp(scale * x * x) - exp(scale * radius * radius);
    }
    case FILTER_BOX:
        break;
    }
    return 1;
}

static void axis_init(filter_axis_t *axis, const blob_filter_t *kind, float radius)
{
    double sum = 0, width = 2.0 * (double)radius / FILTER_TABLE, values[FILTER_TABLE];
    for (int i = 0; i < FILTER_TABLE; i++) {
        values[i] = filter_value(kind, (double)radius, -(double)radius + (i + 0.5) * width);
        sum += values[i];
    }
    axis->radius = radius;
    axis->is_pixel = kind->kind == FILTER_BOX && radius == 0.5f;
    double cumulative = 0;
    for (int i = 0; i < FILTER_TABLE; i++) {
        axis->density[i] = (float)(values[i] / (sum * width));
        axis->cumulative[i] = (float)(cumulative / sum);
        cumulative += values[i];
    }
    axis->cumulative[FILTER_TABLE] = 1;
}

void filter_init(filter_t *filter, const blob_filter_t *kind)
{
    axis_init(&filter->x, kind, kind->radius_x);
    axis_init(&filter->y, kind, kind->radius_y);
}

float filter_sample(const filter_axis_t *axis, float u)
{
    if (axis->is_pixel) return u - 0.5f;
    int low = 0, high = FILTER_TABLE; /* cumulative[low] <= u < cumulative[high] */
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (axis->cumulative[middle] <= u)
            low = middle;
        else
            high = middle;
    }
    float span = axis->cumulative[low + 1] - axis->cumulative[low];
    float in_bin = span > 0 ? (u - axis->cumulative[low]) / span : 0.5f;
    return axis->radius * (2 * ((float)low + in_bin) / FILTER_TABLE - 1);
}

float filter_density(const filter_axis_t *axis, float offset)
{
    float bin = (offset / axis->radius + 1) * (0.5f * FILTER_TABLE);
    return bin >= 0 && bin < FILTER_TABLE ? axis->density[(int)bin] : 0;
}

int filter_choose_pixel(const filter_axis_t *axis, float position, float u, float *weight)
{
    int own = (int)floorf(position);
    *weight = 1;
    if (axis->is_pixel) return own;
    int first = (int)floorf(position - axis->radius), last = (int)floorf(position + axis->radius);
    float sum = 0;
    for (int i = first; i <= last; i++) sum += filter_density(axis, position - ((float)i + 0.5f));
    *weight = sum;
    float left = u * sum;
    int chosen = own;
    for (int i = first; i <= last; i++) {
        float density = filter_density(axis, position - ((float)i + 0.5f));
        if (!(density > 0)) continue;
        chosen = i;
        if (left < density) break;
        left -= density;
    }
    return chosen;
}
