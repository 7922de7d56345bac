/* Tests of common/scene: what is built is read back, and whatever else is in the bytes (truncation,
 * damage, wrong contents under a right checksum) gives an error and no access outside them: run with the
 * sanitizers. */
#include "common/film/film.h"
#include "common/scene/blob_builder.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static void assert_fails(result_t result, const char *part)
{
    if (result.code != RESULT_INPUT || strstr(result.message, part) == NULL)
        fail_msg("expected code %d with '%s', got code %d: %s", RESULT_INPUT, part, result.code,
                 result.message);
}

/* ---- a small scene with one of everything ---- */

static void add_mesh(blob_builder_t *builder, bool smooth)
{
    const vec3_t positions[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                 normals[4] = {{0, 0, 1}, {0, 0, 1}, {1, 0, 0}, {0, 1, 0}},
                 tangents[8] = {{1, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1},
                                {0, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 0}};
    const vec2_t uvs[4] = {{0, 0}, {1, 0}, {0, 1}, {1, 1}};
    const blob_triangle_t triangles[2] = {{{0, 1, 2}}, {{1, 2, 3}}};
    blob_mesh_t mesh = {.first_position = blob_builder_add(builder, BLOB_SECTION_POSITIONS, positions, 4),
                        .vertex_count = 4,
                        .first_normal = BLOB_NONE,
                        .first_uv = BLOB_NONE,
                        .first_uv2 = BLOB_NONE,
                        .first_colour = BLOB_NONE,
                        .first_triangle = blob_builder_add(builder, BLOB_SECTION_TRIANGLES, triangles, 2),
                        .triangle_count = 2};
    if (smooth) mesh.first_normal = blob_builder_add(builder, BLOB_SECTION_NORMALS, normals, 4);
    if (smooth) mesh.first_tangent = 1 + blob_builder_add(builder, BLOB_SECTION_NORMALS, tangents, 8);
    if (smooth) mesh.first_uv = blob_builder_add(builder, BLOB_SECTION_UVS, uvs, 4);
    if (smooth) mesh.first_uv2 = mesh.first_uv;
    if (smooth) mesh.first_colour = blob_builder_add(builder, BLOB_SECTION_COLOURS, NULL, 4);
    blob_builder_add(builder, BLOB_SECTION_MESHES, &mesh, 1);
}

static void add_curves(blob_builder_t *builder)
{
    const blob_curve_point_t points[8] = {{0, 0, 0, 0.1f}, {1, 0, 0, 0.1f}, {2, 0, 0, 0.1f}, {3, 0, 0, 0}};
    const vec3_t normals[4] = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}};
    uint32_t normal = blob_builder_add(builder, BLOB_SECTION_NORMALS, normals, 4);
    uint32_t first = blob_builder_add(builder, BLOB_SECTION_CURVE_POINTS, points, 8);
    const blob_curves_t curves[2] = {{CURVES_FIBRE, first, 1, BLOB_NONE},
                                     {CURVES_RIBBON, first + 4, 1, normal}};
    blob_builder_add(builder, BLOB_SECTION_CURVES, curves, 2);
}

/* World: a lamp (mesh 0), a sphere of fog with alpha from texture 0, curves; object 1: a smooth mesh, placed
 * once.
 */
static void add_shapes(blob_builder_t *builder)
{
    const blob_quadric_t sphere = {.kind = QUADRIC_SPHERE,
                                   .object_from_quadric = xform_identity(),
                                   .radius = 2,
                                   .z_min = -2,
                                   .z_max = 2,
                                   .phi_max = TWO_PI_F};
    const blob_object_t objects[2] = {{0, 3}, {3, 1}};
    const blob_instance_t instance = {1, xform_identity(), xform_identity()};
    const blob_value_t opaque = blob_constant(1), masked = {{1, 1, 1}, 1, 0};
    uint32_t name = blob_builder_string(builder, "scene.pbrt:7");
    const uint32_t flags = SHAPE_FLIP | SHAPE_CUTOUT | SHAPE_INTERFACE;
    const blob_shape_t shapes[4] = {
        {SHAPE_MESH, 0, 0, 0, SHAPE_INTERFACE, name, opaque, opaque, {0, 2}},
        {SHAPE_QUADRIC, 0, 1, BLOB_NONE, flags, name, masked, opaque, {1, 3}},
        {SHAPE_CURVES, 1, 3, BLOB_NONE, SHAPE_INTERFACE, name, opaque, opaque, {1, 0}},
        {SHAPE_MESH, 1, 2, BLOB_NONE, 0, 0, opaque, opaque, {0, 0}}};
    add_mesh(builder, false);
    add_mesh(builder, true);
    add_curves(builder);
    blob_builder_add(builder, BLOB_SECTION_QUADRICS, &sphere, 1);
    blob_builder_add(builder, BLOB_SECTION_SHAPES, shapes, 4);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, objects, 2);
    blob_builder_add(builder, BLOB_SECTION_INSTANCES, &instance, 1);
}

/* Field 2: bricks, of which the second is there twice and the third is not; 3 and 4: colours; 5: a cloud.
 * Medium 3 has the bricks and glows by them, 4 has the colours, 5 the cloud. */
static void add_fields(blob_builder_t *builder)
{
    enum { COUNT = 2 * BLOB_BRICK_CELLS };
    const uint32_t bricks[4] = {0, 1, BLOB_NONE, 1};
    const float numbers[3 * BLOB_GLOW_STEPS] = {0, 1, 2, 3, 4, 5};
    blob_field_t field = {.kind = FIELD_BRICKS, .channels = 1, .cells = {8, 16, 16}, .span = {8, 12, 11}};
    field.world_from_field = xform_identity();
    field.first = blob_builder_add(builder, BLOB_SECTION_NUMBERS, numbers, COUNT);
    field.first_brick = blob_builder_add(builder, BLOB_SECTION_BRICKS, bricks, 4);
    field.brick_count = 2;
    blob_medium_t medium = {.absorption = {1, 1, 1}, .emission = {1, 1, 1}};
    medium.density = medium.temperature = 1 + blob_builder_add(builder, BLOB_SECTION_FIELDS, &field, 1);
    medium.coldest = 100;
    medium.hottest = 1000;
    medium.first_glow = blob_builder_add(builder, BLOB_SECTION_NUMBERS, numbers, 3 * BLOB_GLOW_STEPS);
    blob_builder_add(builder, BLOB_SECTION_MEDIA, &medium, 1);

    blob_field_t colours = {.kind = FIELD_CELLS, .channels = 3, .cells = {2, 1, 1}, .span = {2, 1, 1}};
    colours.world_from_field = xform_identity();
    colours.first = blob_builder_add(builder, BLOB_SECTION_NUMBERS, numbers, 6);
    medium = (blob_medium_t){.absorption = {1, 1, 1}, .scattering = {1, 1, 1}, .emission = {1, 1, 1}};
    medium.absorption_tint = 1 + blob_builder_add(builder, BLOB_SECTION_FIELDS, &colours, 1);
    colours.first = blob_builder_add(builder, BLOB_SECTION_NUMBERS, numbers, 6);
    medium.scattering_tint = medium.emission_tint =
        1 + blob_builder_add(builder, BLOB_SECTION_FIELDS, &colours, 1);
    blob_builder_add(builder, BLOB_SECTION_MEDIA, &medium, 1);

    blob_field_t cloud = {.kind = FIELD_CLOUD, .channels = 1, .span = {2, 1, 1}, .parameters = {1, 1, 5}};
    cloud.world_from_field = xform_identity();
    medium = (blob_medium_t){.density = 1 + blob_builder_add(builder, BLOB_SECTION_FIELDS, &cloud, 1)};
    blob_builder_add(builder, BLOB_SECTION_MEDIA, &medium, 1);
}

/* Medium 0: fog; 1 and 2: clouds of two cells, in one of which the camera stands. */
static void add_media(blob_builder_t *builder)
{
    const float densities[2] = {0, 3};
    blob_medium_t medium = {.absorption = {1, 2, 3}, .scattering = {4, 5, 6}, .g = 0.5f};
    medium.name = blob_builder_string(builder, "fog");
    blob_builder_add(builder, BLOB_SECTION_MEDIA, &medium, 1);
    for (int i = 0; i < 2; i++) {
        blob_field_t field = {.kind = FIELD_CELLS, .channels = 1, .cells = {2, 1, 1}, .span = {2, 1, 1}};
        field.world_from_field = xform_identity();
        field.first = blob_builder_add(builder, BLOB_SECTION_NUMBERS, densities, 2);
        medium.density = 1 + blob_builder_add(builder, BLOB_SECTION_FIELDS, &field, 1);
        blob_builder_add(builder, BLOB_SECTION_MEDIA, &medium, 1);
    }
    add_fields(builder);
    blob_scene_t *scene = blob_builder_records(builder, BLOB_SECTION_SCENE);
    scene->medium = 2;
}

