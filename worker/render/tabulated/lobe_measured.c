/* lobe_measured: a measured BRDF (blob_measured_t; Dupuy and Jakob 2018, "An Adaptive Parameterization for
 * Efficient Material Acquisition and Rendering"), as pbrt-v4 evaluates and samples it.
 *
 * For each outgoing direction a warp of the unit square makes visible microfacet normals of uniform numbers;
 * over these numbers lie the measured colours, and a second warp that draws numbers by their luminance. So a
 * direction is drawn by both warps, and evaluated by the inverse of the first. Warps are marginal-conditional
 * ones of bilinear densities: between slices the sums are interpolated, which are then those of the
 * interpolated densities.
 *
 * A measurement is reciprocal only about: importance is scattered as radiance on the way back, so that paths
 * from either end tell of the same surface. Like pbrt's, the surface is the same from below. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/sampling/interval.h"

/* ---- slices -------------------------------------------------------------------------------------------- */

/* The slices about an outgoing direction, and what each counts. */
typedef struct {
    uint32_t index[4];
    float weight[4];
} slices_t;

/* Between which of `count` ascending values x lies, and how far towards the second; beyond the ends, at them.
 */
static uint32_t find_between(const float *values, uint32_t count, float x, float *t)
{
    *t = 0;
    if (count == 1) return 0;
    uint32_t first = interval_find(values, count - 1, x);
    *t = float_clamp((x - values[first]) / (values[first + 1] - values[first]), 0, 1);
    return first;
}

static void find_slices(const lobe_measured_t *m, float phi, float theta, slices_t *s)
{
    const blob_measured_t *table = m->table;
    float t[2];
    uint32_t azimuth = find_between(m->numbers + table->first_azimuth, table->azimuths, phi, &t[0]),
             elevation = find_between(m->numbers + table->first_elevation, table->elevations, theta, &t[1]);
    for (uint32_t k = 0; k < 4; k++) {
        bool next[2] = {k / 2 == 1 && table->azimuths > 1, k % 2 == 1 && table->elevations > 1};
        s->index[k] = (azimuth + next[0]) * table->elevations + elevation + next[1];
        s->weight[k] = (k / 2 == 1 ? t[0] : 1 - t[0]) * (k % 2 == 1 ? t[1] : 1 - t[1]);
    }
}

/* One number of each slice, `stride` apart, interpolated. */
static float mixed(const float *numbers, const slices_t *s, size_t stride, size_t at)
{
    float sum = 0;
    for (int k = 0; k < 4; k++)
        if (s->weight[k] > 0) sum += s->weight[k] * numbers[s->index[k] * stride + at];
    return sum;
}

/* ---- grids --------------------------------------------------------------------------------------------- */

/* A cell of a grid and a place in it, 0 to 1. */
typedef struct {
    uint32_t column, row;
    float x, y;
} place_t;

static place_t find_place(const blob_grid_t *grid, vec2_t at)
{
    float x = float_clamp(at.x, 0, 1) * (float)(grid->width - 1),
          y = float_clamp(at.y, 0, 1) * (float)(grid->height - 1);
    uint32_t column = (uint32_t)x, row = (uint32_t)y;
    if (column > grid->width - 2) column = grid->width - 2;
    if (row > grid->height - 2) row = grid->height - 2;
    return (place_t){column, row, x - (float)column, y - (float)row};
}

static float between(float a, float b, float t)
{
    return (1 - t) * a + t * b;
}

/* Of a grid without slices. */
static float grid_value(const lobe_measured_t *m, const blob_grid_t *grid, vec2_t at)
{
    place_t p = find_place(grid, at);
    const float *low = m->numbers + grid->first + (size_t)p.row * grid->width + p.column;
    const float *high = low + grid->width;
    return between(between(low[0], low[1], p.x), between(high[0], high[1], p.x), p.y);
}

/* ---- warps --------------------------------------------------------------------------------------------- */

/* A grid with sums, at an outgoing direction. */
typedef struct {
    const blob_grid_t *grid;
    const float *densities, *rows, *parts;
    size_t pixels;
    slices_t slices;
} warp_t;

static warp_t warp_at(const lobe_measured_t *m, const blob_grid_t *grid, const slices_t *slices)
{
    size_t pixels = (size_t)grid->width * grid->height,
           count = (size_t)m->table->azimuths * m->table->elevations;
    const float *densities = m->numbers + grid->first, *rows = densities + count * pixels;
    return (warp_t){grid, densities, rows, rows + count * grid->height, pixels, *slices};
}

