/* glTF files as the world writes them: of the first version, not filled up, incomplete; packed by Draco, by
 * meshopt, with pictures as WebP. What is packed gives the same as its twin that is not; the packed bytes are
 * made here, by the encoders of the same libraries. */
#include "tests/unit/client/import/test_import.h"

#include <meshoptimizer.h>
#include <png.h>
#include <webp/encode.h>

#include "common/base.h"
#include "tests/draco_pack.h"

/* ---- a mesh -----------------------------------------------------------------------------------------------
 */

enum { SIDE = 7, VERTICES = SIDE * SIDE, TRIANGLES = 2 * (SIDE - 1) * (SIDE - 1), CORNERS = 3 * TRIANGLES };

/* A hilly square with all attributes. */
typedef struct {
    float positions[VERTICES][3], normals[VERTICES][3], uvs[VERTICES][2];
    uint8_t colours[VERTICES][4];
    uint16_t corners[TRIANGLES][3];
} hills_t;

static void make_vertex(hills_t *hills, int i)
{
    float x = (float)(i % SIDE) / (SIDE - 1), y = (float)(i / SIDE) / (SIDE - 1);
    float slope_x = 0.6f * cosf(3 * x), slope_y = -0.8f * sinf(4 * y);
    float length = sqrtf(1 + slope_x * slope_x + slope_y * slope_y);
    memcpy(hills->positions[i], (float[3]){x, y, 0.2f * sinf(3 * x) + 0.2f * cosf(4 * y)}, 12);
    memcpy(hills->normals[i], (float[3]){-slope_x / length, -slope_y / length, 1 / length}, 12);
    memcpy(hills->uvs[i], (float[2]){x * 0.9f, y * 1.1f}, 8);
    memcpy(hills->colours[i], (uint8_t[4]){(uint8_t)(5 * i), (uint8_t)(255 - 5 * i), 7, 255}, 4);
}

static hills_t make_hills(void)
{
    hills_t hills = {.colours = {{0}}};
    for (int i = 0; i < VERTICES; ++i) make_vertex(&hills, i);
    for (int i = 0; i < TRIANGLES; ++i) {
        int cell = i / 2, first = cell / (SIDE - 1) * SIDE + cell % (SIDE - 1);
        int corners[2][3] = {{0, 1, SIDE}, {1, SIDE + 1, SIDE}};
        for (int k = 0; k < 3; ++k) hills.corners[i][k] = (uint16_t)(first + corners[i % 2][k]);
    }
    return hills;
}

/* ---- files ------------------------------------------------------------------------------------------------
 */

/* The buffer b.bin and the views of it, in the making. */
typedef struct {
    uint8_t bytes[1 << 15];
    size_t size;
    char views[4096];
} buffer_t;

static size_t put(buffer_t *buffer, const void *data, size_t size)
{
    size_t at = buffer->size;
    assert_true(size <= sizeof buffer->bytes - at - 4);
    memcpy(buffer->bytes + at, data, size);
    buffer->size = (at + size + 3) / 4 * 4;
    return at;
}

static void add_view(buffer_t *buffer, const char *format, ...) __attribute__((format(printf, 2, 3)));

static void add_view(buffer_t *buffer, const char *format, ...)
{
    size_t used = strlen(buffer->views);
    if (used > 0) buffer->views[used++] = ',';
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(buffer->views + used, sizeof buffer->views - used, format, arguments);
    va_end(arguments);
}

static void put_view(buffer_t *buffer, const void *data, size_t size)
{
    size_t at = put(buffer, data, size);
    add_view(buffer, "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu}", at, size);
}

/* A view of `count` elements, whose bytes are packed. */
static void put_packed_view(buffer_t *buffer, const void *data, size_t size, const char *mode,
                            const char *filter, size_t count, size_t stride)
{
    size_t at = put(buffer, data, size);
    add_view(buffer,
             "{\"buffer\":1,\"byteLength\":%zu,\"extensions\":{\"EXT_meshopt_compression\":{\"buffer\":0,"
             "\"byteOffset\":%zu,\"byteLength\":%zu,\"count\":%zu,\"byteStride\":%zu,\"mode\":\"%s\","
             "\"filter\":\"%s\"}}}",
             count * stride, at, size, count, stride, mode, filter);
}

