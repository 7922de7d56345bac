/* clerk: see clerk.h.
 *
 * DESIGN. A job is written down before it is put in the queue: so no unit of it can be out with a worker when
 * its number is not safe, and a submission that cannot be written (a full disk) is refused without a trace.
 * An order is carried out first and then written down; where that fails, the client is told that it holds
 * only as long as this process, and it is tried again until it is safe.
 *
 * A deleted job's files go before its record: a crash in between leaves a job without a film, which can be
 * deleted again, and not a film without a job, which would be taken for one that the journal has lost. */
#include "master/store/clerk.h"

#include "master/gallery.h"

#include <assert.h>
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

enum {
    RETRY = 5,       /* seconds between attempts when the journal cannot be written */
    WARN_EVERY = 60, /* seconds between warnings that it cannot */
    RECORDS_A_TURN = 64,
    JOURNAL_ROOM = 4 << 20, /* bytes that are to be free for the journal */
    POLL_MS = 1000
};

struct clerk {
    clerk_options_t options;
    char *data_dir;
    pthread_t thread;
    atomic_bool stop;
    pthread_mutex_t lock; /* guards what follows */
    clerk_request_t *waiting;
    size_t waiting_count;
    clerk_answer_t *answers;
    size_t answer_count;
    /* the thread's own */
    uint64_t next_job;
    job_record_t records[RECORDS_A_TURN];
    double retry_at;  /* seconds; after a failure */
    double warned_at; /* seconds, when the last failure was complained of; 0: none since the last success */
};

static void wake(int descriptor)
{
    uint64_t one = 1;
    if (write(descriptor, &one, sizeof one) < 0) return; /* full: it is awake already */
}

