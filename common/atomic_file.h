/* atomic_file: a file that appears whole or not at all.
 *
 * The bytes go to a temporary beside the target. Commit flushes it to the disk and renames it over the
 * target; until then an old file of that name stays as it was, whatever happens: a full disk, a signal, a
 * power cut.
 */
#ifndef LIGHTMILL_ATOMIC_FILE_H
#define LIGHTMILL_ATOMIC_FILE_H

#include "common/base.h"

typedef struct {
    char *path;      /* the target */
    char *temporary; /* in the target's directory; NULL when nothing is open */
    int descriptor;
    int error;     /* errno of the first write that failed, 0 for none */
    bool fleeting; /* set after opening: commit does not flush */
} atomic_file_t;

/* Opens the temporary. RESULT_IO names the path and the cause; `file` then needs no abort. */
result_t atomic_file_open(atomic_file_t *file, const char *path);
/* Writes all of `size` bytes at a byte offset; false on failure, which commit reports. */
bool atomic_file_write_at(atomic_file_t *file, const void *data, size_t size, uint64_t offset);
/* Flushes, renames and closes, or, when anything failed, removes the temporary and returns RESULT_IO. */
result_t atomic_file_commit(atomic_file_t *file);
/* Closes and removes the temporary; harmless after a commit or a failed open. */
void atomic_file_abort(atomic_file_t *file);
/* All of the above for bytes that are at hand. */
result_t file_write_atomic(const char *path, const void *data, size_t size);
/* The same for a secret: nobody but the owner can read it, at any time (mode 0600). Its directory is made
 * where it is missing, for the owner alone. */
result_t file_write_private(const char *path, const void *data, size_t size);

#endif