/* The accessors of the hills; with a view each, 0 to 4, or without. */
static char *accessors(bool views, const char *normal_type)
{
    static const char *const kinds[] = {
        "\"componentType\":5126,\"count\":49,\"type\":\"VEC3\"", NULL,
        "\"componentType\":5126,\"count\":49,\"type\":\"VEC2\"",
        "\"componentType\":5121,\"count\":49,\"type\":\"VEC4\",\"normalized\":true",
        "\"componentType\":5123,\"count\":216,\"type\":\"SCALAR\""};
    char *text = mem_strdup("\"accessors\":[");
    for (int i = 0; i < 5; ++i) {
        char *view = views ? mem_printf("\"bufferView\":%d,", i) : mem_strdup("");
        char *longer = mem_printf("%s%s{%s%s}", text, i ? "," : "", view, kinds[i] ? kinds[i] : normal_type);
        free(view);
        free(text);
        text = longer;
    }
    text = mem_realloc(text, strlen(text) + 2);
    return strcat(text, "]");
}

#define FLOAT_NORMALS "\"componentType\":5126,\"count\":49,\"type\":\"VEC3\""
#define NO_EXTENSION ""

/* Imports the hills as that buffer has them; `more` stands in the primitive, `rest` at the root. */
static void import_hills(bench_t *bench, const buffer_t *buffer, bool views, const char *normal_type,
                         const char *more, const char *rest)
{
    char *arrays = accessors(views, normal_type);
    char *text = mem_printf(
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"uri\":\"b.bin\",\"byteLength\":%zu},{"
        "\"byteLength\":99999}],"
        "\"bufferViews\":[%s],%s,\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"NORMAL\":1,"
        "\"TEXCOORD_0\":2,\"COLOR_0\":3},\"indices\":4%s}]}],\"nodes\":[{\"mesh\":0}]%s}",
        buffer->size, buffer->views, arrays, more, rest);
    bench_write(bench, "b.bin", buffer->bytes, buffer->size);
    bench_write(bench, "s.gltf", text, strlen(text));
    bench_import_file(bench, "s.gltf");
    free(text);
    free(arrays);
}

static void put_plain(buffer_t *buffer, const hills_t *hills)
{
    put_view(buffer, hills->positions, sizeof hills->positions);
    put_view(buffer, hills->normals, sizeof hills->normals);
    put_view(buffer, hills->uvs, sizeof hills->uvs);
    put_view(buffer, hills->colours, sizeof hills->colours);
    put_view(buffer, hills->corners, sizeof hills->corners);
}

static void import_plain(bench_t *bench)
{
    hills_t hills = make_hills();
    buffer_t buffer = {.size = 0};
    put_plain(&buffer, &hills);
    import_hills(bench, &buffer, true, FLOAT_NORMALS, NO_EXTENSION, "");
    bench_expect_ok(bench);
    assert_int_equal(bench->blob.counts[BLOB_SECTION_TRIANGLES], TRIANGLES);
}

static void expect_same_blob(const bench_t *a, const bench_t *b)
{
    bench_expect_ok(a);
    assert_int_equal(a->size, b->size);
    assert_memory_equal(a->bytes, b->bytes, a->size);
}

/* ---- the same surface, where order or precision may differ ------------------------------------------------
 */

static bool near(float a, float b, float tolerance)
{
    return fabsf(a - b) <= tolerance;
}

static bool same_vertex(const scene_blob_t *a, uint32_t va, const scene_blob_t *b, uint32_t vb,
                        float tolerance)
{
    vec3_t p = a->positions[va], q = b->positions[vb], n = a->normals[va], m = b->normals[vb];
    vec2_t s = a->uvs[va], t = b->uvs[vb];
    return near(p.x, q.x, tolerance) && near(p.y, q.y, tolerance) && near(p.z, q.z, tolerance) &&
           near(n.x, m.x, tolerance) && near(n.y, m.y, tolerance) && near(n.z, m.z, tolerance) &&
           near(s.x, t.x, tolerance) && near(s.y, t.y, tolerance) &&
           memcmp(&a->colours[va], &b->colours[vb], sizeof *a->colours) == 0;
}

