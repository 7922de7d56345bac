/* image_writer: see image_writer.h.
 *
 * DESIGN. The thread sleeps on the farm's eventfd, which image_writer_ask writes as well. Woken, it first
 * sees to jobs that are over or stand at a milestone, then to requests. A snapshot is identified by what it
 * shows (job, number of batches merged, format), so that people who watch one job share one file. The final
 * image of a job is a snapshot too, whose file is not deleted with it; in another format it is made from the
 * float file, since the film is gone. */
#include "master/threads/image_writer.h"

#include "common/film/picture.h"
#include "common/own_directory.h"
#include "common/thread.h"
#include "common/wake.h"
#include "master/threads/stored_film.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* That a pixel of an image takes, at most, beside light groups: 13 channels, as many of layers, 6 of halves
 * and 24 of mattes. */
enum { PIXEL_BYTES = 4 * (13 + 13 + 6 + 24) };

typedef struct {
    uint64_t id; /* random; 0: vacant */
    uint64_t job, version;
    bool over;
    image_format_t format;
    uint32_t at; /* image_request_t.at */
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

struct image_writer {
    image_writer_options_t options;
    char *data_dir;
    pthread_t thread;
    atomic_bool stop;
    mattes_t *mattes;     /* the thread's own: of the scene that was needed last; NULL: none was */
    hash_t mattes_scene;  /* its blob */
    pthread_mutex_t lock; /* guards what follows */
    bool closed;          /* image_writer_close */
    snapshot_t snapshots[IMAGE_WRITER_MAX_SNAPSHOTS];
    image_request_t waiting[IMAGE_WRITER_MAX_WAITING];
    size_t waiting_count;
    answer_t answers[IMAGE_WRITER_MAX_WAITING];
    size_t answer_count;
};

char *image_writer_image_path(const char *data_dir, uint64_t job)
{
    return mem_printf("%s/job-%llu.exr", data_dir, (unsigned long long)job);
}

static char *milestone_path(const char *data_dir, uint64_t job, uint32_t spp)
{
    return mem_printf("%s/job-%llu-at-%u.exr", data_dir, (unsigned long long)job, spp);
}

/* True for the name of the last image of a job, or of a milestone's. */
static bool is_image_of(const char *name, uint64_t job)
{
    unsigned long long number;
    unsigned spp;
    int end = 0;
    if (sscanf(name, "job-%15llu%n", &number, &end) != 1 || number != job) return false;
    if (strcmp(name + end, ".exr") == 0) return true;
    name += end;
    end = 0;
    return sscanf(name, "-at-%10u.exr%n", &spp, &end) == 1 && end > 0 && name[end] == '\0';
}

void image_writer_delete(const char *data_dir, uint64_t job)
{
    DIR *directory = opendir(data_dir);
    if (directory == NULL) log_warning("cannot look for images in %s: %s", data_dir, strerror(errno));
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;)
        if (is_image_of(entry->d_name, job) && unlinkat(dirfd(directory), entry->d_name, 0) != 0 &&
            errno != ENOENT)
            log_warning("cannot delete %s/%s: %s", data_dir, entry->d_name, strerror(errno));
    if (directory != NULL) closedir(directory);
}

uint64_t image_writer_last_job(const char *data_dir)
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

/* The settings of a job that ends at a milestone. */
static void end_at(job_settings_t *settings, uint32_t spp)
{
    settings->spp = spp;
    settings->time_limit = settings->error = 0;
    settings->save_at.count = 0;
}

/* The names for the mattes of a job, kept for the next image; NULL when it has no mattes, or its scene is
 * gone: then an image without them is better than none. */
static const mattes_t *find_mattes(image_writer_t *image_writer, const job_t *job)
{
    job_record_t record = farm_record(image_writer->options.farm, clock_now(), job);
    if (!job_has_mattes(&record.settings)) return NULL;
    if (image_writer->mattes != NULL && hash_equal(&image_writer->mattes_scene, &record.blob))
        return image_writer->mattes;
    scene_blob_t blob;
    result_t result = blob_store_map(image_writer->options.blobs, &record.blob, &blob);
    if (result.code != RESULT_OK) {
        log_warning("job %llu: its image is without mattes: %s", (unsigned long long)record.job,
                    result.message);
        return NULL;
    }
    mattes_free(&image_writer->mattes);
    image_writer->mattes = mattes_new(&blob);
    image_writer->mattes_scene = record.blob;
    blob_close(&blob);
    return image_writer->mattes;
}

