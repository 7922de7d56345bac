/* blob_cache: scene blobs on the worker's disk, by hash, within a limit of bytes.
 *
 * Workers of one machine may share a directory: a blob is downloaded by one of them at a time, and appears
 * under its name only when it is whole and its hash is right. A download that broke off is taken up where it
 * ended, also by another process. One that stands still, since its process is stopped, is not waited for.
 *
 * What the disk does not take (it is full, broken, read-only) is kept in memory, as far as that is allowed.
 */
#ifndef LIGHTMILL_BLOB_CACHE_H
#define LIGHTMILL_BLOB_CACHE_H

#include "common/scene/scene_blob.h"

typedef struct blob_cache blob_cache_t;

/* A download in progress; it holds the lock on its file. */
typedef struct {
    blob_cache_t *cache;
    int file;      /* descriptor, -1 when closed */
    uint64_t have; /* bytes so far: the offset to go on from */
    uint64_t size; /* bytes of the whole blob */
    hash_t hash;
    char *part_path; /* owned; NULL: the file is in memory */
} blob_download_t;

/* The directory that is used when none is given: $XDG_CACHE_HOME/lightmill or ~/.cache/lightmill. The caller
 * frees the string. */
char *blob_cache_default_dir(void);

/* Opens the cache and creates its directory. RESULT_IO when that is not possible. */
result_t blob_cache_new(const char *dir, uint64_t limit, blob_cache_t **cache);
void blob_cache_destroy(blob_cache_t **cache);

/* A scene of up to so many bytes may be kept in memory when the disk does not take it; 0, the default: none.
 */
void blob_cache_allow_memory(blob_cache_t *cache, uint64_t bytes);

/* Maps a blob that is in the cache and marks it as used now; *found is false when it is not there. A file
 * whose bytes do not have the hash any more is removed and counts as not there. */
result_t blob_cache_open(blob_cache_t *cache, const hash_t *hash, scene_blob_t *blob, bool *found);

/* Makes room and begins a download, or takes up an old one. *busy is true when another process is at it, or
 * has just finished: look again a little later. `now` is the clock, in seconds. */
result_t blob_cache_download(blob_cache_t *cache, double now, const hash_t *hash, uint64_t size,
                             blob_download_t *download, bool *busy);
result_t blob_download_append(blob_download_t *download, const void *data, size_t size);
/* Checks the whole file, gives it its name, maps it, and closes the download. RESULT_INPUT when the hash is
 * wrong: then the bytes are gone, and the next download starts anew. */
result_t blob_download_finish(blob_cache_t *cache, blob_download_t *download, scene_blob_t *blob);
/* A download that goes into memory alone, of a small blob that is no scene; */
result_t blob_download_in_memory(const hash_t *hash, uint64_t size, blob_download_t *download);
/* and its bytes, in fresh memory that the caller frees. RESULT_INPUT when the hash is wrong: the next
 * download starts anew. The download stays open. */
result_t blob_download_bytes(const blob_download_t *download, uint8_t **bytes);
/* Closes a download and keeps what has come so far; harmless on a closed one. */
void blob_download_close(blob_download_t *download);

#endif
