/* docket: see docket.h. */
#include "tests/chaos/docket.h"

#include "common/image.h"
#include "tests/chaos/errand.h"
#include "tests/chaos/job_kinds.h"
#include "tests/chaos/process.h"
#include "tests/chaos/words.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__
enum { SLOWNESS = 8 };
#else
enum { SLOWNESS = 1 };
#endif
enum { MAX_JOBS = 500, MAX_REFERENCES = 200, SEEDS = 3, SPP_CHARS = 16 };
static const double COMMAND_LIMIT = 90;     /* seconds for a command; it has time-outs of its own */
static const double REFERENCE_LIMIT = 600;  /* seconds for a render */
static const double STATUS_INTERVAL = 0.25; /* seconds between questions */
static const double RETRY = 0.4;            /* seconds after a failed command */
static const double PAUSE = 1;              /* seconds, of a job that is paused */
static const char *const TIMEOUT = "2";     /* of the commands, seconds */

/* What the image of a job has to be. */
typedef struct {
    const job_kind_t *kind;
    unsigned seed;
    bool extended;
    errand_t render;
    char *image;
    bool ready;
    hash_t hash;
} reference_t;

typedef enum {
    SENDING,   /* the submission runs, or waits for its next attempt */
    UNSURE,    /* it failed: the next status tells whether the master has the job */
    RENDERING, /* the master has it */
    FETCHING,  /* it is done; the image is being fetched */
    COMPARING, /* the image is here, the reference may not be */
    EXTENDING, /* proved; the order for more samples is under way */
    PAUSING,   /* ordered once, whatever comes of it */
    RESUMING,  /* ordered until it goes on */
    PROVED,
    WRONG
} stage_t;

/* What the master said last. */
typedef struct {
    char state[16];
    uint64_t issued, counted, returned, out, skipped, total;
    uint64_t batches, batches_refused, units_reissued;
} account_t;

typedef struct {
    const job_kind_t *kind;
    char *name;
    uint64_t number; /* the master's; 0: not known yet */
    unsigned seed;
    stage_t stage;
    bool promised; /* its submission succeeded: the master may never forget it */
    bool resumed;  /* so did the order to go on after a pause */
    bool extended, paused;
    errand_t errand;
    double submitted, changed, next_try;
    reference_t *reference;
    account_t account;
    uint64_t counted;    /* when samples were out last: what the film really held, */
    unsigned generation; /* under this master */
    char *image;
    hash_t hash;
} docket_job_t;

struct docket {
    docket_setup_t setup;
    dice_t dice;
    docket_job_t jobs[MAX_JOBS];
    size_t job_count;
    reference_t references[MAX_REFERENCES];
    size_t reference_count;
    errand_t status;
    double next_status;
    unsigned generation, status_generation; /* of masters: now, and when it was asked */
    size_t deck[JOB_KINDS], deck_left;
    docket_sum_t sum;
};

docket_t *docket_new(const docket_setup_t *setup)
{
    docket_t *docket = mem_zalloc(1, sizeof *docket);
    docket->setup = *setup;
    docket->dice = dice_new(setup->seed, 2);
    return docket;
}

void docket_free(docket_t **docket_pointer)
{
    docket_t *docket = *docket_pointer;
    if (docket == NULL) return;
    for (size_t i = 0; i < docket->job_count; i++) {
        errand_end(&docket->jobs[i].errand);
        free(docket->jobs[i].name);
        free(docket->jobs[i].image);
    }
    for (size_t i = 0; i < docket->reference_count; i++) {
        errand_end(&docket->references[i].render);
        free(docket->references[i].image);
    }
    errand_end(&docket->status);
    free(docket);
    *docket_pointer = NULL;
}

void docket_new_master(docket_t *docket)
{
    docket->generation++;
}

static void enter(docket_job_t *job, stage_t stage, double now)
{
    job->stage = stage;
    job->changed = now;
    job->next_try = now;
}

static void violate(docket_t *docket, docket_job_t *job, const char *what)
{
    const account_t *a = &job->account;
    report_violation(
        docket->setup.report,
        "%s (job %llu, %s, seed %u): %s; %s, issued %llu, counted %llu of %llu, returned %llu, out "
        "%llu, skipped %llu",
        job->name, (unsigned long long)job->number, job->kind->name, job->seed, what, a->state,
        (unsigned long long)a->issued, (unsigned long long)a->counted, (unsigned long long)a->total,
        (unsigned long long)a->returned, (unsigned long long)a->out, (unsigned long long)a->skipped);
    job->stage = WRONG;
}

