/* image_exr: OpenEXR files through OpenEXRCore, the C API of OpenEXR 3.1 (see image.h).
 *
 * The library reads and writes through our own streams: reads by pread with the errno kept, writes into an
 * atomic_file_t. What it has to say about an error goes into our message instead of to stderr. Chunks (16
 * lines of a ZIP file, a tile, ...) are decoded one after the other straight into the channels' planes; a
 * truncated file fails at its first missing chunk, before the zero pages of the planes behind it are ever
 * touched.
 *
 * Writing is mostly compression, so several threads share it. Each takes the next chunk, encodes it with a
 * pipeline of its own, and waits for its turn to write: chunks are in the file in order, and its bytes do not
 * depend on how many threads there were.
 *
 * What zlib is asked for was measured with scenes/seed-diffuse at 1920 x 1080 and 4 samples, all layers: 73.1
 * MB in 1.8 CPU seconds, a tenth of the render. Film noise hardly gets smaller: level 4 takes 20 % longer for
 * 0.6 %. Level 1 saves no time. PIZ saves 20 % of it for a file that is 5.5 % larger, RLE 70 % for one 45 %
 * larger.
 */
#include "common/atomic_file.h"
#include "common/image/image.h"
#include "common/memory_limit.h"
#include "common/plain_text.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <openexr.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum {
    ZIP_LEVEL = 2,           /* see the head comment */
    MAX_ATTRIBUTE_NAME = 31, /* without the long-name flag in the file */
    MAX_TILE_SIDE = 1 << 14,
    MAX_WRITERS = 16, /* threads that compress */
};
#define HALF_MAX 65504.0f

/* What our callbacks share with the caller. */
typedef struct {
    int descriptor;           /* of the file that is read, */
    const uint8_t *data;      /* or its bytes in memory, */
    size_t size;              /* this many */
    atomic_file_t *file;      /* that is written, */
    image_writing_t *writing; /* what is told of it; NULL: nobody asks */
    int error;                /* errno of a failed read */
    pthread_mutex_t lock;     /* guards the message when several threads write */
    char message[256];        /* the library's last words */
} exr_stream_t;

static void keep_message(exr_const_context_t context, exr_result_t code, const char *message)
{
    void *user = NULL;
    (void)code;
    if (context == NULL || exr_get_user_data(context, &user) != EXR_ERR_SUCCESS || user == NULL) return;
    exr_stream_t *stream = user;
    pthread_mutex_lock(&stream->lock);
    /* The first message of a failure names the cause, later ones only its consequences. */
    if (stream->message[0] == '\0') {
        snprintf(stream->message, sizeof stream->message, "%s", message);
        plain_text_clean(stream->message); /* it may quote the file's bytes */
    }
    pthread_mutex_unlock(&stream->lock);
}

static const char *stream_message(exr_stream_t *stream, exr_result_t code)
{
    if (stream->error != 0) return strerror(stream->error);
    pthread_mutex_lock(&stream->lock);
    bool known = stream->message[0] != '\0'; /* from then on it stays as it is */
    pthread_mutex_unlock(&stream->lock);
    return known ? stream->message : exr_get_default_error_message(code);
}

/* ---- reading ---- */

static int64_t memory_read(exr_const_context_t context, void *user, void *buffer, uint64_t size,
                           uint64_t offset, exr_stream_error_func_ptr_t report)
{
    (void)context, (void)report;
    const exr_stream_t *stream = user;
    if (offset >= stream->size) return 0;
    uint64_t got = size < stream->size - offset ? size : stream->size - offset;
    memcpy(buffer, stream->data + offset, got);
    return (int64_t)got;
}

static int64_t memory_size(exr_const_context_t context, void *user)
{
    (void)context;
    const exr_stream_t *stream = user;
    return (int64_t)stream->size;
}

static int64_t stream_read(exr_const_context_t context, void *user, void *buffer, uint64_t size,
                           uint64_t offset, exr_stream_error_func_ptr_t report)
{
    (void)context, (void)report;
    exr_stream_t *stream = user;
    uint64_t got = 0;
    while (got < size) {
        ssize_t n = pread(stream->descriptor, (uint8_t *)buffer + got, size - got, (off_t)(offset + got));
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) stream->error = errno;
        if (n < 0) return -1;
        if (n == 0) break;
        got += (uint64_t)n;
    }
    return (int64_t)got;
}

