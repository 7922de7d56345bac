/* checkpointer: see checkpointer.h.
 *
 * DESIGN. A checkpoint is a snapshot (shared_film.h) written at leisure: merging and scheduling go on. What
 * it costs is measured, as time and as a share of the cores, and after it there is a pause of REST times as
 * much, in which only last checkpoints of jobs that end are written: so checkpoints take less than 2% of the
 * time. A master that has run for long is likely to run on: the pause grows to twice the time since its
 * start, up to LONG_REST times the cost. So a crash never costs more than two thirds of what was rendered
 * since then, a master that crashes again and again gets on, and one that runs takes a quarter of a percent.
 * Where that pause would be too long (a large film, a busy machine, a slow disk), --checkpoint-max ends it:
 * the next checkpoint begins so early that it is on the disk before the samples of the last one are that
 * old. It costs more then, but never more than half of the time. A whole film is written each time: while a
 * job is at work each batch changes nearly every page, so that what did not change is not worth looking for.
 *
 * When the disk is full, nothing is lost: the films stay in memory and merging goes on. Films of jobs that
 * are over and not retained make room, oldest first. Where that is not enough, checkpoints pause, with a
 * warning that is repeated; before each new attempt the room is looked at, since a film that is written in
 * vain costs as much as any other.
 *
 * A checkpoint that cannot be read is told from one that is damaged. What is damaged is set aside and the one
 * before is used. What cannot be read for the moment (an I/O error, a later version) is left alone; when
 * nothing else is there, the job fails rather than begins anew, and can be extended when the disk is well
 * again. */
#include "master/threads/checkpointer.h"

#include "common/thread.h"
#include "common/wake.h"
#include "master/store/checkpoint.h"
#include "master/store/film_load.h"

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum {
    REST = 49,       /* times the cost of a checkpoint: 1 / 50 of the time is spent on it; */
    LONG_REST = 399, /* or 1 / 400, when the master has run for half of that time */
    MARGIN = 2,      /* a checkpoint may take so many times what the last one took, and be there in time; */
    THIN = 8,        /* or so many, while most of the film was empty then */
    MAX_DOUBLINGS = 3,
    RETRY = 5,       /* seconds between attempts when checkpoints fail */
    WARN_EVERY = 60, /* seconds between warnings that they do */
    KEEP = 2,        /* checkpoints of a job that is not over */
    PATIENCE = 1     /* seconds between looks at what there is to do */
};

struct checkpointer {
    checkpointer_options_t options;
    pthread_t thread;
    atomic_bool stop;
    bool finished;           /* the thread has been joined */
    pthread_mutex_t custody; /* held while it is decided whether a film is needed, and while it is deleted */
    int cores;
    double started; /* seconds; when the master did */
    /* the thread's own */
    double not_before; /* seconds, when checkpoints have cost so little that the next may be made */
    double busy_until; /* seconds, when they have cost half of the time: none is made before */
    double slow_told;  /* seconds, when it was last complained that they take too long */
    int failures;      /* since the last success */
    double retry_at;   /* seconds; after a failure */
    double warned_at;  /* seconds, when the last of them was complained of */
};

/* "123 pixel samples (45.6%)", the share as far as it is known. */
static void describe_samples(const job_record_t *record, uint64_t samples, char text[80])
{
    uint64_t wanted = job_total_samples(&record->settings);
    if (wanted > 0)
        snprintf(text, 80, "%llu pixel samples (%.1f%%)", (unsigned long long)samples,
                 100 * (double)samples / (double)wanted);
    else
        snprintf(text, 80, "%llu pixel samples", (unsigned long long)samples);
}

static void note(checkpointer_t *checkpointer, uint64_t job, const char *event, const char *text)
{
    result_t result = journal_note(checkpointer->options.journal, job, event, text);
    if (result.code != RESULT_OK) log_debug("%s", result.message);
}

/* ---- loading ------------------------------------------------------------------------------------------- */

