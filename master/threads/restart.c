/* restart: see restart.h.
 *
 * DESIGN. The journal says which jobs there are, the checkpoints say how far they are. Where the journal has
 * lost a job (it was damaged, or is an older copy), the head of a checkpoint has the job's whole record, and
 * the job is taken from there; it goes on from the state that it had then. The counters of a job are the
 * higher of both, and the bits that a film is made of are those of its job. */
#include "master/threads/restart.h"

#include "master/store/checkpoint.h"
#include "master/threads/image_writer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* What was found. */
typedef struct {
    job_record_t *records;
    size_t count, known; /* in all; in the journal */
} jobs_t;

uint64_t restart_first_job(const journal_t *journal, film_store_t *films, const char *data_dir)
{
    uint64_t first = journal_found(journal)->next_job, last = image_writer_last_job(data_dir);
    size_t count;
    film_file_t *files = film_store_list(films, 0, &count);
    if (count > 0 && files[count - 1].job > last) last = files[count - 1].job;
    free(files);
    return first > last ? first : last + 1;
}

/* ---- jobs that the films know -------------------------------------------------------------------------- */

/* The record in the latest checkpoint of a job whose head can be read; false when there is none. */
static bool read_record(film_store_t *films, uint64_t job, job_record_t *record)
{
    size_t count;
    bool found = false;
    film_file_t *files = film_store_list(films, job, &count);
    for (size_t i = 0; i < count && !found; i++) {
        char *path = film_store_path(films, job, files[i].generation);
        checkpoint_t *checkpoint;
        result_t result = checkpoint_open(path, &checkpoint);
        found = result.code == RESULT_OK && checkpoint_info(checkpoint)->record.job == job;
        if (found) *record = checkpoint_info(checkpoint)->record;
        if (result.code != RESULT_OK)
            log_warning("%s", result.message); /* if it is needed, the checkpointer says what it costs */
        checkpoint_close(&checkpoint);
        free(path);
    }
    free(files);
    return found;
}

