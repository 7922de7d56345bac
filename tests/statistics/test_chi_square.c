/* Every sampling routine against the density that it claims: BSDFs, lights, camera, filter, warps. The random
 * numbers are fixed, so a result is pass or fail for good; the level is chosen so that a right routine fails
 * by chance in one build of a thousand. */
#include "common/sampler.h"
#include "tests/chi_square.h"
#include "worker/render/alias.h"
#include "worker/render/bsdf.h"
#include "worker/render/camera.h"
#include "worker/render/filter.h"
#include "worker/render/light.h"
#include "worker/render/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const double level = 1e-5;
enum { DRAWS = 400000, ROWS = 20, COLUMNS = 40, CELLS = ROWS * COLUMNS, FINE = 16 };

/* ---- directions ---------------------------------------------------------------------------------------- */

/* Equal solid angles: rows in cos theta, columns in phi. */
static size_t direction_cell(vec3_t w)
{
    double phi = atan2((double)w.y, (double)w.x);
    int row = (int)(((double)w.z + 1) / 2 * ROWS), column = (int)((phi + M_PI) / (2 * M_PI) * COLUMNS);
    return (size_t)int_min(int_max(row, 0), ROWS - 1) * COLUMNS +
           (size_t)int_min(int_max(column, 0), COLUMNS - 1);
}

/* Expected draws in each cell for a density per steradian, by the midpoint rule on FINE x FINE points a cell.
 */
static void integrate_directions(float (*density)(const void *, vec3_t), const void *what, double *expected)
{
    memset(expected, 0, CELLS * sizeof *expected);
    double area = 4 * M_PI / ((double)CELLS * FINE * FINE);
    for (int row = 0; row < ROWS * FINE; row++)
        for (int column = 0; column < COLUMNS * FINE; column++) {
            double z = -1 + 2 * (row + 0.5) / (ROWS * FINE), r = sqrt(1 - z * z);
            double phi = -M_PI + 2 * M_PI * (column + 0.5) / (COLUMNS * FINE);
            vec3_t w = vec3((float)(r * cos(phi)), (float)(r * sin(phi)), (float)z);
            expected[(size_t)(row / FINE) * COLUMNS + (size_t)(column / FINE)] +=
                (double)density(what, w) * area * DRAWS;
        }
}

typedef struct {
    bsdf_t bsdf;
    vec3_t wo;
} scattering_t;

static float bsdf_density(const void *what, vec3_t wi)
{
    const scattering_t *s = what;
    bsdf_value_t value;
    return bsdf_eval(&s->bsdf, s->wo, wi, TRANSPORT_RADIANCE, &value) ? value.pdf : 0;
}

static scattering_t scattering(const blob_material_t *material, vec3_t normal, vec3_t wo)
{
    surface_t surface = {.ng = normal, .ns = normal, .tangent = vec3(0.3f, 0.9f, 0.1f), .material = material};
    scattering_t s = {.wo = v_normalize(wo)};
    bsdf_init(&s.bsdf, &surface);
    return s;
}

static void check_bsdf(const blob_material_t *material, vec3_t normal, vec3_t wo)
{
    scattering_t s = scattering(material, normal, wo);
    double *observed = calloc(CELLS, sizeof *observed), *expected = calloc(CELLS, sizeof *expected);
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(&s.bsdf, s.wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &sample)) continue;
        observed[direction_cell(sample.wi)]++;
    }
    integrate_directions(bsdf_density, &s, expected);
    double p = chi_square_p(observed, expected, CELLS, DRAWS);
    free(observed);
    free(expected);
    if (!(p > level)) fail_msg("p = %g for wo = %g %g %g", p, (double)s.wo.x, (double)s.wo.y, (double)s.wo.z);
}

static const blob_material_t diffuse = {.kind = MATERIAL_DIFFUSE, .reflectance = {0.5f, 0.6f, 0.7f}};