/* The same three corners, from whichever one on. */
static bool same_triangle(const scene_blob_t *a, const blob_triangle_t *s, const scene_blob_t *b,
                          const blob_triangle_t *t, float tolerance)
{
    for (int turn = 0; turn < 3; ++turn) {
        bool same = true;
        for (int k = 0; k < 3; ++k)
            same = same && same_vertex(a, s->v[k], b, t->v[(k + turn) % 3], tolerance);
        if (same) return true;
    }
    return false;
}

static void expect_same_surface(const bench_t *packed, const bench_t *plain, float tolerance)
{
    bench_expect_ok(packed);
    assert_int_equal(packed->blob.counts[BLOB_SECTION_TRIANGLES], TRIANGLES);
    for (int i = 0; i < TRIANGLES; ++i) {
        bool found = false;
        for (int k = 0; k < TRIANGLES && !found; ++k)
            found = same_triangle(&packed->blob, &packed->blob.triangles[i], &plain->blob,
                                  &plain->blob.triangles[k], tolerance);
        if (!found) fail_msg("triangle %d is not one of the mesh that was packed", i);
    }
}

/* ---- meshopt ----------------------------------------------------------------------------------------------
 */

static void put_packed_vertices(buffer_t *buffer, const void *data, size_t stride, const char *filter)
{
    uint8_t packed[4096];
    size_t size = meshopt_encodeVertexBuffer(packed, sizeof packed, data, VERTICES, stride);
    assert_true(size > 0);
    put_packed_view(buffer, packed, size, "ATTRIBUTES", filter, VERTICES, stride);
}

static void put_packed_corners(buffer_t *buffer, const hills_t *hills, const char *mode)
{
    unsigned corners[CORNERS];
    uint8_t packed[4096];
    for (int i = 0; i < CORNERS; ++i) corners[i] = hills->corners[i / 3][i % 3];
    size_t size = strcmp(mode, "INDICES") == 0
                      ? meshopt_encodeIndexSequence(packed, sizeof packed, corners, CORNERS)
                      : meshopt_encodeIndexBuffer(packed, sizeof packed, corners, CORNERS);
    assert_true(size > 0);
    put_packed_view(buffer, packed, size, mode, "NONE", CORNERS, 2);
}

static void put_meshopt(buffer_t *buffer, const char *mode)
{
    hills_t hills = make_hills();
    put_packed_vertices(buffer, hills.positions, 12, "NONE");
    put_packed_vertices(buffer, hills.normals, 12, "NONE");
    put_packed_vertices(buffer, hills.uvs, 8, "NONE");
    put_packed_vertices(buffer, hills.colours, 4, "NONE");
    put_packed_corners(buffer, &hills, mode);
}

static void what_meshopt_packed_is_as_before(void **state)
{
    (void)state;
    bench_t plain = {0}, packed = {0};
    import_plain(&plain);
    buffer_t buffer = {.size = 0};
    put_meshopt(&buffer, "INDICES");
    import_hills(&packed, &buffer, true, FLOAT_NORMALS, NO_EXTENSION,
                 ",\"extensionsRequired\":[\"EXT_meshopt_compression\"]");
    expect_same_blob(&packed, &plain);

    buffer = (buffer_t){.size = 0};
    put_meshopt(&buffer, "TRIANGLES");
    import_hills(&packed, &buffer, true, FLOAT_NORMALS, NO_EXTENSION, "");
    expect_same_surface(&packed, &plain, 0);
    bench_close(&packed);
    bench_close(&plain);
}

/* The name is as long as the other. */
static void name_khronos(buffer_t *buffer)
{
    for (char *at = buffer->views; (at = strstr(at, "EXT_meshopt")) != NULL;) memcpy(at, "KHR", 3);
}

/* Khronos's extension has the same streams, and newer ones, which are told. */
static void what_khronos_packed_is_as_before(void **state)
{
    (void)state;
    static const char required[] = ",\"extensionsRequired\":[\"KHR_meshopt_compression\"]";
    bench_t plain = {0}, packed = {0};
    import_plain(&plain);
    buffer_t buffer = {.size = 0};
    put_meshopt(&buffer, "INDICES");
    name_khronos(&buffer);
    import_hills(&packed, &buffer, true, FLOAT_NORMALS, NO_EXTENSION, required);
    expect_same_blob(&packed, &plain);
    buffer.bytes[0] = 0xa1;
    import_hills(&packed, &buffer, true, FLOAT_NORMALS, NO_EXTENSION, required);
    assert_int_equal(packed.result.code, RESULT_INPUT);
    expect_text(packed.result.message, "of a version that only KHR_meshopt_compression has");
    bench_close(&packed);
    bench_close(&plain);
}

