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

/* ---- workers ------------------------------------------------------------------------------------------- */

bool wire_worker_is(const char *name, const char *who)
{
    size_t host = strcspn(name, ":");
    return strcmp(name, who) == 0 || (strlen(who) == host && strncmp(name, who, host) == 0);
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

/* Fields that a message and a type of ours call by the same name, for a macro that is told each. The small
 * settings are an int or an enum here, and a uint32 in the message. */
#define SMALL_SETTINGS(FIELD)                                                                                \
    FIELD(integrator)                                                                                        \
    FIELD(sampler)                                                                                           \
    FIELD(width)                                                                                             \
    FIELD(height) FIELD(max_depth) FIELD(tile_size) FIELD(film_scale) FIELD(strategy_s) FIELD(strategy_t)
#define SETTINGS(FIELD)                                                                                      \
    SMALL_SETTINGS(FIELD)                                                                                    \
    FIELD(seed)                                                                                              \
    FIELD(spp)                                                                                               \
    FIELD(time_limit)                                                                                        \
    FIELD(features)                                                                                          \
    FIELD(unweighted)                                                                                        \
    FIELD(error) FIELD(adaptive) FIELD(cryptomatte) FIELD(learn) FIELD(merge_radius) FIELD(spectral)
#define TERMS(FIELD) FIELD(priority) FIELD(verify) FIELD(mixed) FIELD(halves)
#define ORDER(FIELD) FIELD(job) FIELD(kind) FIELD(priority) FIELD(spp) FIELD(error) FIELD(time_limit)
#define COUNTS(FIELD) FIELD(dropped) FIELD(overflows) FIELD(rays) FIELD(cpu_us)
#define COPY(field) to->field = (typeof(to->field))from->field;

void wire_settings_put(const job_settings_t *from, Lm__Settings *to)
{
    SETTINGS(COPY);
    to->n_save_at = from->save_at.count;
    to->save_at = (uint32_t *)from->save_at.spp;
    to->light_groups = (char *)from->light_groups;
}

/* job_settings_check looks at the counts themselves. */
static result_t get_save_at(const Lm__Settings *from, save_at_t *to)
{
    if (from->n_save_at > JOB_MAX_SAVES)
        return result_fail(RESULT_PROTOCOL, "%zu sample counts to save images at, the limit is %d",
                           from->n_save_at, JOB_MAX_SAVES);
    to->count = (uint32_t)from->n_save_at;
    for (uint32_t i = 0; i < to->count; i++) to->spp[i] = from->save_at[i];
    return result_ok();
}

result_t wire_settings_get(const Lm__Settings *from, job_settings_t *to)
{
    if (from == NULL) return result_fail(RESULT_PROTOCOL, "a message without settings");
#define CHECK(field)                                                                                         \
    if (from->field > INT32_MAX)                                                                             \
        return result_fail(RESULT_PROTOCOL, #field " is %u, out of all bounds", from->field);
    SMALL_SETTINGS(CHECK)
#undef CHECK
    *to = (job_settings_t){0};
    SETTINGS(COPY);
    TRY(get_save_at(from, &to->save_at));
    if (strlen(from->light_groups) > LIGHT_GROUPS_TEXT)
        return result_fail(RESULT_PROTOCOL, "light groups of %zu bytes, the limit is %d",
                           strlen(from->light_groups), LIGHT_GROUPS_TEXT);
    strcpy(to->light_groups, from->light_groups);
    return job_settings_check(to);
}

void wire_terms_put(const job_terms_t *from, Lm__Terms *to)
{
    TERMS(COPY);
}

result_t wire_terms_get(const Lm__Terms *from, const char *name, job_terms_t *to)
{
    *to = (job_terms_t){0};
    snprintf(to->name, sizeof to->name, "%s", name);
    if (from == NULL) return result_ok();
    TERMS(COPY);
    return job_terms_check(to);
}

void wire_order_put(const job_order_t *from, Lm__JobOrder *to)
{
    ORDER(COPY);
    to->who = (char *)from->who;
}

result_t wire_order_get(const Lm__JobOrder *from, job_order_t *to)
{
    if (from->kind < ORDER_CANCEL || from->kind > ORDER_TAKE_OUT)
        return result_fail(RESULT_PROTOCOL, "an order of unknown kind %u", from->kind);
    *to = (job_order_t){0};
    ORDER(COPY);
    snprintf(to->who, sizeof to->who, "%s", from->who);
    if (to->kind == ORDER_TAKE_OUT && to->who[0] == '\0')
        return result_fail(RESULT_USAGE, "whose samples are to be taken out is not said");
    if (to->spp > JOB_MAX_SPP)
        return result_fail(RESULT_USAGE, "samples a pixel is %u, must be at most %d", to->spp, JOB_MAX_SPP);
    if (!(to->error >= 0 && to->error < 1))
        return result_fail(RESULT_USAGE, "error is %g, must be 0 (as it was) or below 1", to->error);
    if (!(to->time_limit >= 0 && to->time_limit <= 1e9))
        return result_fail(RESULT_USAGE, "time limit is %g s, must be from 0 (as it was) to 1e9",
                           to->time_limit);
    return result_ok();
}

void wire_counts_put(const film_counts_t *from, Lm__Counts *to)
{
    to->light_paths_even = from->light_paths[0];
    to->light_paths_odd = from->light_paths[1];
    COUNTS(COPY);
}

void wire_counts_get(const Lm__Counts *from, film_counts_t *to)
{
    *to = (film_counts_t){0};
    if (from == NULL) return; /* proto3 leaves out a message of zeroes */
    to->light_paths[0] = from->light_paths_even;
    to->light_paths[1] = from->light_paths_odd;
    COUNTS(COPY);
}

Lm__Unit **wire_units_new(const unit_t *units, const issue_t *issues, size_t count)
{
    if (count == 0) return NULL;
    Lm__Unit **messages = mem_alloc(count * (sizeof *messages + sizeof **messages));
    Lm__Unit *storage = (Lm__Unit *)(messages + count);
    for (size_t i = 0; i < count; i++) {
        lm__unit__init(&storage[i]);
        storage[i].tile = units[i].tile;
        storage[i].first = units[i].first;
        storage[i].count = units[i].count;
        if (issues != NULL) {
            storage[i].mac = issues[i].mac;
            storage[i].before = issues[i].before;
            storage[i].after = issues[i].after;
        }
        messages[i] = &storage[i];
    }
    return messages;
}

result_t wire_units_get(Lm__Unit *const *messages, size_t count, const job_settings_t *settings,
                        unit_t *units, issue_t *issues)
{
    if (count > WIRE_MAX_UNITS)
        return result_fail(RESULT_PROTOCOL, "%zu units, the limit is %d", count, WIRE_MAX_UNITS);
    for (size_t i = 0; i < count; i++)
        units[i] = (unit_t){messages[i]->tile, messages[i]->first, messages[i]->count};
    for (size_t i = 0; i < count && issues != NULL; i++)
        issues[i] = (issue_t){messages[i]->mac, messages[i]->before, messages[i]->after};
    return settings != NULL ? job_check_units(settings, units, count) : result_ok();
}

result_t wire_batch_get(wire_message_t *message, batch_t *batch, issue_t **issues)
{
    const Lm__BatchResult *body = message->envelope->batch_result;
    *issues = NULL;
    if (message->payload_count < BATCH_BASE_PAYLOADS)
        return result_fail(RESULT_PROTOCOL, "a batch has %d payloads, and %d are the least",
                           message->payload_count, BATCH_BASE_PAYLOADS);
    while (message->payload_count < BATCH_PAYLOADS) /* empty ones were left out: payload_count */
        zmq_msg_init(&message->payload[message->payload_count++]);
    if (body->n_units == 0) return result_fail(RESULT_PROTOCOL, "a batch without units");
    batch->unit_count = batch->unit_capacity = body->n_units;
    batch->units = mem_alloc(body->n_units * sizeof *batch->units);
    *issues = mem_alloc(body->n_units * sizeof **issues);
    wire_counts_get(body->counts, &batch->counts);
    return wire_units_get(body->units, body->n_units, NULL, batch->units, *issues);
}

Lm__Plan **wire_plans_new(const hash_t plans[LEARNING_PASSES], size_t *count)
{
    Lm__Plan **messages = mem_alloc(LEARNING_PASSES * (sizeof *messages + sizeof **messages));
    Lm__Plan *storage = (Lm__Plan *)(messages + LEARNING_PASSES);
    *count = 0;
    for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++) {
        if (hash_is_zero(&plans[pass])) continue;
        Lm__Plan *plan = &storage[*count];
        lm__plan__init(plan);
        plan->pass = pass;
        plan->blob = wire_hash_put(&plans[pass]);
        messages[(*count)++] = plan;
    }
    return messages;
}

/* Whether each unit lies within one pass, whose plan is named if it has one. */
static result_t check_passes(const job_settings_t *settings, const unit_t *units, size_t count,
                             const hash_t plans[LEARNING_PASSES])
{
    for (size_t i = 0; i < count && job_learns(settings); i++) {
        uint32_t pass = learning_pass(settings, units[i].first);
        if (unit_end(&units[i]) > learning_pass_begin(settings, pass + 1))
            return result_fail(RESULT_PROTOCOL, "a unit of samples %u + %u crosses passes", units[i].first,
                               units[i].count);
        if (learning_teachers(pass) > 0 && hash_is_zero(&plans[pass]))
            return result_fail(RESULT_PROTOCOL, "units of pass %u without a plan", pass);
    }
    return result_ok();
}

result_t wire_plans_get(Lm__Plan *const *messages, size_t message_count, const job_settings_t *settings,
                        const unit_t *units, size_t count, hash_t plans[LEARNING_PASSES])
{
    memset(plans, 0, LEARNING_PASSES * sizeof *plans);
    for (size_t i = 0; i < message_count && job_learns(settings); i++) {
        uint32_t pass = messages[i]->pass;
        if (pass >= learning_passes(settings) || learning_teachers(pass) == 0)
            return result_fail(RESULT_PROTOCOL, "a plan of pass %u, which has none", pass);
        if (!wire_hash_get(&messages[i]->blob, &plans[pass]))
            return result_fail(RESULT_PROTOCOL, "a plan without a hash");
    }
    return check_passes(settings, units, count, plans);
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
