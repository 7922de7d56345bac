/* BSDFs from tables against the tables' definitions, written down again in other arithmetic, and against what
 * every BSDF must obey. The files are made here, of formulas. */
#include "client/import/files/fourier_table.h"
#include "client/import/files/measured_table.h"
#include "common/sampler.h"
#include "tests/bsdf_files.h"
#include "tests/scattering.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

/* ---- Fourier series ------------------------------------------------------------------------------------ */

enum { NODES = 16, TERMS = 24 };
static const float eta = 1.4f;

/* A table and the BSDF of a material that it is. */
typedef struct {
    fourier_table_t table;
    scattering_t s;
} fourier_t;

static void fourier_begin(fourier_t *f, uint32_t channels, fourier_formula_t *formula)
{
    size_t size;
    uint8_t *file = fourier_file(NODES, channels, TERMS, eta, formula, &size);
    blob_builder_t *builder = blob_builder_new();
    assert_string_equal(fourier_table_decode("a.bsdf", file, size, &f->table).message, "");
    blob_material_t material = {.kind = MATERIAL_FOURIER, .table = fourier_table_add(&f->table, builder)};
    scattering_begin_in(&f->s, builder, material);
    free(file);
}

static void fourier_end(fourier_t *f)
{
    scattering_end(&f->s);
    fourier_table_free(&f->table);
}

/* The series of two nodes, term by term. */
static double series_at(const fourier_table_t *table, uint32_t i, uint32_t o, uint32_t channel, double phi)
{
    const blob_series_t *s = &table->series[o * table->nodes + i];
    double sum = 0;
    for (uint32_t k = 0; k < s->count; k++)
        sum += (double)table->coefficients[s->first + channel * s->count + k] * cos(k * phi);
    return sum;
}

/* A cubic with given ends whose slopes are those of the lines through the neighbours (Catmull and Rom). */
static double spline(const float *x, uint32_t count, const double *y, double at)
{
    uint32_t i = 0;
    while (i + 2 < count && (double)x[i + 1] <= at) i++;
    uint32_t low = i > 0 ? i - 1 : i, high = i + 2 < count ? i + 2 : i + 1;
    double width = (double)x[i + 1] - (double)x[i], t = (at - (double)x[i]) / width;
    double slope0 = (y[i + 1] - y[low]) / ((double)x[i + 1] - (double)x[low]) * width;
    double slope1 = (y[high] - y[i]) / ((double)x[high] - (double)x[i]) * width;
    double square = 3 * (y[i + 1] - y[i]) - 2 * slope0 - slope1,
           cube = slope0 + slope1 - 2 * (y[i + 1] - y[i]);
    return y[i] + t * (slope0 + t * (square + t * cube));
}

static double table_at(const fourier_table_t *table, double mu_i, double mu_o, uint32_t channel, double phi)
{
    double rows[NODES], row[NODES];
    for (uint32_t o = 0; o < NODES; o++) {
        for (uint32_t i = 0; i < NODES; i++) row[i] = series_at(table, i, o, channel, phi);
        rows[o] = spline(table->mu, NODES, row, mu_i);
    }
    return spline(table->mu, NODES, rows, mu_o);
}

/* Radiance by the definition. */
static void defined(const fourier_table_t *table, vec3_t wo, vec3_t wi, double rgb[3])
{
    double mu_i = -(double)wi.z, mu_o = (double)wo.z;
    double phi = atan2(-(double)wi.y, -(double)wi.x) - atan2((double)wo.y, (double)wo.x);
    double scale = 1 / fabs(mu_i), index = (double)table->eta;
    if (mu_i * mu_o > 0) scale *= mu_i > 0 ? 1 / (index * index) : index * index;
    double y = fmax(table_at(table, mu_i, mu_o, 0, phi), 0);
    rgb[0] = rgb[1] = rgb[2] = y * scale;
    if (table->channels == 1) return;
    double r = table_at(table, mu_i, mu_o, 1, phi), b = table_at(table, mu_i, mu_o, 2, phi);
    rgb[0] = fmax(r, 0) * scale;
    rgb[1] = fmax(1.39829 * y - 0.100913 * b - 0.297375 * r, 0) * scale;
    rgb[2] = fmax(b, 0) * scale;
}

