/* blob_cache: see blob_cache.h.
 *
 * DESIGN. A blob is the file HASH.blob; while it is coming in, it is HASH.part. The part is locked (flock) by
 * the process that writes it, so a crash releases the lock and leaves bytes that the next one goes on from.
 * A process that is stopped keeps its lock: when a part that somebody has does not grow for long, the others
 * stop waiting and fetch the blob into parts of their own, HASH.TOKEN.part. Whoever is done first gives it
 * the name, and whoever is done later does it again, with the same bytes. The rename from part to blob is
 * atomic and happens only after the whole file has been mapped, checked and hashed: a name that ends in .blob
 * can be trusted as far as the disk can, and is hashed once more whenever it is opened.
 *
 * The time of last use is the file's mtime, touched at each opening; least recently used goes first when room
 * is needed. Removing a file that another worker has mapped is harmless: its pages live until they are
 * unmapped. A blob larger than the whole limit is still fetched, since the job needs it; it is then alone in
 * the cache.
 *
 * When a part cannot be made or written, the download goes on in memory (memfd), with what has come so far,
 * and its mapping is all that remains of it: the next process, or the next job of the scene, fetches it
 * again.
 */
#include "proto/uplink/blob_cache.h"

#include "common/file_io.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

/* A process that fetches a blob gets a chunk, or lets its part go, much sooner; but when all is there, it
 * reads it once more before the lock is gone. */
static const double STALL_SECONDS = 30, HASHED_BYTES_PER_SECOND = 5e7;

enum { TOKEN_DIGITS = 8 };

struct blob_cache {
    char *dir;
    uint64_t limit;               /* bytes */
    char token[TOKEN_DIGITS + 1]; /* in the names of its own parts */
    uint64_t memory;              /* bytes that a scene may take in memory */
    bool told; /* it was logged that the disk takes no scenes, and it has taken none since */

    /* The part that another process had when it was looked at last. */
    hash_t watched;
    off_t watched_size;           /* bytes */
    struct timespec watched_time; /* when it was last written, or taken by somebody */
    double since;                 /* clock, when it was first seen so */
};

typedef struct {
    char *path;
    uint64_t size;
    struct timespec used;
} entry_t;

typedef struct {
    entry_t *entries;
    size_t count, capacity;
    uint64_t total; /* bytes */
} listing_t;

char *blob_cache_default_dir(void)
{
    const char *cache = getenv("XDG_CACHE_HOME");
    if (cache && cache[0] == '/') return mem_printf("%s/lightmill", cache);
    const char *home = getenv("HOME");
    if (home && home[0] == '/') return mem_printf("%s/.cache/lightmill", home);
    return mem_printf("/var/tmp/lightmill-%u", (unsigned)getuid());
}

result_t blob_cache_new(const char *dir, uint64_t limit, blob_cache_t **cache)
{
    result_t result = directory_make(dir, 0777);
    if (result.code == RESULT_OK && access(dir, W_OK | X_OK) != 0)
        result = result_fail(RESULT_IO, "cannot write to the directory %.300s: %s", dir, strerror(errno));
    if (result.code != RESULT_OK)
        return result_fail(RESULT_IO, "the cache: %.400s; choose another with --cache (a relay: --data)",
                           result.message);
    *cache = mem_zalloc(1, sizeof **cache);
    (*cache)->dir = mem_strdup(dir);
    (*cache)->limit = limit;
    snprintf((*cache)->token, sizeof(*cache)->token, "%08x", randombytes_random());
    return result_ok();
}

void blob_cache_allow_memory(blob_cache_t *cache, uint64_t bytes)
{
    cache->memory = bytes;
}

void blob_cache_destroy(blob_cache_t **cache)
{
    if (*cache == NULL) return;
    free((*cache)->dir);
    free(*cache);
    *cache = NULL;
}

static char *entry_path(const blob_cache_t *cache, const hash_t *hash, const char *suffix)
{
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(hash, hex);
    return mem_printf("%s/%s%s", cache->dir, hex, suffix);
}

/* The name of the part that nobody else writes. */
static char *own_part_path(const blob_cache_t *cache, const hash_t *hash)
{
    char suffix[32];
    snprintf(suffix, sizeof suffix, ".%s.part", cache->token);
    return entry_path(cache, hash, suffix);
}

