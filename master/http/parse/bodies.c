/* bodies: see bodies.h. */
#include "master/http/parse/bodies.h"

#include "common/plain_text.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

result_t body_parse(const char *text, size_t size, json_t **object)
{
    json_error_t error;
    *object = size == 0 ? json_object() : json_loadb(text, size, JSON_REJECT_DUPLICATES, &error);
    if (*object == NULL)
        return result_fail(RESULT_USAGE, "the body is no JSON: line %d, column %d: %.200s", error.line,
                           error.column, error.text);
    if (json_is_object(*object)) return result_ok();
    json_decref(*object);
    *object = NULL;
    return result_fail(RESULT_USAGE, "the body is to be a JSON object, like {\"spp\": 256}");
}

/* ---- members ------------------------------------------------------------------------------------------- */

/* A number from `least` to `most`, whole if `whole`; *number stays as it is when there is none. */
static result_t take_number(json_t *body, const char *key, double least, double most, bool whole,
                            double *number)
{
    const json_t *value = json_object_get(body, key);
    if (value == NULL) return result_ok();
    double got = json_number_value(value);
    bool good = whole ? json_is_integer(value) : json_is_number(value);
    if (!good || !(got >= least && got <= most))
        return result_fail(RESULT_USAGE, "%s is a %snumber from %.10g to %.10g", key, whole ? "whole " : "",
                           least, most);
    *number = got;
    json_object_del(body, key);
    return result_ok();
}

/* A whole number, or `missing`. */
static result_t take_count(json_t *body, const char *key, int32_t least, int32_t most, int32_t missing,
                           int32_t *count)
{
    double number = missing;
    TRY(take_number(body, key, least, most, true, &number));
    *count = (int32_t)number;
    return result_ok();
}

/* A relative error; *error stays as it is when there is none. */
static result_t take_error(json_t *body, double *error)
{
    double number = 0;
    TRY(take_number(body, "error", 1e-9, 1, false, &number));
    if (number >= 1) return result_fail(RESULT_USAGE, "error is a number below 1: 0.01 is 1 %%");
    if (number > 0) *error = number;
    return result_ok();
}

/* *flag stays as it is when there is none. */
static result_t take_flag(json_t *body, const char *key, bool *flag)
{
    const json_t *value = json_object_get(body, key);
    if (value == NULL) return result_ok();
    if (!json_is_boolean(value)) return result_fail(RESULT_USAGE, "%s is true or false", key);
    *flag = json_is_true(value);
    json_object_del(body, key);
    return result_ok();
}

/* The place of one of `names` from 1; 0 when there is none. */
static result_t take_choice(json_t *body, const char *key, const char *const names[], int *choice)
{
    char known[80] = "";
    const json_t *value = json_object_get(body, key);
    *choice = 0;
    if (value == NULL) return result_ok();
    for (int i = 0; names[i] != NULL; i++) {
        size_t used = strlen(known);
        snprintf(known + used, sizeof known - used, "%s%s", i > 0 ? ", " : "", names[i]);
        if (json_is_string(value) && strcmp(json_string_value(value), names[i]) == 0) *choice = i + 1;
    }
    if (*choice == 0) return result_fail(RESULT_USAGE, "%s is one of %s", key, known);
    json_object_del(body, key);
    return result_ok();
}

/* What was not taken has a name that nobody knows. */
static result_t check_rest(json_t *body, const char *what)
{
    void *rest = json_object_iter(body);
    if (rest == NULL) return result_ok();
    return result_fail(RESULT_USAGE, "%s knows no '%.60s'", what, json_object_iter_key(rest));
}

/* ---- orders -------------------------------------------------------------------------------------------- */

static result_t take_goals(json_t *body, job_order_t *order)
{
    double spp = 0;
    TRY(take_number(body, "spp", 1, JOB_MAX_SPP, true, &spp));
    TRY(take_error(body, &order->error));
    TRY(take_number(body, "time", 0.1, 1e9, false, &order->time_limit));
    order->spp = (uint32_t)spp;
    return result_ok();
}

