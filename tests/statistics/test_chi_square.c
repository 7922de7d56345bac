/* Every sampling routine against the density that it claims: lights, camera, filter, warps (BSDFs have
 * test_bsdf.c). The random
 * numbers are fixed, so a result is pass or fail for good; the level is chosen so that a right routine fails
 * by chance in one build of a thousand. */
#include "common/sampler.h"
#include "common/scene/blob_builder.h"
#include "tests/chi_square.h"
#include "worker/render/camera/camera.h"
#include "worker/render/camera/filter.h"
#include "worker/render/light/light.h"
#include "worker/render/sampling/alias.h"
#include "worker/render/sampling/warp.h"

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

/* ---- lights -------------------------------------------------------------------------------------------- */

typedef struct {
    uint8_t *bytes;
    scene_blob_t blob;
    scene_t *scene;
    lights_t *lights;
} fixture_t;

static const xform_t stretch = {{{1, 0.3f, 0, -4}, {0, 2, 0, 1}, {0, 0.2f, 0.5f, 7}}};
static const float sphere_radius = 0.8f;

static void add_light(blob_builder_t *b, uint32_t shape_kind, rgb_t radiance, uint32_t flags)
{
    uint32_t index = blob_builder_count(b, BLOB_SECTION_SHAPES);
    blob_builder_add(
        b, BLOB_SECTION_SHAPES,
        &(blob_shape_t){
            .kind = shape_kind, .light = index, .alpha = blob_constant(1), .shadow_alpha = blob_constant(1)},
        1);
    blob_builder_add(b, BLOB_SECTION_LIGHTS,
                     &(blob_light_t){.kind = LIGHT_AREA,
                                     .radiance = blob_colour_value(radiance),
                                     .shape = index,
                                     .flags = flags,
                                     .world_from_light = xform_identity()},
                     1);
}

static blob_scene_t scene_record(xform_t world_from_camera, float fov)
{
    blob_scene_t scene = blob_default_scene();
    scene.world_from_camera = scene.world_from_camera_end = world_from_camera;
    scene.fov = fov;
    scene.width = 64;
    scene.height = 48;
    return scene;
}

