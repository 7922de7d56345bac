/* journal_writer: see journal_writer.h.
 *
 * DESIGN. A job is written down before it is put in the queue: so no unit of it can be out with a worker when
 * its number is not safe, and a submission that cannot be written (a full disk) is refused without a trace.
 * An order is carried out first and then written down; where that fails, the client is told that it holds
 * only as long as this process, and it is tried again until it is safe.
 *
 * A deleted job's files go before its record: a crash in between leaves a job without a film, which can be
 * deleted again, and not a film without a job, which would be taken for one that the journal has lost. */
#include "master/threads/journal_writer.h"

#include "common/thread.h"
#include "common/wake.h"
#include "master/threads/image_writer.h"

#include <assert.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum {
    RETRY = 5,       /* seconds between attempts when the journal cannot be written */
    WARN_EVERY = 60, /* seconds between warnings that it cannot */
    RECORDS_A_TURN = 64,
    JOURNAL_ROOM = 4 << 20, /* bytes that are to be free for the journal */
    POLL_MS = 1000
};

struct journal_writer {
    journal_writer_options_t options;
    char *data_dir;
    pthread_t thread;
    atomic_bool stop;
    pthread_mutex_t lock; /* guards what follows */
    journal_writer_request_t *waiting;
    size_t waiting_count;
    journal_writer_answer_t *answers;
    size_t answer_count;
    /* the thread's own */
    uint64_t next_job;
    job_record_t records[RECORDS_A_TURN];
    double retry_at;  /* seconds; after a failure */
    double warned_at; /* seconds, when the last failure was complained of; 0: none since the last success */
};

/* ---- records ------------------------------------------------------------------------------------------- */

/* Deletes the files of a job that is no longer known. */
static void delete_files(journal_writer_t *journal_writer, uint64_t job)
{
    if (journal_writer->options.checkpointer != NULL)
        checkpointer_delete(journal_writer->options.checkpointer, job);
    image_writer_delete(journal_writer->data_dir, job);
}

/* A job that is over does without its scene, unless it is retained. */
static bool needs_blob(job_state_t state, bool retained)
{
    return retained || !job_state_final((uint32_t)state);
}

static void complain(journal_writer_t *journal_writer, const char *what)
{
    double now = clock_now();
    if (journal_writer->warned_at > 0 && now - journal_writer->warned_at < WARN_EVERY) return;
    journal_writer->warned_at = now;
    log_error("THE JOURNAL PAUSES: %s; jobs go on, but what changes of them now is forgotten if this process "
              "ends; it is tried again every %d s",
              what, RETRY);
}

static result_t failed(journal_writer_t *journal_writer, result_t result)
{
    complain(journal_writer, result.message);
    journal_writer->retry_at = clock_now() + RETRY;
    return result;
}

/* Saves records; those of removed jobs lose their files too. */
static result_t save(journal_writer_t *journal_writer, const job_record_t *records, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (records[i].removed) delete_files(journal_writer, records[i].job);
    result_t result = journal_save(journal_writer->options.journal, records, count);
    if (result.code != RESULT_OK && journal_writer->options.checkpointer != NULL &&
        checkpointer_make_room(journal_writer->options.checkpointer, JOURNAL_ROOM))
        result = journal_save(journal_writer->options.journal, records, count);
    if (result.code != RESULT_OK) return failed(journal_writer, result);
    for (size_t i = 0; i < count; i++)
        blob_store_need(journal_writer->options.store, &records[i].blob, records[i].job,
                        !records[i].removed && needs_blob(records[i].state, records[i].retained));
    if (journal_writer->warned_at > 0) log_info("the journal goes on");
    journal_writer->warned_at = 0;
    return result;
}

/* Writes down what has changed. */
static result_t save_changes(journal_writer_t *journal_writer)
{
    farm_t *farm = journal_writer->options.farm;
    for (;;) {
        size_t count = 0;
        while (count < RECORDS_A_TURN && farm_next_record(farm, clock_now(), &journal_writer->records[count]))
            count++;
        if (count == 0) return result_ok();
        result_t result = save(journal_writer, journal_writer->records, count);
        if (result.code == RESULT_OK) continue;
        for (size_t i = 0; i < count; i++) farm_record_unsaved(farm, journal_writer->records[i].job);
        return result;
    }
}

/* Writes down how errors fell, where that has changed. */
static result_t save_errors(journal_writer_t *journal_writer)
{
    farm_t *farm = journal_writer->options.farm;
    error_history_t errors;
    for (uint64_t job; farm_next_history(farm, &job, &errors);) {
        result_t result = journal_save_errors(journal_writer->options.journal, job, &errors);
        if (result.code == RESULT_OK) continue;
        farm_history_unsaved(farm, job);
        return failed(journal_writer, result);
    }
    return result_ok();
}

