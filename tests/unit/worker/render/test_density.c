/* Tests of worker/render/medium/density.c: pieces of rays cover what lies in the grid and no more, their
 * bounds hold, the density is the trilinear one, and integrals are those that small steps add up. */
#include "worker/render/medium/density.h"

#include "common/base.h"
#include "common/sampler.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

/* A number in [0, 1) that depends on its argument alone. */
static float uniform(uint64_t i)
{
    return sampler_float((uint32_t)(sampler_mix(i * 0x9E3779B97F4A7C15u + 4711) >> 32));
}

/* ---- a grid and what is known of it -------------------------------------------------------------------- */

typedef struct {
    blob_field_t field;
    float *cells;
    xform_t grid_from_world;
    density_t *density;
} grid_t;

static const uint32_t sizes[][3] = {{1, 1, 1},  {2, 3, 1},  {4, 4, 4},   {9, 5, 13},
                                    {64, 2, 3}, {1, 65, 1}, {3, 130, 7}, {300, 2, 2}};

/* Cells with holes of several cells, and a dense one here and there. */
static void grid_begin(grid_t *grid, const uint32_t size[3], xform_t world_from_grid)
{
    *grid = (grid_t){.field = {.kind = FIELD_CELLS, .channels = 1, .world_from_field = world_from_grid}};
    for (int i = 0; i < 3; i++) {
        grid->field.cells[i] = size[i];
        grid->field.origin[i] = -0.5f;
        grid->field.span[i] = (float)size[i];
    }
    size_t count = (size_t)size[0] * size[1] * size[2];
    grid->cells = mem_alloc(count * sizeof(float));
    for (size_t i = 0; i < count; i++) {
        float u = uniform(i), hole = uniform(i / 13 + 1000000);
        grid->cells[i] = hole < 0.3f && count > 4 ? 0 : u > 0.97f ? 20 * u : u;
    }
    assert_true(xform_invert(&world_from_grid, &grid->grid_from_world));
    scene_blob_t blob = {.numbers = grid->cells, .fields = &grid->field};
    grid->density = density_new(&blob, 1);
}

static void grid_end(grid_t *grid)
{
    density_destroy(&grid->density);
    assert_null(grid->density);
    free(grid->cells);
}

/* Turned, stretched and mirrored. */
static xform_t some_transform(uint32_t i)
{
    xform_t t = {{{2, 0.5f, -0.3f, 1}, {-0.4f, 1.5f, 0.2f, -2}, {0.1f, 0.6f, i & 1 ? -3 : 3, 0.5f}}};
    return i == 0 ? xform_identity() : t;
}

typedef struct {
    vec3_t from, direction;
    float distance;
    double origin[3], along[3]; /* in the grid's own space */
} ray_t;

static void ray_place(const grid_t *grid, ray_t *ray)
{
    const float from[3] = {ray->from.x, ray->from.y, ray->from.z},
                direction[3] = {ray->direction.x, ray->direction.y, ray->direction.z};
    for (int r = 0; r < 3; r++) {
        const float *row = grid->grid_from_world.m[r];
        ray->origin[r] = (double)row[3];
        ray->along[r] = 0;
        for (int c = 0; c < 3; c++) {
            ray->origin[r] += (double)row[c] * (double)from[c];
            ray->along[r] += (double)row[c] * (double)direction[c];
        }
    }
}

/* From outside through the grid, from inside, or past it; some of them end. */
static ray_t some_ray(const grid_t *grid, uint64_t i)
{
    vec3_t a = vec3(uniform(16 * i), uniform(16 * i + 1), uniform(16 * i + 2)),
           b = vec3(uniform(16 * i + 3), uniform(16 * i + 4), uniform(16 * i + 5));
    if (i % 3 != 0) a = v_sub(v_scale(a, 5), vec3(2, 2, 2));
    vec3_t from = xform_point(&grid->field.world_from_field, a),
           to = xform_point(&grid->field.world_from_field, b);
    ray_t ray = {.from = from,
                 .direction = v_scale(v_sub(to, from), 1 / v_length(v_sub(to, from))),
                 .distance = i % 2 ? INFINITY : 2 * uniform(16 * i + 6) * v_length(v_sub(to, from))};
    ray_place(grid, &ray);
    return ray;
}