static void assert_is(vec3_t f, const double rgb[3])
{
    const float values[3] = {f.x, f.y, f.z};
    for (int c = 0; c < 3; c++)
        if (!(fabs((double)values[c] - rgb[c]) <= 2e-4 * rgb[c] + 2e-5))
            fail_msg("channel %d: %g for %g", c, (double)values[c], rgb[c]);
}

/* A pair of directions, every second one at nodes of both cosines, where no spline is between; away from the
 * poles, which have no azimuth. */
static void draw_pair(uint32_t n, vec3_t *wo, vec3_t *wi)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 5, 0, n);
    *wo = warp_sphere(sampler_2d(&sampler));
    *wi = warp_sphere(sampler_2d(&sampler));
    vec2_t u = sampler_2d(&sampler);
    if (n % 2 == 0) return;
    *wo = scattering_direction(fourier_node(NODES, 1 + (uint32_t)(u.x * (NODES - 2))), 6 * wo->x);
    *wi = scattering_direction(fourier_node(NODES, 1 + (uint32_t)(u.y * (NODES - 2))), 6 * wi->x);
}

static void series_have_their_values(void **state)
{
    (void)state;
    for (uint32_t channels = 1; channels <= 3; channels += 2) {
        fourier_t f;
        fourier_begin(&f, channels, fourier_skewed);
        int checked = 0;
        for (uint32_t n = 0; n < 1500; n++) {
            vec3_t wo, wi;
            double rgb[3];
            bsdf_value_t value, back;
            draw_pair(n, &wo, &wi);
            defined(&f.table, wo, wi, rgb);
            if (!bsdf_eval(&f.s.bsdf, wo, wi, TRANSPORT_RADIANCE, &value)) value.f = vec3(0, 0, 0);
            assert_is(value.f, rgb);
            if (v_is_zero(value.f)) continue;
            checked++;
            /* Importance is scattered as radiance on the way back. */
            assert_true(bsdf_eval(&f.s.bsdf, wi, wo, TRANSPORT_IMPORTANCE, &back));
            assert_is(back.f, rgb);
            assert_float_equal(back.pdf, value.pdf_rev, 1e-4f * value.pdf_rev);
            assert_float_equal(back.pdf_rev, value.pdf, 1e-4f * value.pdf);
        }
        assert_true(checked > 1200);
        fourier_end(&f);
    }
}

/* The table says what the formula says that it was made of; and what is reciprocal in it stays so at nodes.
 */
static void tables_have_their_formulas(void **state)
{
    (void)state;
    fourier_t f;
    fourier_begin(&f, 3, fourier_glossy);
    for (uint32_t n = 1; n < 1500; n += 2) {
        vec3_t wo, wi;
        bsdf_value_t value, back;
        draw_pair(n, &wo, &wi);
        if (wo.z * wi.z < 0) continue; /* the index of refraction scales it */
        double phi = atan2(-(double)wi.y, -(double)wi.x) - atan2((double)wo.y, (double)wo.x);
        double truth = fourier_glossy(-(double)wi.z, (double)wo.z, phi, 1) / fabs((double)wi.z);
        assert_true(bsdf_eval(&f.s.bsdf, wo, wi, TRANSPORT_RADIANCE, &value));
        assert_true(bsdf_eval(&f.s.bsdf, wi, wo, TRANSPORT_RADIANCE, &back));
        assert_float_equal(value.f.x, truth, 2e-3 * truth);
        assert_float_equal(back.f.x, truth, 2e-3 * truth);
    }
    fourier_end(&f);
}

static double integral_of_density(const fourier_t *f, vec3_t wo)
{
    enum { PARTS = 4 };
    double sum = 0;
    for (uint32_t i = 0; i + 1 < NODES; i++)
        for (uint32_t k = 0; k < 2 * FOURIER_AZIMUTHS * PARTS; k++) {
            double low = pow((double)(k / 2 / PARTS) / FOURIER_AZIMUTHS, 2),
                   high = pow((double)(k / 2 / PARTS + 1) / FOURIER_AZIMUTHS, 2);
            double phi = M_PI * (low + (high - low) * (k / 2 % PARTS + 0.5) / PARTS) * (k % 2 ? 1 : -1);
            double width = (double)f->table.mu[i + 1] - (double)f->table.mu[i];
            double mu = (double)f->table.mu[i] + width / 3;
            bsdf_value_t value;
            vec3_t wi = scattering_direction((float)mu, (float)(phi + atan2((double)wo.y, (double)wo.x)));
            if (!bsdf_eval(&f->s.bsdf, wo, v_neg(wi), TRANSPORT_RADIANCE, &value)) continue;
            sum += (double)value.pdf * width * M_PI * (high - low) / PARTS;
        }
    return sum;
}

