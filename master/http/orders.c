/* orders: what the API orders done with jobs: the orders of `lightmill pause` and the like, by the same way.
 * An order is answered when it is safe on the disk. */
#include "master/http/routes.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- bodies -------------------------------------------------------------------------------------------- */

/* A number of the body from `least` to `most`, whole if `whole`; *number stays as it is when there is none.
 */
static result_t take_number(json_t *body, const char *key, double least, double most, bool whole,
                            double *number)
{
    const json_t *value = json_object_get(body, key);
    if (value == NULL) return result_ok();
    double got = json_number_value(value);
    bool good = whole ? json_is_integer(value) : json_is_number(value);
    if (!good || !(got >= least && got <= most))
        return result_fail(RESULT_USAGE, "%s is a %snumber from %g to %g", key, whole ? "whole " : "", least,
                           most);
    *number = got;
    json_object_del(body, key);
    return result_ok();
}

/* What was not taken has a name that nobody knows. */
static result_t check_rest(json_t *body)
{
    void *rest = json_object_iter(body);
    if (rest == NULL) return result_ok();
    return result_fail(RESULT_USAGE, "this order knows no '%.60s'", json_object_iter_key(rest));
}

static result_t take_goals(json_t *body, job_order_t *order)
{
    double spp = 0;
    TRY(take_number(body, "spp", 1, JOB_MAX_SPP, true, &spp));
    TRY(take_number(body, "error", 1e-9, 1, false, &order->error));
    TRY(take_number(body, "time", 0.1, 1e9, false, &order->time_limit));
    order->spp = (uint32_t)spp;
    return check_rest(body);
}

static result_t take_priority(json_t *body, job_order_t *order)
{
    double priority = NAN;
    TRY(take_number(body, "priority", -JOB_MAX_PRIORITY, JOB_MAX_PRIORITY, true, &priority));
    if (isnan(priority)) return result_fail(RESULT_USAGE, "say the priority: {\"priority\": 1}");
    order->priority = (int32_t)priority;
    return check_rest(body);
}

static result_t take_nothing(json_t *body, job_order_t *order)
{
    (void)order;
    return check_rest(body);
}

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
        http_reply_job(request, request->numbers[0]);
}

static void give(http_request_t *request, order_kind_t kind, result_t (*take)(json_t *, job_order_t *))
{
    json_t *body = NULL;
    job_order_t order = {.job = request->numbers[0], .kind = kind};
    result_t result = http_body_object(request, &body);
    if (result.code == RESULT_OK) result = take(body, &order);
    json_decref(body);
    if (result.code != RESULT_OK) {
        http_reply_failure(request, &result);
        return;
    }
    if (!has_job(request) || !http_wait(request, tell)) return;
    result = request->master->order(request->master->context, &order, on_done, request);
    if (result.code != RESULT_OK) on_done(request, &result, 0);
}

#define ORDER_HANDLER(name, kind, take)                                                                      \
    static void name(http_request_t *request)                                                                \
    {                                                                                                        \
        give(request, kind, take);                                                                           \
    }
ORDER_HANDLER(cancel_job, ORDER_CANCEL, take_nothing)
ORDER_HANDLER(pause_job, ORDER_PAUSE, take_nothing)
ORDER_HANDLER(resume_job, ORDER_RESUME, take_nothing)
ORDER_HANDLER(retain_job, ORDER_RETAIN, take_nothing)
ORDER_HANDLER(release_job, ORDER_RELEASE, take_nothing)
ORDER_HANDLER(delete_job, ORDER_DELETE, take_nothing)
ORDER_HANDLER(extend_job, ORDER_EXTEND, take_goals)
ORDER_HANDLER(set_priority, ORDER_PRIORITY, take_priority)

static const http_route_t routes[] = {{"POST", "/api/v1/jobs/#/cancel", HTTP_OPERATE, cancel_job},
                                      {"POST", "/api/v1/jobs/#/pause", HTTP_OPERATE, pause_job},
                                      {"POST", "/api/v1/jobs/#/resume", HTTP_OPERATE, resume_job},
                                      {"POST", "/api/v1/jobs/#/retain", HTTP_OPERATE, retain_job},
                                      {"POST", "/api/v1/jobs/#/release", HTTP_OPERATE, release_job},
                                      {"POST", "/api/v1/jobs/#/extend", HTTP_OPERATE, extend_job},
                                      {"POST", "/api/v1/jobs/#/priority", HTTP_OPERATE, set_priority},
                                      {"DELETE", "/api/v1/jobs/#", HTTP_OPERATE, delete_job}};
const http_table_t http_order_routes = {routes, ARRAY_LENGTH(routes)};
