/* blob_store: see blob_store.h.
 *
 * DESIGN. The directory is the truth: whether a blob is there, and how far an upload has come, is asked of
 * the file system. Beside it there is a list of what takes room, so that the limit costs no walk over the
 * directory, and of the jobs that need a blob. An upload counts with the size that it will have. When a blob
 * was last used is the time of its file, so that it outlives the process. */
#include "master/store/blob_store.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum {
    HASH_PIECE = 1 << 20, /* bytes */
    MAX_PARTS = 64,       /* uploads begun and not finished; more are refused */
    PART_KEEP =
        7 * 24 * 3600, /* seconds; one that nobody went on with for longer goes when a master starts */
    MAX_PUTS = 4,      /* at a time */
    PART_IDLE = 3600   /* seconds; likewise when there are too many */
};

typedef struct {
    hash_t hash;
    uint64_t bytes; /* of a part: that it will have */
    time_t used;
    bool part;
} item_t;

typedef struct {
    hash_t hash;
    uint64_t job;
} need_t;

struct blob_store {
    char *directory;
    uint64_t limit;
    bool fleeting;
    bool (*make_room)(void *context, uint64_t bytes); /* NULL: there is nobody to ask */
    void *room_context;
    pthread_mutex_t lock; /* guards what follows */
    item_t *items;
    size_t item_count;
    need_t *needs;
    size_t need_count;
    hash_t puts[MAX_PUTS]; /* what is written to by a thread at this moment */
    size_t put_count;
    pthread_cond_t put_ended;
};

static char *blob_path(const blob_store_t *store, const hash_t *hash, const char *suffix)
{
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(hash, hex);
    return mem_printf("%s/%s.%s", store->directory, hex, suffix);
}

/* ---- the list; under the lock -------------------------------------------------------------------------- */

static item_t *find_item(const blob_store_t *store, const hash_t *hash, bool part)
{
    for (size_t i = 0; i < store->item_count; i++)
        if (store->items[i].part == part && hash_equal(&store->items[i].hash, hash)) return &store->items[i];
    return NULL;
}

static item_t *make_item(blob_store_t *store, const hash_t *hash, bool part)
{
    item_t *item = find_item(store, hash, part);
    if (item != NULL) return item;
    store->items = mem_realloc(store->items, (store->item_count + 1) * sizeof *item);
    item = &store->items[store->item_count++];
    *item = (item_t){.hash = *hash, .part = part};
    return item;
}

static void forget_item(blob_store_t *store, item_t *item)
{
    if (item != NULL) *item = store->items[--store->item_count];
}

/* Deletes the file of an item and forgets it. */
static void drop_item(blob_store_t *store, item_t *item)
{
    char *path = blob_path(store, &item->hash, item->part ? "part" : "blob");
    if (unlink(path) != 0 && errno != ENOENT) log_warning("cannot delete %s: %s", path, strerror(errno));
    free(path);
    forget_item(store, item);
}

static bool is_needed(const blob_store_t *store, const hash_t *hash)
{
    for (size_t i = 0; i < store->need_count; i++)
        if (hash_equal(&store->needs[i].hash, hash)) return true;
    return false;
}

/* The blob that no job needs and that was not used for longest, or the upload that was left for longest, if
 * for longer than PART_IDLE; NULL when there is none. */
static item_t *find_oldest(const blob_store_t *store, bool part)
{
    item_t *oldest = NULL;
    time_t now = time(NULL);
    for (size_t i = 0; i < store->item_count; i++) {
        item_t *item = &store->items[i];
        if (item->part != part || (part ? now - item->used <= PART_IDLE : is_needed(store, &item->hash)))
            continue;
        if (oldest == NULL || item->used < oldest->used) oldest = item;
    }
    return oldest;
}

/* What all items take but the upload of this hash. */
static uint64_t bytes_of_others(const blob_store_t *store, const hash_t *hash)
{
    uint64_t total = 0;
    for (size_t i = 0; i < store->item_count; i++)
        if (!store->items[i].part || !hash_equal(&store->items[i].hash, hash)) total += store->items[i].bytes;
    return total;
}