static int64_t stream_size(exr_const_context_t context, void *user)
{
    (void)context;
    const exr_stream_t *stream = user;
    struct stat about;
    return fstat(stream->descriptor, &about) == 0 ? (int64_t)about.st_size : -1;
}

/* One file being read. */
typedef struct {
    const char *path;
    exr_stream_t stream;
    exr_context_t context;
    image_t *image;
    image_rows_fn take; /* NULL: the image is read whole */
    void *context_of_take;
    int height;     /* of the file; the image may have some of its rows */
    float **planes; /* of the channels in file order */
    int32_t origin_x, origin_y;
    exr_decode_pipeline_t decoder;
    bool decoder_ready;
} exr_reader_t;

static result_t read_error(exr_reader_t *reader, exr_result_t code)
{
    return result_fail(reader->stream.error != 0 ? RESULT_IO : RESULT_INPUT,
                       "%s: cannot be read as OpenEXR: %s", reader->path,
                       stream_message(&reader->stream, code));
}

#define TRY_READ(call)                                                                                       \
    do {                                                                                                     \
        exr_result_t try_code_ = (call);                                                                     \
        if (try_code_ != EXR_ERR_SUCCESS) return read_error(reader, try_code_);                              \
    } while (0)

static result_t open_file(exr_reader_t *reader)
{
    struct stat about;
    return file_open(reader->path, &reader->stream.descriptor, &about);
}

static result_t reader_open(exr_reader_t *reader)
{
    bool in_memory = reader->stream.data != NULL;
    if (!in_memory) TRY(open_file(reader));
    exr_context_initializer_t options = EXR_DEFAULT_CONTEXT_INITIALIZER;
    options.error_handler_fn = keep_message;
    options.user_data = &reader->stream;
    options.read_fn = in_memory ? memory_read : stream_read;
    options.size_fn = in_memory ? memory_size : stream_size;
    options.max_image_width = IMAGE_MAX_SIDE;
    options.max_image_height = IMAGE_MAX_SIDE;
    options.max_tile_width = MAX_TILE_SIDE;
    options.max_tile_height = MAX_TILE_SIDE;
    options.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    TRY_READ(exr_start_read(&reader->context, reader->path, &options));
    return result_ok();
}

static result_t read_size(exr_reader_t *reader)
{
    exr_attr_box2i_t window;
    TRY_READ(exr_get_data_window(reader->context, 0, &window));
    int64_t width = (int64_t)window.max.x - window.min.x + 1,
            height = (int64_t)window.max.y - window.min.y + 1;
    if (width < 1 || height < 1 || width > IMAGE_MAX_SIDE || height > IMAGE_MAX_SIDE ||
        width * height > IMAGE_MAX_PIXELS)
        return result_fail(
            RESULT_INPUT, "%s: %lld x %lld pixels are outside the limits (%d a side, %d in all)",
            reader->path, (long long)width, (long long)height, IMAGE_MAX_SIDE, IMAGE_MAX_PIXELS);
    image_init(reader->image, (int)width, (int)height);
    reader->height = (int)height;
    reader->origin_x = window.min.x;
    reader->origin_y = window.min.y;
    return result_ok();
}

static result_t check_channels(const exr_reader_t *reader, const exr_attr_chlist_t *list)
{
    uint64_t pixels = (uint64_t)reader->image->width * (uint64_t)reader->image->height;
    if (list->num_channels < 1 || list->num_channels > IMAGE_MAX_CHANNELS)
        return result_fail(RESULT_INPUT, "%s: %d channels, expected 1 to %d", reader->path,
                           list->num_channels, IMAGE_MAX_CHANNELS);
    if (pixels * (uint64_t)list->num_channels * sizeof(float) > IMAGE_MAX_BYTES)
        return result_fail(RESULT_INPUT, "%s: %d channels of %d x %d pixels take more than %llu GiB",
                           reader->path, list->num_channels, reader->image->width, reader->image->height,
                           (unsigned long long)(IMAGE_MAX_BYTES >> 30));
    for (int i = 0; i < list->num_channels; i++)
        if (list->entries[i].x_sampling != 1 || list->entries[i].y_sampling != 1)
            return result_fail(RESULT_INPUT, "%s: channel %s is subsampled, which is not supported",
                               reader->path, list->entries[i].name.str);
    return result_ok();
}