/* Writes a resolved film. `milestone`: the samples a pixel that it stands at; 0: none. */
static result_t write_image(const char *path, const film_image_t *film, const job_record_t *record,
                            const mattes_t *mattes, uint32_t milestone, const image_format_t *format)
{
    picture_meta_t meta = {.scene = record->blob,
                           .scene_name = record->terms.name,
                           .settings = record->settings,
                           .counts = record->counts,
                           .workers = record->workers_seen,
                           .wall_seconds = record->elapsed,
                           .bits = record->fingerprint,
                           .mattes = mattes,
                           .note = record->message};
    if (milestone > 0) end_at(&meta.settings, milestone);
    return format->png ? picture_write_png(path, film, format->exposure)
                       : picture_write_exr(path, film, &meta, format->half);
}

/* Resolves the film as it is now and writes it. */
static result_t write_film(image_writer_t *image_writer, job_t *job, const char *path, uint32_t milestone,
                           const image_format_t *format)
{
    film_extras_t extras = {.halves = format->halves || farm_job_halves(image_writer->options.farm, job),
                            .groups = !format->png,
                            .mattes = format->png ? NULL : find_mattes(image_writer, job)};
    film_image_t film = {0};
    job_report_t report;
    TRY(farm_resolve(image_writer->options.farm, clock_now(), job, &extras, &film, &report));
    result_t result = write_image(path, &film, &report.record, extras.mattes, milestone, format);
    film_image_free(&film);
    return result;
}

/* The same with the film of a job that is over, with halves. */
static result_t write_stored(image_writer_t *image_writer, job_t *job, const char *path,
                             const image_format_t *format)
{
    farm_t *farm = image_writer->options.farm;
    film_extras_t extras = {.halves = true, .groups = true, .mattes = find_mattes(image_writer, job)};
    film_image_t film = {0};
    job_record_t record = farm_record(farm, clock_now(), job);
    TRY(stored_film_resolve(farm, image_writer->options.films, &record, &extras, &film));
    result_t result = write_image(path, &film, &record, extras.mattes, 0, format);
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
        if (strncmp(image.attributes[i].name, "lightmill.", 10) == 0 ||
            strncmp(image.attributes[i].name, "cryptomatte/", 12) == 0)
            copy_attribute(&halves, &image.attributes[i]);
    result_t result = image_write_exr(path, &halves);
    image_free(&halves);
    image_free(&image);
    return result;
}

/* Makes a PNG from a finished image. */
static result_t write_png(const char *from, const char *path, float exposure)
{
    image_t image = {0};
    TRY(image_read_exr(from, &image));
    result_t result = image_write_png(path, &image, exposure);
    image_free(&image);
    return result;
}

/* The bytes that its file takes, at most: as if nothing could be packed. */
static uint64_t largest_file(const job_settings_t *settings)
{
    uint64_t pixels = (uint64_t)settings->width * (uint64_t)settings->height;
    size_t groups = sum_planes(settings, SUM_GROUP_EYE) + sum_planes(settings, SUM_GROUP_SPLAT);
    return pixels * (PIXEL_BYTES + groups * 3 * sizeof(float));
}

/* Writes an image that is to stay; on a full disk, films of jobs that are over make room for it. */
static result_t write_kept(image_writer_t *image_writer, job_t *job, const char *path, uint32_t milestone)
{
    checkpointer_t *checkpointer = image_writer->options.checkpointer;
    image_format_t format = {.half = false};
    result_t result = write_film(image_writer, job, path, milestone, &format);
    job_settings_t settings = farm_job_settings(image_writer->options.farm, job);
    bool again = result.code == RESULT_IO && checkpointer != NULL &&
                 checkpointer_make_room(checkpointer, largest_file(&settings));
    if (again) result = write_film(image_writer, job, path, milestone, &format);
    own_directory_hide(image_writer->data_dir, result.message); /* it becomes a message of the job */
    return result;
}

