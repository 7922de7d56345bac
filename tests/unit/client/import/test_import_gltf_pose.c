/* Skins and morph targets of glTF files: a mesh that they deform is a mesh placed by hand. */
#include "tests/unit/client/import/test_import.h"

#include "common/base.h"

/* What the scenes are made of. A square, what its vertices follow, and where targets move them. */
typedef struct {
    float positions[4][3], normals[4][3];
    uint16_t indices[6], joints2[4][4], pad;
    uint8_t joints[4][4], bad_joints[4][4], bytes[4][4];
    float whole[4][4], halves[4][4], mixed[4][4], nothing[4][4], wrong[4][4];
    float inverses[2][16];
    float shift[4][3], tilt[4][3];
    uint8_t sparse_index, pad2[3];
    float sparse_value[3];
    int8_t small[4][4];
} data_t;

static const data_t data = {
    .positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}},
    .normals = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}},
    .indices = {0, 1, 2, 0, 2, 3},
    .joints2 = {{0, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}},
    .joints = {{1, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}},
    .bad_joints = {{1, 0, 0, 0}, {1, 2, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}},
    .bytes = {{255, 0, 0, 0}, {255, 0, 0, 0}, {51, 204, 0, 0}, {255, 0, 0, 0}},
    .whole = {{1, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}},
    .halves = {{0.5f, 0, 0, 0}, {0.5f, 0, 0, 0}, {0.5f, 0, 0, 0}, {0.5f, 0, 0, 0}},
    .mixed = {{1, 0, 0, 0}, {0.5f, 0.5f, 0, 0}, {0.75f, 0.25f, 0, 0}, {3, 1, 0, 0}},
    .nothing = {{1, 0, 0, 0}, {0, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 0}},
    .wrong = {{1, NAN, 0, 0}, {1, -1, 0, 0}, {1, INFINITY, 0, 0}, {1, 0, 0, 0}},
    .inverses = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1},
                 {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -5, 0, 1}},
    .shift = {{0, 0, 2}, {0, 0, 2}, {4, 0, 2}, {0, 0, 2}},
    .tilt = {{1, 0, -1}, {1, 0, -1}, {1, 0, -1}, {1, 0, -1}},
    .sparse_index = 2,
    .sparse_value = {0, 8, 0},
    .small = {{0, 127, 0, 0}, {0, 127, 0, 0}, {0, 127, 0, 0}, {0, 127, 0, 0}},
};

/* The accessors, by these numbers. */
typedef struct {
    size_t offset, size;
    const char *text;
} row_t;
#define ROW(field, text)                                                                                     \
    {                                                                                                        \
        offsetof(data_t, field), sizeof data.field, text                                                     \
    }
static const row_t rows[] = {
    /* 0 */ ROW(positions, "\"componentType\":5126,\"count\":4,\"type\":\"VEC3\""),
    /* 1 */ ROW(normals, "\"componentType\":5126,\"count\":4,\"type\":\"VEC3\""),
    /* 2 */ ROW(indices, "\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\""),
    /* 3 */ ROW(joints, "\"componentType\":5121,\"count\":4,\"type\":\"VEC4\""),
    /* 4 */ ROW(whole, "\"componentType\":5126,\"count\":4,\"type\":\"VEC4\""),
    /* 5 */ ROW(mixed, "\"componentType\":5126,\"count\":4,\"type\":\"VEC4\""),
    /* 6 */ ROW(inverses, "\"componentType\":5126,\"count\":2,\"type\":\"MAT4\""),
    /* 7 */ ROW(joints2, "\"componentType\":5123,\"count\":4,\"type\":\"VEC4\""),
    /* 8 */ ROW(halves, "\"componentType\":5126,\"count\":4,\"type\":\"VEC4\""),
    /* 9 */ ROW(bytes, "\"componentType\":5121,\"normalized\":true,\"count\":4,\"type\":\"VEC4\""),
    /* 10 */ ROW(bad_joints, "\"componentType\":5121,\"count\":4,\"type\":\"VEC4\""),
    /* 11 */ ROW(nothing, "\"componentType\":5126,\"count\":4,\"type\":\"VEC4\""),
    /* 12 */ ROW(wrong, "\"componentType\":5126,\"count\":4,\"type\":\"VEC4\""),
    /* 13 */ ROW(shift, "\"componentType\":5126,\"count\":4,\"type\":\"VEC3\""),
    /* 14 */ ROW(tilt, "\"componentType\":5126,\"count\":4,\"type\":\"VEC3\""),
    /* 15 */ ROW(sparse_index, "\"componentType\":5121,\"count\":1,\"type\":\"SCALAR\""),
    /* 16 */ ROW(sparse_value, "\"componentType\":5126,\"count\":1,\"type\":\"VEC3\""),
    /* 17 */ ROW(inverses, "\"componentType\":5126,\"count\":1,\"type\":\"MAT4\""),
};
/* Two more: 18: zeroes but for one element, 19: signed bytes, four of them an element. */
static const char more[] = "{\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"sparse\":{\"count\":1,"
                           "\"indices\":{\"bufferView\":15,\"componentType\":5121},"
                           "\"values\":{\"bufferView\":16}}},"
                           "{\"bufferView\":18,\"componentType\":5120,\"normalized\":true,\"count\":4,"
                           "\"type\":\"VEC3\"}";

