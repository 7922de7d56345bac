/* blob_builder: see blob_builder.h. */
#include "common/scene/blob_builder.h"

#include "common/scene/blob_layout.h"

#include <stdlib.h>
#include <string.h>

struct blob_builder {
    struct {
        uint8_t *bytes;
        uint64_t count, capacity; /* records */
    } sections[BLOB_SECTION_COUNT];
    bool full; /* a section would have passed 2^32 - 2 records */
};

blob_builder_t *blob_builder_new(void)
{
    blob_builder_t *builder = mem_zalloc(1, sizeof *builder);
    blob_builder_add(builder, BLOB_SECTION_STRINGS, "", 1);
    return builder;
}

void blob_builder_destroy(blob_builder_t **builder)
{
    if (*builder == NULL) return;
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) free((*builder)->sections[i].bytes);
    free(*builder);
    *builder = NULL;
}

uint32_t blob_builder_add(blob_builder_t *builder, blob_section_t section, const void *records,
                          uint32_t count)
{
    uint64_t size = blob_section_types[section].size, first = builder->sections[section].count;
    if (first + count >= BLOB_NONE) {
        builder->full = true;
        return 0;
    }
    if (first + count > builder->sections[section].capacity) {
        uint64_t capacity = 2 * first + count;
        builder->sections[section].bytes = mem_realloc(builder->sections[section].bytes, capacity * size);
        builder->sections[section].capacity = capacity;
    }
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
    return *text == 0 ? 0 : blob_builder_add(builder, BLOB_SECTION_STRINGS, text, (uint32_t)strlen(text) + 1);
}

void blob_builder_take(blob_builder_t *builder, const scene_blob_t *blob)
{
    const header_t *header = (const header_t *)(const void *)blob->bytes;
    builder->sections[BLOB_SECTION_STRINGS].count = 0; /* the blob has its own empty string */
    for (int i = 0; i < BLOB_SECTION_COUNT; i++)
        blob_builder_add(builder, (blob_section_t)i, blob->bytes + header->sections[i].offset,
                         (uint32_t)blob->counts[i]);
}

static uint64_t align_up(uint64_t offset)
{
    return (offset + SECTION_ALIGN - 1) / SECTION_ALIGN * SECTION_ALIGN;
}

/* Copies a section to its place in the blob and frees it, so that no large scene is in memory twice. */
static void move_section(blob_builder_t *builder, blob_section_t section, uint8_t *blob,
                         const header_t *header)
{
    const section_t *to = &header->sections[section];
    if (to->count > 0)
        memcpy(blob + to->offset, builder->sections[section].bytes,
               to->count * blob_section_types[section].size);
    free(builder->sections[section].bytes);
    builder->sections[section].bytes = NULL;
    builder->sections[section].count = builder->sections[section].capacity = 0;
}

result_t blob_builder_finish(blob_builder_t *builder, uint8_t **bytes, uint64_t *size)
{
    *bytes = NULL;
    *size = 0;
    if (builder->full)
        return result_fail(RESULT_LIMIT, "the scene has more than %u records of one kind", BLOB_NONE - 1);
    header_t header = {.version = BLOB_VERSION, .section_count = BLOB_SECTION_COUNT};
    memcpy(header.magic, blob_magic, sizeof header.magic);
    uint64_t end = align_up(sizeof header);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) {
        header.sections[i] = (section_t){.offset = end, .count = builder->sections[i].count};
        end = align_up(end + builder->sections[i].count * blob_section_types[i].size + SECTION_PADDING);
    }
    header.size = end;
    if (end > BLOB_MAX_BYTES)
        return result_fail(RESULT_LIMIT, "the scene takes %llu bytes, over the limit of %llu",
                           (unsigned long long)end, (unsigned long long)BLOB_MAX_BYTES);
    uint8_t *blob = mem_zalloc(1, end);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) move_section(builder, (blob_section_t)i, blob, &header);
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
