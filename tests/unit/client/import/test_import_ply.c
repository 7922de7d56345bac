/* PLY files: the three encodings, what is skipped, and what is refused. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/files/gunzip.h"
#include "client/import/files/ply.h"
#include "tests/clock.h"

#include <zlib.h>

static const char quad_ascii[] = "ply\n"
                                 "format ascii 1.0\n"
                                 "comment a square with a corner fan\n"
                                 "element vertex 4\n"
                                 "property float x\nproperty float y\nproperty float z\n"
                                 "property float nx\nproperty float ny\nproperty float nz\n"
                                 "property uchar red\n"
                                 "property float u\nproperty float v\n"
                                 "element face 2\n"
                                 "property list uchar int vertex_indices\n"
                                 "end_header\n"
                                 "0 0 0  0 0 1 255 0 0\n"
                                 "1 0 0  0 0 1 128 1 0\n"
                                 "1 1 0  0 0 1 7 1 1\n"
                                 "0 1 0.5  0 0 1 0 0 1\n"
                                 "4 0 1 2 3\n"
                                 "3 0 1 3\n";

/* ---- writing binary files ------------------------------------------------------------------------------ */

typedef struct {
    char bytes[2048];
    size_t size;
    bool big;
} out_t;

static void put(out_t *out, const void *value, size_t size)
{
    const char *bytes = value;
    for (size_t i = 0; i < size; ++i) out->bytes[out->size++] = bytes[out->big ? size - 1 - i : i];
}

static void put_text(out_t *out, const char *text)
{
    memcpy(out->bytes + out->size, text, strlen(text));
    out->size += strlen(text);
}

static void put_float(out_t *out, float value)
{
    put(out, &value, sizeof value);
}

/* The square of quad_ascii with other types, other names, and things to skip. */
static out_t quad_binary(bool big)
{
    out_t out = {.big = big};
    put_text(&out, "ply\r\nformat binary_");
    put_text(&out, big ? "big" : "little");
    put_text(&out,
             "_endian 1.0\r\nobj_info made by a test\nelement junk 2\nproperty short a\n"
             "property list ushort double b\nelement vertex 4\nproperty double x\nproperty float32 y\n"
             "property float z\nproperty int8 c\nproperty float nx\nproperty float ny\nproperty float nz\n"
             "property float s\nproperty float t\nelement face 2\nproperty uchar flags\n"
             "property list uint8 uint16 vertex_index\nproperty list uchar float texcoord\nend_header\n");
    for (int i = 0; i < 2; ++i) {
        int16_t a = -5;
        uint16_t length = (uint16_t)i;
        double b = 1e300;
        put(&out, &a, sizeof a);
        put(&out, &length, sizeof length);
        if (i) put(&out, &b, sizeof b);
    }
    static const float corners[4][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0.5f}};
    for (int i = 0; i < 4; ++i) {
        double x = (double)corners[i][0];
        int8_t c = -1;
        put(&out, &x, sizeof x);
        put_float(&out, corners[i][1]);
        put_float(&out, corners[i][2]);
        put(&out, &c, 1);
        for (int k = 0; k < 3; ++k) put_float(&out, k == 2);
        put_float(&out, corners[i][0]);
        put_float(&out, corners[i][1]);
    }
    static const uint16_t faces[2][4] = {{0, 1, 2, 3}, {0, 1, 3, 0}};
    for (int f = 0; f < 2; ++f) {
        uint8_t flags = 9, length = (uint8_t)(4 - f), coordinates = (uint8_t)f;
        put(&out, &flags, 1);
        put(&out, &length, 1);
        for (int i = 0; i < length; ++i) put(&out, &faces[f][i], 2);
        put(&out, &coordinates, 1);
        if (f) put_float(&out, 0.5f);
    }
    return out;
}

/* ---- reading ------------------------------------------------------------------------------------------- */

static result_t read_as(bench_t *bench, ply_rules_t rules, const void *data, size_t size, mesh_t *mesh,
                        uint64_t *faces)
{
    import_report_t sink = {.warn = bench_warn, .context = bench, .strict = bench->strict};
    report_t report = report_begin(&sink);
    bench->warnings[0] = '\0';
    bench_write(bench, "m.ply", data, size);
    char *path = bench_path(bench, "m.ply");
    *mesh = (mesh_t){0};
    result_t result = ply_read(path, rules, &report, mesh, faces);
    free(path);
    return result;
}

