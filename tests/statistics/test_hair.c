/* Hair: a fibre is met as the band that it shows to a ray; a hair that absorbs nothing gives everything back,
 * at every offset and roughness; it draws from the densities that it claims, for eye and light subpaths
 * alike; and its values are those of the papers. The random numbers are fixed. */
#include "common/sampler.h"
#include "tests/chi_square.h"
#include "tests/render_here.h"
#include "worker/render/integrator/vertex.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define NUMBER(place, x) .values[place] = {{x, x, x}, 0}
#define COLOUR(place, r, g, b) .values[place] = {{r, g, b}, 0}
#define HAIR(along, about)                                                                                   \
    .kind = MATERIAL_HAIR, NUMBER(VALUE_ETA, 1.55f), NUMBER(VALUE_TILT, 2),                                  \
    NUMBER(VALUE_ROUGHNESS_U, along), NUMBER(VALUE_ROUGHNESS_V, about)

static const float RADIUS = 0.1f;

/* A straight hair along x, from -1 to 1, seen from z = -5. */
typedef struct {
    test_scene_t builder;
    scene_t *scene;
} strand_t;

static void add_fibre(blob_builder_t *b, curves_kind_t kind, const blob_curve_point_t points[4],
                      uint32_t material)
{
    blob_curves_t curves = {.kind = kind, .segment_count = 1, .first_normal = BLOB_NONE};
    curves.first_point = blob_builder_add(b, BLOB_SECTION_CURVE_POINTS, points, 4);
    blob_shape_t shape = {.kind = SHAPE_CURVES,
                          .material = material,
                          .light = BLOB_NONE,
                          .alpha = blob_constant(1),
                          .shadow_alpha = blob_constant(1)};
    shape.geometry = blob_builder_add(b, BLOB_SECTION_CURVES, &curves, 1);
    blob_builder_add(b, BLOB_SECTION_SHAPES, &shape, 1);
}

static void strand_begin_as(strand_t *strand, curves_kind_t kind, blob_material_t material)
{
    const blob_curve_point_t points[4] = {
        {-1, 0, 0, RADIUS}, {-1 / 3.0f, 0, 0, RADIUS}, {1 / 3.0f, 0, 0, RADIUS}, {1, 0, 0, RADIUS}};
    strand->builder = test_scene_begin(vec3(0, 0, -5), 40, 8);
    add_fibre(strand->builder.builder, kind, points, test_scene_material(&strand->builder, material));
    test_scene_finish(&strand->builder);
    assert_int_equal(scene_new(&strand->builder.blob, &strand->scene).code, RESULT_OK);
}

static void strand_begin(strand_t *strand, blob_material_t material)
{
    strand_begin_as(strand, CURVES_FIBRE, material);
}

static void strand_end(strand_t *strand)
{
    scene_destroy(&strand->scene);
    test_scene_end(&strand->builder);
}

/* The vertex where a ray in direction (slant, 0, 1) meets the hair at an offset. */
static vertex_t vertex_at(const strand_t *strand, float h, float slant)
{
    vertex_t vertex = {.kind = VERTEX_SURFACE};
    vec3_t d = v_normalize(vec3(slant, 0, 1)), at = vec3(0.25f, h * RADIUS, 0);
    assert_true(scene_intersect(strand->scene, v_mad(at, -3, d), d, 0, &vertex.surface));
    vertex.wo = v_neg(d);
    material_bsdf(strand->scene, &vertex.surface, &vertex.bsdf);
    return vertex;
}

static const float offsets[] = {-0.95f, -0.5f, 0, 0.3f, 0.8f}, roughnesses[] = {0.15f, 0.3f, 0.6f, 1};

/* ---- geometry ------------------------------------------------------------------------------------------ */

