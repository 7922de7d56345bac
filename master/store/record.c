/* record: see record.h. */
#include "master/store/record.h"

#include <math.h>
#include <stdio.h>

void record_put(const job_record_t *record, record_message_t *out)
{
    lm__job_record__init(&out->message);
    lm__settings__init(&out->settings);
    lm__terms__init(&out->terms);
    lm__account__init(&out->account);
    lm__counts__init(&out->counts);
    wire_settings_put(&record->settings, &out->settings);
    wire_terms_put(&record->terms, &out->terms);
    wire_counts_put(&record->counts, &out->counts);
    out->account.issued = record->account.issued;
    out->account.counted = record->account.counted;
    out->account.returned = record->account.returned;
    out->account.skipped = record->account.skipped;
    Lm__JobRecord *m = &out->message;
    m->job = record->job;
    m->name = (char *)record->terms.name;
    m->settings = &out->settings;
    m->terms = &out->terms;
    m->blob = wire_hash_put(&record->blob);
    m->blob_size = record->blob_size;
    m->state = (uint32_t)record->state;
    m->outcome = (uint32_t)record->outcome;
    m->retained = record->retained;
    m->fingerprint = wire_hash_put(&record->fingerprint);
    m->elapsed = record->elapsed;
    m->submitted = record->submitted;
    m->finished = record->finished;
    m->bytes = record->bytes;
    m->batches = record->batches;
    m->batches_refused = record->batches_refused;
    m->units_reissued = record->units_reissued;
    m->checks_passed = record->checks_passed;
    m->checks_failed = record->checks_failed;
    m->workers_seen = record->workers_seen;
    m->samples_done = record->samples_done;
    m->account = &out->account;
    m->counts = &out->counts;
    m->error = record->error;
    m->saved = record->saved;
    m->message = (char *)record->message;
    m->news = (uint32_t)record->news;
}

/* A time or a share: no NaN, nothing below zero. */
static result_t check_number(const char *name, double value)
{
    if (value >= 0 && isfinite(value)) return result_ok();
    return result_fail(RESULT_INPUT, "%s is %g", name, value);
}

static result_t check_numbers(const Lm__JobRecord *m)
{
    TRY(check_number("the time spent on it", m->elapsed));
    TRY(check_number("the time of its submission", m->submitted));
    TRY(check_number("the time of its end", m->finished));
    return check_number("its error", m->error);
}

static result_t check_states(const Lm__JobRecord *m)
{
    if (m->state < JOB_QUEUED || m->state > JOB_PAUSED)
        return result_fail(RESULT_INPUT, "it is in the unknown state %u", m->state);
    if (m->outcome > JOB_PAUSED || (m->state == JOB_FINISHING && !job_state_final(m->outcome)))
        return result_fail(RESULT_INPUT, "it is to end in the unknown state %u", m->outcome);
    if (m->news > JOB_PAUSED) return result_fail(RESULT_INPUT, "it tells of the unknown state %u", m->news);
    return result_ok();
}

result_t record_get(const Lm__JobRecord *m, job_record_t *record)
{
    *record = (job_record_t){0};
    if (m == NULL) return result_fail(RESULT_INPUT, "there is no record");
    if (m->job == 0) return result_fail(RESULT_INPUT, "the job has no number");
    TRY(wire_settings_get(m->settings, &record->settings));
    TRY(wire_terms_get(m->terms, m->name, &record->terms));
    if (!wire_hash_get(&m->blob, &record->blob)) return result_fail(RESULT_INPUT, "it names no scene");
    if (m->fingerprint.len > 0 && !wire_hash_get(&m->fingerprint, &record->fingerprint))
        return result_fail(RESULT_INPUT, "its fingerprint has %zu bytes", m->fingerprint.len);
    TRY(check_states(m));
    TRY(check_numbers(m));
    record->job = m->job;
    record->blob_size = m->blob_size;
    record->state = (job_state_t)m->state;
    record->outcome = (job_state_t)m->outcome;
    record->retained = m->retained;
    record->elapsed = m->elapsed;
    record->submitted = m->submitted;
    record->finished = m->finished;
    record->bytes = m->bytes;
    record->batches = m->batches;
    record->batches_refused = m->batches_refused;
    record->units_reissued = m->units_reissued;
    record->checks_passed = m->checks_passed;
    record->checks_failed = m->checks_failed;
    record->workers_seen = m->workers_seen;
    record->samples_done = m->samples_done;
    if (m->account != NULL)
        record->account = (schedule_account_t){.issued = m->account->issued,
                                               .counted = m->account->counted,
                                               .returned = m->account->returned,
                                               .skipped = m->account->skipped};
    wire_counts_get(m->counts, &record->counts);
    record->error = m->error;
    record->saved = m->saved;
    snprintf(record->message, sizeof record->message, "%s", m->message);
    record->news = (job_state_t)m->news;
    return result_ok();
}

uint8_t *record_pack(const job_record_t *record, size_t *size)
{
    record_message_t message;
    record_put(record, &message);
    uint8_t *bytes = mem_alloc(lm__job_record__get_packed_size(&message.message));
    *size = lm__job_record__pack(&message.message, bytes);
    return bytes;
}

result_t record_unpack(const void *bytes, size_t size, job_record_t *record)
{
    size_t left = RECORD_MAX_DECODED;
    ProtobufCAllocator allocator = wire_allocator(&left);
    Lm__JobRecord *message = lm__job_record__unpack(&allocator, size, bytes);
    if (message == NULL) return result_fail(RESULT_INPUT, "a record of %zu bytes does not decode", size);
    result_t result = record_get(message, record);
    lm__job_record__free_unpacked(message, NULL);
    return result;
}