/* Tells what a checkpoint that could not be used has cost. */
static void tell_loss(checkpointer_t *checkpointer, job_t *job, const job_record_t *record,
                      const film_load_t *load)
{
    char text[500];
    uint64_t most = load->most > 0 ? load->most : record->samples_done;
    uint64_t have = load->film != NULL ? load->info.samples : 0, lost = most > have ? most - have : 0;
    snprintf(text, sizeof text,
             "a checkpoint could not be used (%.250s): %s; %s%llu pixel samples are rendered again",
             load->failure.message,
             load->film != NULL ? "the one before is" : "there is no other, the job begins anew",
             load->most > 0 ? "" : "about ", (unsigned long long)lost);
    note(checkpointer, record->job, "checkpoint damaged", text);
    farm_note(checkpointer->options.farm, job, text);
    log_error("job %llu: %s", (unsigned long long)record->job, text);
}

static void tell_loaded(const job_record_t *record, const film_load_t *load, double seconds)
{
    char text[80];
    if (load->film == NULL) {
        log_info("job %llu has no checkpoint: it begins anew", (unsigned long long)record->job);
        return;
    }
    describe_samples(record, load->info.samples, text);
    log_info("job %llu: checkpoint %llu, %.0f s old, holds %s; it was read in %.2f s",
             (unsigned long long)record->job, (unsigned long long)load->info.generation,
             fmax(0, clock_wall() - load->info.written), text, seconds);
}

static void load_film(checkpointer_t *checkpointer, job_t *job)
{
    farm_t *farm = checkpointer->options.farm;
    double start = clock_now();
    job_record_t record = farm_record(farm, start, job);
    film_load_t load = film_load(checkpointer->options.films, &record, checkpointer->cores);
    if (load.film == NULL && load.unreadable) {
        farm_load_failed(farm, clock_now(), job, load.failure.message);
        return;
    }
    if (load.failure.code != RESULT_OK) tell_loss(checkpointer, job, &record, &load);
    tell_loaded(&record, &load, clock_now() - start);
    result_t result = farm_loaded(farm, clock_now(), job, load.film, &load.state);
    if (result.code != RESULT_OK) log_error("job %llu: %s", (unsigned long long)record.job, result.message);
}

static void load_films(checkpointer_t *checkpointer)
{
    farm_t *farm = checkpointer->options.farm;
    for (job_t *job; !atomic_load(&checkpointer->stop) && (job = farm_next_load(farm)) != NULL;) {
        load_film(checkpointer, job);
        farm_unpin(farm, job);
    }
}

/* ---- room ---------------------------------------------------------------------------------------------- */

/* A job that is over, may go, and has films. */
typedef struct {
    uint64_t job, bytes;
    double finished;
} spare_t;

static int by_end(const void *a, const void *b)
{
    double x = ((const spare_t *)a)->finished, y = ((const spare_t *)b)->finished;
    return x < y ? -1 : x > y;
}

static bool is_spare(const job_report_t *report)
{
    return job_state_final((uint32_t)report->record.state) && !report->record.retained;
}

/* Those jobs, the first to end first, in fresh memory; *bytes is what their films take. */
static spare_t *find_spares(const checkpointer_t *checkpointer, size_t *count, uint64_t *bytes)
{
    size_t jobs;
    uint32_t workers;
    job_report_t *reports = farm_report(checkpointer->options.farm, clock_now(), 0, &jobs, &workers);
    spare_t *spares = mem_alloc((jobs + 1) * sizeof *spares);
    *count = 0;
    *bytes = 0;
    for (size_t i = 0; i < jobs; i++) {
        spare_t spare = {reports[i].record.job,
                         film_store_bytes(checkpointer->options.films, reports[i].record.job),
                         reports[i].record.finished};
        if (!is_spare(&reports[i]) || spare.bytes == 0) continue;
        spares[(*count)++] = spare;
        *bytes += spare.bytes;
    }
    free(reports);
    qsort(spares, *count, sizeof *spares, by_end);
    return spares;
}

