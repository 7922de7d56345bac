/* wire_fields: what the fields of messages mean (see wire.h): states and rights; settings, terms, orders,
 * units and counts to and from their messages. What comes from a message is checked against every limit that
 * its type has. */
#include "proto/wire/wire.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- names of states ----------------------------------------------------------------------------------- */

const char *job_state_name(uint32_t state)
{
    static const char *const names[] = {
        [JOB_QUEUED] = "queued", [JOB_RUNNING] = "running",     [JOB_FINISHING] = "finishing",
        [JOB_DONE] = "done",     [JOB_CANCELLED] = "cancelled", [JOB_FAILED] = "failed",
        [JOB_PAUSED] = "paused"};
    return state >= JOB_QUEUED && state <= JOB_PAUSED ? names[state] : "unknown";
}

bool job_state_final(uint32_t state)
{
    return state == JOB_DONE || state == JOB_CANCELLED || state == JOB_FAILED;
}

/* ---- rights -------------------------------------------------------------------------------------------- */

const char *wire_rights_name(unsigned rights)
{
    switch (rights & RIGHTS_ALL) {
    case RIGHT_WORK:
        return "may work";
    case RIGHT_CLIENT:
        return "may submit and control jobs";
    case RIGHTS_ALL:
        return "may do everything";
    default:
        return "may do nothing";
    }
}

/* ---- settings, units, counts, hashes ------------------------------------------------------------------- */

/* Fields that a message and a type of ours call by the same name, for a macro that is told each. */
#define SMALL_SETTINGS(FIELD) /* here an int or an enum, in the message a uint32 */                          \
    FIELD(integrator)                                                                                        \
    FIELD(sampler)                                                                                           \
    FIELD(width)                                                                                             \
    FIELD(height) FIELD(max_depth) FIELD(tile_size) FIELD(film_scale) FIELD(strategy_s) FIELD(strategy_t)
#define SETTINGS(FIELD)                                                                                      \
    SMALL_SETTINGS(FIELD)                                                                                    \
    FIELD(seed) FIELD(spp) FIELD(time_limit) FIELD(features) FIELD(unweighted) FIELD(error) FIELD(adaptive)

void wire_settings_put(const job_settings_t *settings, Lm__Settings *message)
{
#define PUT(field) message->field = (typeof(message->field))settings->field;
    SETTINGS(PUT)
#undef PUT
}

