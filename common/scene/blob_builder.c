/* blob_builder: see blob_builder.h. */
#include "common/scene/blob_builder.h"

#include "common/file_io.h"
#include "common/scene/blob_layout.h"
#include "common/scene/temporary_file.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

/* More than this is kept on disk, where there is room; a file grows by so much more than is asked for; and so
 * much at a time is written. */
static const uint64_t most_in_memory = 64 << 20, spare_bytes = 16 << 20, write_bytes = 8 << 20;

/* The records of a section so far: in memory, or in a temporary file that is mapped. */
typedef struct {
    uint8_t *bytes;
    uint64_t count, capacity; /* records */
    uint64_t mapped;          /* bytes of the file; 0: there is none */
    int file;
} gathered_t;

struct blob_builder {
    gathered_t sections[BLOB_SECTION_COUNT];
    bool full; /* a section would have passed 2^32 - 2 records */
};

/* ---- sections ------------------------------------------------------------------------------------------ */

static void drop(gathered_t *section)
{
    if (section->mapped > 0) {
        munmap(section->bytes, section->mapped);
        close(section->file);
    } else {
        free(section->bytes);
    }
    *section = (gathered_t){0};
}

/* Moves what is in memory to a file; false when there is no room for it. */
static bool move_to_file(gathered_t *section, uint64_t used, uint64_t size)
{
    int file;
    if (temporary_file(size, &file).code != RESULT_OK) return false;
    void *bytes = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (bytes == MAP_FAILED) {
        close(file);
        return false;
    }
    if (used > 0) memcpy(bytes, section->bytes, used);
    free(section->bytes);
    section->bytes = bytes;
    section->mapped = size;
    section->file = file;
    return true;
}

/* What is there already leaves memory: the file has it. */
static bool grow_file(gathered_t *section, uint64_t size)
{
    if (temporary_file_grow(section->file, size).code != RESULT_OK) return false;
    void *bytes = mremap(section->bytes, section->mapped, size, MREMAP_MAYMOVE);
    if (bytes == MAP_FAILED) return false;
    section->bytes = bytes;
    section->mapped = size;
    madvise(bytes, size, MADV_DONTNEED);
    return true;
}

static void move_to_memory(gathered_t *section, uint64_t used)
{
    uint8_t *bytes = mem_alloc(used);
    memcpy(bytes, section->bytes, used);
    munmap(section->bytes, section->mapped);
    close(section->file);
    section->bytes = bytes;
    section->mapped = 0;
}

/* Room for `count` records of so many bytes. */
static void make_room(gathered_t *section, uint64_t count, uint64_t record)
{
    uint64_t used = section->count * record;
    section->capacity =
        count * record > most_in_memory ? count + spare_bytes / record : section->count + count;
    uint64_t size = section->capacity * record;
    if (size > most_in_memory) {
        if (section->mapped > 0 ? grow_file(section, size) : move_to_file(section, used, size)) return;
        if (section->mapped > 0) move_to_memory(section, used);
    }
    section->bytes = mem_realloc(section->bytes, size);
}

blob_builder_t *blob_builder_new(void)
{
    blob_builder_t *builder = mem_zalloc(1, sizeof *builder);
    blob_builder_add(builder, BLOB_SECTION_STRINGS, "", 1);
    return builder;
}

void blob_builder_destroy(blob_builder_t **builder)
{
    if (*builder == NULL) return;
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) drop(&(*builder)->sections[i]);
    free(*builder);
    *builder = NULL;
}

uint32_t blob_builder_add(blob_builder_t *builder, blob_section_t section, const void *records,
                          uint64_t count)
{
    uint64_t size = blob_section_types[section].size, first = builder->sections[section].count;
    if (count >= BLOB_NONE - first) {
        builder->full = true;
        return 0;
    }
    if (first + count > builder->sections[section].capacity)
        make_room(&builder->sections[section], first + count, size);
    if (count == 0) return (uint32_t)first;
    uint8_t *to = builder->sections[section].bytes + first * size;
    if (records != NULL)
        memcpy(to, records, count * size);
    else
        memset(to, 0, count * size);
    builder->sections[section].count = first + count;
    return (uint32_t)first;
}

void *blob_builder_records(blob_builder_t *builder, blob_section_t section)
{
    return builder->sections[section].bytes;
}

uint32_t blob_builder_count(const blob_builder_t *builder, blob_section_t section)
{
    return (uint32_t)builder->sections[section].count;
}

uint32_t blob_builder_string(blob_builder_t *builder, const char *text)
{
    return *text == 0 ? 0 : blob_builder_add(builder, BLOB_SECTION_STRINGS, text, strlen(text) + 1);
}