static result_t take_priority(json_t *body, job_order_t *order)
{
    double priority = NAN;
    TRY(take_number(body, "priority", -JOB_MAX_PRIORITY, JOB_MAX_PRIORITY, true, &priority));
    if (isnan(priority)) return result_fail(RESULT_USAGE, "say the priority: {\"priority\": 1}");
    order->priority = (int32_t)priority;
    return result_ok();
}

result_t body_order(json_t *body, order_kind_t kind, job_order_t *order)
{
    order->kind = kind;
    if (kind == ORDER_EXTEND) TRY(take_goals(body, order));
    if (kind == ORDER_PRIORITY) TRY(take_priority(body, order));
    return check_rest(body, "this order");
}

/* ---- submissions --------------------------------------------------------------------------------------- */

static result_t take_blob(json_t *body, hash_t *blob)
{
    const json_t *value = json_object_get(body, "blob");
    if (!hash_from_hex(json_is_string(value) ? json_string_value(value) : "", json_string_length(value),
                       blob))
        return result_fail(RESULT_USAGE,
                           "blob is the hash of a scene, %d hexadecimal digits: lightmill import SCENE "
                           "makes its blob, and PUT /api/v1/blobs/HASH sends it",
                           2 * HASH_BYTES);
    json_object_del(body, "blob");
    return result_ok();
}

/* Without a name the job is called after its scene's hash. */
static result_t take_name(json_t *body, const hash_t *blob, char name[JOB_MAX_NAME + 1])
{
    char hex[2 * HASH_BYTES + 1];
    const json_t *value = json_object_get(body, "name");
    hash_to_hex(blob, hex);
    snprintf(name, JOB_MAX_NAME + 1, "%.12s", hex);
    if (value == NULL) return result_ok();
    if (!json_is_string(value) || json_string_length(value) < 1 || json_string_length(value) > JOB_MAX_NAME)
        return result_fail(RESULT_USAGE, "name is a text of 1 to %d bytes", JOB_MAX_NAME);
    snprintf(name, JOB_MAX_NAME + 1, "%s", json_string_value(value));
    plain_text_clean(name);
    json_object_del(body, "name");
    return result_ok();
}

/* A whole number below 2^64: a number, or its digits as a text where JSON programs would round it. */
static result_t take_seed(json_t *body, overrides_t *overrides)
{
    const json_t *value = json_object_get(body, "seed");
    if (value == NULL) return result_ok();
    const char *text = json_is_string(value) ? json_string_value(value) : "";
    errno = 0;
    overrides->seed = json_is_integer(value) ? (uint64_t)json_integer_value(value) : strtoull(text, NULL, 10);
    bool digits = *text != '\0' && text[strspn(text, "0123456789")] == '\0' && errno == 0;
    if (!digits && !(json_is_integer(value) && json_integer_value(value) >= 0))
        return result_fail(RESULT_USAGE, "seed is a whole number below 2^64, or a text with its digits");
    overrides->has_seed = true;
    json_object_del(body, "seed");
    return result_ok();
}

static result_t take_save_at(json_t *body, save_at_t *save_at)
{
    const json_t *list = json_object_get(body, "save_at");
    if (list == NULL) return result_ok();
    bool good = json_is_array(list) && json_array_size(list) <= JOB_MAX_SAVES;
    for (size_t i = 0; good && i < json_array_size(list); i++) {
        const json_t *value = json_array_get(list, i);
        json_int_t spp = json_integer_value(value), last = i > 0 ? (json_int_t)save_at->spp[i - 1] : 0;
        good = json_is_integer(value) && spp > last && spp <= JOB_MAX_SPP;
        if (good) save_at->spp[i] = (uint32_t)spp;
        if (good) save_at->count++;
    }
    if (!good)
        return result_fail(RESULT_USAGE,
                           "save_at is a list of at most %d rising numbers of samples, like [16, 64, 256]",
                           JOB_MAX_SAVES);
    json_object_del(body, "save_at");
    return result_ok();
}

