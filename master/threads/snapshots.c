/* snapshots: see snapshots.h. */
#include "master/threads/snapshots.h"

#include "common/file_io.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sodium.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Seconds. What takes less to make is made anew whenever something was counted; a reader that has not asked
 * for so long is taken to be gone when there is no room. */
static const double SLOW = 2, IDLE = 30;

typedef struct {
    snapshot_t snapshot; /* id 0: vacant */
    double made, used;   /* seconds, when it was, and last */
    uint32_t readers;    /* that were told of it and have not read its end */
} entry_t;

struct snapshots {
    char *directory;
    uint64_t limit;
    pthread_mutex_t lock; /* guards what follows */
    entry_t entries[SNAPSHOTS_MAX];
};

bool image_format_equal(const image_format_t *a, const image_format_t *b)
{
    return a->half == b->half && a->halves == b->halves && a->png == b->png && a->exposure == b->exposure;
}

/* ---- under the lock ------------------------------------------------------------------------------------ */

static void drop(entry_t *entry)
{
    if (entry->snapshot.id != 0 && !entry->snapshot.keep) unlink(entry->snapshot.path);
    free(entry->snapshot.path);
    *entry = (entry_t){.used = 0};
}

static entry_t *find(snapshots_t *snapshots, uint64_t id)
{
    for (size_t i = 0; id != 0 && i < SNAPSHOTS_MAX; i++)
        if (snapshots->entries[i].snapshot.id == id) return &snapshots->entries[i];
    return NULL;
}

/* Of the same job and kind, of any version. */
static bool alike(const entry_t *entry, const image_key_t *key)
{
    const image_key_t *own = &entry->snapshot.key;
    return entry->snapshot.id != 0 && own->job == key->job && own->over == key->over && own->at == key->at &&
           image_format_equal(&own->format, &key->format);
}

static bool fresh(const entry_t *entry, double now)
{
    double seconds = entry->snapshot.seconds;
    return seconds >= SLOW && !entry->snapshot.key.over && now - entry->made <= seconds;
}

static bool idle(const entry_t *entry, double now)
{
    return entry->readers == 0 || now - entry->used > IDLE;
}

/* What counts against the limit. */
static uint64_t bytes_of(const entry_t *entry)
{
    return entry->snapshot.keep ? 0 : entry->snapshot.size;
}

static uint64_t bytes_taken(const snapshots_t *snapshots)
{
    uint64_t bytes = 0;
    for (size_t i = 0; i < SNAPSHOTS_MAX; i++) bytes += bytes_of(&snapshots->entries[i]);
    return bytes;
}

static uint64_t bytes_left(const snapshots_t *snapshots)
{
    uint64_t taken = bytes_taken(snapshots);
    return taken < snapshots->limit ? snapshots->limit - taken : 0;
}

/* The least recently used that nobody reads and that takes room; NULL: there is none. */
static entry_t *find_idle(snapshots_t *snapshots, double now)
{
    entry_t *found = NULL;
    for (size_t i = 0; i < SNAPSHOTS_MAX; i++) {
        entry_t *entry = &snapshots->entries[i];
        if (bytes_of(entry) > 0 && idle(entry, now) && (found == NULL || entry->used < found->used))
            found = entry;
    }
    return found;
}

/* A vacant entry; if need be the one that was not used for longest goes. */
static entry_t *vacate(snapshots_t *snapshots)
{
    entry_t *oldest = &snapshots->entries[0];
    for (size_t i = 0; i < SNAPSHOTS_MAX; i++) {
        entry_t *entry = &snapshots->entries[i];
        if (entry->snapshot.id == 0) return entry;
        if (entry->used < oldest->used) oldest = entry;
    }
    drop(oldest);
    return oldest;
}

static result_t refuse(const snapshots_t *snapshots)
{
    double taken = 1e-9 * (double)bytes_taken(snapshots), limit = 1e-9 * (double)snapshots->limit;
    if (taken > 0)
        return result_fail(RESULT_LIMIT,
                           "there is no room for the image now: images that others fetch take %.3g of the "
                           "%.3g GB that they may (--snapshot-limit of the master): try again later",
                           taken, limit);
    return result_fail(RESULT_LIMIT,
                       "the image is larger than the %.3g GB that images being fetched may take: start the "
                       "master with a larger --snapshot-limit",
                       limit);
}

/* ---- life ---------------------------------------------------------------------------------------------- */

result_t snapshots_new(const char *data_dir, uint64_t limit, snapshots_t **out)
{
    char *directory = mem_printf("%s/snapshots", data_dir);
    result_t result = directory_make(directory, 0700);
    if (result.code != RESULT_OK) {
        free(directory);
        return result;
    }
    directory_clear(directory);
    *out = mem_zalloc(1, sizeof **out);
    (*out)->directory = directory;
    (*out)->limit = limit > 0 ? limit : UINT64_MAX;
    pthread_mutex_init(&(*out)->lock, NULL);
    return result;
}

void snapshots_free(snapshots_t **snapshots)
{
    if (*snapshots == NULL) return;
    for (size_t i = 0; i < SNAPSHOTS_MAX; i++) drop(&(*snapshots)->entries[i]);
    pthread_mutex_destroy(&(*snapshots)->lock);
    free((*snapshots)->directory);
    free(*snapshots);
    *snapshots = NULL;
}

