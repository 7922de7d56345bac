/* The borders of media that shadow rays go through (scene_shadow.c): which, in which order, and what lies
 * behind each. */
#include "common/sampler.h"
#include "tests/render_here.h"
#include "worker/render/scene/scene.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const rgb_t black = {0, 0, 0};

static test_scene_t begin(uint32_t *border)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -3), 60, 8);
    *border = test_scene_material(&scene, (blob_material_t){.kind = MATERIAL_DIFFUSE});
    return scene;
}

/* Shapes of the material `border` do nothing but part media; shape i parts medium 2 i + 1, on the side away
 * from its normal, from 2 i + 2. The shape `clear` has an alpha of 0. */
static scene_t *finish(test_scene_t *test, uint32_t border, uint32_t clear)
{
    scene_t *scene;
    test_scene_finish(test);
    ((blob_material_t *)test->blob.materials)[border].kind = MATERIAL_INTERFACE;
    blob_shape_t *shapes = (blob_shape_t *)test->blob.shapes;
    for (uint32_t i = 0; i < test->blob.counts[BLOB_SECTION_SHAPES]; i++) {
        shapes[i].flags |= SHAPE_INTERFACE;
        shapes[i].media[0] = 2 * i + 1;
        shapes[i].media[1] = 2 * i + 2;
        if (i == clear) shapes[i].alpha = blob_constant(0);
    }
    assert_int_equal(scene_new(&test->blob, &scene).code, RESULT_OK);
    return scene;
}

static void add_sheet(test_scene_t *test, float z, uint32_t material)
{
    test_scene_rectangle(test, vec3(-1, -1, z), vec3(2, 0, 0), vec3(0, 2, 0), material, black);
}

enum { SHEETS = 30 };
/* Shape i lies at such a height: in no order. */
static int height_of(int shape)
{
    return shape * 7 % SHEETS;
}

/* What must lie behind the n-th sheet on the way, which leads along their normals, or against them. */
static blob_ref_t behind_sheet(int n, bool along)
{
    for (int i = 0; i < SHEETS; i++)
        if (height_of(i) == (along ? n : SHEETS - 1 - n)) return (blob_ref_t)(2 * i + (along ? 2 : 1));
    return 0;
}

/* From before the n-th sheet on: all that there are count, and the first are kept. */
static void borders_come_in_order(void **state)
{
    (void)state;
    uint32_t material;
    test_scene_t test = begin(&material);
    for (int i = 0; i < SHEETS; i++) add_sheet(&test, (float)height_of(i), material);
    scene_t *scene = finish(&test, material, BLOB_NONE);
    assert_true(scene_has_borders(scene));
    for (int along = 0; along < 2; along++)
        for (int n = 0; n < SHEETS; n++) {
            float z = (float)n - 0.5f, last = (float)(SHEETS - 1), rest = last + 0.5f - z;
            vec3_t from = vec3(0.6f, -0.2f, along ? z : last - z),
                   to = vec3(0.5f, 0.1f, along ? last + 0.5f : -0.5f);
            borders_t borders;
            assert_false(scene_crosses(scene, from, to, 0, false, &borders));
            assert_int_equal(borders.count, SHEETS - n);
            for (int i = 0; i < int_min(borders.count, BORDERS_KEPT); i++) {
                assert_float_equal(borders.kept[i].at, ((float)i + 0.5f) / rest, 1e-5f);
                assert_int_equal(borders.kept[i].behind, behind_sheet(n + i, along));
            }
        }
    scene_destroy(&scene);
    test_scene_end(&test);
}

/* Into a ball and out of it; past a sheet that an alpha takes away, and up to a wall. */
static void only_what_is_met_counts(void **state)
{
    (void)state;
    uint32_t material;
    test_scene_t test = begin(&material);
    uint32_t wall = test_scene_material(&test, (blob_material_t){.kind = MATERIAL_DIFFUSE});
    test_scene_sphere(&test, vec3(0, 0, 0), 1, material, black);
    add_sheet(&test, 2, material);
    add_sheet(&test, 3, wall);
    scene_t *scene = finish(&test, material, 1);
    borders_t borders;
    assert_false(scene_crosses(scene, vec3(0, 0, -3), vec3(0, 0, 2.5f), 0, false, &borders));
    assert_int_equal(borders.count, 2);
    assert_float_equal(borders.kept[0].at, 2 / 5.5f, 1e-5f);
    assert_float_equal(borders.kept[1].at, 4 / 5.5f, 1e-5f);
    assert_int_equal(borders.kept[0].behind, 1);
    assert_int_equal(borders.kept[1].behind, 2);
    assert_false(scene_crosses(scene, vec3(0, 0, 0), vec3(0, 0.5f, 0), 0, false, &borders));
    assert_int_equal(borders.count, 0);
    assert_true(scene_crosses(scene, vec3(0, 0, -3), vec3(0, 0, 3.5f), 0, false, &borders));
    assert_true(scene_occluded(scene, vec3(0, 0, -3), vec3(0, 0, 3.5f), 0, false));
    assert_false(scene_occluded(scene, vec3(0, 0, -3), vec3(0, 0, 2.5f), 0, false));
    scene_destroy(&scene);
    test_scene_end(&test);
}

static vec3_t some_point(sampler_t *numbers)
{
    vec2_t u = sampler_2d(numbers);
    return vec3(3 * u.x - 1.5f, 3 * u.y - 1.5f, 7 * sampler_1d(numbers) - 1);
}

/* A packet has for each segment what the segment has by itself. */
static void packets_and_single_rays_agree(void **state)
{
    (void)state;
    uint32_t material;
    test_scene_t test = begin(&material);
    uint32_t wall = test_scene_material(&test, (blob_material_t){.kind = MATERIAL_DIFFUSE});
    for (int i = 0; i < 5; i++) add_sheet(&test, (float)i, material);
    test_scene_sphere(&test, vec3(0, 0, 2.5f), 1.3f, material, black);
    test_scene_rectangle(&test, vec3(0.2f, 0.2f, 2.2f), vec3(1, 0, 0.5f), vec3(0, 1, 0), wall, black);
    scene_t *scene = finish(&test, material, BLOB_NONE);
    int seen = 0, hidden = 0;
    for (uint32_t k = 0; k < 500; k++) {
        sampler_t numbers = sampler_new(SAMPLER_INDEPENDENT, 5, k, 0);
        segments_t segments = {.count = 1 + (int)(k % SCENE_PACKET)};
        for (int i = 0; i < SCENE_PACKET; i++)
            segments_set(&segments, i, some_point(&numbers), some_point(&numbers));
        borders_t together[SCENE_PACKET], alone;
        uint32_t lost = scene_crosses_packet(scene, &segments, together);
        for (int i = 0; i < segments.count; i++) {
            bool occluded = scene_crosses(scene, segments_from(&segments, i), segments_to(&segments, i), 0,
                                          false, &alone);
            assert_true(occluded == (lost >> i & 1));
            hidden += occluded;
            if (occluded) continue;
            assert_int_equal(together[i].count, alone.count);
            for (int n = 0; n < int_min(alone.count, BORDERS_KEPT); n++) {
                assert_float_equal(together[i].kept[n].at, alone.kept[n].at, 1e-5f);
                assert_int_equal(together[i].kept[n].behind, alone.kept[n].behind);
            }
            seen += alone.count;
        }
    }
    assert_true(seen > 1000 && hidden > 100);
    scene_destroy(&scene);
    test_scene_end(&test);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(borders_come_in_order),
        cmocka_unit_test(only_what_is_met_counts),
        cmocka_unit_test(packets_and_single_rays_agree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