/* Normals by the octahedral filter, in 8 and in 16 bits, and positions by the exponential one. */
static void filters_of_meshopt_are_undone(void **state)
{
    (void)state;
    hills_t hills = make_hills();
    bench_t plain = {0}, packed = {0};
    import_plain(&plain);
    for (size_t bits = 8; bits <= 16; bits += 8) {
        float normals[VERTICES][4] = {0};
        uint8_t octahedral[VERTICES * 8];
        uint32_t exponential[VERTICES][3];
        size_t stride = bits / 2;
        for (int i = 0; i < VERTICES; ++i) memcpy(normals[i], hills.normals[i], 12);
        meshopt_encodeFilterOct(octahedral, VERTICES, stride, (int)bits, &normals[0][0]);
        meshopt_encodeFilterExp(exponential, VERTICES, 12, 15, &hills.positions[0][0]);
        buffer_t buffer = {.size = 0};
        put_packed_vertices(&buffer, exponential, 12, "EXPONENTIAL");
        put_packed_vertices(&buffer, octahedral, stride, "OCTAHEDRAL");
        put_packed_vertices(&buffer, hills.uvs, 8, "NONE");
        put_packed_vertices(&buffer, hills.colours, 4, "NONE");
        put_packed_corners(&buffer, &hills, "INDICES");
        char *view = mem_printf("\"byteLength\":%zu,", VERTICES * stride), *at = strstr(buffer.views, view);
        assert_non_null(at); /* of the normals: three components of four */
        char *views =
            mem_printf("%.*s\"byteStride\":%zu,%s", (int)(at - buffer.views), buffer.views, stride, at);
        strcpy(buffer.views, views);
        import_hills(&packed, &buffer, true,
                     bits == 8 ? "\"componentType\":5120,\"normalized\":true,\"count\":49,\"type\":\"VEC3\""
                               : "\"componentType\":5122,\"normalized\":true,\"count\":49,\"type\":\"VEC3\"",
                     NO_EXTENSION, "");
        expect_same_surface(&packed, &plain, bits == 8 ? 0.02f : 2e-4f);
        free(view);
        free(views);
    }
    bench_close(&packed);
    bench_close(&plain);
}

/* Three turned copies, whose rotations went through the quaternion filter. */
static void rotations_of_meshopt_are_undone(void **state)
{
    (void)state;
    static const float turns[3][4] = {{0, 0, 0, 1}, {0.5f, -0.5f, 0.5f, 0.5f}, {0, 0.6f, 0, 0.8f}};
    hills_t hills = make_hills();
    bench_t bench = {0};
    int16_t filtered[3][4];
    uint8_t packed[256];
    meshopt_encodeFilterQuat(filtered, 3, 8, 16, &turns[0][0]);
    size_t size = meshopt_encodeVertexBuffer(packed, sizeof packed, filtered, 3, 8);
    buffer_t buffer = {.size = 0};
    put_plain(&buffer, &hills);
    put_packed_view(&buffer, packed, size, "ATTRIBUTES", "QUATERNION", 3, 8);
    char *text = mem_printf(
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"uri\":\"b.bin\",\"byteLength\":%zu},{"
        "\"byteLength\":99}],"
        "\"bufferViews\":[%s],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":49,\"type\":"
        "\"VEC3\"},"
        "{\"bufferView\":5,\"componentType\":5122,\"normalized\":true,\"count\":3,\"type\":\"VEC4\"},"
        "{\"bufferView\":4,\"componentType\":5123,\"count\":216,\"type\":\"SCALAR\"}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":2}]}],"
        "\"nodes\":[{\"mesh\":0,\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"ROTATION\":1}}"
        "}}]}",
        buffer.size, buffer.views);
    bench_write(&bench, "b.bin", buffer.bytes, buffer.size);
    bench_write(&bench, "s.gltf", text, strlen(text));
    bench_import_file(&bench, "s.gltf");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 3);
    /* the first columns of the matrices: where the x axis goes */
    static const double axes[3][3] = {{1, 0, 0}, {0, 0, 1}, {0.28, 0, -0.96}};
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            expect_near((double)bench.blob.instances[i].world_from_object.m[k][0], axes[i][k], 2e-4);
    free(text);
    bench_close(&bench);
}