/* OpenEXRCore 3.1 silently mixes up the lines of channels that B44 stores as they are: all but halves. */
static result_t check_compression(exr_reader_t *reader, const exr_attr_chlist_t *list)
{
    exr_compression_t compression;
    TRY_READ(exr_get_compression(reader->context, 0, &compression));
    if (compression != EXR_COMPRESSION_B44 && compression != EXR_COMPRESSION_B44A) return result_ok();
    for (int i = 0; i < list->num_channels; i++)
        if (list->entries[i].pixel_type != EXR_PIXEL_HALF)
            return result_fail(RESULT_INPUT,
                               "%s: B44 compression of float channels is not supported; use ZIP",
                               reader->path);
    return result_ok();
}

static result_t read_channels(exr_reader_t *reader)
{
    const exr_attr_chlist_t *list = NULL;
    TRY_READ(exr_get_channels(reader->context, 0, &list));
    TRY(check_channels(reader, list));
    TRY(check_compression(reader, list));
    reader->planes = mem_zalloc((size_t)list->num_channels, sizeof *reader->planes);
    for (int i = 0; i < list->num_channels; i++) {
        const exr_attr_chlist_entry_t *entry = &list->entries[i];
        pixel_type_t type = entry->pixel_type == EXR_PIXEL_HALF   ? PIXEL_HALF
                            : entry->pixel_type == EXR_PIXEL_UINT ? PIXEL_UINT
                                                                  : PIXEL_FLOAT;
        reader->planes[i] = image_add_channel(reader->image, entry->name.str, type);
        if (reader->planes[i] == NULL)
            return result_fail(RESULT_LIMIT, "%s: no memory for %d channels of %d x %d pixels", reader->path,
                               list->num_channels, reader->image->width, reader->image->height);
    }
    return result_ok();
}

/* The value of an attribute that is neither string nor int nor float, or what type it has; fresh memory. */
static char *other_text(const exr_attribute_t *attribute)
{
    static const char *const compressions[] = {"none",  "rle", "zips", "zip",  "piz",
                                               "pxr24", "b44", "b44a", "dwaa", "dwab"};
    static const char *const orders[] = {"increasing y", "decreasing y", "random y"};
    switch (attribute->type) {
    case EXR_ATTR_DOUBLE:
        return mem_printf("%.17g", attribute->d);
    case EXR_ATTR_V2I:
        return mem_printf("%d %d", attribute->v2i->x, attribute->v2i->y);
    case EXR_ATTR_V2F:
        return mem_printf("%.9g %.9g", (double)attribute->v2f->x, (double)attribute->v2f->y);
    case EXR_ATTR_BOX2I:
        return mem_printf("%d %d to %d %d", attribute->box2i->min.x, attribute->box2i->min.y,
                          attribute->box2i->max.x, attribute->box2i->max.y);
    case EXR_ATTR_COMPRESSION:
        if (attribute->uc < ARRAY_LENGTH(compressions)) return mem_strdup(compressions[attribute->uc]);
        break;
    case EXR_ATTR_LINEORDER:
        if (attribute->uc < ARRAY_LENGTH(orders)) return mem_strdup(orders[attribute->uc]);
        break;
    default:
        break;
    }
    return mem_printf("(%s)", attribute->type_name);
}

static void read_chromaticities(image_t *image, const exr_attr_chromaticities_t *c)
{
    const float xy[4][2] = {
        {c->red_x, c->red_y}, {c->green_x, c->green_y}, {c->blue_x, c->blue_y}, {c->white_x, c->white_y}};
    memcpy(image->chromaticities, xy, sizeof xy);
    image->has_chromaticities = true;
}