static blob_material_t metal(float alpha_u, float alpha_v)
{
    return (blob_material_t){.kind = MATERIAL_CONDUCTOR,
                             .eta = {0.2f, 0.924f, 1.102f},
                             .k = {3.912f, 2.452f, 2.142f},
                             .alpha_u = alpha_u,
                             .alpha_v = alpha_v};
}

static const vec3_t outgoing[] = {{0.1f, 0.2f, 0.9f}, {0.9f, -0.3f, 0.2f}, {-0.7f, 0.1f, -0.5f}, {0, 0, 1}};

static void diffuse_draws_its_density(void **state)
{
    (void)state;
    for (size_t i = 0; i < ARRAY_LENGTH(outgoing); i++) {
        check_bsdf(&diffuse, vec3(0, 0, 1), outgoing[i]);
        check_bsdf(&diffuse, v_normalize(vec3(1, -2, 0.5f)), outgoing[i]);
    }
}

static void conductor_draws_its_density(void **state)
{
    (void)state;
    const float alphas[][2] = {{0.5f, 0.5f}, {0.2f, 0.2f}, {0.4f, 0.15f}, {1, 1}};
    for (size_t a = 0; a < ARRAY_LENGTH(alphas); a++)
        for (size_t i = 0; i < ARRAY_LENGTH(outgoing); i++) {
            blob_material_t material = metal(alphas[a][0], alphas[a][1]);
            check_bsdf(&material, vec3(0, 0, 1), outgoing[i]);
            check_bsdf(&material, v_normalize(vec3(0.2f, 0.3f, -1)), outgoing[i]);
        }
}

/* What a sample says of itself must be what evaluation says of its direction, both ways. */
static void samples_agree_with_evaluation(void **state)
{
    (void)state;
    const blob_material_t materials[] = {diffuse, metal(0.3f, 0.3f), metal(0.1f, 0.4f)};
    for (size_t m = 0; m < ARRAY_LENGTH(materials); m++)
        for (uint32_t i = 0; i < 2000; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 2, (uint32_t)m, i);
            scattering_t s = scattering(&materials[m], vec3(0, 0, 1), warp_sphere(sampler_2d(&sampler)));
            bsdf_sample_t sample;
            bsdf_value_t there, back;
            vec2_t u = sampler_2d(&sampler);
            if (!bsdf_sample(&s.bsdf, s.wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &sample)) continue;
            assert_false(sample.specular);
            assert_true(bsdf_eval(&s.bsdf, s.wo, sample.wi, TRANSPORT_RADIANCE, &there));
            assert_true(bsdf_eval(&s.bsdf, sample.wi, s.wo, TRANSPORT_IMPORTANCE, &back));
            float cos = fabsf(sample.wi.z);
            assert_float_equal(sample.pdf / there.pdf, 1, 2e-3f);
            assert_float_equal(sample.pdf_rev / there.pdf_rev, 1, 2e-3f);
            assert_float_equal(there.pdf_rev / back.pdf, 1, 2e-3f);
            assert_float_equal(sample.weight.x * sample.pdf / (there.f.x * cos), 1, 2e-3f);
        }
}

/* ---- lights -------------------------------------------------------------------------------------------- */

typedef struct {
    uint8_t *bytes;
    scene_blob_t blob;
} fixture_t;