/* A layout of the packed positions that the extension does not allow, or that their bytes do not have. */
static void wrong_meshopt_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *from, *to, *message;
    } cases[] = {
        {"\"mode\":\"ATTRIBUTES\"", "\"mode\":\"VERTICES\"", "its mode \"VERTICES\" is not one"},
        {"\"filter\":\"NONE\"", "\"filter\":\"COLOR\"", "its filter \"COLOR\" is not one"},
        {"\"filter\":\"NONE\"", "\"filter\":\"OCTAHEDRAL\"", "no byteStride of 12"},
        {"\"byteStride\":12", "\"byteStride\":0", "no byteStride of 0"},
        {"\"byteStride\":12", "\"byteStride\":512", "no byteStride of 512"},
        {"\"count\":49", "\"count\":0", "a count of 0"},
        {"\"count\":49", "\"count\":4000000000", "cannot hold 4000000000 elements"},
        {"\"count\":49", "\"count\":65", "are damaged"},
        {"\"buffer\":0", "\"buffer\":1", "has no uri"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        buffer_t buffer = {.size = 0};
        put_meshopt(&buffer, "INDICES");
        char *at = strstr(buffer.views, cases[i].from);
        assert_non_null(at);
        char *views = mem_printf("%.*s%s%s", (int)(at - buffer.views), buffer.views, cases[i].to,
                                 at + strlen(cases[i].from));
        strcpy(buffer.views, views);
        import_hills(&bench, &buffer, true, FLOAT_NORMALS, NO_EXTENSION, "");
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, "s.gltf: ");
        expect_text(bench.result.message, cases[i].message);
        free(views);
    }
    bench_close(&bench);
}

/* ---- Draco ------------------------------------------------------------------------------------------------
 */

#define DRACO_ATTRIBUTES "\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2,\"COLOR_0\":3}"
#define DRACO ",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0," DRACO_ATTRIBUTES "}}"
#define DRACO_REQUIRED ",\"extensionsRequired\":[\"KHR_draco_mesh_compression\"]"

static buffer_t pack_hills(bool reorder, int bits)
{
    hills_t hills = make_hills();
    draco_pack_t mesh = {VERTICES,
                         TRIANGLES,
                         &hills.positions[0][0],
                         &hills.normals[0][0],
                         &hills.uvs[0][0],
                         &hills.colours[0][0],
                         &hills.corners[0][0],
                         reorder,
                         bits};
    size_t size;
    uint8_t *bytes = draco_pack(&mesh, &size);
    assert_non_null(bytes);
    buffer_t buffer = {.size = 0};
    put_view(&buffer, bytes, size);
    free(bytes);
    return buffer;
}

static void what_draco_packed_is_as_before(void **state)
{
    (void)state;
    bench_t plain = {0}, packed = {0};
    import_plain(&plain);
    buffer_t buffer = pack_hills(false, 0);
    import_hills(&packed, &buffer, false, FLOAT_NORMALS, DRACO, DRACO_REQUIRED);
    expect_same_blob(&packed, &plain);

    buffer = pack_hills(true, 0);
    import_hills(&packed, &buffer, false, FLOAT_NORMALS, DRACO, "");
    expect_same_surface(&packed, &plain, 0);

    buffer = pack_hills(true, 14);
    import_hills(&packed, &buffer, false, FLOAT_NORMALS, DRACO ",\"mode\":5", "");
    expect_same_surface(&packed, &plain, 5e-4f);
    bench_close(&packed);
    bench_close(&plain);
}