static void read_attribute(image_t *image, const exr_attribute_t *attribute)
{
    switch (attribute->type) {
    case EXR_ATTR_CHLIST:
        return; /* known as channels already */
    case EXR_ATTR_INT:
        image_set_int(image, attribute->name, attribute->i);
        return;
    case EXR_ATTR_FLOAT:
        image_set_float(image, attribute->name, attribute->f);
        return;
    case EXR_ATTR_STRING:
        image_set_string(image, attribute->name, attribute->string->str);
        return;
    case EXR_ATTR_CHROMATICITIES:
        if (strcmp(attribute->name, "chromaticities") == 0)
            read_chromaticities(image, attribute->chromaticities);
        break;
    default:
        break;
    }
    char *text = other_text(attribute);
    image_set_string(image, attribute->name, text);
    image->attributes[image->attribute_count - 1].kind = ATTRIBUTE_OTHER;
    free(text);
}

static result_t read_attributes(exr_reader_t *reader)
{
    int32_t count = 0;
    TRY_READ(exr_get_attribute_count(reader->context, 0, &count));
    if (count > IMAGE_MAX_ATTRIBUTES)
        return result_fail(RESULT_INPUT, "%s: %d attributes, expected at most %d", reader->path, count,
                           IMAGE_MAX_ATTRIBUTES);
    for (int32_t i = 0; i < count; i++) {
        const exr_attribute_t *attribute = NULL;
        TRY_READ(exr_get_attribute_by_index(reader->context, 0, EXR_ATTR_LIST_FILE_ORDER, i, &attribute));
        read_attribute(reader->image, attribute);
    }
    return result_ok();
}

/* Decodes a chunk to the planes, its top left pixel at (x, y) of the image. */
static result_t read_chunk(exr_reader_t *reader, const exr_chunk_info_t *chunk, int x, int y)
{
    const image_t *image = reader->image;
    exr_decode_pipeline_t *decoder = &reader->decoder;
    if (chunk->width < 0 || chunk->height < 0 || x + chunk->width > image->width ||
        y + chunk->height > image->height)
        return result_fail(RESULT_INPUT, "%s: a chunk lies outside the image", reader->path);
    if (reader->decoder_ready)
        TRY_READ(exr_decoding_update(reader->context, 0, chunk, decoder));
    else
        TRY_READ(exr_decoding_initialize(reader->context, 0, chunk, decoder));
    for (int i = 0; i < decoder->channel_count; i++) {
        exr_coding_channel_info_t *channel = &decoder->channels[i];
        channel->decode_to_ptr =
            (uint8_t *)(reader->planes[i] + (size_t)y * (size_t)image->width + (size_t)x);
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_bytes_per_element = sizeof(float);
        channel->user_pixel_stride = sizeof(float);
        channel->user_line_stride = image->width * (int32_t)sizeof(float);
    }
    if (!reader->decoder_ready) TRY_READ(exr_decoding_choose_default_routines(reader->context, 0, decoder));
    reader->decoder_ready = true;
    TRY_READ(exr_decoding_run(reader->context, 0, decoder));
    return result_ok();
}

static result_t read_chunk_lines(exr_reader_t *reader, int32_t *lines)
{
    TRY_READ(exr_get_scanlines_per_chunk(reader->context, 0, lines));
    if (*lines < 1) return result_fail(RESULT_INPUT, "%s: chunks of %d lines", reader->path, *lines);
    return result_ok();
}

/* From now on the image has the rows of one chunk. */
static result_t keep_rows_only(exr_reader_t *reader)
{
    int32_t lines = 0;
    TRY(read_chunk_lines(reader, &lines));
    reader->image->height = int_min(lines, reader->height);
    return result_ok();
}

static result_t read_scanlines(exr_reader_t *reader)
{
    int32_t lines = 0;
    TRY(read_chunk_lines(reader, &lines));
    for (int y = 0; y < reader->height; y += lines) {
        exr_chunk_info_t chunk;
        TRY_READ(exr_read_scanline_chunk_info(reader->context, 0, reader->origin_y + y, &chunk));
        TRY(read_chunk(reader, &chunk, 0, reader->take != NULL ? 0 : y));
        if (reader->take == NULL) continue;
        reader->image->height = chunk.height; /* the last may be lower */
        TRY(reader->take(reader->context_of_take, reader->image, y, reader->height));
    }
    return result_ok();
}

