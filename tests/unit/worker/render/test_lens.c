/* A camera behind a lens of elements: against the thin lens and the pinhole that simple ones come near to,
 * against pbrt's formula for its weights, and all integrators against one another. */
#include "client/import/scene/lens.h"
#include "common/sampler.h"
#include "tests/quarters.h"
#include "tests/render_here.h"
#include "worker/render/camera/camera.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 16 };

/* A glass of focal length 100 mm, so thin that it is a thin lens, with a stop on its film's side. */
static const blob_lens_element_t glass_and_stop[] = {
    {0.1f, 4e-4f, 1.5f, 0.006f}, {-0.1f, 1e-5f, 1, 0.006f}, {0, 0, 1, 0.004f}};
/* The stop stands apart, so pupils move and are cut off towards the film's corners. */
static const blob_lens_element_t stop_apart[] = {{0.1f, 0.006f, 1.5f, 0.01f},
                                                 {-0.1f, 0.012f, 1, 0.009f},
                                                 {0, 0.004f, 1, 0.005f},
                                                 {-0.3f, 0.002f, 1.6f, 0.008f},
                                                 {0.5f, 0, 1, 0.008f}};

/* A scene record and view for camera_new. */
typedef struct {
    blob_scene_t record;
    blob_lens_element_t elements[8];
    blob_pupil_t pupils[LENS_PUPILS];
    scene_blob_t blob;
    lens_t lens;
} optics_t;

static const float film = 0.03f, distance = 1; /* the square film's side; of the plane in focus */

static void focus(optics_t *o, const blob_lens_element_t *elements, uint32_t count, float stop)
{
    *o = (optics_t){.record = blob_default_scene()};
    memcpy(o->elements, elements, count * sizeof *elements);
    o->lens = (lens_t){.elements = o->elements, .count = count};
    double thickness;
    for (uint32_t i = 0; i < count; i++)
        if (o->elements[i].curvature_radius == 0 && stop > 0) o->elements[i].aperture_radius = stop;
    assert_string_equal(lens_focus(&o->lens, 4e-5, (double)distance, &thickness).message, "");
    o->elements[count - 1].thickness = (float)thickness;
    assert_true(lens_find_pupils(&o->lens, (double)film * M_SQRT1_2, o->pupils));
    o->record.camera = CAMERA_REALISTIC;
    const float window[4] = {-film / 2, film / 2, -film / 2, film / 2},
                rear = o->elements[count - 1].thickness;
    memcpy(o->record.screen_window, window, sizeof window);
    o->record.lens_exposure = 1 / (rear * rear);
    o->blob = (scene_blob_t){.scene = &o->record, .lens = o->elements, .pupils = o->pupils};
    o->blob.counts[BLOB_SECTION_LENS] = count;
    o->blob.counts[BLOB_SECTION_PUPILS] = LENS_PUPILS;
}

static vec2_t pair(uint32_t i)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
    return sampler_2d(&sampler);
}

/* Where the ray is at z. */
static vec3_t at_depth(const camera_ray_t *ray, float z)
{
    return v_mad(ray->origin, (z - ray->origin.z) / ray->direction.z, ray->direction);
}

/* How far rays of a place on the film spread about their mean, at a depth; *mean receives it. */
static float spread_at(const camera_t *camera, vec2_t raster, float z, vec3_t *mean)
{
    enum { RAYS = 200 };
    vec3_t sum = vec3(0, 0, 0);
    float sum2 = 0;
    int count = 0;
    for (uint32_t i = 0; i < RAYS; i++) {
        camera_ray_t ray;
        camera_ray(camera, raster, pair(i), 0, &ray);
        assert_false(ray.joinable);
        if (ray.weight == 0) continue;
        vec3_t p = at_depth(&ray, z);
        sum = v_add(sum, p);
        sum2 += v_length2(p);
        count++;
    }
    assert_true(count > RAYS / 4);
    *mean = v_scale(sum, 1 / (float)count);
    return sqrtf(float_max(0, sum2 / (float)count - v_length2(*mean)));
}