result_t wire_settings_get(const Lm__Settings *message, job_settings_t *settings)
{
    if (message == NULL) return result_fail(RESULT_PROTOCOL, "a message without settings");
#define CHECK(field)                                                                                         \
    if (message->field > INT32_MAX)                                                                          \
        return result_fail(RESULT_PROTOCOL, #field " is %u, out of all bounds", message->field);
    SMALL_SETTINGS(CHECK)
#undef CHECK
#define GET(field) .field = (typeof(settings->field))message->field,
    *settings = (job_settings_t){SETTINGS(GET)};
#undef GET
    return job_settings_check(settings);
}

void wire_terms_put(const job_terms_t *terms, Lm__Terms *message)
{
    message->priority = terms->priority;
    message->verify = terms->verify;
    message->mixed = terms->mixed;
}

result_t wire_terms_get(const Lm__Terms *message, const char *name, job_terms_t *terms)
{
    *terms = (job_terms_t){0};
    snprintf(terms->name, sizeof terms->name, "%s", name);
    if (message == NULL) return result_ok();
    terms->priority = message->priority;
    terms->verify = message->verify;
    terms->mixed = message->mixed;
    return job_terms_check(terms);
}

void wire_order_put(const job_order_t *order, Lm__JobOrder *message)
{
    message->job = order->job;
    message->kind = (uint32_t)order->kind;
    message->priority = order->priority;
    message->spp = order->spp;
    message->error = order->error;
    message->time_limit = order->time_limit;
}

result_t wire_order_get(const Lm__JobOrder *message, job_order_t *order)
{
    if (message->kind < ORDER_CANCEL || message->kind > ORDER_EXTEND)
        return result_fail(RESULT_PROTOCOL, "an order of unknown kind %u", message->kind);
    *order = (job_order_t){.job = message->job,
                           .kind = (order_kind_t)message->kind,
                           .priority = message->priority,
                           .spp = message->spp,
                           .error = message->error,
                           .time_limit = message->time_limit};
    if (order->spp > JOB_MAX_SPP)
        return result_fail(RESULT_USAGE, "samples a pixel is %u, must be at most %d", order->spp,
                           JOB_MAX_SPP);
    if (!(order->error >= 0 && order->error < 1))
        return result_fail(RESULT_USAGE, "error is %g, must be 0 (as it was) or below 1", order->error);
    if (!(order->time_limit >= 0 && order->time_limit <= 1e9))
        return result_fail(RESULT_USAGE, "time limit is %g s, must be from 0 (as it was) to 1e9",
                           order->time_limit);
    return result_ok();
}

void wire_counts_put(const film_counts_t *counts, Lm__Counts *message)
{
    message->light_paths_even = counts->light_paths[0];
    message->light_paths_odd = counts->light_paths[1];
    message->dropped = counts->dropped;
    message->overflows = counts->overflows;
    message->rays = counts->rays;
    message->cpu_us = counts->cpu_us;
}

void wire_counts_get(const Lm__Counts *message, film_counts_t *counts)
{
    *counts = (film_counts_t){0};
    if (message == NULL) return; /* proto3 leaves out a message of zeroes */
    counts->light_paths[0] = message->light_paths_even;
    counts->light_paths[1] = message->light_paths_odd;
    counts->dropped = message->dropped;
    counts->overflows = message->overflows;
    counts->rays = message->rays;
    counts->cpu_us = message->cpu_us;
}

Lm__Unit **wire_units_new(const unit_t *units, size_t count)
{
    if (count == 0) return NULL;
    Lm__Unit **messages = mem_alloc(count * (sizeof *messages + sizeof **messages));
    Lm__Unit *storage = (Lm__Unit *)(messages + count);
    for (size_t i = 0; i < count; i++) {
        lm__unit__init(&storage[i]);
        storage[i].tile = units[i].tile;
        storage[i].first = units[i].first;
        storage[i].count = units[i].count;
        messages[i] = &storage[i];
    }
    return messages;
}

result_t wire_units_get(Lm__Unit *const *messages, size_t count, const job_settings_t *settings,
                        unit_t *units)
{
    if (count > WIRE_MAX_UNITS)
        return result_fail(RESULT_PROTOCOL, "%zu units, the limit is %d", count, WIRE_MAX_UNITS);
    for (size_t i = 0; i < count; i++)
        units[i] = (unit_t){messages[i]->tile, messages[i]->first, messages[i]->count};
    return settings != NULL ? job_check_units(settings, units, count) : result_ok();
}

result_t wire_batch_get(const wire_message_t *message, batch_t *batch)
{
    const Lm__BatchResult *body = message->envelope->batch_result;
    if (message->payload_count != BATCH_PAYLOADS)
        return result_fail(RESULT_PROTOCOL, "a batch has %d payloads, not %d", message->payload_count,
                           BATCH_PAYLOADS);
    if (body->n_units == 0) return result_fail(RESULT_PROTOCOL, "a batch without units");
    batch->unit_count = batch->unit_capacity = body->n_units;
    batch->units = mem_alloc(body->n_units * sizeof *batch->units);
    wire_counts_get(body->counts, &batch->counts);
    return wire_units_get(body->units, body->n_units, NULL, batch->units);
}

bool wire_hash_get(const ProtobufCBinaryData *bytes, hash_t *hash)
{
    if (bytes->len != HASH_BYTES) return false;
    memcpy(hash->bytes, bytes->data, HASH_BYTES);
    return true;
}

ProtobufCBinaryData wire_hash_put(const hash_t *hash)
{
    return (ProtobufCBinaryData){HASH_BYTES, (uint8_t *)hash->bytes};
}
