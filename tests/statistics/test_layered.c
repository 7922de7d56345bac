/* The layered materials against photons that are traced through the layers one by one, in other arithmetic,
 * by other sampling and without any of the renderer's lobes; against closed forms; and what physics demands.
 */
#include "common/sampler.h"
#include "tests/scattering.h"
#include "worker/render/bsdf/lobe.h"
#include "worker/render/sampling/warp.h"

#include <complex.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ---- photons ------------------------------------------------------------------------------------------- */

typedef struct {
    double x, y, z;
} dir_t;

/* The layers, in red; the material is made of the same numbers. */
typedef struct {
    const char *name;
    double ior, alpha; /* of the coat; alpha 0: smooth */
    double thickness, albedo, g;
    bool metal;
    double reflectance;         /* of Lambert */
    double eta, k, metal_alpha; /* of metal, against vacuum */
    double tint;                /* of what the coat reflects; 0: none */
} layer_stack_t;

typedef struct {
    uint64_t state;
} dice_t;

static double roll(dice_t *dice)
{
    dice->state = dice->state * 6364136223846793005u + 1442695040888963407u;
    return ((double)(dice->state >> 11) + 0.5) * 0x1p-53;
}

static double dot(dir_t a, dir_t b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static dir_t combine(double s, dir_t a, double t, dir_t b)
{
    return (dir_t){s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z};
}

/* From the amplitudes of both polarisations, with a complex index. */
static double fresnel(double cos_i, complex double index)
{
    complex double cos_t = csqrt(1 - (1 - cos_i * cos_i) / (index * index));
    if (cimag(index) == 0 && creal(cos_t) == 0) return 1;
    complex double s = (cos_i - index * cos_t) / (cos_i + index * cos_t),
                   p = (index * cos_i - cos_t) / (index * cos_i + cos_t);
    return 0.5 * (creal(s) * creal(s) + cimag(s) * cimag(s) + creal(p) * creal(p) + cimag(p) * cimag(p));
}

static double lambda(double alpha, dir_t w)
{
    double tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    return 0.5 * (sqrt(1 + alpha * alpha * tan2) - 1);
}

/* A normal by the distribution times its cosine, not by what is visible (Walter et al. 2007, equation 35). */
static dir_t normal(double alpha, dice_t *dice)
{
    double u = roll(dice), phi = 2 * M_PI * roll(dice), tan2 = alpha * alpha * u / (1 - u);
    double z = 1 / sqrt(1 + tan2), r = sqrt(1 - z * z);
    return (dir_t){r * cos(phi), r * sin(phi), z};
}

/* Light that travels along *w meets a rough or smooth interface; `index` is that of the far side. Returns the
 * factor on its weight (Walter et al. 2007, equation 41), 0 when it is lost. *w becomes the new direction. */
static double meet(double alpha, complex double index, bool opaque, dir_t *w, dice_t *dice)
{
    double side = w->z < 0 ? 1 : -1; /* the near side is up: 1 */
    dir_t i = {-w->x, -w->y, -w->z}, m = alpha > 0 ? normal(alpha, dice) : (dir_t){0, 0, 1}, o;
    m = combine(side, m, 0, m);
    double cos = dot(i, m);
    if (cos <= 0) return 0;
    double f = fresnel(cos, index);
    bool reflect = opaque || roll(dice) < f;
    if (reflect) {
        o = combine(2 * cos, m, -1, i);
        if (o.z * side <= 0) return 0;
    } else {
        double n = creal(index), cos_t = sqrt(1 - (1 - cos * cos) / (n * n));
        o = combine(cos / n - cos_t, m, -1 / n, i);
        if (o.z * side >= 0) return 0;
    }
    *w = o;
    double weight = opaque ? f : 1;
    if (alpha == 0) return weight;
    return weight * cos / ((1 + lambda(alpha, i) + lambda(alpha, o)) * fabs(i.z) * fabs(m.z));
}

static void turn(double g, dir_t *w, dice_t *dice)
{
    double c = 1 - 2 * roll(dice), phi = 2 * M_PI * roll(dice);
    if (g != 0) {
        double q = (1 - g * g) / (1 - g * c);
        c = (1 + g * g - q * q) / (2 * g);
    }
    dir_t a = fabs(w->x) < 0.7 ? (dir_t){1, 0, 0} : (dir_t){0, 1, 0}, b;
    a = combine(1, a, -dot(a, *w), *w);
    a = combine(1 / sqrt(dot(a, a)), a, 0, a);
    b = (dir_t){w->y * a.z - w->z * a.y, w->z * a.x - w->x * a.z, w->x * a.y - w->y * a.x};
    double s = sqrt(fmax(0, 1 - c * c));
    *w = combine(c, *w, 1, combine(s * cos(phi), a, s * sin(phi), b));
}

/* Sends one photon in along *w, down; returns its weight when it leaves, along *w, up; *mirrored tells that
 * it never entered. */
static double photon(const layer_stack_t *stack, dir_t *w, bool *mirrored, dice_t *dice)
{
    double weight = meet(stack->alpha, stack->ior, false, w, dice), z = stack->thickness;
    *mirrored = w->z > 0;
    if (*mirrored) return stack->tint > 0 ? weight * stack->tint : weight;
    while (weight > 0) {
        double free = -log(roll(dice)) * fabs(w->z), way = w->z < 0 ? z : stack->thickness - z;
        if (free < way) {
            z += w->z < 0 ? -free : free;
            weight *= stack->albedo;
            turn(stack->g, w, dice);
        } else if (w->z > 0) {
            z = stack->thickness;
            weight *= meet(stack->alpha, 1 / stack->ior, false, w, dice);
            if (w->z > 0) return weight;
        } else if (stack->metal) {
            z = 0;
            weight *= meet(stack->metal_alpha, (stack->eta + I * stack->k) / stack->ior, true, w, dice);
        } else {
            z = 0;
            weight *= stack->reflectance;
            double u = roll(dice), phi = 2 * M_PI * roll(dice);
            *w = (dir_t){sqrt(u) * cos(phi), sqrt(u) * sin(phi), sqrt(1 - u)};
        }
    }
    return 0;
}

/* ---- the materials ------------------------------------------------------------------------------------- */

static blob_material_t material_of(const layer_stack_t *s)
{
    blob_material_t m = {.kind = s->metal ? MATERIAL_COATED_CONDUCTOR : MATERIAL_COATED_DIFFUSE};
    m.values[VALUE_REFLECTANCE] = blob_constant((float)s->reflectance);
    m.values[VALUE_ETA] = blob_constant((float)s->ior);
    m.values[VALUE_ROUGHNESS_U] = m.values[VALUE_ROUGHNESS_V] = blob_constant((float)s->alpha);
    m.values[VALUE_THICKNESS] = blob_constant((float)s->thickness);
    m.values[VALUE_ALBEDO] = blob_constant((float)s->albedo);
    m.values[VALUE_G] = blob_constant((float)s->g);
    m.values[VALUE_BASE_ETA] = blob_constant((float)s->eta);
    m.values[VALUE_K] = blob_constant((float)s->k);
    m.values[VALUE_BASE_ROUGHNESS_U] = m.values[VALUE_BASE_ROUGHNESS_V] =
        blob_constant((float)s->metal_alpha);
    m.values[VALUE_SPECULAR] = blob_constant((float)s->tint);
    if (s->tint > 0) m.flags = MATERIAL_TINTED;
    return m;
}

static const layer_stack_t stacks[] = {
    {"smooth, Lambert", 1.5, 0, 0.01, 0, 0, false, 0.7, 0, 0, 0, 0},
    {"smooth, absorbing, Lambert", 1.4, 0, 0.4, 0, 0, false, 0.9, 0, 0, 0, 0},
    {"smooth, scattering, Lambert", 1.5, 0, 0.5, 0.8, 0.4, false, 0.5, 0, 0, 0, 0},
    {"rough, Lambert", 1.5, 0.3, 0.01, 0, 0, false, 0.7, 0, 0, 0, 0},
    {"rough, scattering, Lambert", 1.6, 0.4, 0.7, 0.9, -0.3, false, 0.4, 0, 0, 0, 0},
    {"smooth, metal", 1.5, 0, 0.3, 0, 0, true, 0, 0.2, 3.9, 0.2, 0},
    {"rough, metal", 1.5, 0.25, 0.01, 0, 0, true, 0, 0.2, 3.9, 0.3, 0},
    {"rough, scattering, metal", 1.5, 0.4, 0.6, 0.9, 0.2, true, 0, 1.5, 7, 0.2, 0},
    {"rough, smooth metal", 1.5, 0.3, 0.01, 0, 0, true, 0, 0.2, 3.9, 0, 0},
    {"rough and tinted, metal", 1.5, 0.25, 0.3, 0, 0, true, 0, 0.2, 3.9, 0.3, 0.3},
};

/* ---- light that leaves, by direction ------------------------------------------------------------------- */

enum { ROWS = 6, COLUMNS = 8, CELLS = ROWS * COLUMNS, PHOTONS = 120000 };

typedef struct {
    double sum[CELLS + 1], squares[CELLS + 1]; /* the last: all */
} histogram_t;

static void histogram_add(histogram_t *h, dir_t w, double weight)
{
    int row = (int)(w.z * ROWS), column = (int)((atan2(w.y, w.x) / (2 * M_PI) + 0.5) * COLUMNS);
    if (row >= ROWS) row = ROWS - 1;
    if (column >= COLUMNS) column = COLUMNS - 1;
    int cells[2] = {row * COLUMNS + column, CELLS};
    for (int i = 0; i < 2; i++) {
        h->sum[cells[i]] += weight;
        h->squares[cells[i]] += weight * weight;
    }
}

static double cell_variance(const histogram_t *h, int cell, double n)
{
    double mean = h->sum[cell] / n;
    return (h->squares[cell] / n - mean * mean) / n;
}

/* The renderer's, by its own sampling. */
static void gather(const bsdf_t *bsdf, vec3_t wo, histogram_t *h)
{
    for (uint32_t i = 0; i < PHOTONS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 5, 0, i);
        bsdf_sample_t s;
        vec2_t u = sampler_2d(&sampler);
        if (bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &s) && !s.specular)
            histogram_add(h, (dir_t){(double)s.wi.x, (double)s.wi.y, (double)s.wi.z}, (double)s.weight.x);
    }
}

