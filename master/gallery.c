/* gallery: see gallery.h.
 *
 * DESIGN. The thread sleeps on the farm's eventfd, which gallery_ask writes as well. Woken, it first sees to
 * jobs that are over, then to requests. A snapshot is identified by what it shows (job, number of batches
 * merged, half or float), so that people who watch one job share one file. The final image of a job is a
 * snapshot too, whose file is not deleted with it; as halves it is made from the float file, since the film
 * is gone. */
#include "master/gallery.h"

#include "common/picture.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <sodium.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

enum { PIXEL_BYTES = 128 }; /* that a pixel of an image takes, at most: 13 channels, and as many of layers */

typedef struct {
    uint64_t id; /* random; 0: vacant */
    uint64_t job, version;
    bool over, half;
    char *path;
    bool keep; /* the file stays when the snapshot goes */
    uint64_t size;
    double last_used;
} snapshot_t;

typedef struct {
    image_request_t request;
    result_t result;
    uint64_t snapshot;
} answer_t;

struct gallery {
    gallery_options_t options;
    char *data_dir;
    pthread_t thread;
    atomic_bool stop;
    pthread_mutex_t lock; /* guards what follows */
    snapshot_t snapshots[GALLERY_MAX_SNAPSHOTS];
    image_request_t waiting[GALLERY_MAX_WAITING];
    size_t waiting_count;
    answer_t answers[GALLERY_MAX_WAITING];
    size_t answer_count;
};

static void wake(int descriptor)
{
    uint64_t one = 1;
    if (write(descriptor, &one, sizeof one) < 0) return; /* full: it is awake already */
}

char *gallery_image_path(const char *data_dir, uint64_t job)
{
    return mem_printf("%s/job-%llu.exr", data_dir, (unsigned long long)job);
}

uint64_t gallery_last_job(const char *data_dir)
{
    uint64_t last = 0;
    DIR *directory = opendir(data_dir);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;) {
        unsigned long long number;
        if (sscanf(entry->d_name, "job-%15llu.exr", &number) == 1 && number > last) last = number;
    }
    if (directory != NULL) closedir(directory);
    return last;
}

/* ---- writing images ------------------------------------------------------------------------------------ */

/* Resolves the film as it is now and writes it. */
static result_t write_film(gallery_t *gallery, job_t *job, const char *path, bool half)
{
    film_image_t film = {0};
    job_report_t report;
    TRY(farm_resolve(gallery->options.farm, clock_now(), job, &film, &report));
    picture_meta_t meta = {.scene = report.blob,
                           .scene_name = report.terms.name,
                           .settings = report.settings,
                           .counts = report.counts,
                           .workers = report.workers_seen,
                           .wall_seconds = report.elapsed,
                           .bits = report.fingerprint,
                           .note = report.message};
    result_t result = picture_write_exr(path, &film, &meta, half);
    film_image_free(&film);
    return result;
}

static void copy_attribute(image_t *image, const image_attribute_t *attribute)
{
    switch (attribute->kind) {
    case ATTRIBUTE_STRING:
        image_set_string(image, attribute->name, attribute->text);
        break;
    case ATTRIBUTE_INT:
        image_set_int(image, attribute->name, attribute->integer);
        break;
    case ATTRIBUTE_FLOAT:
        image_set_float(image, attribute->name, attribute->real);
        break;
    case ATTRIBUTE_OTHER:
        break; /* the writer's own */
    }
}

/* Makes a file of halves from a finished image. */
static result_t write_halves(const char *from, const char *path)
{
    image_t image = {0}, halves;
    TRY(image_read_exr(from, &image));
    image_init(&halves, image.width, image.height);
    for (size_t i = 0; i < image.channel_count; i++) {
        const image_channel_t *channel = &image.channels[i];
        image_add_view(&halves, channel->name, picture_half_fits(channel->name) ? PIXEL_HALF : PIXEL_FLOAT,
                       channel->data, channel->stride);
    }
    for (size_t i = 0; i < image.attribute_count; i++)
        if (strncmp(image.attributes[i].name, "lightmill.", 10) == 0)
            copy_attribute(&halves, &image.attributes[i]);
    result_t result = image_write_exr(path, &halves);
    image_free(&halves);
    image_free(&image);
    return result;
}

