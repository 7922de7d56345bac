/* What the renderer makes of light groups: the picture keeps its bits; the groups add up to it; and a group
 * is what its lights alone would give. By all integrators, with a filter that has negative parts, and where
 * the luminance of a sample is limited. */
#include "tests/render_here.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { SIDE = 24, PIXELS = SIDE * SIDE };

/* Lights of the room, as bits of who is lit. */
enum { SKY = 1, LAMP = 2, BULB = 4, BALL = 8, ALL = 15 };
static const char GROUPS[] = "sky=infinite,small=1+2,rest";
static const int members[] = {SKY, LAMP | BULB, BALL};
enum { GROUP_COUNT = ARRAY_LENGTH(members) };

static void add_light(test_scene_t *scene, light_kind_t kind, rgb_t radiance, vec3_t place)
{
    blob_light_t light = {.kind = kind,
                          .radiance = blob_colour_value(radiance),
                          .world_from_light = {{{1, 0, 0, place.x}, {0, 1, 0, place.y}, {0, 0, 1, place.z}}}};
    blob_builder_add(scene->builder, BLOB_SECTION_LIGHTS, &light, 1);
}

/* A corner with a mirror and a glass ball under a sky, a rectangle, a bulb and a glowing ball; those that are
 * not `lit` are black, and keep their numbers. */
static test_scene_t room(int lit)
{
    const rgb_t black = vec3(0, 0, 0), least = vec3(1e-30f, 1e-30f, 1e-30f); /* is still a light */
    test_scene_t scene = test_scene_begin(vec3(0, 0, -3), 60, SIDE);
    blob_material_t matt = {.kind = MATERIAL_DIFFUSE}, mirror = {.kind = MATERIAL_MIRROR};
    matt.values[VALUE_REFLECTANCE] = blob_colour_value(vec3(0.7f, 0.5f, 0.3f));
    mirror.values[VALUE_REFLECTANCE] = blob_constant(0.9f);
    uint32_t wall = test_scene_material(&scene, matt), shiny = test_scene_material(&scene, mirror);
    add_light(&scene, LIGHT_INFINITE, lit & SKY ? vec3(0.4f, 0.5f, 0.8f) : black, black);
    test_scene_rectangle(&scene, vec3(-0.4f, 1.4f, 0.2f), vec3(0.8f, 0, 0), vec3(0, 0, 0.8f), wall,
                         lit & LAMP ? vec3(8, 7, 5) : least);
    add_light(&scene, LIGHT_POINT, lit & BULB ? vec3(1, 2, 1) : black, vec3(1, 0.5f, -0.5f));
    test_scene_sphere(&scene, vec3(-0.9f, 0.3f, 0.4f), 0.25f, wall, lit & BALL ? vec3(6, 1, 1) : least);
    test_scene_rectangle(&scene, vec3(-3, -1, -3), vec3(0, 0, 6), vec3(6, 0, 0), wall, black);
    test_scene_rectangle(&scene, vec3(-3, -1, 2), vec3(0, 4, 0), vec3(6, 0, 0), wall, black);
    test_scene_sphere(&scene, vec3(0.6f, -0.4f, 0.3f), 0.5f, shiny, black);
    return scene;
}

/* Changes the one scene record before the blob is made. */
static void finish(test_scene_t *scene, float max_luminance)
{
    test_scene_finish(scene);
    blob_scene_t *record = (blob_scene_t *)scene->blob.scene;
    record->max_luminance = max_luminance;
    record->filter = (blob_filter_t){FILTER_MITCHELL, 1.5f, 1.5f, {1.0f / 3, 1.0f / 3}};
}

static job_settings_t settings_of(const test_scene_t *scene, integrator_t integrator)
{
    job_settings_t settings = blob_default_settings(&scene->blob);
    settings.integrator = integrator;
    settings.tile_size = 16;
    settings.spp = 9;
    return settings;
}

static void set_groups(job_settings_t *settings)
{
    strcpy(settings->light_groups, GROUPS);
}

static double sum_of(const int64_t *values, size_t count, size_t stride)
{
    double sum = 0;
    for (size_t i = 0; i < count; i++) sum += (double)values[i * stride];
    return sum;
}