static void directions_follow_their_densities(void **state)
{
    (void)state;
    fourier_t f;
    fourier_begin(&f, 3, fourier_skewed);
    for (uint32_t n = 0; n < 20; n++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 6, 0, n);
        assert_float_equal(integral_of_density(&f, warp_sphere(sampler_2d(&sampler))), 1, 1e-4);
    }
    scattering_check_densities(&f.s.bsdf);
    scattering_check_draws(&f.s.bsdf, scattering_direction(0.8f, 1));
    scattering_check_draws(&f.s.bsdf, scattering_direction(-0.3f, 2));
    scattering_check_draws(&f.s.bsdf, vec3(0, 0, 1));
    for (uint32_t n = 0; n < 20; n++) scattering_check_finite(&f.s.bsdf, n, 1e-6f);
    fourier_end(&f);
}

/* Samples find all of the light, and not much worse than the best that they could: a white surface is white,
 * and its weights hardly vary. */
static void white_series_are_white(void **state)
{
    (void)state;
    fourier_t f;
    fourier_begin(&f, 1, fourier_white);
    for (int k = 1; k <= 4; k++) {
        vec3_t wo = scattering_direction(0.25f * (float)k, (float)k);
        for (int mode = TRANSPORT_RADIANCE; mode <= TRANSPORT_IMPORTANCE; mode++) {
            scattering_mean_t mean = scattering_albedo(&f.s.bsdf, wo, (transport_t)mode, 20000);
            /* A spline rounds the kink of |cos| at the horizon. */
            assert_float_equal(mean.mean, 1, k == 1 ? 0.04 : 0.008);
            assert_true(mean.error < 0.002);
        }
    }
    bsdf_value_t value;
    assert_true(bsdf_eval(&f.s.bsdf, vec3(0.6f, 0, 0.8f), vec3(0, -0.8f, 0.6f), TRANSPORT_RADIANCE, &value));
    assert_float_equal(value.f.x, INV_PI_F, 1e-3f);
    assert_float_equal(bsdf_albedo(&f.s.bsdf).x, 1, 0.02f);
    fourier_end(&f);
}

/* ---- measured BRDFs ------------------------------------------------------------------------------------ */

typedef struct {
    measured_table_t table;
    scattering_t s;
} measured_t;

static void measured_begin(measured_t *m, bool isotropic, bool red, double level)
{
    size_t size;
    uint8_t *file = measured_file(isotropic, red, level, &size);
    blob_builder_t *builder = blob_builder_new();
    assert_string_equal(measured_table_decode("a.bsdf", file, size, &m->table).message, "");
    blob_material_t material = {.kind = MATERIAL_MEASURED, .table = measured_table_add(&m->table, builder)};
    scattering_begin_in(&m->s, builder, material);
    free(file);
}

static void measured_end(measured_t *m)
{
    scattering_end(&m->s);
    measured_table_free(&m->table);
}

/* Slices that are interpolated at an outgoing direction. */
typedef struct {
    size_t index[4];
    double weight[4];
} mixture_t;

static size_t bracket(const float *values, size_t count, double x, double *t)
{
    size_t i = 0;
    *t = 0;
    if (count == 1) return 0;
    while (i + 2 < count && (double)values[i + 1] <= x) i++;
    *t = fmin(fmax((x - (double)values[i]) / ((double)values[i + 1] - (double)values[i]), 0), 1);
    return i;
}

static mixture_t mixture(const measured_table_t *table, double phi, double theta)
{
    double t[2];
    mixture_t m;
    size_t a = bracket(table->azimuth, table->azimuths, phi, &t[0]),
           e = bracket(table->elevation, table->elevations, theta, &t[1]);
    for (size_t k = 0; k < 4; k++) {
        size_t up[2] = {k < 2 || table->azimuths == 1 ? 0 : 1, k % 2};
        m.index[k] = (a + up[0]) * table->elevations + e + up[1];
        m.weight[k] = (k < 2 ? 1 - t[0] : t[0]) * (k % 2 == 0 ? 1 - t[1] : t[1]);
    }
    return m;
}