static void compare(const layer_stack_t *stack, vec3_t wo)
{
    scattering_t scattering;
    scattering_begin(&scattering, material_of(stack));
    histogram_t *ours = calloc(1, sizeof *ours), *theirs = calloc(1, sizeof *theirs);
    dice_t dice = {12345};
    gather(&scattering.bsdf, wo, ours);
    for (int i = 0; i < PHOTONS; i++) {
        dir_t w = {-(double)wo.x, -(double)wo.y, -(double)wo.z};
        bool mirrored;
        double weight = photon(stack, &w, &mirrored, &dice);
        if (weight > 0 && !(mirrored && stack->alpha == 0)) histogram_add(theirs, w, weight);
    }
    for (int i = 0; i <= CELLS; i++) {
        double error = sqrt(cell_variance(ours, i, PHOTONS) + cell_variance(theirs, i, PHOTONS));
        double a = ours->sum[i] / PHOTONS, b = theirs->sum[i] / PHOTONS;
        if (!(fabs(a - b) < 4.7 * error + 1e-5))
            fail_msg("%s, cos %g, cell %d: %g where photons make %g (+- %g)", stack->name, (double)wo.z, i, a,
                     b, error);
    }
    double a = ours->sum[CELLS] / PHOTONS, error = sqrt(cell_variance(ours, CELLS, PHOTONS));
    if (getenv("LAYERED_VERBOSE"))
        print_message("%s, cos %g: %.4f +- %.5f, photons +- %.5f\n", stack->name, (double)wo.z, a, error,
                      sqrt(cell_variance(theirs, CELLS, PHOTONS)));
    assert_true(error < 0.01 * a); /* else the test tells nothing */
    free(ours);
    free(theirs);
    scattering_end(&scattering);
}