/* A mesh of two unlike triangles, and an ellipsoid. Both emit. */
static fixture_t lights_fixture(void)
{
    blob_builder_t *b = blob_builder_new();
    blob_scene_t scene = {.world_from_camera = xform_identity(),
                          .fov = 40,
                          .width = 64,
                          .height = 48,
                          .filter = {.kind = FILTER_BOX, .radius_x = 0.5f, .radius_y = 0.5f},
                          .max_depth = 5,
                          .spp = 1,
                          .integrator = INTEGRATOR_BDPT,
                          .sampler = SAMPLER_SOBOL};
    const vec3_t positions[] = {{0, 0, 5}, {3, 0, 5}, {0, 1, 5}, {3, 4, 6}};
    const blob_triangle_t triangles[] = {{{0, 1, 2}}, {{1, 3, 2}}};
    blob_builder_add(b, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(b, BLOB_SECTION_POSITIONS, positions, 4);
    blob_builder_add(b, BLOB_SECTION_TRIANGLES, triangles, 2);
    blob_builder_add(
        b, BLOB_SECTION_MESHES,
        &(blob_mesh_t){
            .vertex_count = 4, .first_normal = BLOB_NONE, .first_uv = BLOB_NONE, .triangle_count = 2},
        1);
    xform_t stretch = {{{1, 0.3f, 0, -4}, {0, 2, 0, 1}, {0, 0.2f, 0.5f, 7}}};
    blob_builder_add(b, BLOB_SECTION_SPHERES, &(blob_sphere_t){stretch, 0.8f}, 1);
    blob_builder_add(b, BLOB_SECTION_MATERIALS, &(blob_material_t){.kind = MATERIAL_DIFFUSE}, 1);
    blob_builder_add(b, BLOB_SECTION_SHAPES, &(blob_shape_t){.kind = SHAPE_MESH, .light = 0}, 1);
    blob_builder_add(b, BLOB_SECTION_SHAPES, &(blob_shape_t){.kind = SHAPE_SPHERE, .light = 1}, 1);
    blob_builder_add(b, BLOB_SECTION_LIGHTS, &(blob_light_t){.radiance = {1, 2, 3}, .shape = 0}, 1);
    blob_builder_add(b, BLOB_SECTION_LIGHTS,
                     &(blob_light_t){.radiance = {0, 4, 1}, .shape = 1, .flags = LIGHT_TWO_SIDED}, 1);
    blob_builder_add(b, BLOB_SECTION_OBJECTS, &(blob_object_t){0, 2}, 1);
    fixture_t fixture = {0};
    uint64_t size;
    result_t made = blob_builder_finish(b, &fixture.bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(fixture.bytes, size, &fixture.blob).code, RESULT_OK);
    blob_builder_destroy(&b);
    return fixture;
}

/* Cells: the two triangles, then the ellipsoid's surface by the direction in its own space. */
static void lights_draw_by_power_and_area(void **state)
{
    (void)state;
    fixture_t fixture = lights_fixture();
    lights_t *lights = lights_new(&fixture.blob);
    double *observed = calloc(CELLS + 2, sizeof *observed), *expected = calloc(CELLS + 2, sizeof *expected);
    const blob_sphere_t *sphere = &fixture.blob.spheres[0];
    xform_t inverse;
    assert_true(xform_invert(&sphere->object_from_sphere, &inverse));
    float mesh_pdf = 0;
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
        float choice = sampler_1d(&sampler);
        light_point_t point;
        lights_sample(lights, choice, sampler_2d(&sampler), &point);
        vec3_t local = xform_point(&inverse, point.p);
        if (point.two_sided) {
            observed[2 + direction_cell(v_normalize(local))]++;
            continue;
        }
        mesh_pdf = point.pdf_area;
        observed[point.p.z > 5.00001f || point.p.x / 3 + point.p.y > 1.00001f]++;
    }
    expected[0] = DRAWS * (double)mesh_pdf * 1.5;
    vec3_t e1 = vec3(0, 4, 1), e2 = vec3(-3, 1, 0);
    expected[1] = DRAWS * (double)mesh_pdf * 0.5 * (double)v_length(v_cross(e1, e2));
    /* Density per area times area, the area of a patch from finite differences. */
    double step = 1e-3, cell = 4 * M_PI / CELLS;
    for (int k = 0; k < CELLS * 64; k++) {
        int c = k / 64;
        double z = -1 + 2 * (c / COLUMNS + (k % 64 / 8 + 0.5) / 8) / ROWS;
        double phi = -M_PI + 2 * M_PI * (c % COLUMNS + (k % 8 + 0.5) / 8) / COLUMNS, r = sqrt(1 - z * z);
        vec3_t n = vec3((float)(r * cos(phi)), (float)(r * sin(phi)), (float)z), s, t;
        v_frame(n, &s, &t);
        vec3_t ds = xform_vector(&sphere->object_from_sphere, v_scale(s, (float)step));
        vec3_t dt = xform_vector(&sphere->object_from_sphere, v_scale(t, (float)step));
        double stretch = (double)v_length(v_cross(ds, dt)) / (step * step), radius = (double)sphere->radius;
        surface_t surface = {.p = xform_point(&sphere->object_from_sphere, v_scale(n, sphere->radius)),
                             .light = 1};
        light_point_t point;
        lights_at(lights, &surface, &point);
        expected[2 + c] += DRAWS * (double)point.pdf_area * stretch * radius * radius * cell / 64;
    }
    double p = chi_square_p(observed, expected, CELLS + 2, DRAWS);
    if (!(p > level))
        fail_msg("p = %g, triangles %g of %g and %g of %g", p, observed[0], expected[0], observed[1],
                 expected[1]);
    free(observed);
    free(expected);
    lights_destroy(&lights);
    free(fixture.bytes);
}

