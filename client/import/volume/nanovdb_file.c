/* nanovdb_file: see nanovdb_file.h. */
#include "client/import/volume/nanovdb_file.h"

#include "client/import/packed/unblosc.h"
#include "common/scene/temporary_file.h"

#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>
#include <zlib.h>

enum { HEADER_BYTES = 16, RECORD_BYTES = 176, MOST_NAME = 4096, MAJOR_VERSION = 32 };
typedef enum { CODEC_NONE, CODEC_ZIP, CODEC_BLOSC } codec_t;
static const uint64_t chunk_bytes = (uint64_t)1 << 30, /* that Blosc packs at a time */
    most_in_memory = 64 << 20,                         /* more is unpacked into a temporary file */
    most_growth = 1100;                                /* no codec packs better */

/* What is left of a file. */
typedef struct {
    const char *path;
    const uint8_t *data;
    uint64_t left;
} bytes_t;

/* The record of a grid that is wanted. */
typedef struct {
    uint64_t offset, packed, size; /* of its bytes behind the records of its segment; unpacked */
    uint32_t type, class;
    bool found;
} entry_t;

static result_t truncated(const bytes_t *b)
{
    return result_fail(RESULT_INPUT, "%s: the file ends early; is it truncated?", b->path);
}

static const uint8_t *take(bytes_t *b, uint64_t size)
{
    if (size > b->left) return NULL;
    const uint8_t *taken = b->data;
    b->data += size;
    b->left -= size;
    return taken;
}

static uint64_t u64_at(const uint8_t *bytes)
{
    uint64_t value;
    memcpy(&value, bytes, sizeof value);
    return value;
}

static uint32_t u32_at(const uint8_t *bytes)
{
    uint32_t value;
    memcpy(&value, bytes, sizeof value);
    return value;
}

static uint16_t u16_at(const uint8_t *bytes)
{
    uint16_t value;
    memcpy(&value, bytes, sizeof value);
    return value;
}

/* ---- segments ------------------------------------------------------------------------------------------ */

/* "NanoVDB0", and "NanoVDB2" of newer files; "NanoVDB1" is a grid without a file about it. */
static result_t check_header(const bytes_t *b, const uint8_t *header)
{
    if (memcmp(header, "NanoVDB", 7) != 0 || (header[7] != '0' && header[7] != '2'))
        return result_fail(RESULT_INPUT,
                           "%s: this is no NanoVDB file; make one of an OpenVDB file by nanovdb_convert",
                           b->path);
    uint32_t version = u32_at(header + 8), major = version >> 21;
    if (major != MAJOR_VERSION)
        return result_fail(RESULT_INPUT,
                           "%s: version %u of NanoVDB is not supported; write it with version %d", b->path,
                           major, MAJOR_VERSION);
    if (u16_at(header + 14) > CODEC_BLOSC)
        return result_fail(RESULT_INPUT, "%s: no codec is known by the number %u", b->path,
                           u16_at(header + 14));
    return result_ok();
}

/* Reads the record of one grid; *end is where the grids before it end, behind the records, and moves on. */
static result_t read_record(bytes_t *b, const char *name, uint64_t *end, entry_t *entry)
{
    const uint8_t *record = take(b, RECORD_BYTES);
    if (record == NULL) return truncated(b);
    uint64_t size = u64_at(record), packed = u64_at(record + 8);
    uint32_t name_size = u32_at(record + 136);
    if (name_size == 0 || name_size > MOST_NAME)
        return result_fail(RESULT_INPUT, "%s: the name of a grid has %u bytes", b->path, name_size);
    const char *called = (const char *)take(b, name_size);
    if (called == NULL || packed > b->left || *end > b->left - packed) return truncated(b);
    bool wanted = !entry->found && called[name_size - 1] == '\0' && strcmp(called, name) == 0;
    if (wanted) *entry = (entry_t){*end, packed, size, u32_at(record + 32), u32_at(record + 36), true};
    *end += packed;
    return result_ok();
}

/* Reads a segment up to its grids' bytes, which *end is the length of. */
static result_t read_segment(bytes_t *b, const char *name, entry_t *entry, uint64_t *end, codec_t *codec)
{
    const uint8_t *header = take(b, HEADER_BYTES);
    if (header == NULL) return truncated(b);
    TRY(check_header(b, header));
    *codec = (codec_t)u16_at(header + 14);
    *end = 0;
    for (unsigned i = 0, count = u16_at(header + 12); i < count; ++i) TRY(read_record(b, name, end, entry));
    return *end <= b->left ? result_ok() : truncated(b);
}