/* A lamp, a spot, and the images of a window and of the sky. */
static void add_lights(blob_builder_t *builder)
{
    const blob_light_t lights[4] = {
        {.kind = LIGHT_AREA, .radiance = {{5000, 4000, 3000}, 3}, .shape = 0},
        {.kind = LIGHT_SPOT, .radiance = {{1, 2, 3}, 0}, .medium = 1, .parameters = {0.5f, 0.9f}},
        {.kind = LIGHT_PROJECTION,
         .radiance = {{1, 1, 1}, 0},
         .image = 2,
         .mapping = LIGHT_LATLONG,
         .parameters = {-1, 1, -0.5f, 0.5f}},
        {.kind = LIGHT_INFINITE, .radiance = {{1, 1, 1}, 0}, .image = 1, .mapping = LIGHT_OCTAHEDRAL}};
    uint32_t first = blob_builder_add(builder, BLOB_SECTION_LIGHTS, lights, 4);
    blob_light_t *records = blob_builder_records(builder, BLOB_SECTION_LIGHTS);
    for (uint32_t i = 0; i < 4; i++) records[first + i].world_from_light = xform_identity();
}

/* Image 0: 3 x 1 floats in colour; image 1: 5 x 1 bytes. Texture 0: image 1; 1: noise; 2: their product. */
static void add_textures(blob_builder_t *builder)
{
    const float floats[9] = {0, 1, 2, 3, 4, 5, 6, 7, 8};
    const uint32_t bytes[2] = {0x03020100, 0x04};
    uint32_t colours = blob_builder_add(builder, BLOB_SECTION_TEXELS, floats, 9);
    uint32_t greys = blob_builder_add(builder, BLOB_SECTION_TEXELS, bytes, 2);
    const blob_image_t images[2] = {{TEXELS_RGB32F, 3, 1, colours, 1}, {TEXELS_R8, 5, 1, greys, 0}};
    const blob_texture_t textures[3] = {
        {.kind = TEXTURE_IMAGE,
         .mapping = MAPPING_UV,
         .matrix = {{1, 0, 0}, {0, -1, 1}},
         .image = 2,
         .channel = CHANNEL_R,
         .wrap_s = WRAP_REPEAT,
         .wrap_t = WRAP_CLAMP,
         .inputs = {{{1, 1, 1}, 0}}},
        {.kind = TEXTURE_FBM,
         .mapping = MAPPING_POINT,
         .texture_from_world = xform_identity(),
         .parameters = {8, 0.5f}},
        {.kind = TEXTURE_SCALE, .inputs = {{{1, 1, 1}, 1, 0}, {{2, 2, 2}, 2, 0}}}};
    blob_builder_add(builder, BLOB_SECTION_IMAGES, images, 2);
    blob_builder_add(builder, BLOB_SECTION_TEXTURES, textures, 3);
}

static void add_materials(blob_builder_t *builder)
{
    blob_material_t materials[5] = {
        {.kind = MATERIAL_DIFFUSE},
        {.kind = MATERIAL_MIRROR, .bump = 2},
        {.kind = MATERIAL_FOURIER, .table = 1, .normal_map = 1, .normal_scale = 1},
        {.kind = MATERIAL_MEASURED, .flags = MATERIAL_REMAP_SQRT},
        {.kind = MATERIAL_MIX, .parts = {3, 1}}};
    materials[0].values[VALUE_REFLECTANCE] = (blob_value_t){{0.5f, 0.4f, 0.3f}, 3, 0};
    materials[1].values[VALUE_REFLECTANCE] = blob_constant(0.9f);
    materials[3].values[VALUE_K] = blob_colour_value(vec3(3.9f, 2.4f, 2.2f));
    materials[3].values[VALUE_ROUGHNESS_V] = blob_constant(0.2f);
    materials[4].values[VALUE_AMOUNT] = blob_constant(0.25f);
    blob_builder_add(builder, BLOB_SECTION_MATERIALS, materials, 5);
}

/* A fourier of 2 nodes, and a second one like it. */
static void add_tables(blob_builder_t *builder)
{
    enum { NODES = 2, ROWS = NODES, COLUMNS = FOURIER_AZIMUTHS + 1 };
    const float nodes[NODES] = {-1, 1}, marginal[NODES * NODES] = {0, 1, 0, 1},
                coefficients[2] = {0.5f, 0.1f};
    float conditional[ROWS * COLUMNS];
    for (uint32_t i = 0; i < ROWS * COLUMNS; i++) conditional[i] = (float)(i % COLUMNS) / FOURIER_AZIMUTHS;
    for (int i = 0; i < 2; i++) {
        uint32_t first = blob_builder_add(builder, BLOB_SECTION_NUMBERS, coefficients, 2);
        const blob_series_t series[NODES * NODES] = {{0, 0}, {first, 1}, {first, 2}, {0, 0}};
        blob_fourier_t table = {.nodes = NODES, .channels = 1, .eta = 1.5f, .albedo = {1, 1, 1}};
        table.first_series = blob_builder_add(builder, BLOB_SECTION_SERIES, series, NODES * NODES);
        table.first_node = blob_builder_add(builder, BLOB_SECTION_NUMBERS, nodes, NODES);
        table.first_marginal = blob_builder_add(builder, BLOB_SECTION_NUMBERS, marginal, NODES * NODES);
        table.first_conditional =
            blob_builder_add(builder, BLOB_SECTION_NUMBERS, conditional, ROWS * COLUMNS);
        blob_builder_add(builder, BLOB_SECTION_FOURIERS, &table, 1);
    }
}

/* A measured BRDF of one azimuth, two elevations, and grids of 2 x 2 numbers. */
static void add_measured(blob_builder_t *builder)
{
    const float directions[3] = {0, 0, 1}, flat[4] = {1, 1, 1, 1};
    /* of two slices: densities, sums over rows, sums along them */
    const float warp[20] = {1, 1, 1, 1, 1, 1, 1, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1};
    const float colours[24] = {0.5f};
    blob_measured_t table = {.azimuths = 1, .elevations = 2, .isotropic = 1, .albedo = {1, 1, 1}};
    table.first_azimuth = blob_builder_add(builder, BLOB_SECTION_NUMBERS, directions, 3);
    table.first_elevation = table.first_azimuth + 1;
    table.ndf = (blob_grid_t){blob_builder_add(builder, BLOB_SECTION_NUMBERS, flat, 4), 2, 2};
    table.sigma = (blob_grid_t){blob_builder_add(builder, BLOB_SECTION_NUMBERS, flat, 4), 2, 2};
    table.visible = (blob_grid_t){blob_builder_add(builder, BLOB_SECTION_NUMBERS, warp, 20), 2, 2};
    table.luminance = (blob_grid_t){blob_builder_add(builder, BLOB_SECTION_NUMBERS, warp, 20), 2, 2};
    table.first_colour = blob_builder_add(builder, BLOB_SECTION_NUMBERS, colours, 24);
    blob_builder_add(builder, BLOB_SECTION_MEASUREMENTS, &table, 1);
}

static void add_scene(blob_builder_t *builder)
{
    const blob_scene_t scene = {.camera = CAMERA_PERSPECTIVE,
                                .world_from_camera = xform_identity(),
                                .world_from_camera_end = xform_identity(),
                                .fov = 40,
                                .focal_distance = 1e6f,
                                .screen_window = {-1, 1, -1, 1},
                                .film_window = {0, 1, 0, 1},
                                .filter = {FILTER_BOX, 0.5f, 0.5f, {0}},
                                .width = 64,
                                .height = 48,
                                .max_depth = 5,
                                .spp = 16,
                                .integrator = INTEGRATOR_PATH,
                                .sampler = SAMPLER_SOBOL,
                                .max_luminance = INFINITY,
                                .occlusion_distance = 2,
                                .occlusion_radiance = {1, 1, 1}};
    blob_builder_add(builder, BLOB_SECTION_SCENE, &scene, 1);
}

