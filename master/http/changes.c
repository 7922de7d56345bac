/* changes: see changes.h. */
#include "master/http/changes.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Jobs keep their order, so the one that is looked for is mostly where it was. */
static const job_report_t *find_job(const changes_t *changes, uint64_t job, size_t hint)
{
    if (hint < changes->job_count && changes->jobs[hint].record.job == job) return &changes->jobs[hint];
    for (size_t i = 0; i < changes->job_count; i++)
        if (changes->jobs[i].record.job == job) return &changes->jobs[i];
    return NULL;
}

static bool job_differs(const job_report_t *a, const job_report_t *b)
{
    const job_record_t *old = &a->record, *now = &b->record;
    return old->state != now->state || old->samples_done != now->samples_done || a->error != b->error ||
           a->samples_total != b->samples_total || a->workers != b->workers ||
           old->retained != now->retained || old->terms.priority != now->terms.priority ||
           old->settings.error != now->settings.error ||
           old->settings.time_limit != now->settings.time_limit || strcmp(old->message, now->message) != 0;
}

static json_t *job_change(const job_report_t *job)
{
    json_t *data = json_object();
    put_count(data, "job", job->record.job);
    put_text(data, "state", job_state_name(job->record.state));
    put_count(data, "samples_done", job->record.samples_done);
    put_count(data, "samples_total", job->samples_total);
    put_real(data, "elapsed", job->record.elapsed);
    put_real(data, "remaining", job->remaining);
    put_real(data, "error", job->error);
    put_count(data, "workers", job->workers);
    return data;
}

static json_t *image_change(const job_report_t *job)
{
    json_t *data = json_object();
    put_count(data, "job", job->record.job);
    put_count(data, "version", job->record.batches);
    return data;
}

/* What happened to a job, in a word and in a sentence's part. Takes over `why`. */
static void tell_note(const job_report_t *job, const char *what, char *why, change_fn tell, void *context)
{
    json_t *data = json_object();
    put_count(data, "job", job->record.job);
    put_text(data, "what", what);
    put_text(data, "why", why);
    free(why);
    tell(context, "note", data);
}

static void tell_progress(const changes_t *before, const changes_t *after, const job_report_t *old,
                          const job_report_t *now, change_fn tell, void *context)
{
    const job_record_t *was = &old->record, *is = &now->record;
    double saved = after->time - now->checkpoint_age, last = before->time - old->checkpoint_age;
    if (now->checkpoint_age >= 0 && (old->checkpoint_age < 0 || saved > last + 1e-3))
        tell_note(now, "checkpoint", mem_printf("at %" PRIu64 " samples", is->samples_done), tell, context);
    if (is->saved != was->saved)
        tell_note(now, "saved", mem_printf("the image at %" PRIu32 " samples a pixel", is->saved), tell,
                  context);
    if (is->checks_passed != was->checks_passed || is->checks_failed != was->checks_failed)
        tell_note(
            now, is->checks_failed != was->checks_failed ? "differs" : "verified",
            mem_printf("%" PRIu64 " passed, %" PRIu64 " failed so far", is->checks_passed, is->checks_failed),
            tell, context);
}

static bool is_extended(const job_settings_t *was, const job_settings_t *is)
{
    return was->spp != is->spp || was->error != is->error || was->time_limit != is->time_limit;
}

/* "to 64 samples a pixel or an error of 1 %". */
static char *goals(const job_settings_t *settings)
{
    char text[160] = "";
    size_t used = 0;
    if (settings->spp > 0)
        used += (size_t)snprintf(text, sizeof text, "to %" PRIu32 " samples a pixel", settings->spp);
    if (settings->error > 0)
        used += (size_t)snprintf(text + used, sizeof text - used, "%s an error of %g %%", used ? " or" : "to",
                                 100 * settings->error);
    if (settings->time_limit > 0)
        snprintf(text + used, sizeof text - used, "%s %g s", used ? " or" : "to", settings->time_limit);
    return mem_strdup(text);
}