static void light_leaves_like_photons(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof stacks / sizeof *stacks; i++) {
        compare(&stacks[i], scattering_direction(0.9f, 0.4f));
        compare(&stacks[i], scattering_direction(0.35f, -2));
    }
}

/* ---- closed forms -------------------------------------------------------------------------------------- */

static double fresnel_transmittance(double cos)
{
    return 1 - fresnel(cos, 1.5);
}

/* f = T T rho / (pi index^2 (1 - rho K)). */
static void smooth_coat_over_lambert_is_a_series(void **state)
{
    (void)state;
    double back = 0;
    enum { STEPS = 200000 };
    for (int i = 0; i < STEPS; i++) {
        double c = (i + 0.5) / STEPS;
        back += 2 * c * fresnel(c, 1 / 1.5) / STEPS;
    }
    assert_true(fabs(back - 0.596) < 1e-3); /* the known value */
    assert_true(fabs((double)lobe_layered_returns(1.5f, 0) - back) < 1e-3);
    layer_stack_t stack = {"", 1.5, 0, 0, 0, 0, false, 0.8, 0, 0, 0, 0};
    scattering_t s;
    scattering_begin(&s, material_of(&stack));
    const float cosines[] = {1, 0.8f, 0.5f, 0.2f};
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            bsdf_value_t value;
            assert_true(bsdf_eval(&s.bsdf, scattering_direction(cosines[i], 1),
                                  scattering_direction(cosines[j], 4), TRANSPORT_RADIANCE, &value));
            double truth = fresnel_transmittance((double)cosines[i]) *
                           fresnel_transmittance((double)cosines[j]) * 0.8 / (M_PI * 2.25 * (1 - 0.8 * back));
            assert_true(fabs((double)value.f.x / truth - 1) < 2e-3);
        }
    scattering_end(&s);
}