static result_t take_size(json_t *body, overrides_t *overrides)
{
    TRY(take_count(body, "width", 1, JOB_MAX_RESOLUTION, 0, &overrides->width));
    TRY(take_count(body, "height", 1, JOB_MAX_RESOLUTION, 0, &overrides->height));
    if ((overrides->width > 0) == (overrides->height > 0)) return result_ok();
    return result_fail(RESULT_USAGE, "width and height belong together");
}

static result_t take_end(json_t *body, overrides_t *overrides)
{
    int32_t spp;
    TRY(take_count(body, "spp", 1, JOB_MAX_SPP, 0, &spp));
    overrides->spp = (uint32_t)spp;
    TRY(take_number(body, "time", 0.1, 1e9, false, &overrides->time_limit));
    TRY(take_error(body, &overrides->error));
    TRY(take_flag(body, "adaptive", &overrides->adaptive));
    return take_save_at(body, &overrides->save_at);
}

static result_t take_light_groups(json_t *body, http_submission_t *submission)
{
    const json_t *value = json_object_get(body, "light_groups");
    if (value == NULL) return result_ok();
    if (!json_is_string(value) || json_string_length(value) > LIGHT_GROUPS_TEXT)
        return result_fail(RESULT_USAGE,
                           "light_groups is a text of at most %d bytes, like \"key=3+4,sky=infinite\"",
                           LIGHT_GROUPS_TEXT);
    strcpy(submission->light_groups, json_string_value(value));
    submission->overrides.light_groups = submission->light_groups;
    json_object_del(body, "light_groups");
    return result_ok();
}

static result_t take_settings(json_t *body, overrides_t *overrides)
{
    int integrator, sampler;
    bool layers = true, learn = true;
    *overrides = overrides_none();
    TRY(take_end(body, overrides));
    TRY(take_size(body, overrides));
    TRY(take_choice(body, "integrator", integrator_names, &integrator));
    TRY(take_choice(body, "sampler", sampler_names, &sampler));
    overrides->integrator = (integrator_t)integrator;
    overrides->sampler = (sampler_kind_t)sampler;
    TRY(take_seed(body, overrides));
    TRY(take_count(body, "max_depth", 0, JOB_MAX_DEPTH, -1, &overrides->max_depth));
    TRY(take_count(body, "tile_size", JOB_MIN_TILE, JOB_MAX_TILE, 0, &overrides->tile_size));
    TRY(take_count(body, "film_scale", FILM_MIN_SCALE, FILM_MAX_SCALE, -1, &overrides->film_scale));
    TRY(take_flag(body, "layers", &layers));
    TRY(take_flag(body, "cryptomatte", &overrides->cryptomatte));
    TRY(take_flag(body, "learn", &learn));
    TRY(take_flag(body, "spectral", &overrides->spectral));
    TRY(take_number(body, "merge_radius", 0, JOB_MAX_MERGE_RADIUS, false, &overrides->merge_radius));
    overrides->no_layers = !layers;
    overrides->no_learn = !learn;
    return result_ok();
}

static result_t take_terms(json_t *body, const hash_t *blob, job_terms_t *terms)
{
    *terms = (job_terms_t){0};
    TRY(take_name(body, blob, terms->name));
    TRY(take_count(body, "priority", -JOB_MAX_PRIORITY, JOB_MAX_PRIORITY, 0, &terms->priority));
    TRY(take_number(body, "verify", 0, 1, false, &terms->verify));
    TRY(take_flag(body, "mixed", &terms->mixed));
    return take_flag(body, "halves", &terms->halves);
}

result_t body_submission(json_t *body, http_submission_t *submission)
{
    TRY(take_blob(body, &submission->blob));
    TRY(take_settings(body, &submission->overrides));
    TRY(take_light_groups(body, submission));
    TRY(take_terms(body, &submission->blob, &submission->terms));
    return check_rest(body, "a submission");
}