static void tell_notes(const changes_t *before, const changes_t *after, const job_report_t *old,
                       const job_report_t *now, change_fn tell, void *context)
{
    tell_progress(before, after, old, now, tell, context);
    if (is_extended(&old->record.settings, &now->record.settings))
        tell_note(now, "extended", goals(&now->record.settings), tell, context);
    if (now->record.message[0] != '\0' && strcmp(old->record.message, now->record.message) != 0)
        tell_note(now, "message", mem_strdup(now->record.message), tell, context);
}

static void tell_jobs(const changes_t *before, const changes_t *after, change_fn tell, void *context)
{
    for (size_t i = 0; i < after->job_count; i++) {
        const job_report_t *now = &after->jobs[i], *old = find_job(before, now->record.job, i);
        if (old == NULL || job_differs(old, now)) tell(context, "job", job_change(now));
        if (now->record.batches != (old != NULL ? old->record.batches : 0))
            tell(context, "image", image_change(now));
        if (old != NULL) tell_notes(before, after, old, now, tell, context);
    }
    for (size_t i = 0; i < before->job_count; i++) {
        if (find_job(after, before->jobs[i].record.job, i) != NULL) continue;
        json_t *data = json_object();
        put_count(data, "job", before->jobs[i].record.job);
        put_text(data, "state", "deleted");
        tell(context, "job", data);
    }
}

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Names and keys are no one's own: two workers may have the same. */
static int by_number(const void *a, const void *b)
{
    const worker_report_t *left = a, *right = b;
    return left->number < right->number ? -1 : left->number > right->number;
}

/* NULL: there is none of this number. */
static const worker_report_t *find_worker(const changes_t *changes, const worker_report_t *like)
{
    if (changes->worker_count == 0) return NULL;
    return bsearch(like, changes->workers, changes->worker_count, sizeof *like, by_number);
}

static void tell_worker(const worker_report_t *worker, const char *what, change_fn tell, void *context)
{
    json_t *data = json_object();
    put_text(data, "name", worker->name);
    put_text(data, "what", what);
    put_text(data, "why", worker->aside);
    tell(context, "worker", data);
}

static void tell_workers(const changes_t *before, const changes_t *after, change_fn tell, void *context)
{
    for (size_t i = 0; i < after->worker_count; i++) {
        const worker_report_t *now = &after->workers[i], *old = find_worker(before, now);
        bool was_aside = old != NULL && old->aside[0] != '\0', is_aside = now->aside[0] != '\0';
        if (now->connected && (old == NULL || !old->connected)) tell_worker(now, "joined", tell, context);
        if (is_aside && !was_aside) tell_worker(now, "aside", tell, context);
        if (was_aside && !is_aside && now->connected) tell_worker(now, "back", tell, context);
    }
    for (size_t i = 0; i < before->worker_count; i++) {
        const worker_report_t *old = &before->workers[i], *now = find_worker(after, old);
        if (old->connected && (now == NULL || !now->connected)) tell_worker(old, "left", tell, context);
    }
}

/* ---- both ---------------------------------------------------------------------------------------------- */

static changes_t look(farm_t *farm)
{
    changes_t changes;
    uint32_t connected;
    changes.time = clock_now();
    changes.jobs = farm_report(farm, changes.time, 0, &changes.job_count, &connected);
    changes.workers = farm_worker_report(farm, changes.time, &changes.worker_count);
    if (changes.worker_count > 0)
        qsort(changes.workers, changes.worker_count, sizeof *changes.workers, by_number);
    return changes;
}

void changes_begin(changes_t *changes, farm_t *farm)
{
    changes_free(changes);
    *changes = look(farm);
}

void changes_tell(changes_t *changes, farm_t *farm, change_fn tell, void *context)
{
    changes_t now = look(farm);
    tell_jobs(changes, &now, tell, context);
    tell_workers(changes, &now, tell, context);
    changes_free(changes);
    *changes = now;
}

void changes_free(changes_t *changes)
{
    free(changes->jobs);
    free(changes->workers);
    *changes = (changes_t){0};
}