static float emission_density(const void *what, vec3_t w)
{
    return light_direction_pdf(what, w);
}

static void lights_emit_by_cosine(void **state)
{
    (void)state;
    for (int sides = 1; sides <= 2; sides++) {
        light_point_t point = {.n = v_normalize(vec3(0.3f, -1, 0.4f)), .two_sided = sides == 2};
        double *observed = calloc(CELLS, sizeof *observed), *expected = calloc(CELLS, sizeof *expected);
        for (uint32_t i = 0; i < DRAWS; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, i);
            observed[direction_cell(light_sample_direction(&point, sampler_2d(&sampler)))]++;
        }
        integrate_directions(emission_density, &point, expected);
        assert_true(chi_square_p(observed, expected, CELLS, DRAWS) > level);
        free(observed);
        free(expected);
    }
}

static void alias_follows_weights(void **state)
{
    (void)state;
    const double weights[] = {3, 0, 1e-3, 7, 2, 0, 5, 0.5, 0};
    enum { N = sizeof weights / sizeof *weights };
    double observed[N] = {0}, expected[N];
    alias_t alias;
    alias_init(&alias, weights, N);
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 5, 0, i);
        float u = sampler_1d(&sampler);
        observed[alias_sample(&alias, &u)]++;
        assert_true(u >= 0 && u < 1);
    }
    for (size_t i = 0; i < N; i++) {
        expected[i] = weights[i] / alias.total * DRAWS;
        if (weights[i] == 0) assert_true(observed[i] == 0);
    }
    alias_free(&alias);
    assert_true(chi_square_p(observed, expected, N, DRAWS) > level);
    const double nothing[] = {0, 0};
    alias_init(&alias, nothing, 2);
    assert_int_equal(alias.count, 0);
}

/* ---- camera and filter --------------------------------------------------------------------------------- */

static camera_t test_camera(void)
{
    blob_scene_t scene = {.world_from_camera = {{{-1, 0, 0, 2}, {0, 0.8f, -0.6f, 1}, {0, 0.6f, 0.8f, -3}}},
                          .fov = 75};
    camera_t camera;
    camera_init(&camera, &scene, 64, 40);
    return camera;
}

static float camera_density(const void *what, vec3_t w)
{
    const camera_t *camera = what;
    camera_view_t view;
    return camera_project(camera, v_mad(camera->position, 3, w), 0, &view) ? view.pdf : 0;
}