static blob_builder_t *make_builder(void)
{
    blob_builder_t *builder = blob_builder_new();
    add_scene(builder);
    add_shapes(builder);
    add_lights(builder);
    add_textures(builder);
    add_materials(builder);
    add_tables(builder);
    add_measured(builder);
    add_media(builder);
    return builder;
}

static uint8_t *make_blob(uint64_t *size)
{
    uint8_t *bytes;
    blob_builder_t *builder = make_builder();
    result_t result = blob_builder_finish(builder, &bytes, size);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    blob_builder_destroy(&builder);
    assert_null(builder);
    return bytes;
}

/* ---- the layout, as scene_blob.c has it ---- */

enum { CHECKSUM_OFFSET = 24, SECTIONS_OFFSET = 56, HEADER_SIZE = SECTIONS_OFFSET + 16 * BLOB_SECTION_COUNT };

static uint64_t read_u64(const uint8_t *at)
{
    uint64_t value;
    memcpy(&value, at, sizeof value);
    return value;
}

static uint8_t *section_entry(uint8_t *bytes, blob_section_t section)
{
    return bytes + SECTIONS_OFFSET + (size_t)16 * section;
}

static void renew_checksum(uint8_t *bytes, uint64_t size)
{
    hash_t checksum = hash_bytes(bytes + HEADER_SIZE, size - HEADER_SIZE);
    memcpy(bytes + CHECKSUM_OFFSET, &checksum, sizeof checksum);
}

/* Opens a copy that ends exactly where its memory does, so that the sanitizer sees the first byte too far. */
static result_t open_copy(const uint8_t *bytes, uint64_t size, void (*use)(const scene_blob_t *blob))
{
    uint8_t *copy = mem_alloc(size > 0 ? size : 1);
    memcpy(copy, bytes, size);
    scene_blob_t blob;
    result_t result = blob_open(copy, size, &blob);
    if (result.code == RESULT_OK && use != NULL) use(&blob);
    if (result.code != RESULT_OK) assert_null(blob.bytes);
    blob_close(&blob);
    free(copy);
    return result;
}

/* ---- what is right ---- */

static void everything_comes_back(void **state)
{
    (void)state;
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    scene_blob_t blob;
    assert_true(blob_recognise(bytes, size));
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    hash_t hash = hash_bytes(bytes, size);
    assert_true(hash_equal(&hash, &blob.hash));
    assert_int_equal(blob.counts[BLOB_SECTION_POSITIONS], 8);
    assert_int_equal(blob.counts[BLOB_SECTION_TRIANGLES], 4);
    assert_int_equal(blob.counts[BLOB_SECTION_SHAPES], 4);
    assert_int_equal(blob.meshes[1].first_position, 4);
    assert_int_equal(blob.meshes[0].first_normal, BLOB_NONE);
    assert_int_equal(blob.triangles[3].v[2], 3);
    assert_true(blob.positions[5].x == 1.0f && blob.normals[2].x == 1.0f && blob.uvs[1].x == 1.0f);
    assert_true(blob.quadrics[0].radius == 2.0f && blob.curve_points[1].x == 1.0f);
    assert_true(blob.materials[3].values[VALUE_ROUGHNESS_V].factor.x == 0.2f);
    assert_int_equal(blob.materials[0].values[VALUE_REFLECTANCE].texture, 3);
    assert_int_equal(blob.textures[2].inputs[1].texture, 2);
    assert_int_equal(blob.images[1].first_word, 9);
    assert_int_equal(((const uint8_t *)(blob.texels + 9))[4], 4);
    assert_string_equal(blob.strings + blob.shapes[1].name, "scene.pbrt:7");
    assert_string_equal(blob.strings, "");
    assert_int_equal(blob.lights[0].shape, 0);
    assert_true(blob.lights[0].radiance.factor.y == 4000.0f);
    assert_int_equal(blob.lights[1].medium, 1);
    assert_int_equal(blob.shapes[1].media[1], 3);
    assert_int_equal(blob.scene->medium, 2);
    assert_string_equal(blob.strings + blob.media[0].name, "fog");
    assert_true(blob.numbers[blob.fields[blob.media[2].density - 1].first + 1] == 3.0f);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++)
        assert_int_equal(read_u64(section_entry(bytes, (blob_section_t)i)) % 64, 0);
    job_settings_t settings = blob_default_settings(&blob);
    assert_int_equal(settings.width, 64);
    assert_int_equal(settings.max_depth, 5);
    assert_int_equal(settings.integrator, INTEGRATOR_PATH);
    /* 2^12 <= 5000 < 2^13, which is 2^3 over the 2^10 that the default is made for. */
    assert_int_equal(settings.film_scale, FILM_DEFAULT_SCALE - 3);
    /* A strong lamp may be far away: it does not make the film so coarse that all is black. */
    blob_light_t lights[2] = {{.kind = LIGHT_POINT, .radiance = blob_constant(3e12f)},
                              {.kind = LIGHT_AREA, .radiance = blob_constant(3e8f)}};
    scene_blob_t other = blob;
    other.lights = lights;
    other.counts[BLOB_SECTION_LIGHTS] = 1;
    assert_int_equal(blob_film_scale(&other), FILM_DEFAULT_SCALE - 16);
    other.counts[BLOB_SECTION_LIGHTS] = 2;
    assert_int_equal(blob_film_scale(&other), FILM_DEFAULT_SCALE - 19);
    blob_close(&blob);
    blob_close(&blob);
    free(bytes);
}

static void the_same_scene_has_the_same_name(void **state)
{
    (void)state;
    uint64_t size, other_size;
    uint8_t *bytes = make_blob(&size), *other = make_blob(&other_size);
    assert_int_equal(size, other_size);
    assert_memory_equal(bytes, other, size);
    free(bytes);
    free(other);
}

static void builders_grow_and_fill_in_late(void **state)
{
    (void)state;
    blob_builder_t *builder = blob_builder_new();
    for (uint32_t i = 0; i < 1000; i++)
        assert_int_equal(blob_builder_add(builder, BLOB_SECTION_POSITIONS, &(vec3_t){(float)i, 0, 0}, 1), i);
    assert_int_equal(blob_builder_add(builder, BLOB_SECTION_POSITIONS, NULL, 3), 1000);
    assert_int_equal(blob_builder_count(builder, BLOB_SECTION_POSITIONS), 1003);
    vec3_t *positions = blob_builder_records(builder, BLOB_SECTION_POSITIONS);
    assert_true(positions[999].x == 999.0f && positions[1002].x == 0.0f);
    assert_int_equal(blob_builder_string(builder, ""), 0);
    assert_int_equal(blob_builder_string(builder, "a"), 1);
    assert_int_equal(blob_builder_string(builder, "b"), 3);
    uint8_t *bytes;
    uint64_t size;
    assert_fails(blob_builder_finish(builder, &bytes, &size), "one scene record"); /* it has none */
    assert_null(bytes);
    blob_builder_destroy(&builder);
    builder = blob_builder_new();
    add_scene(builder);
    assert_fails(blob_builder_finish(builder, &bytes, &size), "no world object");
    blob_builder_destroy(&builder);
    blob_builder_destroy(&builder);
}

/* A scene with so many more texels, in two parts, so that the section grows when it is large already. */
static blob_builder_t *large_scene(uint32_t words)
{
    blob_builder_t *builder = make_builder();
    uint32_t part = words - words / 4, first = blob_builder_add(builder, BLOB_SECTION_TEXELS, NULL, part);
    uint32_t *texels = blob_builder_records(builder, BLOB_SECTION_TEXELS);
    for (uint32_t i = 0; i < part; i += 509) texels[first + i] = i;
    blob_builder_add(builder, BLOB_SECTION_TEXELS, NULL, words - part);
    texels = blob_builder_records(builder, BLOB_SECTION_TEXELS);
    texels[first + words - 1] = 7;
    return builder;
}

