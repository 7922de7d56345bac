/* nanovdb_file: a grid's bytes out of a NanoVDB file (.nvdb), unpacked where they are packed by ZIP or Blosc.
 *
 * A file is a row of segments: a header of 16 bytes, for each grid a record of 176 bytes and its name, then
 * the bytes of the grids (nanovdb/util/IO.h). Sizes are checked before anything is read or made room for. */
#ifndef LIGHTMILL_NANOVDB_FILE_H
#define LIGHTMILL_NANOVDB_FILE_H

#include "common/base.h"

/* A grid in memory. `data` is of the file's bytes, or owned. */
typedef struct {
    const uint8_t *data; /* NULL: the file has no such grid */
    uint64_t size;
    uint32_t type, class; /* as NanoVDB numbers them */
    uint8_t *unpacked;    /* owned, or NULL */
    bool mapped;          /* `unpacked` is a temporary file's */
} nanovdb_bytes_t;

/* Finds the first grid of this name in the bytes of the file `path`, which must outlive it. RESULT_INPUT when
 * the file is no NanoVDB file of a known version, is truncated or damaged, or says that a grid becomes more
 * than its bytes can hold; RESULT_IO, RESULT_LIMIT when there is no room for it. On failure there is nothing
 * to free. */
result_t nanovdb_find(const char *path, const uint8_t *file, size_t size, const char *name,
                      nanovdb_bytes_t *grid);
void nanovdb_bytes_free(nanovdb_bytes_t *grid);

#endif