/* Every sum of the two films that both have. */
static void expect_same_picture(const film_t *plain, const film_t *grouped)
{
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) {
        size_t bytes = sum_image_values(&plain->settings, k) * film_sums[k].bytes;
        if (bytes > 0) assert_memory_equal(film_values(plain, k), film_values(grouped, k), bytes);
    }
    assert_memory_equal(plain->counts.light_paths, grouped->counts.light_paths,
                        sizeof plain->counts.light_paths);
}

/* Splats go to one group each; of an eye sample each group is rounded by itself. */
static void expect_whole(const film_t *film, sum_kind_t sum, sum_kind_t groups, double rounding)
{
    size_t values = 3 * PIXELS;
    bool some[GROUP_COUNT] = {false};
    for (size_t v = 0; v < values; v++) {
        double whole = (double)film->sums[sum][v] + (double)film->sums[sum][values + v], parts = 0, size = 0;
        for (size_t g = 0; g < GROUP_COUNT; g++) {
            double part = (double)film->sums[groups][g * values + v];
            parts += part;
            size += fabs(part);
            some[g] = some[g] || part != 0;
        }
        if (!(fabs(whole - parts) <= rounding * (size + 1e6)))
            fail_msg("value %zu of %s is %.0f, its groups have %.0f", v, film_sums[sum].name, whole, parts);
    }
    for (size_t g = 0; g < GROUP_COUNT; g++) assert_true(some[g]);
}

static void check_integrator(const test_scene_t *scene, integrator_t integrator)
{
    job_settings_t settings = settings_of(scene, integrator);
    film_t *plain = render_here(&scene->blob, &settings);
    set_groups(&settings);
    film_t *grouped = render_here(&scene->blob, &settings);
    expect_same_picture(plain, grouped);
    /* A sample of vcm is a sum of hundreds of photons. */
    expect_whole(grouped, SUM_EYE, SUM_GROUP_EYE, integrator == INTEGRATOR_VCM ? 1e-5 : 4e-6);
    assert_int_equal(grouped->sums[SUM_GROUP_SPLAT] != NULL, integrator != INTEGRATOR_PATH);
    if (integrator != INTEGRATOR_PATH) expect_whole(grouped, SUM_SPLAT, SUM_GROUP_SPLAT, 0);
    film_destroy(&plain);
    film_destroy(&grouped);
}

static void groups_add_up_to_the_picture(void **state)
{
    (void)state;
    static const float limits[] = {INFINITY, 0.5f};
    for (size_t l = 0; l < ARRAY_LENGTH(limits); l++) {
        test_scene_t scene = room(ALL);
        finish(&scene, limits[l]);
        for (integrator_t i = INTEGRATOR_BDPT; i <= INTEGRATOR_LIGHT; i++) check_integrator(&scene, i);
        check_integrator(&scene, INTEGRATOR_VCM);
        test_scene_end(&scene);
    }
}

/* Eye subpaths that run into lights go the same ways whatever the lights are. */
static void a_group_is_its_lights_bit_by_bit(void **state)
{
    (void)state;
    test_scene_t scene = room(ALL);
    finish(&scene, INFINITY);
    job_settings_t settings = settings_of(&scene, INTEGRATOR_BDPT);
    settings.strategy_t = 3;
    settings.unweighted = true;
    set_groups(&settings);
    film_t *film = render_here(&scene.blob, &settings);
    settings.light_groups[0] = '\0';
    for (size_t g = 0; g < GROUP_COUNT; g++) {
        size_t values = 3 * PIXELS, lit = 0;
        test_scene_t alone = room(members[g]);
        finish(&alone, INFINITY);
        film_t *other = render_here(&alone.blob, &settings);
        for (size_t v = 0; v < values; v++) {
            int64_t sum = other->sums[SUM_EYE][v] + other->sums[SUM_EYE][values + v];
            assert_true(film->sums[SUM_GROUP_EYE][g * values + v] == sum);
            lit += sum != 0;
        }
        assert_true(lit > 20);
        film_destroy(&other);
        test_scene_end(&alone);
    }
    film_destroy(&film);
    test_scene_end(&scene);
}