/* In a file and in memory the blob is the same, whether its sections were in files or not. */
static void blobs_are_written_to_files(void **state)
{
    (void)state;
    const uint32_t sizes[] = {1000, 23 << 20, 17 << 20};
    char *kept = getenv("TMPDIR") ? mem_strdup(getenv("TMPDIR")) : NULL;
    for (size_t k = 0; k < ARRAY_LENGTH(sizes); k++) {
        if (k == 2) setenv("TMPDIR", "/nowhere", 1); /* no disk: memory */
        blob_builder_t *builder = large_scene(sizes[k]);
        int file;
        uint8_t *bytes;
        uint64_t size;
        scene_blob_t blob;
        assert_int_equal(blob_builder_write(builder, &file).code, RESULT_OK);
        blob_builder_destroy(&builder);
        assert_int_equal(blob_open_descriptor(file, "it", &blob).code, RESULT_OK);
        close(file);
        builder = large_scene(sizes[k]);
        assert_int_equal(blob_builder_finish(builder, &bytes, &size).code, RESULT_OK);
        blob_builder_destroy(&builder);
        assert_true(blob.size == size && memcmp(blob.bytes, bytes, size) == 0);
        uint32_t first = (uint32_t)blob.counts[BLOB_SECTION_TEXELS] - sizes[k];
        assert_int_equal(blob.texels[first + 509], 509);
        assert_int_equal(blob.texels[first + sizes[k] - 1], 7);
        free(bytes);
        blob_close(&blob);
    }
    if (kept)
        setenv("TMPDIR", kept, 1);
    else
        unsetenv("TMPDIR");
    free(kept);
}

static void files_are_mapped(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "x.blob");
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    scene_blob_t blob;
    scratch_write(path, bytes, size);
    assert_int_equal(blob_open_file(path, &blob).code, RESULT_OK);
    assert_true(blob.mapped && blob.size == size);
    assert_memory_equal(blob.bytes, bytes, size);
    blob_close(&blob);
    assert_null(blob.bytes);
    scratch_write(path, bytes, size - 64);
    assert_fails(blob_open_file(path, &blob), "x.blob: scene blob: says it has");
    scratch_write(path, bytes, 0);
    assert_fails(blob_open_file(path, &blob), "x.blob: ");
    assert_fails(blob_open_file(folder, &blob), folder);
    assert_fails(blob_open_file("/nowhere/x", &blob), "/nowhere/x: cannot be opened");
    free(bytes);
    free(path);
    scratch_destroy(&folder);
}

/* ---- what is wrong ---- */

static void every_truncation_is_an_error(void **state)
{
    (void)state;
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    for (uint64_t length = 0; length < size; length++)
        assert_fails(open_copy(bytes, length, NULL), "scene blob");
    /* The same with a header that admits to its length and a right checksum. */
    for (uint64_t length = HEADER_SIZE; length < size; length++) {
        uint8_t *cut = mem_alloc(length);
        memcpy(cut, bytes, length);
        memcpy(cut + 16, &length, sizeof length);
        renew_checksum(cut, length);
        result_t result = open_copy(cut, length, NULL);
        /* Only the padding behind the last section may be shorter than it was. */
        if (length <= size - 64) assert_fails(result, "lies outside the blob");
        free(cut);
    }
    free(bytes);
}

static void every_flipped_byte_is_an_error(void **state)
{
    (void)state;
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    for (uint64_t at = 0; at < size; at++) {
        /* The table of sections is not under the checksum, but a blob's name covers it. */
        if (at >= SECTIONS_OFFSET && at < HEADER_SIZE) continue;
        bytes[at] ^= 0x10;
        assert_fails(open_copy(bytes, size, NULL), "scene blob");
        bytes[at] ^= 0x10;
    }
    assert_int_equal(open_copy(bytes, size, NULL).code, RESULT_OK);
    free(bytes);
}

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* One wrong 32-bit field under a right checksum, and what the error must say. */
typedef struct {
    blob_section_t section;
    size_t offset; /* bytes into the section */
    uint32_t value;
    const char *expected;
} corruption_t;

#define FIELD(type, index, field) ((index) * sizeof(type) + offsetof(type, field))

static void check_corruptions(const corruption_t *corruptions, size_t count)
{
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    for (size_t i = 0; i < count; i++) {
        const corruption_t *c = &corruptions[i];
        uint8_t *field = bytes + read_u64(section_entry(bytes, c->section)) + c->offset;
        uint32_t kept;
        memcpy(&kept, field, sizeof kept);
        memcpy(field, &c->value, sizeof kept);
        renew_checksum(bytes, size);
        assert_fails(open_copy(bytes, size, NULL), c->expected);
        memcpy(field, &kept, sizeof kept);
    }
    renew_checksum(bytes, size);
    assert_int_equal(open_copy(bytes, size, NULL).code, RESULT_OK);
    free(bytes);
}

#define VALUE(field, slot) FIELD(blob_material_t, field, values[slot])

static void bad_indices_are_errors(void **state)
{
    (void)state;
    const corruption_t corruptions[] = {
        {BLOB_SECTION_TRIANGLES, FIELD(blob_triangle_t, 0, v[1]), 4, "uses vertex 4 of 4"},
        {BLOB_SECTION_TRIANGLES, FIELD(blob_triangle_t, 3, v[2]), UINT32_MAX, "uses vertex"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_position), 5, "its vertices"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_position), UINT32_MAX, "its vertices"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 0, vertex_count), UINT32_MAX, "its vertices"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 0, vertex_count), 3, "uses vertex 3 of 3"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_normal), 13, "its normals"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 0, first_normal), UINT32_MAX - 1, "its normals"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_tangent), 10, "its tangents"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 0, first_tangent), UINT32_MAX, "its tangents"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, steps), 1, "is given at 1 times"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, steps), BLOB_MAX_STEPS + 1, "is given at 130 times"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, steps), BLOB_MAX_STEPS, "its vertices"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_uv), 1, "its uvs"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_uv2), 1, "its uvs"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_colour), 1, "its colours"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 1, first_triangle), 3, "its triangles"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 0, triangle_count), 5, "its triangles"},
        {BLOB_SECTION_MESHES, FIELD(blob_mesh_t, 0, triangle_count), 0, "its triangles"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, kind), 4, "quadric 0: unknown kind 4"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 0, kind), 0, "curves 0: unknown kind 0"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 0, segment_count), 0, "curves 0: its points"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 0, segment_count), 2, "curves 1: its points"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 1, first_point), 5, "curves 1: its points"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 1, segment_count), UINT32_MAX, "curves 1: its points"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 0, first_normal), 0, "curves 0: its normals"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 1, first_normal), 13, "curves 1: its normals"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 1, first_normal), BLOB_NONE, "curves 1: its normals"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 0, kind), 4, "shape 0: unknown kind 4"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 0, geometry), 2, "shape 0: no geometry 2"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, geometry), 1, "shape 1: no geometry 1"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 2, geometry), 2, "shape 2: no geometry 2"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 3, material), 5, "shape 3: no material 5"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 0, light), 4, "shape 0: light 4"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 0, light), 1, "shape 0: light 1 does not belong"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, light), 0, "shape 1: light 0 does not belong"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 0, light), BLOB_NONE, "light 0 does not belong"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 1, kind), CURVES_FIBRE, "curves 1: its normals"},
        {BLOB_SECTION_CURVES, FIELD(blob_curves_t, 0, kind), CURVES_FLAT_FIBRE + 1,
         "curves 0: unknown kind 5"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 2, geometry), 0, "shape 2: is of fibres, and its material"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 0, kind), SHAPE_CURVES, "curves cannot emit"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, flags), SHAPE_BUMPS_V3, "shape 1: is no mesh"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, name), 1000, "its name"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, alpha.texture), 4, "shape 1: its alpha"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, shadow_alpha.texture), UINT32_MAX, "its alpha"},
        {BLOB_SECTION_OBJECTS, FIELD(blob_object_t, 0, shape_count), 5, "object 0: its shapes"},
        {BLOB_SECTION_OBJECTS, FIELD(blob_object_t, 1, first_shape), UINT32_MAX, "object 1: its shapes"},
        {BLOB_SECTION_OBJECTS, FIELD(blob_object_t, 1, shape_count), 0, "objects hold"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, object), 0, "instance 0: no object 0"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, object), 2, "instance 0: no object 2"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 0, format), 0, "image 0: unknown format 0"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 0, format), 5, "image 0: unknown format 5"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 0, width), 0, "image 0: 0 x 1 pixels"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 1, height), 65537, "image 1: 5 x 65537 pixels"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 0, height), 2, "image 0: its pixels"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 1, width), 9, "image 1: its pixels"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 1, first_word), 10, "image 1: its pixels"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 1, first_word), UINT32_MAX, "image 1: its pixels"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, kind), 0, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, kind), TEXTURE_KIND_END, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, mapping), MAPPING_CYLINDER + 1,
         "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, image), 3, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, image), 0, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, channel), 8, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, wrap_s), 5, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, wrap_t), 5, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, inputs[0].texture), 1, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 2, inputs[3].texture), 3, "texture 2 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 1, inputs[0].texture), 3, "texture 1 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 0, kind), 0, "material 0 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 0, kind), MATERIAL_KIND_END,
         "material 0 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 3, name), 1000, "material 3 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 1, bump), 4, "material 1 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 2, normal_map), 4, "material 2 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 2, coat_normal_map), 4, "material 2 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 4, parts[0]), 4, "material 4 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 4, parts[1]), UINT32_MAX, "material 4 is malformed"},
        {BLOB_SECTION_MATERIALS, VALUE(0, VALUE_ATTENUATION) + 12, 4, "material 0 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 2, table), 2, "material 2 is malformed"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 0, nodes), 1, "fourier 0: 1 nodes"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 0, nodes), 1025, "fourier 0: 1025 nodes"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 0, nodes), 3, "fourier 0: its numbers"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, channels), 2, "fourier 1: 2 nodes, 2 channels"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, first_node), 2, "fourier 1: its numbers"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, first_node), UINT32_MAX, "fourier 1: its numbers"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, first_marginal), UINT32_MAX,
         "fourier 1: its numbers"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, first_conditional), UINT32_MAX,
         "fourier 1: its numbers"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, first_series), 3, "fourier 1: its series"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, first_series), UINT32_MAX, "fourier 1: its series"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 3, table), 1, "material 3 is malformed"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, azimuths), 0, "measured 0: 0 azimuths"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, elevations), UINT32_MAX, "measured 0: 1 azim"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, isotropic), 2, "measured 0: 1 azimuths"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, first_azimuth), UINT32_MAX, "its directions"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, first_elevation), 0, "its directions"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, ndf.width), 1, "measured 0: a grid"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, ndf.height), 4097, "measured 0: a grid"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, sigma.first), UINT32_MAX, "measured 0: a grid"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, visible.first), 0, "measured 0: a grid"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, luminance.height), 4096, "measured 0: a grid"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, first_colour), UINT32_MAX, "its colours"},
        {BLOB_SECTION_SERIES, FIELD(blob_series_t, 1, first), UINT32_MAX, "fourier 0: a series"},
        {BLOB_SECTION_SERIES, FIELD(blob_series_t, 5, count), BLOB_MAX_FOURIER_ORDER + 1,
         "fourier 1: a series is too long"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, kind), 0, "light 1: unknown kind 0"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 3, kind), 8, "light 3: unknown kind 8"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 0, shape), 1, "light 0 does not belong"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 0, shape), 3, "light 0 does not belong"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, flags), LIGHT_PICTURE, "light 1: only area lights are"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 0, flags), LIGHT_UNSEEN | LIGHT_PICTURE, "light 0: "},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 0, radiance.texture), 4, "light 0: no such texture"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, radiance.texture), 1, "light 1: only area lights"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 3, image), 3, "light 3: no image 3"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 3, mapping), 4, "light 3: unknown mapping 4"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 2, image), 0, "light 2 has no image"},
        {BLOB_SECTION_STRINGS, 0, 0x41414141, "not terminated"}};
    check_corruptions(corruptions, ARRAY_LENGTH(corruptions));
}