/* Its place in the plane in focus is that of a thin lens, and its blur elsewhere. */
static void a_simple_glass_is_a_thin_lens(void **state)
{
    (void)state;
    optics_t o;
    focus(&o, glass_and_stop, 3, 0);
    camera_t *camera = camera_new(&o.blob, SIDE, SIDE);
    assert_true(camera_has_lens(camera));
    double behind = (1 - sqrt(1 - 4 * 0.1)) / 2; /* 1 / b + 1 / (1 - b) = 1 / 0.1 */
    assert_float_equal((float)lens_rear(&o.lens), (float)behind, 4e-4f);
    for (int i = 0; i < 4; i++) {
        vec2_t raster = {8 + 0.7f * (float)i, 8 - 0.3f * (float)i}; /* where a single glass is sharp */
        vec3_t sharp, blurred;
        float in_focus = spread_at(camera, raster, distance, &sharp),
              before = spread_at(camera, raster, distance / 2, &blurred);
        float scale = film / SIDE * (distance - (float)behind) / (float)behind;
        assert_float_equal(sharp.x, scale * (raster.x - 8), 0.01f * scale * SIDE);
        assert_float_equal(sharp.y, scale * (8 - raster.y), 0.01f * scale * SIDE);
        /* A disc of radius r seen from its middle spreads by r / sqrt(2). */
        float expected = 0.004f * 0.5f / (1 - (float)behind) / sqrtf(2);
        assert_float_equal(before, expected, 0.1f * expected);
        assert_true(in_focus < 0.1f * before);
    }
    free(camera);
}

static void a_small_stop_is_a_pinhole(void **state)
{
    (void)state;
    optics_t o;
    focus(&o, glass_and_stop, 3, 6e-5f);
    camera_t *camera = camera_new(&o.blob, SIDE, SIDE);
    float rear = (float)lens_rear(&o.lens);
    blob_scene_t record = blob_default_scene();
    record.fov = 2 * atanf(film / 2 / rear) * 180 / PI_F;
    camera_t *pinhole = camera_new(&(scene_blob_t){.scene = &record}, SIDE, SIDE);
    int seen = 0;
    for (uint32_t i = 0; i < 400; i++) {
        vec2_t raster = {SIDE * pair(1000 + i).x, SIDE * pair(1000 + i).y};
        camera_ray_t ray, other;
        camera_ray(camera, raster, pair(i), 0, &ray);
        camera_ray(pinhole, raster, (vec2_t){0, 0}, 0, &other);
        if (ray.weight == 0) continue;
        assert_true(v_length(v_sub(ray.direction, other.direction)) < 2e-3f);
        seen++;
    }
    assert_true(seen > 100);
    free(camera);
    free(pinhole);
}

/* ---- weights ------------------------------------------------------------------------------------------- */

static double mean_weight(const camera_t *camera, vec2_t raster)
{
    enum { RAYS = 4096 };
    double sum = 0;
    for (uint32_t i = 0; i < RAYS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_SOBOL, 3, 0, i);
        camera_ray_t ray;
        camera_ray(camera, raster, sampler_2d(&sampler), 0, &ray);
        sum += (double)ray.weight / RAYS;
    }
    return sum;
}

/* The irradiance under a disc of radiance 1 at the rear of the lens: its area times cos^4 over its distance
 * squared. */
static void weights_are_the_films_irradiance(void **state)
{
    (void)state;
    optics_t o;
    focus(&o, glass_and_stop, 3, 0);
    camera_t *camera = camera_new(&o.blob, SIDE, SIDE);
    double rear = lens_rear(&o.lens), disc = M_PI * 0.004 * 0.004;
    for (int i = 0; i <= 8; i += 4) {
        double off = (double)film / SIDE * i * M_SQRT2, cos2 = 1 / (1 + off * off / (rear * rear));
        double truth = disc / (rear * rear) * cos2 * cos2,
               mean = mean_weight(camera, (vec2_t){8 + (float)i, 8 + (float)i});
        if (!(fabs(mean - truth) < 0.02 * truth)) fail_msg("%d pixels off: %g, not %g", i, mean, truth);
    }
    free(camera);
}

