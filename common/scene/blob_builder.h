/* blob_builder: gathers a scene section by section and lays it out as a blob (see scene_blob.h).
 *
 * A section that grows large, as that of the texels does, lies in a temporary file, and so does a large blob:
 * a scene may have more images than the machine has memory. */
#ifndef LIGHTMILL_BLOB_BUILDER_H
#define LIGHTMILL_BLOB_BUILDER_H

#include "common/scene/scene_blob.h"

typedef struct blob_builder blob_builder_t;

blob_builder_t *blob_builder_new(void);
/* Frees the builder and sets *builder to NULL. */
void blob_builder_destroy(blob_builder_t **builder);
/* Appends `count` records to a section and returns the index of the first; `records` may be NULL for zeroes.
 * Records are sizeof(the section's type) each. Sections hold less than 2^32 - 1 records. */
uint32_t blob_builder_add(blob_builder_t *builder, blob_section_t section, const void *records,
                          uint64_t count);
/* The records gathered so far, valid until the next add; writable, so that references can be filled in late.
 */
void *blob_builder_records(blob_builder_t *builder, blob_section_t section);
uint32_t blob_builder_count(const blob_builder_t *builder, blob_section_t section);
/* Adds a name to the strings and returns its offset. */
uint32_t blob_builder_string(blob_builder_t *builder, const char *text);
/* Takes over all records of a blob that blob_open has let through; the builder must be new. */
void blob_builder_take(blob_builder_t *builder, const scene_blob_t *blob);
/* Lays the blob out in a file without a name, on disk when it is large, which the caller closes; nothing is
 * checked but its size: open it with blob_open_descriptor. The builder is left as by blob_builder_finish. */
result_t blob_builder_write(blob_builder_t *builder, int *file);
/* Lays the blob out in fresh memory (the caller frees *bytes), and checks it as blob_open does. The builder
 * is left without records, good only for blob_builder_destroy, unless the scene was too large. */
result_t blob_builder_finish(blob_builder_t *builder, uint8_t **bytes, uint64_t *size);

#endif
