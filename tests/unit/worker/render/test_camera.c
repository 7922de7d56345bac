/* Cameras with lenses: what is sharp, densities, and that all integrators see the same through them. */
#include "worker/render/camera/camera.h"

#include "tests/quarters.h"
#include "tests/render_here.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { WIDTH = 60, HEIGHT = 40 };

/* A camera with a lens, moved, turned, and with `stretch` made unequal along its axes. */
static blob_scene_t lens_record(camera_kind_t kind, float stretch)
{
    blob_scene_t record = blob_default_scene();
    record.camera = kind;
    record.world_from_camera =
        (xform_t){{{-stretch, 0, 0, 2}, {0, 0.8f, -0.6f / stretch, 1}, {0, 0.6f, 0.8f / stretch, -3}}};
    record.world_from_camera_end = record.world_from_camera;
    record.fov = 50;
    record.lens_radius = 1;
    record.focal_distance = 3;
    return record;
}

static float distance_between(vec3_t a, vec3_t b)
{
    return v_length(v_sub(a, b));
}

/* Where the ray is in the plane of focus. */
static vec3_t focus_of(const camera_ray_t *ray, const blob_scene_t *record)
{
    xform_t camera_from_world;
    assert_true(xform_invert(&record->world_from_camera, &camera_from_world));
    vec3_t o = xform_point(&camera_from_world, ray->origin),
           d = xform_vector(&camera_from_world, ray->direction);
    return v_mad(o, (record->focal_distance - o.z) / d.z, d);
}

static const camera_kind_t lens_kinds[] = {CAMERA_PERSPECTIVE, CAMERA_ORTHOGRAPHIC};

static void rays_of_a_pixel_meet_in_focus(void **state)
{
    (void)state;
    const vec2_t raster = {13.5f, 30};
    for (size_t k = 0; k < ARRAY_LENGTH(lens_kinds); ++k) {
        blob_scene_t record = lens_record(lens_kinds[k], 1);
        camera_t *camera = camera_new(&(scene_blob_t){.scene = &record}, WIDTH, HEIGHT);
        assert_true(camera_has_lens(camera));
        camera_ray_t ray, other;
        camera_ray(camera, raster, (vec2_t){0.5f, 0.5f}, 0, &ray);
        for (int i = 0; i < 16; ++i) {
            vec2_t lens = {(float)(i % 4) / 4, (float)(i / 4) / 4};
            camera_ray(camera, raster, lens, 0, &other);
            assert_true(distance_between(focus_of(&ray, &record), focus_of(&other, &record)) < 1e-5f);
            assert_true(distance_between(ray.origin, other.origin) <= 1.0001f * record.lens_radius);
        }
        assert_true(distance_between(ray.origin, other.origin) > 0.3f);
        free(camera);
    }
}

/* What camera_project says of a point on a ray is what the ray was. */
static void projection_undoes_rays(void **state)
{
    (void)state;
    for (size_t k = 0; k < 2 * ARRAY_LENGTH(lens_kinds); ++k) {
        blob_scene_t record = lens_record(lens_kinds[k / 2], k % 2 ? 1.7f : 1);
        camera_t *camera = camera_new(&(scene_blob_t){.scene = &record}, WIDTH, HEIGHT);
        for (int i = 0; i < 64; ++i) {
            vec2_t raster = {(float)i * 0.9f, (float)(i % 8) * 4.5f},
                   lens = {(float)i / 64, (float)(i % 7) / 7};
            camera_ray_t ray;
            camera_view_t view;
            camera_ray(camera, raster, lens, 0, &ray);
            vec3_t p = v_mad(ray.origin, 2.5f, ray.direction);
            assert_true(camera_project(camera, p, lens, 0, 1, &view));
            assert_float_equal(view.raster.x, raster.x, 1e-3f);
            assert_float_equal(view.raster.y, raster.y, 1e-3f);
            assert_true(distance_between(view.position, ray.origin) < 1e-5f);
            assert_float_equal(v_dot(view.w, ray.direction), -1, 1e-5f);
            float spread = ray.parallel ? 1 : 2.5f * 2.5f;
            assert_float_equal(view.density * spread / ray.pdf, 1, 1e-4f);
        }
        free(camera);
    }
}