/* Deletes the films of a job, unless it is needed after all. */
static uint64_t drop_film(checkpointer_t *checkpointer, uint64_t job)
{
    size_t count;
    uint32_t workers;
    uint64_t bytes = 0;
    pthread_mutex_lock(&checkpointer->custody);
    job_report_t *report = farm_report(checkpointer->options.farm, clock_now(), job, &count, &workers);
    if (report != NULL && is_spare(report)) bytes = film_store_delete(checkpointer->options.films, job);
    pthread_mutex_unlock(&checkpointer->custody);
    free(report);
    if (bytes == 0) return 0;
    log_info(
        "the film of job %llu (%.1f MB) goes to make room: the job is over and not retained; its image stays",
        (unsigned long long)job, 1e-6 * (double)bytes);
    note(checkpointer, job, "film dropped", "to make room");
    return bytes;
}

/* Keeps what films of jobs that are over take under the limit. */
static void enforce_limit(checkpointer_t *checkpointer)
{
    size_t count;
    uint64_t bytes;
    spare_t *spares = find_spares(checkpointer, &count, &bytes);
    for (size_t i = 0; i < count && bytes > checkpointer->options.keep_bytes; i++)
        if (drop_film(checkpointer, spares[i].job) > 0) bytes -= spares[i].bytes;
    free(spares);
}

bool checkpointer_make_room(checkpointer_t *checkpointer, uint64_t needed)
{
    size_t count;
    uint64_t bytes;
    if (film_store_room(checkpointer->options.films) >= needed) return true;
    spare_t *spares = find_spares(checkpointer, &count, &bytes);
    for (size_t i = 0; i < count && film_store_room(checkpointer->options.films) < needed; i++)
        drop_film(checkpointer, spares[i].job);
    free(spares);
    return film_store_room(checkpointer->options.films) >= needed;
}

/* The job's last checkpoint; all zero when there is none. */
static film_file_t last_file(const checkpointer_t *checkpointer, uint64_t job)
{
    size_t count;
    film_file_t *files = film_store_list(checkpointer->options.films, job, &count);
    film_file_t last = count > 0 ? files[0] : (film_file_t){.bytes = 0};
    free(files);
    return last;
}

/* About what a checkpoint takes on the disk when every pixel has samples: a quarter of the film. */
static uint64_t full_bytes(const job_record_t *record)
{
    return (uint64_t)shared_film_page_count(&record->settings) * SHARED_FILM_PAGE_BYTES / 4;
}

/* What the job's next checkpoint will take on the disk: about what its last one took, or, when there was
 * none, what a full one takes; *sure says which. */
static uint64_t expected_bytes(const checkpointer_t *checkpointer, const job_record_t *record, bool *sure)
{
    uint64_t bytes = last_file(checkpointer, record->job).bytes;
    *sure = bytes > 0;
    return *sure ? bytes + bytes / 10 + (1 << 20) : full_bytes(record);
}

/* Seconds that the job's next checkpoint may take: the last one may have found the film empty yet. */
static double longest(const checkpointer_t *checkpointer, const job_record_t *record)
{
    film_file_t file = last_file(checkpointer, record->job);
    if (file.bytes == 0) return 0;
    return file.seconds * fmin(fmax((double)full_bytes(record) / (double)file.bytes, MARGIN), THIN);
}

/* Sees to it that there is room for a checkpoint. Where that is not certain it is tried. */
static result_t prepare_disk(checkpointer_t *checkpointer, const job_record_t *record)
{
    bool sure;
    uint64_t least = expected_bytes(checkpointer, record, &sure);
    /* Twice as much after each failure: then the guess was wrong, or others want room as well. */
    checkpointer_make_room(checkpointer, least << int_min(checkpointer->failures, MAX_DOUBLINGS));
    uint64_t room = film_store_room(checkpointer->options.films);
    if (!sure || room >= least) return result_ok();
    return result_fail(RESULT_IO,
                       "the disk is full: a checkpoint of job %llu takes %.1f MB, %.1f MB are free",
                       (unsigned long long)record->job, 1e-6 * (double)least, 1e-6 * (double)room);
}

/* ---- checkpoints --------------------------------------------------------------------------------------- */