/* Another process was faster. */
static void discard_own_part(const blob_cache_t *cache, const hash_t *hash)
{
    char *path = own_part_path(cache, hash);
    unlink(path);
    free(path);
}

/* Maps and checks a file. *right is false when it is no blob or has another hash. */
static void open_checked(const char *path, const hash_t *hash, scene_blob_t *blob, bool *right, result_t *why)
{
    *why = blob_open_file(path, blob);
    if (why->code == RESULT_OK && !hash_equal(&blob->hash, hash)) {
        blob_close(blob);
        *why = result_fail(RESULT_INPUT, "%s does not have the hash that it should have", path);
    }
    *right = why->code == RESULT_OK;
}

result_t blob_cache_open(blob_cache_t *cache, const hash_t *hash, scene_blob_t *blob, bool *found)
{
    char *path = entry_path(cache, hash, ".blob");
    result_t why = result_ok();
    *found = access(path, F_OK) == 0;
    if (*found) {
        open_checked(path, hash, blob, found, &why);
        if (*found) {
            utimensat(AT_FDCWD, path, NULL, 0);
            discard_own_part(cache, hash);
        } else if (why.code == RESULT_INPUT) {
            log_warning("%s; fetching it again", why.message);
            unlink(path);
            why = result_ok();
        }
    }
    free(path);
    return why;
}

/* ---- room --------------------------------------------------------------------------------------------- */

static bool is_cache_name(const char *name)
{
    size_t length = strlen(name);
    if (length < 2 * HASH_BYTES + 5) return false;
    const char *rest = name + 2 * HASH_BYTES;
    if (length == 2 * HASH_BYTES + 5) return strcmp(rest, ".blob") == 0 || strcmp(rest, ".part") == 0;
    return length == 2 * HASH_BYTES + 1 + TOKEN_DIGITS + 5 && rest[0] == '.' &&
           strcmp(rest + 1 + TOKEN_DIGITS, ".part") == 0;
}

static void listing_add(listing_t *listing, const char *dir, const char *name)
{
    char *path = mem_printf("%s/%s", dir, name);
    struct stat status;
    if (stat(path, &status) != 0 || !S_ISREG(status.st_mode)) {
        free(path);
        return;
    }
    if (listing->count == listing->capacity) {
        listing->capacity = listing->capacity ? 2 * listing->capacity : 16;
        listing->entries = mem_realloc(listing->entries, listing->capacity * sizeof *listing->entries);
    }
    listing->entries[listing->count++] =
        (entry_t){.path = path, .size = (uint64_t)status.st_size, .used = status.st_mtim};
    listing->total += (uint64_t)status.st_size;
}

static listing_t listing_read(const char *dir)
{
    listing_t listing = {0};
    DIR *stream = opendir(dir);
    if (stream == NULL) return listing;
    for (struct dirent *entry = readdir(stream); entry; entry = readdir(stream))
        if (is_cache_name(entry->d_name)) listing_add(&listing, dir, entry->d_name);
    closedir(stream);
    return listing;
}

static void listing_free(listing_t *listing)
{
    for (size_t i = 0; i < listing->count; i++) free(listing->entries[i].path);
    free(listing->entries);
}

static int compare_use(const void *a, const void *b)
{
    const struct timespec *s = &((const entry_t *)a)->used, *t = &((const entry_t *)b)->used;
    if (s->tv_sec != t->tv_sec) return s->tv_sec < t->tv_sec ? -1 : 1;
    return (s->tv_nsec > t->tv_nsec) - (s->tv_nsec < t->tv_nsec);
}

/* Removes a file unless it is a part that somebody is writing. */
static bool remove_unused(const char *path)
{
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0) return errno == ENOENT;
    bool removed = flock(file, LOCK_EX | LOCK_NB) == 0 && unlink(path) == 0;
    close(file);
    return removed;
}

/* Removes the least recently used files until `size` more bytes fit; `keep` stays. */
static void make_room(blob_cache_t *cache, uint64_t size, const char *keep)
{
    listing_t listing = listing_read(cache->dir);
    if (listing.count > 0) qsort(listing.entries, listing.count, sizeof *listing.entries, compare_use);
    for (size_t i = 0; i < listing.count && listing.total + size > cache->limit; i++) {
        const entry_t *entry = &listing.entries[i];
        if (strcmp(entry->path, keep) == 0 || !remove_unused(entry->path)) continue;
        listing.total -= entry->size;
        log_info("cache: removed %s (%.1f MB) to make room", entry->path, 1e-6 * (double)entry->size);
    }
    listing_free(&listing);
}

