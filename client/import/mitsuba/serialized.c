/* serialized: see serialized.h. All numbers are little-endian, as this machine's are. */
#include "client/import/mitsuba/serialized.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

static const size_t largest_file = (size_t)1 << 36;
enum { HEADER = 4, MAGIC = 0x041C, LONGEST_NAME = 65536 };
enum {
    HAS_NORMALS = 0x1,
    HAS_UVS = 0x2,
    HAS_COLOURS = 0x8,
    FACE_NORMALS = 0x10,
    SINGLE_PRECISION = 0x1000,
    DOUBLE_PRECISION = 0x2000
};

typedef struct {
    const char *path;
    position_t at;
    const uint8_t *data;
    size_t size, left; /* left: bytes that zlib has not been given yet */
    z_stream stream;
    bool wide; /* numbers are doubles */
} reader_t;

/* ---- bytes --------------------------------------------------------------------------------------------- */

static result_t damaged(const reader_t *r, const char *why)
{
    return error_at(r->at, "%.300s: %s", r->path, why);
}

static void feed(reader_t *r)
{
    if (r->stream.avail_in > 0) return;
    size_t piece = r->left < (1 << 30) ? r->left : 1 << 30;
    r->stream.next_in = (uint8_t *)r->data + (r->size - r->left);
    r->stream.avail_in = (uInt)piece;
    r->left -= piece;
}

/* The next `size` bytes of what is compressed. */
static result_t read_bytes(reader_t *r, void *out, size_t size)
{
    uint8_t *to = out;
    while (size > 0) {
        size_t piece = size < (1 << 30) ? size : 1 << 30;
        feed(r);
        r->stream.next_out = to;
        r->stream.avail_out = (uInt)piece;
        int status = inflate(&r->stream, Z_NO_FLUSH);
        size_t got = piece - r->stream.avail_out;
        to += got;
        size -= got;
        if (size > 0 && (status == Z_STREAM_END || (status == Z_BUF_ERROR && r->left == 0)))
            return damaged(r, "ends in the middle of a mesh");
        if (status != Z_OK && status != Z_STREAM_END && status != Z_BUF_ERROR)
            return damaged(r, "is damaged: zlib cannot read it");
    }
    return result_ok();
}

/* `count` numbers, of either precision. */
static result_t read_floats(reader_t *r, float *out, size_t count)
{
    if (!r->wide) return read_bytes(r, out, count * sizeof *out);
    double buffer[512];
    for (size_t i = 0; i < count;) {
        size_t piece = count - i < ARRAY_LENGTH(buffer) ? count - i : ARRAY_LENGTH(buffer);
        TRY(read_bytes(r, buffer, piece * sizeof *buffer));
        for (size_t k = 0; k < piece; ++k) out[i++] = (float)buffer[k];
    }
    return result_ok();
}

/* ---- the directory ------------------------------------------------------------------------------------- */

static uint64_t number_at(const uint8_t *data, size_t size)
{
    uint64_t number = 0;
    memcpy(&number, data, size);
    return number;
}

/* Where mesh `index` begins. A file without a directory (of one mesh) has it at its begin. */
static result_t find_mesh(reader_t *r, uint64_t index, size_t *offset, unsigned *version)
{
    if (r->size < HEADER + 4 || number_at(r->data, 2) != MAGIC)
        return damaged(r, "is no file of Mitsuba's serialized meshes");
    *version = (unsigned)number_at(r->data + 2, 2);
    if (*version != 3 && *version != 4)
        return damaged(r, "has a version that is neither 3 nor 4; write it anew");
    size_t width = *version == 4 ? 8 : 4;
    uint64_t count = number_at(r->data + r->size - 4, 4);
    if (count > (r->size - 4) / width) return damaged(r, "its directory does not fit");
    if (index >= count)
        return error_at(r->at, "%.300s: shapeIndex %" PRIu64 " is asked for, but it has %" PRIu64 " meshes",
                        r->path, index, count);
    uint64_t at = number_at(r->data + r->size - 4 - width * (count - index), width);
    if (at > r->size - HEADER || number_at(r->data + at, 2) != MAGIC)
        return damaged(r, "its directory points to what is no mesh");
    *offset = (size_t)at + HEADER;
    return result_ok();
}