static void save_milestone(image_writer_t *image_writer, job_t *job, uint32_t spp)
{
    farm_t *farm = image_writer->options.farm;
    char *path = milestone_path(image_writer->data_dir, farm_job_id(job), spp);
    result_t result = write_kept(image_writer, job, path, spp);
    farm_milestone_written(farm, clock_now(), job, result, path);
    farm_unpin(farm, job);
    free(path);
}

static void finish_job(image_writer_t *image_writer, job_t *job)
{
    farm_t *farm = image_writer->options.farm;
    bool failed;
    uint64_t batches = farm_image_version(farm, job, &failed);
    result_t result = result_ok();
    char *path = NULL;
    if (!failed && batches > 0) {
        path = image_writer_image_path(image_writer->data_dir, farm_job_id(job));
        result = write_kept(image_writer, job, path, 0);
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

static void drop_old(image_writer_t *image_writer, double now)
{
    for (size_t i = 0; i < IMAGE_WRITER_MAX_SNAPSHOTS; i++)
        if (image_writer->snapshots[i].id != 0 &&
            now - image_writer->snapshots[i].last_used > IMAGE_WRITER_KEEP)
            snapshot_drop(&image_writer->snapshots[i]);
}

/* A vacant entry; if need be the one that was not used for longest goes. */
static snapshot_t *snapshot_make(image_writer_t *image_writer)
{
    snapshot_t *oldest = &image_writer->snapshots[0];
    for (size_t i = 0; i < IMAGE_WRITER_MAX_SNAPSHOTS; i++) {
        snapshot_t *snapshot = &image_writer->snapshots[i];
        if (snapshot->id == 0) return snapshot;
        if (snapshot->last_used < oldest->last_used) oldest = snapshot;
    }
    snapshot_drop(oldest);
    return oldest;
}

static bool same_format(const image_format_t *a, const image_format_t *b)
{
    return a->half == b->half && a->halves == b->halves && a->png == b->png && a->exposure == b->exposure;
}

static snapshot_t *snapshot_find(image_writer_t *image_writer, const snapshot_t *like)
{
    for (size_t i = 0; i < IMAGE_WRITER_MAX_SNAPSHOTS; i++) {
        snapshot_t *s = &image_writer->snapshots[i];
        if (s->id != 0 && s->job == like->job && s->version == like->version && s->over == like->over &&
            s->at == like->at && same_format(&s->format, &like->format))
            return s;
    }
    return NULL;
}

/* ---- requests ------------------------------------------------------------------------------------------ */

/* Why there is no file that a snapshot is to be made from. */
static result_t no_image(const image_writer_t *image_writer, const job_t *job, const snapshot_t *snapshot)
{
    unsigned long long number = snapshot->job;
    if (snapshot->at == 0) return result_fail(RESULT_INPUT, "job %llu has no image", number);
    job_settings_t settings = farm_job_settings(image_writer->options.farm, job);
    if (job_next_milestone(&settings, snapshot->at - 1) == snapshot->at)
        return result_fail(RESULT_INPUT, "job %llu has no image at %u samples a pixel yet", number,
                           snapshot->at);
    return result_fail(RESULT_INPUT,
                       "job %llu keeps no image at %u samples a pixel: submit it with --save-at %u", number,
                       snapshot->at, snapshot->at);
}

/* An image of a milestone has the halves only if the job was submitted so, and there is no film of it. */
static result_t no_halves(const snapshot_t *snapshot)
{
    return result_fail(RESULT_INPUT,
                       "job %llu was submitted without --halves, so its image at %u samples a pixel is kept "
                       "without",
                       (unsigned long long)snapshot->job, snapshot->at);
}

/* Writes the file of a snapshot and fills in its path. */
static result_t take_snapshot(image_writer_t *image_writer, job_t *job, snapshot_t *snapshot)
{
    char *final = snapshot->at > 0 ? milestone_path(image_writer->data_dir, snapshot->job, snapshot->at)
                                   : image_writer_image_path(image_writer->data_dir, snapshot->job);
    const image_format_t *format = &snapshot->format;
    bool lacks_halves = snapshot->over && format->halves && !farm_job_halves(image_writer->options.farm, job);
    snapshot->keep = snapshot->over && !format->half && !format->png && !lacks_halves;
    snapshot->path = snapshot->keep
                         ? mem_strdup(final)
                         : mem_printf("%s/snapshots/%016llx.%s", image_writer->data_dir,
                                      (unsigned long long)snapshot->id, format->png ? "png" : "exr");
    result_t result = result_ok();
    if (!snapshot->over)
        result = write_film(image_writer, job, snapshot->path, 0, format);
    else if (access(final, R_OK) != 0)
        result = no_image(image_writer, job, snapshot);
    else if (lacks_halves && snapshot->at > 0)
        result = no_halves(snapshot);
    else if (lacks_halves)
        result = write_stored(image_writer, job, snapshot->path, format);
    else if (format->png)
        result = write_png(final, snapshot->path, format->exposure);
    else if (format->half)
        result = write_halves(final, snapshot->path);
    free(final);
    struct stat status;
    if (result.code == RESULT_OK && stat(snapshot->path, &status) != 0)
        result = result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    if (result.code == RESULT_OK) snapshot->size = (uint64_t)status.st_size;
    return result;
}

/* Finds or makes the snapshot that a request asks for. */
static result_t serve_request(image_writer_t *image_writer, job_t *job, const image_request_t *request,
                              uint64_t *id)
{
    snapshot_t wanted = {.job = request->job, .format = request->format, .at = request->at, .over = true};
    if (request->at == 0) wanted.version = farm_image_version(image_writer->options.farm, job, &wanted.over);
    pthread_mutex_lock(&image_writer->lock);
    snapshot_t *found = snapshot_find(image_writer, &wanted);
    if (found != NULL) {
        found->last_used = clock_now();
        *id = found->id;
    }
    pthread_mutex_unlock(&image_writer->lock);
    if (found != NULL) return result_ok();
    while (wanted.id == 0) randombytes_buf(&wanted.id, sizeof wanted.id);
    result_t result = take_snapshot(image_writer, job, &wanted);
    if (result.code != RESULT_OK) {
        free(wanted.path);
        return result;
    }
    pthread_mutex_lock(&image_writer->lock);
    wanted.last_used = clock_now();
    *snapshot_make(image_writer) = wanted;
    pthread_mutex_unlock(&image_writer->lock);
    *id = wanted.id;
    return result;
}

/* A file that outlives its snapshot. */
static result_t open_file(image_writer_t *image_writer, uint64_t id, image_file_t *file)
{
    result_t result = result_fail(RESULT_IO, "the image was not kept: ask again");
    pthread_mutex_lock(&image_writer->lock);
    for (size_t i = 0; id != 0 && i < IMAGE_WRITER_MAX_SNAPSHOTS; i++) {
        const snapshot_t *snapshot = &image_writer->snapshots[i];
        if (snapshot->id != id) continue;
        *file = (image_file_t){.descriptor = open(snapshot->path, O_RDONLY | O_CLOEXEC),
                               .size = snapshot->size,
                               .version = snapshot->version,
                               .over = snapshot->over};
        result = file->descriptor >= 0
                     ? result_ok()
                     : result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    }
    pthread_mutex_unlock(&image_writer->lock);
    return result;
}

/* Calls who is to be told. */
static void tell(image_writer_t *image_writer, answer_t *answer)
{
    image_file_t file = {.descriptor = -1};
    if (answer->result.code == RESULT_OK) answer->result = open_file(image_writer, answer->snapshot, &file);
    answer->request.done(answer->request.context, &answer->result, &file);
}

static void answer_request(image_writer_t *image_writer, const image_request_t *request)
{
    answer_t answer = {.request = *request};
    job_t *job = farm_pin(image_writer->options.farm, request->job);
    if (job == NULL) {
        answer.result = result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)request->job);
    } else {
        answer.result = serve_request(image_writer, job, request, &answer.snapshot);
        farm_unpin(image_writer->options.farm, job);
    }
    if (request->done != NULL) {
        tell(image_writer, &answer);
        return;
    }
    pthread_mutex_lock(&image_writer->lock);
    image_writer->answers[image_writer->answer_count++] = answer;
    pthread_mutex_unlock(&image_writer->lock);
    wake_up(image_writer->options.answer_wake);
}