static void a_ray_meets_a_fibre_at_its_offset(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin(&strand, (blob_material_t){HAIR(0.3f, 0.3f)});
    for (size_t i = 0; i < ARRAY_LENGTH(offsets); i++) {
        float h = offsets[i];
        vertex_t vertex = vertex_at(&strand, h, 1);
        surface_t *surface = &vertex.surface;
        assert_true(surface->fibre);
        assert_float_equal(surface->p.z, 0, 1e-5f); /* in the plane of its axis */
        assert_float_equal(surface->place.y, h, 1e-3f);
        assert_float_equal(vertex.bsdf.lobes[0].hair.h, h, 1e-3f);
        assert_float_equal(surface->place.x, 0.625f, 1e-3f);
        assert_float_equal(surface->along.x, 1, 1e-6f);
        assert_float_equal(surface->ng.x, 0, 1e-6f);
        assert_float_equal(surface->ng.y, -sinf(0.5f * PI_F * h), 2e-3f);
        assert_float_equal(surface->ng.z, -cosf(0.5f * PI_F * h), 2e-3f);
        assert_float_equal(surface->radius, RADIUS, 1e-6f);
        assert_float_equal(surface->offset, 4 * RADIUS * (fabsf(surface->ng.y) + fabsf(surface->ng.z)),
                           1e-3f);
        surface_details_t details; /* u along it, v across */
        scene_details(strand.scene, surface, &details);
        assert_float_equal(details.uv.x, 0.625f, 1e-3f);
        assert_float_equal(details.uv.y, 0.5f + 0.5f * h, 1e-3f);
        assert_true(details.dpdu.x > 0 && vertex_is_for_eyes(&vertex));
        assert_false(vertex_is_mergeable(&vertex));
    }
    surface_t beside;
    assert_false(scene_intersect(strand.scene, vec3(0, 1.01f * RADIUS, -3), vec3(0, 0, 1), 0, &beside));
    strand_end(&strand);
}

/* The normal of a flat hair does not turn, and its offsets are those of any. */
static void a_flat_fibre_faces_the_ray(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin_as(&strand, CURVES_FLAT_FIBRE, (blob_material_t){HAIR(0.3f, 0.3f)});
    for (size_t i = 0; i < ARRAY_LENGTH(offsets); i++) {
        vertex_t vertex = vertex_at(&strand, offsets[i], 1);
        assert_true(vertex_is_for_eyes(&vertex));
        assert_float_equal(vertex.bsdf.lobes[0].hair.h, offsets[i], 1e-3f);
        assert_float_equal(vertex.surface.ng.y, 0, 1e-6f);
        assert_float_equal(vertex.surface.ng.z, -1, 1e-6f);
    }
    strand_end(&strand);
}

/* A hair lights what rays from it come to, from where they come; and nothing that they miss. */
static void a_fibre_lights_what_its_rays_meet(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin(&strand, (blob_material_t){HAIR(0.3f, 0.3f)});
    for (uint32_t i = 0; i < 2000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, 0, i);
        vertex_t vertex = vertex_at(&strand, 1.98f * sampler_1d(&sampler) - 0.99f, 0.5f);
        vec3_t w = warp_sphere(sampler_2d(&sampler)), n = vertex.surface.ng, d;
        float distance = 0.01f + sampler_1d(&sampler);
        vec3_t met = v_mad(vertex_exit(&vertex, w), 2 * RADIUS + distance, w);
        assert_true(vertex_way_to(&vertex, met, &d));
        assert_float_equal(v_length(d), distance, 1e-4f);
        assert_float_equal(v_length(v_sub(v_normalize(d), w)), 0, 1e-3f);
        vec3_t across = v_mad(w, -v_dot(w, n), n), missed = v_add(vertex.surface.p, across);
        missed = v_mad(missed, 0.99f * vertex.surface.offset * (2 * sampler_1d(&sampler) - 1), n);
        assert_false(vertex_way_to(&vertex, missed, &d));
    }
    strand_end(&strand);
}

