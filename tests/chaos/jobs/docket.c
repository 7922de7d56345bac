/* docket: see docket.h. */
#include "tests/chaos/jobs/docket.h"

#include "tests/chaos/dice.h"
#include "tests/chaos/jobs/job.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_JOBS = 500, SEEDS = 3 };
static const double STATUS_LIMIT = 90;      /* seconds for an answer; the command has a time-out of its own */
static const double STATUS_INTERVAL = 0.25; /* seconds between questions */

struct docket {
    job_setup_t setup;
    references_t references;
    size_t at_a_time;
    dice_t dice;
    size_t deck[JOB_KINDS], deck_left;
    job_t jobs[MAX_JOBS];
    size_t job_count;
    errand_t status;
    double next_status;
    unsigned master, asked_master; /* how many there have been: now, and when the status was asked for */
    uint64_t questions;
};

docket_t *docket_new(const docket_setup_t *setup)
{
    docket_t *docket = mem_zalloc(1, sizeof *docket);
    docket->references = (references_t){.report = setup->report, .folder = setup->folder};
    docket->setup = (job_setup_t){.report = setup->report,
                                  .folder = setup->folder,
                                  .master = setup->master,
                                  .passes = setup->passes,
                                  .references = &docket->references};
    docket->at_a_time = setup->at_a_time;
    docket->dice = dice_new(setup->seed, 2);
    docket->master = 1;
    return docket;
}

void docket_free(docket_t **docket_pointer)
{
    docket_t *docket = *docket_pointer;
    if (docket == NULL) return;
    for (size_t i = 0; i < docket->job_count; i++) job_free(&docket->jobs[i]);
    references_free(&docket->references);
    errand_end(&docket->status);
    free(docket);
    *docket_pointer = NULL;
}

void docket_new_master(docket_t *docket)
{
    docket->master++;
}

/* ---- what the master says ----------------------------------------------------------------------------- */

static const json_t *find_job(const json_t *jobs, const char *name)
{
    for (size_t i = 0; i < json_array_size(jobs); i++) {
        const json_t *object = json_array_get(jobs, i);
        const char *its_name = json_string_value(json_object_get(object, "name"));
        if (its_name && strcmp(its_name, name) == 0) return object;
    }
    return NULL;
}

static void take_jobs(docket_t *docket, const json_t *jobs, double now)
{
    const job_answer_t answer = {.asked = docket->status.started,
                                 .master = docket->asked_master == docket->master ? docket->master : 0};
    docket->questions++;
    for (size_t i = 0; i < docket->job_count; i++) {
        job_t *job = &docket->jobs[i];
        job_take(job, find_job(jobs, job->name), &answer, now);
    }
}

static void take_status(docket_t *docket, double now)
{
    char *text = errand_said(&docket->status);
    json_t *root = json_loads(text, 0, NULL);
    const json_t *jobs = json_object_get(root, "jobs");
    if (json_is_array(jobs))
        take_jobs(docket, jobs, now);
    else
        report_violation(docket->setup.report, "status --json says \"%.200s\"", text);
    json_decref(root);
    free(text);
}

static void ask_status(docket_t *docket, double now)
{
    char *output = mem_printf("%s/status.json", docket->setup.folder);
    words_t words = {0};
    WORDS_ADD(&words, "status", "--json");
    job_master_words(&docket->setup, &words);
    docket->next_status = now + STATUS_INTERVAL;
    docket->asked_master = docket->master;
    errand_start(&docket->status, output, words.list, false);
    free(output);
}

static void tick_status(docket_t *docket, double now)
{
    errand_state_t state = errand_poll(&docket->status, now, STATUS_LIMIT);
    if (state == ERRAND_DONE) take_status(docket, now);
    if (state == ERRAND_NONE && now >= docket->next_status) ask_status(docket, now);
}

/* ---- jobs --------------------------------------------------------------------------------------------- */

/* Kinds come from a shuffled deck, so that all of them come. */
static const job_kind_t *draw_kind(docket_t *docket)
{
    if (docket->deck_left == 0)
        for (; docket->deck_left < JOB_KINDS; docket->deck_left++)
            docket->deck[docket->deck_left] = docket->deck_left;
    size_t pick = dice_below(&docket->dice, docket->deck_left), kind = docket->deck[pick];
    docket->deck[pick] = docket->deck[--docket->deck_left];
    return &JOB_KIND_LIST[kind];
}

static void new_job(docket_t *docket, double now)
{
    job_t *job = &docket->jobs[docket->job_count++];
    const job_kind_t *kind = draw_kind(docket);
    unsigned seed = 1 + (unsigned)dice_below(&docket->dice, SEEDS);
    job_begin(job, &docket->setup, kind, seed, docket->job_count, now);
}

void docket_tick(docket_t *docket, double now, bool more)
{
    size_t open = 0;
    tick_status(docket, now);
    references_tick(&docket->references, now);
    for (size_t i = 0; i < docket->job_count; i++) {
        job_tick(&docket->jobs[i], now);
        open += job_is_open(&docket->jobs[i]);
    }
    if (more && open < docket->at_a_time && docket->job_count < MAX_JOBS) new_job(docket, now);
}

bool docket_settled(const docket_t *docket)
{
    for (size_t i = 0; i < docket->job_count; i++)
        if (job_is_open(&docket->jobs[i])) return false;
    return true;
}

docket_sum_t docket_sum(const docket_t *docket)
{
    docket_sum_t sum = {.submitted = docket->job_count, .questions = docket->questions};
    for (size_t i = 0; i < docket->job_count; i++) {
        const job_t *job = &docket->jobs[i];
        const account_t *account = &job->account;
        sum.issued += account->issued;
        sum.counted += account->counted;
        sum.batches += account->batches;
        sum.batches_refused += account->batches_refused;
        sum.units_reissued += account->units_reissued;
        if (job->stage != JOB_PROVED) continue;
        sum.proved++;
        sum.longest = fmax(sum.longest, job->changed - job->submitted);
    }
    return sum;
}

void docket_describe(const docket_t *docket)
{
    for (size_t i = 0; i < docket->job_count; i++)
        if (docket->jobs[i].stage != JOB_PROVED) job_describe(&docket->jobs[i]);
}
