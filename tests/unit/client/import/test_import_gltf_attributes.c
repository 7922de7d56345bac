/* Attributes of glTF's meshes: tangents, TANGENT or those of the texture coordinates, which normal maps and
 * anisotropy follow, as the renderer sees it; and what morph targets make of texture coordinates and colours.
 */
#include "tests/unit/client/import/test_import.h"

#include "worker/render/material/material.h"

/* A square over which u runs along x and v, as Lightmill has it, along y. */
typedef struct {
    float positions[4][3], normals[4][3], uvs[4][2];
    float up[4][4], up_mirrored[4][4], right[4][4], turn[4][3], wrong[4][4];
    float times[2], turns[2][4], weights[4][4];
    float slide[4][2], second[4][2], colours[4][4], paint[4][3], fade[4][4];
    uint16_t indices[6];
    uint8_t joints[4][4], pad[4];
} data_t;

static const data_t data = {
    .positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}},
    .normals = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}},
    .uvs = {{0, 1}, {1, 1}, {1, 0}, {0, 0}},
    .up = {{0, 1, 0, 1}, {0, 1, 0, 1}, {0, 1, 0, 1}, {0, 1, 0, 1}},
    .up_mirrored = {{0, 1, 0, -1}, {0, 1, 0, -1}, {0, 1, 0, -1}, {0, 1, 0, -1}},
    .right = {{1, 0, 0, 1}, {1, 0, 0, 1}, {1, 0, 0, 1}, {1, 0, 0, 1}},
    .turn = {{-1, 1, 0}, {-1, 1, 0}, {-1, 1, 0}, {-1, 1, 0}},
    .wrong = {{0, 0, 0, 1}, {NAN, 0, 0, 1}, {0, INFINITY, 0, 1}, {0, 0, 0, 1}},
    .times = {0, 1},
    .turns = {{0, 0, 0, 1}, {0, 0, 0.70710678f, 0.70710678f}}, /* a quarter turn about z */
    .weights = {{1, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}},
    .slide = {{1, 0}, {0, 2}, {0, 0}, {0, 0}},
    .second = {{0, 0}, {0, 1}, {1, 1}, {1, 0}}, /* u runs along y, v against x */
    .colours = {{0.5f, 0.5f, 0.5f, 0.5f}, {0, 0, 0, 1}, {0, 0, 0, 1}, {7, 0, 0, 1}},
    .paint = {{4, -2, 0.25f}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}},
    .fade = {{0, 0, 0, 0.5f}, {0, 0, 0, 0}, {0, 0, 0, 0}, {-6.5f, 0, 0, 0}},
    .indices = {0, 1, 2, 0, 2, 3},
};

