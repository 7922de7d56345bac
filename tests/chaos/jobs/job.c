/* job: see job.h. */
#include "tests/chaos/jobs/job.h"

#include "tests/chaos/process.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const double COMMAND_LIMIT = 90; /* seconds for a command; it has time-outs of its own */
static const double RETRY = 0.4;        /* seconds after a failed command */
static const double PAUSE = 1;          /* seconds, of a job that is paused */
static const char *const TIMEOUT = "2"; /* of the commands, seconds */

static void enter(job_t *job, job_stage_t stage, double now)
{
    job->stage = stage;
    job->changed = now;
    job->next_try = now;
}

static void use_reference(job_t *job)
{
    job->reference = references_get(job->setup->references, job->kind, job->seed, job->extended);
}

void job_begin(job_t *job, const job_setup_t *setup, const job_kind_t *kind, unsigned seed, size_t number,
               double now)
{
    *job = (job_t){.setup = setup, .kind = kind, .seed = seed, .submitted = now};
    job->name = mem_printf("chaos-%zu", number);
    use_reference(job);
    enter(job, JOB_SENDING, now);
    report_line(setup->report, "%s: %s, seed %u", job->name, kind->name, seed);
}

void job_free(job_t *job)
{
    command_end(&job->command);
    free(job->name);
    free(job->image);
}

static void violate(job_t *job, const char *what)
{
    const account_t *a = &job->account;
    report_violation(
        job->setup->report,
        "%s (job %llu, %s, seed %u): %s; %s, issued %llu, counted %llu of %llu, returned %llu, out "
        "%llu, skipped %llu",
        job->name, (unsigned long long)a->job, job->kind->name, job->seed, what, a->state,
        (unsigned long long)a->issued, (unsigned long long)a->counted, (unsigned long long)a->total,
        (unsigned long long)a->returned, (unsigned long long)a->out, (unsigned long long)a->skipped);
    job->stage = JOB_WRONG;
}

/* ---- commands ----------------------------------------------------------------------------------------- */

void job_master_words(const job_setup_t *setup, words_t *words)
{
    WORDS_ADD(words, "--master", setup->master, "--timeout", TIMEOUT);
    words_add_all(words, setup->passes->client);
}

/* What the command says goes to NAME`suffix`. */
static void start_command(job_t *job, words_t *words, const char *suffix)
{
    char *output = mem_printf("%s/%s%s", job->setup->folder, job->name, suffix);
    job_master_words(job->setup, words);
    command_start(&job->command, output, words->list, false);
    free(output);
}

static void submit(job_t *job)
{
    words_t words = {0};
    job_text_t text = {0};
    words_add(&words, "submit");
    job_kind_words(job->kind, job->setup->references->smaller, job->seed, false, &words, &text);
    words_add_all(&words, job->kind->terms);
    WORDS_ADD(&words, "--name", job->name);
    start_command(job, &words, ".submit.log");
    job->sent++;
}

/* A command about the job: "COMMAND NUMBER OPTION VALUE"; the last two may be missing. */
static void start_order(job_t *job, const char *command, const char *option, const char *value)
{
    char number[24];
    snprintf(number, sizeof number, "%llu", (unsigned long long)job->account.job);
    words_t words = {0};
    WORDS_ADD(&words, command, number, option, value);
    start_command(job, &words, ".order.log");
}

static void fetch(job_t *job)
{
    free(job->image);
    job->image = mem_printf("%s/%s%s.exr", job->setup->folder, job->name, job->extended ? ".extended" : "");
    start_order(job, "fetch", "-o", job->image);
}

static void extend(job_t *job)
{
    job_text_t text = {0};
    start_order(job, "extend", "--spp",
                job_kind_spp(job->kind, job->setup->references->smaller, true, &text));
}

static void pause_job(job_t *job)
{
    start_order(job, "pause", NULL, NULL);
}

static void resume_job(job_t *job)
{
    start_order(job, "resume", NULL, NULL);
}

static void delete_job(job_t *job)
{
    start_order(job, "delete", NULL, NULL);
}

/* ---- what the master says ----------------------------------------------------------------------------- */

/* What the film holds may fall when the master has died, and never else. Before a new one has read the film,
 * it tells what its journal knows, and nothing is out. */
static bool has_lost_samples(job_t *job, const job_answer_t *answer)
{
    if (answer->master == 0 || job->account.out == 0) return false;
    bool lost = job->counted_by == answer->master && job->account.counted < job->counted;
    job->counted = job->account.counted;
    job->counted_by = answer->master;
    return lost;
}

