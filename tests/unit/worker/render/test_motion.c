/* Transforms that change: their ends, what lies between, and Embree's idea of the same. */
#include "worker/render/scene/motion.h"

#include "client/import/import.h"
#include "common/sampler.h"
#include "tests/scratch.h"
#include "worker/render/scene/scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static float number(uint32_t i, uint32_t dimension)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 31, 0, i);
    sampler.dimension = dimension;
    return 2 * sampler_1d(&sampler) - 1;
}

/* Any matrix that is not close to singular: half of them mirror. */
static bool random_transform(uint32_t i, uint32_t first, xform_t *t)
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 4; c++) t->m[r][c] = number(i, first + (uint32_t)(4 * r + c)) * (c == 3 ? 5 : 2);
    return fabsf(xform_determinant(t)) > 0.3f;
}

static void assert_same(const xform_t *a, const xform_t *b, float tolerance)
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 4; c++) assert_float_equal(a->m[r][c], b->m[r][c], tolerance);
}

static void ends_are_reproduced(void **state)
{
    (void)state;
    int mirrored = 0, all = 0;
    for (uint32_t i = 0; i < 2000; i++) {
        xform_t start, end;
        if (!random_transform(i, 0, &start) || !random_transform(i, 12, &end)) continue;
        motion_t motion = motion_between(&start, &end);
        assert_true(motion.moves);
        xform_t at0 = motion_at(&motion, 0), at1 = motion_at(&motion, 1);
        assert_same(&at0, &start, 2e-5f);
        assert_same(&at1, &end, 2e-5f);
        all++;
        mirrored += xform_determinant(&start) < 0;
        motion = motion_between(&start, &start);
        at0 = motion_at(&motion, 0.3f);
        assert_false(motion.moves);
        assert_memory_equal(&at0, &start, sizeof start);
    }
    assert_true(all > 500 && mirrored > 200);
}

static xform_t turned(float angle, float scale, float x)
{
    float c = scale * cosf(angle), s = scale * sinf(angle);
    return (xform_t){{{c, -s, 0, x}, {s, c, 0, 0}, {0, 0, scale, 2 * x}}};
}

/* Turns go evenly, the shorter way; moves and stretches in a straight line. */
static void between_is_even(void **state)
{
    (void)state;
    const float angles[] = {0.01f, 1, 2.5f, -3};
    for (size_t k = 0; k < sizeof angles / sizeof *angles; k++) {
        xform_t start = turned(0.4f, 1, 0), end = turned(0.4f + angles[k], 3, 4);
        motion_t motion = motion_between(&start, &end);
        for (int i = 0; i <= 8; i++) {
            float time = (float)i / 8;
            xform_t at = motion_at(&motion, time);
            xform_t expected = turned(0.4f + time * angles[k], 1 + 2 * time, 4 * time);
            assert_same(&at, &expected, 2e-5f);
        }
    }
}

/* A hit's point is made from Embree's place on the triangle (or distance to a quadric) and motion_at: it lies
 * on the ray only if both put the instance at the same place. */