static result_t read_bytes(bench_t *bench, const void *data, size_t size, mesh_t *mesh)
{
    return read_as(bench, PLY_FANS, data, size, mesh, NULL);
}

static void check_quad(const mesh_t *mesh)
{
    assert_int_equal(mesh->vertex_count, 4);
    assert_int_equal(mesh->triangle_count, 3);
    expect_vec3(mesh->positions[3], 0, 1, 0.5);
    expect_vec3(mesh->normals[2], 0, 0, 1);
    expect_near((double)mesh->uvs[1].x, 1, 0);
    expect_near((double)mesh->uvs[1].y, 0, 0);
    expect_near((double)mesh->uvs[3].y, 1, 0);
    static const blob_triangle_t triangles[3] = {{{0, 1, 2}}, {{0, 2, 3}}, {{0, 1, 3}}};
    assert_memory_equal(mesh->triangles, triangles, sizeof triangles);
}

static void all_three_encodings_give_the_same_mesh(void **state)
{
    (void)state;
    bench_t bench = {0};
    mesh_t mesh;
    assert_string_equal(read_bytes(&bench, quad_ascii, strlen(quad_ascii), &mesh).message, "");
    check_quad(&mesh);
    mesh_free(&mesh);
    for (int big = 0; big < 2; ++big) {
        out_t out = quad_binary(big);
        assert_string_equal(read_bytes(&bench, out.bytes, out.size, &mesh).message, "");
        check_quad(&mesh);
        mesh_free(&mesh);
    }
    bench_close(&bench);
}

static void every_truncation_is_an_error(void **state)
{
    (void)state;
    bench_t bench = {0};
    mesh_t mesh;
    out_t files[3] = {quad_binary(false), quad_binary(true), {.size = strlen(quad_ascii)}};
    memcpy(files[2].bytes, quad_ascii, files[2].size);
    for (int f = 0; f < 3; ++f) {
        /* the last newline of the ASCII file may be missing */
        for (size_t size = 0; size + (f == 2) < files[f].size; ++size) {
            result_t result = read_bytes(&bench, files[f].bytes, size, &mesh);
            mesh_free(&mesh);
            if (result.code != RESULT_INPUT) fail_msg("file %d cut to %zu bytes was accepted", f, size);
            expect_text(result.message, "m.ply");
        }
    }
    bench_close(&bench);
}

static void random_damage_never_crashes(void **state)
{
    (void)state;
    bench_t bench = {0};
    uint32_t seed = 7;
    for (int round = 0; round < 3000; ++round) {
        out_t file = quad_binary(round % 2);
        if (round % 3 == 0) {
            file.size = strlen(quad_ascii);
            memcpy(file.bytes, quad_ascii, file.size);
        }
        for (int k = 0; k < 1 + round % 4; ++k) {
            seed = seed * 1664525u + 1013904223u;
            file.bytes[(seed >> 8) % file.size] = (char)(seed >> 24);
        }
        mesh_t mesh;
        result_t result = read_bytes(&bench, file.bytes, file.size, &mesh);
        for (uint32_t i = 0; result.code == RESULT_OK && i < 3 * mesh.triangle_count; ++i)
            assert_true(mesh.triangles[i / 3].v[i % 3] < mesh.vertex_count);
        mesh_free(&mesh);
    }
    bench_close(&bench);
}

#define VERTEX3 "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
#define FACES(n) "element face " n "\nproperty list uchar int vertex_indices\n"
#define POINTS "0 0 0\n1 0 0\n0 1 0\n"