/* ---- commands ----------------------------------------------------------------------------------------- */

static void add_master(const docket_t *docket, words_t *words)
{
    WORDS_ADD(words, "--master", docket->setup.master, "--timeout", TIMEOUT);
    words_add_all(words, docket->setup.passes->client);
}

static char *file_of(const docket_t *docket, const char *name, const char *suffix)
{
    return mem_printf("%s/%s%s", docket->setup.folder, name, suffix);
}

static void start_command(docket_t *docket, docket_job_t *job, const words_t *words, const char *suffix)
{
    char *output = file_of(docket, job->name, suffix);
    errand_start(&job->errand, output, words->list, false);
    free(output);
}

/* How many samples a pixel a kind of job has, as text in `text`. */
static const char *spp_of(const job_kind_t *kind, bool extended, char text[SPP_CHARS])
{
    unsigned spp = (extended ? kind->extended_spp : kind->spp) / SLOWNESS;
    snprintf(text, SPP_CHARS, "%u", spp > 0 ? spp : 1);
    return text;
}

/* What the image depends on. */
static void add_settings(words_t *words, const job_kind_t *kind, bool extended, unsigned seed,
                         char text[2][SPP_CHARS])
{
    words_add_all(words, kind->options);
    if (kind->spp > 0) WORDS_ADD(words, "--spp", spp_of(kind, extended, text[0]));
    snprintf(text[1], SPP_CHARS, "%u", seed);
    WORDS_ADD(words, "--seed", text[1]);
}

static void submit(docket_t *docket, docket_job_t *job)
{
    words_t words = {0};
    char text[2][SPP_CHARS];
    words_add(&words, "submit");
    add_settings(&words, job->kind, false, job->seed, text);
    words_add_all(&words, job->kind->terms);
    WORDS_ADD(&words, "--name", job->name);
    add_master(docket, &words);
    start_command(docket, job, &words, ".submit.log");
}

static void fetch(docket_t *docket, docket_job_t *job)
{
    char number[24];
    snprintf(number, sizeof number, "%llu", (unsigned long long)job->number);
    free(job->image);
    job->image = file_of(docket, job->name, job->extended ? ".extended.exr" : ".exr");
    words_t words = {.list = {"fetch", number, "-o", job->image}, .count = 4};
    add_master(docket, &words);
    start_command(docket, job, &words, ".fetch.log");
}

static void order(docket_t *docket, docket_job_t *job, const char *command, const char *option,
                  const char *value)
{
    char number[24];
    snprintf(number, sizeof number, "%llu", (unsigned long long)job->number);
    words_t words = {.list = {command, number}, .count = 2};
    if (option) words_add(&words, option);
    if (option) words_add(&words, value);
    add_master(docket, &words);
    start_command(docket, job, &words, ".order.log");
}

static void extend(docket_t *docket, docket_job_t *job)
{
    char spp[SPP_CHARS];
    order(docket, job, "extend", "--spp", spp_of(job->kind, true, spp));
}

static void pause_job(docket_t *docket, docket_job_t *job)
{
    order(docket, job, "pause", NULL, NULL);
}

static void resume_job(docket_t *docket, docket_job_t *job)
{
    order(docket, job, "resume", NULL, NULL);
}

/* ---- references --------------------------------------------------------------------------------------- */

static void render_reference(reference_t *reference)
{
    words_t words = {0};
    char text[2][SPP_CHARS];
    words_add(&words, "render");
    add_settings(&words, reference->kind, reference->extended, reference->seed, text);
    WORDS_ADD(&words, "--quiet", "-o", reference->image);
    char *output = mem_printf("%s.log", reference->image);
    errand_start(&reference->render, output, words.list, true);
    free(output);
}

static reference_t *reference_for(docket_t *docket, const docket_job_t *job)
{
    for (size_t i = 0; i < docket->reference_count; i++) {
        reference_t *made = &docket->references[i];
        if (made->kind == job->kind && made->seed == job->seed && made->extended == job->extended)
            return made;
    }
    reference_t *reference = &docket->references[docket->reference_count++];
    *reference = (reference_t){.kind = job->kind, .seed = job->seed, .extended = job->extended};
    reference->image = mem_printf("%s/reference-%s-%u%s.exr", docket->setup.folder, job->kind->name,
                                  job->seed, job->extended ? "-extended" : "");
    render_reference(reference);
    return reference;
}