static result_t read_tiles(exr_reader_t *reader)
{
    int32_t width = 0, height = 0;
    TRY_READ(exr_get_tile_sizes(reader->context, 0, 0, 0, &width, &height));
    if (width < 1 || height < 1) return result_fail(RESULT_INPUT, "%s: empty tiles", reader->path);
    for (int y = 0; y < reader->image->height; y += height)
        for (int x = 0; x < reader->image->width; x += width) {
            exr_chunk_info_t chunk;
            TRY_READ(exr_read_tile_chunk_info(reader->context, 0, x / width, y / height, 0, 0, &chunk));
            TRY(read_chunk(reader, &chunk, x, y));
        }
    return result_ok();
}

static result_t reader_run(exr_reader_t *reader)
{
    TRY(reader_open(reader));
    TRY(read_size(reader));
    exr_storage_t storage;
    TRY_READ(exr_get_storage(reader->context, 0, &storage));
    if (storage != EXR_STORAGE_SCANLINE && storage != EXR_STORAGE_TILED)
        return result_fail(RESULT_INPUT, "%s: deep images are not supported", reader->path);
    if (reader->take != NULL && storage != EXR_STORAGE_SCANLINE)
        return result_fail(RESULT_INPUT, "%s: is in tiles, not in rows", reader->path);
    if (reader->take != NULL) TRY(keep_rows_only(reader));
    TRY(read_channels(reader));
    TRY(read_attributes(reader));
    return storage == EXR_STORAGE_TILED ? read_tiles(reader) : read_scanlines(reader);
}

/* Reads what the reader says and frees what is its own; the image is the caller's. */
static result_t read_and_close(exr_reader_t *reader)
{
    *reader->image = (image_t){0};
    result_t result = reader_run(reader);
    if (reader->context != NULL) {
        exr_decoding_destroy(reader->context, &reader->decoder);
        exr_finish(&reader->context);
    }
    if (reader->stream.descriptor >= 0) close(reader->stream.descriptor);
    free(reader->planes);
    return result;
}

static result_t read_image(const char *path, exr_stream_t stream, image_t *image)
{
    exr_reader_t reader = {.path = path, .image = image, .stream = stream};
    result_t result = read_and_close(&reader);
    if (result.code != RESULT_OK) image_free(image);
    return result;
}

result_t image_read_exr(const char *path, image_t *image)
{
    return read_image(path, (exr_stream_t){.descriptor = -1, .lock = PTHREAD_MUTEX_INITIALIZER}, image);
}

result_t image_read_exr_rows(const char *path, image_rows_fn take, void *context)
{
    image_t rows;
    exr_reader_t reader = {.path = path,
                           .image = &rows,
                           .stream = {.descriptor = -1, .lock = PTHREAD_MUTEX_INITIALIZER},
                           .take = take,
                           .context_of_take = context};
    result_t result = read_and_close(&reader);
    image_free(&rows);
    return result;
}

result_t image_decode_exr(const char *name, const uint8_t *data, size_t size, image_t *image)
{
    return read_image(
        name, (exr_stream_t){.descriptor = -1, .lock = PTHREAD_MUTEX_INITIALIZER, .data = data, .size = size},
        image);
}

/* ---- writing ---- */

static bool may_write(exr_stream_t *stream, uint64_t end)
{
    image_writing_t *writing = stream->writing;
    if (writing == NULL) return true;
    if (writing->limit > 0 && end > writing->limit) writing->too_large = true;
    return !writing->too_large && !atomic_load(&writing->cancel);
}

static int64_t stream_write(exr_const_context_t context, void *user, const void *data, uint64_t size,
                            uint64_t offset, exr_stream_error_func_ptr_t report)
{
    (void)context, (void)report;
    exr_stream_t *stream = user;
    if (!may_write(stream, offset + size)) return -1;
    return atomic_file_write_at(stream->file, data, size, offset) ? (int64_t)size : -1;
}