/* A checkpoint could not be written. */
static void on_failure(checkpointer_t *checkpointer, uint64_t job, result_t failure)
{
    double now = clock_now();
    if (checkpointer->failures++ == 0) note(checkpointer, job, "checkpoints paused", failure.message);
    checkpointer->retry_at =
        fmax(now + RETRY, fmin(checkpointer->not_before, now + checkpointer->options.most));
    if (checkpointer->warned_at > 0 && now - checkpointer->warned_at < WARN_EVERY) return;
    checkpointer->warned_at = now;
    log_error(
        "CHECKPOINTS PAUSE: %s; rendering goes on, but what comes after the last checkpoint of job %llu "
        "lives in memory only: make room, they go on by themselves",
        failure.message, (unsigned long long)job);
}

static void on_success(checkpointer_t *checkpointer, uint64_t job)
{
    if (checkpointer->failures > 0) {
        log_info("checkpoints go on");
        note(checkpointer, job, "checkpoints go on", "");
    }
    checkpointer->failures = 0;
    checkpointer->warned_at = 0;
}

/* The job may have been deleted meanwhile: then nobody would ever delete this file. */
static void keep_file(checkpointer_t *checkpointer, const film_file_t *file, bool over)
{
    pthread_mutex_lock(&checkpointer->custody);
    film_store_add(checkpointer->options.films, file, over ? 1 : KEEP);
    job_t *job = farm_pin(checkpointer->options.farm, file->job);
    if (job == NULL)
        film_store_delete(checkpointer->options.films, file->job);
    else
        farm_unpin(checkpointer->options.farm, job);
    pthread_mutex_unlock(&checkpointer->custody);
}

/* Accounts for a checkpoint that took so many seconds, and what `cost` says. */
static void rest(checkpointer_t *checkpointer, double seconds, const checkpoint_cost_t *cost)
{
    double now = clock_now();
    double spent = fmax(seconds, cost->cpu / checkpointer->cores);
    checkpointer->not_before =
        now + fmax(REST * spent, fmin(LONG_REST * spent, 2 * (now - checkpointer->started)));
    checkpointer->busy_until = now + seconds;
}

/* Writes the checkpoint of a snapshot. */
static result_t write_snapshot(checkpointer_t *checkpointer, checkpoint_info_t *info,
                               const schedule_state_t *state, shared_film_snapshot_t *snapshot)
{
    film_store_t *films = checkpointer->options.films;
    checkpoint_cost_t cost;
    info->generation = film_store_next(films, info->record.job);
    info->written = clock_wall();
    char *path = film_store_path(films, info->record.job, info->generation);
    double start = clock_now();
    result_t result = farm_sync(checkpointer->options.farm);
    cost = (checkpoint_cost_t){.wall = 0};
    if (result.code == RESULT_OK)
        result = checkpoint_write(path, info, state, snapshot, int_max(1, checkpointer->cores / 2), &cost);
    free(path);
    double seconds = clock_now() - start;
    rest(checkpointer, seconds, &cost);
    if (result.code != RESULT_OK) return result;
    log_debug("job %llu: checkpoint %llu of %llu pixel samples, %.1f MB in %.2f s, %.2f CPU s",
              (unsigned long long)info->record.job, (unsigned long long)info->generation,
              (unsigned long long)info->samples, 1e-6 * (double)cost.bytes, cost.wall, cost.cpu);
    keep_file(checkpointer, &(film_file_t){info->record.job, info->generation, cost.bytes, seconds},
              info->record.state == JOB_FINISHING);
    return result;
}

/* Writes a checkpoint of a pinned job; *taken: when its snapshot was. RESULT_CANCELLED when its film is freed
 * already. */
static result_t write_film(checkpointer_t *checkpointer, job_t *job, checkpoint_info_t *info, double *taken)
{
    farm_t *farm = checkpointer->options.farm;
    schedule_state_t state;
    shared_film_snapshot_t *snapshot;
    TRY(prepare_disk(checkpointer, &info->record));
    if (!farm_snapshot(farm, job, &state, &snapshot))
        return result_fail(RESULT_CANCELLED, "the film is gone");
    *taken = clock_now();
    info->record = farm_record(farm, clock_now(), job);
    result_t result = write_snapshot(checkpointer, info, &state, snapshot);
    shared_film_snapshot_free(&snapshot);
    schedule_state_free(&state);
    return result;
}

