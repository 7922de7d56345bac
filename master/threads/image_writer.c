/* image_writer: see image_writer.h.
 *
 * DESIGN. The thread sleeps on the farm's eventfd, which image_writer_ask writes as well. Woken, it first
 * sees to jobs that are over or stand at a milestone, then to requests. The final image of a job is a
 * snapshot too, whose file is not deleted with it; in another format it is made from the float file, since
 * the film is gone.
 *
 * An image may take minutes. Those who wait for it can be told how far it is; when the last of them is gone,
 * it is given up. */
#include "master/threads/image_writer.h"

#include "common/film/picture.h"
#include "common/own_directory.h"
#include "common/thread.h"
#include "common/wake.h"
#include "master/threads/stored_film.h"

#include <dirent.h>
#include <errno.h>
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
    image_request_t request;
    result_t result;
    uint64_t snapshot;
} answer_t;

struct image_writer {
    image_writer_options_t options;
    char *data_dir;
    pthread_t thread;
    atomic_bool stop;
    mattes_t *mattes;    /* the thread's own: of the scene that was needed last; NULL: none was */
    hash_t mattes_scene; /* its blob */
    snapshots_t *snapshots;
    image_writing_t writing; /* of the file that is being written */
    pthread_mutex_t lock;    /* guards what follows */
    bool closed;             /* image_writer_close */
    image_request_t current; /* the request that is being served; job 0: none */
    bool abandoned;          /* who made it is gone */
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
                            const mattes_t *mattes, uint32_t milestone, const image_format_t *format,
                            image_writing_t *writing)
{
    picture_meta_t meta = {.scene = record->blob,
                           .scene_name = record->terms.name,
                           .settings = record->settings,
                           .counts = record->counts,
                           .workers = record->workers_seen,
                           .wall_seconds = record->elapsed,
                           .bits = record->fingerprint,
                           .mattes = mattes,
                           .writing = writing,
                           .note = record->message};
    if (milestone > 0) end_at(&meta.settings, milestone);
    return format->png ? picture_write_png(path, film, format->exposure)
                       : picture_write_exr(path, film, &meta, format->half);
}