/* What is not in the packed mesh is read as ever. */
static void attributes_beside_draco_are_read(void **state)
{
    (void)state;
    bench_t plain = {0}, packed = {0};
    import_plain(&plain);
    hills_t hills = make_hills();
    buffer_t buffer = pack_hills(false, 0);
    put_view(&buffer, hills.normals, sizeof hills.normals); /* view 1, of the accessor of the normals */
    import_hills(
        &packed, &buffer, false, "\"bufferView\":1," FLOAT_NORMALS,
        ",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,\"attributes\":{\"POSITION\":0,"
        "\"TEXCOORD_0\":2,\"COLOR_0\":3}}}",
        "");
    expect_same_blob(&packed, &plain);
    bench_close(&packed);
    bench_close(&plain);
}

static void wrong_draco_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *more, *message;
    } cases[] = {
        {",\"extensions\":{\"KHR_draco_mesh_compression\":{" DRACO_ATTRIBUTES "}}", "names no bufferView"},
        {",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":1," DRACO_ATTRIBUTES "}}",
         "damaged or no mesh"},
        {",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,\"attributes\":{\"POSITION\":9}}"
         "}",
         "no such attribute"},
        {",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,\"attributes\":{\"POSITION\":2}}"
         "}",
         "must be a VEC3"},
    };
    bench_t bench = {0};
    buffer_t buffer = pack_hills(true, 10);
    put_view(&buffer, "not Draco", 9);
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        import_hills(&bench, &buffer, false, FLOAT_NORMALS, cases[i].more, "");
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, "meshes[0].primitives[0]");
        expect_text(bench.result.message, cases[i].message);
    }
    bench_close(&bench);
}

/* Whatever damage does to the decoder, the importer reads or refuses, and goes on. */
static void damaged_draco_is_read_or_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    uint32_t random = 1;
    int refused = 0;
    for (int round = 0; round < 40; ++round) {
        buffer_t buffer = pack_hills(round % 2, 10);
        for (int k = 0; k < 1 + round % 4; ++k) {
            random = random * 1664525u + 1013904223u;
            buffer.bytes[(random >> 8) % buffer.size] = (uint8_t)(random >> 24);
        }
        import_hills(&bench, &buffer, false, FLOAT_NORMALS, DRACO, "");
        refused += bench.result.code == RESULT_INPUT;
        assert_true(bench.result.code == RESULT_OK || bench.result.code == RESULT_INPUT);
    }
    assert_true(refused > 5);
    bench_close(&bench);
}

/* ---- pictures ---------------------------------------------------------------------------------------------
 */

enum { PICTURE = 6 };

static void make_picture(uint8_t pixels[PICTURE * PICTURE][4])
{
    for (int i = 0; i < PICTURE * PICTURE; ++i)
        memcpy(pixels[i],
               (uint8_t[4]){(uint8_t)(7 * i), (uint8_t)(255 - 6 * i), (uint8_t)(i * i), (uint8_t)(9 + i)}, 4);
}

static void write_png(bench_t *bench, const char *name)
{
    uint8_t pixels[PICTURE * PICTURE][4], bytes[4096];
    make_picture(pixels);
    png_image image = {
        .version = PNG_IMAGE_VERSION, .width = PICTURE, .height = PICTURE, .format = PNG_FORMAT_RGBA};
    png_alloc_size_t size = sizeof bytes;
    assert_true(png_image_write_to_memory(&image, bytes, &size, 0, pixels, 0, NULL));
    bench_write(bench, name, bytes, size);
}

static void write_webp(bench_t *bench, const char *name)
{
    uint8_t pixels[PICTURE * PICTURE][4], *bytes;
    make_picture(pixels);
    size_t size = WebPEncodeLosslessRGBA(&pixels[0][0], PICTURE, PICTURE, 4 * PICTURE, &bytes);
    assert_true(size > 0);
    bench_write(bench, name, bytes, size);
    WebPFree(bytes);
}

/* The hills with a texture; `rest`: its record, its image, and what else stands at the root. */
static void import_textured(bench_t *bench, const char *rest)
{
    hills_t hills = make_hills();
    buffer_t buffer = {.size = 0};
    put_plain(&buffer, &hills);
    char *all = mem_printf(",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,0.5,0.5,1],"
                           "\"baseColorTexture\":{\"index\":0}}}],%s",
                           rest);
    import_hills(bench, &buffer, true, FLOAT_NORMALS, ",\"material\":0", all);
    free(all);
}