/* ---- downloads ---------------------------------------------------------------------------------------- */

/* Opens and locks a part. *mine is false when another process has it, or renamed it under our hands. */
static result_t lock_part(const char *path, const char *whole_path, int *file, bool *mine)
{
    *mine = false;
    *file = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (*file < 0) return result_fail(RESULT_IO, "cannot create %s: %s", path, strerror(errno));
    struct stat opened, named;
    if (flock(*file, LOCK_EX | LOCK_NB) == 0 && fstat(*file, &opened) == 0 && stat(path, &named) == 0)
        *mine = opened.st_ino == named.st_ino && opened.st_dev == named.st_dev;
    if (*mine && access(whole_path, F_OK) == 0) {
        unlink(path);
        *mine = false;
    }
    if (*mine)
        futimens(*file, NULL); /* others see that somebody else has it now */
    else
        close(*file);
    return result_ok();
}

/* True when one process has had a part for long and has not written a byte. */
static bool stands_still(blob_cache_t *cache, double now, const hash_t *hash, uint64_t size, const char *path)
{
    struct stat status = {.st_size = -1};
    (void)stat(path, &status);
    bool same = hash_equal(&cache->watched, hash) && cache->watched_size == status.st_size &&
                cache->watched_time.tv_sec == status.st_mtim.tv_sec &&
                cache->watched_time.tv_nsec == status.st_mtim.tv_nsec;
    if (!same) {
        cache->watched = *hash;
        cache->watched_size = status.st_size;
        cache->watched_time = status.st_mtim;
        cache->since = now;
    }
    return now - cache->since > STALL_SECONDS + (double)size / HASHED_BYTES_PER_SECOND;
}

/* Opens and locks the part that all share, or the own one where that is begun or not worth waiting for; *path
 * is its name, the caller's. */
static result_t lock_either_part(blob_cache_t *cache, double now, const hash_t *hash, uint64_t size,
                                 char **path, int *file, bool *mine)
{
    char *shared = entry_path(cache, hash, ".part"), *own = own_part_path(cache, hash);
    char *whole_path = entry_path(cache, hash, ".blob");
    bool alone = access(own, F_OK) == 0;
    result_t result = lock_part(alone ? own : shared, whole_path, file, mine);
    if (result.code == RESULT_OK && !*mine && !alone && stands_still(cache, now, hash, size, shared)) {
        log_warning("another process has %s and does not go on; fetching the scene without it", shared);
        alone = true;
        result = lock_part(own, whole_path, file, mine);
    }
    if (*mine) cache->watched = (hash_t){0};
    *path = alone ? own : shared;
    free(alone ? shared : own);
    free(whole_path);
    return result;
}

/* Copies what has come so far. */
static bool copy_part(const blob_download_t *download, int to)
{
    uint8_t bytes[1 << 16];
    for (uint64_t at = 0; at < download->have;) {
        size_t left = download->have - at < sizeof bytes ? (size_t)(download->have - at) : sizeof bytes;
        ssize_t size = pread(download->file, bytes, left, (off_t)at);
        if (size <= 0 || pwrite(to, bytes, (size_t)size, (off_t)at) != size) return false;
        at += (uint64_t)size;
    }
    return true;
}

/* Goes on in memory, since `why` stands against the disk: that is the result if memory cannot help. */
static result_t move_to_memory(blob_download_t *download, result_t why)
{
    blob_cache_t *cache = download->cache;
    if (download->size > cache->memory)
        return result_fail(RESULT_IO, "%.350s; and the scene of %.1f MB does not fit into memory instead",
                           why.message, 1e-6 * (double)download->size);
    int memory = memfd_create("scene", MFD_CLOEXEC);
    if (memory < 0 || !copy_part(download, memory)) {
        if (memory >= 0) close(memory);
        return why;
    }
    if (!cache->told) log_warning("%s: scenes are kept in memory until that works again", why.message);
    cache->told = true;
    if (download->file >= 0) {
        unlink(download->part_path);
        close(download->file);
    }
    free(download->part_path);
    download->part_path = NULL;
    download->file = memory;
    return result_ok();
}