/* A tint is on what the coat reflects alone, and leaves smooth layers without walks for Lambert. */
static void tints_are_of_the_coat_alone(void **state)
{
    (void)state;
    layer_stack_t stack = {"", 1.5, 0, 0.1, 0, 0, false, 0.8, 0, 0, 0, 0.25};
    scattering_t plain, tinted;
    scattering_begin(&tinted, material_of(&stack));
    stack.tint = 0;
    scattering_begin(&plain, material_of(&stack));
    vec3_t wo = scattering_direction(0.3f, 1), wi = scattering_direction(0.6f, 4);
    bsdf_value_t a, b;
    bsdf_sample_t mirrored;
    assert_true(bsdf_eval(&plain.bsdf, wo, wi, TRANSPORT_RADIANCE, &a));
    assert_true(bsdf_eval(&tinted.bsdf, wo, wi, TRANSPORT_RADIANCE, &b));
    assert_float_equal(b.f.x, a.f.x, 1e-6f);
    assert_true(bsdf_sample(&tinted.bsdf, wo, (vec2_t){0.5f, 0.5f}, 0.9999f, TRANSPORT_RADIANCE, &mirrored));
    assert_true(mirrored.specular);
    assert_true(fabs((double)(mirrored.weight.x * mirrored.pdf) - 0.25 * fresnel((double)wo.z, 1.5)) < 1e-5);
    scattering_end(&plain);
    scattering_end(&tinted);
}