/* The next request, as long as there is room for its answer. */
static bool next_request(image_writer_t *image_writer, image_request_t *request)
{
    pthread_mutex_lock(&image_writer->lock);
    bool found = image_writer->waiting_count > 0 && image_writer->answer_count < IMAGE_WRITER_MAX_WAITING;
    if (found) {
        *request = image_writer->waiting[0];
        image_writer->waiting_count--;
        memmove(image_writer->waiting, image_writer->waiting + 1,
                image_writer->waiting_count * sizeof *request);
    }
    pthread_mutex_unlock(&image_writer->lock);
    return found;
}

static bool is_asked(image_writer_t *image_writer)
{
    pthread_mutex_lock(&image_writer->lock);
    bool asked = image_writer->waiting_count > 0;
    pthread_mutex_unlock(&image_writer->lock);
    return asked;
}

/* Images of milestones first: a job that waits for both gives out the other then. */
static void serve_farm(image_writer_t *image_writer)
{
    farm_t *farm = image_writer->options.farm;
    uint32_t spp;
    for (job_t *job;;) {
        if ((job = farm_next_milestone(farm, &spp)) != NULL)
            save_milestone(image_writer, job, spp);
        else if ((job = farm_next_finished(farm)) != NULL)
            finish_job(image_writer, job);
        else
            break;
    }
}