static const struct {
    size_t offset, size;
    const char *text;
} rows[] = {
#define ROW(field, type, text)                                                                               \
    {                                                                                                        \
        offsetof(data_t, field), sizeof data.field, "\"componentType\":" type "," text                       \
    }
#define FLOATS "5126"
    /* 0 */ ROW(positions, FLOATS, "\"count\":4,\"type\":\"VEC3\""),
    /* 1 */ ROW(normals, FLOATS, "\"count\":4,\"type\":\"VEC3\""),
    /* 2 */ ROW(uvs, FLOATS, "\"count\":4,\"type\":\"VEC2\""),
    /* 3 */ ROW(up, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 4 */ ROW(up_mirrored, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 5 */ ROW(right, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 6 */ ROW(turn, FLOATS, "\"count\":4,\"type\":\"VEC3\""),
    /* 7 */ ROW(wrong, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 8 */ ROW(times, FLOATS, "\"count\":2,\"type\":\"SCALAR\""),
    /* 9 */ ROW(turns, FLOATS, "\"count\":2,\"type\":\"VEC4\""),
    /* 10 */ ROW(weights, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 11 */ ROW(indices, "5123", "\"count\":6,\"type\":\"SCALAR\""),
    /* 12 */ ROW(joints, "5121", "\"count\":4,\"type\":\"VEC4\""),
    /* 13 */ ROW(slide, FLOATS, "\"count\":4,\"type\":\"VEC2\""),
    /* 14 */ ROW(colours, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 15 */ ROW(paint, FLOATS, "\"count\":4,\"type\":\"VEC3\""),
    /* 16 */ ROW(fade, FLOATS, "\"count\":4,\"type\":\"VEC4\""),
    /* 17 */ ROW(times, FLOATS, "\"count\":2,\"type\":\"SCALAR\""),
    /* 18 */ ROW(second, FLOATS, "\"count\":4,\"type\":\"VEC2\""),
};

/* Two maps of one texel: what is 0.6 along the tangent and 0.8 along the normal, and the same along the
 * bitangent. */
static void write_files(bench_t *bench)
{
    struct {
        char head[12];
        float texel[3];
    } along = {"PF\n1 1\n-1.0\n", {0.8f, 0.5f, 0.9f}}, across = {"PF\n1 1\n-1.0\n", {0.5f, 0.8f, 0.9f}};
    bench_write(bench, "b.bin", &data, sizeof data);
    bench_write(bench, "along.pfm", &along, sizeof along);
    bench_write(bench, "across.pfm", &across, sizeof across);
}

/* Imports a scene of the accessors above, a material, and `rest`: further properties of the root. */
static void run(bench_t *bench, const char *material, const char *rest)
{
    char *text = NULL;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    fprintf(out, "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"uri\":\"b.bin\",\"byteLength\":%zu}],",
            sizeof data);
    for (size_t i = 0; i < ARRAY_LENGTH(rows); ++i)
        fprintf(out, "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu}", i ? "," : "\"bufferViews\":[",
                rows[i].offset, rows[i].size);
    for (size_t i = 0; i < ARRAY_LENGTH(rows); ++i)
        fprintf(out, "%s{\"bufferView\":%zu,%s}", i ? "," : "],\"accessors\":[", i, rows[i].text);
    fprintf(out,
            "],\"images\":[{\"uri\":\"along.pfm\"},{\"uri\":\"across.pfm\"}],"
            "\"textures\":[{\"source\":0},{\"source\":1}],\"materials\":[{%s}],%s}",
            material, rest);
    fclose(out);
    write_files(bench);
    bench_write(bench, "s.gltf", text, strlen(text));
    bench_import_file(bench, "s.gltf");
    free(text);
}

#define MESH(attributes, more)                                                                               \
    "\"meshes\":[{\"primitives\":[{\"material\":0,\"indices\":11,\"attributes\":{\"POSITION\":0,"            \
    "\"TEXCOORD_0\":2" attributes "}" more "}]}],"
#define NORMAL ",\"NORMAL\":1"
#define NODE(properties) "\"nodes\":[{\"mesh\":0" properties "}]"
#define MAP "\"normalTexture\":{\"index\":0}"

/* What a ray along -z meets at (x, y), at a time while the shutter is open. */
static bsdf_t seen(const bench_t *bench, float x, float y, float time)
{
    scene_t *scene;
    surface_t surface;
    bsdf_t bsdf;
    assert_int_equal(scene_new(&bench->blob, &scene).code, RESULT_OK);
    assert_true(scene_intersect(scene, vec3(x, y, 9), vec3(0, 0, -1), time, &surface));
    material_bsdf(scene, &surface, &bsdf);
    scene_destroy(&scene);
    return bsdf;
}

/* The two maps, with the surface's normal along z, must show the tangent and the bitangent. */
static void expect_tangents_of(const char *const maps[2], const char *rest, vec2_t place, float time,
                               vec3_t tangent, vec3_t bitangent)
{
    import_wishes_t wishes = import_wishes_none();
    wishes.time_point = 0.5, wishes.shutter = "1";
    bench_t bench = {.wishes = strstr(rest, "\"animations\"") ? &wishes : NULL};
    vec3_t expected[2] = {tangent, bitangent};
    for (int i = 0; i < 2; ++i) {
        run(&bench, maps[i], rest);
        bench_expect_ok(&bench);
        vec3_t n = seen(&bench, place.x, place.y, time).ns;
        expect_near((double)n.x, 0.6 * (double)expected[i].x, 1e-5);
        expect_near((double)n.y, 0.6 * (double)expected[i].y, 1e-5);
        expect_near((double)n.z, 0.8, 1e-5);
    }
    bench_close(&bench);
}

static void expect_tangents(const char *rest, vec2_t place, float time, vec3_t tangent, vec3_t bitangent)
{
    static const char *const maps[2] = {MAP, "\"normalTexture\":{\"index\":1}"};
    expect_tangents_of(maps, rest, place, time, tangent, bitangent);
}

static const vec2_t middle = {0.4f, 0.6f}, left = {-0.4f, 0.6f};
static const vec3_t plus_x = {1, 0, 0}, plus_y = {0, 1, 0}, minus_x = {-1, 0, 0}, minus_y = {0, -1, 0};

static void normal_maps_follow_the_tangents_of_the_file(void **state)
{
    (void)state;
    expect_tangents(MESH(NORMAL, "") NODE(""), middle, 0, plus_x, plus_y);
    expect_tangents(MESH(NORMAL ",\"TANGENT\":5", "") NODE(""), middle, 0, plus_x, plus_y);
    expect_tangents(MESH(NORMAL ",\"TANGENT\":3", "") NODE(""), middle, 0, plus_y, minus_x);
    expect_tangents(MESH(NORMAL ",\"TANGENT\":4", "") NODE(""), middle, 0, plus_y, plus_x);
    /* Without direction: those of the texture coordinates. Without normals: no tangents. */
    expect_tangents(MESH(NORMAL ",\"TANGENT\":7", "") NODE(""), middle, 0, plus_x, plus_y);
    expect_tangents(MESH(",\"TANGENT\":3", "") NODE(""), middle, 0, plus_x, plus_y);
}

/* Bitangents, too, go where the mesh goes, also in a mirror: alone, and as an instance. */
static void tangents_go_with_their_mesh(void **state)
{
    (void)state;
#define TURNED ",\"rotation\":[0,0,0.70710678,0.70710678]"
    expect_tangents(MESH(NORMAL ",\"TANGENT\":5", "") NODE(TURNED), left, 0, plus_y, minus_x);
    expect_tangents(MESH(NORMAL ",\"TANGENT\":5", "") NODE(",\"scale\":[-1,1,1]"), left, 0, minus_x, plus_y);
    expect_tangents(MESH(NORMAL ",\"TANGENT\":4", "") NODE(",\"scale\":[-1,1,1]"), left, 0, plus_y, minus_x);
#define TWO_NODES(properties) "\"nodes\":[{\"mesh\":0" properties "},{\"mesh\":0,\"translation\":[50,0,0]}]"
    expect_tangents(MESH(NORMAL ",\"TANGENT\":5", "") TWO_NODES(TURNED), left, 0, plus_y, minus_x);
    expect_tangents(MESH(NORMAL ",\"TANGENT\":4", "") TWO_NODES(",\"scale\":[-1,1,1]"), left, 0, plus_y,
                    minus_x);
}

#define SKINNED(tangent)                                                                                     \
    MESH(NORMAL ",\"TANGENT\":" tangent ",\"JOINTS_0\":12,\"WEIGHTS_0\":10", "")                             \
    "\"skins\":[{\"joints\":[1]}],"
#define MORPHED(more)                                                                                        \
    MESH(NORMAL ",\"TANGENT\":5", ",\"targets\":[{\"TANGENT\":6}]")                                          \
    "\"nodes\":[{\"mesh\":0" more "}]"

static void tangents_follow_skins_and_targets(void **state)
{
    (void)state;
    expect_tangents(SKINNED("5") "\"nodes\":[{\"mesh\":0,\"skin\":0},{\"rotation\":"
                                 "[0,0,0.70710678,0.70710678]}]",
                    left, 0, plus_y, minus_x);
    expect_tangents(SKINNED("4") "\"nodes\":[{\"mesh\":0,\"skin\":0},{\"scale\":[-1,1,1]}]", left, 0, plus_y,
                    minus_x);
    expect_tangents(MORPHED(",\"weights\":[1]"), middle, 0, plus_y, minus_x);
    expect_tangents(MORPHED(",\"weights\":[0]"), middle, 0, plus_x, plus_y);
}

#define TURNING(node)                                                                                        \
    ",\"animations\":[{\"channels\":[{\"sampler\":0,\"target\":{\"node\":" node ",\"path\":\"rotation\"}}]," \
    "\"samplers\":[{\"input\":8,\"output\":9}]}]"

/* While the shutter is open, from 0 to 1, a joint turns by 90 degrees. */
static void tangents_move_while_the_shutter_is_open(void **state)
{
    (void)state;
    const float half = 0.70710678f;
    const char *rest = SKINNED("5") "\"nodes\":[{\"mesh\":0,\"skin\":0},{}]" TURNING("1");
    expect_tangents(rest, middle, 0, plus_x, plus_y);
    expect_tangents(rest, (vec2_t){0.1f, 0.7f}, 0.5f, vec3(half, half, 0), vec3(-half, half, 0));
    expect_tangents(rest, left, 1, plus_y, minus_x);
    rest = MESH(NORMAL ",\"TANGENT\":3", "") NODE("") TURNING("0");
    expect_tangents(rest, middle, 0, plus_y, minus_x);
    expect_tangents(rest, left, 1, minus_x, minus_y);
}

static uint32_t first_tangent(const char *material, const char *attributes)
{
    bench_t bench = {0};
    char *rest = mem_printf(MESH("%s", "") NODE(""), attributes);
    run(&bench, material, rest);
    free(rest);
    bench_expect_ok(&bench);
    uint32_t first = bench.blob.meshes[0].first_tangent;
    bench_close(&bench);
    return first;
}

/* They take memory, so only a material that looks at them gets them. */
static void tangents_are_kept_where_something_follows_them(void **state)
{
    (void)state;
#define COAT "\"extensions\":{\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1,\"clearcoatNormalTexture\":{"
#define BRUSHED "\"extensions\":{\"KHR_materials_anisotropy\":{\"anisotropyStrength\":0.8}}"
    const char *both = NORMAL ",\"TANGENT\":3";
    assert_int_not_equal(first_tangent(MAP, both), 0);
    assert_int_not_equal(first_tangent(COAT "\"index\":0}}}", both), 0);
    assert_int_not_equal(first_tangent(BRUSHED, both), 0);
    assert_int_equal(first_tangent("\"doubleSided\":true", both), 0);
    assert_int_equal(first_tangent(MAP, NORMAL), 0);
    assert_int_equal(first_tangent(MAP, ",\"TANGENT\":3"), 0);
}

/* The set of the mesh that a texture goes by: 0, or 1 for `second`. */
static int set_of(const bench_t *bench, blob_ref_t texture)
{
    const blob_mesh_t *mesh = bench->blob.meshes;
    bool first = bench->blob.textures[texture - 1].mapping == MAPPING_UV;
    const vec2_t *uv = bench->blob.uvs + (first ? mesh->first_uv : mesh->first_uv2);
    return uv[1].x == 0;
}

static void normal_maps_follow_their_own_texture_coordinates(void **state)
{
    (void)state;
#define SECOND(index) "\"normalTexture\":{\"index\":" index ",\"texCoord\":1}"
#define COLOURED "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}},"
    static const char *const maps[2] = {COLOURED SECOND("0"), COLOURED SECOND("1")};
    const char *rest = MESH(",\"TEXCOORD_1\":18", "") NODE("");
    bench_t bench = {0};
    expect_tangents_of(maps, rest, middle, 0, plus_y, minus_x);
    expect_tangents_of(maps, MESH(NORMAL ",\"TEXCOORD_1\":18", "") NODE(""), middle, 0, plus_y, minus_x);
    expect_tangents_of(maps, MESH(NORMAL ",\"TEXCOORD_1\":18,\"TANGENT\":5", "") NODE(""), middle, 0, plus_x,
                       plus_y);
    expect_tangents_of(maps, MESH(NORMAL, "") NODE(""), middle, 0, plus_x, plus_y); /* no second set */
    expect_tangents(rest, middle, 0, plus_x, plus_y);
    run(&bench, maps[0], rest);
    bench_expect_ok(&bench);
    assert_null(strstr(bench.warnings, "different texture coordinates"));
    const blob_material_t *material = &bench.blob.materials[bench.blob.shapes[0].material];
    assert_int_equal(set_of(&bench, material->normal_map), 1);
    assert_int_equal(set_of(&bench, material->values[VALUE_REFLECTANCE].texture), 0);
    run(&bench, COLOURED COAT "\"index\":0,\"texCoord\":1}}}", rest);
    bench_expect_ok(&bench);
    assert_null(strstr(bench.warnings, "different texture coordinates"));
    material = &bench.blob.materials[bench.blob.shapes[0].material];
    assert_int_equal(bench.blob.textures[material->coat_normal_map - 1].mapping, MAPPING_UV);
    assert_int_equal(set_of(&bench, material->coat_normal_map), 1);
    assert_int_equal(set_of(&bench, material->values[VALUE_REFLECTANCE].texture), 0);
    run(&bench, SECOND("0") "," COAT "\"index\":0}}}", rest);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "its normal maps have different texture coordinates");
    bench_close(&bench);
}

static void anisotropy_follows_the_tangents_of_the_file(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, BRUSHED, MESH(NORMAL ",\"TANGENT\":3", "") NODE(""));
    bench_expect_ok(&bench);
    vec3_t s = seen(&bench, 0.4f, 0.6f, 0).s;
    expect_vec3(s, 0, 1, 0);
    bench_close(&bench);
}

static void tangents_that_are_none_are_errors(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MAP, MESH(NORMAL ",\"TANGENT\":6", "") NODE(""));
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, "accessor 6 has the wrong number of components for TANGENT");
    run(&bench, MAP, MESH(NORMAL ",\"TANGENT\":8", "") NODE(""));
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, "accessor 8 has the wrong number of components for TANGENT");
    bench_close(&bench);
}

/* ---- texture coordinates and colours of morph targets -------------------------------------------------- */

#define TARGETS(targets, weights)                                                                            \
    MESH(",\"TEXCOORD_1\":2,\"COLOR_0\":14", ",\"targets\":[" targets "]")                                   \
    "\"nodes\":[{\"mesh\":0,\"weights\":" weights "}]"

static void expect_uv(const bench_t *bench, uint32_t first, uint32_t vertex, double u, double v)
{
    expect_near((double)bench->blob.uvs[first + vertex].x, u, 1e-6);
    expect_near((double)bench->blob.uvs[first + vertex].y, 1 - v, 1e-6);
}

static void expect_colour(const bench_t *bench, uint32_t vertex, double r, double g, double b, double a)
{
    blob_colour_t c = bench->blob.colours[bench->blob.meshes[0].first_colour + vertex];
    expect_near((double)c.r, r, 1e-6);
    expect_near((double)c.g, g, 1e-6);
    expect_near((double)c.b, b, 1e-6);
    expect_near((double)c.a, a, 1e-6);
}

static void targets_move_texture_coordinates(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MAP, TARGETS("{\"TEXCOORD_0\":13},{\"TEXCOORD_1\":13}", "[0.5,-1]"));
    bench_expect_ok(&bench);
    const blob_mesh_t *mesh = bench.blob.meshes;
    expect_uv(&bench, mesh->first_uv, 0, 0.5, 1);
    expect_uv(&bench, mesh->first_uv, 1, 1, 2);
    expect_uv(&bench, mesh->first_uv, 2, 1, 0);
    expect_uv(&bench, mesh->first_uv2, 0, -1, 1);
    expect_uv(&bench, mesh->first_uv2, 1, 1, -1);
    run(&bench, MAP, TARGETS("{\"TEXCOORD_0\":15}", "[1]"));
    expect_text(bench.result.message, "accessor 15 has the wrong number of components for TEXCOORD_0");
    bench_close(&bench);
}