/* An order to submit it that nobody answered may be done after it was given anew: then there are two of them.
 * The other was deleted, this one is left alone. */
static bool is_twin(const job_t *job)
{
    return job->deleted != 0 && job->account.job != job->deleted && job->sent > 1;
}

static const char *check(job_t *job, const job_answer_t *answer)
{
    const char *wrong = account_check(&job->account);
    if (is_twin(job)) return wrong;
    if (has_lost_samples(job, answer)) wrong = "counted samples were lost";
    bool later = answer->asked > job->changed;
    if (later && job->resumed && account_is(&job->account, "paused")) wrong = "it is paused again";
    if (later && job->lasting && job->account.total == job->first_total)
        wrong = "its extension was forgotten";
    if (later && job->deleted != 0) wrong = "it was deleted and is back";
    return wrong;
}

static void take_extended(job_t *job, bool extended)
{
    job->extended = extended;
    use_reference(job);
}

/* The master was asked after the job entered its stage: what it says of the state is no older. */
static void advance(job_t *job, double now)
{
    const account_t *a = &job->account;
    bool extended = a->total > job->first_total;
    bool paused = account_is(a, "paused");
    bool to_pause = job->kind->paused && !job->paused && 4 * a->counted > a->total;
    if (job->stage == JOB_RENDERING && job->extended && !extended) {
        take_extended(job, false); /* the order had failed, was done, and is forgotten */
        enter(job, JOB_EXTENDING, now);
    } else if (job->stage == JOB_RENDERING && account_is(a, "done"))
        enter(job, JOB_FETCHING, now);
    else if (job->stage == JOB_RENDERING && to_pause)
        enter(job, JOB_PAUSING, now);
    else if (job->stage == JOB_RENDERING && paused)
        enter(job, JOB_RESUMING, now); /* the order had failed: it was done, and is forgotten */
    else if (job->stage == JOB_RESUMING && job->command.process == 0 && !paused)
        enter(job, JOB_RENDERING, now); /* the order has failed, and was done */
    else if (job->stage == JOB_EXTENDING && job->command.process == 0 && extended) {
        take_extended(job, true); /* this order, too, has failed, and was done */
        enter(job, JOB_RENDERING, now);
    }
}

static void take_account(job_t *job, const json_t *object, const job_answer_t *answer, double now)
{
    bool complete = account_read(object, &job->account);
    const char *wrong = complete ? check(job, answer) : "its status lacks a field";
    if (wrong) {
        violate(job, wrong);
        return;
    }
    if (job->stage == JOB_UNSURE) enter(job, JOB_RENDERING, now);
    if (answer->asked > job->changed) advance(job, now);
}

/* The master does not know the job, though it was asked after the last that it was told of it. */
static void miss(job_t *job, double now)
{
    if (job->promised && job->stage != JOB_WRONG) violate(job, "the master has forgotten it");
    if (job->stage == JOB_DELETING) {
        if (job->command.process == 0) enter(job, JOB_PROVED, now); /* the order has failed, and was done */
        return;
    }
    if (!job_is_open(job) || job->stage == JOB_SENDING) return;
    command_end(&job->command);
    job->account = (account_t){0};
    job->counted = 0;
    job->paused = false;
    take_extended(job, false);
    enter(job, JOB_SENDING, now);
}

void job_take(job_t *job, const json_t *object, const job_answer_t *answer, double now)
{
    if (object && job->stage != JOB_WRONG && job->stage != JOB_SENDING)
        take_account(job, object, answer, now);
    else if (object == NULL && answer->asked > job->changed)
        miss(job, now);
}

/* ---- the course of a job ------------------------------------------------------------------------------ */

/* A command crashed, hung, or was not understood. */
static void violate_command(job_t *job)
{
    char *how = process_how(job->command.how), *said = command_said(&job->command);
    char *text = mem_printf("a command ended with %s: %.300s", how, said);
    violate(job, text);
    free(text);
    free(said);
    free(how);
}

/* Drives a command to its success; true then. A failure is tried again; *failed tells of it. */
static bool succeed(job_t *job, double now, void (*start)(job_t *), bool *failed)
{
    *failed = false;
    switch (command_poll(&job->command, now, COMMAND_LIMIT)) {
    case COMMAND_NONE:
        if (now >= job->next_try) start(job);
        return false;
    case COMMAND_DONE:
        return true;
    case COMMAND_FAILED:
        job->next_try = now + RETRY;
        *failed = job->command.how != RESULT_USAGE && job->command.how < PROCESS_SIGNALLED;
        if (!*failed) violate_command(job);
        return false;
    default:
        return false;
    }
}