/* Deletes what can go first, if anything can. */
static bool drop_oldest(blob_store_t *store)
{
    item_t *oldest = find_oldest(store, false);
    if (oldest == NULL) oldest = find_oldest(store, true);
    if (oldest == NULL) return false;
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(&oldest->hash, hex);
    log_info("the scene %.16s... (%.1f MB) goes to make room: no job needs it", hex,
             1e-6 * (double)oldest->bytes);
    drop_item(store, oldest);
    return true;
}

/* ---- opening ------------------------------------------------------------------------------------------- */

/* "<hash>.blob" or "<hash>.part". */
static bool parse_name(const char *name, hash_t *hash, bool *part)
{
    size_t length;
    const char *end;
    if (sodium_hex2bin(hash->bytes, HASH_BYTES, name, strlen(name), NULL, &length, &end) != 0) return false;
    *part = strcmp(end, ".part") == 0;
    return length == HASH_BYTES && (*part || strcmp(end, ".blob") == 0);
}

static result_t scan(blob_store_t *store)
{
    DIR *directory = opendir(store->directory);
    if (directory == NULL)
        return result_fail(RESULT_IO, "cannot read %s: %s", store->directory, strerror(errno));
    time_t now = time(NULL);
    for (const struct dirent *entry; (entry = readdir(directory)) != NULL;) {
        hash_t hash;
        bool part;
        struct stat status;
        if (!parse_name(entry->d_name, &hash, &part)) continue;
        if (fstatat(dirfd(directory), entry->d_name, &status, 0) != 0 || !S_ISREG(status.st_mode)) continue;
        item_t *item = make_item(store, &hash, part);
        item->bytes = (uint64_t)status.st_size;
        item->used = status.st_mtime;
        if (part && now - item->used > PART_KEEP) drop_item(store, item);
    }
    closedir(directory);
    return result_ok();
}

result_t blob_store_open(const blob_store_options_t *options, blob_store_t **out)
{
    TRY(directory_make(options->directory, 0700));
    blob_store_t *store = mem_zalloc(1, sizeof *store);
    store->directory = mem_strdup(options->directory);
    store->limit = options->limit;
    store->fleeting = options->fleeting;
    pthread_mutex_init(&store->lock, NULL);
    pthread_cond_init(&store->put_ended, NULL);
    result_t result = scan(store);
    if (result.code != RESULT_OK) blob_store_close(&store);
    *out = store;
    return result;
}

void blob_store_close(blob_store_t **store)
{
    if (*store == NULL) return;
    pthread_cond_destroy(&(*store)->put_ended);
    pthread_mutex_destroy(&(*store)->lock);
    free((*store)->items);
    free((*store)->needs);
    free((*store)->directory);
    free(*store);
    *store = NULL;
}

/* ---- what jobs ask ------------------------------------------------------------------------------------- */

/* True when there is a file of the hash with this suffix, with its size in bytes. */
static bool find_file(const blob_store_t *store, const hash_t *hash, const char *suffix, uint64_t *size)
{
    char *path = blob_path(store, hash, suffix);
    struct stat status;
    bool found = stat(path, &status) == 0 && S_ISREG(status.st_mode);
    free(path);
    if (found) *size = (uint64_t)status.st_size;
    return found;
}

bool blob_store_find(const blob_store_t *store, const hash_t *hash, uint64_t *size)
{
    return find_file(store, hash, "blob", size);
}

bool blob_store_find_part(const blob_store_t *store, const hash_t *hash, uint64_t *length)
{
    return find_file(store, hash, "part", length);
}

/* The view that `open_file` makes of a blob. */
static result_t view(const blob_store_t *store, const hash_t *hash,
                     result_t (*open_file)(const char *, scene_blob_t *), scene_blob_t *blob)
{
    char *path = blob_path(store, hash, "blob");
    uint64_t size;
    result_t result = blob_store_find(store, hash, &size)
                          ? open_file(path, blob)
                          : result_fail(RESULT_INPUT, "this master does not have the scene: send it first");
    free(path);
    return result;
}