static void media_are_checked(void **state)
{
    (void)state;
    const uint32_t nan = bits_of(NAN), infinite = bits_of(INFINITY), minus = bits_of(-1), one = bits_of(1);
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    scene_blob_t blob;
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    const size_t densities = 4 * (size_t)blob.fields[0].first;
    blob_close(&blob);
    free(bytes);
    const corruption_t corruptions[] = {
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, media[0]), 7,
         "shape 1: parts media that it cannot part"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, media[1]), UINT32_MAX, "shape 1: parts media"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, flags), SHAPE_CUTOUT, "shape 1: parts media"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 3, media[0]), 1, "shape 3: parts media"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 0, kind), MATERIAL_INTERFACE,
         "shape 0: is nothing but the border of media"}, /* it emits */
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 2, kind), MATERIAL_INTERFACE,
         "shape 3: is nothing but the border of media"}, /* it parts none */
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 3, kind), MATERIAL_INTERFACE,
         "shape 2: is nothing but the border of media"}, /* curves */
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 1, kind), MATERIAL_INTERFACE,
         "material 4 is malformed"}, /* a mix of it */
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, medium), 7, "light 1: shines into no medium 7"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, medium), UINT32_MAX, "light 1: shines into no medium"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 3, medium), 1, "light 3: shines into no medium 1"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, medium), 7, "the camera stands in no medium 7"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 0, name), 1000, "medium 0: its name"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 0, absorption.x), minus, "medium 0: a coefficient"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 0, absorption.z), nan, "medium 0: a coefficient"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 1, scattering.y), infinite, "medium 1: a coefficient"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 1, scattering.z), bits_of(1.1e9f), "medium 1: a coeff"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 2, emission.x), minus, "medium 2: a coefficient"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 2, emission.y), nan, "medium 2: a coefficient"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 0, g), one, "medium 0: its g"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 0, g), minus, "medium 0: its g"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 1, g), nan, "medium 1: its g"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, kind), 0, "field 0: is of no known kind 0"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, kind), FIELD_CLOUD + 1, "field 0: is of no known kind"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, channels), 2, "field 0: cannot have 2 channels"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, channels), 3, "field 2: cannot have 3 channels"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, cells[0]), 0, "field 0: its grid has 0 x 1 x 1 cells"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, cells[1]), BLOB_MAX_GRID_SIDE + 1, "2 x 4097 x 1 cells"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, cells[2]), UINT32_MAX, "field 0: its grid has"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, cells[0]), BLOB_MAX_GRID_SIDE, "field 2: its numbers"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, cells[1]), 2, "field 1: its numbers"}, /* shared */
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, first), 0, "field 1: its numbers"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, first), UINT32_MAX, "field 1: its numbers"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, cells[1]), 9, "field 2: its bricks"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, cells[1]), 24, "field 2: its bricks"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, first_brick), 1, "field 2: its bricks"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, first_brick), UINT32_MAX, "field 2: its bricks"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, brick_count), 1, "field 2: its bricks"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, brick_count), UINT32_MAX, "field 2: its numbers"},
        {BLOB_SECTION_BRICKS, 4, 2, "field 2: its bricks"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, span[1]), bits_of(0.5f), "field 1: the span"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 2, span[2]), nan, "field 2: the span"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 5, span[0]), 0, "field 5: the span"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, origin[1]), nan, "field 1: a number"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 5, parameters[0]), minus, "field 5: a number"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 5, parameters[2]), infinite, "field 5: a number"},
        {BLOB_SECTION_NUMBERS, densities, minus, "field 0: its numbers"},
        {BLOB_SECTION_NUMBERS, densities + 12, minus, "field 1: its numbers"},
        {BLOB_SECTION_NUMBERS, densities, nan, "is not finite, or too large"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 0, world_from_field.m[1][1]), 0, "field 0: its transform"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, world_from_field.m[0][3]), infinite,
         "field 1: its transform"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 1, world_from_field.m[2][0]), nan, "field 1: its trans"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 1, density), 7, "medium 1: one of its fields"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 1, density), UINT32_MAX, "medium 1: one of its fields"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 1, density), 4,
         "medium 1: one of its fields"}, /* colours */
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 4, absorption_tint), 1, "medium 4: one of its fields"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 4, scattering_tint), 3, "medium 4: one of its fields"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 4, emission_tint), 9, "medium 4: one of its fields"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 3, temperature), 4, "medium 3: one of its fields"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 4, density), 1, "medium 4: has tints and a density"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 3, density), 0, "medium 3: glows in no box"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 0, emission_tint), 1, "medium 0: glows in no box"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 4, origin[0]), one, "medium 4: its tints"},
        {BLOB_SECTION_FIELDS, FIELD(blob_field_t, 3, world_from_field.m[0][0]), one + 1,
         "medium 4: its tints"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 3, hottest), bits_of(100), "medium 3: its temperatures"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 3, coldest), nan, "medium 3: its temperatures"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 3, hottest), infinite, "medium 3: its temperatures"},
        {BLOB_SECTION_MEDIA, FIELD(blob_medium_t, 3, first_glow), UINT32_MAX, "medium 3: the colours"}};
    check_corruptions(corruptions, ARRAY_LENGTH(corruptions));
}