/* Writes a job's last image; on a full disk, films of jobs that are over make room for it. */
static result_t write_last(gallery_t *gallery, job_t *job, const char *path)
{
    keeper_t *keeper = gallery->options.keeper;
    result_t result = write_film(gallery, job, path, false);
    if (result.code != RESULT_IO || keeper == NULL) return result;
    job_settings_t settings = farm_job_settings(gallery->options.farm, job);
    uint64_t bytes = (uint64_t)settings.width * (uint64_t)settings.height * PIXEL_BYTES;
    return keeper_make_room(keeper, bytes) ? write_film(gallery, job, path, false) : result;
}

static void finish_job(gallery_t *gallery, job_t *job)
{
    farm_t *farm = gallery->options.farm;
    bool failed;
    uint64_t batches = farm_image_version(farm, job, &failed);
    result_t result = result_ok();
    char *path = NULL;
    if (!failed && batches > 0) {
        path = gallery_image_path(gallery->data_dir, farm_job_id(job));
        result = write_last(gallery, job, path);
    }
    if (result.code == RESULT_INPUT) { /* nothing of it is left, so there is nothing to show */
        log_warning("%s", result.message);
        result = result_ok();
        free(path);
        path = NULL;
    }
    farm_finished(farm, clock_now(), job, result, path);
    farm_unpin(farm, job);
    free(path);
}

/* ---- snapshots; all under the lock --------------------------------------------------------------------- */

static void snapshot_drop(snapshot_t *snapshot)
{
    if (snapshot->id != 0 && !snapshot->keep) unlink(snapshot->path);
    free(snapshot->path);
    *snapshot = (snapshot_t){0};
}

static void drop_old(gallery_t *gallery, double now)
{
    for (size_t i = 0; i < GALLERY_MAX_SNAPSHOTS; i++)
        if (gallery->snapshots[i].id != 0 && now - gallery->snapshots[i].last_used > GALLERY_KEEP)
            snapshot_drop(&gallery->snapshots[i]);
}

/* A vacant entry; if need be the one that was not used for longest goes. */
static snapshot_t *snapshot_make(gallery_t *gallery)
{
    snapshot_t *oldest = &gallery->snapshots[0];
    for (size_t i = 0; i < GALLERY_MAX_SNAPSHOTS; i++) {
        snapshot_t *snapshot = &gallery->snapshots[i];
        if (snapshot->id == 0) return snapshot;
        if (snapshot->last_used < oldest->last_used) oldest = snapshot;
    }
    snapshot_drop(oldest);
    return oldest;
}

static snapshot_t *snapshot_find(gallery_t *gallery, const snapshot_t *like)
{
    for (size_t i = 0; i < GALLERY_MAX_SNAPSHOTS; i++) {
        snapshot_t *s = &gallery->snapshots[i];
        if (s->id != 0 && s->job == like->job && s->version == like->version && s->half == like->half &&
            s->over == like->over)
            return s;
    }
    return NULL;
}

/* ---- requests ------------------------------------------------------------------------------------------ */

/* Writes the file of a snapshot and fills in its path. */
static result_t take_snapshot(gallery_t *gallery, job_t *job, snapshot_t *snapshot)
{
    char *final = gallery_image_path(gallery->data_dir, snapshot->job);
    snapshot->keep = snapshot->over && !snapshot->half;
    snapshot->path = snapshot->keep ? mem_strdup(final)
                                    : mem_printf("%s/snapshots/%016llx.exr", gallery->data_dir,
                                                 (unsigned long long)snapshot->id);
    result_t result = result_ok();
    if (!snapshot->over)
        result = write_film(gallery, job, snapshot->path, snapshot->half);
    else if (access(final, R_OK) != 0)
        result = result_fail(RESULT_INPUT, "job %llu has no image", (unsigned long long)snapshot->job);
    else if (snapshot->half)
        result = write_halves(final, snapshot->path);
    free(final);
    struct stat status;
    if (result.code == RESULT_OK && stat(snapshot->path, &status) != 0)
        result = result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    if (result.code == RESULT_OK) snapshot->size = (uint64_t)status.st_size;
    return result;
}

