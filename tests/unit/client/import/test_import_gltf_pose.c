/* Skins, morph targets and animations of glTF files: what they make of a mesh is a mesh placed by hand. */
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
    float times[3], moves[3][3], turns[3][4], spline[6][3], target_weights[3][2], bad_moves[3][3];
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
    .times = {1, 2, 4},
    .moves = {{0, 0, 0}, {2, 0, 0}, {6, 0, 4}},
    .turns = {{0, 0, 0, 1}, {0, 0, -0.70710678f, -0.70710678f}, {0, 0, 1, 0}}, /* 0, 90 and 180 degrees */
    .spline = {{9, 9, 9}, {0, 0, 0}, {1, 0, 0}, {3, 0, 0}, {1, 2, 0}, {9, 9, 9}},
    .target_weights = {{0, 0}, {0.5f, 2}, {1, 0}},
    .bad_moves = {{0, 0, 0}, {NAN, 0, 0}, {0, 0, 0}},
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
    /* 18 */ ROW(times, "\"componentType\":5126,\"count\":3,\"type\":\"SCALAR\""),
    /* 19 */ ROW(moves, "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\""),
    /* 20 */ ROW(turns, "\"componentType\":5126,\"count\":3,\"type\":\"VEC4\""),
    /* 21 */ ROW(spline, "\"componentType\":5126,\"count\":6,\"type\":\"VEC3\""),
    /* 22 */ ROW(target_weights, "\"componentType\":5126,\"count\":6,\"type\":\"SCALAR\""),
    /* 23 */ ROW(bad_moves, "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\""),
    /* 24 */ ROW(times, "\"componentType\":5126,\"count\":2,\"type\":\"SCALAR\""),
};
/* Two more: 25: zeroes but for one element, 26: signed bytes, four of them an element. */
static const char more[] = "{\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"sparse\":{\"count\":1,"
                           "\"indices\":{\"bufferView\":15,\"componentType\":5121},"
                           "\"values\":{\"bufferView\":16}}},"
                           "{\"bufferView\":25,\"componentType\":5120,\"normalized\":true,\"count\":4,"
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

static void a_scale_of_0_hides_nothing_that_a_skin_moves(void **state)
{
    (void)state;
    expect_same(MESH(SQUARE ",\"JOINTS_0\":3,\"WEIGHTS_0\":4",
                     "}") "," SKIN
                          ",\"nodes\":[{\"mesh\":0,\"skin\":0,\"name\":\"n\",\"scale\":[0,0,0]}," JOINTS "]",
                SKINNED("3", "4"));
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
    expect_failure(
        MESH(SQUARE ",\"JOINTS_0\":3,\"WEIGHTS_0\":4",
             "}") "," SKIN
                  ",\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"skin\":0},{\"children\":[2]},"
                  "{\"children\":[1]}]",
        "element 0, node 1, hangs from itself");
#define WITH_SKIN(skin) MESH(SQUARE ",\"JOINTS_0\":3,\"WEIGHTS_0\":4", "}") ",\"skins\":[" skin "]," NODES
    expect_failure(WITH_SKIN(""), "nodes[0] (n).skin: is 0, but there are 0");
    expect_failure(WITH_SKIN("{\"joints\":[]}"), "skins[0]: needs joints");
    expect_failure(WITH_SKIN("{\"joints\":[1,7]}"), "element 1 must be the index of one of the 3 nodes");
    expect_failure(WITH_SKIN("{\"joints\":[1,2],\"inverseBindMatrices\":17}"),
                   "has 1 inverseBindMatrices for 2 joints");
    expect_failure(WITH_SKIN("{\"joints\":[1,2],\"inverseBindMatrices\":0}"), "must be a MAT4 of floats");
}