static void a_webp_picture_is_the_same_picture(void **state)
{
    (void)state;
    bench_t png = {0}, webp = {0};
    write_png(&png, "a.png");
    import_textured(&png, "\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"a.png\"}]");
    bench_expect_ok(&png);
    assert_int_equal(png.blob.counts[BLOB_SECTION_IMAGES], 1);
    write_webp(&webp, "a.webp");
    import_textured(&webp,
                    "\"extensionsRequired\":[\"EXT_texture_webp\"],"
                    "\"textures\":[{\"source\":0,\"extensions\":{\"EXT_texture_webp\":{\"source\":1}}}],"
                    "\"images\":[{\"uri\":\"no.png\"},{\"uri\":\"a.webp\"}]");
    expect_same_blob(&webp, &png);
    bench_close(&webp);
    bench_close(&png);
}

/* An image that is not there is an error; leniently a warning, and the factor alone is left. */
static void a_missing_texture_is_left_out_leniently(void **state)
{
    (void)state;
    static const char *const cases[][2] = {
        {"\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"no.png\"}]", "no.png"},
        {"\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"b.bin\"}]", "is not an image"},
        {"\"textures\":[{\"extensions\":{\"KHR_texture_basisu\":{\"source\":0}}}],"
         "\"images\":[{\"uri\":\"no.ktx2\"}]",
         "export textures as PNG, JPEG or WebP"},
        {"\"extensionsRequired\":[\"KHR_texture_basisu\"],"
         "\"textures\":[{\"extensions\":{\"KHR_texture_basisu\":{\"source\":0}}}],"
         "\"images\":[{\"uri\":\"no.ktx2\"}]",
         "without KHR_texture_basisu, which is not supported; export textures as PNG, JPEG or WebP"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench.lenient = false;
        import_textured(&bench, cases[i][0]);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, cases[i][1]);
        bench.lenient = true;
        import_textured(&bench, cases[i][0]);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, cases[i][1]);
        expect_text(bench.warnings, "left out");
        blob_value_t colour = bench.blob.materials[bench.blob.shapes[0].material].values[VALUE_REFLECTANCE];
        assert_int_equal(bench.blob.counts[BLOB_SECTION_IMAGES], 0);
        expect_near((double)colour.factor.x, 0.5, 1e-6);
    }
    bench_close(&bench);
}

static void a_lenient_import_ignores_extensions_that_a_file_requires(void **state)
{
    (void)state;
    static const char text[] = "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"ACME_fur\"],"
                               "\"extensionsRequired\":[\"ACME_fur\"]}";
    bench_t bench = {0};
    bench_write(&bench, "s.gltf", text, strlen(text));
    bench_import_file(&bench, "s.gltf");
    expect_text(bench.result.message, "extensionsRequired[0]: the file cannot be read without ACME_fur");
    bench.lenient = true;
    bench_import_file(&bench, "s.gltf");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "which is not supported; export without it; it is ignored");
    bench_close(&bench);
}

#define PICTURE "\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"a.png\"}]"

static void where_on_the_globe_a_file_stands_is_no_matter(void **state)
{
    (void)state;
    bench_t here = {0}, there = {0};
    write_png(&here, "a.png");
    import_textured(&here, PICTURE);
    write_png(&there, "a.png");
    import_textured(&there, PICTURE ",\"extensionsUsed\":[\"CESIUM_RTC\"],"
                                    "\"extensionsRequired\":[\"CESIUM_RTC\"],"
                                    "\"extensions\":{\"CESIUM_RTC\":{\"center\":[6378137,0,0]}}");
    expect_same_blob(&there, &here);
    bench_close(&there);
    bench_close(&here);
}

/* ---- containers -------------------------------------------------------------------------------------------
 */