/* Else each triangle would show all of the image. A normal map tilts by the one texel, in some direction. */
static void images_on_a_mesh_without_texture_coordinates_are_one_texel(void **state)
{
    (void)state;
#define BARE(more)                                                                                           \
    "\"meshes\":[{\"primitives\":[{\"material\":0,\"indices\":11,\"attributes\":{\"POSITION\":0" more        \
    "}}]}]," NODE("")
    static const char *const materials[] = {MAP,
                                            "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
                                            "\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{\"index\":0}"};
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(materials); ++i) {
        run(&bench, materials[i], BARE(NORMAL));
        bench_expect_ok(&bench);
        assert_true(bench.blob.meshes[0].first_uv != BLOB_NONE);
        for (uint32_t k = 0; k < 4; ++k) expect_uv(&bench, bench.blob.meshes[0].first_uv, k, 0, 0);
        if (i == 0) expect_near((double)seen(&bench, 0.7f, 0.2f, 0).ns.z, 0.8, 1e-5);
    }
    run(&bench, materials[1], BARE(",\"TEXCOORD_1\":2"));
    bench_expect_ok(&bench);
    expect_uv(&bench, bench.blob.meshes[0].first_uv, 2, 0, 0);
    expect_uv(&bench, bench.blob.meshes[0].first_uv2, 2, 1, 0);
    run(&bench, "\"name\":\"plain\"", BARE(NORMAL));
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.meshes[0].first_uv, BLOB_NONE);
    bench_close(&bench);
}