static result_t hash_of(const char *path, hash_t *hash)
{
    image_t image;
    TRY(image_read_exr(path, &image));
    *hash = image_hash(&image);
    image_free(&image);
    return result_ok();
}

static void tick_reference(docket_t *docket, reference_t *reference, double now)
{
    switch (errand_poll(&reference->render, now, REFERENCE_LIMIT)) {
    case ERRAND_DONE:
        reference->ready = hash_of(reference->image, &reference->hash).code == RESULT_OK;
        if (!reference->ready) report_violation(docket->setup.report, "%s cannot be read", reference->image);
        break;
    case ERRAND_FAILED:
        report_violation(docket->setup.report, "%s cannot be rendered", reference->image);
        break;
    default:
        break;
    }
}

/* ---- what the master says ----------------------------------------------------------------------------- */

/* Takes a number out of a job's status; false when it is not there. */
static bool number_of(const json_t *object, const char *name, uint64_t *value)
{
    const json_t *field = json_object_get(object, name);
    if (!json_is_integer(field) || json_integer_value(field) < 0) return false;
    *value = (uint64_t)json_integer_value(field);
    return true;
}

static bool read_account(const json_t *object, account_t *account)
{
    const char *state = json_string_value(json_object_get(object, "state"));
    if (state == NULL) return false;
    snprintf(account->state, sizeof account->state, "%s", state);
    return number_of(object, "samples_issued", &account->issued) &&
           number_of(object, "samples_counted", &account->counted) &&
           number_of(object, "samples_returned", &account->returned) &&
           number_of(object, "samples_out", &account->out) &&
           number_of(object, "samples_skipped", &account->skipped) &&
           number_of(object, "samples_total", &account->total) &&
           number_of(object, "batches", &account->batches) &&
           number_of(object, "batches_refused", &account->batches_refused) &&
           number_of(object, "units_reissued", &account->units_reissued);
}

/* What must hold at any time. */
static const char *check_account(const docket_t *docket, const docket_job_t *job)
{
    const account_t *a = &job->account;
    if (a->issued != a->counted + a->returned + a->out) return "issued is not counted + returned + out";
    if (a->total > 0 && a->counted > a->total) return "more is counted than wanted";
    if (a->skipped > 0) return "samples were skipped";
    if (strcmp(a->state, "failed") == 0 || strcmp(a->state, "cancelled") == 0) return "it has ended badly";
    bool same = job->generation == docket->generation && docket->status_generation == docket->generation;
    if (same && a->out > 0 && a->counted < job->counted) return "counted samples were lost";
    if (strcmp(a->state, "done") != 0) return NULL;
    if (a->out > 0) return "it is done and samples are out";
    if (a->total > 0 && a->counted != a->total) return "it is done and not all is counted";
    return NULL;
}

/* The master was asked after the job entered its stage: what it says of the state is no older. */
static void advance(docket_job_t *job, double now)
{
    const account_t *a = &job->account;
    bool done = strcmp(a->state, "done") == 0, paused = strcmp(a->state, "paused") == 0;
    bool to_pause = job->kind->paused && !job->paused && 4 * a->counted > a->total;
    if (job->stage == RENDERING && done)
        enter(job, FETCHING, now);
    else if (job->stage == RENDERING && to_pause)
        enter(job, PAUSING, now);
    else if (job->stage == RENDERING && paused)
        enter(job, RESUMING, now); /* the order had failed: it was done, and is forgotten */
    else if (job->stage == RESUMING && job->errand.process == 0 && !paused)
        enter(job, RENDERING, now); /* the order has failed, and was done */
}

