/* orders: what the API orders done: jobs are submitted, and the orders of `lightmill pause` and the like
 * given, by the same way as theirs. An order is answered when it is safe on the disk. */
#include "master/http/routes.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

/* ---- the order ----------------------------------------------------------------------------------------- */

static bool has_job(http_request_t *request)
{
    job_t *job = farm_pin(request->master->farm, request->numbers[0]);
    if (job == NULL)
        http_reply_no_job(request, request->numbers[0]);
    else
        farm_unpin(request->master->farm, job);
    return job != NULL;
}

static void on_done(void *ticket, const result_t *result, uint64_t value)
{
    http_request_t *request = ticket;
    request->value = value;
    request->result = *result;
    http_go(request);
}

/* The order is carried out, or refused. */
static void tell(http_request_t *request)
{
    if (request->result.code != RESULT_OK)
        http_reply_failure(request, &request->result);
    else if (strcmp(request->route->method, "DELETE") == 0)
        http_reply(request, MHD_HTTP_NO_CONTENT, NULL, "", 0, MHD_RESPMEM_PERSISTENT);
    else
        http_reply_job(request, MHD_HTTP_OK, request->numbers[0]);
}

static void give(http_request_t *request, order_kind_t kind)
{
    json_t *body = NULL;
    job_order_t order = {.job = request->numbers[0]};
    result_t result = http_body_object(request, &body);
    if (result.code == RESULT_OK) result = body_order(body, kind, &order);
    json_decref(body);
    if (result.code != RESULT_OK) {
        http_reply_failure(request, &result);
        return;
    }
    if (!has_job(request) || !http_wait(request, tell)) return;
    result = request->master->order(request->master->context, &order, on_done, request);
    if (result.code != RESULT_OK) on_done(request, &result, 0);
}

#define ORDER_HANDLER(name, kind)                                                                            \
    static void name(http_request_t *request)                                                                \
    {                                                                                                        \
        give(request, kind);                                                                                 \
    }
ORDER_HANDLER(cancel_job, ORDER_CANCEL)
ORDER_HANDLER(pause_job, ORDER_PAUSE)
ORDER_HANDLER(resume_job, ORDER_RESUME)
ORDER_HANDLER(retain_job, ORDER_RETAIN)
ORDER_HANDLER(release_job, ORDER_RELEASE)
ORDER_HANDLER(delete_job, ORDER_DELETE)
ORDER_HANDLER(extend_job, ORDER_EXTEND)
ORDER_HANDLER(set_priority, ORDER_PRIORITY)
ORDER_HANDLER(mix_job, ORDER_MIXED)
ORDER_HANDLER(rebind_job, ORDER_REBIND)

/* ---- submissions --------------------------------------------------------------------------------------- */

/* The job is in the queue, or refused. */
static void tell_submitted(http_request_t *request)
{
    if (request->result.code != RESULT_OK) {
        http_reply_failure(request, &request->result);
        return;
    }
    snprintf(request->location, sizeof request->location, "/api/v1/jobs/%" PRIu64, request->value);
    http_reply_job(request, MHD_HTTP_CREATED, request->value);
}

static result_t read_submission(http_request_t *request, http_submission_t *submission)
{
    json_t *body = NULL;
    result_t result = http_body_object(request, &body);
    if (result.code == RESULT_OK) result = body_submission(body, submission);
    json_decref(body);
    return result;
}

static void submit_job(http_request_t *request)
{
    http_submission_t submission;
    result_t result = read_submission(request, &submission);
    if (result.code != RESULT_OK) {
        http_reply_failure(request, &result);
        return;
    }
    if (!http_wait(request, tell_submitted)) return;
    result = request->master->submit(request->master->context, &submission, on_done, request);
    if (result.code != RESULT_OK) on_done(request, &result, 0);
}

static const http_route_t routes[] = {{"POST", "/api/v1/jobs", HTTP_OPERATE, submit_job},
                                      {"POST", "/api/v1/jobs/#/cancel", HTTP_OPERATE, cancel_job},
                                      {"POST", "/api/v1/jobs/#/pause", HTTP_OPERATE, pause_job},
                                      {"POST", "/api/v1/jobs/#/resume", HTTP_OPERATE, resume_job},
                                      {"POST", "/api/v1/jobs/#/retain", HTTP_OPERATE, retain_job},
                                      {"POST", "/api/v1/jobs/#/release", HTTP_OPERATE, release_job},
                                      {"POST", "/api/v1/jobs/#/extend", HTTP_OPERATE, extend_job},
                                      {"POST", "/api/v1/jobs/#/priority", HTTP_OPERATE, set_priority},
                                      {"POST", "/api/v1/jobs/#/mixed", HTTP_OPERATE, mix_job},
                                      {"POST", "/api/v1/jobs/#/rebind", HTTP_OPERATE, rebind_job},
                                      {"DELETE", "/api/v1/jobs/#", HTTP_OPERATE, delete_job}};
const http_table_t http_order_routes = {routes, ARRAY_LENGTH(routes)};