/* Where it lies in the grid; false when it does not. */
static bool inside(const ray_t *ray, double *begin, double *end)
{
    *begin = 0;
    *end = (double)ray->distance;
    for (int i = 0; i < 3; i++) {
        if (ray->along[i] == 0 && !(ray->origin[i] >= 0 && ray->origin[i] <= 1)) return false;
        if (ray->along[i] == 0) continue;
        double a = -ray->origin[i] / ray->along[i], b = (1 - ray->origin[i]) / ray->along[i];
        *begin = fmax(*begin, fmin(a, b));
        *end = fmin(*end, fmax(a, b));
    }
    return *begin < *end;
}

static double cell_at(const grid_t *grid, const int at[3])
{
    const uint32_t *n = grid->field.cells;
    for (int i = 0; i < 3; i++)
        if (at[i] < 0 || at[i] >= (int)n[i]) return 0;
    return (double)grid->cells[((size_t)at[2] * n[1] + (size_t)at[1]) * n[0] + (size_t)at[0]];
}

static double density_at(const grid_t *grid, const ray_t *ray, double t)
{
    double part[3], sum = 0;
    int first[3];
    for (int i = 0; i < 3; i++) {
        double at = (ray->origin[i] + t * ray->along[i]) * grid->field.cells[i] - 0.5;
        first[i] = (int)floor(at);
        part[i] = at - first[i];
    }
    for (int k = 0; k < 8; k++) {
        const int d[3] = {k & 1, k >> 1 & 1, k >> 2},
                  at[3] = {first[0] + d[0], first[1] + d[1], first[2] + d[2]};
        double share = 1;
        for (int i = 0; i < 3; i++) share *= d[i] ? part[i] : 1 - part[i];
        sum += share * cell_at(grid, at);
    }
    return sum;
}

static double integral(const grid_t *grid, const ray_t *ray, double begin, double end)
{
    enum { STEPS = 20000 };
    double sum = 0, step = (end - begin) / STEPS;
    for (int i = 0; i < STEPS; i++) sum += density_at(grid, ray, begin + (i + 0.5) * step) * step;
    return sum;
}

/* ---- pieces -------------------------------------------------------------------------------------------- */

/* Densities at places of a piece. */
static void check_piece(const grid_t *grid, const ray_t *ray, const march_t *march, float begin, float end,
                        float most, uint64_t key)
{
    for (uint64_t k = 0; k < 4; k++) {
        float t = begin + uniform(8 * key + k) * (end - begin), density = density_along(march, t);
        assert_true(density <= most * (1 + 1e-5f));
        /* a float's place in 300 cells, where neighbours differ by 20 */
        assert_true(fabs((double)density - density_at(grid, ray, (double)t)) < 0.01);
    }
}

static void check_march(const grid_t *grid, const ray_t *ray, uint64_t key)
{
    double first, last;
    bool meets = inside(ray, &first, &last);
    march_t march;
    float begin, end, most, at = -1;
    uint64_t pieces = 0;
    march_begin(&march, grid->density, ray->from, ray->direction, ray->distance);
    for (; march_next(&march, &begin, &end, &most); pieces++) {
        assert_true(pieces < 400);
        assert_true(begin <= end);
        if (pieces == 0) assert_true(fabs((double)begin - first) < 1e-4);
        if (pieces > 0) assert_true(begin == at);
        check_piece(grid, ray, &march, begin, end, most, 1000 * key + pieces);
        at = end;
    }
    if (meets && last - first > 1e-4) assert_true(pieces > 0);
    if (!meets) assert_true(pieces == 0 || (double)at - last < 1e-4);
    if (meets && pieces > 0) assert_true(fabs((double)at - last) < 1e-4);
}

static void pieces_cover_the_ray(void **state)
{
    (void)state;
    for (uint32_t s = 0; s < ARRAY_LENGTH(sizes); s++)
        for (uint32_t k = 0; k < 3; k++) {
            grid_t grid;
            grid_begin(&grid, sizes[s], some_transform(k));
            for (uint64_t i = 0; i < 1000; i++) {
                ray_t ray = some_ray(&grid, i);
                check_march(&grid, &ray, i);
            }
            grid_end(&grid);
        }
}

static bool find_along(const density_t *density, vec3_t from, vec3_t direction, float distance, float wanted,
                       float *sum, float *at)
{
    way_t way;
    way_begin(&way, density, from, direction, distance);
    return way_find(&way, wanted, sum, at);
}