/* A mesh of two unlike triangles, and an ellipsoid that emits to both sides. */
static fixture_t lights_fixture(void)
{
    blob_builder_t *b = blob_builder_new();
    blob_scene_t scene = scene_record(xform_identity(), 40);
    const vec3_t positions[] = {{0, 0, 5}, {3, 0, 5}, {0, 1, 5}, {3, 4, 6}};
    const blob_triangle_t triangles[] = {{{0, 1, 2}}, {{1, 3, 2}}};
    blob_builder_add(b, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(b, BLOB_SECTION_POSITIONS, positions, 4);
    blob_builder_add(b, BLOB_SECTION_TRIANGLES, triangles, 2);
    blob_builder_add(b, BLOB_SECTION_MESHES,
                     &(blob_mesh_t){.vertex_count = 4,
                                    .first_normal = BLOB_NONE,
                                    .first_uv = BLOB_NONE,
                                    .first_uv2 = BLOB_NONE,
                                    .first_colour = BLOB_NONE,
                                    .triangle_count = 2},
                     1);
    blob_builder_add(b, BLOB_SECTION_QUADRICS,
                     &(blob_quadric_t){.kind = QUADRIC_SPHERE,
                                       .object_from_quadric = stretch,
                                       .radius = sphere_radius,
                                       .z_min = -sphere_radius,
                                       .z_max = sphere_radius,
                                       .phi_max = TWO_PI_F},
                     1);
    blob_builder_add(b, BLOB_SECTION_MATERIALS, &(blob_material_t){.kind = MATERIAL_DIFFUSE}, 1);
    add_light(b, SHAPE_MESH, vec3(1, 2, 3), 0);
    add_light(b, SHAPE_QUADRIC, vec3(0, 4, 1), LIGHT_TWO_SIDED);
    blob_builder_add(b, BLOB_SECTION_OBJECTS, &(blob_object_t){0, 2}, 1);
    fixture_t fixture = {0};
    uint64_t size;
    result_t made = blob_builder_finish(b, &fixture.bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(fixture.bytes, size, &fixture.blob).code, RESULT_OK);
    blob_builder_destroy(&b);
    return fixture;
}

static void fixture_begin(fixture_t *fixture)
{
    *fixture = lights_fixture();
    assert_int_equal(scene_new(&fixture->blob, &fixture->scene).code, RESULT_OK);
    fixture->lights = lights_new(fixture->scene);
}

static void fixture_end(fixture_t *fixture)
{
    lights_destroy(&fixture->lights);
    scene_destroy(&fixture->scene);
    free(fixture->bytes);
}

static bool is_on_ellipsoid(vec3_t p)
{
    return p.x < -1;
}

/* A place on one of the lights; of the mesh any will do. */
static surface_t place_on(const fixture_t *fixture, vec3_t p, vec3_t n)
{
    uint32_t index = is_on_ellipsoid(p);
    return (surface_t){.p = p,
                       .ng = n,
                       .ns = n,
                       .shape = &fixture->blob.shapes[index],
                       .light = index,
                       .instance = BLOB_NONE};
}

/* Cells: the two triangles, then the ellipsoid's surface by the direction in its own space. */
static void lights_draw_by_power_and_area(void **state)
{
    (void)state;
    fixture_t fixture;
    fixture_begin(&fixture);
    double *observed = calloc(CELLS + 2, sizeof *observed), *expected = calloc(CELLS + 2, sizeof *expected);
    xform_t inverse;
    assert_true(xform_invert(&stretch, &inverse));
    float mesh_pdf = 0;
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
        float choice = sampler_1d(&sampler);
        vec2_t place = sampler_2d(&sampler);
        light_ray_t ray;
        if (!lights_emit(fixture.lights, choice, place, sampler_2d(&sampler), &ray)) continue;
        if (is_on_ellipsoid(ray.point)) {
            observed[2 + direction_cell(v_normalize(xform_point(&inverse, ray.point)))]++;
            continue;
        }
        mesh_pdf = ray.pdf_place;
        observed[ray.point.z > 5.00001f || ray.point.x / 3 + ray.point.y > 1.00001f]++;
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
        vec3_t ds = xform_vector(&stretch, v_scale(s, (float)step));
        vec3_t dt = xform_vector(&stretch, v_scale(t, (float)step));
        double area = (double)v_length(v_cross(ds, dt)) / (step * step), radius = (double)sphere_radius;
        surface_t surface =
            place_on(&fixture, xform_point(&stretch, v_scale(n, sphere_radius)), vec3(0, 0, 1));
        light_hit_t hit;
        assert_true(lights_hit(fixture.lights, vec3(0, 0, 0), &surface, vec3(0, 0, 1), &hit));
        expected[2 + c] += DRAWS * (double)hit.pdf_place * area * radius * radius * cell / 64;
    }
    double p = chi_square_p(observed, expected, CELLS + 2, DRAWS);
    if (!(p > level))
        fail_msg("p = %g, triangles %g of %g and %g of %g", p, observed[0], expected[0], observed[1],
                 expected[1]);
    free(observed);
    free(expected);
    fixture_end(&fixture);
}

typedef struct {
    const lights_t *lights;
    surface_t surface;
} emitting_t;

static float emission_density(const void *what, vec3_t w)
{
    const emitting_t *emitting = what;
    light_hit_t hit;
    return lights_hit(emitting->lights, vec3(0, 0, 0), &emitting->surface, w, &hit) ? hit.pdf_ray : 0;
}

