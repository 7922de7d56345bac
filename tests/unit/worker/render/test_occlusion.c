/* Ambient occlusion against what is known in closed form: a ball over a wall, which covers (r / d)^2 cos of
 * the hemisphere over a point, d from its middle (as a form factor, whatever lies below no horizon). */
#include "tests/render_here.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

enum { SIDE = 16, EDGE = 12 };
static const float radius = 1.9f, height = 3, fov = 40;

/* A camera before a wall at distance 1, which ends at column EDGE, and behind the camera a ball. */
static film_image_t render(bool turned, float distance, uint32_t spp)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, 0), fov, SIDE);
    blob_scene_t *record = blob_builder_records(scene.builder, BLOB_SECTION_SCENE);
    record->occlusion_distance = distance;
    record->occlusion_radiance = vec3(2, 1, 0.5f);
    record->integrator = INTEGRATOR_AO;
    record->spp = spp;
    uint32_t black = test_scene_material(&scene, (blob_material_t){.kind = MATERIAL_DIFFUSE});
    float edge = tanf(fov * PI_F / 360) * (2.0f * EDGE / SIDE - 1);
    vec3_t across = vec3(-9, 0, 0), up = vec3(0, 9, 0);
    test_scene_rectangle(&scene, vec3(edge, -4.5f, 1), turned ? up : across, turned ? across : up, black,
                         vec3(0, 0, 0));
    test_scene_sphere(&scene, vec3(0, 0, 1 - height), radius, black, vec3(0, 0, 0));
    test_scene_finish(&scene);
    job_settings_t settings = blob_default_settings(&scene.blob);
    film_t *film = render_here(&scene.blob, &settings);
    film_image_t image;
    film_resolve(film, &image);
    assert_int_equal(film->counts.light_paths[0], 0);
    film_destroy(&film);
    test_scene_end(&scene);
    return image;
}

static double openness(int x, int y)
{
    double scale = tan((double)fov * M_PI / 360), u = scale * ((2.0 * x + 1) / SIDE - 1),
           v = scale * ((2.0 * y + 1) / SIDE - 1), d = sqrt(u * u + v * v + (double)(height * height));
    return 1 - (double)(radius * radius * height) / (d * d * d);
}

static void a_ball_hides_its_form_factor(void **state)
{
    (void)state;
    for (int turned = 0; turned < 2; ++turned) {
        film_image_t image = render(turned, INFINITY, 256);
        double sum = 0, truth = 0, error = 0;
        for (int i = 0; i < SIDE * SIDE; ++i) {
            const float *value = image.sum + 3 * i;
            if (i % SIDE >= EDGE) {
                assert_float_equal(value[0], 0, 0); /* beside the wall */
                continue;
            }
            double noise = (double)image.noise[3 * i + 1];
            sum += (double)value[1];
            truth += openness(i % SIDE, i / SIDE);
            error += noise * noise;
            assert_float_equal(value[0], 4 * value[2], 1e-4f);
            assert_true(fabs((double)value[1] - openness(i % SIDE, i / SIDE)) < 0.15);
        }
        error = sqrt(error);
        if (!(error < 0.01 * truth && fabs(sum - truth) < 4.5 * error))
            fail_msg("turned %d: %g +- %g, not %g", turned, sum, error, truth);
        film_image_free(&image);
    }
}

static void what_is_farther_than_the_distance_hides_nothing(void **state)
{
    (void)state;
    const float nearest = height - radius;
    film_image_t open = render(false, 0.99f * nearest, 16), hidden = render(false, 2 * height, 16);
    double lost = 0;
    for (int i = 0; i < SIDE * SIDE; ++i) {
        if (i % SIDE < EDGE) assert_float_equal(open.sum[3 * i + 1], 1, 1e-6f);
        lost += i % SIDE < EDGE ? 1 - (double)hidden.sum[3 * i + 1] : 0;
    }
    assert_true(lost > 0.3 * SIDE * EDGE);
    film_image_free(&open);
    film_image_free(&hidden);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_ball_hides_its_form_factor),
        cmocka_unit_test(what_is_farther_than_the_distance_hides_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