/* What leaves a hair does not meet it again. */
static void light_leaves_its_fibre(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin(&strand, (blob_material_t){HAIR(0.3f, 0.3f)});
    for (uint32_t i = 0; i < 2000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 5, 0, i);
        vertex_t vertex = vertex_at(&strand, 1.98f * sampler_1d(&sampler) - 0.99f, 0.5f);
        vec3_t w = warp_sphere(sampler_2d(&sampler));
        surface_t again;
        vec3_t from = vertex_exit(&vertex, w);
        assert_false(scene_intersect(strand.scene, from, w, 0, &again));
        assert_false(scene_occluded(strand.scene, from, v_mad(from, 3, w), 0, false));
    }
    strand_end(&strand);
}

/* A hair reflects to the side to which its normal leans. */
static void the_normal_is_between_both_ways(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin(&strand, (blob_material_t){HAIR(0.2f, 0.2f), NUMBER(VALUE_ATTENUATION, 1e3f)});
    for (size_t i = 0; i < ARRAY_LENGTH(offsets); i++) {
        vertex_t vertex = vertex_at(&strand, offsets[i], 0);
        vec3_t mean = vec3(0, 0, 0);
        for (uint32_t k = 0; k < 500; k++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 8, 0, k);
            bsdf_sample_t sample;
            vec2_t u = sampler_2d(&sampler);
            if (vertex_sample(&vertex, u, sampler_1d(&sampler), &sample)) mean = v_add(mean, sample.wi);
        }
        vec3_t half = v_normalize(v_add(v_normalize(mean), vertex.wo));
        assert_float_equal(half.y, -offsets[i], 0.05f); /* the normal of a tube's inside */
        assert_true(offsets[i] == 0 || half.y * vertex.surface.ng.y > 0);
    }
    strand_end(&strand);
}

/* An instance's stretch and turn are those of its hairs. */
static void fibres_of_instances_are_where_they_are_placed(void **state)
{
    (void)state;
    const blob_curve_point_t points[4] = {
        {-1, 0, 0, RADIUS}, {0, 0, 0, RADIUS}, {0, 0, 0, RADIUS}, {1, 0, 0, RADIUS}};
    strand_t strand;
    strand.builder = test_scene_begin(vec3(0, 0, -5), 40, 8);
    blob_builder_t *b = strand.builder.builder;
    uint32_t material = test_scene_material(&strand.builder, (blob_material_t){HAIR(0.3f, 0.3f)});
    test_scene_sphere(&strand.builder, vec3(0, 0, 50), 1, material, vec3(0, 0, 0));
    uint32_t world = blob_builder_count(b, BLOB_SECTION_SHAPES);
    add_fibre(b, CURVES_FIBRE, points, material);
    const xform_t turned = {{{0, -2, 0, 0}, {2, 0, 0, 0}, {0, 0, 2, 0}}}; /* x to y, twice as large */
    const blob_object_t objects[] = {{0, world}, {world, 1}};
    const blob_instance_t instance = {1, turned, turned};
    blob_builder_add(b, BLOB_SECTION_OBJECTS, objects, 2);
    blob_builder_add(b, BLOB_SECTION_INSTANCES, &instance, 1);
    uint64_t size;
    assert_int_equal(blob_builder_finish(b, &strand.builder.bytes, &size).code, RESULT_OK);
    assert_int_equal(blob_open(strand.builder.bytes, size, &strand.builder.blob).code, RESULT_OK);
    assert_int_equal(scene_new(&strand.builder.blob, &strand.scene).code, RESULT_OK);
    surface_t surface;
    assert_true(scene_intersect(strand.scene, vec3(1.6f * RADIUS, 1, -3), vec3(0, 0, 1), 0, &surface));
    assert_true(surface.fibre);
    assert_float_equal(surface.along.y, 1, 1e-6f);
    assert_float_equal(surface.ng.x, -sinf(0.4f * PI_F), 3e-3f);
    assert_float_equal(surface.radius, 2 * RADIUS, 1e-5f);
    strand_end(&strand);
}

/* ---- what it scatters ---------------------------------------------------------------------------------- */