/* The densities at both ends of a cell, along the line at p.y. */
static void cell_ends(const warp_t *w, const place_t *p, float ends[2])
{
    size_t at = (size_t)p->row * w->grid->width + p->column;
    for (size_t i = 0; i < 2; i++)
        ends[i] = between(mixed(w->densities, &w->slices, w->pixels, at + i),
                          mixed(w->densities, &w->slices, w->pixels, at + w->grid->width + i), p->y);
}

/* The integral along the line at p.y up to a column. */
static float part_of_line(const warp_t *w, const place_t *p, uint32_t column)
{
    size_t at = (size_t)p->row * w->grid->width + column;
    return between(mixed(w->parts, &w->slices, w->pixels, at),
                   mixed(w->parts, &w->slices, w->pixels, at + w->grid->width), p->y);
}

/* The integrals of a row and of the next. */
static void row_wholes(const warp_t *w, uint32_t row, float wholes[2])
{
    size_t at = (size_t)row * w->grid->width + w->grid->width - 1;
    for (size_t i = 0; i < 2; i++)
        wholes[i] = mixed(w->parts, &w->slices, w->pixels, at + i * w->grid->width);
}

static float sum_of_rows(const warp_t *w, uint32_t row)
{
    return mixed(w->rows, &w->slices, w->grid->height, row);
}

static float line_density(const warp_t *w, const float ends[2], float x)
{
    return between(ends[0], ends[1], x) * (float)(w->grid->width - 1) * (float)(w->grid->height - 1);
}

/* Where between 0 and 1 the integral of the line from a to b reaches u. */
static float invert_line(float a, float b, float u)
{
    float root = a + sqrtf(float_max(0, a * a + 2 * u * (b - a)));
    return root > 0 ? float_clamp(2 * u / root, 0, 1) : 0;
}

/* The point of density that a pair of uniform numbers makes. */
static vec2_t warp_draw(const warp_t *w, vec2_t u)
{
    place_t p = {0, 0, 0, 0};
    float wholes[2], ends[2];
    uint32_t last = w->grid->height - 1;
    while (last - p.row > 1) {
        uint32_t middle = (p.row + last) / 2;
        if (sum_of_rows(w, middle) <= u.y)
            p.row = middle;
        else
            last = middle;
    }
    row_wholes(w, p.row, wholes);
    p.y = invert_line(wholes[0], wholes[1], u.y - sum_of_rows(w, p.row));
    float x = u.x * between(wholes[0], wholes[1], p.y);
    last = w->grid->width - 1;
    while (last - p.column > 1) {
        uint32_t middle = (p.column + last) / 2;
        if (part_of_line(w, &p, middle) <= x)
            p.column = middle;
        else
            last = middle;
    }
    cell_ends(w, &p, ends);
    p.x = invert_line(ends[0], ends[1], x - part_of_line(w, &p, p.column));
    return (vec2_t){((float)p.column + p.x) / (float)(w->grid->width - 1),
                    ((float)p.row + p.y) / (float)(w->grid->height - 1)};
}

/* The numbers that make a point, and its density. */
static vec2_t warp_undo(const warp_t *w, vec2_t at, float *density)
{
    place_t p = find_place(w->grid, at);
    float wholes[2], ends[2];
    cell_ends(w, &p, ends);
    row_wholes(w, p.row, wholes);
    *density = line_density(w, ends, p.x);
    float whole = between(wholes[0], wholes[1], p.y);
    float x = part_of_line(w, &p, p.column) + p.x * (ends[0] + 0.5f * p.x * (ends[1] - ends[0]));
    float y = sum_of_rows(w, p.row) + p.y * (wholes[0] + 0.5f * p.y * (wholes[1] - wholes[0]));
    return (vec2_t){whole > 0 ? float_clamp(x / whole, 0, 1) : 0, float_clamp(y, 0, 1)};
}

static float warp_density(const warp_t *w, vec2_t at)
{
    place_t p = find_place(w->grid, at);
    float ends[2];
    cell_ends(w, &p, ends);
    return line_density(w, ends, p.x);
}

/* ---- directions ---------------------------------------------------------------------------------------- */

/* Elevation from the normal. Not acos, which is coarse near it. */
static float elevation(vec3_t w)
{
    return atan2f(sqrtf(w.x * w.x + w.y * w.y), w.z);
}

static float azimuth(vec3_t w)
{
    return w.x == 0 && w.y == 0 ? 0 : atan2f(w.y, w.x);
}

static vec2_t square_point(float theta, float phi)
{
    return (vec2_t){sqrtf(float_max(theta, 0) * (2 / PI_F)), phi * (1 / TWO_PI_F) + 0.5f};
}