static double wall_time(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* ---- records ------------------------------------------------------------------------------------------- */

/* Deletes the files of a job that is no longer known. */
static void delete_files(clerk_t *clerk, uint64_t job)
{
    if (clerk->options.keeper != NULL) keeper_delete(clerk->options.keeper, job);
    char *image = gallery_image_path(clerk->data_dir, job);
    if (unlink(image) != 0 && errno != ENOENT) log_warning("cannot delete %s: %s", image, strerror(errno));
    free(image);
}

/* A job that is over does without its scene, unless it is retained. */
static bool needs_blob(job_state_t state, bool retained)
{
    return retained || !job_state_final((uint32_t)state);
}

static void complain(clerk_t *clerk, const char *what)
{
    double now = clock_now();
    if (clerk->warned_at > 0 && now - clerk->warned_at < WARN_EVERY) return;
    clerk->warned_at = now;
    log_error("THE JOURNAL PAUSES: %s; jobs go on, but what changes of them now is forgotten if this process "
              "ends; it is "
              "tried again every %d s",
              what, RETRY);
}

/* Saves records; those of removed jobs lose their files too. */
static result_t save(clerk_t *clerk, const job_record_t *records, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (records[i].removed) delete_files(clerk, records[i].job);
    result_t result = journal_save(clerk->options.journal, records, count);
    if (result.code != RESULT_OK && clerk->options.keeper != NULL &&
        keeper_make_room(clerk->options.keeper, JOURNAL_ROOM))
        result = journal_save(clerk->options.journal, records, count);
    if (result.code != RESULT_OK) {
        complain(clerk, result.message);
        clerk->retry_at = clock_now() + RETRY;
        return result;
    }
    for (size_t i = 0; i < count; i++)
        blob_store_need(clerk->options.store, &records[i].blob, records[i].job,
                        !records[i].removed && needs_blob(records[i].state, records[i].retained));
    if (clerk->warned_at > 0) log_info("the journal goes on");
    clerk->warned_at = 0;
    return result;
}

/* Writes down what has changed. */
static result_t save_changes(clerk_t *clerk)
{
    farm_t *farm = clerk->options.farm;
    for (;;) {
        size_t count = 0;
        while (count < RECORDS_A_TURN && farm_next_record(farm, clock_now(), &clerk->records[count])) count++;
        if (count == 0) return result_ok();
        result_t result = save(clerk, clerk->records, count);
        if (result.code == RESULT_OK) continue;
        for (size_t i = 0; i < count; i++) farm_record_unsaved(farm, clerk->records[i].job);
        return result;
    }
}

/* ---- what clients want --------------------------------------------------------------------------------- */

static result_t submit(clerk_t *clerk, const clerk_request_t *request, uint64_t *job)
{
    job_record_t record = {.job = clerk->next_job,
                           .terms = request->terms,
                           .settings = request->settings,
                           .blob = request->blob,
                           .state = JOB_QUEUED,
                           .submitted = wall_time()};
    /* From now on the blob does not go to make room. */
    blob_store_need(clerk->options.store, &record.blob, record.job, true);
    result_t result = result_ok();
    if (!blob_store_find(clerk->options.store, &record.blob, &record.blob_size))
        result = result_fail(RESULT_INPUT, "this master does not have the scene: send it first");
    if (result.code == RESULT_OK) result = save(clerk, &record, 1);
    if (result.code != RESULT_OK) {
        blob_store_need(clerk->options.store, &record.blob, record.job, false);
        return result;
    }
    result = farm_submit(clerk->options.farm, clock_now(), &record.terms, &record.settings, &record.blob,
                         record.blob_size, job);
    if (result.code == RESULT_OK) {
        assert(*job == clerk->next_job);
        clerk->next_job++;
    } else {
        record.removed = true;
        if (save(clerk, &record, 1).code != RESULT_OK) farm_record_unsaved(clerk->options.farm, record.job);
    }
    return result;
}

/* The job as it is now; false when there is none of that number. */
static bool find_job(clerk_t *clerk, uint64_t job, job_report_t *report)
{
    size_t count;
    uint32_t workers;
    job_report_t *reports = farm_report(clerk->options.farm, clock_now(), job, &count, &workers);
    if (reports != NULL) *report = reports[0];
    free(reports);
    return reports != NULL;
}

/* A job that is to be worked on again needs its scene: from now on it does not go to make room. */
static result_t hold_scene(clerk_t *clerk, const job_report_t *job)
{
    uint64_t size;
    blob_store_need(clerk->options.store, &job->blob, job->job, true);
    if (blob_store_find(clerk->options.store, &job->blob, &size)) return result_ok();
    return result_fail(RESULT_INPUT,
                       "the scene of job %llu is no longer here: send it again (submit another job with it)",
                       (unsigned long long)job->job);
}

static result_t carry_out(clerk_t *clerk, const job_order_t *order)
{
    keeper_t *keeper = clerk->options.keeper;
    job_report_t job;
    bool again = order->kind == ORDER_EXTEND || order->kind == ORDER_RESUME;
    result_t result = result_ok();
    if (again && find_job(clerk, order->job, &job)) result = hold_scene(clerk, &job);
    if (result.code == RESULT_OK)
        result = keeper != NULL ? keeper_order(keeper, clock_now(), order)
                                : farm_order(clerk->options.farm, clock_now(), order);
    if (result.code != RESULT_OK && again && find_job(clerk, order->job, &job)) /* it needs what it needed */
        blob_store_need(clerk->options.store, &job.blob, job.job, needs_blob(job.state, job.retained));
    return result;
}

static result_t order(clerk_t *clerk, const clerk_request_t *request)
{
    TRY(carry_out(clerk, &request->order));
    result_t saved = save_changes(clerk);
    if (saved.code == RESULT_OK) return saved;
    return result_fail(RESULT_IO,
                       "it is done, but is forgotten if the master ends before it can write it down: %.300s",
                       saved.message);
}

static void serve(clerk_t *clerk, const clerk_request_t *request)
{
    clerk_answer_t answer = {.identity = request->identity,
                             .request = request->request,
                             .kind = request->kind,
                             .job = request->order.job};
    if (request->kind == CLERK_SUBMIT)
        answer.result = submit(clerk, request, &answer.job);
    else
        answer.result = order(clerk, request);
    pthread_mutex_lock(&clerk->lock);
    clerk->answers[clerk->answer_count++] = answer;
    pthread_mutex_unlock(&clerk->lock);
    wake(clerk->options.answer_wake);
}

/* The next request, as long as there is room for its answer. */
static bool next_request(clerk_t *clerk, clerk_request_t *request)
{
    pthread_mutex_lock(&clerk->lock);
    bool found = clerk->waiting_count > 0 && clerk->answer_count < CLERK_MAX_WAITING;
    if (found) {
        *request = clerk->waiting[0];
        clerk->waiting_count--;
        memmove(clerk->waiting, clerk->waiting + 1, clerk->waiting_count * sizeof *request);
    }
    pthread_mutex_unlock(&clerk->lock);
    return found;
}

static void *clerk_run(void *argument)
{
    clerk_t *clerk = argument;
    prctl(PR_SET_NAME, "lm-clerk");
    while (!atomic_load(&clerk->stop)) {
        struct pollfd wait = {.fd = clerk->options.clerk_wake, .events = POLLIN};
        uint64_t count;
        if (poll(&wait, 1, POLL_MS) > 0 && read(wait.fd, &count, sizeof count) < 0)
            log_debug("the clerk is woken in vain");
        for (clerk_request_t request; next_request(clerk, &request);) serve(clerk, &request);
        if (clock_now() >= clerk->retry_at) save_changes(clerk);
    }
    for (clerk_request_t request; next_request(clerk, &request);) serve(clerk, &request);
    result_t result = save_changes(clerk);
    if (result.code != RESULT_OK)
        log_error("the last changes of jobs are not written down: %s", result.message);
    return NULL;
}

/* ---- the door ------------------------------------------------------------------------------------------ */

static void free_clerk(clerk_t *clerk)
{
    pthread_mutex_destroy(&clerk->lock);
    free(clerk->waiting);
    free(clerk->answers);
    free(clerk->data_dir);
    free(clerk);
}

result_t clerk_start(const clerk_options_t *options, clerk_t **out)
{
    clerk_t *clerk = mem_zalloc(1, sizeof *clerk);
    clerk->options = *options;
    clerk->data_dir = mem_strdup(options->data_dir);
    clerk->next_job = options->first_job;
    clerk->waiting = mem_alloc(CLERK_MAX_WAITING * sizeof *clerk->waiting);
    clerk->answers = mem_alloc(CLERK_MAX_WAITING * sizeof *clerk->answers);
    pthread_mutex_init(&clerk->lock, NULL);
    int error = pthread_create(&clerk->thread, NULL, clerk_run, clerk);
    *out = clerk;
    if (error == 0) return result_ok();
    free_clerk(clerk);
    *out = NULL;
    return result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
}

void clerk_stop(clerk_t **out)
{
    clerk_t *clerk = *out;
    if (clerk == NULL) return;
    atomic_store(&clerk->stop, true);
    wake(clerk->options.clerk_wake);
    pthread_join(clerk->thread, NULL);
    free_clerk(clerk);
    *out = NULL;
}

result_t clerk_ask(clerk_t *clerk, const clerk_request_t *request)
{
    pthread_mutex_lock(&clerk->lock);
    bool room = clerk->waiting_count < CLERK_MAX_WAITING;
    if (room) clerk->waiting[clerk->waiting_count++] = *request;
    pthread_mutex_unlock(&clerk->lock);
    if (!room)
        return result_fail(RESULT_LIMIT, "%d orders wait to be written down already: try again",
                           CLERK_MAX_WAITING);
    wake(clerk->options.clerk_wake);
    return result_ok();
}

bool clerk_next_answer(clerk_t *clerk, clerk_answer_t *answer)
{
    pthread_mutex_lock(&clerk->lock);
    bool found = clerk->answer_count > 0;
    if (found) {
        *answer = clerk->answers[0];
        clerk->answer_count--;
        memmove(clerk->answers, clerk->answers + 1, clerk->answer_count * sizeof *clerk->answers);
    }
    pthread_mutex_unlock(&clerk->lock);
    if (found) wake(clerk->options.clerk_wake); /* there is room for an answer again */
    return found;
}
