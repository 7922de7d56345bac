/* blob_store: scene blobs on disk under the names of their hashes.
 *
 * DIR/<hash>.blob is whole and checked: its hash is right and blob_open accepts it. DIR/<hash>.part is on its
 * way; its length is where an interrupted upload goes on, also after a restart. The store has no memory of
 * its own beyond its path, so its functions may be called from any thread; uploads come from one thread only.
 */
#ifndef LIGHTMILL_BLOB_STORE_H
#define LIGHTMILL_BLOB_STORE_H

#include "common/base.h"

typedef struct blob_store blob_store_t;

/* Opens the store, making the directory when it is missing. */
result_t blob_store_open(const char *directory, blob_store_t **store);
/* Frees the store and sets *store to NULL; the files stay. */
void blob_store_close(blob_store_t **store);

/* True when the blob is there, with its size in bytes. */
bool blob_store_find(const blob_store_t *store, const hash_t *hash, uint64_t *size);

/* Takes `length` bytes of a blob of `size` bytes at `offset`. *next is the offset from which to go on: size
 * when the blob is complete and right. Bytes that do not begin where the file ends are not taken.
 * RESULT_INPUT when the blob is complete but wrong; it is deleted then. */
result_t blob_store_put(blob_store_t *store, const hash_t *hash, uint64_t offset, uint64_t size,
                        const void *bytes, size_t length, uint64_t *next);

/* Reads up to `length` bytes at `offset`, which lies within the blob; *length says how many there were. */
result_t blob_store_get(const blob_store_t *store, const hash_t *hash, uint64_t offset, void *bytes,
                        size_t *length);

#endif