/* Of light that arrives along wi and leaves along wo: its value, and the density of drawing wi for wo. */
typedef struct {
    rgb_t f;
    float pdf;
} scatter_t;

/* The colours at the numbers that make a normal visible. */
static rgb_t colour_at(const lobe_measured_t *m, const slices_t *s, vec2_t at)
{
    const blob_grid_t *grid = &m->table->luminance;
    const float *colours = m->numbers + m->table->first_colour;
    size_t stride = 3 * (size_t)grid->width * grid->height;
    place_t p = find_place(grid, at);
    float rgb[3];
    for (size_t c = 0; c < 3; c++) {
        size_t low = 3 * ((size_t)p.row * grid->width + p.column) + c, high = low + 3 * (size_t)grid->width;
        rgb[c] =
            between(between(mixed(colours, s, stride, low), mixed(colours, s, stride, low + 3), p.x),
                    between(mixed(colours, s, stride, high), mixed(colours, s, stride, high + 3), p.x), p.y);
    }
    rgb_t colour = vec3(rgb[0], rgb[1], rgb[2]);
    return m->waves == NULL ? colour : waves_coefficient(m->waves, colour);
}

/* Both lie above the surface; `normal` is the microfacet's, halfway between them. */
static scatter_t scatter(const lobe_measured_t *m, vec3_t wo, vec3_t wi, vec3_t normal)
{
    const blob_measured_t *table = m->table;
    float theta = elevation(wo), phi = azimuth(wo), density;
    slices_t slices;
    find_slices(m, phi, theta, &slices);
    warp_t visible = warp_at(m, &table->visible, &slices), luminance = warp_at(m, &table->luminance, &slices);
    float normal_theta = elevation(normal);
    vec2_t at = square_point(normal_theta, azimuth(normal) - (table->isotropic ? phi : 0));
    at.y -= floorf(at.y);
    vec2_t u = warp_undo(&visible, at, &density);
    float sigma = grid_value(m, &table->sigma, square_point(theta, phi));
    float facets = grid_value(m, &table->ndf, at) / (4 * sigma * wi.z);
    /* From the square to solid angle of normals, and from these to directions. */
    float jacobian = float_max(2 * PI_F * PI_F * at.x * sinf(normal_theta), 1e-9f) * 4 * v_dot(wo, normal);
    return (scatter_t){v_scale(v_mul(m->factor, colour_at(m, &slices, u)), facets),
                       density * warp_density(&luminance, u) / jacobian};
}

static bool eval(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    (void)reflect;
    if (wo.z < 0) wo = v_neg(wo), wi = v_neg(wi);
    vec3_t sum = v_add(wo, wi);
    float length2 = v_length2(sum);
    if (!(wo.z > 0 && wi.z > 0 && length2 > 1e-12f)) return false;
    vec3_t normal = v_scale(sum, 1 / sqrtf(length2));
    scatter_t there = scatter(&lobe->measured, wo, wi, normal),
              back = scatter(&lobe->measured, wi, wo, normal);
    value->f = mode == TRANSPORT_RADIANCE ? there.f : back.f;
    value->pdf = there.pdf;
    value->pdf_rev = back.pdf;
    return lobe_is_sane(value);
}

/* Draws wi for wo above the surface. */
static bool draw(const lobe_measured_t *m, vec3_t wo, vec2_t u, vec3_t *wi)
{
    const blob_measured_t *table = m->table;
    float phi = azimuth(wo);
    slices_t slices;
    find_slices(m, phi, elevation(wo), &slices);
    warp_t visible = warp_at(m, &table->visible, &slices), luminance = warp_at(m, &table->luminance, &slices);
    vec2_t at = warp_draw(&visible, warp_draw(&luminance, u));
    float theta = at.x * at.x * (PI_F / 2), around = (2 * at.y - 1) * PI_F + (table->isotropic ? phi : 0);
    float r = sinf(theta);
    vec3_t normal = vec3(r * cosf(around), r * sinf(around), cosf(theta));
    *wi = v_sub(v_scale(normal, 2 * v_dot(wo, normal)), wo);
    return wi->z > 0;
}

static bool sample(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *sample)
{
    vec3_t up = wo.z > 0 ? wo : v_neg(wo), wi;
    bsdf_value_t value;
    (void)choice;
    return draw(&lobe->measured, up, u, &wi) && eval(lobe, up, wi, true, mode, &value) &&
           lobe_complete(wo, wi, &value, sample);
}

const lobe_kind_t lobe_measured = {.flags = LOBE_REFLECTS, .eval = eval, .sample = sample};
