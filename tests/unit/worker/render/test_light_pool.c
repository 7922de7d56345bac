/* The light pool: whatever an eye vertex chooses, each light vertex that it can be joined to counts as often
 * as its one light subpath among those of the block, on average over the number that chooses. */
#include "worker/render/integrator/light_pool.h"

#include "common/sampler.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

enum { VERTICES = 150, DRAWS = 1 << 18 };

/* A vertex at a random place that faces a random direction. Its normals may disagree about the side of
 * things; one in four lets light through. */
static vertex_t random_vertex(sampler_t *sampler, int depth)
{
    vec2_t a = sampler_2d(sampler), b = sampler_2d(sampler);
    float turn = TWO_PI_F * sampler_1d(sampler);
    vertex_t vertex = {.kind = VERTEX_SURFACE, .depth = depth, .length = depth};
    vertex.surface.p = vec3(a.x, a.y, b.x);
    float z = 2 * b.y - 1, r = sqrtf(1 - z * z);
    vec3_t n = vec3(r * cosf(turn), r * sinf(turn), z);
    vertex.surface.ng = n;
    vec2_t d = sampler_2d(sampler), e = sampler_2d(sampler);
    vertex.wo = v_normalize(vec3(d.x - 0.5f, d.y - 0.5f, e.x - 0.5f));
    vec3_t ns = v_normalize(v_mad(n, 0.8f, vec3(a.y - 0.5f, e.y - 0.5f, d.y - 0.5f)));
    vertex.throughput = vec3(0.01f + a.x * a.x, 0.01f + a.y, 0.5f);
    vertex.direct = b.x;
    vertex.inner = b.y;
    vertex.bsdf.ng = n;
    vertex.bsdf.ns = ns;
    v_frame(ns, &vertex.bsdf.s, &vertex.bsdf.t);
    vertex.bsdf.lobes[0] = (lobe_t){.kind = &lobe_lambert, .scale = {0.5f, 0.4f, 0.3f}, .chance = 1};
    vertex.bsdf.count = 1;
    if (a.x < 0.25f)
        vertex.bsdf.lobes[vertex.bsdf.count++] =
            (lobe_t){.kind = &lobe_lambert_transmission, .scale = {0.1f, 0.1f, 0.1f}, .chance = 1};
    return vertex;
}

/* True when the two see one another's sides that scatter. */
static bool can_be_joined(const vertex_t *z, const vertex_t *y, int least, int most)
{
    bsdf_value_t value;
    vec3_t w = v_normalize(v_sub(vertex_point(y), vertex_point(z)));
    return y->depth >= least && y->depth <= most && vertex_eval(z, w, &value) &&
           vertex_eval(y, v_neg(w), &value);
}

/* The pool of so many vertices, three for each subpath, which can be told by their points. */
static light_pool_t *make_pool(sampler_t *sampler, vertex_t *vertices, int count)
{
    light_pool_t *pool = light_pool_new();
    light_pool_reset(pool, POOL_PIXELS);
    for (int i = 0; i < count; i++) {
        light_path_t path = {.source = (uint32_t)i / 3, .last = 1};
        if (i % 3 == 0) light_pool_add_path(pool, &path);
        vertices[i] = random_vertex(sampler, 1 + i % 3);
        light_pool_add(pool, &vertices[i]);
    }
    return pool;
}

static void check_means(int depth, int count, int least, int most, bool weighted, float worth, float often)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 7, (uint32_t)depth, (uint32_t)count);
    vertex_t vertices[VERTICES], z = random_vertex(&sampler, depth);
    light_pool_t *pool = make_pool(&sampler, vertices, count);
    double counts[VERTICES] = {0};
    int possible = 0;
    for (int i = 0; i < DRAWS; i++) {
        light_choice_t choices[LIGHT_CHOICES_MOST];
        light_wish_t wish = {least, most, weighted, worth, often, ((float)i + 0.5f) / DRAWS};
        int chosen = light_pool_choose(pool, &z, &wish, choices);
        assert_in_range(chosen, 0, LIGHT_CHOICES_MOST);
        for (int k = 0; k < chosen; k++) {
            int at = 0;
            while (memcmp(&vertices[at].surface.p, &choices[k].vertex->surface.p, sizeof(vec3_t)) != 0) at++;
            assert_int_equal(choices[k].path->source, at / 3);
            assert_int_equal(choices[k].vertex->bsdf.count, vertices[at].bsdf.count);
            counts[at] += (double)choices[k].factor;
        }
    }
    for (int i = 0; i < count; i++) {
        double mean = counts[i] * POOL_PIXELS / DRAWS;
        bool must = can_be_joined(&z, &vertices[i], least, most);
        bool may = vertices[i].depth >= least && vertices[i].depth <= most;
        possible += must;
        if (!(mean < (may ? 1.02 : 0.001)) || (must && !(mean > 0.98)))
            fail_msg("vertex %d counts %g times", i, mean);
    }
    assert_true(possible > 0);
    light_pool_destroy(&pool);
}

static void first_vertices_count_all(void **state)
{
    (void)state;
    check_means(1, VERTICES, 1, 100, true, 0, 1);
    check_means(1, VERTICES, 1, 100, false, 1000, 1);
    check_means(1, 29, 1, 100, true, 100, 1);
    check_means(1, 15, 1, 100, false, 1000, 1); /* few: some are chosen twice */
}

/* They look at a part of the groups only, another one for each number. */
static void deeper_vertices_count_all(void **state)
{
    (void)state;
    check_means(2, VERTICES, 1, 100, true, 10, 1);
    check_means(5, VERTICES, 1, 100, true, 0, 1);
}

static void vertices_that_choose_now_and_then_count_all(void **state)
{
    (void)state;
    check_means(1, VERTICES, 1, 100, true, 10, 0.5f);
    check_means(3, VERTICES, 1, 100, true, 0, 0.3f);
}

static void depths_are_kept_to(void **state)
{
    (void)state;
    check_means(1, VERTICES, 2, 2, true, 0, 1);
    check_means(3, VERTICES, 1, 2, true, 1, 1);
}

static void an_empty_pool_has_no_choice(void **state)
{
    (void)state;
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 2, 3);
    vertex_t vertices[1], z = random_vertex(&sampler, 1);
    light_pool_t *pool = make_pool(&sampler, vertices, 1);
    light_choice_t choices[LIGHT_CHOICES_MOST];
    light_wish_t wish = {2, 100, true, 1, 1, 0.999999f};
    assert_int_equal(light_pool_choose(pool, &z, &wish, choices), 0);
    light_pool_reset(pool, POOL_PIXELS);
    assert_int_equal(light_pool_pixels(pool), POOL_PIXELS);
    assert_int_equal(light_pool_choose(pool, &z, &wish, choices), 0);
    light_pool_destroy(&pool);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(first_vertices_count_all),
        cmocka_unit_test(deeper_vertices_count_all),
        cmocka_unit_test(vertices_that_choose_now_and_then_count_all),
        cmocka_unit_test(depths_are_kept_to),
        cmocka_unit_test(an_empty_pool_has_no_choice),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