/* One file being written. */
typedef struct {
    const char *path;
    exr_stream_t stream;
    exr_context_t context;
    const image_t *image;
    int32_t lines; /* of a chunk */
    int chunks;
    pthread_mutex_t lock; /* guards what follows, and the library's context */
    pthread_cond_t turn;
    int next;    /* chunk to encode */
    int written; /* chunks that are in the file */
    bool failed; /* no chunk will follow */
} exr_writer_t;

#define TRY_WRITE(call)                                                                                      \
    do {                                                                                                     \
        exr_result_t try_code_ = (call);                                                                     \
        if (try_code_ != EXR_ERR_SUCCESS)                                                                    \
            return result_fail(RESULT_IO, "%s: cannot be written: %s", writer->path,                         \
                               stream_message(&writer->stream, try_code_));                                  \
    } while (0)

static result_t write_attributes(exr_writer_t *writer)
{
    for (size_t i = 0; i < writer->image->attribute_count; i++) {
        const image_attribute_t *attribute = &writer->image->attributes[i];
        const char *name = attribute->name;
        if (strlen(name) > MAX_ATTRIBUTE_NAME)
            return result_fail(RESULT_LIMIT, "%s: attribute name %s is over %d characters", writer->path,
                               name, MAX_ATTRIBUTE_NAME);
        switch (attribute->kind) {
        case ATTRIBUTE_STRING:
            TRY_WRITE(exr_attr_set_string(writer->context, 0, name, attribute->text));
            break;
        case ATTRIBUTE_INT:
            TRY_WRITE(exr_attr_set_int(writer->context, 0, name, attribute->integer));
            break;
        case ATTRIBUTE_FLOAT:
            TRY_WRITE(exr_attr_set_float(writer->context, 0, name, attribute->real));
            break;
        case ATTRIBUTE_OTHER:
            break; /* read from a file that had it; has no value here */
        }
    }
    return result_ok();
}

static result_t write_header(exr_writer_t *writer)
{
    const image_t *image = writer->image;
    TRY_WRITE(exr_add_part(writer->context, "image", EXR_STORAGE_SCANLINE, NULL));
    TRY_WRITE(exr_initialize_required_attr_simple(writer->context, 0, image->width, image->height,
                                                  EXR_COMPRESSION_ZIP));
    for (size_t i = 0; i < image->channel_count; i++) {
        exr_pixel_type_t type = image->channels[i].type == PIXEL_HALF ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT;
        TRY_WRITE(exr_add_channel(writer->context, 0, image->channels[i].name, type,
                                  EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1));
    }
    TRY(write_attributes(writer));
    TRY_WRITE(exr_set_zip_compression_level(writer->context, 0, ZIP_LEVEL));
    TRY_WRITE(exr_write_header(writer->context));
    TRY_WRITE(exr_get_scanlines_per_chunk(writer->context, 0, &writer->lines));
    return result_ok();
}

/* Copies `lines` lines from line y of a channel to `out`; what a half cannot hold is clamped. */
static void gather_lines(const image_t *image, const image_channel_t *channel, int y, int lines, float *out)
{
    const float *data = channel->data + (size_t)y * (size_t)image->width * channel->stride;
    size_t count = (size_t)lines * (size_t)image->width;
    for (size_t i = 0; i < count; i++) out[i] = data[i * channel->stride];
    if (channel->type != PIXEL_HALF) return;
    for (size_t i = 0; i < count; i++)
        if (isfinite(out[i])) out[i] = fmaxf(-HALF_MAX, fminf(HALF_MAX, out[i]));
}

/* A thread that encodes chunks. */
typedef struct {
    exr_writer_t *writer;
    pthread_t thread;
    exr_encode_pipeline_t encoder;
    bool ready;                                               /* the encoder has its routines */
    exr_result_t (*compress)(exr_encode_pipeline_t *encoder); /* the library's own, and below */
    exr_result_t (*write)(exr_encode_pipeline_t *encoder);
    float *stage; /* [channels][lines of a chunk][width], gathered from the channels */
    int chunk;    /* in the making */
    result_t result;
} exr_chunk_writer_t;

/* A chunk as large as its pixels is stored as they are, and read so. OpenEXRCore 3.1 forgets to where
 * compression makes it exactly as large; such a chunk would come back as noise. */
