/* Tests of worker/render/medium/field.c and cloud.c: bricks say what the same numbers in cells say, no number
 * is over its bound, and clouds are pbrt-v4's. */
#include "worker/render/medium/cloud.h"
#include "worker/render/medium/field.h"

#include "common/base.h"
#include "common/sampler.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* A number in [0, 1) that depends on its argument alone. */
static float uniform(uint64_t i)
{
    return sampler_float((uint32_t)(sampler_mix(i * 0x9E3779B97F4A7C15u + 4711) >> 32));
}

/* ---- bricks ---------------------------------------------------------------------------------------------
 */

enum { X = 24, Y = 16, Z = 40, BRICKS = X * Y * Z / BLOB_BRICK_CELLS };

/* The same numbers in cells, field 1, and in bricks, field 2; of which every other is empty. Field 3 has them
 * as the green of colours. */
typedef struct {
    blob_field_t fields[3];
    float numbers[2 * X * Y * Z + 3 * X * Y * Z];
    uint32_t bricks[BRICKS];
    scene_blob_t blob;
} both_t;

static void fill_brick(both_t *both, uint32_t brick, int x0, int y0, int z0)
{
    float *cells = both->numbers, *bricks = both->numbers + X * Y * Z, *colours = bricks + X * Y * Z;
    for (int i = 0; i < BLOB_BRICK_CELLS; i++) {
        int x = i / 64, y = i / 8 % 8, z = i % 8;
        size_t cell = (size_t)(((z0 + z) * Y + y0 + y) * X + x0 + x);
        cells[cell] = bricks[brick * BLOB_BRICK_CELLS + (uint32_t)i] = uniform(cell);
        colours[3 * cell + 1] = cells[cell];
        colours[3 * cell] = 2 * cells[cell];
    }
}

static both_t *both_new(void)
{
    both_t *both = mem_zalloc(1, sizeof *both);
    uint32_t count = 0, entry = 0;
    for (int z = 0; z < Z; z += 8)
        for (int y = 0; y < Y; y += 8)
            for (int x = 0; x < X; x += 8, entry++) {
                both->bricks[entry] = entry % 2 ? BLOB_NONE : count;
                if (entry % 2 == 0) fill_brick(both, count++, x, y, z);
            }
    for (uint32_t i = 0; i < 3; i++) {
        both->fields[i] = (blob_field_t){.kind = i == 1 ? FIELD_BRICKS : FIELD_CELLS,
                                         .channels = i == 2 ? 3 : 1,
                                         .cells = {X, Y, Z},
                                         .first = i * X * Y * Z,
                                         .brick_count = count,
                                         .origin = {-0.5f, 3, 2.5f},
                                         .span = {X, Y - 5, Z - 4}};
        both->fields[i].world_from_field = xform_identity();
    }
    both->blob = (scene_blob_t){.fields = both->fields, .numbers = both->numbers, .bricks = both->bricks};
    return both;
}

static void bricks_are_cells(void **state)
{
    (void)state;
    both_t *both = both_new();
    field_t cells = field_open(&both->blob, 1), bricks = field_open(&both->blob, 2),
            colours = field_open(&both->blob, 3);
    uint64_t different = 0;
    for (uint64_t i = 0; i < 20000; i++) {
        vec3_t u = vec3(uniform(3 * i), uniform(3 * i + 1), uniform(3 * i + 2));
        float place[3], other[3];
        assert_true(field_place(&cells, u, place) && field_place(&bricks, u, other));
        assert_memory_equal(place, other, sizeof place);
        float number = field_number(&cells, place);
        rgb_t colour = field_colour(&colours, place), grey = field_colour(&bricks, place);
        assert_true(number == field_number(&bricks, place));
        assert_true(grey.x == number && grey.y == number && grey.z == number);
        assert_true(fabsf(colour.x - 2 * number) < 1e-6f && colour.y == number && colour.z == 0);
        different += number > 0;
    }
    assert_true(different > 10000 && different < 19000);
    free(both);
}

/* At the middle of a cell lies its number, at the field's own places. */
static void places_are_cells(void **state)
{
    (void)state;
    both_t *both = both_new();
    field_t field = field_open(&both->blob, 2);
    for (int x = 0; x < X; x++) {
        vec3_t u = vec3(((float)x + 0.5f) / X, 2.0f / (Y - 5), 5.5f / (Z - 4));
        float place[3];
        assert_true(field_place(&field, u, place));
        assert_float_equal(field_number(&field, place), both->numbers[(8 * Y + 5) * X + x], 1e-4f);
    }
    float place[3];
    assert_false(field_place(&field, vec3(0.5f, 0.5f, 1.01f), place));
    assert_false(field_place(&field, vec3(0.5f, NAN, 0.5f), place));
    assert_false(field_place(&field, vec3(-INFINITY, 0.5f, 0.5f), place));
    free(both);
}

