/* bodies: what the JSON bodies of orders and submissions say. Names are those of `lightmill submit` and of
 * `lightmill status --json`; a member that is not known is an error that names it. */
#ifndef LIGHTMILL_HTTP_BODIES_H
#define LIGHTMILL_HTTP_BODIES_H

#include "common/scene/overrides.h"
#include "common/text/json.h"
#include "proto/wire/wire.h"

/* A job to be. */
typedef struct {
    hash_t blob;
    overrides_t overrides;                    /* of the scene's own settings */
    char light_groups[LIGHT_GROUPS_TEXT + 1]; /* that overrides.light_groups points to, if it does */
    job_terms_t terms;
} http_submission_t;

/* The JSON object of a body, which the caller frees; an empty body is an empty object. RESULT_USAGE says
 * where it is wrong, and *object is NULL. */
result_t body_parse(const char *text, size_t size, json_t **object);
/* What the members say of an order of this kind; they are taken out of the object. RESULT_USAGE names what is
 * wrong, here and below. */
result_t body_order(json_t *body, order_kind_t kind, job_order_t *order);
/* The same of a job that is to be submitted. What it says fits by itself; whether it fits the scene is not
 * known yet. */
result_t body_submission(json_t *body, http_submission_t *submission);

#endif