result_t blob_store_peek(const blob_store_t *store, const hash_t *hash, scene_blob_t *blob)
{
    return view(store, hash, blob_peek_file, blob);
}

result_t blob_store_map(const blob_store_t *store, const hash_t *hash, scene_blob_t *blob)
{
    return view(store, hash, blob_open_file, blob);
}

/* The hash of a file's bytes. False when it cannot be told: the disk does not give them, or *stop was set. */
static bool hash_file(const char *path, const atomic_bool *stop, hash_t *hash)
{
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0) return false;
    uint8_t *bytes = mem_alloc(HASH_PIECE);
    crypto_generichash_state state;
    ssize_t got;
    crypto_generichash_init(&state, NULL, 0, HASH_BYTES);
    do {
        got = read(file, bytes, HASH_PIECE);
        if (got > 0) crypto_generichash_update(&state, bytes, (size_t)got);
    } while ((got > 0 || (got < 0 && errno == EINTR)) && !atomic_load(stop));
    crypto_generichash_final(&state, hash->bytes, HASH_BYTES);
    free(bytes);
    close(file);
    return got == 0;
}

bool blob_store_check(blob_store_t *store, const hash_t *hash, const atomic_bool *stop)
{
    char *path = blob_path(store, hash, "blob");
    hash_t found;
    bool there = access(path, F_OK) == 0, good = true;
    if (there && hash_file(path, stop, &found)) good = hash_equal(&found, hash);
    if (!good) {
        log_error(
            "A SCENE IS DAMAGED and has to be sent again: the bytes of %s are not those that it is named for",
            path);
        pthread_mutex_lock(&store->lock);
        unlink(path);
        forget_item(store, find_item(store, hash, false));
        pthread_mutex_unlock(&store->lock);
    }
    free(path);
    return there && good;
}

/* Notes that the blob is used now, for this process and the next. */
static void touch(blob_store_t *store, const hash_t *hash)
{
    item_t *item = find_item(store, hash, false);
    if (item == NULL) return;
    item->used = time(NULL);
    char *path = blob_path(store, hash, "blob");
    if (utimensat(AT_FDCWD, path, NULL, 0) != 0) log_debug("cannot touch %s: %s", path, strerror(errno));
    free(path);
}

void blob_store_need(blob_store_t *store, const hash_t *hash, uint64_t job, bool needed)
{
    pthread_mutex_lock(&store->lock);
    size_t at = 0;
    while (at < store->need_count && store->needs[at].job != job) at++;
    bool known = at < store->need_count;
    if (needed && !known) {
        store->needs = mem_realloc(store->needs, (store->need_count + 1) * sizeof *store->needs);
        store->needs[store->need_count++] = (need_t){*hash, job};
        touch(store, hash);
    } else if (!needed && known) {
        touch(store, &store->needs[at].hash);
        store->needs[at] = store->needs[--store->need_count];
    }
    pthread_mutex_unlock(&store->lock);
}

size_t blob_store_count(blob_store_t *store, uint64_t *bytes)
{
    size_t count = 0;
    *bytes = 0;
    pthread_mutex_lock(&store->lock);
    for (size_t i = 0; i < store->item_count; i++) {
        if (store->items[i].part) continue;
        count++;
        *bytes += store->items[i].bytes;
    }
    pthread_mutex_unlock(&store->lock);
    return count;
}

void blob_store_on_full(blob_store_t *store, bool (*make_room)(void *context, uint64_t bytes), void *context)
{
    store->make_room = make_room;
    store->room_context = context;
}

/* ---- uploads ------------------------------------------------------------------------------------------- */

/* Under the lock: room for one more upload among those that lie about unfinished. */
static result_t check_parts(blob_store_t *store)
{
    int parts = 0;
    for (size_t i = 0; i < store->item_count; i++) parts += store->items[i].part;
    if (parts < MAX_PARTS) return result_ok();
    item_t *oldest = find_oldest(store, true);
    if (oldest == NULL)
        return result_fail(RESULT_LIMIT, "%d uploads are unfinished already: try again later", parts);
    drop_item(store, oldest);
    return result_ok();
}