static void files_that_are_wrong_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"", "m.ply:1: not a PLY file"},
        {"plywood\n", "m.ply:1: not a PLY file"},
        {"ply\nformat ascii 1.0\n", "m.ply:2: the header has no end_header line"},
        {"ply\nend_header\n", "m.ply:2: the header has no format line"},
        {"ply\nformat middle_endian 1.0\n", "m.ply:2: unknown format \"middle_endian\""},
        {"ply\nnonsense\n", "m.ply:2: unknown header line \"nonsense\""},
        {"ply\nformat ascii 1.0\nelement vertex -3\n", "m.ply:3: an element line must be"},
        {"ply\nformat ascii 1.0\nelement vertex many\n", "m.ply:3: an element line must be"},
        {"ply\nformat ascii 1.0\nelement vertex 5000000000\n", "m.ply:3: 5000000000 vertices are more than"},
        {"ply\nformat ascii 1.0\nproperty float x\n", "m.ply:3: a property before any element"},
        {"ply\nformat ascii 1.0\n" VERTEX3 "property quad w\n", "m.ply:7: unknown type of property \"w\""},
        {"ply\nformat ascii 1.0\n" VERTEX3 "property list float int w\n",
         "m.ply:7: the length of list \"w\""},
        {"ply\nformat ascii 1.0\n" VERTEX3 "element vertex 1\n", "m.ply:7: a second element \"vertex\""},
        {"ply\nformat ascii 1.0\n" VERTEX3 "end_header\n" POINTS, "the file has no faces"},
        {"ply\nformat ascii 1.0\n" FACES("1") "end_header\n3 0 1 2\n", "the faces come before the vertices"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "have no x, y and z"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty list uchar "
         "float "
         "z\nend_header\n1 1 0\n",
         "have no x, y and z"},
        {"ply\nformat ascii 1.0\n" VERTEX3 "element face 1\nproperty int a\nend_header\n" POINTS "1\n",
         "the faces need one list vertex_indices"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n",
         "m.ply:11: vertex 1: expected"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n",
         "m.ply:11: vertex 1: expected a finite number"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n0 0 0\n1 0 1e200\n0 1 0\n3 0 1 2\n",
         "m.ply:11: vertex 1 is not finite"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n" POINTS "3 0 1 3\n",
         "m.ply:13: face 0 uses vertex 3, but there are 3 vertices"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n" POINTS "3 0 -1 2\n",
         "m.ply:13: face 0 uses vertex -1"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n" POINTS "3 0 0.5 2\n",
         "m.ply:13: face 0 uses vertex 0.5"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n" POINTS "5 0 1 2 0 3\n",
         "m.ply:13: face 0 uses vertex 3"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n" POINTS "-1 0 1 2\n",
         "m.ply:13: face 0 has -1 vertices"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1") "end_header\n" POINTS "1000000000 0 1 2\n",
         "face 0; is it truncated?"},
        {"ply\nformat ascii 1.0\n" VERTEX3 FACES("1000000000000") "end_header\n" POINTS "3 0 1 2\n",
         "1000000000000 face records cannot fit"},
        {"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float "
         "y\nproperty float z\n" FACES("1") "end_header\n1234",
         "byte 178: 4000000000 vertex records cannot fit in the 4 bytes that are left"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        mesh_t mesh;
        result_t result = read_bytes(&bench, cases[i].text, strlen(cases[i].text), &mesh);
        mesh_free(&mesh);
        assert_int_equal(result.code, RESULT_INPUT);
        expect_text(result.message, cases[i].message);
    }
    bench_close(&bench);
}

static void thin_faces_are_left_out(void **state)
{
    (void)state;
    bench_t bench = {0};
    mesh_t mesh;
    const char *text =
        "ply\nformat ascii 1.0\n" VERTEX3 FACES("3") "end_header\n" POINTS "2 0 1\n3 0 1 2\n0\n";
    assert_string_equal(read_bytes(&bench, text, strlen(text), &mesh).message, "");
    assert_int_equal(mesh.triangle_count, 1);
    assert_null(mesh.normals);
    assert_null(mesh.uvs);
    expect_text(bench.warnings, "m.ply: 2 faces have fewer than three vertices");
    mesh_free(&mesh);
    bench_close(&bench);
}

static void large_faces_become_fans(void **state)
{
    (void)state;
    bench_t bench = {0};
    mesh_t mesh;
    const char *text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
                       "property float z\nelement face 2\nproperty list uchar int vertex_indices\n"
                       "property int face_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 0.5 0\n"
                       "5 1 2 3 4 0 17\n3 0 1 2 18\n";
    assert_string_equal(read_bytes(&bench, text, strlen(text), &mesh).message, "");
    static const blob_triangle_t triangles[4] = {{{1, 2, 3}}, {{1, 3, 4}}, {{1, 4, 0}}, {{0, 1, 2}}};
    assert_int_equal(mesh.triangle_count, 4);
    assert_memory_equal(mesh.triangles, triangles, sizeof triangles);
    assert_string_equal(bench.warnings, "");
    mesh_free(&mesh);
    bench_close(&bench);
}