/* Finds or makes the snapshot that a request asks for. */
static result_t serve_request(gallery_t *gallery, job_t *job, const image_request_t *request, uint64_t *id)
{
    snapshot_t wanted = {.job = request->job, .half = request->half};
    wanted.version = farm_image_version(gallery->options.farm, job, &wanted.over);
    pthread_mutex_lock(&gallery->lock);
    snapshot_t *found = snapshot_find(gallery, &wanted);
    if (found != NULL) {
        found->last_used = clock_now();
        *id = found->id;
    }
    pthread_mutex_unlock(&gallery->lock);
    if (found != NULL) return result_ok();
    while (wanted.id == 0) randombytes_buf(&wanted.id, sizeof wanted.id);
    result_t result = take_snapshot(gallery, job, &wanted);
    if (result.code != RESULT_OK) {
        free(wanted.path);
        return result;
    }
    pthread_mutex_lock(&gallery->lock);
    wanted.last_used = clock_now();
    *snapshot_make(gallery) = wanted;
    pthread_mutex_unlock(&gallery->lock);
    *id = wanted.id;
    return result;
}

static void answer_request(gallery_t *gallery, const image_request_t *request)
{
    answer_t answer = {.request = *request};
    job_t *job = farm_pin(gallery->options.farm, request->job);
    if (job == NULL) {
        answer.result = result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)request->job);
    } else {
        answer.result = serve_request(gallery, job, request, &answer.snapshot);
        farm_unpin(gallery->options.farm, job);
    }
    pthread_mutex_lock(&gallery->lock);
    gallery->answers[gallery->answer_count++] = answer;
    pthread_mutex_unlock(&gallery->lock);
    wake(gallery->options.answer_wake);
}

/* The next request, as long as there is room for its answer. */
static bool next_request(gallery_t *gallery, image_request_t *request)
{
    pthread_mutex_lock(&gallery->lock);
    bool found = gallery->waiting_count > 0 && gallery->answer_count < GALLERY_MAX_WAITING;
    if (found) {
        *request = gallery->waiting[0];
        gallery->waiting_count--;
        memmove(gallery->waiting, gallery->waiting + 1, gallery->waiting_count * sizeof *request);
    }
    pthread_mutex_unlock(&gallery->lock);
    return found;
}

static void serve_finished(gallery_t *gallery)
{
    for (job_t *job; (job = farm_next_finished(gallery->options.farm)) != NULL;) finish_job(gallery, job);
}

static void *gallery_run(void *argument)
{
    gallery_t *gallery = argument;
    prctl(PR_SET_NAME, "lm-gallery");
    while (!atomic_load(&gallery->stop)) {
        struct pollfd wait = {.fd = gallery->options.image_wake, .events = POLLIN};
        uint64_t count;
        if (poll(&wait, 1, 1000) > 0 && read(gallery->options.image_wake, &count, sizeof count) < 0) continue;
        serve_finished(gallery);
        for (image_request_t request; !atomic_load(&gallery->stop) && next_request(gallery, &request);) {
            answer_request(gallery, &request);
            serve_finished(gallery);
        }
        pthread_mutex_lock(&gallery->lock);
        drop_old(gallery, clock_now());
        pthread_mutex_unlock(&gallery->lock);
    }
    serve_finished(gallery);
    return NULL;
}

/* ---- the door ------------------------------------------------------------------------------------------ */

/* Deletes images that an earlier process did not finish. */
static void drop_leftovers(const char *data_dir)
{
    DIR *directory = opendir(data_dir);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;) {
        size_t length = strlen(entry->d_name);
        if (strncmp(entry->d_name, "job-", 4) == 0 && length > 5 &&
            strcmp(entry->d_name + length - 5, ".part") == 0)
            unlinkat(dirfd(directory), entry->d_name, 0);
    }
    if (directory != NULL) closedir(directory);
}

/* Makes the snapshot directory, empty. */
static result_t prepare_directory(const char *data_dir)
{
    char *path = mem_printf("%s/snapshots", data_dir);
    result_t result = result_ok();
    if (mkdir(path, 0777) != 0 && errno != EEXIST)
        result = result_fail(RESULT_IO, "cannot make the directory %s: %s", path, strerror(errno));
    DIR *directory = opendir(path);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;)
        if (entry->d_name[0] != '.') unlinkat(dirfd(directory), entry->d_name, 0);
    if (directory != NULL) closedir(directory);
    free(path);
    return result;
}