/* Along axes, through the middles of cells, along their faces and along those of blocks and of the grid. */
static void axes_are_rays_like_others(void **state)
{
    (void)state;
    static const uint32_t size[3] = {8, 16, 12};
    grid_t grid;
    grid_begin(&grid, size, xform_identity());
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i <= 16; i++)
            for (int sign = -1; sign <= 1; sign += 2) {
                float p[3] = {(float)i / 16, (float)i / 16, (float)i / 16}, d[3] = {0};
                d[axis] = (float)sign;
                p[axis] = sign > 0 ? -0.5f : 1.5f;
                ray_t ray = {vec3(p[0], p[1], p[2]), vec3(d[0], d[1], d[2]), INFINITY, {0}, {0}};
                ray_place(&grid, &ray);
                check_march(&grid, &ray, (uint64_t)i);
                double begin, end, truth;
                assert_true(inside(&ray, &begin, &end));
                truth = integral(&grid, &ray, begin, end);
                float sum, at;
                assert_false(find_along(grid.density, ray.from, ray.direction, INFINITY, 1e30f, &sum, &at));
                assert_true(fabs((double)sum - truth) < 1e-4 * truth + 1e-4);
            }
    grid_end(&grid);
}

static void rays_that_miss_meet_nothing(void **state)
{
    (void)state;
    grid_t grid;
    grid_begin(&grid, sizes[3], xform_identity());
    static const ray_t rays[] = {
        {{-1, 0.5f, 0.5f}, {-1, 0, 0}, INFINITY, {0}, {0}},  /* away from it */
        {{-1, 0.5f, 0.5f}, {1, 0, 0}, 0.9f, {0}, {0}},       /* ends before it */
        {{-1, 1.5f, 0.5f}, {1, 0, 0}, INFINITY, {0}, {0}},   /* above it */
        {{-1, -1e-3f, 0.5f}, {1, 0, 0}, INFINITY, {0}, {0}}, /* just below it */
        {{0.5f, 0.5f, 0.5f}, {1, 0, 0}, 0, {0}, {0}},        /* nowhere */
        {{-1, 0, 0.5f}, {0.6f, -0.8f, 0}, INFINITY, {0}, {0}},
        {{-1e10f, 0.5f, 0.5f},
         {1, 0, 0},
         INFINITY,
         {0},
         {0}}, /* from where floats do not tell blocks apart */
        {{-INFINITY, 0.5f, 0.5f}, {1, 0, 0}, INFINITY, {0}, {0}},
        {{0.5f, NAN, 0.5f}, {0, 0.6f, 0.8f}, INFINITY, {0}, {0}},
        {{0.5f, 0.5f, 0.5f}, {INFINITY, 0, 0}, INFINITY, {0}, {0}},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(rays); i++) {
        march_t march;
        float begin, end, most, sum = 1, at;
        march_begin(&march, grid.density, rays[i].from, rays[i].direction, rays[i].distance);
        assert_false(march_next(&march, &begin, &end, &most));
        assert_false(
            find_along(grid.density, rays[i].from, rays[i].direction, rays[i].distance, 1e-6f, &sum, &at));
        assert_true(sum == 0);
    }
    grid_end(&grid);
}

/* A place in the grid that is no number: two of its terms are infinite. */
static void grids_without_places_are_not_met(void **state)
{
    (void)state;
    grid_t grid;
    const xform_t flat = {{{1, 0, 0, 0}, {1, -2e-38f, 0, 0}, {0, 0, 1, 0}}};
    grid_begin(&grid, sizes[3], flat);
    march_t march;
    float begin, end, most;
    march_begin(&march, grid.density, vec3(10, 20, 0.5f), vec3(-0.6f, 0, 0.8f), INFINITY);
    assert_true(isnan(march.origin[1]));
    assert_false(march_next(&march, &begin, &end, &most));
    grid_end(&grid);
}

/* ---- integrals ----------------------------------------------------------------------------------------- */

static void check_find(const grid_t *grid, const ray_t *ray)
{
    double begin, end, truth = 0;
    if (inside(ray, &begin, &end)) truth = integral(grid, ray, begin, end);
    float sum, at;
    double slack = 1e-3 * truth + 1e-4;
    assert_false(find_along(grid->density, ray->from, ray->direction, ray->distance,
                            (float)(truth + 2 * slack), &sum, &at));
    assert_true(fabs((double)sum - truth) < slack);
    if (!(truth > 0.01)) return;
    for (int k = 1; k < 8; k++) {
        double wanted = truth * k / 8;
        assert_true(
            find_along(grid->density, ray->from, ray->direction, ray->distance, (float)wanted, &sum, &at));
        assert_true((double)at > begin - 1e-4 && (double)at < end + 1e-4);
        assert_true(fabs(integral(grid, ray, begin, (double)at) - wanted) < 2 * slack);
    }
}