/* A quad's second triangle begins where pbrt's does, and larger faces are left out. */
static void pbrt_takes_triangles_and_quads(void **state)
{
    (void)state;
    bench_t bench = {0};
    mesh_t mesh;
    uint64_t faces;
    const char *text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
                       "property float z\n" FACES("4") "end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 0.5 0\n"
                                                       "5 1 2 3 4 0\n4 0 1 2 3\n3 4 0 3\n2 0 1\n";
    static const blob_triangle_t v3[3] = {{{0, 1, 2}}, {{3, 0, 2}}, {{4, 0, 3}}},
                                 v4[3] = {{{0, 1, 2}}, {{2, 3, 0}}, {{4, 0, 3}}};
    for (int i = 0; i < 2; ++i) {
        result_t result = read_as(&bench, i ? PLY_PBRT_V4 : PLY_PBRT_V3, text, strlen(text), &mesh, &faces);
        assert_string_equal(result.message, "");
        assert_int_equal(mesh.triangle_count, 3);
        assert_memory_equal(mesh.triangles, i ? v4 : v3, sizeof v3);
        assert_int_equal(faces, 2);
        expect_text(bench.warnings, "m.ply: 1 faces have fewer than three vertices");
        expect_text(bench.warnings,
                    "m.ply: 1 faces have more than four vertices and are left out, as by pbrt");
        mesh_free(&mesh);
    }
    bench.strict = true;
    result_t strict = read_as(&bench, PLY_PBRT_V3, text, strlen(text), &mesh, &faces);
    expect_text(strict.message, "1 faces have more than four vertices");
    mesh_free(&mesh);
    bench_close(&bench);
}

/* ---- gzip ---------------------------------------------------------------------------------------------- */

/* One gzip member; the caller frees it. */
static uint8_t *pack(const void *data, size_t size, size_t *packed_size)
{
    z_stream stream = {0};
    assert_int_equal(deflateInit2(&stream, 9, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY), Z_OK);
    size_t room = deflateBound(&stream, size);
    uint8_t *packed = mem_alloc(room);
    stream.next_in = (Bytef *)data;
    stream.avail_in = (uInt)size;
    stream.next_out = packed;
    stream.avail_out = (uInt)room;
    assert_int_equal(deflate(&stream, Z_FINISH), Z_STREAM_END);
    *packed_size = room - stream.avail_out;
    deflateEnd(&stream);
    return packed;
}

static void gzipped_files_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    mesh_t mesh;
    out_t out = quad_binary(false);
    size_t first_size, second_size;
    uint8_t *first = pack(out.bytes, 100, &first_size);
    uint8_t *second = pack(out.bytes + 100, out.size - 100, &second_size);
    uint8_t *both = mem_zalloc(first_size + second_size + 7, 1); /* two members, and padding */
    memcpy(both, first, first_size);
    memcpy(both + first_size, second, second_size);
    assert_string_equal(read_bytes(&bench, both, first_size + second_size + 7, &mesh).message, "");
    check_quad(&mesh);
    mesh_free(&mesh);
    for (size_t size = 2; size < first_size + second_size; ++size) {
        if (size == first_size) continue; /* a whole gzip file of half a mesh: refused as such below */
        result_t result = read_bytes(&bench, both, size, &mesh);
        mesh_free(&mesh);
        if (result.code != RESULT_INPUT) fail_msg("cut to %zu bytes it was accepted", size);
        expect_text(result.message, "m.ply");
    }
    result_t half = read_bytes(&bench, both, first_size, &mesh);
    expect_text(half.message, "no end_header line");
    mesh_free(&mesh);
    size_t refused = 0; /* the time and padding bits mean nothing; other damage shows in a checksum */
    for (size_t i = 0; i < first_size + second_size; ++i) {
        both[i] ^= 0x10;
        result_t result = read_bytes(&bench, both, first_size + second_size, &mesh);
        both[i] ^= 0x10;
        if (result.code == RESULT_OK) check_quad(&mesh);
        refused += result.code == RESULT_INPUT;
        mesh_free(&mesh);
    }
    assert_true(refused + 24 > first_size + second_size);
    free(first);
    free(second);
    free(both);
    bench_close(&bench);
}

