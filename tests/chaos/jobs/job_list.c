/* job_list: see job_list.h. */
#include "tests/chaos/jobs/job_list.h"

#include "tests/chaos/dice.h"
#include "tests/chaos/jobs/job.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_JOBS = 500, SEEDS = 3 };
static const double STATUS_LIMIT = 90;      /* seconds for an answer; the command has a time-out of its own */
static const double STATUS_INTERVAL = 0.25; /* seconds between questions */

struct job_list {
    job_setup_t setup;
    references_t references;
    size_t at_a_time;
    dice_t dice;
    size_t deck[JOB_KINDS], deck_left;
    job_t jobs[MAX_JOBS];
    size_t job_count;
    command_t status;
    double next_status;
    unsigned master, asked_master; /* how many there have been: now, and when the status was asked for */
    uint64_t questions;
};

job_list_t *job_list_new(const job_list_setup_t *setup)
{
    job_list_t *job_list = mem_zalloc(1, sizeof *job_list);
    job_list->references =
        (references_t){.report = setup->report, .folder = setup->folder, .smaller = setup->smaller};
    job_list->setup = (job_setup_t){.report = setup->report,
                                    .folder = setup->folder,
                                    .master = setup->master,
                                    .passes = setup->passes,
                                    .references = &job_list->references};
    job_list->at_a_time = setup->at_a_time;
    job_list->dice = dice_new(setup->seed, 2);
    job_list->master = 1;
    return job_list;
}

void job_list_free(job_list_t **job_list_pointer)
{
    job_list_t *job_list = *job_list_pointer;
    if (job_list == NULL) return;
    for (size_t i = 0; i < job_list->job_count; i++) job_free(&job_list->jobs[i]);
    references_free(&job_list->references);
    command_end(&job_list->status);
    free(job_list);
    *job_list_pointer = NULL;
}

void job_list_new_master(job_list_t *job_list)
{
    job_list->master++;
}

/* ---- what the master says ----------------------------------------------------------------------------- */

/* The one that it was last time, or the first of its name. */
static const json_t *find_job(const json_t *jobs, const job_t *job)
{
    const json_t *found = NULL;
    for (size_t i = 0; i < json_array_size(jobs); i++) {
        const json_t *object = json_array_get(jobs, i);
        const char *name = json_string_value(json_object_get(object, "name"));
        if (name == NULL || strcmp(name, job->name) != 0) continue;
        bool same = json_integer_value(json_object_get(object, "job")) == (json_int_t)job->account.job;
        if (found == NULL || same) found = object;
    }
    return found;
}

static void take_jobs(job_list_t *job_list, const json_t *jobs, double now)
{
    const job_answer_t answer = {.asked = job_list->status.started,
                                 .master = job_list->asked_master == job_list->master ? job_list->master : 0};
    job_list->questions++;
    for (size_t i = 0; i < job_list->job_count; i++) {
        job_t *job = &job_list->jobs[i];
        job_take(job, find_job(jobs, job), &answer, now);
    }
}

static void take_status(job_list_t *job_list, double now)
{
    char *text = command_said(&job_list->status);
    json_t *root = json_loads(text, 0, NULL);
    const json_t *jobs = json_object_get(root, "jobs");
    if (json_is_array(jobs))
        take_jobs(job_list, jobs, now);
    else
        report_violation(job_list->setup.report, "status --json says \"%.200s\"", text);
    json_decref(root);
    free(text);
}

static void ask_status(job_list_t *job_list, double now)
{
    char *output = mem_printf("%s/status.json", job_list->setup.folder);
    words_t words = {0};
    WORDS_ADD(&words, "status", "--json");
    job_master_words(&job_list->setup, &words);
    job_list->next_status = now + STATUS_INTERVAL;
    job_list->asked_master = job_list->master;
    command_start(&job_list->status, output, words.list, false);
    free(output);
}

static void tick_status(job_list_t *job_list, double now)
{
    command_state_t state = command_poll(&job_list->status, now, STATUS_LIMIT);
    if (state == COMMAND_DONE) take_status(job_list, now);
    if (state == COMMAND_NONE && now >= job_list->next_status) ask_status(job_list, now);
}

/* ---- jobs --------------------------------------------------------------------------------------------- */

/* Kinds come from a shuffled deck, so that all of them come. */
static const job_kind_t *draw_kind(job_list_t *job_list)
{
    if (job_list->deck_left == 0)
        for (; job_list->deck_left < JOB_KINDS; job_list->deck_left++)
            job_list->deck[job_list->deck_left] = job_list->deck_left;
    size_t pick = dice_below(&job_list->dice, job_list->deck_left), kind = job_list->deck[pick];
    job_list->deck[pick] = job_list->deck[--job_list->deck_left];
    return &JOB_KIND_LIST[kind];
}

static void new_job(job_list_t *job_list, double now)
{
    job_t *job = &job_list->jobs[job_list->job_count++];
    const job_kind_t *kind = draw_kind(job_list);
    unsigned seed = 1 + (unsigned)dice_below(&job_list->dice, SEEDS);
    job_begin(job, &job_list->setup, kind, seed, job_list->job_count, now);
}

void job_list_tick(job_list_t *job_list, double now, bool more)
{
    size_t open = 0;
    tick_status(job_list, now);
    references_tick(&job_list->references, now);
    for (size_t i = 0; i < job_list->job_count; i++) {
        job_tick(&job_list->jobs[i], now);
        open += job_is_open(&job_list->jobs[i]);
    }
    if (more && open < job_list->at_a_time && job_list->job_count < MAX_JOBS) new_job(job_list, now);
}

bool job_list_settled(const job_list_t *job_list)
{
    for (size_t i = 0; i < job_list->job_count; i++)
        if (job_is_open(&job_list->jobs[i])) return false;
    return true;
}

job_list_sum_t job_list_sum(const job_list_t *job_list)
{
    job_list_sum_t sum = {.submitted = job_list->job_count, .questions = job_list->questions};
    for (size_t i = 0; i < job_list->job_count; i++) {
        const job_t *job = &job_list->jobs[i];
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

void job_list_describe(const job_list_t *job_list)
{
    for (size_t i = 0; i < job_list->job_count; i++)
        if (job_list->jobs[i].stage != JOB_PROVED) job_describe(&job_list->jobs[i]);
}
