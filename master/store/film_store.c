/* film_store: see film_store.h. */
#include "master/store/film_store.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

struct film_store {
    char *directory;
    pthread_mutex_t lock; /* guards what follows */
    film_file_t *files;   /* by job, latest first */
    size_t count, capacity;
};

/* ---- names --------------------------------------------------------------------------------------------- */

/* Digits of a number without leading zeroes; false unless there are 1 to 18. */
static bool parse_number(const char **text, uint64_t *number)
{
    size_t digits = strspn(*text, "0123456789");
    if (digits == 0 || digits > 18 || **text == '0') return false;
    *number = strtoull(*text, NULL, 10);
    *text += digits;
    return true;
}

/* "job-<number>.<generation>.film" and what follows; NULL when it is no such name. */
static const char *parse_name(const char *name, film_file_t *file)
{
    if (strncmp(name, "job-", 4) != 0) return NULL;
    name += 4;
    if (!parse_number(&name, &file->job) || *name++ != '.') return NULL;
    if (!parse_number(&name, &file->generation) || strncmp(name, ".film", 5) != 0) return NULL;
    return name + 5;
}

char *film_store_path(const film_store_t *store, uint64_t job, uint64_t generation)
{
    return mem_printf("%s/job-%llu.%llu.film", store->directory, (unsigned long long)job,
                      (unsigned long long)generation);
}

/* ---- the list; under the lock -------------------------------------------------------------------------- */

static bool comes_before(const film_file_t *a, const film_file_t *b)
{
    return a->job != b->job ? a->job < b->job : a->generation > b->generation;
}

static void insert(film_store_t *store, const film_file_t *file)
{
    if (store->count == store->capacity) {
        store->capacity = 2 * store->capacity + 16;
        store->files = mem_realloc(store->files, store->capacity * sizeof *store->files);
    }
    size_t at = store->count++;
    for (; at > 0 && comes_before(file, &store->files[at - 1]); at--) store->files[at] = store->files[at - 1];
    store->files[at] = *file;
}

static void forget(film_store_t *store, size_t at)
{
    memmove(store->files + at, store->files + at + 1, (--store->count - at) * sizeof *store->files);
}

/* The first file of the job, or of a later one. */
static size_t find_job(const film_store_t *store, uint64_t job)
{
    size_t at = 0;
    while (at < store->count && store->files[at].job < job) at++;
    return at;
}

/* Deletes a file and forgets it. */
static void drop(film_store_t *store, size_t at)
{
    char *path = film_store_path(store, store->files[at].job, store->files[at].generation);
    if (unlink(path) != 0 && errno != ENOENT) log_warning("cannot delete %s: %s", path, strerror(errno));
    free(path);
    forget(store, at);
}

/* ---- the public functions ------------------------------------------------------------------------------ */

/* Looks at one entry of the directory. */
static void scan_entry(film_store_t *store, int directory, const char *name)
{
    film_file_t file = {0};
    const char *rest = parse_name(name, &file);
    if (rest == NULL) return;
    size_t length = strlen(rest);
    struct stat status;
    if (*rest == '\0' && fstatat(directory, name, &status, 0) == 0 && S_ISREG(status.st_mode)) {
        file.bytes = (uint64_t)status.st_size;
        insert(store, &file);
    } else if (length > 5 && strcmp(rest + length - 5, ".part") == 0) {
        unlinkat(directory, name, 0); /* never finished */
    }
}

static result_t scan(film_store_t *store)
{
    DIR *directory = opendir(store->directory);
    if (directory == NULL)
        return result_fail(RESULT_IO, "cannot read %s: %s", store->directory, strerror(errno));
    for (const struct dirent *entry; (entry = readdir(directory)) != NULL;)
        scan_entry(store, dirfd(directory), entry->d_name);
    closedir(directory);
    return result_ok();
}

result_t film_store_open(const char *directory, film_store_t **out)
{
    TRY(directory_make(directory, 0700));
    film_store_t *store = mem_zalloc(1, sizeof *store);
    store->directory = mem_strdup(directory);
    pthread_mutex_init(&store->lock, NULL);
    result_t result = scan(store);
    if (result.code != RESULT_OK) film_store_close(&store);
    *out = store;
    return result;
}