/* Writes a checkpoint of a pinned job and tells the farm; `last`: it is waited for. */
static result_t save_film(checkpointer_t *checkpointer, job_t *job, bool last)
{
    farm_t *farm = checkpointer->options.farm;
    checkpoint_info_t info = {.record = farm_record(farm, clock_now(), job)};
    double taken = clock_now();
    result_t result = write_film(checkpointer, job, &info, &taken);
    if (result.code == RESULT_CANCELLED) return result;
    farm_checkpointed(farm, taken, job, result);
    if (result.code != RESULT_OK) {
        on_failure(checkpointer, info.record.job, result);
        return result;
    }
    on_success(checkpointer, info.record.job);
    if (last && info.record.state != JOB_FINISHING) { /* the process ends */
        char text[80];
        describe_samples(&info.record, info.samples, text);
        log_info("job %llu is saved: %s", (unsigned long long)info.record.job, text);
    }
    return result;
}

/* In how many seconds the checkpoint of a job is due that has had work in none for `age` seconds. */
static double next_in(const checkpointer_t *checkpointer, const job_t *job, double now, double age)
{
    job_record_t record = farm_record(checkpointer->options.farm, now, job);
    double pause = fmax(checkpointer->options.interval - age, checkpointer->not_before - now);
    double late = checkpointer->options.most - age - longest(checkpointer, &record);
    return fmax(fmin(pause, late), checkpointer->busy_until - now);
}

/* Tells when what a crash costs was more than it is to be, although nothing failed. */
static void check_age(checkpointer_t *checkpointer, uint64_t job, double age)
{
    double now = clock_now();
    if (age <= checkpointer->options.most || checkpointer->failures > 0) return;
    if (checkpointer->slow_told > 0 && now - checkpointer->slow_told < WARN_EVERY) return;
    checkpointer->slow_told = now;
    log_warning("job %llu: its work was in no checkpoint for %.0f s, longer than --checkpoint-max (%.0f s), "
                "since one takes %.0f s: a faster disk helps, fewer large jobs at a time, or a longer "
                "--checkpoint-max",
                (unsigned long long)job, age, checkpointer->options.most,
                last_file(checkpointer, job).seconds);
}

/* Makes the checkpoints that are due; returns in how many seconds there may be one again. */
static double save_films(checkpointer_t *checkpointer)
{
    farm_t *farm = checkpointer->options.farm;
    double interval = checkpointer->options.interval, patience = fmin(PATIENCE, interval);
    while (!atomic_load(&checkpointer->stop)) {
        double age, now = clock_now();
        bool last;
        if (now < checkpointer->retry_at) return patience;
        job_t *job = farm_next_checkpoint(farm, now, &age, &last);
        if (job == NULL) return patience;
        uint64_t number = farm_job_id(job);
        double wait = last ? 0 : next_in(checkpointer, job, now, age);
        bool saved = wait <= 0 && save_film(checkpointer, job, last).code != RESULT_CANCELLED;
        farm_unpin(farm, job);
        if (saved && !last) check_age(checkpointer, number, age + clock_now() - now);
        if (!saved) return wait > 0 ? fmin(patience, wait) : patience;
        if (last) enforce_limit(checkpointer);
    }
    return 0;
}

/* The process ends: everything that no checkpoint holds is saved. What cannot be is not tried again. */
static void save_all(checkpointer_t *checkpointer)
{
    farm_t *farm = checkpointer->options.farm;
    double age;
    bool last, good = true;
    checkpointer->warned_at = 0;
    for (job_t *job; good && (job = farm_next_checkpoint(farm, clock_now(), &age, &last)) != NULL;) {
        result_t result = save_film(checkpointer, job, true);
        good = result.code == RESULT_OK || result.code == RESULT_CANCELLED;
        if (!good)
            log_error("JOB %llu IS NOT SAVED: the last %.0f s of work on it are lost",
                      (unsigned long long)farm_job_id(job), age);
        farm_unpin(farm, job);
    }
}