/* ---- a mesh -------------------------------------------------------------------------------------------- */

static result_t skip_name(reader_t *r)
{
    char c = 1;
    for (int i = 0; c != '\0'; ++i) {
        if (i == LONGEST_NAME) return damaged(r, "a mesh has a name without an end");
        TRY(read_bytes(r, &c, 1));
    }
    return result_ok();
}

static result_t read_colours(reader_t *r, mesh_t *mesh)
{
    mesh->colours = mem_alloc((size_t)mesh->vertex_count * sizeof *mesh->colours);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        float c[3];
        TRY(read_floats(r, c, 3));
        mesh->colours[i] = (blob_colour_t){c[0], c[1], c[2], 1};
    }
    return result_ok();
}

static result_t read_vertices(reader_t *r, uint32_t flags, mesh_t *mesh)
{
    size_t count = mesh->vertex_count;
    mesh->positions = mem_alloc(count * sizeof *mesh->positions);
    TRY(read_floats(r, &mesh->positions->x, 3 * count));
    if (flags & HAS_NORMALS) {
        mesh->normals = mem_alloc(count * sizeof *mesh->normals);
        TRY(read_floats(r, &mesh->normals->x, 3 * count));
    }
    if (flags & HAS_UVS) {
        mesh->uvs = mem_alloc(count * sizeof *mesh->uvs);
        TRY(read_floats(r, &mesh->uvs->x, 2 * count));
    }
    return flags & HAS_COLOURS ? read_colours(r, mesh) : result_ok();
}

static result_t read_mesh(reader_t *r, unsigned version, scene_builder_t *scene, mesh_t *mesh, bool *flat)
{
    uint32_t flags;
    uint64_t counts[2];
    TRY(read_bytes(r, &flags, sizeof flags));
    if (version == 4) TRY(skip_name(r));
    TRY(read_bytes(r, counts, sizeof counts));
    if (counts[0] == 0 || counts[1] == 0 || counts[0] >= UINT32_MAX || counts[1] >= UINT32_MAX)
        return damaged(r, "a mesh has no triangle, or more than 2^32");
    TRY(scene_charge(scene, SCENE_VERTICES, counts[0] + 3 * counts[1], r->at));
    mesh->vertex_count = (uint32_t)counts[0];
    r->wide = (flags & DOUBLE_PRECISION) != 0;
    *flat = (flags & FACE_NORMALS) != 0;
    TRY(read_vertices(r, flags, mesh));
    mesh->triangles = mem_alloc((size_t)counts[1] * sizeof *mesh->triangles);
    TRY(read_bytes(r, mesh->triangles, (size_t)counts[1] * sizeof *mesh->triangles));
    mesh->triangle_count = (uint32_t)counts[1];
    return result_ok();
}

result_t serialized_read(const char *path, uint64_t index, scene_builder_t *scene, position_t at,
                         mesh_t *mesh, bool *flat)
{
    uint8_t *data;
    size_t size, offset = 0;
    unsigned version = 0;
    result_t result = file_read(path, largest_file, &data, &size);
    if (result.code != RESULT_OK) return error_at(at, "%s", result.message);
    scene->source_bytes += size;
    reader_t r = {.path = path, .at = at, .data = data, .size = size};
    result = find_mesh(&r, index, &offset, &version);
    r.left = size - offset;
    if (result.code == RESULT_OK && inflateInit(&r.stream) != Z_OK)
        result = result_fail(RESULT_LIMIT, "%s: no memory to decompress it", path);
    else if (result.code == RESULT_OK) {
        result = read_mesh(&r, version, scene, mesh, flat);
        inflateEnd(&r.stream);
    }
    free(data);
    return result;
}