static void bad_numbers_are_errors(void **state)
{
    (void)state;
    enum { MEASURED_AT = 2 * (2 + 2 + 4 + 2 * (FOURIER_AZIMUTHS + 1)) }; /* behind the fouriers' numbers */
    const uint32_t nan = bits_of(NAN), infinite = bits_of(INFINITY), minus = bits_of(-1.0f);
    const corruption_t corruptions[] = {
        {BLOB_SECTION_POSITIONS, FIELD(vec3_t, 7, z), nan, "position 7"},
        {BLOB_SECTION_NORMALS, FIELD(vec3_t, 0, x), infinite, "normal 0"},
        {BLOB_SECTION_UVS, FIELD(vec2_t, 2, y), nan, "uv 2"},
        {BLOB_SECTION_COLOURS, FIELD(blob_colour_t, 3, a), nan, "colour 3"},
        {BLOB_SECTION_CURVE_POINTS, FIELD(blob_curve_point_t, 2, y), nan, "curve point 2"},
        {BLOB_SECTION_CURVE_POINTS, FIELD(blob_curve_point_t, 5, radius), minus, "curve point 5"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, radius), 0, "radius"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, radius), nan, "radius"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, z_max), bits_of(-2.0f), "its extent is empty"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, z_max), nan, "its extent"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, z_max), bits_of(2.5f), "outside its radius"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, phi_max), bits_of(6.3f), "its extent"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, object_from_quadric.m[1][1]), 0, "singular"},
        {BLOB_SECTION_QUADRICS, FIELD(blob_quadric_t, 0, object_from_quadric.m[0][3]), infinite, "singular"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, alpha.factor.y), nan, "its alpha"},
        {BLOB_SECTION_SHAPES, FIELD(blob_shape_t, 1, shadow_alpha.factor.x), infinite, "its alpha"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, world_from_object.m[2][2]), 0,
         "instance 0: its transform"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, world_from_object_end.m[2][2]), 0,
         "instance 0: its transform"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, world_from_object.m[1][3]), nan,
         "instance 0: its transform"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, world_from_object_end.m[2][3]), infinite,
         "instance 0: its transform"},
        {BLOB_SECTION_INSTANCES, FIELD(blob_instance_t, 0, world_from_object_end.m[2][2]), minus,
         "inside out"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 1, gamma), minus, "its gamma"},
        {BLOB_SECTION_IMAGES, FIELD(blob_image_t, 1, gamma), nan, "its gamma"},
        {BLOB_SECTION_TEXELS, 8 * sizeof(uint32_t), nan, "image 0: a pixel is not finite"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 0, matrix[1][2]), nan, "texture 0 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 1, texture_from_world.m[2][3]), infinite,
         "texture 1 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 1, parameters[3]), nan, "texture 1 is malformed"},
        {BLOB_SECTION_TEXTURES, FIELD(blob_texture_t, 2, inputs[1].factor.z), nan, "texture 2 is malformed"},
        {BLOB_SECTION_MATERIALS, VALUE(0, VALUE_REFLECTANCE), nan, "material 0 is malformed"},
        {BLOB_SECTION_MATERIALS, VALUE(3, VALUE_K) + 8, infinite, "material 3 is malformed"},
        {BLOB_SECTION_MATERIALS, FIELD(blob_material_t, 2, normal_scale), nan, "material 2 is malformed"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 0, eta), 0, "fourier 0: its index"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 1, eta), nan, "fourier 1: its index"},
        {BLOB_SECTION_FOURIERS, FIELD(blob_fourier_t, 0, albedo.y), 0, "fourier 0: its index or albedo"},
        {BLOB_SECTION_MEASUREMENTS, FIELD(blob_measured_t, 0, albedo.z), nan, "measured 0: its albedo"},
        {BLOB_SECTION_NUMBERS, 4 * (MEASURED_AT + 2), 0, "measured 0: its directions"},
        {BLOB_SECTION_NUMBERS, 4 * (MEASURED_AT + 4), minus, "measured 0: a grid"},
        {BLOB_SECTION_NUMBERS, 4 * (MEASURED_AT + 19), bits_of(0.5f), "measured 0: a grid"},
        {BLOB_SECTION_NUMBERS, 4 * (MEASURED_AT + 20), bits_of(2), "measured 0: a grid"},
        {BLOB_SECTION_NUMBERS, 4 * (MEASURED_AT + 23), bits_of(0.5f), "measured 0: a grid"},
        {BLOB_SECTION_NUMBERS, 4 * (MEASURED_AT + 60), minus, "measured 0: its colours"},
        {BLOB_SECTION_NUMBERS, 0, nan, "number 0 is not finite"},
        {BLOB_SECTION_NUMBERS, 2 * sizeof(float), bits_of(1), "fourier 0: its cosines do not ascend"},
        {BLOB_SECTION_NUMBERS, 3 * sizeof(float), bits_of(2), "fourier 0: its cosines do not ascend"},
        {BLOB_SECTION_NUMBERS, 4 * sizeof(float), bits_of(0.5f), "fourier 0: its probabilities"},
        {BLOB_SECTION_NUMBERS, 7 * sizeof(float), bits_of(0.5f), "fourier 0: its probabilities"},
        {BLOB_SECTION_NUMBERS, 10 * sizeof(float), bits_of(0.5f), "fourier 0: its probabilities"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 0, radiance.factor.x), infinite, "radiance"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 3, radiance.factor.z), minus, "radiance"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 3, parameters[2]), nan, "light 3: its parameters"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, world_from_light.m[0][0]), 0, "light 1: its transform"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 2, parameters[1]), minus, "light 2: its window is empty"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, parameters[0]), bits_of(0.95f), "light 1: its cone"},
        {BLOB_SECTION_LIGHTS, FIELD(blob_light_t, 1, parameters[1]), bits_of(1.5f), "light 1: its cone"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, camera), 0, "unknown camera 0"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, camera), 6, "unknown camera 6"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, camera), CAMERA_REALISTIC, "its lens has 0 elements"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, world_from_camera.m[0][0]), nan, "camera"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, world_from_camera_end.m[0][0]), 0, "camera"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, fov), bits_of(180.0f), "fov"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, fov), nan, "fov"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, lens_radius), minus, "lens radius"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, occlusion_distance), nan, "ambient occlusion"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, occlusion_radiance.y), minus, "ambient occlusion"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, focal_distance), 0, "focal distance"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, screen_window[1]), minus, "screen window is empty"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, screen_window[3]), infinite,
         "screen window is not finite"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, film_window[1]), 0, "film's window is empty"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, filter.kind), FILTER_GAUSSIAN, "parameter must be"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, filter.kind), 9, "pixel filter 9"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, filter.radius_y), nan, "radius"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, filter.parameters[1]), nan, "parameters are not"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, width), 0, "width"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, height), INT32_MAX, "height"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, spp), UINT32_MAX, "samples"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, max_luminance), nan, "largest luminance"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, regularize), 2, "regularize"},
        {BLOB_SECTION_SCENE, FIELD(blob_scene_t, 0, integrator), 77, "integrator"}};
    check_corruptions(corruptions, ARRAY_LENGTH(corruptions));
}

/* A chain of mixes: each of the one before and of itself again. */
static result_t open_mixes(int depth)
{
    blob_builder_t *builder = make_builder();
    for (int i = 0; i < depth; i++) {
        uint32_t last = blob_builder_count(builder, BLOB_SECTION_MATERIALS) - 1;
        blob_material_t mix = {.kind = MATERIAL_MIX, .parts = {last, last}};
        blob_builder_add(builder, BLOB_SECTION_MATERIALS, &mix, 1);
    }
    uint8_t *bytes;
    uint64_t size;
    result_t result = blob_builder_finish(builder, &bytes, &size);
    blob_builder_destroy(&builder);
    free(bytes);
    return result;
}

/* Each product takes the one before twice: the cost of a look-up doubles. */
static result_t open_products(int depth)
{
    blob_builder_t *builder = make_builder();
    for (int i = 0; i < depth; i++) {
        blob_ref_t last = blob_builder_count(builder, BLOB_SECTION_TEXTURES);
        blob_texture_t product = {.kind = TEXTURE_SCALE,
                                  .inputs = {{{1, 1, 1}, last, 0}, {{1, 1, 1}, last, 0}}};
        blob_builder_add(builder, BLOB_SECTION_TEXTURES, &product, 1);
    }
    uint8_t *bytes;
    uint64_t size;
    result_t result = blob_builder_finish(builder, &bytes, &size);
    blob_builder_destroy(&builder);
    free(bytes);
    return result;
}

