/* gunzip: see gunzip.h. */
#include "client/import/files/gunzip.h"

#include <limits.h>
#include <stdlib.h>
#include <zlib.h>

enum { GZIP_ONLY = 16 + MAX_WBITS, FIRST_ROOM = 1 << 16 };

typedef struct {
    const char *path;
    z_stream stream;
    const uint8_t *data;
    size_t size, read; /* bytes of data, and those that zlib was given */
    uint8_t *out;
    size_t used, room, limit;
} gunzip_t;

static bool is_gzip(const uint8_t *data, size_t size)
{
    return size >= 2 && data[0] == 0x1f && data[1] == 0x8b;
}

static size_t smaller(size_t a, size_t b)
{
    return a < b ? a : b;
}

/* Doubles the room, up to one byte over the limit: that one shows that there is too much. */
static result_t make_room(gunzip_t *g)
{
    if (g->used < g->room) return result_ok();
    size_t room = smaller(g->room ? 2 * g->room : FIRST_ROOM, g->limit + 1);
    uint8_t *out = realloc(g->out, room);
    if (!out) return result_fail(RESULT_LIMIT, "%s: no memory to decompress it", g->path);
    g->out = out;
    g->room = room;
    return result_ok();
}

/* Gives zlib what it has room for; zlib counts in 32 bits. */
static int step(gunzip_t *g)
{
    z_stream *stream = &g->stream;
    if (stream->avail_in == 0) {
        stream->next_in = (Bytef *)(g->data + g->read); /* zlib does not write to it */
        stream->avail_in = (uInt)smaller(g->size - g->read, INT_MAX);
        g->read += stream->avail_in;
    }
    stream->next_out = g->out + g->used;
    stream->avail_out = (uInt)smaller(g->room - g->used, INT_MAX);
    uInt room = stream->avail_out;
    int status = inflate(stream, Z_NO_FLUSH);
    g->used += room - stream->avail_out;
    return status;
}

static result_t inflate_all(gunzip_t *g)
{
    for (;;) {
        TRY(make_room(g));
        int status = step(g);
        size_t at = g->read - g->stream.avail_in;
        if (g->used > g->limit)
            return result_fail(RESULT_INPUT, "%s: decompressed it has more than the limit of %zu bytes",
                               g->path, g->limit);
        if (status == Z_STREAM_END) {
            if (!is_gzip(g->data + at, g->size - at)) return result_ok(); /* padding is allowed */
            inflateReset(&g->stream);
        } else if (status == Z_BUF_ERROR && at == g->size) {
            return result_fail(RESULT_INPUT, "%s: the compressed data end early; is the file truncated?",
                               g->path);
        } else if (status != Z_OK && status != Z_BUF_ERROR) {
            return result_fail(RESULT_INPUT, "%s: byte %zu: the compressed data are damaged", g->path, at);
        }
    }
}

result_t gunzip(const char *path, const uint8_t *data, size_t size, size_t limit, uint8_t **out,
                size_t *out_size)
{
    *out = NULL;
    *out_size = 0;
    gunzip_t g = {.path = path, .data = data, .size = size, .limit = limit};
    if (inflateInit2(&g.stream, GZIP_ONLY) != Z_OK)
        return result_fail(RESULT_LIMIT, "%s: no memory to decompress it", path);
    result_t result = inflate_all(&g);
    inflateEnd(&g.stream);
    if (result.code != RESULT_OK) {
        free(g.out);
        return result;
    }
    *out = g.out;
    *out_size = g.used;
    return result_ok();
}

result_t gunzip_read_file(const char *path, size_t limit, uint8_t **data, size_t *size)
{
    static const size_t most = (size_t)1 << 32; /* a few megabytes can be made to claim that much */
    TRY(file_read(path, limit, data, size));
    if (!is_gzip(*data, *size)) return result_ok();
    uint8_t *packed = *data;
    result_t result = gunzip(path, packed, *size, most, data, size);
    free(packed);
    return result;
}