/* The errors come first: where a job is over by its record, its history is whole. */
static result_t save_all(journal_writer_t *journal_writer)
{
    result_t errors = save_errors(journal_writer), changes = save_changes(journal_writer);
    return errors.code != RESULT_OK ? errors : changes;
}

/* ---- what clients want --------------------------------------------------------------------------------- */

static result_t submit(journal_writer_t *journal_writer, const journal_writer_request_t *request,
                       uint64_t *job)
{
    job_record_t record = {.job = journal_writer->next_job,
                           .terms = request->terms,
                           .settings = request->settings,
                           .blob = request->blob,
                           .state = JOB_QUEUED,
                           .submitted = clock_wall()};
    /* From now on the blob does not go to make room. */
    blob_store_need(journal_writer->options.store, &record.blob, record.job, true);
    result_t result = result_ok();
    if (!blob_store_find(journal_writer->options.store, &record.blob, &record.blob_size))
        result = result_fail(RESULT_INPUT, "this master does not have the scene: send it first");
    if (result.code == RESULT_OK) result = save(journal_writer, &record, 1);
    if (result.code != RESULT_OK) {
        blob_store_need(journal_writer->options.store, &record.blob, record.job, false);
        return result;
    }
    result = farm_submit(journal_writer->options.farm, clock_now(), &record.terms, &record.settings,
                         &record.blob, record.blob_size, job);
    if (result.code == RESULT_OK) {
        assert(*job == journal_writer->next_job);
        journal_writer->next_job++;
    } else {
        record.removed = true;
        if (save(journal_writer, &record, 1).code != RESULT_OK)
            farm_record_unsaved(journal_writer->options.farm, record.job);
    }
    return result;
}

/* The job as it is now; false when there is none of that number. */
static bool find_job(journal_writer_t *journal_writer, uint64_t job, job_report_t *report)
{
    size_t count;
    uint32_t workers;
    job_report_t *reports = farm_report(journal_writer->options.farm, clock_now(), job, &count, &workers);
    if (reports != NULL) *report = reports[0];
    free(reports);
    return reports != NULL;
}

/* A job that is to be worked on again needs its scene: from now on it does not go to make room. */
static result_t hold_scene(journal_writer_t *journal_writer, const job_report_t *job)
{
    uint64_t size;
    blob_store_need(journal_writer->options.store, &job->record.blob, job->record.job, true);
    if (blob_store_find(journal_writer->options.store, &job->record.blob, &size)) return result_ok();
    return result_fail(RESULT_INPUT,
                       "the scene of job %llu is no longer here: send it again (submit another job with it)",
                       (unsigned long long)job->record.job);
}

static result_t carry_out(journal_writer_t *journal_writer, const job_order_t *order)
{
    checkpointer_t *checkpointer = journal_writer->options.checkpointer;
    job_report_t job;
    bool again = order->kind == ORDER_EXTEND || order->kind == ORDER_RESUME;
    result_t result = result_ok();
    if (again && find_job(journal_writer, order->job, &job)) result = hold_scene(journal_writer, &job);
    if (result.code == RESULT_OK)
        result = checkpointer != NULL ? checkpointer_order(checkpointer, clock_now(), order)
                                      : farm_order(journal_writer->options.farm, clock_now(), order);
    if (result.code != RESULT_OK && again &&
        find_job(journal_writer, order->job, &job)) /* it needs what it needed */
        blob_store_need(journal_writer->options.store, &job.record.blob, job.record.job,
                        needs_blob(job.record.state, job.record.retained));
    return result;
}

static result_t order(journal_writer_t *journal_writer, const journal_writer_request_t *request)
{
    TRY(carry_out(journal_writer, &request->order));
    result_t saved = save_changes(journal_writer);
    if (saved.code == RESULT_OK) return saved;
    return result_fail(RESULT_IO,
                       "it is done, but is forgotten if the master ends before it can write it down: %.300s",
                       saved.message);
}

static void serve(journal_writer_t *journal_writer, const journal_writer_request_t *request)
{
    journal_writer_answer_t answer = {.identity = request->identity,
                                      .request = request->request,
                                      .kind = request->kind,
                                      .job = request->order.job,
                                      .save_at = request->settings.save_at.count,
                                      .halves = request->terms.halves};
    if (request->kind == JOURNAL_WRITER_SUBMIT)
        answer.result = submit(journal_writer, request, &answer.job);
    else
        answer.result = order(journal_writer, request);
    if (request->done != NULL) {
        request->done(request->context, &answer);
        return;
    }
    pthread_mutex_lock(&journal_writer->lock);
    journal_writer->answers[journal_writer->answer_count++] = answer;
    pthread_mutex_unlock(&journal_writer->lock);
    wake_up(journal_writer->options.answer_wake);
}

