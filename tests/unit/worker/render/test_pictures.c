/* Surfaces that only the camera sees (LIGHT_PICTURE), by all integrators: what they show, what mirrors show
 * of them, and that they neither light nor shade anything else. */
#include "tests/render_here.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { SIDE = 24, PIXELS = SIDE * SIDE };
static const rgb_t shown = {0.5f, 0.25f, 2}, black = {0, 0, 0};

static uint32_t add_material(test_scene_t *scene, material_kind_t kind, float reflectance, float roughness)
{
    blob_material_t material = {.kind = kind};
    material.values[VALUE_REFLECTANCE] = material.values[VALUE_METALLIC] = blob_constant(reflectance);
    material.values[VALUE_ROUGHNESS_U] = blob_constant(roughness);
    return test_scene_material(scene, material);
}

/* A picture whose left lower corner is given, 1.5 wide and high, turned to the camera or away from it. */
static void add_picture(test_scene_t *scene, vec3_t corner, bool turned)
{
    vec3_t across = vec3(1.5f, 0, 0), up = vec3(0, 1.5f, 0);
    uint32_t material = add_material(scene, MATERIAL_GLTF, 0, 0);
    test_scene_rectangle(scene, corner, turned ? across : up, turned ? up : across, material, shown);
}

/* Makes the blob, with all lights of the colour of the pictures as pictures. */
static void finish(test_scene_t *scene, int max_depth)
{
    test_scene_finish(scene);
    blob_light_t *lights = (blob_light_t *)scene->blob.lights;
    for (uint64_t i = 0; i < scene->blob.counts[BLOB_SECTION_LIGHTS]; i++)
        if (lights[i].radiance.factor.z == shown.z) lights[i].flags |= LIGHT_PICTURE | LIGHT_TWO_SIDED;
    ((blob_scene_t *)scene->blob.scene)->max_depth = max_depth;
}

static film_t *render(const test_scene_t *scene, integrator_t integrator)
{
    job_settings_t settings = blob_default_settings(&scene->blob);
    settings.integrator = integrator;
    settings.tile_size = SIDE;
    settings.spp = 4;
    settings.learn = false; /* what a job learns of the picture changes how it goes on */
    return render_here(&scene->blob, &settings);
}

/* What the eye subpaths of a pixel found in a channel, in the mean. */
static double eye_at(const film_t *film, size_t pixel, size_t channel)
{
    size_t v = 3 * pixel + channel;
    double sum = (double)film->sums[SUM_EYE][v] + (double)film->sums[SUM_EYE][3 * PIXELS + v];
    return ldexp(sum, -film->settings.film_scale) / film->settings.spp;
}

static bool is_splatted(const film_t *film, size_t pixel)
{
    if (film->sums[SUM_SPLAT] == NULL) return false;
    const int64_t *sums = film->sums[SUM_SPLAT];
    for (size_t c = 0; c < 3; c++)
        if (sums[3 * pixel + c] != 0 || sums[3 * (PIXELS + pixel) + c] != 0) return true;
    return false;
}

static bool shows(const film_t *film, size_t pixel, float factor)
{
    return fabs(eye_at(film, pixel, 0) - (double)(factor * shown.x)) < 1e-4 &&
           fabs(eye_at(film, pixel, 1) - (double)(factor * shown.y)) < 1e-4 &&
           fabs(eye_at(film, pixel, 2) - (double)(factor * shown.z)) < 1e-4 && !is_splatted(film, pixel);
}

static bool is_black(const film_t *film, size_t pixel)
{
    return eye_at(film, pixel, 0) == 0 && eye_at(film, pixel, 1) == 0 && eye_at(film, pixel, 2) == 0 &&
           !is_splatted(film, pixel);
}

/* A white room, and a picture that looks away from the camera: the room stays black. */
static void a_picture_lights_nothing(void **state)
{
    (void)state;
    for (integrator_t i = INTEGRATOR_BDPT; i <= INTEGRATOR_LIGHT; i++) {
        test_scene_t scene = test_scene_begin(vec3(0, 0, -3), 60, SIDE);
        test_scene_room(&scene, vec3(-4, -4, -4), vec3(4, 4, 4), add_material(&scene, MATERIAL_DIFFUSE, 1, 0),
                        black);
        add_picture(&scene, vec3(-1.6f, -0.7f, 1), i == INTEGRATOR_PATH);
        finish(&scene, 5);
        film_t *film = render(&scene, i);
        size_t seen = 0;
        for (size_t p = 0; p < PIXELS; p++) seen += shows(film, p, 1);
        for (size_t p = 0; p < PIXELS; p++)
            if (p % SIDE >= SIDE / 2) assert_true(is_black(film, p));
        assert_true(seen > 20);
        film_destroy(&film);
        test_scene_end(&scene);
    }
}

