/* The scene builder as a reader of a new format meets it. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/scene/mesh.h"
#include "client/import/scene/scene_defaults.h"
#include "client/import/scene/scene_images.h"

static const position_t here = {"scene.new", 3, 1};

/* A builder with what it stands on. */
typedef struct {
    report_t report;
    blob_builder_t *blob;
    scene_builder_t scene;
} site_t;

static void open_site(site_t *site)
{
    site->report = report_begin(NULL);
    site->blob = blob_builder_new();
    scene_begin(&site->scene, site->blob, &site->report);
}

static void close_site(site_t *site)
{
    scene_end(&site->scene);
    blob_builder_destroy(&site->blob);
}

/* A unit square at z = 0, in an object. */
static void add_square(site_t *site, uint32_t object, uint32_t material)
{
    mesh_t mesh = {.vertex_count = 4, .triangle_count = 2};
    mesh.positions = mem_alloc(4 * sizeof *mesh.positions);
    mesh.triangles = mem_alloc(2 * sizeof *mesh.triangles);
    for (int i = 0; i < 4; ++i) mesh.positions[i] = vec3((float)(i & 1), (float)(i >> 1), 0);
    mesh.triangles[0] = (blob_triangle_t){{0, 1, 2}};
    mesh.triangles[1] = (blob_triangle_t){{1, 3, 2}};
    affine_t identity = affine_identity();
    blob_shape_t shape = {.material = material, .alpha = blob_constant(1), .shadow_alpha = blob_constant(1)};
    assert_int_equal(mesh_add(&site->scene, &mesh, &identity, false, here, &shape).code, RESULT_OK);
    assert_int_equal(mesh.vertex_count, 0);
    scene_add_shape(&site->scene, object, shape, NULL);
}

static void bounds_grow_with_the_bytes_of_the_files(void **state)
{
    (void)state;
    site_t site;
    open_site(&site);
    const uint64_t free_pixels = (uint64_t)1 << 27;
    assert_int_equal(scene_charge(&site.scene, SCENE_PIXELS, free_pixels, here).code, RESULT_OK);
    result_t result = scene_charge(&site.scene, SCENE_PIXELS, 1, here);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(
        strstr(result.message, "scene.new:3:1: 134217729 pixels so far are too many for files of 0"));
    site.scene.source_bytes = 1;
    assert_int_equal(scene_charge(&site.scene, SCENE_PIXELS, 511, here).code, RESULT_OK);
    assert_int_equal(scene_charge(&site.scene, SCENE_PIXELS, 1, here).code, RESULT_INPUT);
    assert_int_equal(scene_charge(&site.scene, SCENE_VERTICES, UINT64_MAX, here).code, RESULT_INPUT);
    close_site(&site);
}

static void what_a_reader_adds_becomes_a_scene_with_the_world_first(void **state)
{
    (void)state;
    site_t site;
    open_site(&site);
    blob_material_t material = {.kind = MATERIAL_DIFFUSE, .normal_scale = 1};
    blob_builder_add(site.blob, BLOB_SECTION_MATERIALS, &material, 1);
    add_square(&site, 1, 0); /* makes the object */
    add_square(&site, 0, 0);
    affine_t away = affine_translation((double[]){3, 0, 0}), flat = affine_scaling((double[]){1, 1, 0}),
             mirror = affine_scaling((double[]){-1, 1, 1}), identity = affine_identity();
    assert_int_equal(scene_add_instance(&site.scene, 1, &away, &away, here).code, RESULT_OK);
    assert_int_equal(scene_add_instance(&site.scene, 1, &flat, &flat, here).code, RESULT_INPUT);
    assert_int_equal(scene_add_instance(&site.scene, 1, &identity, &mirror, here).code, RESULT_INPUT);
    assert_false(scene_has_light(&site.scene));
    scene_default_light(&site.scene, false, here);
    assert_true(scene_has_light(&site.scene));

    expect_near(mesh_area(&site.scene, 0), 1, 1e-6);
    blob_scene_t record = blob_default_scene();
    assert_int_equal(scene_see_everything(&site.scene, &record, here).code, RESULT_OK);
    vec3_t eye = xform_point(&record.world_from_camera, vec3(0, 0, 0));
    vec3_t ahead = v_sub(vec3(2, 0.5f, 0), eye); /* the middle of both squares */
    vec3_t axis = xform_vector(&record.world_from_camera, vec3(0, 0, 1));
    expect_near((double)v_dot(v_normalize(ahead), axis), 1, 1e-5);
    assert_int_equal(scene_finish(&site.scene, &record, here).code, RESULT_OK);

    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    assert_int_equal(blob_builder_finish(site.blob, &bytes, &size).code, RESULT_OK);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    assert_int_equal(blob.counts[BLOB_SECTION_OBJECTS], 2);
    assert_int_equal(blob.counts[BLOB_SECTION_INSTANCES], 1);
    assert_int_equal(blob.objects[1].first_shape, 1);
    assert_int_equal(blob.shapes[blob.objects[0].first_shape].geometry, 1); /* the square that came second */
    free(bytes);
    close_site(&site);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bounds_grow_with_the_bytes_of_the_files),
        cmocka_unit_test(what_a_reader_adds_becomes_a_scene_with_the_world_first),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
