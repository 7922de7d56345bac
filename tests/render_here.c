/* render_here: see render_here.h. */
#include "tests/render_here.h"

#include "master/schedule/next_round.h"
#include "master/schedule/schedule.h"
#include "tests/films.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

static void check(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

void plan_here(renderer_t *renderer, const job_settings_t *settings, uint32_t pass, const int64_t *lessons)
{
    if (!job_learns(settings) || learning_teachers(pass) == 0) return;
    hash_t content = {{0}};
    learning_plan_t plan;
    uint8_t *bytes = mem_alloc(learning_plan_bytes());
    learning_plan_write(pass, lessons, &content, 0, bytes, learning_plan_bytes());
    check(learning_plan_read(bytes, learning_plan_bytes(), &content, &plan));
    renderer_plan(renderer, &plan);
    free(bytes);
}

/* All samples of a pass; of a job that does not learn, all samples. */
static void render_pass(const renderer_t *renderer, uint32_t pass, batch_t *batch)
{
    const job_settings_t *settings = &batch->settings;
    uint32_t begin = 0, end = settings->spp;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    if (job_learns(settings)) {
        begin = learning_pass_begin(settings, pass);
        if (learning_pass_begin(settings, pass + 1) < end) end = learning_pass_begin(settings, pass + 1);
    }
    while (begin < end) {
        uint32_t run_end = job_run_end(settings, begin) < end ? job_run_end(settings, begin) : end;
        for (uint32_t tile = 0; tile < job_tile_count(settings); tile++) {
            unit_t unit = {tile, begin, run_end - begin};
            assert_true(renderer_unit(renderer, &unit, &result, &cancel));
            batch_add(batch, &result);
        }
        begin = run_end;
    }
    unit_result_free(&result);
}

void render_batch_here(const scene_blob_t *blob, const job_settings_t *settings, batch_t *batch)
{
    renderer_t *renderer;
    check(job_settings_check(settings));
    check(renderer_new(blob, settings, &renderer));
    batch_init(batch, settings);
    uint32_t last = job_learns(settings) ? learning_pass(settings, settings->spp - 1) : 0;
    for (uint32_t pass = 0; pass <= last; pass++) {
        plan_here(renderer, settings, pass, job_learns(settings) ? batch_frame(batch, SUM_LESSONS) : NULL);
        render_pass(renderer, pass, batch);
    }
    renderer_destroy(&renderer);
}

film_t *film_of_batch(batch_t *batch)
{
    film_t *film;
    check(film_new(&batch->settings, &film));
    check(merge_as_master(film, batch, NULL, 1));
    batch_free(batch);
    return film;
}

film_t *render_here(const scene_blob_t *blob, const job_settings_t *settings)
{
    batch_t batch;
    render_batch_here(blob, settings, &batch);
    return film_of_batch(&batch);
}

static void render_weighted(const renderer_t *renderer, film_t *film, schedule_t *schedule,
                            const unit_t *unit)
{
    unit_result_t result = {0};
    batch_t batch;
    atomic_bool cancel = false;
    uint32_t weight = schedule_weight(schedule, unit);
    batch_init(&batch, &film->settings);
    assert_true(renderer_unit(renderer, unit, &result, &cancel));
    batch_add(&batch, &result);
    check(merge_as_master(film, &batch, &weight, 1));
    check(schedule_accept(schedule, unit, 1));
    unit_result_free(&result);
    batch_free(&batch);
}

/* Everything that the open rounds and passes allow. */
static void render_open(const renderer_t *renderer, film_t *film, schedule_t *schedule, uint64_t unit_samples,
                        size_t stride)
{
    unit_t units[64];
    schedule_wish_t wish = {1, UINT64_MAX, unit_samples, 1, 1};
    for (size_t n; (n = schedule_take(schedule, &wish, units, ARRAY_LENGTH(units))) > 0;)
        for (size_t first = 0; first < stride; first++)
            for (size_t i = first; i < n; i += stride) render_weighted(renderer, film, schedule, &units[i]);
}

/* Everything that the open rounds allow, pass by pass. */
static void render_round(renderer_t *renderer, film_t *film, schedule_t *schedule, uint64_t unit_samples,
                         size_t stride)
{
    render_open(renderer, film, schedule, unit_samples, stride);
    for (uint32_t pass; (pass = schedule_next_pass(schedule)) > 0;) {
        plan_here(renderer, &film->settings, pass, film->sums[SUM_LESSONS]);
        schedule_teach(schedule);
        film->settled = learning_teachers(pass);
        schedule_open_pass(schedule);
        render_open(renderer, film, schedule, unit_samples, stride);
    }
}

film_t *render_planned(const scene_blob_t *blob, const job_settings_t *settings, uint64_t unit_samples,
                       size_t stride, planned_t *planned)
{
    renderer_t *renderer;
    film_t *film;
    uint32_t tiles = job_tile_count(settings);
    size_t pixels = (size_t)settings->width * (size_t)settings->height;
    check(job_settings_check(settings));
    check(renderer_new(blob, settings, &renderer));
    check(film_new(settings, &film));
    schedule_t *schedule = schedule_new(settings);
    round_t last = {mem_zalloc(tiles, sizeof(uint32_t)), mem_zalloc(tiles, sizeof(uint32_t))},
            next = {mem_zalloc(tiles, sizeof(uint32_t)), mem_zalloc(tiles, sizeof(uint32_t))};
    *planned = (planned_t){.shown = mem_zalloc(pixels, sizeof(float))};
    for (; next_round(settings, planned->rounds, planned->rounds > 0 ? &last : NULL, film, &next,
                      &planned->error) == ROUND_NEXT;
         planned->rounds++) {
        schedule_open_round(schedule, next.ends, next.weights);
        render_round(renderer, film, schedule, unit_samples, stride);
        assert_true(schedule_round_counted(schedule));
        round_t done = last;
        last = next;
        next = done;
    }
    planned->samples = (double)schedule_done(schedule) / (double)pixels;
    uint32_t *samples = mem_alloc(tiles * sizeof *samples);
    schedule_tile_samples(schedule, samples);
    schedule_show_samples(settings, samples, 0, settings->height, planned->shown);
    uint32_t *arrays[] = {last.ends, last.weights, next.ends, next.weights, samples};
    for (size_t i = 0; i < ARRAY_LENGTH(arrays); i++) free(arrays[i]);
    schedule_destroy(&schedule);
    renderer_destroy(&renderer);
    return film;
}

test_scene_t test_scene_begin(vec3_t eye, float fov, int resolution)
{
    test_scene_t scene = {.builder = blob_builder_new()};
    xform_t world_from_camera = {{{1, 0, 0, eye.x}, {0, 1, 0, eye.y}, {0, 0, 1, eye.z}}};
    blob_scene_t record = {.camera = CAMERA_PERSPECTIVE,
                           .world_from_camera = world_from_camera,
                           .world_from_camera_end = world_from_camera,
                           .fov = fov,
                           .focal_distance = 1,
                           .film_window = {0, 1, 0, 1},
                           .max_luminance = INFINITY,
                           .occlusion_distance = INFINITY,
                           .occlusion_radiance = {1, 1, 1},
                           .filter = {.kind = FILTER_BOX, .radius_x = 0.5f, .radius_y = 0.5f},
                           .width = resolution,
                           .height = resolution,
                           .max_depth = 8,
                           .spp = 16,
                           .integrator = INTEGRATOR_BDPT,
                           .sampler = SAMPLER_SOBOL};
    blob_builder_add(scene.builder, BLOB_SECTION_SCENE, &record, 1);
    return scene;
}

uint32_t test_scene_material(test_scene_t *scene, blob_material_t material)
{
    return blob_builder_add(scene->builder, BLOB_SECTION_MATERIALS, &material, 1);
}

static void add_shape(test_scene_t *scene, shape_kind_t kind, uint32_t geometry, uint32_t material,
                      rgb_t radiance)
{
    uint32_t index = blob_builder_count(scene->builder, BLOB_SECTION_SHAPES), light = BLOB_NONE;
    if (!v_is_zero(radiance))
        light = blob_builder_add(scene->builder, BLOB_SECTION_LIGHTS,
                                 &(blob_light_t){.kind = LIGHT_AREA,
                                                 .radiance = blob_colour_value(radiance),
                                                 .shape = index,
                                                 .world_from_light = xform_identity()},
                                 1);
    blob_shape_t shape = {.kind = kind,
                          .geometry = geometry,
                          .material = material,
                          .light = light,
                          .alpha = blob_constant(1),
                          .shadow_alpha = blob_constant(1)};
    blob_builder_add(scene->builder, BLOB_SECTION_SHAPES, &shape, 1);
}

static void add_mesh(test_scene_t *scene, const vec3_t *positions, uint32_t vertices,
                     const blob_triangle_t *triangles, uint32_t count, uint32_t material, rgb_t radiance)
{
    blob_mesh_t mesh = {.vertex_count = vertices,
                        .first_normal = BLOB_NONE,
                        .first_uv = BLOB_NONE,
                        .first_uv2 = BLOB_NONE,
                        .first_colour = BLOB_NONE,
                        .triangle_count = count};
    mesh.first_position = blob_builder_add(scene->builder, BLOB_SECTION_POSITIONS, positions, vertices);
    mesh.first_triangle = blob_builder_add(scene->builder, BLOB_SECTION_TRIANGLES, triangles, count);
    add_shape(scene, SHAPE_MESH, blob_builder_add(scene->builder, BLOB_SECTION_MESHES, &mesh, 1), material,
              radiance);
}

void test_scene_rectangle(test_scene_t *scene, vec3_t p, vec3_t e1, vec3_t e2, uint32_t material,
                          rgb_t radiance)
{
    const vec3_t positions[] = {p, v_add(p, e1), v_add(p, v_add(e1, e2)), v_add(p, e2)};
    const blob_triangle_t triangles[] = {{{0, 1, 2}}, {{0, 2, 3}}};
    add_mesh(scene, positions, 4, triangles, 2, material, radiance);
}

void test_scene_room(test_scene_t *scene, vec3_t low, vec3_t high, uint32_t material, rgb_t radiance)
{
    vec3_t positions[8];
    for (int i = 0; i < 8; i++)
        positions[i] = vec3(i & 1 ? high.x : low.x, i & 2 ? high.y : low.y, i & 4 ? high.z : low.z);
    static const blob_triangle_t triangles[12] = {{{0, 1, 2}}, {{1, 3, 2}}, {{4, 6, 5}}, {{5, 6, 7}},
                                                  {{0, 4, 1}}, {{1, 4, 5}}, {{2, 3, 6}}, {{3, 7, 6}},
                                                  {{0, 2, 4}}, {{2, 6, 4}}, {{1, 5, 3}}, {{3, 5, 7}}};
    add_mesh(scene, positions, 8, triangles, 12, material, radiance);
}

void test_scene_sphere(test_scene_t *scene, vec3_t centre, float radius, uint32_t material, rgb_t radiance)
{
    blob_quadric_t sphere = {
        .kind = QUADRIC_SPHERE,
        .object_from_quadric = {{{1, 0, 0, centre.x}, {0, 1, 0, centre.y}, {0, 0, 1, centre.z}}},
        .radius = radius,
        .z_min = -radius,
        .z_max = radius,
        .phi_max = TWO_PI_F};
    add_shape(scene, SHAPE_QUADRIC, blob_builder_add(scene->builder, BLOB_SECTION_QUADRICS, &sphere, 1),
              material, radiance);
}

void test_scene_finish(test_scene_t *scene)
{
    blob_object_t world = {0, blob_builder_count(scene->builder, BLOB_SECTION_SHAPES)};
    blob_builder_add(scene->builder, BLOB_SECTION_OBJECTS, &world, 1);
    uint64_t size;
    check(blob_builder_finish(scene->builder, &scene->bytes, &size));
    check(blob_open(scene->bytes, size, &scene->blob));
}

void test_scene_end(test_scene_t *scene)
{
    blob_builder_destroy(&scene->builder);
    free(scene->bytes);
    *scene = (test_scene_t){0};
}