static void joints_need_not_be_in_the_scene(void **state)
{
    (void)state;
    expect_same(SKINNED("3", "4") ",\"scenes\":[{\"nodes\":[0]}]", SKINNED("3", "4"));
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

#define TARGETS ",\"targets\":[{\"POSITION\":13,\"NORMAL\":14},{\"POSITION\":25},{\"POSITION\":26}]}"
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
    expect_failure(WITH_TARGET("{\"NORMAL\":99}"), "NORMAL: is 99, but there are 27");
    expect_failure(WITH_TARGET("7"), "targets[0]: must be an object");
    expect_failure(MORPHED("[\"a\"]", SQUARE) ",\"nodes\":[{\"mesh\":0}]", "weights[0]: must be a number");
}

/* ---- animations ---------------------------------------------------------------------------------------- */

#define PLAIN MESH(SQUARE, "}")
#define CHANNEL(path, node) "{\"sampler\":0,\"target\":{\"node\":" node ",\"path\":\"" path "\"}}"
#define SAMPLER(input, output, how)                                                                          \
    "{\"input\":" input ",\"output\":" output ",\"interpolation\":\"" how "\"}"
#define ANIMATION(name, channels, samplers)                                                                  \
    "{\"name\":\"" name "\",\"channels\":[" channels "],\"samplers\":[" samplers "]}"
#define ANIMATED(mesh, path, output, how)                                                                    \
    mesh ",\"nodes\":[{\"mesh\":0,\"name\":\"n\"}],\"animations\":[" ANIMATION(                              \
        "a", CHANNEL(path, "0"), SAMPLER("18", output, how)) "]"

/* Imports the scene as it is at that time. */
static void run_at(bench_t *bench, const char *rest, double time)
{
    import_wishes_t wishes = import_wishes_none();
    wishes.time_point = time;
    bench->wishes = &wishes;
    run(bench, rest);
    bench->wishes = NULL;
}

/* Where a corner of the square is at that time; 0: its origin, 1: x = 1. */
static vec3_t corner_at(const char *rest, double time, uint32_t corner)
{
    bench_t bench = {0};
    run_at(&bench, rest, time);
    bench_expect_ok(&bench);
    if (strstr(bench.warnings, "animation")) fail_msg("%s", bench.warnings);
    vec3_t p = position(&bench, corner);
    bench_close(&bench);
    return p;
}

static void nodes_stand_between_their_keys(void **state)
{
    (void)state;
    static const char linear[] = ANIMATED(PLAIN, "translation", "19", "LINEAR"),
                      step[] = ANIMATED(PLAIN, "translation", "19", "STEP");
    expect_vec3(corner_at(linear, 3, 0), 4, 0, 2);
    expect_vec3(corner_at(linear, 2, 0), 2, 0, 0);
    expect_vec3(corner_at(linear, 0, 0), 0, 0, 0); /* before the first key */
    expect_vec3(corner_at(linear, 99, 0), 6, 0, 4);
    expect_vec3(corner_at(step, 3.9, 0), 2, 0, 0);
    expect_vec3(corner_at(step, 4, 0), 6, 0, 4);
}

static void rotations_take_the_shorter_arc(void **state)
{
    (void)state;
    static const char turning[] = ANIMATED(PLAIN, "rotation", "20", "LINEAR");
    expect_vec3(corner_at(turning, 1 + 1 / 3.0, 1), sqrt(0.75), 0.5, 0); /* 30 degrees */
    expect_vec3(corner_at(turning, 3, 1), -sqrt(0.5), sqrt(0.5), 0);
}

static void splines_are_cubic(void **state)
{
    (void)state;
    static const char spline[] = PLAIN ",\"nodes\":[{\"mesh\":0}],\"animations\":[" ANIMATION(
        "a", CHANNEL("translation", "0"), SAMPLER("24", "21", "CUBICSPLINE")) "]";
    expect_vec3(corner_at(spline, 1.5, 0), 0.25, 1, 0); /* x: 1/8 + 1/2 - 3/8 */
    expect_vec3(corner_at(spline, 2, 0), 1, 2, 0);
}

static void weights_are_animated(void **state)
{
    (void)state;
    /* at 1.5 seconds the weights are 0.25 and 1 */
    expect_vec3(corner_at(ANIMATED(MORPHED("[7,7]", SQUARE), "weights", "22", "LINEAR"), 1.5, 2), 2, 9, 0.5);
}