static exr_result_t compress_chunk(exr_encode_pipeline_t *encoder)
{
    const exr_chunk_writer_t *self = encoder->encoding_user_data;
    exr_result_t code = self->compress(encoder);
    if (code == EXR_ERR_SUCCESS && encoder->compressed_bytes == encoder->packed_bytes)
        memcpy(encoder->compressed_buffer, encoder->packed_buffer, encoder->packed_bytes);
    return code;
}

/* Writes the encoded chunk once all before it are written. */
static exr_result_t write_in_turn(exr_encode_pipeline_t *encoder)
{
    const exr_chunk_writer_t *self = encoder->encoding_user_data;
    exr_writer_t *writer = self->writer;
    exr_result_t code = EXR_ERR_WRITE_IO;
    pthread_mutex_lock(&writer->lock);
    while (writer->written != self->chunk && !writer->failed) pthread_cond_wait(&writer->turn, &writer->lock);
    if (!writer->failed) {
        code = self->write(encoder);
        if (code == EXR_ERR_SUCCESS) writer->written++;
        if (writer->image->writing != NULL)
            atomic_store(&writer->image->writing->done, (size_t)writer->written);
        pthread_cond_broadcast(&writer->turn);
    }
    pthread_mutex_unlock(&writer->lock);
    return code;
}

static exr_result_t no_wait(exr_encode_pipeline_t *encoder)
{
    (void)encoder;
    return EXR_ERR_SUCCESS; /* write_in_turn waits */
}

static result_t start_encoder(exr_chunk_writer_t *self)
{
    exr_writer_t *writer = self->writer;
    TRY_WRITE(exr_encoding_choose_default_routines(writer->context, 0, &self->encoder));
    self->compress = self->encoder.compress_fn;
    self->write = self->encoder.write_fn;
    self->encoder.compress_fn = compress_chunk;
    self->encoder.yield_until_ready_fn = no_wait;
    self->encoder.write_fn = write_in_turn;
    self->encoder.encoding_user_data = self;
    self->ready = true;
    return result_ok();
}

/* Under the lock: makes the encoder fit the chunk that begins at line y. */
static result_t aim_encoder(exr_chunk_writer_t *self, int y, exr_chunk_info_t *chunk)
{
    exr_writer_t *writer = self->writer;
    TRY_WRITE(exr_write_scanline_chunk_info(writer->context, 0, y, chunk));
    if (self->ready)
        TRY_WRITE(exr_encoding_update(writer->context, 0, chunk, &self->encoder));
    else
        TRY_WRITE(exr_encoding_initialize(writer->context, 0, chunk, &self->encoder));
    return result_ok();
}

static result_t write_chunk(exr_chunk_writer_t *self)
{
    exr_writer_t *writer = self->writer;
    exr_encode_pipeline_t *encoder = &self->encoder;
    exr_chunk_info_t chunk;
    int y = self->chunk * writer->lines;
    pthread_mutex_lock(&writer->lock);
    result_t aimed = aim_encoder(self, y, &chunk);
    pthread_mutex_unlock(&writer->lock);
    TRY(aimed);
    size_t width = (size_t)writer->image->width;
    for (int i = 0; i < encoder->channel_count; i++) {
        exr_coding_channel_info_t *channel = &encoder->channels[i];
        float *stage = self->stage + (size_t)i * (size_t)writer->lines * width;
        /* The library sorts the channels of a file by name. */
        gather_lines(writer->image, image_find(writer->image, channel->channel_name), y, chunk.height, stage);
        channel->encode_from_ptr = (const uint8_t *)stage;
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_bytes_per_element = sizeof(float);
        channel->user_pixel_stride = sizeof(float);
        channel->user_line_stride = writer->image->width * (int32_t)sizeof(float);
    }
    if (!self->ready) TRY(start_encoder(self));
    TRY_WRITE(exr_encoding_run(writer->context, 0, encoder));
    return result_ok();
}

/* Takes the next chunk; false when there is none, or one has failed. */
static bool next_chunk(exr_chunk_writer_t *self)
{
    exr_writer_t *writer = self->writer;
    pthread_mutex_lock(&writer->lock);
    bool taken = !writer->failed && writer->next < writer->chunks;
    if (taken) self->chunk = writer->next++;
    pthread_mutex_unlock(&writer->lock);
    return taken;
}