/* The walks, where the closed form holds. */
static void walks_agree_with_the_series(void **state)
{
    (void)state;
    scattering_t s;
    scattering_begin(&s, material_of(&stacks[1]));
    assert_ptr_equal(s.bsdf.lobes[0].kind, &lobe_coated_lambert);
    lobe_t walks = s.bsdf.lobes[0];
    walks.kind = &lobe_layered;
    walks.layered.returns = 0;
    vec3_t wo = scattering_direction(0.7f, 0), wi = scattering_direction(0.4f, 2);
    bsdf_value_t series, walk;
    double sum = 0, squares = 0;
    enum { N = 100000 };
    assert_true(lobe_coated_lambert.eval(&s.bsdf.lobes[0], wo, wi, true, TRANSPORT_RADIANCE, &series));
    for (int i = 0; i < N; i++) {
        vec3_t near = scattering_direction(0.4f, 2 + 1e-5f * (float)i);
        assert_true(walks.kind->eval(&walks, wo, near, true, TRANSPORT_RADIANCE, &walk));
        sum += (double)walk.f.x / N;
        squares += (double)walk.f.x * (double)walk.f.x / N;
    }
    double error = sqrt((squares - sum * sum) / N);
    assert_true(error < 0.005 * sum);
    assert_true(fabs(sum - (double)series.f.x) < 4 * error + 1e-3 * sum);
    scattering_end(&s);
}

/* ---- what physics demands ------------------------------------------------------------------------------ */

/* What neither absorbs nor is rough loses nothing. */
static void layers_keep_energy(void **state)
{
    (void)state;
    const layer_stack_t clear[] = {
        {"clear, Lambert", 1.5, 0, 0, 0, 0, false, 1, 0, 0, 0, 0},
        {"scattering, Lambert", 1.5, 0, 0.5, 1, 0.3, false, 1, 0, 0, 0, 0},
        {"clear, perfect mirror", 1.5, 0, 0, 0, 0, true, 0, 0, 3, 0, 0},
    };
    for (size_t i = 0; i < sizeof clear / sizeof *clear; i++) {
        scattering_t s;
        scattering_begin(&s, material_of(&clear[i]));
        for (int j = 1; j <= 5; j++) {
            vec3_t wo = scattering_direction((j % 2 ? 0.2f : -0.2f) * (float)j, 1);
            scattering_mean_t albedo = scattering_albedo(&s.bsdf, wo, TRANSPORT_RADIANCE, 25000);
            if (!(fabs(albedo.mean - 1) < 4 * albedo.error + 1e-3 && albedo.error < 0.01))
                fail_msg("%s, cos %g: %g +- %g", clear[i].name, (double)wo.z, albedo.mean, albedo.error);
        }
        scattering_end(&s);
    }
    /* Rough layers lose light but make none. */
    for (size_t i = 0; i < sizeof stacks / sizeof *stacks; i++) {
        scattering_t s;
        layer_stack_t stack = stacks[i];
        stack.reflectance = 1, stack.thickness = 0, stack.albedo = 0, stack.eta = 0;
        scattering_begin(&s, material_of(&stack));
        for (int j = 1; j <= 10; j++) {
            scattering_mean_t albedo = scattering_albedo(&s.bsdf, scattering_direction(0.1f * (float)j, 1),
                                                         TRANSPORT_IMPORTANCE, 8000);
            assert_true(albedo.mean < 1 + 4 * albedo.error + 1e-3);
            assert_true(albedo.mean > 0.4);
        }
        scattering_end(&s);
    }
}

static void layers_are_reciprocal_and_two_sided(void **state)
{
    (void)state;
    for (size_t k = 0; k < sizeof stacks / sizeof *stacks; k++) {
        scattering_t s;
        scattering_begin(&s, material_of(&stacks[k]));
        for (uint32_t i = 0; i < 2000; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, 0, i);
            vec3_t a = warp_cosine_hemisphere(sampler_2d(&sampler)),
                   b = warp_cosine_hemisphere(sampler_2d(&sampler));
            bsdf_value_t there, back, below, again;
            bool any = bsdf_eval(&s.bsdf, a, b, TRANSPORT_RADIANCE, &there);
            assert_int_equal(any, bsdf_eval(&s.bsdf, b, a, TRANSPORT_IMPORTANCE, &back));
            assert_int_equal(any, bsdf_eval(&s.bsdf, v_neg(a), v_neg(b), TRANSPORT_RADIANCE, &below));
            assert_int_equal(any, bsdf_eval(&s.bsdf, a, b, TRANSPORT_RADIANCE, &again));
            if (!any) continue;
            assert_memory_equal(&again, &there, sizeof again);
            assert_float_equal(there.f.x, back.f.x, 1e-5f * there.f.x + 1e-7f);
            assert_float_equal(there.f.x, below.f.x, 1e-5f * there.f.x + 1e-7f);
            assert_float_equal(there.pdf, back.pdf_rev, 1e-3f * there.pdf);
            assert_false(bsdf_eval(&s.bsdf, a, v_neg(b), TRANSPORT_RADIANCE, &below));
        }
        scattering_end(&s);
    }
}