static void a_joint_that_moves_takes_its_mesh_along(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_at(&bench,
           SKINNED("3", "4") ",\"animations\":[" ANIMATION("a", CHANNEL("translation", "1"),
                                                           SAMPLER("18", "19", "LINEAR")) "]",
           4);
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 0), 7 + 6, 5, 4); /* joint 1 hangs from joint 0 */
    bench_close(&bench);
}

static void an_animated_mesh_is_one_placed_by_hand(void **state)
{
    (void)state;
    bench_t a = {0}, b = {0};
    run_at(&a, ANIMATED(PLAIN, "translation", "19", "LINEAR"), 3);
    run(&b, PLAIN ",\"nodes\":[{\"mesh\":0,\"name\":\"n\",\"translation\":[4,0,2]}]");
    hash_t left = name_of(&a), right = name_of(&b);
    assert_memory_equal(&left, &right, sizeof left);
    bench_close(&a);
    bench_close(&b);
}

static void cameras_and_lamps_move_too(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_at(&bench,
           PLAIN ",\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.5}}],"
                 "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\"}]}},"
                 "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"children\":[2]},"
                 "{\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}],\"animations\":[" ANIMATION(
                     "a", CHANNEL("translation", "1"), SAMPLER("18", "19", "LINEAR")) "]",
           3);
    bench_expect_silence(&bench);
    expect_near((double)bench.blob.scene->world_from_camera.m[0][3], 4, 1e-6);
    expect_near((double)bench.blob.lights[0].world_from_light.m[2][3], 2, 1e-6);
    bench_close(&bench);
}

static void a_frame_is_a_time(void **state)
{
    (void)state;
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    wishes.frame = 72;
    bench.wishes = &wishes;
    run(&bench, ANIMATED(PLAIN, "translation", "19", "LINEAR"));
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 0), 4, 0, 2);
    wishes.frames_per_second = 48;
    run(&bench, ANIMATED(PLAIN, "translation", "19", "LINEAR"));
    expect_vec3(position(&bench, 0), 1, 0, 0);
    bench_close(&bench);
}

/* Three animations: the second moves what the first does, the third something else. */
#define THREE                                                                                                \
    PLAIN ",\"nodes\":[{\"mesh\":0}],\"animations\":[" ANIMATION(                                            \
        "walk", CHANNEL("translation", "0"),                                                                 \
        SAMPLER("18", "19",                                                                                  \
                "LINEAR")) "," ANIMATION("run", CHANNEL("translation", "0"),                                 \
                                         SAMPLER("18", "19",                                                 \
                                                 "STEP")) "," ANIMATION("turn", CHANNEL("rotation", "0"),    \
                                                                        SAMPLER("18", "20", "LINEAR")) "]"

static void expect_choice(const char *animation, vec3_t corner, const char *warning)
{
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    wishes.time_point = 3;
    wishes.animation = animation;
    bench.wishes = &wishes;
    run(&bench, THREE);
    bench_expect_ok(&bench);
    expect_vec3(position(&bench, 1), (double)corner.x, (double)corner.y, (double)corner.z);
    expect_text(bench.warnings, warning);
    bench_close(&bench);
}

static void animations_that_go_together_are_taken_together(void **state)
{
    (void)state;
    const float half = 0.70710678f;
    expect_choice(NULL, vec3(4 - half, half, 2), "1 of 3 (animations[1] (run)) move what one before them");
    expect_choice("run", vec3(3, 0, 0), "");
    expect_choice("3", vec3(-half, half, 0), "");
}

static void expect_usage(const import_wishes_t *wishes, const char *rest, const char *message)
{
    bench_t bench = {.wishes = wishes};
    run(&bench, rest);
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, message);
    bench_close(&bench);
}