/* By hand, on a grid over all of the rear: through whatever is in the way. */
static double irradiance(const lens_t *lens, double off)
{
    enum { CELLS = 200 };
    double side = 3 * (double)lens->elements[lens->count - 1].aperture_radius, z = lens_rear(lens), sum = 0;
    for (int i = 0; i < CELLS * CELLS; i++) {
        double x = side * ((i % CELLS + 0.5) / CELLS - 0.5), y = side * ((i / CELLS + 0.5) / CELLS - 0.5);
        lens_ray_t ray = {{off, 0, 0}, {x - off, y, z}};
        double cos2 = z * z / (z * z + (x - off) * (x - off) + y * y);
        if (lens_trace_from_film(lens, &ray) > 0)
            sum += cos2 * cos2 * side * side / (CELLS * CELLS) / (z * z);
    }
    return sum;
}

/* Nothing of the light is lost beside the boxes of the pupils, wherever on the film and turned as they may
 * be. */
static void boxes_hold_their_pupils(void **state)
{
    (void)state;
    optics_t o;
    focus(&o, stop_apart, ARRAY_LENGTH(stop_apart), 0);
    camera_t *camera = camera_new(&o.blob, SIDE, SIDE);
    double before = INFINITY;
    for (int i = 0; i < 8; i += 2) {
        double along = (double)film / SIDE * i, truth = irradiance(&o.lens, along),
               corner = irradiance(&o.lens, along * M_SQRT2);
        double right = mean_weight(camera, (vec2_t){8 + (float)i, 8}),
               up = mean_weight(camera, (vec2_t){8, 8 - (float)i}),
               diagonal = mean_weight(camera, (vec2_t){8 - (float)i, 8 - (float)i});
        if (!(fabs(right - truth) < 0.02 * truth && fabs(up - truth) < 0.02 * truth &&
              fabs(diagonal - corner) < 0.02 * corner))
            fail_msg("%d pixels off: %g %g, not %g; %g, not %g", i, right, up, truth, diagonal, corner);
        assert_true(corner < before);
        before = corner;
    }
    free(camera);
}

static void an_aperture_weighs_what_passes(void **state)
{
    (void)state;
    const float half[] = {0, 1, 0, 1}; /* open for y < 0 alone, see blob_scene_t and blob_image_t */
    optics_t o;
    focus(&o, glass_and_stop, 3, 0);
    o.lens.aperture = half;
    o.lens.aperture_width = o.lens.aperture_height = 2;
    lens_ray_t below = {{0, 0, 0}, {0, -0.002, lens_rear(&o.lens)}},
               above = {{0, 0, 0}, {0, 0.0021, lens_rear(&o.lens)}},
               middle = {{0, 0, 0}, {0, 0, lens_rear(&o.lens)}},
               outside = {{0, 0, 0}, {0, -0.0061, lens_rear(&o.lens)}};
    assert_float_equal(lens_trace_from_film(&o.lens, &below), 1, 1e-5f);
    assert_float_equal(lens_trace_from_film(&o.lens, &above), 0, 0);
    assert_float_equal(lens_trace_from_film(&o.lens, &middle), 0.5f, 1e-5f);
    assert_float_equal(lens_trace_from_film(&o.lens, &outside), 0, 0);
}

static void lenses_that_do_not_focus_are_told(void **state)
{
    (void)state;
    double thickness;
    blob_lens_element_t e[3];
    memcpy(e, glass_and_stop, sizeof e);
    lens_t lens = {.elements = e, .count = 3};
    assert_non_null(
        strstr(lens_focus(&lens, 4e-5, 0.3, &thickness).message, "cannot focus on 0.3: the nearest is 0."));
    e[2].aperture_radius = 1e-6f;
    assert_non_null(strstr(lens_focus(&lens, 4e-5, 1, &thickness).message, "lets no ray through"));
    memcpy(e, glass_and_stop, sizeof e);
    e[0].curvature_radius = -0.1f, e[1].curvature_radius = 0.1f;
    assert_non_null(strstr(lens_focus(&lens, 4e-5, 1, &thickness).message, "spreads it"));
    e[0].eta = 1;
    assert_int_equal(lens_focus(&lens, 4e-5, 1, &thickness).code, RESULT_INPUT);
}