enum { ROWS = 20, COLUMNS = 40, CELLS = ROWS * COLUMNS, FINE = 16, DRAWS = 100000 };

/* Equal solid angles: rows in sin theta, columns in phi. */
static vec3_t fine_direction(const bsdf_t *bsdf, int row, int column)
{
    double sine = -1 + 2 * (row + 0.5) / (ROWS * FINE), cosine = sqrt(1 - sine * sine);
    double phi = -M_PI + 2 * M_PI * (column + 0.5) / (COLUMNS * FINE);
    return bsdf_to_world(bsdf, vec3((float)sine, (float)(cosine * cos(phi)), (float)(cosine * sin(phi))));
}

static size_t cell_of(const bsdf_t *bsdf, vec3_t w)
{
    vec3_t l = bsdf_to_local(bsdf, w);
    int row = (int)(((double)l.x + 1) / 2 * ROWS);
    int column = (int)((atan2((double)l.z, (double)l.y) + M_PI) / (2 * M_PI) * COLUMNS);
    return (size_t)int_min(int_max(row, 0), ROWS - 1) * COLUMNS +
           (size_t)int_min(int_max(column, 0), COLUMNS - 1);
}

typedef struct {
    double cells[CELLS]; /* of the density */
    double density, value;
} integral_t;

static void integrate(const vertex_t *vertex, transport_t mode, integral_t *sum)
{
    const double area = 4 * M_PI / ((double)CELLS * FINE * FINE);
    *sum = (integral_t){.value = 0};
    for (int row = 0; row < ROWS * FINE; row++)
        for (int column = 0; column < COLUMNS * FINE; column++) {
            vec3_t wi = fine_direction(&vertex->bsdf, row, column);
            bsdf_value_t value;
            if (!bsdf_eval(&vertex->bsdf, vertex->wo, wi, mode, &value)) continue;
            sum->cells[(size_t)(row / FINE) * COLUMNS + (size_t)(column / FINE)] += (double)value.pdf * area;
            sum->density += (double)value.pdf * area;
            sum->value += (double)(value.f.y * vertex_cosine(vertex, wi)) * area;
        }
}

static void a_hair_that_absorbs_nothing_gives_everything_back(void **state)
{
    (void)state;
    integral_t *integral = malloc(sizeof *integral);
    for (size_t i = 0; i < ARRAY_LENGTH(roughnesses); i++) {
        strand_t strand;
        strand_begin(&strand, (blob_material_t){HAIR(roughnesses[i], roughnesses[3 - i])});
        for (size_t k = 0; k < ARRAY_LENGTH(offsets); k++)
            for (int slanted = 0; slanted < 2; slanted++) {
                vertex_t vertex = vertex_at(&strand, offsets[k], slanted ? 1.3f : 0);
                integrate(&vertex, TRANSPORT_RADIANCE, integral);
                assert_float_equal(integral->value, 1, 2e-3f);
                assert_float_equal(integral->density, 1, 2e-3f);
            }
        strand_end(&strand);
    }
    free(integral);
}

/* Draws of the hair against the density that it claims; what they are worth against the value. */
static void check_draws(const vertex_t *vertex, transport_t mode, integral_t *integral, double *observed)
{
    double worth = 0, square = 0;
    memset(observed, 0, CELLS * sizeof *observed);
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(&vertex->bsdf, vertex->wo, u, sampler_1d(&sampler), mode, &sample)) continue;
        observed[cell_of(&vertex->bsdf, sample.wi)]++;
        worth += (double)sample.weight.y / DRAWS;
        square += (double)sample.weight.y * (double)sample.weight.y / DRAWS;
    }
    integrate(vertex, mode, integral);
    for (size_t i = 0; i < CELLS; i++) integral->cells[i] *= DRAWS;
    double p = chi_square_p(observed, integral->cells, CELLS, DRAWS);
    if (!(p > 1e-5)) fail_msg("mode %d, h = %g: p = %g", (int)mode, (double)vertex->surface.place.y, p);
    double error = sqrt(fmax(square - worth * worth, 0) / DRAWS);
    assert_true(fabs(worth - integral->value) < 4.5 * error + 2e-3);
}