static void take_account(docket_t *docket, docket_job_t *job, const json_t *object, double now)
{

    if (!number_of(object, "job", &job->number) || !read_account(object, &job->account)) {
        violate(docket, job, "its status lacks a field");
        return;
    }
    const char *wrong = check_account(docket, job);
    bool later = docket->status.started > job->changed;
    if (later && job->resumed && strcmp(job->account.state, "paused") == 0) wrong = "it is paused again";
    /* Before a new master has read the film, it tells what its journal knows, and nothing is out. */
    if (job->account.out > 0 && docket->status_generation == docket->generation) {
        job->counted = job->account.counted;
        job->generation = docket->generation;
    }
    if (wrong) {
        violate(docket, job, wrong);
        return;
    }
    if (job->stage == UNSURE) enter(job, RENDERING, now);
    if (later) advance(job, now);
}

/* The master does not know the job, though it was asked after the last that it was told of it. */
static void miss(docket_t *docket, docket_job_t *job, double now)
{
    if (job->promised && job->stage != WRONG) violate(docket, job, "the master has forgotten it");
    if (job->stage == PROVED || job->stage == WRONG || job->stage == SENDING) return;
    errand_end(&job->errand);
    job->account = (account_t){0};
    job->counted = 0;
    job->paused = job->extended = false;
    job->reference = reference_for(docket, job);
    enter(job, SENDING, now);
}

static const json_t *find_job(const json_t *jobs, const char *name)
{
    for (size_t i = 0; i < json_array_size(jobs); i++) {
        const json_t *object = json_array_get(jobs, i);
        const char *its_name = json_string_value(json_object_get(object, "name"));
        if (its_name && strcmp(its_name, name) == 0) return object;
    }
    return NULL;
}

static void take_status(docket_t *docket, double now)
{
    char *text = errand_said(&docket->status);
    json_t *root = json_loads(text, 0, NULL);
    const json_t *jobs = json_object_get(root, "jobs");
    if (!json_is_array(jobs)) report_violation(docket->setup.report, "status --json says \"%.200s\"", text);
    for (size_t i = 0; i < docket->job_count && json_is_array(jobs); i++) {
        docket_job_t *job = &docket->jobs[i];
        const json_t *object = find_job(jobs, job->name);
        bool later = docket->status.started > job->changed;
        if (object && job->stage != WRONG && job->stage != SENDING)
            take_account(docket, job, object, now);
        else if (object == NULL && later)
            miss(docket, job, now);
    }
    docket->sum.questions += json_is_array(jobs);
    json_decref(root);
    free(text);
}

static void tick_status(docket_t *docket, double now)
{
    switch (errand_poll(&docket->status, now, COMMAND_LIMIT)) {
    case ERRAND_DONE:
        take_status(docket, now);
        break;
    case ERRAND_NONE:
        if (now < docket->next_status) break;
        char *output = file_of(docket, "status", ".json");
        words_t words = {.list = {"status", "--json"}, .count = 2};
        add_master(docket, &words);
        docket->next_status = now + STATUS_INTERVAL;

        docket->status_generation = docket->generation;
        errand_start(&docket->status, output, words.list, false);
        free(output);
        break;
    default:
        break;
    }
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
    docket_job_t *job = &docket->jobs[docket->job_count++];
    *job = (docket_job_t){.kind = draw_kind(docket), .seed = 1 + (unsigned)dice_below(&docket->dice, SEEDS)};
    job->name = mem_printf("chaos-%zu", docket->job_count);
    job->submitted = now;
    job->reference = reference_for(docket, job);
    enter(job, SENDING, now);
    docket->sum.submitted++;
    report_line(docket->setup.report, "%s: %s, seed %u", job->name, job->kind->name, job->seed);
}

/* A command crashed, hung, or was not understood. */
static void violate_command(docket_t *docket, docket_job_t *job)
{
    char *how = process_how(job->errand.how), *said = errand_said(&job->errand);
    char *text = mem_printf("a command ended with %s: %.300s", how, said);
    violate(docket, job, text);
    free(text);
    free(said);
    free(how);
}

/* Drives a command to its success; true then. A failure is tried again, after `failed` where it is given. */
static bool succeed(docket_t *docket, docket_job_t *job, double now,
                    void (*start)(docket_t *, docket_job_t *), bool *failed)
{
    *failed = false;
    switch (errand_poll(&job->errand, now, COMMAND_LIMIT)) {
    case ERRAND_NONE:
        if (now >= job->next_try) start(docket, job);
        return false;
    case ERRAND_DONE:
        return true;
    case ERRAND_FAILED:
        job->next_try = now + RETRY;
        *failed = job->errand.how != RESULT_USAGE && job->errand.how < PROCESS_SIGNALLED;
        if (!*failed) violate_command(docket, job);
        return false;
    default:
        return false;
    }
}