static uint64_t most(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

/* The process ended between a checkpoint and the record of it. */
static void catch_up(job_record_t *record, const job_record_t *film)
{
    if (hash_is_zero(&record->fingerprint)) record->fingerprint = film->fingerprint;
    record->elapsed = fmax(record->elapsed, film->elapsed);
    record->bytes = most(record->bytes, film->bytes);
    record->batches = most(record->batches, film->batches);
    record->batches_refused = most(record->batches_refused, film->batches_refused);
    record->units_reissued = most(record->units_reissued, film->units_reissued);
    record->checks_passed = most(record->checks_passed, film->checks_passed);
    record->checks_failed = most(record->checks_failed, film->checks_failed);
    record->workers_seen = (uint32_t)most(record->workers_seen, film->workers_seen);
}

static job_record_t *find_record(const jobs_t *jobs, uint64_t job)
{
    for (size_t i = 0; i < jobs->count; i++)
        if (jobs->records[i].job == job) return &jobs->records[i];
    return NULL;
}

/* Looks at the films of one job. */
static void use_films(jobs_t *jobs, film_store_t *films, uint64_t job)
{
    job_record_t film, *record = find_record(jobs, job);
    if (record != NULL && job_state_final((uint32_t)record->state)) return;
    if (!read_record(films, job, &film)) return;
    if (record != NULL) {
        catch_up(record, &film);
        return;
    }
    jobs->records = mem_realloc(jobs->records, (jobs->count + 1) * sizeof film);
    jobs->records[jobs->count++] = film;
    log_warning("job %llu (%s) is not in the journal: it comes back from its film", (unsigned long long)job,
                film.terms.name);
}

static int by_number(const void *a, const void *b)
{
    uint64_t x = ((const job_record_t *)a)->job, y = ((const job_record_t *)b)->job;
    return x < y ? -1 : x > y;
}

/* All jobs that are known, in the order of their numbers. */
static jobs_t find_jobs(const journal_t *journal, film_store_t *films)
{
    const journal_found_t *found = journal_found(journal);
    jobs_t jobs = {.count = found->record_count, .known = found->record_count};
    jobs.records = mem_alloc((jobs.count + 1) * sizeof *jobs.records);
    if (jobs.count > 0) memcpy(jobs.records, found->records, jobs.count * sizeof *jobs.records);
    size_t count;
    film_file_t *files = film_store_list(films, 0, &count);
    for (size_t i = 0; i < count; i++)
        if (i == 0 || files[i].job != files[i - 1].job) use_films(&jobs, films, files[i].job);
    free(files);
    qsort(jobs.records, jobs.count, sizeof *jobs.records, by_number);
    return jobs;
}

/* ---- going on ------------------------------------------------------------------------------------------ */

/* A job whose scene is gone waits for it: no worker could render it. */
static void check_blob(job_record_t *record, blob_store_t *blobs)
{
    uint64_t size;
    bool over = job_state_final((uint32_t)record->state);
    if (!over || record->retained) blob_store_need(blobs, &record->blob, record->job, true);
    if (over || record->state == JOB_FINISHING || blob_store_find(blobs, &record->blob, &size)) return;
    record->state = JOB_PAUSED;
    if (strcmp(record->message, FARM_NO_SCENE) != 0) record->news = JOB_PAUSED; /* else it was told */
    snprintf(record->message, sizeof record->message, "%s", FARM_NO_SCENE);
    log_error("job %llu is paused: %s", (unsigned long long)record->job, record->message);
}

static const char *plural(size_t count)
{
    return count == 1 ? "" : "s";
}

/* "3 jobs (2 to go on with, 1 paused, ...". */
static void count_states(const jobs_t *jobs, char *text, size_t size)
{
    size_t going = 0, paused = 0, over = 0;
    for (size_t i = 0; i < jobs->count; i++) {
        job_state_t state = jobs->records[i].state;
        over += job_state_final((uint32_t)state);
        paused += state == JOB_PAUSED;
        going += !job_state_final((uint32_t)state) && state != JOB_PAUSED;
    }
    snprintf(text, size, "%zu job%s (%zu to go on with, %zu paused, %zu over)", jobs->count,
             plural(jobs->count), going, paused, over);
}

static void say_what_is_there(const jobs_t *jobs, journal_t *journal, film_store_t *films,
                              blob_store_t *blobs)
{
    const journal_found_t *found = journal_found(journal);
    char text[120];
    size_t film_count;
    uint64_t film_bytes = 0, blob_bytes;
    film_file_t *files = film_store_list(films, 0, &film_count);
    for (size_t i = 0; i < film_count; i++) film_bytes += files[i].bytes;
    free(files);
    size_t blob_count = blob_store_count(blobs, &blob_bytes);
    count_states(jobs, text, sizeof text);
    if (found->fresh && jobs->count == 0 && blob_count == 0) {
        log_info("a new data directory");
        return;
    }
    log_info("found %s, %zu checkpoint%s (%.1f MB), %zu scene%s (%.1f MB)%s", text, film_count,
             plural(film_count), 1e-6 * (double)film_bytes, blob_count, plural(blob_count),
             1e-6 * (double)blob_bytes, found->crashed ? "; the last master did not end properly" : "");
    if (found->crashed) (void)journal_note(journal, 0, "restart", "the last master did not end properly");
}

result_t restart_farm(farm_t *farm, journal_t *journal, film_store_t *films, blob_store_t *blobs)
{
    jobs_t jobs = find_jobs(journal, films);
    for (size_t i = 0; i < jobs.count; i++) check_blob(&jobs.records[i], blobs);
    say_what_is_there(&jobs, journal, films, blobs);
    result_t result = jobs.count > jobs.known ? journal_save(journal, jobs.records, jobs.count) : result_ok();
    double now = clock_now();
    for (size_t i = 0; i < jobs.count && result.code == RESULT_OK; i++)
        farm_restore(farm, now, &jobs.records[i]);
    const journal_found_t *found = journal_found(journal);
    for (size_t i = 0; i < found->record_count && result.code == RESULT_OK; i++)
        farm_restore_history(farm, found->records[i].job, &found->errors[i]);
    journal_forget_found(journal);
    free(jobs.records);
    return result;
}