/* Under the lock: room for a blob under the limit. */
static result_t check_room(blob_store_t *store, const hash_t *hash, uint64_t size)
{
    const double gb = 1e-9;
    if (size > store->limit)
        return result_fail(RESULT_LIMIT, "the scene has %.3g GB, this master keeps at most %.3g GB of scenes",
                           gb * (double)size, gb * (double)store->limit);
    while (bytes_of_others(store, hash) > store->limit - size)
        if (!drop_oldest(store))
            return result_fail(RESULT_LIMIT,
                               "no room for a scene of %.3g GB: jobs and uploads need %.3g GB of scenes and "
                               "this master keeps at most %.3g GB; wait for jobs to end, or start it with a "
                               "larger --blob-limit",
                               gb * (double)size, gb * (double)bytes_of_others(store, hash),
                               gb * (double)store->limit);
    return result_ok();
}

/* Makes an upload known, if there is room for it. */
static result_t admit_upload(blob_store_t *store, const hash_t *hash, uint64_t size)
{
    pthread_mutex_lock(&store->lock);
    item_t *item = find_item(store, hash, true);
    result_t result = item == NULL ? check_parts(store) : result_ok();
    if (result.code == RESULT_OK && (item == NULL || item->bytes < size))
        result = check_room(store, hash, size);
    if (result.code == RESULT_OK) {
        item = make_item(store, hash, true);
        item->bytes = size;
        item->used = time(NULL);
    }
    pthread_mutex_unlock(&store->lock);
    return result;
}

/* The disk refused. What is there stays. */
static result_t disk_failure(const char *path, int error, uint64_t have, uint64_t size)
{
    if (error == ENOSPC || error == EDQUOT)
        return result_fail(
            RESULT_IO,
            "the master's disk is full; %llu of the scene's %llu bytes are there: when there is room, "
            "send it again and it goes on from there",
            (unsigned long long)have, (unsigned long long)size);
    return result_fail(RESULT_IO, "the master cannot write %s: %s", path, strerror(error));
}

/* The disk is full: true when something was done about it. *asked is set when that was the last means. */
static bool find_room(blob_store_t *store, size_t length, bool *asked)
{
    pthread_mutex_lock(&store->lock);
    bool room = drop_oldest(store);
    pthread_mutex_unlock(&store->lock);
    if (room || *asked || store->make_room == NULL) return room;
    *asked = true;
    return store->make_room(store->room_context, length);
}

/* Writes at the end of the file; what nobody needs makes room when the disk is full. *offset is where it
 * ends afterwards. Returns 0 or an errno. */
static int write_all(blob_store_t *store, int descriptor, uint64_t *offset, const uint8_t *bytes,
                     size_t length)
{
    bool asked = false;
    while (length > 0) {
        ssize_t written = pwrite(descriptor, bytes, length, (off_t)*offset);
        if (written < 0 && errno == EINTR) continue;
        if (written <= 0) {
            int error = written < 0 ? errno : ENOSPC;
            bool full = error == ENOSPC || error == EDQUOT;
            if (full && find_room(store, length, &asked)) continue;
            return error;
        }
        bytes += written;
        *offset += (uint64_t)written;
        length -= (size_t)written;
    }
    return 0;
}

/* Appends what fits; *next is the length of the file afterwards. */
static result_t append_open(blob_store_t *store, int descriptor, const char *path, uint64_t offset,
                            uint64_t size, const void *bytes, size_t length, uint64_t *next)
{
    struct stat status;
    if (fstat(descriptor, &status) != 0) return disk_failure(path, errno, 0, size);
    *next = (uint64_t)status.st_size;
    if (*next > size) { /* somebody named another size before: begin anew */
        if (ftruncate(descriptor, 0) != 0) return disk_failure(path, errno, 0, size);
        *next = 0;
    }
    int error = 0;
    if (offset == *next && length <= size - offset) error = write_all(store, descriptor, next, bytes, length);
    if (error != 0) return disk_failure(path, error, *next, size);
    /* Also when all was there before: the process that wrote it may have ended before it was flushed. */
    if (*next < size || store->fleeting || fsync(descriptor) == 0) return result_ok();
    error = errno;
    if (ftruncate(descriptor, 0) != 0) error = errno; /* nobody knows what of it is on the disk */
    return disk_failure(path, error, 0, size);
}