/* A .glb of a triangle, whose JSON is filled up by `filling` bytes that its length counts or not. */
static void import_glb(bench_t *bench, uint32_t version, size_t filling, bool counted)
{
    static const float positions[3][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    static const char json[] =
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":36}],\"bufferViews\":[{\"buffer\":0,"
        "\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":"
        "\"VEC3\"}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],\"nodes\":[{\"mesh\":0}]}";
    uint32_t length = sizeof json - 1, chunk = length + (counted ? (uint32_t)filling : 0);
    uint8_t bytes[1024];
    size_t size = 12;
    memcpy(bytes + size, (uint32_t[2]){chunk, 0x4E4F534A}, 8);
    memcpy(bytes + size + 8, json, length);
    memset(bytes + size + 8 + length, ' ', filling);
    size += 8 + length + filling;
    memcpy(bytes + size, (uint32_t[2]){sizeof positions, 0x004E4942}, 8);
    memcpy(bytes + size + 8, positions, sizeof positions);
    size += 8 + sizeof positions;
    memcpy(bytes, (uint32_t[3]){0x46546C67, version, (uint32_t)size}, 12);
    bench_write(bench, "s.glb", bytes, size);
    bench_import_file(bench, "s.glb");
}

static void chunks_that_are_not_filled_up_are_taken(void **state)
{
    (void)state;
    bench_t bench = {0}, right = {0};
    size_t filling = 0;
    while (import_glb(&right, 2, filling, true), strstr(right.warnings, "a chunk of")) ++filling;
    bench_expect_ok(&right);
    assert_in_range(filling, 1, 3); /* else the lines below test nothing */
    import_glb(&bench, 2, 0, true);
    expect_text(bench.warnings, "is not filled up to a multiple of 4; it is taken as it is");
    expect_same_blob(&bench, &right);
    import_glb(&bench, 2, filling, false);
    expect_text(bench.warnings, "is not filled up to a multiple of 4; it is taken as it is");
    expect_same_blob(&bench, &right);
    bench_close(&bench);
    bench_close(&right);
}

/* The specification lets a reader pass it over. */
static void a_byte_order_mark_is_passed_over(void **state)
{
    (void)state;
    static const char text[] = "\xEF\xBB\xBF{\"asset\":{\"version\":\"2.0\"}}";
    bench_t bench = {0};
    bench_write(&bench, "s.gltf", text, strlen(text));
    bench_import_file(&bench, "s.gltf");
    bench_expect_ok(&bench);
    bench_close(&bench);
}

static void the_first_version_gets_one_message(void **state)
{
    (void)state;
    static const char *const texts[] = {
        "{\"asset\":{\"version\":\"1.0\"},\"nodes\":{\"a\":{\"meshes\":[]}},\"scene\":\"s\"}",
        "{\"nodes\":{\"a\":{\"meshes\":[]}},\"scene\":\"s\"}",
        "{\"asset\":{\"generator\":\"x\"},\"buffers\":{\"a\":{\"uri\":\"b\"}}}",
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(texts); ++i) {
        bench_write(&bench, "s.gltf", texts[i], strlen(texts[i]));
        bench_import_file(&bench, "s.gltf");
        expect_text(bench.result.message, "is not glTF 2.0 but 1.0; export it as glTF 2.0");
    }
    import_glb(&bench, 1, 1, true);
    expect_text(bench.result.message, "is not glTF 2.0 but 1.0; export it as glTF 2.0");
    bench_write(&bench, "s.gltf", "{\"nodes\":[]}", 12);
    bench_import_file(&bench, "s.gltf");
    expect_text(bench.result.message, "not a glTF file");
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_meshopt_packed_is_as_before),
        cmocka_unit_test(what_khronos_packed_is_as_before),
        cmocka_unit_test(filters_of_meshopt_are_undone),
        cmocka_unit_test(rotations_of_meshopt_are_undone),
        cmocka_unit_test(wrong_meshopt_is_refused),
        cmocka_unit_test(what_draco_packed_is_as_before),
        cmocka_unit_test(attributes_beside_draco_are_read),
        cmocka_unit_test(wrong_draco_is_refused),
        cmocka_unit_test(damaged_draco_is_read_or_refused),
        cmocka_unit_test(a_webp_picture_is_the_same_picture),
        cmocka_unit_test(a_missing_texture_is_left_out_leniently),
        cmocka_unit_test(a_lenient_import_ignores_extensions_that_a_file_requires),
        cmocka_unit_test(where_on_the_globe_a_file_stands_is_no_matter),
        cmocka_unit_test(chunks_that_are_not_filled_up_are_taken),
        cmocka_unit_test(a_byte_order_mark_is_passed_over),
        cmocka_unit_test(the_first_version_gets_one_message),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