/* The mean of the image, by its eye and its light part. */
typedef struct {
    double eye, light;
} means_t;

static means_t means_of(const film_t *film, sum_kind_t eye, sum_kind_t light, size_t first, size_t planes)
{
    double paths = (double)film->counts.light_paths[0] + (double)film->counts.light_paths[1];
    means_t means = {sum_of(film->sums[eye] + first, 3 * PIXELS * planes, 1) / film->settings.spp, 0};
    if (film->sums[light] != NULL && paths > 0)
        means.light = sum_of(film->sums[light] + first, 3 * PIXELS * planes, 1) * PIXELS / paths;
    double unit = ldexp(1.0, -film->settings.film_scale) / (3 * PIXELS);
    return (means_t){means.eye * unit, means.light * unit};
}

enum { RUNS = 12 };

/* The difference of two means of several runs, in standard errors. */
static double distance(const double a[RUNS], const double b[RUNS])
{
    double mean[2] = {0, 0}, variance = 0;
    const double *runs[2] = {a, b};
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < RUNS; i++) mean[k] += runs[k][i] / RUNS;
        for (int i = 0; i < RUNS; i++) variance += pow(runs[k][i] - mean[k], 2) / (RUNS * (RUNS - 1));
    }
    return fabs(mean[0] - mean[1]) / sqrt(variance);
}

/* The way in which lights are chosen differs, so that only the means are the same. bdpt's weights differ too,
 * by the chances of the lights, so that only eye and light together are. */
static void check_means(integrator_t integrator)
{
    test_scene_t scene = room(ALL);
    finish(&scene, INFINITY);
    for (size_t g = 0; g < GROUP_COUNT; g++) {
        test_scene_t alone = room(members[g]);
        finish(&alone, INFINITY);
        double with[RUNS], without[RUNS];
        for (int i = 0; i < RUNS; i++) {
            job_settings_t settings = settings_of(&scene, integrator);
            settings.sampler = SAMPLER_INDEPENDENT;
            settings.spp = 16;
            settings.seed = (uint64_t)i;
            film_t *other = render_here(&alone.blob, &settings);
            settings.seed += RUNS;
            set_groups(&settings);
            film_t *film = render_here(&scene.blob, &settings);
            means_t a = means_of(film, SUM_GROUP_EYE, SUM_GROUP_SPLAT, 3 * PIXELS * g, 1);
            means_t b = means_of(other, SUM_EYE, SUM_SPLAT, 0, 2);
            with[i] = a.eye + a.light;
            without[i] = b.eye + b.light;
            film_destroy(&film);
            film_destroy(&other);
        }
        double apart = distance(with, without);
        if (!(apart < 4)) fail_msg("group %zu is %.1f standard errors from its lights alone", g, apart);
        test_scene_end(&alone);
    }
    test_scene_end(&scene);
}

static void a_group_is_its_lights_in_the_mean(void **state)
{
    (void)state;
    for (integrator_t i = INTEGRATOR_BDPT; i <= INTEGRATOR_LIGHT; i++) check_means(i);
}

static void groups_of_another_scene_are_refused(void **state)
{
    (void)state;
    test_scene_t scene = room(ALL);
    finish(&scene, INFINITY);
    job_settings_t settings = settings_of(&scene, INTEGRATOR_PATH);
    strcpy(settings.light_groups, "a=0-3,b=4");
    renderer_t *renderer;
    assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
    result_t result = renderer_new(&scene.blob, &settings, &renderer);
    assert_int_equal(result.code, RESULT_USAGE);
    assert_non_null(strstr(result.message, "no light '4'"));
    assert_null(renderer);
    test_scene_end(&scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(groups_add_up_to_the_picture),
                                       cmocka_unit_test(a_group_is_its_lights_bit_by_bit),
                                       cmocka_unit_test(a_group_is_its_lights_in_the_mean),
                                       cmocka_unit_test(groups_of_another_scene_are_refused)};
    return cmocka_run_group_tests_name("light groups of the renderer", tests, NULL, NULL);
}