static void *write_chunks(void *argument)
{
    exr_chunk_writer_t *self = argument;
    exr_writer_t *writer = self->writer;
    while (self->result.code == RESULT_OK && next_chunk(self)) self->result = write_chunk(self);
    if (self->result.code == RESULT_OK) return NULL;
    pthread_mutex_lock(&writer->lock);
    writer->failed = true;
    pthread_cond_broadcast(&writer->turn);
    pthread_mutex_unlock(&writer->lock);
    return NULL;
}

/* Writes all chunks on as many threads as there are cores, this one among them. */
static result_t write_all_chunks(exr_writer_t *writer)
{
    const image_t *image = writer->image;
    exr_chunk_writer_t *threads = mem_zalloc(MAX_WRITERS, sizeof *threads);
    int wanted = int_min(MAX_WRITERS, int_min(core_count(), writer->chunks)), started = 0;
    size_t stage = image->channel_count * (size_t)writer->lines * (size_t)image->width * sizeof(float);
    for (int i = 0; i < wanted; i++) {
        threads[i].writer = writer;
        threads[i].stage = mem_alloc(stage);
    }
    while (started < wanted - 1 &&
           pthread_create(&threads[started].thread, NULL, write_chunks, &threads[started]) == 0) {
        pthread_setname_np(threads[started].thread, "exr");
        started++;
    }
    write_chunks(&threads[started]);
    result_t result = result_ok();
    for (int i = 0; i < started; i++) pthread_join(threads[i].thread, NULL);
    for (int i = 0; i < wanted; i++) {
        if (result.code == RESULT_OK) result = threads[i].result;
        exr_encoding_destroy(writer->context, &threads[i].encoder);
        free(threads[i].stage);
    }
    free(threads);
    return result;
}

static result_t writer_run(exr_writer_t *writer)
{
    const image_t *image = writer->image;
    exr_context_initializer_t options = EXR_DEFAULT_CONTEXT_INITIALIZER;
    options.error_handler_fn = keep_message;
    options.user_data = &writer->stream;
    options.write_fn = stream_write;
    TRY_WRITE(exr_start_write(&writer->context, writer->path, EXR_WRITE_FILE_DIRECTLY, &options));
    TRY(write_header(writer));
    writer->chunks = (image->height + writer->lines - 1) / writer->lines;
    if (image->writing != NULL) atomic_store(&image->writing->total, (size_t)writer->chunks);
    TRY(write_all_chunks(writer));
    TRY_WRITE(exr_finish(&writer->context)); /* writes the chunk table */
    return result_ok();
}

/* Why the file was given up by us, if it was. */
static result_t given_up(const char *path, const image_writing_t *writing, result_t otherwise)
{
    if (writing != NULL && writing->too_large)
        return result_fail(RESULT_LIMIT, "%s: the image takes more than %llu bytes", path,
                           (unsigned long long)writing->limit);
    if (writing != NULL && atomic_load(&writing->cancel))
        return result_fail(RESULT_CANCELLED, "%s: the image is not wanted any more", path);
    return otherwise;
}

result_t image_write_exr(const char *path, const image_t *image)
{
    atomic_file_t file;
    TRY(atomic_file_open(&file, path));
    file.fleeting = image->writing != NULL && image->writing->fleeting;
    exr_writer_t writer = {.path = path,
                           .image = image,
                           .stream = {.descriptor = -1,
                                      .file = &file,
                                      .writing = image->writing,
                                      .lock = PTHREAD_MUTEX_INITIALIZER},
                           .lock = PTHREAD_MUTEX_INITIALIZER,
                           .turn = PTHREAD_COND_INITIALIZER};
    result_t result = writer_run(&writer);
    if (writer.context != NULL) exr_finish(&writer.context);
    /* A write that failed is known to the file with its cause, the library only knows that it did. */
    if (result.code == RESULT_OK || file.error != 0) return atomic_file_commit(&file);
    atomic_file_abort(&file);
    return given_up(path, image->writing, result);
}