static void camera_draws_its_density(void **state)
{
    (void)state;
    camera_t camera = test_camera();
    double *observed = calloc(CELLS, sizeof *observed), *expected = calloc(CELLS, sizeof *expected);
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 6, 0, i);
        vec2_t u = sampler_2d(&sampler);
        float pdf;
        vec3_t w = camera_ray(&camera, (vec2_t){u.x * 64, u.y * 40}, &pdf);
        observed[direction_cell(w)]++;
        camera_view_t view;
        assert_true(camera_project(&camera, v_mad(camera.position, 7, w), 1e-2f, &view));
        assert_float_equal(view.raster.x, u.x * 64, 1e-3f);
        assert_float_equal(view.raster.y, u.y * 40, 1e-3f);
        assert_float_equal(view.pdf / pdf, 1, 1e-4f);
        assert_float_equal(view.distance, 7, 1e-4f);
    }
    integrate_directions(camera_density, &camera, expected);
    double total = 0;
    for (size_t i = 0; i < CELLS; i++) total += expected[i];
    assert_float_equal((float)(total / DRAWS), 1, 5e-3f); /* importance is normalised over the film */
    /* The film's edge cuts through cells, where the midpoint rule is coarse: these are left out. */
    size_t whole = 0;
    for (size_t i = 0; i < CELLS; i++) {
        bool inside = i % COLUMNS > 0 && i % COLUMNS < COLUMNS - 1 && i >= COLUMNS && i + COLUMNS < CELLS &&
                      expected[i - 1] > 0 && expected[i + 1] > 0 && expected[i - COLUMNS] > 0 &&
                      expected[i + COLUMNS] > 0;
        if (inside) observed[whole] = observed[i], expected[whole++] = expected[i];
    }
    assert_true(whole > 50);
    assert_true(chi_square_p(observed, expected, whole, DRAWS) > level);
    free(observed);
    free(expected);
}

static void check_filter(blob_filter_t kind)
{
    filter_t *filter = malloc(sizeof *filter);
    filter_init(filter, &kind);
    enum { BINS = 64 };
    double observed[BINS] = {0}, expected[BINS], width = 2.0 * (double)kind.radius_x / BINS;
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, 0, i);
        float x = filter_sample(&filter->x, sampler_1d(&sampler));
        assert_true(fabsf(x) <= kind.radius_x);
        observed[int_min((int)(((double)x + (double)kind.radius_x) / width), BINS - 1)]++;
    }
    for (int i = 0; i < BINS; i++) {
        expected[i] = 0;
        for (int k = 0; k < 16; k++)
            expected[i] +=
                (double)filter_density(&filter->x, (float)((i + (k + 0.5) / 16) * width) - kind.radius_x) *
                width / 16 * DRAWS;
    }
    double p = chi_square_p(observed, expected, BINS, DRAWS);
    if (!(p > level)) fail_msg("filter %u: p = %g", kind.kind, p);

    /* A splat gives each pixel in reach, on average, the filter's density there. */
    double given[64] = {0};
    const float position = 20.3f;
    enum { SPLATS = 200000 };
    for (uint32_t i = 0; i < SPLATS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 8, 0, i);
        float weight;
        int pixel = filter_choose_pixel(&filter->x, position, sampler_1d(&sampler), &weight);
        assert_in_range(pixel, 0, 63);
        given[pixel] += (double)weight / SPLATS;
    }
    for (int i = 0; i < 64; i++)
        assert_true(fabs(given[i] - (double)filter_density(&filter->x, position - ((float)i + 0.5f))) < 0.01);
    free(filter);
}

static void filters_draw_their_density(void **state)
{
    (void)state;
    check_filter((blob_filter_t){.kind = FILTER_BOX, .radius_x = 0.5f, .radius_y = 0.5f});
    check_filter((blob_filter_t){.kind = FILTER_BOX, .radius_x = 1.7f, .radius_y = 0.5f});
    check_filter((blob_filter_t){.kind = FILTER_TRIANGLE, .radius_x = 2, .radius_y = 2});
    check_filter(
        (blob_filter_t){.kind = FILTER_GAUSSIAN, .radius_x = 1.5f, .radius_y = 1.5f, .gaussian_sigma = 0.5f});
}

/* ---- warps and numbers --------------------------------------------------------------------------------- */

