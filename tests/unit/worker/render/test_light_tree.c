/* The tree of many lights: chances add up to one and are those that lights are chosen with, whatever lies
 * where; what is near is chosen more often than what is as bright and far away. */
#include "worker/render/light/light_tree.h"

#include "common/base.h"
#include "common/sampler.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

enum { LIGHTS = 37 };

static vec3_t place(sampler_t *numbers)
{
    vec2_t a = sampler_2d(numbers), b = sampler_2d(numbers);
    return vec3(10 * a.x, 10 * a.y, 3 * b.x);
}

/* Lights of odd numbers, of many powers and sizes. */
static light_tree_t *some_lights(light_box_t boxes[LIGHTS])
{
    sampler_t numbers = sampler_new(SAMPLER_INDEPENDENT, 1, 2, 3);
    for (uint32_t i = 0; i < LIGHTS; i++) {
        vec3_t low = place(&numbers), size = v_scale(place(&numbers), i % 3 == 0 ? 0.1f : 0);
        boxes[i] = (light_box_t){low, v_add(low, size), exp(8 * (double)sampler_1d(&numbers) - 4), 2 * i + 1};
    }
    return light_tree_new(boxes, LIGHTS, 2 * LIGHTS);
}

static void check_point(const light_tree_t *tree, vec3_t point)
{
    enum { DRAWS = 1 << 18 };
    double counts[2 * LIGHTS] = {0}, sum = 0;
    for (int i = 0; i < DRAWS; i++) {
        float u = ((float)i + 0.5f) / DRAWS, chance;
        uint32_t light = light_tree_choose(tree, point, &u, &chance);
        assert_true(light % 2 == 1 && light < 2 * LIGHTS && u >= 0 && u < 1);
        assert_true(fabsf(chance - light_tree_chance(tree, light, point)) <= 1e-5f * chance);
        counts[light]++;
    }
    for (uint32_t light = 1; light < 2 * LIGHTS; light += 2) {
        double chance = (double)light_tree_chance(tree, light, point);
        if (!(chance > 0 && fabs(counts[light] / DRAWS - chance) < 1e-4 + 1e-3 * chance))
            fail_msg("light %u: %g of the draws, chance %g", light, counts[light] / DRAWS, chance);
        sum += chance;
    }
    assert_true(fabs(sum - 1) < 1e-4);
}

static void chances_are_those_of_the_choice(void **state)
{
    (void)state;
    light_box_t boxes[LIGHTS];
    light_tree_t *tree = some_lights(boxes);
    check_point(tree, vec3(5, 5, 1));
    check_point(tree, boxes[7].low);
    check_point(tree, vec3(-1000, 0, 0));
    light_tree_destroy(&tree);
    assert_null(tree);
}

static void near_lights_have_more(void **state)
{
    (void)state;
    light_box_t boxes[16];
    for (uint32_t i = 0; i < 16; i++) {
        vec3_t p = vec3((float)i, 0, 0);
        boxes[i] = (light_box_t){p, p, 1, i};
    }
    light_tree_t *tree = light_tree_new(boxes, 16, 16);
    vec3_t point = vec3(3, 0.5f, 0);
    for (uint32_t i = 0; i < 16; i++)
        if (i != 3) assert_true(light_tree_chance(tree, 3, point) > light_tree_chance(tree, i, point));
    assert_true(light_tree_chance(tree, 3, point) > 0.3f && light_tree_chance(tree, 15, point) < 0.02f);
    light_tree_destroy(&tree);
}

/* All at one place, and one that is next to dark: whoever asks from there gets an answer, too. */
static void lights_may_lie_in_one_another(void **state)
{
    (void)state;
    light_box_t boxes[9];
    vec3_t p = vec3(1, 2, 3);
    for (uint32_t i = 0; i < 9; i++) boxes[i] = (light_box_t){p, p, i == 4 ? 1e-300 : 1, i};
    light_tree_t *tree = light_tree_new(boxes, 9, 9);
    double sum = 0;
    for (uint32_t i = 0; i < 9; i++) sum += (double)light_tree_chance(tree, i, p);
    assert_true(fabs(sum - 1) < 1e-5);
    float u = 0.4f, chance;
    assert_in_range(light_tree_choose(tree, p, &u, &chance), 0, 8);
    assert_true(chance > 0 && chance <= 1);
    light_tree_destroy(&tree);
    light_box_t one = {p, p, 1, 0};
    tree = light_tree_new(&one, 1, 1);
    assert_true(light_tree_choose(tree, p, &u, &chance) == 0 && chance == 1);
    light_tree_destroy(&tree);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(chances_are_those_of_the_choice),
        cmocka_unit_test(near_lights_have_more),
        cmocka_unit_test(lights_may_lie_in_one_another),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