static void no_number_is_over_its_bound(void **state)
{
    (void)state;
    both_t *both = both_new();
    field_t fields[2] = {field_open(&both->blob, 1), field_open(&both->blob, 2)};
    for (uint64_t i = 0; i < 3000; i++) {
        float low[3], high[3], place[3], most = 0;
        const int sizes[3] = {X, Y, Z};
        for (int k = 0; k < 3; k++) {
            low[k] = uniform(8 * i + (uint64_t)k) * (float)sizes[k] - 1;
            high[k] = low[k] + 12 * uniform(8 * i + 3 + (uint64_t)k);
        }
        float bound = field_most(&fields[0], low, high);
        assert_true(bound == field_most(&fields[1], low, high));
        for (uint64_t j = 0; j < 20; j++) {
            for (int k = 0; k < 3; k++)
                place[k] = low[k] + uniform(64 * i + 3 * j + (uint64_t)k) * (high[k] - low[k]);
            most = fmaxf(most, field_number(&fields[1], place));
        }
        assert_true(most <= bound * (1 + 1e-6f));
    }
    const float low[3] = {-3, -3, -3}, high[3] = {-2, 5, 5};
    assert_true(field_most(&fields[0], low, high) == 0 && field_most(&fields[1], low, high) == 0);
    free(both);
}

/* ---- clouds ---------------------------------------------------------------------------------------------
 */

/* Worked out in double precision by another program, from pbrt-v4's formula. */
static void clouds_are_those_of_pbrt(void **state)
{
    (void)state;
    static const struct {
        float parameters[3], point[3];
        double density;
    } cases[] = {
        {{1, 1, 5}, {-0.3f, 1.3f, 0.41f}, 0.09673},
        {{1, 1, 5}, {1.51f, 0.78f, 0.92f}, 0.17817},
        {{1, 1, 5}, {0.57f, 1.04f, 1.01f}, 0.04156},
        {{1, 1, 5}, {-0.1f, 0.33f, 1.6f}, 0.54098},
        {{1, 1, 5}, {0.42f, 1.02f, 1.64f}, 0},
        {{2, 3, 4}, {1.4f, 0.74f, 1.81f}, 0.13554},
        {{2, 3, 4}, {1.64f, 0.4f, -0.59f}, 0.2},
        {{2, 3, 4}, {-0.35f, 1.27f, 0.31f}, 0.31988},
        {{2, 3, 4}, {0.16f, 0.65f, 0.76f}, 0.13616},
        {{2, 3, 4}, {0.75f, 1.2f, 1.05f}, 0.01063},
        {{0.5f, 0, 7.5f}, {1.79f, 1.16f, 1.97f}, 0.05817},
        {{0.5f, 0, 7.5f}, {1.01f, 0.46f, 1.58f}, 0.08},
        {{0.5f, 0, 7.5f}, {1.89f, 1.2f, 0.71f}, 0.0345},
        {{0.5f, 0, 7.5f}, {1.14f, 0.51f, 1.49f}, 0.17228},
        {{0.5f, 0, 7.5f}, {0.72f, 0.58f, -0.81f}, 0},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        assert_true(fabs((double)cloud_density(cases[i].parameters, cases[i].point) - cases[i].density) <
                    5e-4);
}

static void no_cloud_is_over_its_bound(void **state)
{
    (void)state;
    float closest = 0;
    for (uint64_t i = 0; i < 60; i++) {
        const float parameters[3] = {i % 4 == 0 ? 1 : 2 * uniform(7 * i), 3 * uniform(7 * i + 1),
                                     10 * uniform(7 * i + 2)};
        float low = 2 * uniform(7 * i + 3) - 0.5f, high = low + 0.2f * uniform(7 * i + 4);
        float bound = cloud_most(parameters, low, high);
        assert_true(bound >= 0 && bound <= 1);
        for (uint64_t j = 0; j < 2000; j++) {
            const float point[3] = {50 * uniform(4 * j), low + uniform(4 * j + 1) * (high - low),
                                    50 * uniform(4 * j + 2)};
            float density = cloud_density(parameters, point);
            assert_true(density >= 0 && density <= bound * (1 + 1e-5f) + 1e-6f);
            if (bound < 1) closest = fmaxf(closest, density / bound);
        }
    }
    assert_true(closest > 0.4f); /* the bound is no wild guess */
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bricks_are_cells),
        cmocka_unit_test(places_are_cells),
        cmocka_unit_test(no_number_is_over_its_bound),
        cmocka_unit_test(clouds_are_those_of_pbrt),
        cmocka_unit_test(no_cloud_is_over_its_bound),
    };
    return cmocka_run_group_tests_name("field", tests, NULL, NULL);
}