static void triangle_warp_is_uniform(void **state)
{
    (void)state;
    enum { N = 16 };
    double observed[N * N] = {0}, expected[N * N] = {0};
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 9, 0, i);
        vec2_t b = warp_triangle(sampler_2d(&sampler));
        assert_true(b.x >= 0 && b.y >= 0 && b.x + b.y <= 1.0001f);
        observed[int_min((int)(b.x * N), N - 1) * N + int_min((int)(b.y * N), N - 1)]++;
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; i + j < N; j++) expected[i * N + j] = (i + j < N - 1 ? 2.0 : 1.0) / (N * N) * DRAWS;
    assert_true(chi_square_p(observed, expected, (size_t)N * N, DRAWS) > level);
}

/* Owen scrambling keeps the Sobol' points a (0, m, 2)-net: one point in each elementary interval. */
static void sobol_points_are_nets(void **state)
{
    (void)state;
    for (uint32_t dimension = 0; dimension < 12; dimension++)
        for (int m = 2; m <= 8; m++)
            for (int a = 0; a <= m; a++) {
                bool seen[256] = {false};
                for (uint32_t i = 0; i < 1u << m; i++) {
                    sampler_t sampler = sampler_new(SAMPLER_SOBOL, 10, 5, 2 * i + (dimension & 1));
                    sampler.dimension = dimension;
                    vec2_t u = sampler_2d(&sampler);
                    int cell = (int)(u.x * (float)(1 << a)) << (m - a) | (int)(u.y * (float)(1 << (m - a)));
                    assert_false(seen[cell]);
                    seen[cell] = true;
                }
            }
}

/* Both samplers, over pixels: pairs of consecutive calls fill the square evenly. */
static void numbers_are_uniform_and_independent(void **state)
{
    (void)state;
    enum { N = 32 };
    for (sampler_kind_t kind = SAMPLER_SOBOL; kind <= SAMPLER_INDEPENDENT; kind++) {
        double xy[N * N] = {0}, xx[N * N] = {0}, expected[N * N];
        for (uint32_t i = 0; i < DRAWS; i++) {
            sampler_t sampler = sampler_new(kind, 11, i, 3);
            vec2_t u = sampler_2d(&sampler), v = sampler_2d(&sampler);
            xy[(int)(u.x * N) * N + (int)(u.y * N)]++;
            xx[(int)(u.x * N) * N + (int)(v.x * N)]++;
        }
        for (size_t i = 0; i < (size_t)N * N; i++) expected[i] = (double)DRAWS / (N * N);
        assert_true(chi_square_p(xy, expected, (size_t)N * N, DRAWS) > level);
        assert_true(chi_square_p(xx, expected, (size_t)N * N, DRAWS) > level);
    }
}

/* The test itself must tell a wrong density from a right one. */
static void the_test_can_fail(void **state)
{
    (void)state;
    double observed[] = {1000, 1000, 1000, 1000}, expected[] = {1150, 950, 950, 950};
    assert_true(chi_square_p(observed, observed, 4, 4000) > 0.99);
    assert_true(chi_square_p(observed, expected, 4, 4000) < level);
    assert_true(fabs(chi_square_tail(3.841, 1) - 0.05) < 1e-3);
    assert_true(fabs(chi_square_tail(124.342, 100) - 0.05) < 1e-3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_test_can_fail),
        cmocka_unit_test(diffuse_draws_its_density),
        cmocka_unit_test(conductor_draws_its_density),
        cmocka_unit_test(samples_agree_with_evaluation),
        cmocka_unit_test(lights_draw_by_power_and_area),
        cmocka_unit_test(lights_emit_by_cosine),
        cmocka_unit_test(alias_follows_weights),
        cmocka_unit_test(camera_draws_its_density),
        cmocka_unit_test(filters_draw_their_density),
        cmocka_unit_test(triangle_warp_is_uniform),
        cmocka_unit_test(sobol_points_are_nets),
        cmocka_unit_test(numbers_are_uniform_and_independent),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