void film_store_close(film_store_t **store)
{
    if (*store == NULL) return;
    pthread_mutex_destroy(&(*store)->lock);
    free((*store)->files);
    free((*store)->directory);
    free(*store);
    *store = NULL;
}

film_file_t *film_store_list(film_store_t *store, uint64_t job, size_t *count)
{
    pthread_mutex_lock(&store->lock);
    size_t first = find_job(store, job), end = store->count;
    if (job != 0)
        for (end = first; end < store->count && store->files[end].job == job;) end++;
    *count = end - first;
    film_file_t *list = *count > 0 ? mem_alloc(*count * sizeof *list) : NULL;
    if (list != NULL) memcpy(list, store->files + first, *count * sizeof *list);
    pthread_mutex_unlock(&store->lock);
    return list;
}

uint64_t film_store_bytes(film_store_t *store, uint64_t job)
{
    uint64_t bytes = 0;
    pthread_mutex_lock(&store->lock);
    for (size_t i = find_job(store, job); i < store->count && store->files[i].job == job; i++)
        bytes += store->files[i].bytes;
    pthread_mutex_unlock(&store->lock);
    return bytes;
}

uint64_t film_store_next(film_store_t *store, uint64_t job)
{
    pthread_mutex_lock(&store->lock);
    size_t at = find_job(store, job);
    bool any = at < store->count && store->files[at].job == job;
    uint64_t next = any ? store->files[at].generation + 1 : 1;
    pthread_mutex_unlock(&store->lock);
    char *aside; /* one that was set aside keeps its number */
    for (bool taken = true; taken; next += taken) {
        char *path = film_store_path(store, job, next);
        aside = mem_printf("%s.damaged", path);
        taken = access(aside, F_OK) == 0;
        free(aside);
        free(path);
    }
    return next;
}

void film_store_add(film_store_t *store, const film_file_t *file, size_t keep)
{
    pthread_mutex_lock(&store->lock);
    insert(store, file);
    size_t at = find_job(store, file->job) + keep;
    while (at < store->count && store->files[at].job == file->job) drop(store, at);
    pthread_mutex_unlock(&store->lock);
}

void film_store_set_aside(film_store_t *store, uint64_t job, uint64_t generation)
{
    char *path = film_store_path(store, job, generation), *aside = mem_printf("%s.damaged", path);
    pthread_mutex_lock(&store->lock);
    for (size_t i = find_job(store, job); i < store->count && store->files[i].job == job; i++) {
        if (store->files[i].generation != generation) continue;
        forget(store, i);
        break;
    }
    if (rename(path, aside) != 0) log_warning("cannot set %s aside: %s", path, strerror(errno));
    pthread_mutex_unlock(&store->lock);
    free(aside);
    free(path);
}

/* Deletes the checkpoints of a job that were set aside, and makes durable what was deleted. */
static void finish_deleting(const film_store_t *store, uint64_t job)
{
    DIR *directory = opendir(store->directory);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;) {
        film_file_t file = {0};
        const char *rest = parse_name(entry->d_name, &file);
        if (rest != NULL && file.job == job && strcmp(rest, ".damaged") == 0)
            unlinkat(dirfd(directory), entry->d_name, 0);
    }
    if (directory == NULL) return;
    (void)fsync(dirfd(directory)); /* one that cannot be flushed is no reason to fail */
    closedir(directory);
}

uint64_t film_store_delete(film_store_t *store, uint64_t job)
{
    uint64_t bytes = 0;
    pthread_mutex_lock(&store->lock);
    size_t at = find_job(store, job);
    while (at < store->count && store->files[at].job == job) {
        bytes += store->files[at].bytes;
        drop(store, at);
    }
    finish_deleting(store, job);
    pthread_mutex_unlock(&store->lock);
    return bytes;
}

uint64_t film_store_room(const film_store_t *store)
{
    struct statvfs status;
    if (statvfs(store->directory, &status) != 0 || status.f_blocks == 0) return UINT64_MAX;
    return (uint64_t)status.f_bavail * status.f_frsize;
}