static void draws_follow_the_density(void **state)
{
    (void)state;
    double *observed = malloc(CELLS * sizeof *observed);
    integral_t *integral = malloc(sizeof *integral);
    for (size_t i = 0; i < ARRAY_LENGTH(roughnesses); i++) {
        strand_t strand;
        strand_begin(&strand, (blob_material_t){HAIR(roughnesses[i], roughnesses[i]),
                                                COLOUR(VALUE_ATTENUATION, 0.1f, 0.3f, 1)});
        for (size_t k = 0; k < ARRAY_LENGTH(offsets); k += 2) {
            vertex_t vertex = vertex_at(&strand, offsets[k], 0.7f);
            check_draws(&vertex, TRANSPORT_RADIANCE, integral, observed);
            check_draws(&vertex, TRANSPORT_IMPORTANCE, integral, observed);
        }
        strand_end(&strand);
    }
    free(integral);
    free(observed);
}

static void assert_near(float a, float b)
{
    if (!(fabsf(a - b) <= 5e-3f * float_max(fabsf(a), fabsf(b)) + 1e-6f))
        fail_msg("%g, but %g", (double)a, (double)b);
}

/* A light subpath sees the light go the way that an eye subpath sees it come, with the densities swapped. */
static void both_ways_are_one(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin(&strand, (blob_material_t){HAIR(0.3f, 0.4f), NUMBER(VALUE_EUMELANIN, 0.5f)});
    for (uint32_t i = 0; i < 4000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, i);
        vertex_t vertex = vertex_at(&strand, 1.9f * sampler_1d(&sampler) - 0.95f, 0.4f);
        vec3_t a = warp_sphere(sampler_2d(&sampler)), b = warp_sphere(sampler_2d(&sampler));
        vec2_t u = sampler_2d(&sampler);
        bsdf_value_t there, back;
        bsdf_sample_t sample;
        bool lit = bsdf_eval(&vertex.bsdf, a, b, TRANSPORT_RADIANCE, &there);
        assert_int_equal(bsdf_eval(&vertex.bsdf, b, a, TRANSPORT_IMPORTANCE, &back), lit);
        if (!lit) continue;
        assert_near(there.f.x, back.f.x);
        assert_near(there.f.z, back.f.z);
        assert_near(there.pdf, back.pdf_rev);
        assert_near(there.pdf_rev, back.pdf);
        transport_t mode = i % 2 ? TRANSPORT_RADIANCE : TRANSPORT_IMPORTANCE;
        if (!bsdf_sample(&vertex.bsdf, a, u, sampler_1d(&sampler), mode, &sample) ||
            fabsf(sample.wi.z) < 0.01f || !bsdf_eval(&vertex.bsdf, a, sample.wi, mode, &there))
            continue;
        assert_near(sample.pdf, there.pdf);
        assert_near(sample.pdf_rev, there.pdf_rev);
        assert_near(sample.weight.y, there.f.y * vertex_cosine(&vertex, sample.wi) / there.pdf);
    }
    strand_end(&strand);
}

/* ---- formulas ------------------------------------------------------------------------------------------ */

/* M_p by the series of I_0, in doubles. */
static double longitudinal(double theta_i, double theta_o, double v)
{
    double a = cos(theta_i) * cos(theta_o) / v, b = sin(theta_i) * sin(theta_o) / v, term = 1, sum = 1;
    for (int k = 1; k < 200; k++) sum += term *= a * a / (4.0 * k * k);
    return exp(-b) * sum / (2 * v * sinh(1 / v));
}

static double azimuthal(double x, double s)
{
    x = remainder(x, 2 * M_PI);
    double e = exp(-fabs(x) / s);
    return e / (s * (1 + e) * (1 + e)) / (1 / (1 + exp(-M_PI / s)) - 1 / (1 + exp(M_PI / s)));
}