/* Imports a scene of these accessors and `rest`: further properties of the root. */
static void run(bench_t *bench, const char *rest)
{
    char *text = NULL;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    fprintf(out, "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"uri\":\"b.bin\",\"byteLength\":%zu}],",
            sizeof data);
    fprintf(out, "\"bufferViews\":[");
    for (size_t i = 0; i < ARRAY_LENGTH(rows); ++i)
        fprintf(out, "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu},", rows[i].offset, rows[i].size);
    fprintf(out, "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":16,\"byteStride\":4}],\"accessors\":[",
            offsetof(data_t, small));
    for (size_t i = 0; i < ARRAY_LENGTH(rows); ++i) fprintf(out, "{\"bufferView\":%zu,%s},", i, rows[i].text);
    fprintf(out, "%s],%s}", more, rest);
    fclose(out);
    bench_write(bench, "b.bin", &data, sizeof data);
    bench_write(bench, "s.gltf", text, strlen(text));
    bench_import_file(bench, "s.gltf");
    free(text);
}

#define SQUARE "\"POSITION\":0,\"NORMAL\":1"
#define MESH(attributes, more_)                                                                              \
    "\"meshes\":[{\"primitives\":[{\"attributes\":{" attributes "},\"indices\":2" more_ "]}]"
#define SKIN "\"skins\":[{\"joints\":[1,2],\"inverseBindMatrices\":6}]"
/* Node 0 has the mesh; where it stands itself means nothing. Joint 0 is node 1, joint 1 node 2, which hangs
 * from it: a quarter turn about z, then to (2, 5). With what the inverses say, joint 0 takes (x, y, z) to
 * (x, y, z + 1), and joint 1 to (7 - y, x + 5, z + 1). */
#define JOINTS "{\"translation\":[0,0,1],\"children\":[2]},{\"matrix\":[0,1,0,0, -1,0,0,0, 0,0,1,0, 2,5,0,1]}"
#define NODES "\"nodes\":[{\"mesh\":0,\"skin\":0,\"name\":\"n\",\"translation\":[9,9,9]}," JOINTS "]"
#define SKINNED(joints, weights)                                                                             \
    MESH(SQUARE ",\"JOINTS_0\":" joints ",\"WEIGHTS_0\":" weights, "}") "," SKIN "," NODES

static vec3_t position(const bench_t *bench, uint32_t i)
{
    const blob_mesh_t *mesh = &bench->blob.meshes[bench->blob.shapes[0].geometry];
    assert_true(i < mesh->vertex_count);
    return bench->blob.positions[mesh->first_position + i];
}

static vec3_t normal(const bench_t *bench, uint32_t i)
{
    const blob_mesh_t *mesh = &bench->blob.meshes[bench->blob.shapes[0].geometry];
    assert_true(i < mesh->vertex_count && mesh->first_normal != BLOB_NONE);
    return bench->blob.normals[mesh->first_normal + i];
}

static hash_t name_of(const bench_t *bench)
{
    bench_expect_ok(bench);
    return bench->blob.hash;
}

/* Both are the same scene, to the bit. */
static void expect_same(const char *posed, const char *placed)
{
    bench_t a = {0}, b = {0};
    run(&a, posed);
    run(&b, placed);
    hash_t left = name_of(&a), right = name_of(&b);
    assert_memory_equal(&left, &right, sizeof left);
    bench_close(&a);
    bench_close(&b);
}

/* ---- skins --------------------------------------------------------------------------------------------- */

static void a_skinned_mesh_is_one_placed_by_hand(void **state)
{
    (void)state;
    expect_same(SKINNED("3", "4"), MESH(SQUARE, "}") ",\"nodes\":[{\"mesh\":0,\"name\":\"n\",\"matrix\":"
                                                     "[0,1,0,0, -1,0,0,0, 0,0,1,0, 7,5,1,1]}]");
}

