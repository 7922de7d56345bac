/* blob_store: scene blobs on disk under the names of their hashes.
 *
 * DIR/<hash>.blob is whole and flushed: its hash was right and blob_open accepted it.
 * DIR/<hash>.part is being uploaded; an interrupted upload goes on at its length, also after a restart.
 * The store has a limit on the disk. Where it would be passed, blobs that no job needs are deleted, the least
 * recently used first.
 *
 * Thread-safe. An upload that comes from two threads at a time goes on in one of them after the other.
 */
#ifndef LIGHTMILL_BLOB_STORE_H
#define LIGHTMILL_BLOB_STORE_H

#include "common/scene/scene_blob.h"

#include <stdatomic.h>

typedef struct blob_store blob_store_t;

typedef struct {
    const char *directory; /* copied; made when it is missing */
    uint64_t limit;        /* bytes of all blobs and uploads */
    bool fleeting;         /* the directory goes with the process: nothing is flushed */
} blob_store_options_t;

/* Opens the store and looks at what is there. */
result_t blob_store_open(const blob_store_options_t *options, blob_store_t **store);
/* Frees the store and sets *store to NULL; the files stay. */
void blob_store_close(blob_store_t **store);

/* True when the blob is there, with its size in bytes. */
bool blob_store_find(const blob_store_t *store, const hash_t *hash, uint64_t *size);
/* True when a part of the blob is there, that was sent and is not complete, with its length in bytes. */
bool blob_store_find_part(const blob_store_t *store, const hash_t *hash, uint64_t *length);
/* The view of blob_peek_file of a blob that is there, to be closed by the caller. RESULT_INPUT when it is
 * not. */
result_t blob_store_peek(const blob_store_t *store, const hash_t *hash, scene_blob_t *blob);
/* Reads a whole blob and checks it, until *stop is set. That may take long. False when the blob is not there,
 * or is damaged: then it is deleted, so that it can be sent again. A blob that the disk cannot read stays. */
bool blob_store_check(blob_store_t *store, const hash_t *hash, const atomic_bool *stop);
/* The job needs the blob, or no longer does. */
void blob_store_need(blob_store_t *store, const hash_t *hash, uint64_t job, bool needed);
/* How many blobs there are, and what they take. */
size_t blob_store_count(blob_store_t *store, uint64_t *bytes);

/* Sets what is called when the disk is full and no blob can be deleted: it makes room, and returns true when
 * that many bytes are free. */
void blob_store_on_full(blob_store_t *store, bool (*make_room)(void *context, uint64_t bytes), void *context);

/* Takes `length` bytes of a blob of `size` bytes at `offset`. *next is the offset from which to go on: size
 * when the blob is complete and right. Bytes that do not begin where the file ends are not taken.
 * RESULT_INPUT when the blob is complete but wrong; it is deleted then. RESULT_LIMIT when there is no room
 * under the limit, RESULT_IO when the disk refuses: what is there stays, and the upload can go on later. */
result_t blob_store_put(blob_store_t *store, const hash_t *hash, uint64_t offset, uint64_t size,
                        const void *bytes, size_t length, uint64_t *next);

/* The view of a blob, checked, to be closed by the caller; reads all of it. RESULT_INPUT when it is not
 * there, or is damaged. */
result_t blob_store_map(const blob_store_t *store, const hash_t *hash, scene_blob_t *blob);
/* Reads up to `length` bytes at `offset`, which lies within the blob; *length says how many there were. */
result_t blob_store_get(const blob_store_t *store, const hash_t *hash, uint64_t offset, void *bytes,
                        size_t *length);

#endif