static void prove(docket_t *docket, docket_job_t *job, double now)
{
    if (!job->reference->ready) return;
    if (!hash_equal(&job->hash, &job->reference->hash)) {
        violate(docket, job, "its image is not that of the undisturbed render");
        return;
    }
    bool more = job->kind->extended_spp && !job->extended;
    const account_t *a = &job->account;
    report_line(docket->setup.report, "%s is right%s: %.1f s, %llu counted, %.1f%% rendered again", job->name,
                more ? " so far" : "", now - job->submitted, (unsigned long long)a->counted,
                100.0 * (double)a->returned / (double)(a->counted ? a->counted : 1));
    unlink(job->image);
    enter(job, more ? EXTENDING : PROVED, now);
    if (more) return;
    docket->sum.proved++;
    docket->sum.longest = fmax(docket->sum.longest, now - job->submitted);
}

static void tick_job(docket_t *docket, docket_job_t *job, double now)
{
    bool failed;
    switch (job->stage) {
    case SENDING:
        job->promised = succeed(docket, job, now, submit, &failed);
        if (job->promised || failed) enter(job, job->promised ? RENDERING : UNSURE, now);
        break;
    case FETCHING:
        if (!succeed(docket, job, now, fetch, &failed)) break;
        enter(job, COMPARING, now);
        if (hash_of(job->image, &job->hash).code != RESULT_OK)
            violate(docket, job, "its image cannot be read");
        break;
    case COMPARING:
        prove(docket, job, now);
        break;
    case EXTENDING:
        if (!succeed(docket, job, now, extend, &failed)) break;
        job->extended = true;
        job->reference = reference_for(docket, job);
        enter(job, RENDERING, now);
        break;
    case PAUSING:
        if (!succeed(docket, job, now, pause_job, &failed) && !failed) break;
        job->paused = true;
        enter(job, RESUMING, now);
        job->next_try = now + PAUSE;
        break;
    case RESUMING:
        if (!succeed(docket, job, now, resume_job, &failed)) break;
        job->resumed = true;
        enter(job, RENDERING, now);
        break;
    default:
        break;
    }
}

static bool is_open(const docket_job_t *job)
{
    return job->stage != PROVED && job->stage != WRONG;
}

void docket_tick(docket_t *docket, double now, bool more)
{
    size_t open = 0;
    tick_status(docket, now);
    for (size_t i = 0; i < docket->reference_count; i++) tick_reference(docket, &docket->references[i], now);
    for (size_t i = 0; i < docket->job_count; i++) {
        tick_job(docket, &docket->jobs[i], now);
        open += is_open(&docket->jobs[i]);
    }
    if (more && open < docket->setup.at_a_time && docket->job_count < MAX_JOBS) new_job(docket, now);
}

bool docket_settled(const docket_t *docket)
{
    for (size_t i = 0; i < docket->job_count; i++)
        if (is_open(&docket->jobs[i])) return false;
    return true;
}

docket_sum_t docket_sum(const docket_t *docket)
{
    docket_sum_t sum = docket->sum;
    for (size_t i = 0; i < docket->job_count; i++) {
        const account_t *account = &docket->jobs[i].account;
        sum.issued += account->issued;
        sum.counted += account->counted;
        sum.batches += account->batches;
        sum.batches_refused += account->batches_refused;
        sum.units_reissued += account->units_reissued;
    }
    return sum;
}

void docket_describe(const docket_t *docket)
{
    static const char *const stages[] = {"is being submitted", "may have been submitted",
                                         "is being rendered",  "is being fetched",
                                         "is being compared",  "is being extended",
                                         "is being paused",    "is being resumed",
                                         "is right",           "is wrong"};
    for (size_t i = 0; i < docket->job_count; i++) {
        const docket_job_t *job = &docket->jobs[i];
        if (job->stage == PROVED) continue;
        report_line(docket->setup.report, "%s (job %llu, %s) %s: %s, counted %llu of %llu, out %llu",
                    job->name, (unsigned long long)job->number, job->kind->name, stages[job->stage],
                    job->account.state, (unsigned long long)job->account.counted,
                    (unsigned long long)job->account.total, (unsigned long long)job->account.out);
    }
}