static void moments_that_make_no_sense_are_refused(void **state)
{
    (void)state;
    import_wishes_t wishes = import_wishes_none();
    wishes.animation = "fly";
    expect_usage(&wishes, THREE, "--animation needs --time-point or --frame");
    wishes.frame = 1;
    expect_usage(&wishes, THREE, "no animation 'fly'; it has 3: 1: walk, 2: run, 3: turn");
    wishes.time_point = 1;
    expect_usage(&wishes, THREE, "give one of them");
    wishes.frame = (double)NAN;
    wishes.frames_per_second = 30;
    expect_usage(&wishes, THREE, "--frames-per-second needs --frame");
    bench_t bench = {.wishes = &wishes};
    wishes = import_wishes_none();
    wishes.time_point = 0;
    bench_run_v3(&bench, "");
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, "--time-point and --frame are for files with animations");
    bench_close(&bench);
}

static void without_a_moment_nothing_is_animated(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, ANIMATED(PLAIN, "translation", "23", "LINEAR"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "--time-point or --frame takes a moment");
    expect_vec3(position(&bench, 1), 1, 0, 0);
    run_at(&bench, PLAIN ",\"nodes\":[{\"mesh\":0}]", 1);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "has no animations");
    bench_close(&bench);
}

static void a_pointer_is_ignored(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_at(&bench,
           "\"extensionsUsed\":[\"KHR_animation_pointer\"]," ANIMATED(PLAIN, "pointer", "19", "LINEAR"), 3);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "animations[0] (a).channels[0]: moves no node; it is ignored");
    bench_close(&bench);
}

static void expect_failure_at(const char *rest, const char *message)
{
    bench_t bench = {0};
    run_at(&bench, rest, 2);
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, message);
    bench_close(&bench);
}

static void broken_animations_are_errors(void **state)
{
    (void)state;
#define WITH_SAMPLER(sampler)                                                                                \
    PLAIN ",\"nodes\":[{\"mesh\":0}],\"animations\":[" ANIMATION("a", CHANNEL("translation", "0"),           \
                                                                 sampler) "]"
    expect_failure_at(ANIMATED(PLAIN, "translation", "23", "LINEAR"),
                      "animated translation is not finite at 2");
    expect_failure_at(ANIMATED(PLAIN, "rotation", "19", "LINEAR"), "wrong number of components");
    expect_failure_at(ANIMATED(PLAIN, "translation", "19", "CUBICSPLINE"), "has 3 values for 3 keys");
    expect_failure_at(ANIMATED(PLAIN, "translation", "19", "SMOOTH"), "found \"SMOOTH\"");
    expect_failure_at(WITH_SAMPLER(SAMPLER("19", "19", "STEP")), "input (accessor 19) must be SCALAR floats");
    expect_failure_at(WITH_SAMPLER("{\"output\":19}"), "needs input and output");
    expect_failure_at(WITH_SAMPLER(""), "sampler: is 0, but there are 0");
}

/* ---- motion blur --------------------------------------------------------------------------------------- */

/* Imports the scene as a shutter sees it that is open from 2 to 4 seconds. */
static void run_blurred(bench_t *bench, const char *rest)
{
    import_wishes_t wishes = import_wishes_none();
    wishes.time_point = 3;
    wishes.shutter = "2";
    bench->wishes = &wishes;
    run(bench, rest);
    bench->wishes = NULL;
    bench_expect_ok(bench);
}

static void what_moves_as_a_whole_becomes_a_moving_instance(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_blurred(&bench, ANIMATED(PLAIN, "translation", "19", "LINEAR"));
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 1);
    const blob_instance_t *instance = bench.blob.instances;
    expect_near((double)instance->world_from_object.m[0][3], 2, 0);
    expect_near((double)instance->world_from_object_end.m[0][3], 6, 0);
    assert_int_equal(bench.blob.meshes[0].steps, 0);
    bench_close(&bench);
}

/* Vertex i of the first mesh at one of its five times. */
static vec3_t position_at(const bench_t *bench, uint32_t step, uint32_t i)
{
    const blob_mesh_t *mesh = &bench->blob.meshes[bench->blob.shapes[0].geometry];
    assert_int_equal(mesh->steps, 5);
    return bench->blob.positions[mesh->first_position + step * mesh->vertex_count + i];
}