void blob_builder_take(blob_builder_t *builder, const scene_blob_t *blob)
{
    const header_t *header = (const header_t *)(const void *)blob->bytes;
    builder->sections[BLOB_SECTION_STRINGS].count = 0; /* the blob has its own empty string */
    for (int i = 0; i < BLOB_SECTION_COUNT; i++)
        blob_builder_add(builder, (blob_section_t)i, blob->bytes + header->sections[i].offset,
                         blob->counts[i]);
}

/* ---- the blob ------------------------------------------------------------------------------------------ */

static uint64_t align_up(uint64_t offset)
{
    return (offset + SECTION_ALIGN - 1) / SECTION_ALIGN * SECTION_ALIGN;
}

/* Where everything will lie: a header without its checksum. */
static result_t lay_out(const blob_builder_t *builder, header_t *header)
{
    if (builder->full)
        return result_fail(RESULT_LIMIT, "the scene has more than %u records of one kind", BLOB_NONE - 1);
    *header = (header_t){.version = BLOB_VERSION, .section_count = BLOB_SECTION_COUNT};
    memcpy(header->magic, blob_magic, sizeof header->magic);
    uint64_t end = align_up(sizeof *header);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) {
        header->sections[i] = (section_t){.offset = end, .count = builder->sections[i].count};
        end = align_up(end + builder->sections[i].count * blob_section_types[i].size + SECTION_PADDING);
    }
    header->size = end;
    if (end > BLOB_MAX_BYTES)
        return result_fail(RESULT_LIMIT, "the scene takes %llu bytes, over the limit of %llu",
                           (unsigned long long)end, (unsigned long long)BLOB_MAX_BYTES);
    return result_ok();
}

/* Copies a section to its place in the blob, piece by piece, each of which leaves memory then when it is
 * mapped from a file; and frees it, so that no large scene is there twice. */
static bool write_section(gathered_t *section, uint64_t size, uint64_t offset, int file)
{
    bool written = lseek(file, (off_t)offset, SEEK_SET) >= 0;
    for (uint64_t at = 0; written && at < size; at += write_bytes) {
        uint64_t piece = size - at < write_bytes ? size - at : write_bytes;
        written = file_write_all(file, section->bytes + at, piece);
        if (section->mapped > 0) madvise(section->bytes + at, piece, MADV_DONTNEED);
    }
    int error = errno;
    drop(section);
    errno = error;
    return written;
}

/* Writes the header, with the checksum of what is behind it. */
static bool write_header(header_t *header, int file)
{
    uint8_t *blob = mmap(NULL, header->size, PROT_READ, MAP_SHARED, file, 0);
    if (blob == MAP_FAILED) return false;
    header->checksum = hash_bytes(blob + sizeof *header, header->size - sizeof *header);
    munmap(blob, header->size);
    return lseek(file, 0, SEEK_SET) == 0 && file_write_all(file, header, sizeof *header);
}

static bool write_blob(blob_builder_t *builder, header_t *header, int file)
{
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) {
        const section_t *to = &header->sections[i];
        if (!write_section(&builder->sections[i], to->count * blob_section_types[i].size, to->offset, file))
            return false;
    }
    return write_header(header, file);
}

/* A file of zeroes that is as large as the blob. */
static result_t open_file(uint64_t size, int *file)
{
    if (size > most_in_memory && temporary_file(size, file).code == RESULT_OK) return result_ok();
    *file = memfd_create("scene", MFD_CLOEXEC);
    if (*file >= 0 && ftruncate(*file, (off_t)size) == 0) return result_ok();
    result_t result = result_fail(RESULT_IO, "no room for a scene of %llu bytes: %s",
                                  (unsigned long long)size, strerror(errno));
    if (*file >= 0) close(*file);
    return result;
}

result_t blob_builder_write(blob_builder_t *builder, int *file)
{
    header_t header;
    *file = -1;
    TRY(lay_out(builder, &header));
    TRY(open_file(header.size, file));
    if (write_blob(builder, &header, *file)) return result_ok();
    result_t result = result_fail(RESULT_IO, "the scene cannot be written: %s", strerror(errno));
    close(*file);
    *file = -1;
    return result;
}

static void move_section(gathered_t *section, uint64_t size, uint8_t *to)
{
    if (size > 0) memcpy(to, section->bytes, size);
    drop(section);
}

result_t blob_builder_finish(blob_builder_t *builder, uint8_t **bytes, uint64_t *size)
{
    header_t header;
    *bytes = NULL;
    *size = 0;
    TRY(lay_out(builder, &header));
    uint64_t end = header.size;
    uint8_t *blob = mem_zalloc(1, end);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++)
        move_section(&builder->sections[i], header.sections[i].count * blob_section_types[i].size,
                     blob + header.sections[i].offset);
    header.checksum = hash_bytes(blob + sizeof header, end - sizeof header);
    memcpy(blob, &header, sizeof header);

    scene_blob_t view;
    result_t result = blob_make_view(blob, end, &view);
    if (result.code != RESULT_OK) {
        free(blob);
        return result;
    }
    *bytes = blob;
    *size = end;
    return result_ok();
}