static void embree_agrees(void **state)
{
    (void)state;
    static const char text[] =
        "Camera \"perspective\"\nFilm \"image\"\nWorldBegin\n"
        "ObjectBegin \"cube\"\nShape \"trianglemesh\" \"integer indices\" [0 2 1 1 2 3 4 5 6 5 7 6 0 1 4 1 5 "
        "4 2 6 "
        "3 3 6 7 0 4 2 2 4 6 1 3 5 3 7 5] \"point P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 "
        "1 1 "
        "1]\nObjectEnd\n"
        "ObjectBegin \"round\"\nShape \"sphere\" \"float phimax\" [300]\nObjectEnd\n"
        "AttributeBegin\nActiveTransform EndTime\nTranslate 2 1 0\nRotate 110 1 1 0.3\nScale 1 0.5 2\n"
        "ActiveTransform All\nScale 1 0.7 1\nObjectInstance \"cube\"\nAttributeEnd\n"
        "AttributeBegin\nTranslate 6 0 0\nScale -1 1 1\nActiveTransform EndTime\nTranslate 1 1 0\nRotate 170 "
        "0.1 1 "
        "0.3\nActiveTransform All\nRotate 40 1 0 1\nScale 1 2 1\nObjectInstance \"cube\"\nAttributeEnd\n"
        "AttributeBegin\nTranslate -6 0 0\nActiveTransform EndTime\nRotate 1 0 1 0.3\nActiveTransform "
        "All\nObjectInstance \"cube\"\nAttributeEnd\n"
        "AttributeBegin\nTranslate 0 6 0\nScale 1 0.5 -0.7\nActiveTransform EndTime\nTranslate 1 1 0\nRotate "
        "120 0.1 "
        "1 0.3\nActiveTransform All\nObjectInstance \"round\"\nAttributeEnd\n"
        "WorldEnd\n";
    char *folder = scratch_new(), *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, sizeof text - 1);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    scene_t *scene;
    result_t made = import_scene_blob(path, NULL, &bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    assert_int_equal(scene_new(&blob, &scene).code, RESULT_OK);
    assert_true(scene_moves(scene));
    int hits[4] = {0};
    vec3_t centre;
    float radius;
    scene_bounds(scene, &centre, &radius);
    for (uint32_t i = 0; i < 20000; i++) {
        vec3_t from = vec3(12 * number(i, 0), 12 * number(i, 1), 12 * number(i, 2));
        vec3_t to = vec3(8 * number(i, 3), 8 * number(i, 4), 3 * number(i, 5)),
               d = v_normalize(v_sub(to, from));
        float time = 0.5f + 0.5f * number(i, 6);
        surface_t surface;
        if (!scene_intersect(scene, from, d, time, &surface)) continue;
        hits[surface.instance]++;
        vec3_t off = v_sub(surface.p, from);
        float along = v_dot(off, d), aside = v_length(v_mad(off, -along, d));
        if (!(along > 0) || !(aside < 2e-4f))
            fail_msg("instance %u, time %g: %g aside of the ray", surface.instance, (double)time,
                     (double)aside);
        assert_true(v_length(v_sub(surface.p, centre)) <= radius);
        /* The segment to the hit is free, and the one beyond it is not. */
        assert_false(scene_occluded(scene, from, v_mad(surface.p, -2e-3f, d), time, false));
        assert_true(scene_occluded(scene, from, v_mad(surface.p, 2e-3f, d), time, false));
    }
    for (int i = 0; i < 4; i++) assert_true(hits[i] > 100);
    scene_destroy(&scene);
    free(bytes);
    free(path);
    scratch_destroy(&folder);
}

/* A square that rises from z = 0 to 1 by time 0.5, and by time 1 turns up into the plane x = z: its normals
 * with it. */
static void meshes_change_between_their_times(void **state)
{
    (void)state;
    const vec3_t positions[] = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0},   {-1, 1, 0}, {-1, -1, 1}, {1, -1, 1},
                                {1, 1, 1},   {-1, 1, 1}, {-1, -1, 0}, {1, -1, 2}, {1, 1, 2},   {-1, 1, 0}};
    const float half = 0.70710678f;
    const vec3_t up = vec3(0, 0, 1), tilted = vec3(-half, 0, half),
                 normals[] = {up, up, up, up, up, up, up, up, tilted, tilted, tilted, tilted};
    const blob_triangle_t triangles[] = {{{0, 1, 2}}, {{0, 2, 3}}};
    const blob_material_t material = {.kind = MATERIAL_DIFFUSE};
    const blob_scene_t settings = blob_default_scene();
    blob_builder_t *builder = blob_builder_new();
    blob_mesh_t mesh = {.vertex_count = 4, .triangle_count = 2, .steps = 3};
    mesh.first_uv = mesh.first_uv2 = mesh.first_colour = BLOB_NONE;
    mesh.first_position = blob_builder_add(builder, BLOB_SECTION_POSITIONS, positions, 12);
    mesh.first_normal = blob_builder_add(builder, BLOB_SECTION_NORMALS, normals, 12);
    mesh.first_triangle = blob_builder_add(builder, BLOB_SECTION_TRIANGLES, triangles, 2);
    const blob_shape_t shape = {
        .kind = SHAPE_MESH, .light = BLOB_NONE, .alpha = blob_constant(1), .shadow_alpha = blob_constant(1)};
    const blob_object_t world = {.shape_count = 1};
    blob_builder_add(builder, BLOB_SECTION_MESHES, &mesh, 1);
    blob_builder_add(builder, BLOB_SECTION_MATERIALS, &material, 1);
    blob_builder_add(builder, BLOB_SECTION_SHAPES, &shape, 1);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, &world, 1);
    blob_builder_add(builder, BLOB_SECTION_SCENE, &settings, 1);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    scene_t *scene;
    assert_int_equal(blob_builder_finish(builder, &bytes, &size).code, RESULT_OK);
    blob_builder_destroy(&builder);
    result_t opened = blob_open(bytes, size, &blob);
    assert_string_equal(opened.message, "");
    assert_int_equal(scene_new(&blob, &scene).code, RESULT_OK);
    assert_true(scene_moves(scene));
    for (int i = 0; i <= 16; i++) {
        float time = (float)i / 16, tilt = time < 0.5f ? 0 : 2 * time - 1, x = 0.6f;
        float height = time < 0.5f ? 2 * time : 1 + tilt * x;
        surface_t surface;
        surface_details_t details;
        assert_true(scene_intersect(scene, vec3(x, 0.2f, 5), vec3(0, 0, -1), time, &surface));
        assert_float_equal(surface.p.z, height, 1e-5f);
        assert_float_equal(surface.p.x, x, 1e-5f);
        float length = sqrtf(1 + tilt * tilt), nx = -half * tilt, nz = 1 - tilt + half * tilt;
        assert_float_equal(surface.ng.x, -tilt / length, 1e-5f);
        assert_float_equal(surface.ns.x, nx / sqrtf(nx * nx + nz * nz), 1e-5f);
        scene_details(scene, &surface, &details);
        assert_float_equal(v_dot(details.dpdu, surface.ng), 0, 1e-5f);
        assert_true(
            scene_occluded(scene, vec3(x, 0.2f, height + 0.01f), vec3(x, 0.2f, height - 0.01f), time, false));
        assert_false(scene_occluded(scene, vec3(x, 0.2f, 5), vec3(x, 0.2f, height + 0.01f), time, false));
    }
    scene_destroy(&scene);
    free(bytes);
}