/* Through each point of the lens, densities of rays over all of a plane before the camera add up to one. */
static void densities_are_of_the_whole_film(void **state)
{
    (void)state;
    enum { CELLS = 400 };
    const float side = 16;
    for (size_t k = 0; k < 2 * ARRAY_LENGTH(lens_kinds); ++k) {
        blob_scene_t record = lens_record(lens_kinds[k / 2], k % 2 ? 1.7f : 1);
        camera_t *camera = camera_new(&(scene_blob_t){.scene = &record}, WIDTH, HEIGHT);
        const xform_t *t = &record.world_from_camera;
        vec3_t ex = xform_vector(t, vec3(side / CELLS, 0, 0)), ey = xform_vector(t, vec3(0, side / CELLS, 0)),
               area = v_cross(ex, ey);
        double sum = 0;
        for (int i = 0; i < CELLS * CELLS; ++i) {
            vec3_t q = vec3(((float)(i % CELLS) + 0.5f) / CELLS - 0.5f,
                            ((float)(i / CELLS) + 0.5f) / CELLS - 0.5f, 4 / side);
            camera_view_t view;
            if (camera_project(camera, xform_point(t, v_scale(q, side)), (vec2_t){0.9f, 0.2f}, 0, 0, &view))
                sum += (double)(view.density * fabsf(v_dot(area, view.w)));
        }
        if (!(fabs(sum - 1) < 0.01)) fail_msg("camera %zu: the densities add up to %g", k, sum);
        free(camera);
    }
}

/* ---- pictures ------------------------------------------------------------------------------------------ */

enum { SIDE = 16 };

/* A room with a lamp at its ceiling and a ball, seen by such a camera. */
static test_scene_t room_before(camera_kind_t kind)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, SIDE);
    blob_scene_t *record = blob_builder_records(scene.builder, BLOB_SECTION_SCENE);
    record->camera = kind;
    record->lens_radius = 0.1f;
    record->focal_distance = 1;
    record->max_depth = 3;
    const float window[4] = {-0.7f, 0.7f, -0.7f, 0.7f};
    if (kind == CAMERA_ORTHOGRAPHIC) memcpy(record->screen_window, window, sizeof window);
    blob_material_t grey = {.kind = MATERIAL_DIFFUSE};
    grey.values[VALUE_REFLECTANCE] = blob_constant(0.6f);
    uint32_t wall = test_scene_material(&scene, grey);
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, vec3(0, 0, 0));
    test_scene_rectangle(&scene, vec3(-0.5f, 0.95f, -0.2f), vec3(0.6f, 0, 0), vec3(0, 0, 0.6f), wall,
                         vec3(5, 5, 5));
    test_scene_sphere(&scene, vec3(-0.3f, -0.4f, 0.3f), 0.4f, wall, vec3(0, 0, 0));
    test_scene_finish(&scene);
    return scene;
}

static void integrators_agree_through_lenses(void **state)
{
    (void)state;
    for (size_t k = 0; k < ARRAY_LENGTH(lens_kinds); ++k) {
        test_scene_t scene = room_before(lens_kinds[k]);
        quarters_t path = quarters_of(&scene.blob, INTEGRATOR_PATH, 64),
                   bdpt = quarters_of(&scene.blob, INTEGRATOR_BDPT, 32),
                   light = quarters_of(&scene.blob, INTEGRATOR_LIGHT, 256);
        quarters_expect_same("bdpt", &bdpt, &path, 0.05);
        quarters_expect_same("light", &light, &path, 0.05);
        test_scene_end(&scene);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rays_of_a_pixel_meet_in_focus),
        cmocka_unit_test(projection_undoes_rays),
        cmocka_unit_test(densities_are_of_the_whole_film),
        cmocka_unit_test(integrators_agree_through_lenses),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