static void what_a_skin_moves_is_given_at_several_times(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_blurred(&bench, SKINNED("3", "4") ",\"animations\":[" ANIMATION("a", CHANNEL("translation", "1"),
                                                                        SAMPLER("18", "19", "LINEAR")) "]");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 0);
    for (uint32_t k = 0; k < 5; ++k) expect_vec3(position_at(&bench, k, 1), 9 + k, 6, k);
    assert_true(bench.blob.meshes[0].first_normal != BLOB_NONE);
    bench_close(&bench);
}

static void what_targets_move_is_given_at_several_times(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_blurred(&bench, ANIMATED(MORPHED("[7,7]", SQUARE), "weights", "22", "LINEAR"));
    expect_vec3(position_at(&bench, 0, 2), 1 + 4 * 0.5, 1 + 16, 1); /* weights 0.5 and 2 */
    expect_vec3(position_at(&bench, 2, 2), 1 + 4 * 0.75, 1 + 8, 1.5);
    expect_vec3(position_at(&bench, 4, 2), 1 + 4, 1, 2);
    bench_close(&bench);
}

static void what_is_flattened_is_given_at_several_times(void **state)
{
    (void)state;
    bench_t bench = {0};
    /* the scale of y is 0, that of z begins with 0: no instance may be so */
    run_blurred(&bench, PLAIN
                ",\"nodes\":[{\"children\":[1]},{\"mesh\":0,\"rotation\":[0.70710678,0,0,0.70710678]}],"
                "\"animations\":[" ANIMATION("a", CHANNEL("scale", "0"), SAMPLER("18", "19", "LINEAR")) "]");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 0);
    expect_vec3(position_at(&bench, 0, 2), 2, 0, 0);
    expect_vec3(position_at(&bench, 4, 2), 6, 0, 4);
    bench_close(&bench);
}

static void a_camera_moves_while_the_shutter_is_open(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_blurred(&bench,
                PLAIN ",\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.5}}],"
                      "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\"}]}},"
                      "\"nodes\":[{\"mesh\":0},{\"camera\":0,\"children\":[2]},"
                      "{\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}],\"animations\":[" ANIMATION(
                          "a", CHANNEL("translation", "1"), SAMPLER("18", "19", "LINEAR")) "]");
    expect_near((double)bench.blob.scene->world_from_camera.m[0][3], 2, 1e-6);
    expect_near((double)bench.blob.scene->world_from_camera_end.m[0][3], 6, 1e-6);
    expect_near((double)bench.blob.lights[0].world_from_light.m[0][3], 4, 1e-6); /* lamps stand still */
    expect_text(bench.warnings, "it stands where it is in the middle of that");
    assert_int_equal(bench.blob.meshes[0].steps, 0);
    bench_close(&bench);
}

#define GLOW "\"materials\":[{\"emissiveFactor\":[1,1,1]}],"
#define GLOWING(targets)                                                                                     \
    GLOW "\"meshes\":[{\"primitives\":[{\"material\":0,\"attributes\":{" SQUARE "},\"indices\":2" targets    \
         "]}]"

static void what_emits_stands_still(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_blurred(&bench, ANIMATED(GLOWING("}"), "translation", "19", "LINEAR"));
    expect_text(bench.warnings, "emits light and moves while the shutter is open");
    expect_vec3(position(&bench, 0), 4, 0, 2);
    run_blurred(&bench, ANIMATED(GLOWING(TARGETS), "weights", "22", "LINEAR"));
    expect_text(bench.warnings, "emits light and moves while the shutter is open");
    assert_int_equal(bench.blob.meshes[0].steps, 0);
    expect_vec3(position(&bench, 2), 4, 9, 1.5);
    bench_close(&bench);
}