static void prove(job_t *job, double now)
{
    if (!job->reference->ready) return;
    if (!hash_equal(&job->hash, &job->reference->hash)) {
        violate(job, "its image is not that of the undisturbed render");
        return;
    }
    bool more = job->kind->extended_spp && !job->extended;
    const account_t *a = &job->account;
    report_line(job->setup->report, "%s is right%s: %.1f s, %llu counted, %.1f%% rendered again", job->name,
                more ? " so far" : "", now - job->submitted, (unsigned long long)a->counted,
                100.0 * (double)a->returned / (double)(a->counted ? a->counted : 1));
    unlink(job->image);
    if (job->kind->deleted) job->promised = false;
    if (more) job->first_total = a->total;
    enter(job, more ? JOB_EXTENDING : job->kind->deleted ? JOB_DELETING : JOB_PROVED, now);
}

/* True when the order to extend was refused because the film is gone, and the master's log tells why: a full
 * disk takes the films of jobs that are over and not retained. */
static bool film_made_room(const job_t *job)
{
    char *said = command_said(&job->command), *log = mem_printf("%s/master.log", job->setup->folder);
    char *line = mem_printf("the film of job %llu (", (unsigned long long)job->account.job);
    uint8_t *bytes = NULL;
    size_t size = 0;
    bool gone = strstr(said, "is no longer kept") &&
                file_read(log, 1 << 28, &bytes, &size).code == RESULT_OK &&
                memmem(bytes, size, line, strlen(line));
    free(bytes);
    free(line);
    free(log);
    free(said);
    return gone;
}

void job_tick(job_t *job, double now)
{
    bool failed;
    switch (job->stage) {
    case JOB_SENDING:
        job->promised = succeed(job, now, submit, &failed);
        if (job->promised || failed) enter(job, job->promised ? JOB_RENDERING : JOB_UNSURE, now);
        break;
    case JOB_FETCHING:
        if (!succeed(job, now, fetch, &failed)) break;
        enter(job, JOB_COMPARING, now);
        if (references_hash(job->image, &job->hash).code != RESULT_OK)
            violate(job, "its image cannot be read");
        break;
    case JOB_COMPARING:
        prove(job, now);
        break;
    case JOB_EXTENDING:
        if (succeed(job, now, extend, &failed)) {
            job->promised = job->lasting = true;
            take_extended(job, true);
            enter(job, JOB_RENDERING, now);
        } else if (failed && film_made_room(job)) {
            report_line(job->setup->report, "%s is not extended: its film made room on a full disk",
                        job->name);
            enter(job, JOB_PROVED, now);
        }
        break;
    case JOB_PAUSING:
        if (!succeed(job, now, pause_job, &failed) && !failed) break;
        job->paused = true;
        enter(job, JOB_RESUMING, now);
        job->next_try = now + PAUSE;
        break;
    case JOB_RESUMING:
        if (!succeed(job, now, resume_job, &failed)) break;
        job->resumed = true;
        enter(job, JOB_RENDERING, now);
        break;
    case JOB_DELETING:
        if (!succeed(job, now, delete_job, &failed)) break;
        job->deleted = job->account.job;
        enter(job, JOB_PROVED, now);
        break;
    default:
        break;
    }
}

bool job_is_open(const job_t *job)
{
    return job->stage != JOB_PROVED && job->stage != JOB_WRONG;
}

void job_describe(const job_t *job)
{
    static const char *const stages[] = {[JOB_SENDING] = "is being submitted",
                                         [JOB_UNSURE] = "may have been submitted",
                                         [JOB_RENDERING] = "is being rendered",
                                         [JOB_FETCHING] = "is being fetched",
                                         [JOB_COMPARING] = "is being compared",
                                         [JOB_EXTENDING] = "is being extended",
                                         [JOB_PAUSING] = "is being paused",
                                         [JOB_RESUMING] = "is being resumed",
                                         [JOB_DELETING] = "is being deleted",
                                         [JOB_PROVED] = "is right",
                                         [JOB_WRONG] = "is wrong"};
    const account_t *a = &job->account;
    report_line(job->setup->report, "%s (job %llu, %s) %s: %s, counted %llu of %llu, out %llu", job->name,
                (unsigned long long)a->job, job->kind->name, stages[job->stage], a->state,
                (unsigned long long)a->counted, (unsigned long long)a->total, (unsigned long long)a->out);
}
