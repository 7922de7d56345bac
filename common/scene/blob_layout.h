/* blob_layout: how a blob lies in its file, for scene_blob.c, blob_check.c and blob_builder.c alone.
 *
 * On disk: header_t, then the sections in the order of blob_section_t, each 64-byte aligned and followed by
 * at least 16 bytes of zeroes. header_t.checksum is the BLAKE2b-256 of everything behind the header, so
 * damage is told from malice only by its message: both are refused. */
#ifndef LIGHTMILL_BLOB_LAYOUT_H
#define LIGHTMILL_BLOB_LAYOUT_H

#include "common/scene/scene_blob.h"

typedef struct {
    uint64_t offset; /* bytes from the start of the blob */
    uint64_t count;  /* records */
} section_t;

typedef struct {
    char magic[8];
    uint32_t version;
    uint32_t section_count;
    uint64_t size; /* of the whole blob */
    hash_t checksum;
    section_t sections[BLOB_SECTION_COUNT];
} header_t;

static const char blob_magic[8] = "LMscene";
enum { SECTION_ALIGN = 64, SECTION_PADDING = 16 };

/* A kind of section. */
typedef struct {
    const char *name;
    uint32_t size; /* bytes of a record */
} section_type_t;
extern const section_type_t blob_section_types[BLOB_SECTION_COUNT];

/* Checks all but the header and the checksum, and makes the view, without its hash. */
result_t blob_make_view(const void *bytes, uint64_t size, scene_blob_t *blob);
/* Checks the contents of all sections, in one pass over every array. RESULT_INPUT names the record. */
result_t blob_check_contents(const scene_blob_t *blob);

/* The part of it about the tables of BSDFs: blob_check_tables.c. */
result_t blob_check_tables(const scene_blob_t *blob);

/* True when [first, first + count) lies inside [0, total). */
static inline bool range_inside(uint32_t first, uint64_t count, uint64_t total)
{
    return (uint64_t)first + count <= total;
}

/* In a function that returns a result: fails it unless the condition holds. */
#define CHECK(condition, ...)                                                                                \
    do {                                                                                                     \
        if (!(condition)) return result_fail(RESULT_INPUT, "scene blob: " __VA_ARGS__);                      \
    } while (0)

#endif