/* The next request, as long as there is room for its answer. */
static bool next_request(journal_writer_t *journal_writer, journal_writer_request_t *request)
{
    pthread_mutex_lock(&journal_writer->lock);
    bool found =
        journal_writer->waiting_count > 0 && journal_writer->answer_count < JOURNAL_WRITER_MAX_WAITING;
    if (found) {
        *request = journal_writer->waiting[0];
        journal_writer->waiting_count--;
        memmove(journal_writer->waiting, journal_writer->waiting + 1,
                journal_writer->waiting_count * sizeof *request);
    }
    pthread_mutex_unlock(&journal_writer->lock);
    return found;
}

static void *journal_writer_run(void *argument)
{
    journal_writer_t *journal_writer = argument;
    while (!atomic_load(&journal_writer->stop)) {
        wake_wait(journal_writer->options.journal_writer_wake, POLL_MS);
        for (journal_writer_request_t request; next_request(journal_writer, &request);)
            serve(journal_writer, &request);
        if (clock_now() >= journal_writer->retry_at) save_all(journal_writer);
    }
    for (journal_writer_request_t request; next_request(journal_writer, &request);)
        serve(journal_writer, &request);
    result_t result = save_all(journal_writer);
    if (result.code != RESULT_OK)
        log_error("the last changes of jobs are not written down: %s", result.message);
    return NULL;
}

/* ---- the public functions ------------------------------------------------------------------------------ */

static void free_journal_writer(journal_writer_t *journal_writer)
{
    pthread_mutex_destroy(&journal_writer->lock);
    free(journal_writer->waiting);
    free(journal_writer->answers);
    free(journal_writer->data_dir);
    free(journal_writer);
}

result_t journal_writer_start(const journal_writer_options_t *options, journal_writer_t **out)
{
    journal_writer_t *journal_writer = mem_zalloc(1, sizeof *journal_writer);
    journal_writer->options = *options;
    journal_writer->data_dir = mem_strdup(options->data_dir);
    journal_writer->next_job = options->first_job;
    journal_writer->waiting = mem_alloc(JOURNAL_WRITER_MAX_WAITING * sizeof *journal_writer->waiting);
    journal_writer->answers = mem_alloc(JOURNAL_WRITER_MAX_WAITING * sizeof *journal_writer->answers);
    pthread_mutex_init(&journal_writer->lock, NULL);
    result_t result = thread_start(&journal_writer->thread, "lm-journal", journal_writer_run, journal_writer);
    if (result.code == RESULT_OK)
        *out = journal_writer;
    else
        free_journal_writer(journal_writer);
    return result;
}

void journal_writer_stop(journal_writer_t **out)
{
    journal_writer_t *journal_writer = *out;
    if (journal_writer == NULL) return;
    atomic_store(&journal_writer->stop, true);
    wake_up(journal_writer->options.journal_writer_wake);
    pthread_join(journal_writer->thread, NULL);
    free_journal_writer(journal_writer);
    *out = NULL;
}

result_t journal_writer_ask(journal_writer_t *journal_writer, const journal_writer_request_t *request)
{
    pthread_mutex_lock(&journal_writer->lock);
    bool room = journal_writer->waiting_count < JOURNAL_WRITER_MAX_WAITING;
    if (room) journal_writer->waiting[journal_writer->waiting_count++] = *request;
    pthread_mutex_unlock(&journal_writer->lock);
    if (!room)
        return result_fail(RESULT_LIMIT, "%d orders wait to be written down already: try again",
                           JOURNAL_WRITER_MAX_WAITING);
    wake_up(journal_writer->options.journal_writer_wake);
    return result_ok();
}

bool journal_writer_next_answer(journal_writer_t *journal_writer, journal_writer_answer_t *answer)
{
    pthread_mutex_lock(&journal_writer->lock);
    bool found = journal_writer->answer_count > 0;
    if (found) {
        *answer = journal_writer->answers[0];
        journal_writer->answer_count--;
        memmove(journal_writer->answers, journal_writer->answers + 1,
                journal_writer->answer_count * sizeof *journal_writer->answers);
    }
    pthread_mutex_unlock(&journal_writer->lock);
    if (found) wake_up(journal_writer->options.journal_writer_wake); /* there is room for an answer again */
    return found;
}