/* Looks at one scene of jobs that came back, or that a worker could not use; false when there is none. */
static bool check_scene(checkpointer_t *checkpointer)
{
    hash_t blob;
    if (!farm_next_scene(checkpointer->options.farm, &blob)) return false;
    if (!blob_store_check(checkpointer->options.blobs, &blob, &checkpointer->stop))
        farm_scene_lost(checkpointer->options.farm, clock_now(), &blob);
    return true;
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void *checkpointer_run(void *argument)
{
    checkpointer_t *checkpointer = argument;
    enforce_limit(checkpointer);
    while (!atomic_load(&checkpointer->stop)) {
        load_films(checkpointer);
        farm_settle(checkpointer->options.farm);
        int wait_ms = 1 + (int)(1000 * save_films(checkpointer));
        if (check_scene(checkpointer)) wait_ms = 0;
        wake_wait(checkpointer->options.checkpoint_wake, wait_ms);
    }
    save_all(checkpointer);
    return NULL;
}

/* ---- the public functions ------------------------------------------------------------------------------ */

result_t checkpointer_start(const checkpointer_options_t *options, checkpointer_t **out)
{
    checkpointer_t *checkpointer = mem_zalloc(1, sizeof *checkpointer);
    checkpointer->options = *options;
    checkpointer->options.most = fmax(options->most, options->interval);
    checkpointer->cores = int_max(1, (int)sysconf(_SC_NPROCESSORS_ONLN));
    checkpointer->started = clock_now();
    pthread_mutex_init(&checkpointer->custody, NULL);
    result_t result = thread_start(&checkpointer->thread, "lm-checkpointer", checkpointer_run, checkpointer);
    *out = checkpointer;
    if (result.code == RESULT_OK) return result;
    checkpointer->finished = true; /* it has not begun */
    checkpointer_stop(out);
    return result;
}

void checkpointer_finish(checkpointer_t *checkpointer)
{
    if (checkpointer == NULL || checkpointer->finished) return;
    atomic_store(&checkpointer->stop, true);
    wake_up(checkpointer->options.checkpoint_wake);
    pthread_join(checkpointer->thread, NULL);
    checkpointer->finished = true;
}

void checkpointer_stop(checkpointer_t **out)
{
    checkpointer_t *checkpointer = *out;
    if (checkpointer == NULL) return;
    checkpointer_finish(checkpointer);
    pthread_mutex_destroy(&checkpointer->custody);
    free(checkpointer);
    *out = NULL;
}

/* A job that is over and has samples can be extended only from its film. */
static result_t check_film(checkpointer_t *checkpointer, double now, uint64_t job)
{
    size_t count;
    uint32_t workers;
    job_report_t *report = farm_report(checkpointer->options.farm, now, job, &count, &workers);
    bool needs =
        report != NULL && job_state_final((uint32_t)report->record.state) && report->record.samples_done > 0;
    free(report);
    if (!needs || film_store_bytes(checkpointer->options.films, job) > 0) return result_ok();
    return result_fail(
        RESULT_INPUT,
        "the film of job %llu is no longer kept: submit it again (retain a job that you want to extend)",
        (unsigned long long)job);
}

result_t checkpointer_order(checkpointer_t *checkpointer, double now, const job_order_t *order)
{
    pthread_mutex_lock(&checkpointer->custody);
    result_t result = order->kind == ORDER_EXTEND ? check_film(checkpointer, now, order->job) : result_ok();
    if (result.code == RESULT_OK) result = farm_order(checkpointer->options.farm, now, order);
    pthread_mutex_unlock(&checkpointer->custody);
    return result;
}

void checkpointer_delete(checkpointer_t *checkpointer, uint64_t job)
{
    pthread_mutex_lock(&checkpointer->custody);
    film_store_delete(checkpointer->options.films, job);
    pthread_mutex_unlock(&checkpointer->custody);
}