/* ---- unpacking ----------------------------------------------------------------------------------------- */

static result_t make_room(const char *path, nanovdb_bytes_t *grid)
{
    void *bytes = MAP_FAILED;
    int file;
    grid->mapped = grid->size > most_in_memory;
    if (!grid->mapped) {
        grid->unpacked = malloc(grid->size > 0 ? grid->size : 1);
        if (grid->unpacked != NULL) return result_ok();
        return result_fail(RESULT_LIMIT, "%s: no memory to unpack it", path);
    }
    TRY(temporary_file(grid->size, &file));
    bytes = mmap(NULL, grid->size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (bytes == MAP_FAILED) return result_fail(RESULT_LIMIT, "%s: no memory to unpack it", path);
    grid->unpacked = bytes;
    return result_ok();
}

/* The size of what follows, and that. */
static const uint8_t *take_packed(bytes_t *b, uint64_t *size)
{
    const uint8_t *length = take(b, sizeof *size);
    if (length == NULL) return NULL;
    *size = u64_at(length);
    return take(b, *size);
}

static result_t unzip(bytes_t *b, const nanovdb_bytes_t *grid)
{
    uint64_t packed;
    const uint8_t *data = take_packed(b, &packed);
    if (data == NULL) return truncated(b);
    uLongf size = grid->size;
    if (uncompress(grid->unpacked, &size, data, packed) == Z_OK && size == grid->size) return result_ok();
    return result_fail(RESULT_INPUT, "%s: its ZIP data are damaged", b->path);
}

static result_t unpack_chunks(bytes_t *b, const nanovdb_bytes_t *grid)
{
    for (uint64_t done = 0; done < grid->size;) {
        uint64_t packed, size = grid->size - done < chunk_bytes ? grid->size - done : chunk_bytes;
        const uint8_t *data = take_packed(b, &packed);
        confined_result_t chunk;
        if (data == NULL) return truncated(b);
        result_t result = unblosc(data, packed, size, &chunk);
        if (result.code != RESULT_OK) return result_fail(result.code, "%s: %s", b->path, result.message);
        memcpy(grid->unpacked + done, chunk.data, size);
        confined_free(&chunk);
        done += size;
    }
    return result_ok();
}

static result_t unpack(bytes_t b, codec_t codec, nanovdb_bytes_t *grid)
{
    if (codec == CODEC_NONE) {
        grid->data = take(&b, grid->size);
        return grid->data != NULL ? result_ok() : truncated(&b);
    }
    if (grid->size / most_growth > b.left)
        return result_fail(RESULT_INPUT, "%s: %llu bytes cannot become the %llu of a grid", b.path,
                           (unsigned long long)b.left, (unsigned long long)grid->size);
    TRY(make_room(b.path, grid));
    grid->data = grid->unpacked;
    return codec == CODEC_ZIP ? unzip(&b, grid) : unpack_chunks(&b, grid);
}

result_t nanovdb_find(const char *path, const uint8_t *file, size_t size, const char *name,
                      nanovdb_bytes_t *grid)
{
    bytes_t b = {path, file, size};
    entry_t entry = {0};
    uint64_t end = 0;
    codec_t codec = CODEC_NONE;
    *grid = (nanovdb_bytes_t){0};
    do {
        TRY(read_segment(&b, name, &entry, &end, &codec));
        if (entry.found) break;
        take(&b, end);
    } while (b.left > 0);
    if (!entry.found) return result_ok();
    *grid = (nanovdb_bytes_t){.size = entry.size, .type = entry.type, .class = entry.class};
    result_t result = unpack((bytes_t){path, b.data + entry.offset, entry.packed}, codec, grid);
    if (result.code != RESULT_OK) nanovdb_bytes_free(grid);
    return result;
}

void nanovdb_bytes_free(nanovdb_bytes_t *grid)
{
    if (grid->mapped && grid->unpacked != NULL)
        munmap(grid->unpacked, grid->size);
    else
        free(grid->unpacked);
    *grid = (nanovdb_bytes_t){0};
}