static void what_stands_still_is_not_blurred(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_blurred(&bench,
                SKINNED("3", "4") ",\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.5}}],"
                                  "\"animations\":[" ANIMATION(
                                      "a", "{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}",
                                      SAMPLER("18", "19", "LINEAR")) "]");
    assert_int_equal(bench.blob.meshes[0].steps, 0);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_POSITIONS], 4);
    bench_close(&bench);
}

static void shutters_are_read(void **state)
{
    (void)state;
    static const char *const wrong[] = {"0", "-1", "1,1", "2,1", "x", "1,", "nan", "0,inf", "1s"};
    import_wishes_t wishes = import_wishes_none();
    bench_t bench = {.wishes = &wishes};
    wishes.shutter = "1";
    expect_usage(&wishes, THREE, "--shutter needs --time-point or --frame");
    wishes.time_point = 2;
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); ++i) {
        wishes.shutter = wrong[i];
        expect_usage(&wishes, THREE, "--shutter takes SECONDS above 0, or OPEN,CLOSE");
    }
    wishes.shutter = "0,1"; /* from 2 to 3 seconds */
    run(&bench, ANIMATED(PLAIN, "translation", "19", "LINEAR"));
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.instances[0].world_from_object.m[0][3], 2, 0);
    expect_near((double)bench.blob.instances[0].world_from_object_end.m[0][3], 4, 0);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_skinned_mesh_is_one_placed_by_hand),
        cmocka_unit_test(a_scale_of_0_hides_nothing_that_a_skin_moves),
        cmocka_unit_test(weights_that_are_no_weights_count_as_0),
        cmocka_unit_test(vertices_follow_the_mean_of_their_joints),
        cmocka_unit_test(several_sets_of_joints_are_added_up),
        cmocka_unit_test(joints_that_mirror_do_not_turn_a_mesh_inside_out),
        cmocka_unit_test(a_vertex_without_weights_follows_its_first_joint),
        cmocka_unit_test(a_primitive_without_joints_stands_where_its_node_does),
        cmocka_unit_test(broken_skins_are_errors),
        cmocka_unit_test(joints_need_not_be_in_the_scene),
        cmocka_unit_test(a_joint_that_weighs_nothing_need_not_exist),
        cmocka_unit_test(a_broken_skin_is_left_off_leniently),
        cmocka_unit_test(targets_move_vertices_by_their_weights),
        cmocka_unit_test(weights_of_a_node_go_before_those_of_its_mesh),
        cmocka_unit_test(places_with_weights_of_their_own_share_no_object),
        cmocka_unit_test(a_skin_takes_what_targets_have_moved),
        cmocka_unit_test(broken_targets_are_errors),
        cmocka_unit_test(nodes_stand_between_their_keys),
        cmocka_unit_test(rotations_take_the_shorter_arc),
        cmocka_unit_test(splines_are_cubic),
        cmocka_unit_test(weights_are_animated),
        cmocka_unit_test(a_joint_that_moves_takes_its_mesh_along),
        cmocka_unit_test(an_animated_mesh_is_one_placed_by_hand),
        cmocka_unit_test(cameras_and_lamps_move_too),
        cmocka_unit_test(a_frame_is_a_time),
        cmocka_unit_test(animations_that_go_together_are_taken_together),
        cmocka_unit_test(moments_that_make_no_sense_are_refused),
        cmocka_unit_test(without_a_moment_nothing_is_animated),
        cmocka_unit_test(a_pointer_is_ignored),
        cmocka_unit_test(broken_animations_are_errors),
        cmocka_unit_test(what_moves_as_a_whole_becomes_a_moving_instance),
        cmocka_unit_test(what_a_skin_moves_is_given_at_several_times),
        cmocka_unit_test(what_targets_move_is_given_at_several_times),
        cmocka_unit_test(what_is_flattened_is_given_at_several_times),
        cmocka_unit_test(a_camera_moves_while_the_shutter_is_open),
        cmocka_unit_test(what_emits_stands_still),
        cmocka_unit_test(what_stands_still_is_not_blurred),
        cmocka_unit_test(shutters_are_read),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