/* One place of each light over and over. */
static void lights_emit_by_cosine(void **state)
{
    (void)state;
    fixture_t fixture;
    fixture_begin(&fixture);
    for (int light = 0; light < 2; light++) {
        double *observed = calloc(CELLS, sizeof *observed), *expected = calloc(CELLS, sizeof *expected);
        emitting_t emitting = {.lights = fixture.lights};
        light_ray_t ray;
        float choice = 0; /* finds the light */
        while (!lights_emit(fixture.lights, choice, (vec2_t){0.3f, 0.4f}, (vec2_t){0.3f, 0.4f}, &ray) ||
               is_on_ellipsoid(ray.point) != (light == 1))
            choice += 0.01f;
        for (uint32_t i = 0; i < DRAWS; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, i);
            vec2_t u = sampler_2d(&sampler);
            if (!lights_emit(fixture.lights, choice, (vec2_t){0.3f, 0.4f}, u, &ray)) continue;
            observed[direction_cell(ray.direction)]++;
        }
        /* Rays start off the surface, along its normal. */
        emitting.surface = place_on(&fixture, ray.point, v_normalize(v_sub(ray.origin, ray.point)));
        integrate_directions(emission_density, &emitting, expected);
        double p = chi_square_p(observed, expected, CELLS, DRAWS);
        if (!(p > level)) fail_msg("light %d: p = %g", light, p);
        free(observed);
        free(expected);
    }
    fixture_end(&fixture);
}

/* The three ways to reach a place say the same of it. */
static void ways_to_a_light_agree(void **state)
{
    (void)state;
    fixture_t fixture;
    fixture_begin(&fixture);
    const vec3_t point = {-1, 0.5f, 9};
    int seen[2] = {0, 0};
    for (uint32_t i = 0; i < 2000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 12, 0, i);
        float choice = sampler_1d(&sampler);
        vec2_t place = sampler_2d(&sampler);
        light_view_t view;
        light_ray_t ray;
        light_hit_t hit;
        if (!lights_illuminate(fixture.lights, point, choice, place, &view)) continue;
        assert_true(lights_emit(fixture.lights, choice, place, sampler_2d(&sampler), &ray));
        vec3_t n = v_normalize(v_sub(ray.origin, ray.point)), d = v_sub(ray.point, point);
        if (!is_on_ellipsoid(ray.point) && v_dot(n, ray.direction) < 0) n = v_neg(n);
        surface_t surface = place_on(&fixture, ray.point, n);
        assert_true(lights_hit(fixture.lights, vec3(0, 0, 0), &surface, v_neg(view.w), &hit));
        float distance2 = v_length2(d);
        assert_float_equal(v_dot(view.w, d) / sqrtf(distance2), 1, 1e-5f);
        assert_float_equal(view.pdf_place / ray.pdf_place, 1, 1e-4f);
        assert_float_equal(hit.pdf_place / ray.pdf_place, 1, 1e-3f);
        assert_float_equal(view.geometry * distance2, fabsf(v_dot(n, view.w)), 2e-2f);
        assert_float_equal(view.arrival * distance2, hit.pdf_ray, 2e-2f);
        assert_float_equal(view.radiance.y, hit.radiance.y, 0);
        assert_float_equal(ray.throughput.y * ray.pdf_place * ray.pdf_ray / ray.cosine, hit.radiance.y,
                           1e-3f);
        seen[is_on_ellipsoid(ray.point)]++;
    }
    assert_true(seen[0] > 100 && seen[1] > 100);
    fixture_end(&fixture);
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

static const vec3_t eye = {2, 1, -3};

static float camera_density(const void *what, vec3_t w)
{
    camera_view_t view;
    return camera_project(what, v_mad(eye, 3, w), (vec2_t){0, 0}, 0, 0, &view) ? 9 * view.density : 0;
}

static void camera_draws_its_density(void **state)
{
    (void)state;
    blob_scene_t record =
        scene_record((xform_t){{{-1, 0, 0, 2}, {0, 0.8f, -0.6f, 1}, {0, 0.6f, 0.8f, -3}}}, 75);
    camera_t *camera = camera_new(&(scene_blob_t){.scene = &record}, 64, 40);
    double *observed = calloc(CELLS, sizeof *observed), *expected = calloc(CELLS, sizeof *expected);
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 6, 0, i);
        vec2_t u = sampler_2d(&sampler), lens = {0.5f, 0.5f};
        camera_ray_t ray;
        camera_ray(camera, (vec2_t){u.x * 64, u.y * 40}, lens, 0, &ray);
        observed[direction_cell(ray.direction)]++;
        camera_view_t view;
        assert_true(camera_project(camera, v_mad(eye, 7, ray.direction), lens, 0, 1e-2f, &view));
        assert_float_equal(view.raster.x, u.x * 64, 1e-3f);
        assert_float_equal(view.raster.y, u.y * 40, 1e-3f);
        assert_float_equal(49 * view.density / ray.pdf, 1, 1e-4f);
        assert_float_equal(v_dot(view.w, ray.direction), -1, 1e-5f);
        assert_false(ray.parallel);
    }
    integrate_directions(camera_density, camera, expected);
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
    free(camera);
}