result_t gallery_start(const gallery_options_t *options, gallery_t **out)
{
    drop_leftovers(options->data_dir);
    TRY(prepare_directory(options->data_dir));
    gallery_t *gallery = mem_zalloc(1, sizeof *gallery);
    gallery->options = *options;
    gallery->data_dir = mem_strdup(options->data_dir);
    pthread_mutex_init(&gallery->lock, NULL);
    int error = pthread_create(&gallery->thread, NULL, gallery_run, gallery);
    if (error == 0) {
        *out = gallery;
        return result_ok();
    }
    pthread_mutex_destroy(&gallery->lock);
    free(gallery->data_dir);
    free(gallery);
    return result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
}

void gallery_stop(gallery_t **out)
{
    gallery_t *gallery = *out;
    if (gallery == NULL) return;
    atomic_store(&gallery->stop, true);
    wake(gallery->options.image_wake);
    pthread_join(gallery->thread, NULL);
    for (size_t i = 0; i < GALLERY_MAX_SNAPSHOTS; i++) snapshot_drop(&gallery->snapshots[i]);
    pthread_mutex_destroy(&gallery->lock);
    free(gallery->data_dir);
    free(gallery);
    *out = NULL;
}

result_t gallery_ask(gallery_t *gallery, const image_request_t *request)
{
    pthread_mutex_lock(&gallery->lock);
    bool room = gallery->waiting_count < GALLERY_MAX_WAITING;
    if (room) gallery->waiting[gallery->waiting_count++] = *request;
    pthread_mutex_unlock(&gallery->lock);
    if (!room) return result_fail(RESULT_LIMIT, "%d images are asked for already", GALLERY_MAX_WAITING);
    wake(gallery->options.image_wake);
    return result_ok();
}

bool gallery_next_answer(gallery_t *gallery, image_request_t *request, result_t *result, uint64_t *snapshot)
{
    pthread_mutex_lock(&gallery->lock);
    bool found = gallery->answer_count > 0;
    if (found) {
        *request = gallery->answers[0].request;
        *result = gallery->answers[0].result;
        *snapshot = gallery->answers[0].snapshot;
        gallery->answer_count--;
        memmove(gallery->answers, gallery->answers + 1, gallery->answer_count * sizeof *gallery->answers);
    }
    pthread_mutex_unlock(&gallery->lock);
    if (found) wake(gallery->options.image_wake); /* there is room for an answer again */
    return found;
}

/* Reads under the lock, so that the file is not deleted meanwhile. */
static result_t read_snapshot(const snapshot_t *snapshot, uint64_t offset, void *bytes, size_t *length)
{
    if (offset > snapshot->size)
        return result_fail(RESULT_INPUT, "offset %llu is beyond the image's %llu bytes",
                           (unsigned long long)offset, (unsigned long long)snapshot->size);
    int descriptor = open(snapshot->path, O_RDONLY | O_CLOEXEC);
    ssize_t got = descriptor < 0 ? -1 : pread(descriptor, bytes, *length, (off_t)offset);
    result_t result = result_ok();
    if (got < 0) result = result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    if (descriptor >= 0) close(descriptor);
    *length = got < 0 ? 0 : (size_t)got;
    return result;
}

result_t gallery_read(gallery_t *gallery, uint64_t id, uint64_t offset, void *bytes, size_t *length,
                      uint64_t *size)
{
    result_t result = result_fail(RESULT_INPUT, "this image is no longer kept: ask for a new one");
    pthread_mutex_lock(&gallery->lock);
    for (size_t i = 0; id != 0 && i < GALLERY_MAX_SNAPSHOTS; i++) {
        snapshot_t *snapshot = &gallery->snapshots[i];
        if (snapshot->id != id) continue;
        result = read_snapshot(snapshot, offset, bytes, length);
        *size = snapshot->size;
        snapshot->last_used = clock_now();
    }
    pthread_mutex_unlock(&gallery->lock);
    return result;
}