/* The sum is cut off, not its parts. */
static void targets_change_colours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MAP, TARGETS("{\"COLOR_0\":15},{\"COLOR_0\":16}", "[0.5,1]"));
    bench_expect_ok(&bench);
    expect_colour(&bench, 0, 1, 0, 0.625, 1);
    expect_colour(&bench, 1, 0, 0, 0, 1);
    expect_colour(&bench, 3, 0.5, 0, 0, 1);
    run(&bench, MAP, TARGETS("{\"COLOR_0\":15}", "[0]"));
    expect_colour(&bench, 3, 1, 0, 0, 1);
    bench_close(&bench);
}

static void a_shutter_shows_colours_of_its_middle(void **state)
{
    (void)state;
    import_wishes_t wishes = import_wishes_none();
    wishes.time_point = 0.5, wishes.shutter = "1";
    bench_t bench = {.wishes = &wishes};
    run(&bench, MAP,
        TARGETS(
            "{\"TEXCOORD_0\":13,\"COLOR_0\":15,\"POSITION\":6}",
            "[0]") ",\"animations\":[{\"channels\":["
                   "{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"weights\"}}],\"samplers\":[{\"input\":8,"
                   "\"output\":17}]}]");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.meshes[0].steps, 5);
    expect_uv(&bench, bench.blob.meshes[0].first_uv, 0, 0.5, 1);
    expect_colour(&bench, 0, 1, 0, 0.625, 0.5);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(normal_maps_follow_the_tangents_of_the_file),
        cmocka_unit_test(tangents_go_with_their_mesh),
        cmocka_unit_test(tangents_follow_skins_and_targets),
        cmocka_unit_test(tangents_move_while_the_shutter_is_open),
        cmocka_unit_test(tangents_are_kept_where_something_follows_them),
        cmocka_unit_test(normal_maps_follow_their_own_texture_coordinates),
        cmocka_unit_test(anisotropy_follows_the_tangents_of_the_file),
        cmocka_unit_test(tangents_that_are_none_are_errors),
        cmocka_unit_test(targets_move_texture_coordinates),
        cmocka_unit_test(images_on_a_mesh_without_texture_coordinates_are_one_texel),
        cmocka_unit_test(targets_change_colours),
        cmocka_unit_test(a_shutter_shows_colours_of_its_middle),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