static void weights_that_are_no_weights_count_as_0(void **state)
{
    (void)state;
    expect_same(SKINNED("3", "12"), SKINNED("3", "4"));
}

static void vertices_follow_the_mean_of_their_joints(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SKINNED("3", "5"));
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 0), 7, 5, 1);
    expect_vec3(position(&bench, 1), 4, 3, 1);
    expect_vec3(position(&bench, 2), 4.75, 4.75, 1);
    expect_vec3(position(&bench, 3), 4.5, 4, 1); /* weights 3 and 1, which are 3/4 and 1/4 */
    expect_vec3(normal(&bench, 1), 0, 0, 1);
    run(&bench, SKINNED("3", "9")); /* bytes */
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 2), 2, 2, 1);
    bench_close(&bench);
}

static void several_sets_of_joints_are_added_up(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SKINNED("3", "8,\"JOINTS_1\":7,\"WEIGHTS_1\":8"));
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 0), 3.5, 2.5, 1);
    bench_close(&bench);
}

/* (p1 - p0) x (p2 - p0) of the first triangle, on the side that its shape says. */
static vec3_t facing(const bench_t *bench)
{
    const blob_shape_t *shape = &bench->blob.shapes[0];
    const uint32_t *v = bench->blob.triangles[bench->blob.meshes[shape->geometry].first_triangle].v;
    vec3_t p = position(bench, v[0]);
    vec3_t n = v_cross(v_sub(position(bench, v[1]), p), v_sub(position(bench, v[2]), p));
    return shape->flags & SHAPE_FLIP ? v_neg(n) : n;
}

static void joints_that_mirror_do_not_turn_a_mesh_inside_out(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        MESH("\"POSITION\":0,\"JOINTS_0\":7,\"WEIGHTS_0\":4",
             "}") "," SKIN ",\"nodes\":[{\"mesh\":0,\"skin\":0},{\"scale\":[-1,1,1],\"children\":[2]},{}]");
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 1), -1, 0, 0);
    expect_vec3(facing(&bench), 0, 0, 1);
    bench_close(&bench);
}

static void a_vertex_without_weights_follows_its_first_joint(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, SKINNED("3", "11"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "1 of 4 vertices have no weight above 0");
    expect_vec3(position(&bench, 1), 7, 6, 1);
    bench_close(&bench);
}

static void a_primitive_without_joints_stands_where_its_node_does(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MESH(SQUARE, "}") "," SKIN "," NODES);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "has no JOINTS_0 and WEIGHTS_0");
    expect_vec3(position(&bench, 1), 10, 9, 9);
    bench_close(&bench);
}

static void expect_failure(const char *rest, const char *message)
{
    bench_t bench = {0};
    run(&bench, rest);
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, message);
    bench_close(&bench);
}

static void broken_skins_are_errors(void **state)
{
    (void)state;
    expect_failure(SKINNED("10", "5"), "vertex 1 follows joint 2, but its skin has 2");
    expect_failure(SKINNED("4", "4"), "JOINTS_0 must be unsigned integers");
    expect_failure(SKINNED("3", "0"), "wrong number of components for WEIGHTS_0");
    expect_failure(SKINNED("3", "4") ",\"scenes\":[{\"nodes\":[0]}]",
                   "element 0, node 1, is not in the scene");
#define WITH_SKIN(skin) MESH(SQUARE ",\"JOINTS_0\":3,\"WEIGHTS_0\":4", "}") ",\"skins\":[" skin "]," NODES
    expect_failure(WITH_SKIN(""), "nodes[0] (n).skin: is 0, but there are 0");
    expect_failure(WITH_SKIN("{\"joints\":[]}"), "skins[0]: needs joints");
    expect_failure(WITH_SKIN("{\"joints\":[1,7]}"), "element 1 must be the index of one of the 3 nodes");
    expect_failure(WITH_SKIN("{\"joints\":[1,2],\"inverseBindMatrices\":17}"),
                   "has 1 inverseBindMatrices for 2 joints");
    expect_failure(WITH_SKIN("{\"joints\":[1,2],\"inverseBindMatrices\":0}"), "must be a MAT4 of floats");
}

static void a_joint_that_weighs_nothing_need_not_exist(void **state)
{
    (void)state;
    expect_same(SKINNED("10", "4"), SKINNED("3", "4"));
}