/* Estimates one error that is due; false when there is none. */
static bool estimate_error(image_writer_t *image_writer)
{
    farm_t *farm = image_writer->options.farm;
    job_t *job = farm_next_estimate(farm, clock_now());
    if (job == NULL) return false;
    farm_estimate(farm, clock_now(), job);
    farm_unpin(farm, job);
    serve_farm(image_writer);
    return true;
}

/* Estimates the errors that are due, as long as nobody waits for an image. */
static void estimate_errors(image_writer_t *image_writer)
{
    while (!atomic_load(&image_writer->stop) && !is_asked(image_writer) && estimate_error(image_writer))
        continue;
}

static void *image_writer_run(void *argument)
{
    image_writer_t *image_writer = argument;
    while (!atomic_load(&image_writer->stop)) {
        wake_wait(image_writer->options.image_wake, 1000);
        serve_farm(image_writer);
        for (image_request_t request;
             !atomic_load(&image_writer->stop) && next_request(image_writer, &request);) {
            answer_request(image_writer, &request);
            serve_farm(image_writer);
            estimate_error(image_writer); /* however many ask: a job that is to reach an error waits for it */
        }
        estimate_errors(image_writer);
        pthread_mutex_lock(&image_writer->lock);
        drop_old(image_writer, clock_now());
        pthread_mutex_unlock(&image_writer->lock);
    }
    serve_farm(image_writer);
    return NULL;
}

/* ---- the public functions ------------------------------------------------------------------------------ */

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
    if (mkdir(path, 0700) != 0 && errno != EEXIST)
        result = result_fail(RESULT_IO, "cannot make the directory %s: %s", path, strerror(errno));
    DIR *directory = opendir(path);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;)
        if (entry->d_name[0] != '.') unlinkat(dirfd(directory), entry->d_name, 0);
    if (directory != NULL) closedir(directory);
    free(path);
    return result;
}

static void free_image_writer(image_writer_t *image_writer)
{
    for (size_t i = 0; i < IMAGE_WRITER_MAX_SNAPSHOTS; i++) snapshot_drop(&image_writer->snapshots[i]);
    pthread_mutex_destroy(&image_writer->lock);
    mattes_free(&image_writer->mattes);
    free(image_writer->data_dir);
    free(image_writer);
}

