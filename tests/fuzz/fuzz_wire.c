/* fuzz_wire: any bytes as the header frame of a message: as they are, and as the envelope behind a preamble
 * and a checksum that are right. Whatever is accepted must be within the limits and must survive what a
 * master, a worker or a client does with it. */
#include "tests/fuzz/fuzz.h"

#include "common/plain_text.h"
#include "proto/wire/checksum.h"
#include "proto/wire/wire.h"

#include <stdlib.h>
#include <string.h>

enum { ENVELOPE_AT = 9 };

static void check_string(const char *text)
{
    if (text == NULL) return;
    fuzz_expect(strlen(text) <= WIRE_MAX_STRING, "a string over the limit");
    for (size_t length; *text != '\0'; text += length) {
        length = plain_text_character(text);
        fuzz_expect(length > 0, "a character in a string that must not be shown");
        if (length == 0) return;
    }
}

static void check_settings(const Lm__Settings *message, job_settings_t *settings)
{
    result_t result = wire_settings_get(message, settings);
    if (result.code != RESULT_OK) {
        fuzz_expect(result.message[0] != '\0', "an error without text");
        *settings = job_settings_default();
        return;
    }
    fuzz_expect(job_settings_check(settings).code == RESULT_OK, "settings that were not checked");
    Lm__Settings again = LM__SETTINGS__INIT;
    job_settings_t copy;
    wire_settings_put(settings, &again);
    fuzz_expect(wire_settings_get(&again, &copy).code == RESULT_OK, "settings do not come back");
}

static void check_units(Lm__Unit *const *messages, size_t count, const job_settings_t *settings)
{
    fuzz_expect(count <= WIRE_MAX_UNITS, "too many units");
    unit_t *units = mem_alloc((count + 1) * sizeof *units);
    if (wire_units_get(messages, count, settings, units, NULL).code == RESULT_OK)
        for (size_t i = 0; i < count; i++)
            fuzz_expect(job_unit_valid(settings, &units[i]), "a unit that is not of the job");
    free(units);
}

/* What the message holds, read as its receiver would. */
static void look_at(const Lm__Envelope *envelope)
{
    job_settings_t settings = job_settings_default();
    job_terms_t terms;
    job_order_t order;
    film_counts_t counts;
    hash_t hash;
    switch (envelope->body_case) {
    case LM__ENVELOPE__BODY_REFUSAL:
        check_string(envelope->refusal->reason);
        break;
    case LM__ENVELOPE__BODY_HELLO:
        check_string(envelope->hello->name);
        wire_hash_get(&envelope->hello->fingerprint, &hash);
        for (size_t i = 0; i < envelope->hello->n_capabilities; i++)
            check_string(envelope->hello->capabilities[i]);
        break;
    case LM__ENVELOPE__BODY_ASSIGNMENT:
        check_settings(envelope->assignment->settings, &settings);
        check_units(envelope->assignment->units, envelope->assignment->n_units, &settings);
        wire_hash_get(&envelope->assignment->blob, &hash);
        break;
    case LM__ENVELOPE__BODY_GOODBYE:
        check_string(envelope->goodbye->reason);
        break;
    case LM__ENVELOPE__BODY_JOB_SUBMIT:
        check_settings(envelope->job_submit->settings, &settings);
        check_string(envelope->job_submit->name);
        if (wire_terms_get(envelope->job_submit->terms, envelope->job_submit->name, &terms).code == RESULT_OK)
            fuzz_expect(job_terms_check(&terms).code == RESULT_OK, "terms that were not checked");
        break;
    case LM__ENVELOPE__BODY_JOB_ORDER:
        if (wire_order_get(envelope->job_order, &order).code == RESULT_OK)
            fuzz_expect(order.kind >= ORDER_CANCEL && order.kind <= ORDER_EXTEND, "an order of no kind");
        break;
    case LM__ENVELOPE__BODY_JOB_STATUS_REPLY:
        for (size_t i = 0; i < envelope->job_status_reply->n_jobs; i++) {
            const Lm__JobStatus *job = envelope->job_status_reply->jobs[i];
            check_string(job->name);
            check_string(job->message);
            job_state_name(job->state);
            wire_counts_get(job->counts, &counts);
        }
        break;
    case LM__ENVELOPE__BODY_BATCH_RESULT:
        check_units(envelope->batch_result->units, envelope->batch_result->n_units, &settings);
        wire_counts_get(envelope->batch_result->counts, &counts);
        break;
    default:
        break;
    }
}

/* Decodes a header frame, which is taken over. */
static void decode(zmq_msg_t *header)
{
    wire_message_t message = {.header_open = true};
    message.header = *header;
    result_t result = wire_decode(&message);
    fuzz_expect((result.code == RESULT_OK) == (message.envelope != NULL), "no envelope");
    if (message.envelope != NULL) {
        look_at(message.envelope);
    } else {
        fuzz_expect(result.message[0] != '\0', "an error without text");
    }
    fuzz_expect(!message.header_open, "a header that is left open");
    wire_free(&message);
}

int fuzz_wire(const uint8_t *data, size_t size)
{
    zmq_msg_t frame;
    zmq_msg_init_size(&frame, size);
    if (size > 0) memcpy(zmq_msg_data(&frame), data, size);
    decode(&frame);
    zmq_msg_init_size(&frame, ENVELOPE_AT + size);
    uint8_t *bytes = zmq_msg_data(&frame);
    uint32_t sum = checksum_add(0, data, size);
    memcpy(bytes, (uint8_t[]){'L', 'M', 'I', 'L', WIRE_VERSION}, 5);
    memcpy(bytes + 5, &sum, sizeof sum);
    if (size > 0) memcpy(bytes + ENVELOPE_AT, data, size);
    decode(&frame);
    return 0;
}