static void a_broken_skin_is_left_off_leniently(void **state)
{
    (void)state;
    bench_t bench = {.lenient = true};
    run(&bench, WITH_SKIN("{\"joints\":[1,2],\"inverseBindMatrices\":17}"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "rest pose");
    expect_vec3(position(&bench, 0), 9, 9, 9);
    bench_close(&bench);
}

/* ---- morph targets ------------------------------------------------------------------------------------- */

#define TARGETS ",\"targets\":[{\"POSITION\":13,\"NORMAL\":14},{\"POSITION\":18},{\"POSITION\":19}]}"
#define MORPHED(weights, attributes)                                                                         \
    "\"meshes\":[{\"weights\":" weights ",\"primitives\":[{\"attributes\":{" attributes                      \
    "},\"indices\":2" TARGETS "]}]"

static void targets_move_vertices_by_their_weights(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MORPHED("[0.5,2]", SQUARE) ",\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 0), 0, 0, 1);
    expect_vec3(position(&bench, 2), 3, 17, 1); /* the second target moves this vertex alone */
    expect_vec3(normal(&bench, 0), sqrt(0.5), 0, sqrt(0.5));
    run(&bench, MORPHED("[0,0,3]", SQUARE) ",\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 2), 1, 4, 0);
    bench_close(&bench);
}

static void weights_of_a_node_go_before_those_of_its_mesh(void **state)
{
    (void)state;
    expect_same(MORPHED("[0.5,2]", SQUARE) ",\"nodes\":[{\"mesh\":0,\"name\":\"n\",\"weights\":[0,0,0]}]",
                MESH(SQUARE, "}") ",\"nodes\":[{\"mesh\":0,\"name\":\"n\"}]");
}

static void places_with_weights_of_their_own_share_no_object(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        MORPHED("[0.5]", SQUARE) ",\"nodes\":[{\"mesh\":0},{\"mesh\":0},{\"mesh\":0,\"weights\":[1]}]");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 2);
    assert_int_equal(bench.blob.objects[0].shape_count, 1);
    expect_vec3(position(&bench, 0), 0, 0, 2);
    const blob_mesh_t *shared = &bench.blob.meshes[bench.blob.shapes[1].geometry];
    expect_vec3(bench.blob.positions[shared->first_position], 0, 0, 1);
    bench_close(&bench);
}

static void a_skin_takes_what_targets_have_moved(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MORPHED("[0.5]", SQUARE ",\"JOINTS_0\":3,\"WEIGHTS_0\":4") "," SKIN "," NODES);
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 2), 6, 8, 2); /* (3, 1, 1) by joint 1 */
    bench_close(&bench);
}

static void broken_targets_are_errors(void **state)
{
    (void)state;
#define WITH_TARGET(target)                                                                                  \
    "\"meshes\":[{\"weights\":[1],\"primitives\":[{\"attributes\":{" SQUARE                                  \
    "},\"indices\":2,\"targets\":[" target "]}]}],\"nodes\":[{\"mesh\":0}]"
    expect_failure(WITH_TARGET("{\"POSITION\":3}"), "wrong number of components for POSITION");
    expect_failure(WITH_TARGET("{\"POSITION\":16}"), "POSITION has 1 elements for 4 vertices");
    expect_failure(WITH_TARGET("{\"NORMAL\":99}"), "NORMAL: is 99, but there are 20");
    expect_failure(WITH_TARGET("7"), "targets[0]: must be an object");
    expect_failure(MORPHED("[\"a\"]", SQUARE) ",\"nodes\":[{\"mesh\":0}]", "weights[0]: must be a number");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_skinned_mesh_is_one_placed_by_hand),
        cmocka_unit_test(weights_that_are_no_weights_count_as_0),
        cmocka_unit_test(vertices_follow_the_mean_of_their_joints),
        cmocka_unit_test(several_sets_of_joints_are_added_up),
        cmocka_unit_test(joints_that_mirror_do_not_turn_a_mesh_inside_out),
        cmocka_unit_test(a_vertex_without_weights_follows_its_first_joint),
        cmocka_unit_test(a_primitive_without_joints_stands_where_its_node_does),
        cmocka_unit_test(broken_skins_are_errors),
        cmocka_unit_test(a_joint_that_weighs_nothing_need_not_exist),
        cmocka_unit_test(a_broken_skin_is_left_off_leniently),
        cmocka_unit_test(targets_move_vertices_by_their_weights),
        cmocka_unit_test(weights_of_a_node_go_before_those_of_its_mesh),
        cmocka_unit_test(places_with_weights_of_their_own_share_no_object),
        cmocka_unit_test(a_skin_takes_what_targets_have_moved),
        cmocka_unit_test(broken_targets_are_errors),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