result_t image_writer_start(const image_writer_options_t *options, image_writer_t **out)
{
    drop_leftovers(options->data_dir);
    TRY(prepare_directory(options->data_dir));
    image_writer_t *image_writer = mem_zalloc(1, sizeof *image_writer);
    image_writer->options = *options;
    image_writer->data_dir = mem_strdup(options->data_dir);
    pthread_mutex_init(&image_writer->lock, NULL);
    result_t result = thread_start(&image_writer->thread, "lm-image_writer", image_writer_run, image_writer);
    if (result.code == RESULT_OK)
        *out = image_writer;
    else
        free_image_writer(image_writer);
    return result;
}

void image_writer_stop(image_writer_t **out)
{
    image_writer_t *image_writer = *out;
    if (image_writer == NULL) return;
    atomic_store(&image_writer->stop, true);
    wake_up(image_writer->options.image_wake);
    pthread_join(image_writer->thread, NULL);
    free_image_writer(image_writer);
    *out = NULL;
}

result_t image_writer_ask(image_writer_t *image_writer, const image_request_t *request)
{
    pthread_mutex_lock(&image_writer->lock);
    bool room = image_writer->waiting_count < IMAGE_WRITER_MAX_WAITING &&
                !(image_writer->closed && request->done != NULL);
    if (room) image_writer->waiting[image_writer->waiting_count++] = *request;
    pthread_mutex_unlock(&image_writer->lock);
    if (!room)
        return result_fail(RESULT_LIMIT, "%d images are asked for already, or the master ends: try again",
                           IMAGE_WRITER_MAX_WAITING);
    wake_up(image_writer->options.image_wake);
    return result_ok();
}

/* Takes out a request of who is told by a call. */
static bool take_told(image_writer_t *image_writer, image_request_t *request)
{
    size_t at = 0;
    pthread_mutex_lock(&image_writer->lock);
    image_writer->closed = true;
    while (at < image_writer->waiting_count && image_writer->waiting[at].done == NULL) at++;
    bool found = at < image_writer->waiting_count;
    if (found) {
        *request = image_writer->waiting[at];
        image_writer->waiting_count--;
        memmove(image_writer->waiting + at, image_writer->waiting + at + 1,
                (image_writer->waiting_count - at) * sizeof *request);
    }
    pthread_mutex_unlock(&image_writer->lock);
    return found;
}

void image_writer_close(image_writer_t *image_writer)
{
    if (image_writer == NULL) return;
    result_t ends = result_fail(RESULT_LIMIT, "the master ends: try again later");
    for (image_request_t request; take_told(image_writer, &request);)
        request.done(request.context, &ends, NULL);
}

bool image_writer_next_answer(image_writer_t *image_writer, image_request_t *request, result_t *result,
                              uint64_t *snapshot)
{
    pthread_mutex_lock(&image_writer->lock);
    bool found = image_writer->answer_count > 0;
    if (found) {
        *request = image_writer->answers[0].request;
        *result = image_writer->answers[0].result;
        *snapshot = image_writer->answers[0].snapshot;
        image_writer->answer_count--;
        memmove(image_writer->answers, image_writer->answers + 1,
                image_writer->answer_count * sizeof *image_writer->answers);
    }
    pthread_mutex_unlock(&image_writer->lock);
    if (found) wake_up(image_writer->options.image_wake); /* there is room for an answer again */
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

result_t image_writer_read(image_writer_t *image_writer, uint64_t id, uint64_t offset, void *bytes,
                           size_t *length, uint64_t *size)
{
    result_t result = result_fail(RESULT_INPUT, "this image is no longer kept: ask for a new one");
    pthread_mutex_lock(&image_writer->lock);
    for (size_t i = 0; id != 0 && i < IMAGE_WRITER_MAX_SNAPSHOTS; i++) {
        snapshot_t *snapshot = &image_writer->snapshots[i];
        if (snapshot->id != id) continue;
        result = read_snapshot(snapshot, offset, bytes, length);
        *size = snapshot->size;
        snapshot->last_used = clock_now();
    }
    pthread_mutex_unlock(&image_writer->lock);
    return result;
}