static void integrals_are_exact(void **state)
{
    (void)state;
    for (uint32_t s = 0; s < ARRAY_LENGTH(sizes); s++) {
        grid_t grid;
        grid_begin(&grid, sizes[s], some_transform(s % 3));
        for (uint64_t i = 0; i < 6; i++) {
            ray_t ray = some_ray(&grid, i);
            check_find(&grid, &ray);
        }
        grid_end(&grid);
    }
}

/* Whatever was asked before, also where there are more cubes than a way keeps. */
static void ways_tell_the_same_again(void **state)
{
    (void)state;
    static const uint32_t large[3] = {64, 64, 64}, small[3] = {5, 9, 3};
    for (int k = 0; k < 2; k++) {
        grid_t grid;
        grid_begin(&grid, k == 0 ? large : small, some_transform(0));
        int most = 0;
        for (uint64_t i = 0; i < 200; i++) {
            ray_t ray = some_ray(&grid, i);
            way_t way;
            way_begin(&way, grid.density, ray.from, ray.direction, ray.distance);
            assert_true(way_is(&way, grid.density, ray.from, ray.direction, ray.distance));
            assert_false(way_is(&way, grid.density, ray.from, v_neg(ray.direction), ray.distance));
            float whole, nowhere;
            find_along(grid.density, ray.from, ray.direction, ray.distance, INFINITY, &whole, &nowhere);
            for (int n = 0; n < 6; n++) {
                static const float parts[6] = {0.4f, 0.2f, 0.9f, 1.5f, 0.7f, 1.1f};
                float sum, at = -1, sum_anew, at_anew = -1, wanted = parts[n] * whole;
                bool found = way_find(&way, wanted, &sum, &at);
                assert_true(found == find_along(grid.density, ray.from, ray.direction, ray.distance, wanted,
                                                &sum_anew, &at_anew));
                assert_true(found == (parts[n] < 1 && whole > 0));
                assert_true(sum == sum_anew && at == at_anew);
                most = int_max(most, way.count);
            }
        }
        assert_true(k == 1 || most > WAY_CUBES);
        grid_end(&grid);
    }
}

/* In a grid of one cell of density 2 the density falls to 1 on the faces, along each axis. */
static void one_cell_falls_off_to_all_sides(void **state)
{
    (void)state;
    static const uint32_t size[3] = {1, 1, 1};
    grid_t grid;
    grid_begin(&grid, size, xform_identity());
    grid.cells[0] = 2;
    density_destroy(&grid.density);
    scene_blob_t blob = {.numbers = grid.cells, .fields = &grid.field};
    grid.density = density_new(&blob, 1);
    float sum, at;
    vec3_t along = vec3(0, 0, 1);
    assert_false(find_along(grid.density, vec3(0.5f, 0.5f, -3), along, INFINITY, 5, &sum, &at));
    assert_float_equal(sum, 1.5f, 1e-5f);
    assert_false(find_along(grid.density, vec3(0.25f, 0.5f, -3), along, INFINITY, 5, &sum, &at));
    assert_float_equal(sum, 0.75f * 1.5f, 1e-5f);
    assert_false(find_along(grid.density, vec3(0.25f, 0, -3), along, 3.5f, 5, &sum, &at));
    assert_float_equal(sum, 0.75f * 0.5f * 0.75f, 1e-5f);
    assert_true(find_along(grid.density, vec3(0.5f, 0.5f, -3), along, INFINITY, 0.75f, &sum, &at));
    assert_float_equal(at, 3.5f, 1e-3f);
    march_t march;
    march_begin(&march, grid.density, vec3(0.5f, 0.5f, -3), along, INFINITY);
    assert_float_equal(density_along(&march, 3.5f), 2, 1e-5f);
    assert_float_equal(density_along(&march, 3.25f), 1.5f, 1e-5f);
    grid_end(&grid);
}

static void long_grids_are_not_small(void **state)
{
    (void)state;
    static const uint32_t most[3] = {1, 64, 1}, more[3] = {1, 1, 65};
    grid_t grid;
    grid_begin(&grid, most, xform_identity());
    assert_true(density_is_small(grid.density));
    grid_end(&grid);
    grid_begin(&grid, more, xform_identity());
    assert_false(density_is_small(grid.density));
    grid_end(&grid);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pieces_cover_the_ray),
        cmocka_unit_test(axes_are_rays_like_others),
        cmocka_unit_test(rays_that_miss_meet_nothing),
        cmocka_unit_test(grids_without_places_are_not_met),
        cmocka_unit_test(integrals_are_exact),
        cmocka_unit_test(ways_tell_the_same_again),
        cmocka_unit_test(one_cell_falls_off_to_all_sides),
        cmocka_unit_test(long_grids_are_not_small),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