/* An axis of a random direction, 1e-10 to 1e10 long, or 0.03 to 30 where `near`. */
static vec3_t random_axis(uint32_t i, uint32_t first, bool near)
{
    vec3_t axis = vec3(number(i, first), number(i, first + 1), number(i, first + 2));
    return v_scale(v_normalize(axis), powf(10, (near ? 1.5f : 10) * number(i, first + 3)));
}

/* Half of them flat: the one axis leans to another, up to a millionth of a right angle. */
static xform_t extreme_transform(uint32_t i, uint32_t first, bool near)
{
    vec3_t axes[3];
    for (uint32_t k = 0; k < 3; k++) axes[k] = random_axis(i, first + 4 * k, near);
    uint32_t flat = i / 4 % 6, from = flat % 3;
    if (flat < 3)
        axes[from] =
            v_add(axes[(from + 1) % 3], v_scale(axes[from], powf(10, -6 * fabsf(number(i, first + 12)))));
    return (xform_t){{{axes[0].x, axes[1].x, axes[2].x, 0},
                      {axes[0].y, axes[1].y, axes[2].y, 0},
                      {axes[0].z, axes[1].z, axes[2].z, 0}}};
}

/* Embree ends the process where its inverse of a transform is not finite. */
static void embree_inverts_all_that_is_let_in(void **state)
{
    (void)state;
    static const char text[] =
        "Camera \"perspective\"\nFilm \"image\"\nWorldBegin\nObjectBegin \"flat\"\n"
        "Shape \"trianglemesh\" \"integer indices\" [0 1 2] \"point P\" [-1 -1 0 1 -1 0 "
        "0 1 0]\nObjectEnd\nObjectInstance \"flat\"\nWorldEnd\n";
    char *folder = scratch_new(), *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, sizeof text - 1);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    assert_int_equal(import_scene_blob(path, NULL, &bytes, &size).code, RESULT_OK);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    assert_int_equal(blob.counts[BLOB_SECTION_INSTANCES], 1);
    int let_in[2] = {0}, refused = 0;
    for (uint32_t i = 0; i < 20000; i++) {
        bool moves = i % 2;
        blob_instance_t instance = {.object = 1, .world_from_object = extreme_transform(i, 0, i / 2 % 2)};
        instance.world_from_object_end =
            moves ? extreme_transform(i, 16, i / 2 % 2) : instance.world_from_object;
        if (!blob_instance_is_traceable(&instance.world_from_object, &instance.world_from_object_end) ||
            (xform_determinant(&instance.world_from_object) < 0) !=
                (xform_determinant(&instance.world_from_object_end) < 0)) {
            refused++;
            continue;
        }
        let_in[moves]++;
        blob.instances = &instance;
        scene_t *scene;
        surface_t surface;
        assert_int_equal(scene_new(&blob, &scene).code, RESULT_OK);
        for (uint32_t k = 0; k < 16; k++) {
            vec3_t from = vec3(number(k, 32), number(k, 33), number(k, 34)),
                   to = v_scale(random_axis(k, 35, true), 0.1f);
            scene_intersect(scene, from, v_normalize(v_sub(to, from)), 0.5f + 0.5f * number(k, 39), &surface);
        }
        scene_destroy(&scene);
    }
    assert_true(let_in[0] > 1000 && let_in[1] > 1000 && refused > 1000);
    free(bytes);
    free(path);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ends_are_reproduced),
        cmocka_unit_test(between_is_even),
        cmocka_unit_test(embree_agrees),
        cmocka_unit_test(meshes_change_between_their_times),
        cmocka_unit_test(embree_inverts_all_that_is_let_in),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