/* ---- pictures ------------------------------------------------------------------------------------------ */

/* A room with a lamp close before its wall, where light subpaths are dense, so that weights must know what
 * does not exist; `glow`: all of its walls shine, and nothing is reflected. */
static test_scene_t room_behind(const optics_t *o, bool glow)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, SIDE);
    blob_scene_t *record = blob_builder_records(scene.builder, BLOB_SECTION_SCENE);
    record->camera = CAMERA_REALISTIC;
    record->max_depth = 3;
    record->lens_exposure = 400 * o->record.lens_exposure;
    memcpy(record->screen_window, o->record.screen_window, sizeof record->screen_window);
    blob_builder_add(scene.builder, BLOB_SECTION_LENS, o->elements, o->lens.count);
    blob_builder_add(scene.builder, BLOB_SECTION_PUPILS, o->pupils, LENS_PUPILS);
    blob_material_t grey = {.kind = MATERIAL_DIFFUSE};
    grey.values[VALUE_REFLECTANCE] = blob_constant(glow ? 0 : 0.7f);
    uint32_t wall = test_scene_material(&scene, grey);
    rgb_t black = vec3(0, 0, 0);
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, glow ? vec3(1, 1, 1) : black);
    if (!glow) {
        test_scene_rectangle(&scene, vec3(-0.05f, -0.05f, 0.85f), vec3(0.1f, 0, 0), vec3(0, 0.1f, 0), wall,
                             vec3(30, 30, 30));
        test_scene_sphere(&scene, vec3(0.1f, 0.1f, 0.5f), 0.05f, wall, black);
    }
    test_scene_finish(&scene);
    return scene;
}

static void integrators_agree_behind_a_lens(void **state)
{
    (void)state;
    optics_t o;
    focus(&o, stop_apart, ARRAY_LENGTH(stop_apart), 0);
    test_scene_t scene = room_behind(&o, false);
    quarters_t path = quarters_of(&scene.blob, INTEGRATOR_PATH, 128),
               bdpt = quarters_of(&scene.blob, INTEGRATOR_BDPT, 128);
    quarters_expect_same("bdpt", &bdpt, &path, 0.03);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.integrator = INTEGRATOR_LIGHT;
    renderer_t *renderer;
    assert_non_null(strstr(renderer_new(&scene.blob, &settings, &renderer).message, "use bdpt or path"));
    assert_null(renderer);
    test_scene_end(&scene);
}

/* A room that glows by 1 all around shows the weights themselves. */
static void a_glowing_room_shows_the_weights(void **state)
{
    (void)state;
    optics_t o;
    focus(&o, stop_apart, ARRAY_LENGTH(stop_apart), 0);
    double truth = 0;
    for (int i = 0; i < SIDE * SIDE / 4; i++)
        truth += 400 * irradiance(&o.lens, (double)film / SIDE * hypot(i % 8 + 0.5, i / 8 + 0.5)) /
                 (SIDE * SIDE / 4.0);
    test_scene_t scene = room_behind(&o, true);
    quarters_t bdpt = quarters_of(&scene.blob, INTEGRATOR_BDPT, 64);
    for (int i = 0; i < QUARTERS; ++i)
        if (!(fabs(bdpt.mean[i] - truth) < 0.02 * truth))
            fail_msg("quarter %d: %g, not %g", i, bdpt.mean[i], truth);
    test_scene_end(&scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_simple_glass_is_a_thin_lens),
        cmocka_unit_test(a_small_stop_is_a_pinhole),
        cmocka_unit_test(weights_are_the_films_irradiance),
        cmocka_unit_test(boxes_hold_their_pupils),
        cmocka_unit_test(an_aperture_weighs_what_passes),
        cmocka_unit_test(lenses_that_do_not_focus_are_told),
        cmocka_unit_test(integrators_agree_behind_a_lens),
        cmocka_unit_test(a_glowing_room_shows_the_weights),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