/* A slice's numbers between four texels; `channel` of `channels`. */
static double bilinear(const measured_grid_t *g, size_t slice, size_t channels, size_t channel, double x,
                       double y)
{
    double px = x * (g->width - 1), py = y * (g->height - 1);
    size_t ix = (size_t)fmin(px, g->width - 2), iy = (size_t)fmin(py, g->height - 2);
    const float *v = g->values + ((slice * g->height + iy) * g->width + ix) * channels + channel;
    double fx = px - (double)ix, fy = py - (double)iy;
    double low = (1 - fx) * (double)v[0] + fx * (double)v[channels];
    v += (size_t)g->width * channels;
    return (1 - fy) * low + fy * ((1 - fx) * (double)v[0] + fx * (double)v[channels]);
}

/* The whole of a slice, by the mean of each cell's corners. */
static double whole(const measured_grid_t *g, size_t slice)
{
    double sum = 0;
    for (uint32_t y = 0; y + 1 < g->height; y++)
        for (uint32_t x = 0; x + 1 < g->width; x++)
            sum += bilinear(g, slice, 1, 0, (x + 0.5) / (g->width - 1), (y + 0.5) / (g->height - 1));
    return sum / (g->width - 1) / (g->height - 1);
}

static double density_at(const measured_grid_t *g, const mixture_t *m, double x, double y)
{
    double sum = 0;
    for (int k = 0; k < 4; k++)
        if (m->weight[k] > 0)
            sum += m->weight[k] * bilinear(g, m->index[k], 1, 0, x, y) / whole(g, m->index[k]);
    return sum;
}

/* The integrals of the density over all x up to y, and along y up to x over that along all of y, by the
 * trapezoidal rule in steps that no texel lies within. */
static void inverse(const measured_grid_t *g, const mixture_t *m, double x, double y, double u[2])
{
    double wholes[4], along = 0, part = 0, below = 0;
    for (int k = 0; k < 4; k++) wholes[k] = m->weight[k] > 0 ? whole(g, m->index[k]) : 1;
    for (uint32_t i = 0; i + 1 < g->width; i++)
        for (int k = 0; k < 4; k++) {
            double from = (double)i / (g->width - 1), to = (double)(i + 1) / (g->width - 1);
            double end = fmin(fmax(x, from), to), scale = m->weight[k] / wholes[k];
            if (scale == 0) continue;
            along += scale * (to - from) * bilinear(g, m->index[k], 1, 0, (from + to) / 2, y);
            part += scale * (end - from) * bilinear(g, m->index[k], 1, 0, (from + end) / 2, y);
            for (uint32_t j = 0; j + 1 < g->height; j++) {
                double low = (double)j / (g->height - 1), high = (double)(j + 1) / (g->height - 1);
                if (y <= low) break;
                high = fmin(high, y);
                below += scale * (to - from) * (high - low) *
                         bilinear(g, m->index[k], 1, 0, (from + to) / 2, (low + high) / 2);
            }
        }
    u[0] = part / along;
    u[1] = below;
}

/* Radiance by the definition, and its density. */
static double measured_definition(const measured_table_t *t, vec3_t wo, vec3_t wi, double rgb[3])
{
    double hx = (double)wo.x + (double)wi.x, hy = (double)wo.y + (double)wi.y,
           hz = (double)wo.z + (double)wi.z;
    double theta = acos((double)wo.z), phi = atan2((double)wo.y, (double)wo.x), r = hypot(hx, hy);
    double around = atan2(hy, hx) - (t->isotropic ? phi : 0), tilt = atan2(r, hz), u[2];
    double x = sqrt(tilt * 2 / M_PI), y = around / (2 * M_PI) + 0.5;
    y -= floor(y);
    mixture_t m = mixture(t, phi, theta);
    inverse(&t->visible, &m, x, y, u);
    double sigma = bilinear(&t->sigma, 0, 1, 0, sqrt(theta * 2 / M_PI), phi / (2 * M_PI) + 0.5);
    double scale = bilinear(&t->ndf, 0, 1, 0, x, y) / (4 * sigma * (double)wi.z);
    for (size_t c = 0; c < 3; c++) {
        rgb[c] = 0;
        for (int k = 0; k < 4; k++)
            if (m.weight[k] > 0)
                rgb[c] += m.weight[k] * scale * bilinear(&t->colours, m.index[k], 3, c, u[0], u[1]);
    }
    double length = sqrt(r * r + hz * hz), cosine = length / 2; /* of the angle to the normal */
    return density_at(&t->luminance, &m, u[0], u[1]) * density_at(&t->visible, &m, x, y) /
           (2 * M_PI * M_PI * x * r / length * 4 * cosine);
}