/* The value times the cosine: the sum of the four modes, written down once more, for beta_m = 0.4, beta_n =
 * 0.5. */
static double hair_value(double h, double sigma, double theta_o, double theta_i, double phi)
{
    double alpha = 2 * M_PI / 180, eta = 1.55, root = 0.726 * 0.4 + 0.812 * 0.16 + 3.7 * pow(0.4, 20);
    double v[4] = {root * root, root * root / 4, 4 * root * root, 4 * root * root};
    double s = sqrt(M_PI / 8) * (0.265 * 0.5 + 1.194 * 0.25 + 5.372 * pow(0.5, 22));
    double tilt[4] = {-2 * alpha, alpha, 4 * alpha, 0};
    double sine_t = h * cos(theta_o) / sqrt(eta * eta - pow(sin(theta_o), 2)), gamma_t = asin(sine_t);
    double t = exp(-2 * sigma * cos(gamma_t) / sqrt(1 - pow(sin(theta_o) / eta, 2)));
    float cosine_t;
    double f = (double)fresnel_dielectric((float)(cos(theta_o) * sqrt(1 - h * h)), 1.55f, &cosine_t);
    double a[4] = {f, (1 - f) * (1 - f) * t, (1 - f) * (1 - f) * t * t * f, 0}, sum = 0;
    a[3] = a[2] * f * t / (1 - f * t);
    for (int p = 0; p < 4; p++) {
        double n = p == 3 ? 1 / (2 * M_PI) : azimuthal(phi - (2 * p * gamma_t - 2 * asin(h) + p * M_PI), s);
        sum += a[p] * longitudinal(theta_i, theta_o + tilt[p], v[p]) * n;
    }
    return sum;
}

static void values_follow_the_papers(void **state)
{
    (void)state;
    strand_t strand;
    strand_begin(&strand, (blob_material_t){HAIR(0.4f, 0.5f), NUMBER(VALUE_ATTENUATION, 0.25f)});
    for (uint32_t i = 0; i < 500; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 6, 0, i);
        vertex_t vertex = vertex_at(&strand, 1.9f * sampler_1d(&sampler) - 0.95f, 0);
        float h = vertex.surface.place.y;
        vec2_t u = sampler_2d(&sampler);
        double theta_o = 2.4 * (double)u.x - 1.2, theta_i = 2.4 * (double)u.y - 1.2;
        double phi_o = 6.28 * (double)sampler_1d(&sampler), phi_i = 6.28 * (double)sampler_1d(&sampler);
        vec3_t o = vec3((float)sin(theta_o), (float)(cos(theta_o) * cos(phi_o)),
                        (float)(cos(theta_o) * sin(phi_o))),
               w = vec3((float)sin(theta_i), (float)(cos(theta_i) * cos(phi_i)),
                        (float)(cos(theta_i) * sin(phi_i)));
        bsdf_value_t value;
        assert_true(bsdf_eval(&vertex.bsdf, bsdf_to_world(&vertex.bsdf, o), bsdf_to_world(&vertex.bsdf, w),
                              TRANSPORT_RADIANCE, &value));
        assert_near(value.f.x * fabsf(w.z),
                    (float)hair_value((double)h, 0.25, theta_o, theta_i, phi_i - phi_o));
    }
    strand_end(&strand);
}

static rgb_t absorption_of(blob_material_t material)
{
    strand_t strand;
    strand_begin(&strand, material);
    vertex_t vertex = vertex_at(&strand, 0.2f, 0);
    strand_end(&strand);
    return vertex.bsdf.lobes[0].hair.absorption;
}

