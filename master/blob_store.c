/* blob_store: see blob_store.h. */
#include "master/blob_store.h"

#include "common/scene_blob.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_PARTS = 64 }; /* uploads begun and not finished; more are refused */

struct blob_store {
    char *directory;
};

static char *blob_path(const blob_store_t *store, const hash_t *hash, const char *suffix)
{
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(hash, hex);
    return mem_printf("%s/%s.%s", store->directory, hex, suffix);
}

result_t blob_store_open(const char *directory, blob_store_t **store)
{
    if (mkdir(directory, 0777) != 0 && errno != EEXIST)
        return result_fail(RESULT_IO, "cannot make the directory %s: %s", directory, strerror(errno));
    *store = mem_zalloc(1, sizeof **store);
    (*store)->directory = mem_strdup(directory);
    return result_ok();
}

void blob_store_close(blob_store_t **store)
{
    if (*store == NULL) return;
    free((*store)->directory);
    free(*store);
    *store = NULL;
}

bool blob_store_find(const blob_store_t *store, const hash_t *hash, uint64_t *size)
{
    char *path = blob_path(store, hash, "blob");
    struct stat status;
    bool found = stat(path, &status) == 0 && S_ISREG(status.st_mode);
    free(path);
    if (found) *size = (uint64_t)status.st_size;
    return found;
}

/* Refuses a new upload when too many lie about unfinished. */
static result_t check_parts(const blob_store_t *store)
{
    DIR *directory = opendir(store->directory);
    if (directory == NULL)
        return result_fail(RESULT_IO, "cannot read %s: %s", store->directory, strerror(errno));
    int parts = 0;
    for (const struct dirent *entry; (entry = readdir(directory)) != NULL;) {
        const char *dot = strrchr(entry->d_name, '.');
        parts += dot != NULL && strcmp(dot, ".part") == 0;
    }
    closedir(directory);
    if (parts < MAX_PARTS) return result_ok();
    return result_fail(RESULT_LIMIT, "%d unfinished uploads are in %s: delete the .part files there", parts,
                       store->directory);
}

static result_t write_all(int descriptor, const char *path, uint64_t offset, const uint8_t *bytes,
                          size_t length)
{
    while (length > 0) {
        ssize_t written = pwrite(descriptor, bytes, length, (off_t)offset);
        if (written < 0 && errno == EINTR) continue;
        if (written <= 0) return result_fail(RESULT_IO, "cannot write %s: %s", path, strerror(errno));
        bytes += written;
        offset += (uint64_t)written;
        length -= (size_t)written;
    }
    return result_ok();
}

/* Appends what fits; *next is the length of the file afterwards. */
static result_t append(const char *path, uint64_t offset, uint64_t size, const void *bytes, size_t length,
                       uint64_t *next)
{
    int descriptor = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    struct stat status;
    if (descriptor < 0) return result_fail(RESULT_IO, "cannot open %s: %s", path, strerror(errno));
    result_t result = result_ok();
    if (fstat(descriptor, &status) != 0)
        result = result_fail(RESULT_IO, "cannot read %s: %s", path, strerror(errno));
    if (result.code == RESULT_OK) {
        *next = (uint64_t)status.st_size;
        if (*next > size) { /* somebody named another size before: begin anew */
            if (ftruncate(descriptor, 0) != 0)
                result = result_fail(RESULT_IO, "cannot truncate %s: %s", path, strerror(errno));
            *next = 0;
        }
    }
    if (result.code == RESULT_OK && offset == *next && length <= size - offset && length > 0) {
        result = write_all(descriptor, path, offset, bytes, length);
        if (result.code == RESULT_OK) *next = offset + length;
        if (result.code == RESULT_OK && *next == size && fsync(descriptor) != 0)
            result = result_fail(RESULT_IO, "cannot flush %s: %s", path, strerror(errno));
    }
    close(descriptor);
    return result;
}

/* Checks a complete upload and gives it its name. */
static result_t finish(const char *part, const char *path, const hash_t *hash)
{
    scene_blob_t blob = {0};
    result_t result = blob_open_file(part, &blob);
    if (result.code == RESULT_OK && !hash_equal(&blob.hash, hash))
        result = result_fail(RESULT_INPUT, "the blob's bytes do not have the hash that it was sent under");
    blob_close(&blob);
    if (result.code == RESULT_OK) {
        if (rename(part, path) == 0) return result;
        result = result_fail(RESULT_IO, "cannot rename %s: %s", part, strerror(errno));
    }
    unlink(part);
    return result;
}

result_t blob_store_put(blob_store_t *store, const hash_t *hash, uint64_t offset, uint64_t size,
                        const void *bytes, size_t length, uint64_t *next)
{
    uint64_t known;
    if (blob_store_find(store, hash, &known)) {
        *next = known;
        if (known == size) return result_ok();
        return result_fail(RESULT_INPUT, "that blob has %llu bytes, not %llu", (unsigned long long)known,
                           (unsigned long long)size);
    }
    if (size == 0 || size > BLOB_MAX_BYTES)
        return result_fail(RESULT_LIMIT, "a blob of %llu bytes; from 1 to %llu are allowed",
                           (unsigned long long)size, (unsigned long long)BLOB_MAX_BYTES);
    char *part = blob_path(store, hash, "part"), *path = blob_path(store, hash, "blob");
    result_t result = access(part, F_OK) == 0 ? result_ok() : check_parts(store);
    if (result.code == RESULT_OK) result = append(part, offset, size, bytes, length, next);
    if (result.code == RESULT_OK && *next == size) result = finish(part, path, hash);
    free(part);
    free(path);
    return result;
}

result_t blob_store_get(const blob_store_t *store, const hash_t *hash, uint64_t offset, void *bytes,
                        size_t *length)
{
    char *path = blob_path(store, hash, "blob");
    int descriptor = open(path, O_RDONLY | O_CLOEXEC);
    result_t result = result_ok();
    if (descriptor < 0) {
        result = result_fail(RESULT_INPUT, "this master does not have the blob");
    } else {
        ssize_t got = pread(descriptor, bytes, *length, (off_t)offset);
        if (got < 0) result = result_fail(RESULT_IO, "cannot read %s: %s", path, strerror(errno));
        *length = got < 0 ? 0 : (size_t)got;
        close(descriptor);
    }
    free(path);
    return result;
}