static void measurements_have_their_values(void **state)
{
    (void)state;
    for (int isotropic = 0; isotropic < 2; isotropic++) {
        measured_t m;
        measured_begin(&m, isotropic == 1, true, 0.8);
        for (uint32_t n = 0; n < 400; n++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, 0, n);
            vec3_t wo = warp_cosine_hemisphere(sampler_2d(&sampler)),
                   wi = warp_cosine_hemisphere(sampler_2d(&sampler));
            bsdf_value_t value, back;
            double rgb[3], pdf;
            pdf = measured_definition(&m.table, wo, wi, rgb);
            assert_true(bsdf_eval(&m.s.bsdf, wo, wi, TRANSPORT_RADIANCE, &value));
            const float f[3] = {value.f.x, value.f.y, value.f.z};
            for (int c = 0; c < 3; c++)
                if (!(fabs((double)f[c] - rgb[c]) <= 1e-3 * rgb[c] + 1e-6))
                    fail_msg("isotropic %d, channel %d: %g for %g", isotropic, c, (double)f[c], rgb[c]);
            assert_float_equal((double)value.pdf / pdf, 1, 2e-3);
            /* Importance is scattered as radiance on the way back, and from below as from above. */
            assert_true(bsdf_eval(&m.s.bsdf, v_neg(wi), v_neg(wo), TRANSPORT_IMPORTANCE, &back));
            if (isotropic == 1) assert_float_equal(back.f.x / value.f.x, 1, 1e-3);
            assert_true(bsdf_eval(&m.s.bsdf, wi, wo, TRANSPORT_IMPORTANCE, &back));
            assert_true(back.f.x == value.f.x && back.f.z == value.f.z);
            assert_true(back.pdf == value.pdf_rev && back.pdf_rev == value.pdf);
            assert_false(bsdf_eval(&m.s.bsdf, wo, v_neg(wi), TRANSPORT_RADIANCE, &value));
        }
        measured_end(&m);
    }
}

static void measured_directions_follow_their_densities(void **state)
{
    (void)state;
    for (int isotropic = 0; isotropic < 2; isotropic++) {
        measured_t m;
        measured_begin(&m, isotropic == 1, false, 1);
        scattering_check_densities(&m.s.bsdf);
        scattering_check_draws(&m.s.bsdf, scattering_direction(isotropic == 1 ? 0.7f : -0.5f, 2));
        for (uint32_t n = 0; n < 20; n++) scattering_check_finite(&m.s.bsdf, n, 1e-6f);
        measured_end(&m);
    }
}

/* What throws back all light but what meets the surface again: nearly white, and grey for a grey spectrum.
 * Each sample's weight is that of its colour alone, as the table says of surfaces whose parts fit together.
 */
static void white_measurements_are_nearly_white(void **state)
{
    (void)state;
    measured_t m;
    measured_begin(&m, true, false, 0.5);
    rgb_t colour = bsdf_albedo(&m.s.bsdf);
    assert_float_equal(colour.x, 0.5 * 1.05, 1e-3); /* the mean luminance is 1.05 */
    assert_float_equal(colour.x, colour.y, 1e-5);
    assert_float_equal(colour.x, colour.z, 1e-5);
    for (int k = 1; k <= 4; k++) {
        vec3_t wo = scattering_direction(0.25f * (float)k, (float)k);
        scattering_mean_t mean = scattering_albedo(&m.s.bsdf, wo, TRANSPORT_RADIANCE, 20000);
        print_message("cos %g: %g +- %g\n", (double)wo.z, mean.mean, mean.error);
        assert_true(mean.mean < 0.55 && mean.mean > 0.4);
    }
    measured_end(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(series_have_their_values),
        cmocka_unit_test(tables_have_their_formulas),
        cmocka_unit_test(directions_follow_their_densities),
        cmocka_unit_test(white_series_are_white),
        cmocka_unit_test(measurements_have_their_values),
        cmocka_unit_test(measured_directions_follow_their_densities),
        cmocka_unit_test(white_measurements_are_nearly_white),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