static void layers_draw_their_density(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof stacks / sizeof *stacks; i++) {
        scattering_t s;
        scattering_begin(&s, material_of(&stacks[i]));
        scattering_check_densities(&s.bsdf);
        scattering_check_draws(&s.bsdf, scattering_direction(0.85f, 1));
        scattering_check_draws(&s.bsdf, scattering_direction(-0.3f, 2));
        bsdf_regularize(&s.bsdf);
        assert_false(s.bsdf.specular);
        scattering_check_draws(&s.bsdf, scattering_direction(0.5f, 1));
        scattering_end(&s);
    }
}

/* Two alphas: the light goes where the rougher axis sends it. */
static void anisotropy_shows(void **state)
{
    (void)state;
    blob_material_t m = material_of(&stacks[5]);
    m.values[VALUE_BASE_ROUGHNESS_U] = blob_constant(0.4f);
    m.values[VALUE_BASE_ROUGHNESS_V] = blob_constant(0.1f);
    scattering_t s;
    scattering_begin(&s, m);
    vec3_t wo = vec3(0, 0, 1);
    bsdf_value_t along, across;
    assert_true(bsdf_eval(&s.bsdf, wo, scattering_direction(0.8f, 0), TRANSPORT_RADIANCE, &along));
    assert_true(
        bsdf_eval(&s.bsdf, wo, scattering_direction(0.8f, (float)M_PI / 2), TRANSPORT_RADIANCE, &across));
    assert_true(along.f.x > 2 * across.f.x);
    scattering_check_draws(&s.bsdf, scattering_direction(0.6f, 1));
    scattering_end(&s);
}

/* Values at and beyond their limits: nothing may be infinite, negative or endless. */
static void extreme_values_are_harmless(void **state)
{
    (void)state;
    const float extremes[] = {0, -1, 1, 1e-30f, 1e30f, 1e-3f};
    for (uint32_t i = 0; i < 400; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 8, 0, i);
        layer_stack_t stack = stacks[i % (sizeof stacks / sizeof *stacks)];
        double *const numbers[] = {&stack.ior,         &stack.alpha, &stack.thickness,
                                   &stack.albedo,      &stack.g,     &stack.eta,
                                   &stack.reflectance, &stack.k,     &stack.metal_alpha};
        for (int j = 0; j < 3; j++) {
            vec2_t u = sampler_2d(&sampler);
            *numbers[(int)(u.x * 9)] = (double)extremes[(int)(u.y * 6)];
        }
        scattering_t s;
        scattering_begin(&s, material_of(&stack));
        scattering_check_finite(&s.bsdf, i, 1e-7f);
        scattering_end(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(smooth_coat_over_lambert_is_a_series),
        cmocka_unit_test(tints_are_of_the_coat_alone),
        cmocka_unit_test(walks_agree_with_the_series),
        cmocka_unit_test(light_leaves_like_photons),
        cmocka_unit_test(layers_keep_energy),
        cmocka_unit_test(layers_are_reciprocal_and_two_sided),
        cmocka_unit_test(layers_draw_their_density),
        cmocka_unit_test(anisotropy_shows),
        cmocka_unit_test(extreme_values_are_harmless),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
