/* reports: what the API tells of jobs, workers and the farm. Names are those of `lightmill status --json`. */
#include "master/farm/status_message.h"
#include "master/http/routes.h"
#include "master/http/server_state.h"
#include "master/http/totals.h"
#include "proto/wire/status_json.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

/* ---- jobs ---------------------------------------------------------------------------------------------- */

static json_t *job_object(job_report_t *report)
{
    status_message_t message;
    status_message_fill(report, &message);
    return status_json_job(&message.status);
}

static void list_jobs(http_request_t *request)
{
    size_t count;
    uint32_t workers;
    job_report_t *reports = farm_report(request->master->farm, clock_now(), 0, &count, &workers);
    json_t *root = json_object(), *list = json_array();
    for (size_t i = 0; i < count; i++) json_array_append_new(list, job_object(&reports[i]));
    put_count(root, "workers", workers);
    json_object_set_new(root, "jobs", list);
    free(reports);
    http_reply_json(request, MHD_HTTP_OK, root);
}

void http_reply_no_job(http_request_t *request, uint64_t job)
{
    char detail[80];
    snprintf(detail, sizeof detail, "there is no job %" PRIu64, job);
    http_reply_problem(request, MHD_HTTP_NOT_FOUND, detail);
}

void http_reply_job(http_request_t *request, unsigned status, uint64_t job)
{
    size_t count;
    uint32_t workers;
    job_report_t *report = farm_report(request->master->farm, clock_now(), job, &count, &workers);
    if (report == NULL)
        http_reply_no_job(request, job);
    else
        http_reply_json(request, status, job_object(report));
    free(report);
}

static void show_job(http_request_t *request)
{
    http_reply_job(request, MHD_HTTP_OK, request->numbers[0]);
}

/* How the error fell: an empty list before the first estimate. */
static void show_history(http_request_t *request)
{
    size_t count;
    job_t *job = farm_pin(request->master->farm, request->numbers[0]);
    if (job == NULL) {
        http_reply_no_job(request, request->numbers[0]);
        return;
    }
    farm_unpin(request->master->farm, job);
    error_point_t *points = farm_job_history(request->master->farm, request->numbers[0], &count);
    json_t *root = json_object(), *list = json_array();
    for (size_t i = 0; i < count; i++) {
        json_t *point = json_object();
        put_real(point, "elapsed", points[i].elapsed);
        put_count(point, "samples", points[i].samples);
        put_real(point, "error", points[i].error);
        json_array_append_new(list, point);
    }
    json_object_set_new(root, "points", list);
    free(points);
    http_reply_json(request, MHD_HTTP_OK, root);
}

/* ---- workers ------------------------------------------------------------------------------------------- */

static void list_workers(http_request_t *request)
{
    size_t count;
    worker_report_t *reports = farm_worker_report(request->master->farm, clock_now(), &count);
    json_t *root = json_object(), *list = json_array();
    for (size_t i = 0; i < count; i++) {
        Lm__WorkerStatus status;
        worker_message_fill(request->master->gate, &reports[i], &status);
        json_array_append_new(list, status_json_worker(&status));
    }
    json_object_set_new(root, "workers", list);
    free(reports);
    http_reply_json(request, MHD_HTTP_OK, root);
}

/* ---- the farm ------------------------------------------------------------------------------------------ */

static void show_farm(http_request_t *request)
{
    totals_t totals = totals_take(request->master->farm);
    json_t *root = json_object(), *jobs = json_object();
    for (uint32_t state = JOB_QUEUED; state < TOTALS_STATES; state++)
        put_count(jobs, job_state_name(state), totals.jobs[state]);
    put_text(root, "version", LIGHTMILL_VERSION);
    put_real(root, "uptime", clock_now() - request->server->started);
    put_count(root, "workers", totals.workers);
    put_count(root, "workers_aside", totals.aside);
    put_count(root, "threads", totals.threads);
    put_real(root, "speed", totals.speed);
    json_object_set_new(root, "jobs", jobs);
    http_reply_json(request, MHD_HTTP_OK, root);
}

static void show_demand(http_request_t *request)
{
    totals_t totals = totals_take(request->master->farm);
    json_t *root = json_object();
    put_count(root, "workers", totals_wanted(&totals));
    http_reply_json(request, MHD_HTTP_OK, root);
}

static void stream_events(http_request_t *request)
{
    http_events_answer(request->server->events, request);
}

static const http_route_t routes[] = {{"GET", "/api/v1/jobs", HTTP_VIEW, list_jobs},
                                      {"GET", "/api/v1/jobs/#", HTTP_VIEW, show_job},
                                      {"GET", "/api/v1/jobs/#/history", HTTP_VIEW, show_history},
                                      {"GET", "/api/v1/workers", HTTP_VIEW, list_workers},
                                      {"GET", "/api/v1/farm", HTTP_VIEW, show_farm},
                                      {"GET", "/api/v1/demand", HTTP_VIEW, show_demand},
                                      {"GET", "/api/v1/events", HTTP_VIEW, stream_events}};
const http_table_t http_report_routes = {routes, ARRAY_LENGTH(routes)};