/* A room with two lamps, seen past a picture, or with the picture behind the wall. */
static film_t *lit_room(integrator_t integrator, bool in_the_way)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -3), 60, SIDE);
    uint32_t white = add_material(&scene, MATERIAL_DIFFUSE, 0.7f, 0);
    test_scene_room(&scene, vec3(-4, -4, -4), vec3(4, 4, 4), white, black);
    add_picture(&scene, vec3(-1.6f, -0.7f, in_the_way ? 1 : 5), true);
    test_scene_rectangle(&scene, vec3(-1, 3.9f, -1), vec3(2, 0, 0), vec3(0, 0, 2), white, vec3(8, 7, 5));
    blob_light_t bulb = {.kind = LIGHT_POINT,
                         .radiance = blob_constant(4),
                         .world_from_light = {{{1, 0, 0, -1}, {0, 1, 0, 0}, {0, 0, 1, -3.5f}}}};
    blob_builder_add(scene.builder, BLOB_SECTION_LIGHTS, &bulb, 1);
    finish(&scene, 4);
    film_t *film = render(&scene, integrator);
    test_scene_end(&scene);
    return film;
}

/* Bit by bit: what the picture does not cover is as if it were not there, though it stands between the lamps
 * and the walls; and nothing shines through where it covers. */
static void a_picture_shades_nothing(void **state)
{
    (void)state;
    for (integrator_t i = INTEGRATOR_BDPT; i <= INTEGRATOR_LIGHT; i++) {
        film_t *with = lit_room(i, true), *without = lit_room(i, false);
        size_t covered = 0, splats = 0;
        for (size_t p = 0; p < PIXELS; p++) {
            bool covers = shows(with, p, 1);
            covered += covers;
            splats += is_splatted(with, p);
            size_t x = p % SIDE, y = p / SIDE;
            bool rim = x >= 3 && x <= 12 && y >= 7 && y <= 16; /* where the picture lies, and a little more */
            assert_true(!covers || rim);
            for (size_t v = 0; v < 6 && !rim; v++) {
                size_t at = v < 3 ? 3 * p + v : 3 * (PIXELS + p) + v - 3;
                assert_true(with->sums[SUM_EYE][at] == without->sums[SUM_EYE][at]);
                assert_true(with->sums[SUM_SPLAT] == NULL ||
                            with->sums[SUM_SPLAT][at] == without->sums[SUM_SPLAT][at]);
            }
        }
        assert_true(covered >= 25);
        assert_int_equal(splats > PIXELS / 2, i != INTEGRATOR_PATH);
        film_destroy(&with);
        film_destroy(&without);
    }
}

/* Lamps behind the sheet, which lets nothing through: so many that lights are chosen by a tree. */
static void add_lamps(test_scene_t *scene)
{
    for (int k = 0; k < 12; k++) {
        blob_light_t bulb = {.kind = LIGHT_POINT,
                             .radiance = blob_constant(4),
                             .world_from_light = {{{1, 0, 0, (float)k - 6}, {0, 1, 0, 0}, {0, 0, 1, 5}}}};
        blob_builder_add(scene->builder, BLOB_SECTION_LIGHTS, &bulb, 1);
    }
}

/* A mirror shows it, twice mirrored as well; what is rough does not, nor does light tracing see mirrors. */
static void mirrors_show_pictures(void **state)
{
    (void)state;
    static const struct {
        material_kind_t kind;
        float roughness, shown;
        bool lamps;
    } cases[] = {{MATERIAL_MIRROR, 0, 0.9f, false},
                 {MATERIAL_MIRROR, 0, 0.9f, true},
                 {MATERIAL_DIFFUSE, 0, 0, false},
                 {MATERIAL_GLTF, 0.5f, 0, false}};
    for (size_t k = 0; k < ARRAY_LENGTH(cases); k++) {
        test_scene_t scene = test_scene_begin(vec3(0, 0, -3), 60, SIDE);
        uint32_t sheet = add_material(&scene, cases[k].kind, 0.9f, cases[k].roughness);
        test_scene_rectangle(&scene, vec3(-9, -9, 1), vec3(0, 18, 0), vec3(18, 0, 0), sheet, black);
        add_picture(&scene, vec3(-0.75f, -0.75f, -4), true);
        if (cases[k].lamps) add_lamps(&scene);
        finish(&scene, 5);
        for (integrator_t i = INTEGRATOR_BDPT; i <= INTEGRATOR_LIGHT; i++) {
            film_t *film = render(&scene, i);
            size_t seen = 0, dark = 0;
            for (size_t p = 0; p < PIXELS; p++) {
                seen += cases[k].shown > 0 && shows(film, p, cases[k].shown);
                dark += is_black(film, p);
            }
            bool sees = cases[k].shown > 0 && i != INTEGRATOR_LIGHT;
            assert_int_equal(seen > 4, sees);
            assert_true(sees ? dark > PIXELS / 2 : dark == PIXELS);
            film_destroy(&film);
        }
        test_scene_end(&scene);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_picture_lights_nothing),
                                       cmocka_unit_test(a_picture_shades_nothing),
                                       cmocka_unit_test(mirrors_show_pictures)};
    return cmocka_run_group_tests_name("pictures", tests, NULL, NULL);
}