/* Draws count by their weight, which may be negative: their mean over each bin is the filter's integral. */
static void check_filter(blob_filter_t kind)
{
    filter_t *filter = malloc(sizeof *filter);
    filter_init(filter, &kind);
    enum { BINS = 64 };
    double observed[BINS] = {0}, expected[BINS], truth[BINS] = {0}, given_to[BINS] = {0}, total = 0;
    double width = 2.0 * (double)kind.radius_x / BINS;
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, 0, i);
        float weight, x = filter_sample(&filter->x, sampler_1d(&sampler), &weight);
        assert_true(fabsf(x) <= kind.radius_x);
        int bin = int_min((int)(((double)x + (double)kind.radius_x) / width), BINS - 1);
        observed[bin]++;
        given_to[bin] += (double)weight / DRAWS;
    }
    double absolute = 0;
    for (int i = 0; i < BINS; i++) {
        expected[i] = 0;
        for (int k = 0; k < 256; k++) {
            double value =
                (double)filter_value(&filter->x, (float)((i + (k + 0.5) / 256) * width) - kind.radius_x) *
                width / 256;
            truth[i] += value;
            expected[i] += fabs(value);
        }
        absolute += expected[i];
        total += truth[i];
    }
    for (int i = 0; i < BINS; i++) expected[i] *= DRAWS / absolute;
    double p = chi_square_p(observed, expected, BINS, DRAWS);
    if (!(p > level)) fail_msg("filter %u: p = %g", kind.kind, p);
    if (!(fabs(total - 1) < 2e-3)) fail_msg("filter %u: integral %g", kind.kind, total);
    for (int i = 0; i < BINS; i++)
        if (!(fabs(given_to[i] - truth[i]) < 2e-3))
            fail_msg("filter %u: bin %d has %g, not %g", kind.kind, i, given_to[i], truth[i]);

    /* A splat gives each pixel in reach, on average, the filter's value there. */
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
        assert_true(fabs(given[i] - (double)filter_value(&filter->x, position - ((float)i + 0.5f))) < 0.01);
    free(filter);
}

static void filters_draw_their_density(void **state)
{
    (void)state;
    check_filter((blob_filter_t){.kind = FILTER_BOX, .radius_x = 0.5f, .radius_y = 0.5f});
    check_filter((blob_filter_t){.kind = FILTER_BOX, .radius_x = 1.7f, .radius_y = 0.5f});
    check_filter((blob_filter_t){.kind = FILTER_TRIANGLE, .radius_x = 2, .radius_y = 2});
    check_filter(
        (blob_filter_t){.kind = FILTER_GAUSSIAN, .radius_x = 1.5f, .radius_y = 1.5f, .parameters = {0.5f}});
    check_filter((blob_filter_t){
        .kind = FILTER_MITCHELL, .radius_x = 2, .radius_y = 2, .parameters = {1 / 3.0f, 1 / 3.0f}});
    check_filter((blob_filter_t){.kind = FILTER_SINC, .radius_x = 4, .radius_y = 4, .parameters = {3}});
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
        cmocka_unit_test(the_test_can_fail),          cmocka_unit_test(lights_draw_by_power_and_area),
        cmocka_unit_test(lights_emit_by_cosine),      cmocka_unit_test(ways_to_a_light_agree),
        cmocka_unit_test(alias_follows_weights),      cmocka_unit_test(camera_draws_its_density),
        cmocka_unit_test(filters_draw_their_density), cmocka_unit_test(triangle_warp_is_uniform),
        cmocka_unit_test(sobol_points_are_nets),      cmocka_unit_test(numbers_are_uniform_and_independent),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