static void hopeless_transforms_are_errors(void **state)
{
    (void)state;
    const float skew = 200, small = 0.9e-10f, large = 1.1e10f;
    const xform_t identity = xform_identity(), flat = {{{1, 0, 0, 0}, {0, 1.1e-10f, 0, 0}, {0, 0, 1e10f, 0}}},
                  skewed = {{{1, skew, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
                  leaning = {{{1, 0, 2 * skew, 0}, {0, 1, 2 * skew, 0}, {0, 0, 1, 0}}},
                  lying = {{{1, 0, 1.1e5f, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
                  tiny = {{{1, 0, 0, 0}, {0, small, 0, 0}, {0, 0, 1, 0}}},
                  huge = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, large, 0}}};
    const xform_t *const usable[] = {&identity, &flat, &skewed, &leaning}, *const refused[] = {&lying, &tiny,
                                                                                               &huge};
    for (size_t i = 0; i < ARRAY_LENGTH(usable); i++) {
        assert_true(blob_instance_is_traceable(usable[i], usable[i]));
        assert_true(blob_instance_is_traceable(&identity, usable[i]));
        for (size_t k = 0; k < ARRAY_LENGTH(refused); k++) {
            assert_false(blob_instance_is_traceable(usable[i], refused[k]));
            assert_false(blob_instance_is_traceable(refused[k], usable[i]));
        }
    }
    /* Each for itself, but not the way from one to the other: 200 x 566 > 1e5. */
    assert_false(blob_instance_is_traceable(&skewed, &leaning));
}

/* A blob whose camera has a lens of two elements, made worse by `spoil`. */
static result_t lens_result(void (*spoil)(blob_scene_t *, blob_lens_element_t *, blob_pupil_t *))
{
    blob_lens_element_t lens[2] = {{0.1f, 0.01f, 1.5f, 0.01f}, {-0.1f, 0.1f, 1, 0.01f}};
    blob_pupil_t pupils[LENS_PUPILS] = {{0}};
    blob_builder_t *builder = make_builder();
    blob_scene_t *scene = blob_builder_records(builder, BLOB_SECTION_SCENE);
    scene->camera = CAMERA_REALISTIC;
    spoil(scene, lens, pupils);
    blob_builder_add(builder, BLOB_SECTION_LENS, lens, 2);
    blob_builder_add(builder, BLOB_SECTION_PUPILS, pupils, LENS_PUPILS);
    uint8_t *bytes;
    uint64_t size;
    result_t result = blob_builder_finish(builder, &bytes, &size);
    free(bytes);
    blob_builder_destroy(&builder);
    return result;
}

#define SPOILED(name, what)                                                                                  \
    static void name(blob_scene_t *scene, blob_lens_element_t *lens, blob_pupil_t *pupils)                   \
    {                                                                                                        \
        (void)scene, (void)lens, (void)pupils;                                                               \
        what;                                                                                                \
    }
SPOILED(nothing_spoiled, )
SPOILED(curvature_spoiled, lens[1].curvature_radius = NAN)
SPOILED(thickness_spoiled, lens[0].thickness = INFINITY)
SPOILED(eta_spoiled, lens[0].eta = 0)
SPOILED(aperture_spoiled, lens[1].aperture_radius = -1)
SPOILED(film_spoiled, lens[1].thickness = 0)
SPOILED(pupil_spoiled, pupils[63].y_max = NAN)
SPOILED(exposure_spoiled, scene->lens_exposure = -1)
SPOILED(window_spoiled, memset(scene->screen_window, 0, sizeof scene->screen_window))
SPOILED(image_spoiled, scene->aperture = 99)
SPOILED(format_spoiled, scene->aperture = 1)
SPOILED(camera_spoiled, scene->camera = CAMERA_PERSPECTIVE)

static void lenses_are_checked(void **state)
{
    (void)state;
    assert_int_equal(lens_result(nothing_spoiled).code, RESULT_OK);
    assert_fails(lens_result(curvature_spoiled), "lens element 1 is malformed");
    assert_fails(lens_result(thickness_spoiled), "lens element 0 is malformed");
    assert_fails(lens_result(eta_spoiled), "lens element 0 is malformed");
    assert_fails(lens_result(aperture_spoiled), "lens element 1 is malformed");
    assert_fails(lens_result(film_spoiled), "the film does not lie behind the lens");
    assert_fails(lens_result(pupil_spoiled), "pupil 63 is not finite");
    assert_fails(lens_result(exposure_spoiled), "exposure");
    assert_fails(lens_result(window_spoiled), "has no size");
    assert_fails(lens_result(image_spoiled), "no image 99");
    assert_fails(lens_result(format_spoiled), "not of grey floats");
    assert_fails(lens_result(camera_spoiled), "its camera takes none");
}

static void depths_and_costs_are_limited(void **state)
{
    (void)state;
    /* the scene has a mix already, of depth 1, and a product of cost 3 */
    assert_int_equal(open_mixes(BLOB_MAX_MIX_DEPTH - 1).code, RESULT_OK);
    assert_fails(open_mixes(BLOB_MAX_MIX_DEPTH), "is malformed");
    assert_int_equal(open_products(7).code, RESULT_OK); /* 4 2^7 - 1 */
    assert_fails(open_products(8), "combines more than 1000 textures");
    assert_fails(open_products(60), "combines more than 1000 textures");
}

static void bad_headers_are_errors(void **state)
{
    (void)state;
    uint64_t size;
    uint8_t *bytes = make_blob(&size);
    const struct {
        size_t offset;
        uint64_t value;
        const char *expected;
    } cases[] = {{0, 0, "magic"},
                 {8, BLOB_VERSION + 1 + ((uint64_t)BLOB_SECTION_COUNT << 32), "version 8"},
                 {8, BLOB_VERSION + ((uint64_t)(BLOB_SECTION_COUNT + 1) << 32), "sections"},
                 {16, UINT64_MAX, "says it has"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        uint64_t kept = read_u64(bytes + cases[i].offset);
        memcpy(bytes + cases[i].offset, &cases[i].value, 8);
        assert_fails(open_copy(bytes, size, NULL), cases[i].expected);
        memcpy(bytes + cases[i].offset, &kept, 8);
    }
    const uint64_t wrong[] = {
        0, 1, 63, 64, size, size - 16, (uint64_t)1 << 31, (uint64_t)1 << 62, UINT64_MAX - 63, UINT64_MAX};
    for (int section = 0; section < BLOB_SECTION_COUNT; section++)
        for (size_t word = 0; word < 2; word++)
            for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++) {
                uint8_t *at = section_entry(bytes, (blob_section_t)section) + 8 * word;
                uint64_t kept = read_u64(at);
                if (kept == wrong[i]) continue;
                memcpy(at, &wrong[i], 8);
                /* A smaller count may leave a scene that is right: any result, and no access outside. */
                result_t result = open_copy(bytes, size, NULL);
                if (word == 0 || wrong[i] >= size) assert_fails(result, "lies outside the blob");
                memcpy(at, &kept, 8);
            }
    free(bytes);
}

/* ---- random contents ---- */

static double touch_mesh(const scene_blob_t *blob, const blob_mesh_t *mesh)
{
    double sum = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            uint32_t v = blob->triangles[mesh->first_triangle + t].v[k];
            sum += (double)blob->positions[mesh->first_position + v].x;
            if (mesh->first_normal != BLOB_NONE) sum += (double)blob->normals[mesh->first_normal + v].x;
            if (mesh->first_tangent != 0)
                sum += (double)blob->normals[mesh->first_tangent - 1 + mesh->vertex_count + v].x;
            if (mesh->first_uv != BLOB_NONE) sum += (double)blob->uvs[mesh->first_uv + v].x;
        }
    return sum;
}

static double touch_value(const scene_blob_t *blob, const blob_value_t *value)
{
    double sum = (double)value->factor.x;
    if (value->texture != 0) sum += (double)blob->textures[value->texture - 1].parameters[0];
    return sum;
}

static double touch_material(const scene_blob_t *blob, const blob_material_t *material)
{
    double sum = (double)strlen(blob->strings + material->name);
    for (int i = 0; i < MATERIAL_VALUES; i++) sum += touch_value(blob, &material->values[i]);
    if (material->bump != 0) sum += blob->textures[material->bump - 1].kind;
    if (material->normal_map != 0) sum += blob->textures[material->normal_map - 1].kind;
    if (material->kind == MATERIAL_MIX)
        for (int i = 0; i < 2; i++) sum += touch_material(blob, &blob->materials[material->parts[i]]);
    return sum;
}

static double touch_curves(const scene_blob_t *blob, const blob_curves_t *curves)
{
    double sum = 0;
    for (uint32_t i = 0; i < 4 * curves->segment_count; i++) {
        sum += (double)blob->curve_points[curves->first_point + i].x;
        if (curves->kind == CURVES_RIBBON) sum += (double)blob->normals[curves->first_normal + i].x;
    }
    return sum;
}

static double touch_shape(const scene_blob_t *blob, const blob_shape_t *shape)
{
    double sum = (double)strlen(blob->strings + shape->name);
    sum += touch_material(blob, &blob->materials[shape->material]);
    sum += touch_value(blob, &shape->alpha) + touch_value(blob, &shape->shadow_alpha);
    if (shape->light != BLOB_NONE) sum += touch_value(blob, &blob->lights[shape->light].radiance);
    for (int i = 0; i < 2; i++)
        if (shape->media[i] != 0) sum += (double)blob->media[shape->media[i] - 1].g;
    if (shape->kind == SHAPE_MESH) return sum + touch_mesh(blob, &blob->meshes[shape->geometry]);
    if (shape->kind == SHAPE_CURVES) return sum + touch_curves(blob, &blob->curves[shape->geometry]);
    return sum + (double)blob->quadrics[shape->geometry].radius;
}

static double touch_image(const scene_blob_t *blob, const blob_image_t *image)
{
    static const uint32_t bytes[] = {
        [TEXELS_R8] = 1, [TEXELS_RGBA8] = 4, [TEXELS_R32F] = 4, [TEXELS_RGB32F] = 12};
    const uint8_t *pixels = (const uint8_t *)(blob->texels + image->first_word);
    uint64_t size = (uint64_t)image->width * image->height * bytes[image->format];
    return (double)pixels[0] + (double)pixels[size - 1];
}

static double touch_texture(const scene_blob_t *blob, const blob_texture_t *texture)
{
    double sum = texture->image != 0 ? touch_image(blob, &blob->images[texture->image - 1]) : 0;
    for (int i = 0; i < TEXTURE_INPUTS; i++) sum += touch_value(blob, &texture->inputs[i]);
    return sum;
}

static double touch_light(const scene_blob_t *blob, const blob_light_t *light)
{
    double sum = light->image != 0 ? touch_image(blob, &blob->images[light->image - 1]) : 0;
    if (light->medium != 0) sum += (double)blob->media[light->medium - 1].g;
    return light->kind == LIGHT_AREA ? sum + blob->shapes[light->shape].kind : sum;
}

static double touch_fourier(const scene_blob_t *blob, const blob_fourier_t *table)
{
    uint32_t n = table->nodes;
    double sum = (double)blob->numbers[table->first_node + n - 1];
    sum += (double)blob->numbers[table->first_marginal + n * n - 1];
    sum += (double)blob->numbers[table->first_conditional + n * (n - 1) * (FOURIER_AZIMUTHS + 1) - 1];
    for (uint32_t i = 0; i < n * n; i++) {
        const blob_series_t *series = &blob->series[table->first_series + i];
        for (uint32_t k = 0; k < series->count * table->channels; k++)
            sum += (double)blob->numbers[series->first + k];
    }
    return sum;
}

static double touch_measured(const scene_blob_t *blob, const blob_measured_t *table)
{
    uint64_t slices = (uint64_t)table->azimuths * table->elevations;
    const blob_grid_t *grids[] = {&table->ndf, &table->sigma, &table->visible, &table->luminance};
    double sum = (double)blob->numbers[table->first_azimuth + table->azimuths - 1];
    sum += (double)blob->numbers[table->first_elevation + table->elevations - 1];
    for (size_t i = 0; i < ARRAY_LENGTH(grids); i++) {
        uint64_t pixels = (uint64_t)grids[i]->width * grids[i]->height;
        uint64_t count = i < 2 ? pixels : slices * (2 * pixels + grids[i]->height);
        sum += (double)blob->numbers[grids[i]->first + count - 1];
        if (i == 3) sum += (double)blob->numbers[table->first_colour + 3 * slices * pixels - 1];
    }
    return sum;
}

static double touch_field(const scene_blob_t *blob, blob_ref_t ref)
{
    if (ref == 0) return 0;
    const blob_field_t *field = &blob->fields[ref - 1];
    const uint32_t *n = field->cells;
    uint64_t cells = (uint64_t)n[0] * n[1] * n[2];
    if (field->kind == FIELD_CLOUD) return (double)field->parameters[0];
    if (field->kind == FIELD_CELLS) return (double)blob->numbers[field->first + field->channels * cells - 1];
    uint32_t brick = blob->bricks[field->first_brick + cells / BLOB_BRICK_CELLS - 1];
    return brick == BLOB_NONE
               ? 0
               : (double)blob->numbers[field->first + (uint64_t)(brick + 1) * BLOB_BRICK_CELLS - 1];
}

static double touch_medium(const scene_blob_t *blob, const blob_medium_t *medium)
{
    double sum = (double)medium->g;
    if (medium->temperature != 0) sum += (double)blob->numbers[medium->first_glow + 3 * BLOB_GLOW_STEPS - 1];
    return sum + touch_field(blob, medium->density) + touch_field(blob, medium->absorption_tint) +
           touch_field(blob, medium->scattering_tint) + touch_field(blob, medium->emission_tint) +
           touch_field(blob, medium->temperature);
}

/* Follows every reference that a renderer would. */
static void touch_everything(const scene_blob_t *blob)
{
    volatile double sum = 0;
    for (uint64_t o = 0; o < blob->counts[BLOB_SECTION_OBJECTS]; o++)
        for (uint32_t s = 0; s < blob->objects[o].shape_count; s++)
            sum += touch_shape(blob, &blob->shapes[blob->objects[o].first_shape + s]);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_INSTANCES]; i++)
        sum += blob->objects[blob->instances[i].object].shape_count;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++)
        sum += touch_light(blob, &blob->lights[i]);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_TEXTURES]; i++)
        sum += touch_texture(blob, &blob->textures[i]);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_FOURIERS]; i++)
        sum += touch_fourier(blob, &blob->fouriers[i]);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MEASUREMENTS]; i++)
        sum += touch_measured(blob, &blob->measurements[i]);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MEDIA]; i++)
        sum += touch_medium(blob, &blob->media[i]);
    if (blob->scene->medium != 0) sum += touch_medium(blob, &blob->media[blob->scene->medium - 1]);
    job_settings_t settings = blob_default_settings(blob);
    assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
}