static void pigments_add_up_and_colours_stand_by_themselves(void **state)
{
    (void)state;
    rgb_t pigments =
        absorption_of((blob_material_t){HAIR(0.3f, 0.3f), COLOUR(VALUE_ATTENUATION, 1, 2, 3),
                                        NUMBER(VALUE_EUMELANIN, 2), NUMBER(VALUE_PHEOMELANIN, 0.5f)});
    assert_float_equal(pigments.x, 1 + 2 * 0.419f + 0.5f * 0.187f, 1e-5f);
    assert_float_equal(pigments.y, 2 + 2 * 0.697f + 0.5f * 0.4f, 1e-5f);
    assert_float_equal(pigments.z, 3 + 2 * 1.37f + 0.5f * 1.05f, 1e-5f);
    rgb_t dyed =
        absorption_of((blob_material_t){HAIR(0.3f, 1), .flags = MATERIAL_DYED,
                                        COLOUR(VALUE_REFLECTANCE, 0.5f, 1, 0), NUMBER(VALUE_EUMELANIN, 2)});
    float scale = 5.969f - 0.215f + 2.532f - 10.73f + 5.574f + 0.245f;
    assert_float_equal(dyed.x, logf(0.5f) / scale * (logf(0.5f) / scale), 1e-5f);
    assert_float_equal(dyed.y, 0, 0);
    assert_true(dyed.z > 100 && isfinite(dyed.z));
}

/* However odd the values, nothing overflows. */
static void odd_hair_stays_finite(void **state)
{
    (void)state;
    static const blob_material_t odd[] = {
        {HAIR(0, 0)},
        {HAIR(7, 9)},
        {HAIR(0.01f, 0.01f), NUMBER(VALUE_ATTENUATION, 1e6f)},
        {.kind = MATERIAL_HAIR, NUMBER(VALUE_ETA, 0), NUMBER(VALUE_TILT, 1e6f)},
        {.kind = MATERIAL_HAIR, NUMBER(VALUE_ETA, 0.5f), NUMBER(VALUE_TILT, -80)},
        {.kind = MATERIAL_HAIR, NUMBER(VALUE_ETA, -3), NUMBER(VALUE_EUMELANIN, -5)},
        {.kind = MATERIAL_HAIR, NUMBER(VALUE_ETA, 1e6f)},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(odd); i++) {
        strand_t strand;
        strand_begin(&strand, odd[i]);
        for (uint32_t k = 0; k < 500; k++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, 0, k);
            vertex_t vertex = vertex_at(&strand, 1.98f * sampler_1d(&sampler) - 0.99f, 0.4f);
            vec3_t wo = k % 50 == 0 ? vertex.surface.along : warp_sphere(sampler_2d(&sampler));
            vec2_t u = sampler_2d(&sampler);
            transport_t mode = k % 2 ? TRANSPORT_RADIANCE : TRANSPORT_IMPORTANCE;
            bsdf_sample_t sample;
            bsdf_value_t value;
            if (bsdf_sample(&vertex.bsdf, wo, u, sampler_1d(&sampler), mode, &sample))
                assert_true(v_is_finite(sample.weight) && v_is_finite(sample.wi) && sample.pdf > 0 &&
                            isfinite(sample.pdf) && isfinite(sample.pdf_rev));
            if (bsdf_eval(&vertex.bsdf, wo, warp_sphere(u), mode, &value))
                assert_true(v_is_finite(value.f) && isfinite(value.pdf) && isfinite(value.pdf_rev));
        }
        strand_end(&strand);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_ray_meets_a_fibre_at_its_offset),
        cmocka_unit_test(a_flat_fibre_faces_the_ray),
        cmocka_unit_test(a_fibre_lights_what_its_rays_meet),
        cmocka_unit_test(light_leaves_its_fibre),
        cmocka_unit_test(the_normal_is_between_both_ways),
        cmocka_unit_test(fibres_of_instances_are_where_they_are_placed),
        cmocka_unit_test(a_hair_that_absorbs_nothing_gives_everything_back),
        cmocka_unit_test(draws_follow_the_density),
        cmocka_unit_test(both_ways_are_one),
        cmocka_unit_test(values_follow_the_papers),
        cmocka_unit_test(pigments_add_up_and_colours_stand_by_themselves),
        cmocka_unit_test(odd_hair_stays_finite),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