result_t blob_cache_download(blob_cache_t *cache, double now, const hash_t *hash, uint64_t size,
                             blob_download_t *download, bool *busy)
{
    *download = (blob_download_t){.cache = cache, .file = -1, .size = size, .hash = *hash};
    char *path;
    bool mine;
    result_t result = lock_either_part(cache, now, hash, size, &path, &download->file, &mine);
    *busy = result.code == RESULT_OK && !mine;
    if (result.code != RESULT_OK || !mine) {
        download->file = -1;
        free(path);
        return result.code == RESULT_IO ? move_to_memory(download, result) : result;
    }
    download->part_path = path;
    off_t have = lseek(download->file, 0, SEEK_END);
    if (have < 0 || (uint64_t)have > size) {
        if (ftruncate(download->file, 0) != 0) log_debug("cannot truncate %s: %s", path, strerror(errno));
        have = lseek(download->file, 0, SEEK_SET);
    }
    download->have = (uint64_t)have;
    make_room(cache, size - download->have, path);
    return result_ok();
}

static result_t write_bytes(const blob_download_t *download, const uint8_t *bytes, size_t size)
{
    for (size_t done = 0; done < size;) {
        ssize_t written = pwrite(download->file, bytes + done, size - done, (off_t)(download->have + done));
        if (written < 0 && errno == EINTR) continue;
        if (written < 0)
            return result_fail(RESULT_IO, "cannot write %s: %s",
                               download->part_path != NULL ? download->part_path : "a scene into memory",
                               strerror(errno));
        done += (size_t)written;
    }
    return result_ok();
}

result_t blob_download_append(blob_download_t *download, const void *data, size_t size)
{
    if (size > download->size - download->have)
        return result_fail(RESULT_PROTOCOL, "the master sent more bytes of a blob than the blob has");
    result_t result = write_bytes(download, data, size);
    if (result.code != RESULT_OK && download->part_path != NULL) {
        TRY(move_to_memory(download, result));
        result = write_bytes(download, data, size);
    }
    TRY(result);
    download->have += size;
    return result_ok();
}

/* Maps and checks what is in memory. */
static result_t finish_in_memory(const blob_download_t *download, scene_blob_t *blob)
{
    TRY(blob_open_descriptor(download->file, "the scene in memory", blob));
    if (hash_equal(&blob->hash, &download->hash)) return result_ok();
    blob_close(blob);
    return result_fail(RESULT_INPUT, "the scene in memory does not have the hash that it should have");
}

/* The same for what is on the disk, which gets its name. Without one it can be used all the same. */
static result_t finish_on_disk(blob_cache_t *cache, const blob_download_t *download, scene_blob_t *blob)
{
    bool right;
    result_t result;
    open_checked(download->part_path, &download->hash, blob, &right, &result);
    if (right) {
        char *path = entry_path(cache, &download->hash, ".blob");
        cache->told = rename(download->part_path, path) != 0;
        if (cache->told) log_warning("cannot rename %s: %s", download->part_path, strerror(errno));
        free(path);
    } else if (result.code == RESULT_INPUT) {
        unlink(download->part_path);
    }
    return result;
}

result_t blob_download_finish(blob_cache_t *cache, blob_download_t *download, scene_blob_t *blob)
{
    result_t result = download->part_path != NULL ? finish_on_disk(cache, download, blob)
                                                  : finish_in_memory(download, blob);
    blob_download_close(download);
    return result;
}

result_t blob_download_in_memory(const hash_t *hash, uint64_t size, blob_download_t *download)
{
    *download = (blob_download_t){.file = memfd_create("blob", MFD_CLOEXEC), .size = size, .hash = *hash};
    if (download->file >= 0) return result_ok();
    return result_fail(RESULT_LIMIT, "no memory for a blob of %llu bytes: %s", (unsigned long long)size,
                       strerror(errno));
}

result_t blob_download_bytes(const blob_download_t *download, uint8_t **bytes)
{
    *bytes = mem_alloc(download->size);
    bool good = file_read_all(download->file, *bytes, download->size, 0);
    hash_t hash = hash_bytes(*bytes, download->size);
    if (good && hash_equal(&hash, &download->hash)) return result_ok();
    free(*bytes);
    *bytes = NULL;
    return result_fail(RESULT_INPUT,
                       "the master sent a blob that does not have the hash that it should have");
}

void blob_download_close(blob_download_t *download)
{
    if (download->file >= 0) close(download->file);
    free(download->part_path);
    download->file = -1;
    download->part_path = NULL;
}
