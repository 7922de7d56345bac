/* control_reports: see control_reports.h. */
#include "master/threads/control_reports.h"

#include <stdlib.h>
#include <string.h>

enum {
    REPLY_BYTES = WIRE_MAX_HEADER / 2, /* of the list in one answer */
    ENTRY_BYTES = 8                    /* that an entry of the list takes beside itself */
};

/* One job's report as messages that point into it. */
typedef struct {
    Lm__JobStatus status;
    Lm__Settings settings;
    Lm__Terms terms;
    Lm__Counts counts;
} status_message_t;

static bool hash_is_zero(const hash_t *hash)
{
    return hash_equal(hash, &(hash_t){{0}});
}

static void fill_progress(const job_report_t *report, Lm__JobStatus *status)
{
    status->samples_done = report->record.samples_done;
    status->samples_total = report->samples_total;
    status->samples_issued = report->record.account.issued;
    status->samples_counted = report->record.account.counted;
    status->samples_returned = report->record.account.returned;
    status->samples_out = report->record.account.out;
    status->samples_skipped = report->record.account.skipped;
    status->elapsed = report->record.elapsed;
    status->remaining = report->remaining;
    status->error = report->error;
    status->checkpoint_age = report->checkpoint_age;
    status->submitted = report->record.submitted;
    status->ended = report->record.finished;
}

static void fill_status(job_report_t *report, status_message_t *out)
{
    lm__job_status__init(&out->status);
    lm__settings__init(&out->settings);
    lm__terms__init(&out->terms);
    lm__counts__init(&out->counts);
    wire_settings_put(&report->record.settings, &out->settings);
    wire_terms_put(&report->record.terms, &out->terms);
    wire_counts_put(&report->record.counts, &out->counts);
    Lm__JobStatus *status = &out->status;
    status->job = report->record.job;
    status->name = report->record.terms.name;
    status->state = (uint32_t)report->record.state;
    status->settings = &out->settings;
    status->terms = &out->terms;
    status->counts = &out->counts;
    status->blob = wire_hash_put(&report->record.blob);
    status->retained = report->record.retained;
    if (!hash_is_zero(&report->record.fingerprint))
        status->fingerprint = wire_hash_put(&report->record.fingerprint);
    status->workers = report->workers;
    status->workers_seen = report->record.workers_seen;
    status->bytes_received = report->record.bytes;
    status->batches = report->record.batches;
    status->batches_refused = report->record.batches_refused;
    status->units_reissued = report->record.units_reissued;
    status->checks_passed = report->record.checks_passed;
    status->checks_failed = report->record.checks_failed;
    status->message = report->record.message;
    fill_progress(report, status);
}

/* Puts the reports from number `from` on into the answer, as many as fit. */
static void fill_jobs(job_report_t *reports, size_t count, uint64_t from, status_message_t *statuses,
                      Lm__JobStatusReply *body)
{
    size_t bytes = 0;
    for (size_t i = 0; i < count && body->next == 0; i++) {
        if (reports[i].record.job < from) continue;
        status_message_t *message = &statuses[body->n_jobs];
        fill_status(&reports[i], message);
        bytes += lm__job_status__get_packed_size(&message->status) + ENTRY_BYTES;
        if (bytes > REPLY_BYTES)
            body->next = reports[i].record.job;
        else
            body->jobs[body->n_jobs++] = &message->status;
    }
}

/* Adds the history of a job's error to its status; returns memory that has to live as long, for two calls of
 * free: the points themselves are in *points. */
static Lm__ErrorPoint **fill_history(farm_t *farm, Lm__JobStatus *status, Lm__ErrorPoint **points)
{
    size_t count;
    error_point_t *history = farm_job_history(farm, status->job, &count);
    Lm__ErrorPoint **list = mem_alloc((count + 1) * sizeof *list);
    *points = mem_alloc((count + 1) * sizeof **points);
    for (size_t i = 0; i < count; i++) {
        list[i] = &(*points)[i];
        lm__error_point__init(list[i]);
        list[i]->elapsed = history[i].elapsed;
        list[i]->samples = history[i].samples;
        list[i]->error = history[i].error;
    }
    free(history);
    status->n_history = count;
    status->history = list;
    return list;
}

result_t report_jobs(farm_t *farm, double now, const Lm__JobStatusRequest *request, uint32_t bulk_port,
                     report_send_fn send, void *context)
{
    size_t count;
    Lm__JobStatusReply body = LM__JOB_STATUS_REPLY__INIT;
    job_report_t *reports = farm_report(farm, now, request->job, &count, &body.workers);
    if (request->job != 0 && count == 0)
        return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)request->job);
    status_message_t *statuses = mem_alloc((count + 1) * sizeof *statuses);
    body.jobs = mem_alloc((count + 1) * sizeof(Lm__JobStatus *));
    body.bulk_port = bulk_port;
    fill_jobs(reports, count, request->job != 0 ? 0 : request->from, statuses, &body);
    Lm__ErrorPoint *points = NULL, **history = NULL;
    if (request->job != 0 && request->history) history = fill_history(farm, body.jobs[0], &points);
    send(context, LM__ENVELOPE__BODY_JOB_STATUS_REPLY, &body);
    free(history);
    free(points);
    free(body.jobs);
    free(statuses);
    free(reports);
    return result_ok();
}

static void fill_worker(gate_t *gate, worker_report_t *report, Lm__WorkerStatus *status)
{
    char name[KEY_MAX_NAME + 1];
    gate_key_name(gate, report->key, name);
    if (name[0] != '\0') memcpy(report->key, name, sizeof name);
    lm__worker_status__init(status);
    status->name = report->name;
    status->key = report->key;
    status->threads = report->threads;
    if (!hash_is_zero(&report->fingerprint)) status->fingerprint = wire_hash_put(&report->fingerprint);
    status->relay = report->relay;
    status->connected = report->connected;
    status->aside = report->aside;
    status->job = report->job;
    status->units_held = report->units_held;
    status->speed = report->speed;
    status->batches = report->batches;
    status->batches_refused = report->batches_refused;
    status->units_reissued = report->units_reissued;
    status->bytes = report->bytes;
    status->last_seen = report->last_seen;
}

void report_workers(farm_t *farm, gate_t *gate, double now, const Lm__WorkerListRequest *request,
                    report_send_fn send, void *context)
{
    size_t count, bytes = 0;
    worker_report_t *reports = farm_worker_report(farm, now, &count);
    Lm__WorkerStatus *statuses = mem_alloc((count + 1) * sizeof *statuses);
    Lm__WorkerList body = LM__WORKER_LIST__INIT;
    body.workers = mem_alloc((count + 1) * sizeof(Lm__WorkerStatus *));
    for (size_t i = request->from; i < count && body.next == 0; i++) {
        fill_worker(gate, &reports[i], &statuses[i]);
        bytes += lm__worker_status__get_packed_size(&statuses[i]) + ENTRY_BYTES;
        if (bytes > REPLY_BYTES)
            body.next = (uint32_t)i;
        else
            body.workers[body.n_workers++] = &statuses[i];
    }
    send(context, LM__ENVELOPE__BODY_WORKER_LIST, &body);
    free(body.workers);
    free(statuses);
    free(reports);
}