static void gzip_bombs_are_refused(void **state)
{
    (void)state;
    enum { SIZE = 10000000, LIMIT = 1000000 };
    uint8_t *zeroes = mem_zalloc(SIZE, 1), *out;
    size_t packed_size, size;
    uint8_t *packed = pack(zeroes, SIZE, &packed_size);
    result_t result = gunzip("b.gz", packed, packed_size, LIMIT, &out, &size);
    assert_int_equal(result.code, RESULT_INPUT);
    expect_text(result.message, "b.gz: decompressed it has more than the limit of 1000000 bytes");
    assert_null(out);
    assert_int_equal(gunzip("b.gz", packed, packed_size, SIZE - 1, &out, &size).code, RESULT_INPUT);
    assert_int_equal(gunzip("b.gz", packed, packed_size, SIZE, &out, &size).code, RESULT_OK);
    assert_int_equal(size, SIZE);
    assert_memory_equal(out, zeroes, SIZE);
    free(out);
    free(packed);
    free(zeroes);
}

/* ---- in a scene ---------------------------------------------------------------------------------------- */

static void a_scene_has_a_ply_file_as_a_shape(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "quad.ply", quad_ascii, strlen(quad_ascii));
    bench_run_v3(&bench,
                 "Material \"matte\"\nTranslate 5 0 0\nShape \"plymesh\" \"string filename\" \"quad.ply\"");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TRIANGLES], 3);
    expect_vec3(bench.blob.positions[2], 6, 1, 0);
    expect_vec3(bench.blob.normals[0], 0, 0, 1);

    bench_write(&bench, "none.ply", "", 0);
    bench_run_v3(&bench, "Shape \"plymesh\" \"string filename\" \"none.ply\"");
    expect_text(bench.result.message, "none.ply");
    expect_text(bench.result.message, "s.pbrt:2:1)");
    bench_run_v3(&bench, "  Shape \"plymesh\"");
    expect_text(bench.result.message, "s.pbrt:2:3: a plymesh needs its file");
    bench_close(&bench);
}

/* A mesh of a million triangles is read in a fraction of a second; the limit only catches a quadratic reader.
 */
static void a_large_mesh_is_read_fast(void **state)
{
    (void)state;
    enum { SIDE = 500 };
    bench_t bench = {0};
    char *text = mem_alloc((size_t)SIDE * SIDE * 60 + 1000), *s = text;
    s += sprintf(
        s,
        "ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
        "element face %d\nproperty list uchar int vertex_indices\nend_header\n",
        SIDE * SIDE, (SIDE - 1) * (SIDE - 1));
    for (int i = 0; i < SIDE * SIDE; ++i)
        s += sprintf(s, "%.6g %.6g 0\n", i % SIDE * 0.037, i / SIDE * 0.0291);
    for (int y = 0; y + 1 < SIDE; ++y)
        for (int x = 0, v = y * SIDE; x + 1 < SIDE; ++x, ++v)
            s += sprintf(s, "4 %d %d %d %d\n", v, v + 1, v + 1 + SIDE, v + SIDE);
    bench_write(&bench, "large.ply", text, (size_t)(s - text));
    free(text);
    double start = clock_cpu();
    bench_run_v3(&bench, "Shape \"plymesh\" \"string filename\" \"large.ply\"");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TRIANGLES], 2 * (SIDE - 1) * (SIDE - 1));
    assert_true(clock_cpu() - start < 5);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_three_encodings_give_the_same_mesh),
        cmocka_unit_test(every_truncation_is_an_error),
        cmocka_unit_test(random_damage_never_crashes),
        cmocka_unit_test(files_that_are_wrong_are_refused),
        cmocka_unit_test(thin_faces_are_left_out),
        cmocka_unit_test(large_faces_become_fans),
        cmocka_unit_test(pbrt_takes_triangles_and_quads),
        cmocka_unit_test(gzipped_files_are_read),
        cmocka_unit_test(gzip_bombs_are_refused),
        cmocka_unit_test(a_scene_has_a_ply_file_as_a_shape),
        cmocka_unit_test(a_large_mesh_is_read_fast),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