static void random_contents_are_survived(void **state)
{
    (void)state;
    uint64_t size;
    uint8_t *bytes = make_blob(&size), *bad = mem_alloc(size);
    unsigned seed = 1;
    size_t accepted = 0;
    enum { ROUNDS = 40000 };
    for (int round = 0; round < ROUNDS; round++) {
        memcpy(bad, bytes, size);
        for (int flips = 1 + rand_r(&seed) % 4; flips > 0; flips--) {
            size_t at = SECTIONS_OFFSET + (size_t)rand_r(&seed) % (size - SECTIONS_OFFSET);
            const uint8_t values[] = {0, 1, 0xFF, 0x7F, (uint8_t)rand_r(&seed)};
            bad[at] = values[rand_r(&seed) % 5];
        }
        renew_checksum(bad, size);
        accepted += open_copy(bad, size, touch_everything).code == RESULT_OK;
    }
    /* Both outcomes must have been seen, or nothing was tested. */
    assert_true(accepted > ROUNDS / 100 && accepted < ROUNDS * 9 / 10);
    free(bytes);
    free(bad);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(everything_comes_back),
                                       cmocka_unit_test(the_same_scene_has_the_same_name),
                                       cmocka_unit_test(builders_grow_and_fill_in_late),
                                       cmocka_unit_test(blobs_are_written_to_files),
                                       cmocka_unit_test(files_are_mapped),
                                       cmocka_unit_test(every_truncation_is_an_error),
                                       cmocka_unit_test(every_flipped_byte_is_an_error),
                                       cmocka_unit_test(bad_indices_are_errors),
                                       cmocka_unit_test(bad_numbers_are_errors),
                                       cmocka_unit_test(media_are_checked),
                                       cmocka_unit_test(hopeless_transforms_are_errors),
                                       cmocka_unit_test(lenses_are_checked),
                                       cmocka_unit_test(depths_and_costs_are_limited),
                                       cmocka_unit_test(bad_headers_are_errors),
                                       cmocka_unit_test(random_contents_are_survived)};
    return cmocka_run_group_tests_name("blob", tests, NULL, NULL);
}