static result_t append(blob_store_t *store, const char *path, uint64_t offset, uint64_t size,
                       const void *bytes, size_t length, uint64_t *next)
{
    int descriptor = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (descriptor < 0) return disk_failure(path, errno, 0, size);
    result_t result = append_open(store, descriptor, path, offset, size, bytes, length, next);
    close(descriptor);
    return result;
}

/* Makes the new name durable. */
static result_t flush_directory(const blob_store_t *store)
{
    if (store->fleeting) return result_ok();
    int directory = open(store->directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    result_t result = result_ok();
    if (directory < 0 || (fsync(directory) != 0 && errno != EINVAL))
        result = result_fail(RESULT_IO, "cannot flush %s: %s", store->directory, strerror(errno));
    if (directory >= 0) close(directory);
    return result;
}

/* Checks a complete upload and gives it its name. */
static result_t finish(blob_store_t *store, const char *part, const char *path, const hash_t *hash,
                       uint64_t size)
{
    scene_blob_t blob = {0};
    result_t result = blob_open_file(part, &blob);
    if (result.code == RESULT_OK && !hash_equal(&blob.hash, hash))
        result = result_fail(RESULT_INPUT, "the blob's bytes do not have the hash that it was sent under");
    blob_close(&blob);
    if (result.code == RESULT_OK && rename(part, path) != 0)
        result = result_fail(RESULT_IO, "cannot rename %s: %s", part, strerror(errno));
    pthread_mutex_lock(&store->lock);
    if (result.code == RESULT_OK) {
        forget_item(store, find_item(store, hash, true));
        item_t *item = make_item(store, hash, false);
        item->bytes = size;
        item->used = time(NULL);
    } else if (result.code != RESULT_IO) {
        unlink(part);
        forget_item(store, find_item(store, hash, true));
    }
    pthread_mutex_unlock(&store->lock);
    return result.code == RESULT_OK ? flush_directory(store) : result;
}

static bool is_put(const blob_store_t *store, const hash_t *hash)
{
    for (size_t i = 0; i < store->put_count; i++)
        if (hash_equal(&store->puts[i], hash)) return true;
    return false;
}

/* Waits until nobody writes to the file: otherwise one thread could write to what the other has just found
 * right. */
static void begin_put(blob_store_t *store, const hash_t *hash)
{
    pthread_mutex_lock(&store->lock);
    while (store->put_count == MAX_PUTS || is_put(store, hash))
        pthread_cond_wait(&store->put_ended, &store->lock);
    store->puts[store->put_count++] = *hash;
    pthread_mutex_unlock(&store->lock);
}

static void end_put(blob_store_t *store, const hash_t *hash)
{
    pthread_mutex_lock(&store->lock);
    for (size_t i = 0; i < store->put_count; i++)
        if (hash_equal(&store->puts[i], hash)) {
            store->puts[i] = store->puts[--store->put_count];
            break;
        }
    pthread_cond_broadcast(&store->put_ended);
    pthread_mutex_unlock(&store->lock);
}

static result_t put_piece(blob_store_t *store, const hash_t *hash, uint64_t offset, uint64_t size,
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
    TRY(admit_upload(store, hash, size));
    char *part = blob_path(store, hash, "part"), *path = blob_path(store, hash, "blob");
    result_t result = append(store, part, offset, size, bytes, length, next);
    if (result.code == RESULT_OK && *next == size) result = finish(store, part, path, hash, size);
    free(part);
    free(path);
    return result;
}

result_t blob_store_put(blob_store_t *store, const hash_t *hash, uint64_t offset, uint64_t size,
                        const void *bytes, size_t length, uint64_t *next)
{
    begin_put(store, hash);
    result_t result = put_piece(store, hash, offset, size, bytes, length, next);
    end_put(store, hash);
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