/* Resolves the film as it is now and writes it; `writing`: a snapshot. */
static result_t write_film(image_writer_t *image_writer, job_t *job, const char *path, uint32_t milestone,
                           const image_format_t *format, image_writing_t *writing)
{
    film_extras_t extras = {.halves = format->halves || farm_job_halves(image_writer->options.farm, job),
                            .groups = !format->png,
                            .mattes = format->png ? NULL : find_mattes(image_writer, job)};
    film_image_t film = {0};
    job_report_t report;
    TRY(farm_resolve(image_writer->options.farm, clock_now(), job, &extras, &film, &report));
    result_t result = write_image(path, &film, &report.record, extras.mattes, milestone, format, writing);
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
    result_t result = write_image(path, &film, &record, extras.mattes, 0, format, &image_writer->writing);
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
static result_t write_halves(const char *from, const char *path, image_writing_t *writing)
{
    image_t image = {0}, halves;
    TRY(image_read_exr(from, &image));
    image_init(&halves, image.width, image.height);
    halves.writing = writing;
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
    result_t result = write_film(image_writer, job, path, milestone, &format, NULL);
    job_settings_t settings = farm_job_settings(image_writer->options.farm, job);
    bool again = result.code == RESULT_IO && checkpointer != NULL &&
                 checkpointer_make_room(checkpointer, largest_file(&settings));
    if (again) result = write_film(image_writer, job, path, milestone, &format, NULL);
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

/* ---- requests ------------------------------------------------------------------------------------------ */

/* Why there is no file that a snapshot is to be made from. */
static result_t no_image(const image_writer_t *image_writer, const job_t *job, const snapshot_t *snapshot)
{
    unsigned long long number = snapshot->key.job;
    if (snapshot->key.at == 0) return result_fail(RESULT_INPUT, "job %llu has no image", number);
    job_settings_t settings = farm_job_settings(image_writer->options.farm, job);
    if (job_next_milestone(&settings, snapshot->key.at - 1) == snapshot->key.at)
        return result_fail(RESULT_INPUT, "job %llu has no image at %u samples a pixel yet", number,
                           snapshot->key.at);
    return result_fail(RESULT_INPUT,
                       "job %llu keeps no image at %u samples a pixel: submit it with --save-at %u", number,
                       snapshot->key.at, snapshot->key.at);
}

/* An image of a milestone has the halves only if the job was submitted so, and there is no film of it. */
static result_t no_halves(const snapshot_t *snapshot)
{
    return result_fail(RESULT_INPUT,
                       "job %llu was submitted without --halves, so its image at %u samples a pixel is kept "
                       "without",
                       (unsigned long long)snapshot->key.job, snapshot->key.at);
}

/* Writes the file of a snapshot, unless it is there. */
static result_t write_snapshot(image_writer_t *image_writer, job_t *job, const snapshot_t *snapshot,
                               const char *final, bool lacks_halves)
{
    const image_format_t *format = &snapshot->key.format;
    if (!snapshot->key.over)
        return write_film(image_writer, job, snapshot->path, 0, format, &image_writer->writing);
    if (access(final, R_OK) != 0) return no_image(image_writer, job, snapshot);
    if (lacks_halves && snapshot->key.at > 0) return no_halves(snapshot);
    if (lacks_halves) return write_stored(image_writer, job, snapshot->path, format);
    if (format->png) return write_png(final, snapshot->path, format->exposure);
    return format->half ? write_halves(final, snapshot->path, &image_writer->writing) : result_ok();
}

/* Prepares what is told of a snapshot, and how large its file may be. */
static result_t begin_writing(image_writer_t *image_writer, const job_t *job, const snapshot_t *snapshot)
{
    image_writing_t *writing = &image_writer->writing;
    job_settings_t settings = farm_job_settings(image_writer->options.farm, job);
    uint64_t pixels = (uint64_t)settings.width * (uint64_t)settings.height;
    uint64_t largest = snapshot->key.format.png ? 4 * pixels : largest_file(&settings), room = UINT64_MAX;
    if (!snapshot->keep) TRY(snapshots_room(image_writer->snapshots, clock_now(), largest, &room));
    if (snapshot->key.format.png && room < largest) return snapshots_refusal(image_writer->snapshots);
    writing->limit = room;
    writing->fleeting = true;
    return result_ok();
}

/* Makes a snapshot of a key: fills in the rest. */
static result_t take_snapshot(image_writer_t *image_writer, job_t *job, snapshot_t *snapshot)
{
    char *final = snapshot->key.at > 0
                      ? milestone_path(image_writer->data_dir, snapshot->key.job, snapshot->key.at)
                      : image_writer_image_path(image_writer->data_dir, snapshot->key.job);
    const image_format_t *format = &snapshot->key.format;
    bool lacks_halves =
        snapshot->key.over && format->halves && !farm_job_halves(image_writer->options.farm, job);
    double begin = clock_now();
    struct stat status;
    snapshot->keep = snapshot->key.over && !format->half && !format->png && !lacks_halves;
    if (snapshot->keep) snapshot->path = mem_strdup(final);
    snapshots_name(image_writer->snapshots, snapshot);
    result_t result = begin_writing(image_writer, job, snapshot);
    if (result.code == RESULT_OK) result = write_snapshot(image_writer, job, snapshot, final, lacks_halves);
    if (image_writer->writing.too_large) result = snapshots_refusal(image_writer->snapshots);
    if (result.code == RESULT_OK && stat(snapshot->path, &status) != 0)
        result = result_fail(RESULT_IO, "cannot read %s: %s", snapshot->path, strerror(errno));
    if (result.code == RESULT_OK) snapshot->size = (uint64_t)status.st_size;
    snapshot->seconds = clock_now() - begin;
    free(final);
    return result;
}

static image_key_t request_key(const image_request_t *request)
{
    return (image_key_t){
        .job = request->job, .format = request->format, .at = request->at, .over = request->at > 0};
}

/* Finds or makes the snapshot that a request asks for. */
static result_t serve_request(image_writer_t *image_writer, job_t *job, const image_request_t *request,
                              uint64_t *id)
{
    snapshot_t wanted = {.key = request_key(request)};
    if (request->at == 0)
        wanted.key.version = farm_image_version(image_writer->options.farm, job, &wanted.key.over);
    *id = snapshots_find(image_writer->snapshots, clock_now(), &wanted.key);
    if (*id != 0) return result_ok();
    result_t result = take_snapshot(image_writer, job, &wanted);
    if (result.code == RESULT_OK)
        snapshots_put(image_writer->snapshots, clock_now(), &wanted);
    else
        free(wanted.path);
    *id = wanted.id;
    return result;
}

/* Calls who is to be told. */
static void tell(image_writer_t *image_writer, answer_t *answer)
{
    image_file_t file = {.descriptor = -1};
    if (answer->result.code == RESULT_OK)
        answer->result = snapshots_open(image_writer->snapshots, answer->snapshot, &file);
    answer->request.done(answer->request.context, &answer->result, &file);
}

/* The current request is served. Who is not told by a call gets the answer later, unless he is gone. */
static void end_serving(image_writer_t *image_writer, const answer_t *answer)
{
    pthread_mutex_lock(&image_writer->lock);
    image_writer->current = (image_request_t){.job = 0};
    if (answer->request.done == NULL && !image_writer->abandoned) {
        if (answer->result.code == RESULT_OK) snapshots_give(image_writer->snapshots, answer->snapshot);
        image_writer->answers[image_writer->answer_count++] = *answer;
    }
    pthread_mutex_unlock(&image_writer->lock);
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
    end_serving(image_writer, &answer);
    if (request->done != NULL)
        tell(image_writer, &answer);
    else
        wake_up(image_writer->options.answer_wake);
}

/* The one to be served next: whom an image that is there can serve does not wait for those before. */
static size_t choose_request(const image_writer_t *image_writer)
{
    double now = clock_now();
    for (size_t i = 1; i < image_writer->waiting_count; i++) {
        image_key_t key = request_key(&image_writer->waiting[i]);
        if (snapshots_find(image_writer->snapshots, now, &key) != 0) return i;
    }
    return 0;
}

static void remove_waiting(image_writer_t *image_writer, size_t at)
{
    image_request_t *waiting = image_writer->waiting;
    image_writer->waiting_count--;
    memmove(waiting + at, waiting + at + 1, (image_writer->waiting_count - at) * sizeof *waiting);
}

/* From now on the request is the current one; under the lock. */
static void begin_serving(image_writer_t *image_writer, const image_request_t *request)
{
    image_writing_t *writing = &image_writer->writing;
    image_writer->current = *request;
    image_writer->abandoned = false;
    atomic_store(&writing->done, 0);
    atomic_store(&writing->total, 0);
    atomic_store(&writing->cancel, false);
    writing->too_large = false;
}

/* The next request, as long as there is room for its answer. */
static bool next_request(image_writer_t *image_writer, image_request_t *request)
{
    pthread_mutex_lock(&image_writer->lock);
    bool found = image_writer->waiting_count > 0 && image_writer->answer_count < IMAGE_WRITER_MAX_WAITING;
    if (found) {
        size_t at = choose_request(image_writer);
        *request = image_writer->waiting[at];
        remove_waiting(image_writer, at);
        begin_serving(image_writer, request);
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
        snapshots_drop_old(image_writer->snapshots, clock_now());
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

static void free_image_writer(image_writer_t *image_writer)
{
    snapshots_free(&image_writer->snapshots);
    pthread_mutex_destroy(&image_writer->lock);
    mattes_free(&image_writer->mattes);
    free(image_writer->data_dir);
    free(image_writer);
}

result_t image_writer_start(const image_writer_options_t *options, image_writer_t **out)
{
    snapshots_t *snapshots;
    TRY(snapshots_new(options->data_dir, options->snapshot_limit, &snapshots));
    drop_leftovers(options->data_dir);
    image_writer_t *image_writer = mem_zalloc(1, sizeof *image_writer);
    image_writer->options = *options;
    image_writer->data_dir = mem_strdup(options->data_dir);
    image_writer->snapshots = snapshots;
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
        remove_waiting(image_writer, at);
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

/* Whether two requests are for the same image of a moment. */
static bool same_wish(const image_request_t *a, const image_request_t *b)
{
    return a->job == b->job && a->at == b->at && image_format_equal(&a->format, &b->format);
}

/* Under the lock. */
static image_news_t news_of(const image_writer_t *image_writer, const image_request_t *request, size_t before)
{
    const image_writing_t *writing = &image_writer->writing;
    image_news_t news = {.identity = request->identity, .request = request->request};
    bool current = image_writer->current.job != 0 && same_wish(request, &image_writer->current);
    size_t total = atomic_load(&writing->total);
    if (!current) news.before = (uint32_t)before;
    if (current && total > 0) news.share = (float)atomic_load(&writing->done) / (float)total;
    return news;
}

size_t image_writer_news(image_writer_t *image_writer, image_news_t news[IMAGE_WRITER_MAX_NEWS])
{
    size_t count = 0;
    pthread_mutex_lock(&image_writer->lock);
    const image_request_t *current = &image_writer->current;
    size_t busy = current->job != 0;
    if (busy && current->progress && !image_writer->abandoned)
        news[count++] = news_of(image_writer, current, 0);
    for (size_t i = 0; i < image_writer->waiting_count; i++)
        if (image_writer->waiting[i].progress)
            news[count++] = news_of(image_writer, &image_writer->waiting[i], i + busy);
    pthread_mutex_unlock(&image_writer->lock);
    return count;
}

static bool is_from(const image_request_t *request, const identity_t *identity, uint64_t number)
{
    return request->done == NULL && request->request == number && request->identity.size == identity->size &&
           memcmp(request->identity.bytes, identity->bytes, identity->size) == 0;
}

/* Nobody waits for what is being made. */
static bool is_unwanted(const image_writer_t *image_writer)
{
    bool wanted = !image_writer->abandoned;
    for (size_t i = 0; i < image_writer->waiting_count; i++)
        wanted |= same_wish(&image_writer->waiting[i], &image_writer->current);
    return !wanted;
}

void image_writer_forget(image_writer_t *image_writer, const identity_t *identity, uint64_t request)
{
    pthread_mutex_lock(&image_writer->lock);
    for (size_t i = image_writer->waiting_count; i-- > 0;)
        if (is_from(&image_writer->waiting[i], identity, request)) remove_waiting(image_writer, i);
    bool busy = image_writer->current.job != 0;
    if (busy && is_from(&image_writer->current, identity, request)) image_writer->abandoned = true;
    if (busy && is_unwanted(image_writer)) atomic_store(&image_writer->writing.cancel, true);
    pthread_mutex_unlock(&image_writer->lock);
}

result_t image_writer_read(image_writer_t *image_writer, uint64_t id, uint64_t offset, void *bytes,
                           size_t *length, uint64_t *size)
{
    return snapshots_read(image_writer->snapshots, clock_now(), id, offset, bytes, length, size);
}