/* ---- making -------------------------------------------------------------------------------------------- */

uint64_t snapshots_find(snapshots_t *snapshots, double now, const image_key_t *key)
{
    uint64_t id = 0;
    pthread_mutex_lock(&snapshots->lock);
    for (size_t i = 0; id == 0 && i < SNAPSHOTS_MAX; i++) {
        entry_t *entry = &snapshots->entries[i];
        if (!alike(entry, key) || (entry->snapshot.key.version != key->version && !fresh(entry, now)))
            continue;
        id = entry->snapshot.id;
        entry->used = now;
    }
    pthread_mutex_unlock(&snapshots->lock);
    return id;
}

void snapshots_name(const snapshots_t *snapshots, snapshot_t *snapshot)
{
    while (snapshot->id == 0) randombytes_buf(&snapshot->id, sizeof snapshot->id);
    if (snapshot->keep) return;
    snapshot->path = mem_printf("%s/%016llx.%s", snapshots->directory, (unsigned long long)snapshot->id,
                                snapshot->key.format.png ? "png" : "exr");
}

result_t snapshots_room(snapshots_t *snapshots, double now, uint64_t largest, uint64_t *room)
{
    pthread_mutex_lock(&snapshots->lock);
    for (entry_t *entry; bytes_left(snapshots) < largest && (entry = find_idle(snapshots, now)) != NULL;)
        drop(entry);
    *room = bytes_left(snapshots);
    result_t result = *room > 0 ? result_ok() : refuse(snapshots);
    pthread_mutex_unlock(&snapshots->lock);
    return result;
}

result_t snapshots_refusal(snapshots_t *snapshots)
{
    pthread_mutex_lock(&snapshots->lock);
    result_t result = refuse(snapshots);
    pthread_mutex_unlock(&snapshots->lock);
    return result;
}

void snapshots_put(snapshots_t *snapshots, double now, const snapshot_t *snapshot)
{
    pthread_mutex_lock(&snapshots->lock);
    *vacate(snapshots) = (entry_t){.snapshot = *snapshot, .made = now, .used = now};
    pthread_mutex_unlock(&snapshots->lock);
}

void snapshots_give(snapshots_t *snapshots, uint64_t id)
{
    pthread_mutex_lock(&snapshots->lock);
    entry_t *entry = find(snapshots, id);
    if (entry != NULL) entry->readers++;
    pthread_mutex_unlock(&snapshots->lock);
}

void snapshots_drop_old(snapshots_t *snapshots, double now)
{
    pthread_mutex_lock(&snapshots->lock);
    for (size_t i = 0; i < SNAPSHOTS_MAX; i++) {
        entry_t *entry = &snapshots->entries[i];
        if (entry->snapshot.id != 0 && now - entry->used > SNAPSHOTS_KEEP) drop(entry);
    }
    pthread_mutex_unlock(&snapshots->lock);
}

/* ---- reading ------------------------------------------------------------------------------------------- */

/* Under the lock, so that the file is not deleted meanwhile. */
static result_t read_file(entry_t *entry, uint64_t offset, void *bytes, size_t *length)
{
    const snapshot_t *snapshot = &entry->snapshot;
    if (offset > snapshot->size)
        return result_fail(RESULT_INPUT, "offset %llu is beyond the image's %llu bytes",
                           (unsigned long long)offset, (unsigned long long)snapshot->size);
    int descriptor = open(snapshot->path, O_RDONLY | O_CLOEXEC);
    ssize_t got = descriptor < 0 ? -1 : pread(descriptor, bytes, *length, (off_t)offset);
    result_t result = result_ok();
    if (got < 0) result = result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    if (descriptor >= 0) close(descriptor);
    *length = got < 0 ? 0 : (size_t)got;
    bool end = *length > 0 && offset + *length >= snapshot->size;
    if (end && entry->readers > 0) entry->readers--;
    return result;
}

result_t snapshots_read(snapshots_t *snapshots, double now, uint64_t id, uint64_t offset, void *bytes,
                        size_t *length, uint64_t *size)
{
    result_t result = result_fail(RESULT_INPUT, "this image is no longer kept: ask for a new one");
    pthread_mutex_lock(&snapshots->lock);
    entry_t *entry = find(snapshots, id);
    if (entry != NULL) {
        result = read_file(entry, offset, bytes, length);
        *size = entry->snapshot.size;
        entry->used = now;
    }
    pthread_mutex_unlock(&snapshots->lock);
    return result;
}

result_t snapshots_open(snapshots_t *snapshots, uint64_t id, image_file_t *file)
{
    result_t result = result_fail(RESULT_IO, "the image was not kept: ask again");
    pthread_mutex_lock(&snapshots->lock);
    const entry_t *entry = find(snapshots, id);
    if (entry != NULL) {
        const snapshot_t *snapshot = &entry->snapshot;
        *file = (image_file_t){.descriptor = open(snapshot->path, O_RDONLY | O_CLOEXEC),
                               .size = snapshot->size,
                               .version = snapshot->key.version,
                               .over = snapshot->key.over};
        result = file->descriptor >= 0
                     ? result_ok()
                     : result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    }
    pthread_mutex_unlock(&snapshots->lock);
    return result;
}
