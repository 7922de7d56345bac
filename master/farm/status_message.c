/* status_message: see status_message.h. */
#include "master/farm/status_message.h"

#include <string.h>

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
    status->saved = report->record.saved;
    status->checkpoint_age = report->checkpoint_age;
    status->submitted = report->record.submitted;
    status->ended = report->record.finished;
}

void status_message_fill(job_report_t *report, status_message_t *out)
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
    status->evidence = report->evidence;
    status->evidence_limit = report->evidence_limit;
    status->message = report->record.message;
    fill_progress(report, status);
}

void worker_message_fill(gate_t *gate, worker_report_t *report, Lm__WorkerStatus *status)
{
    char name[KEY_MAX_NAME + 1];
    gate_key_name(gate, report->key, name);
    if (name[0] != '\0') memcpy(report->key, name, sizeof name);
    lm__worker_status__init(status);
    status->name = report->name;
    status->key = report->key;
    status->address = report->address;
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
