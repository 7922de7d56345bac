/* metrics: what monitoring asks for: /metrics in the text format of Prometheus, /healthz and /readyz.
 *
 * DESIGN. Jobs that are not over have a label render="NUMBER"; "job" is a label of Prometheus' own. Those
 * that are over only count in lightmill_renders, so that the number of series stays small. */
#include "common/text/text.h"
#include "master/http/routes.h"
#include "master/http/server_state.h"
#include "master/http/totals.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void put_head(FILE *out, const char *name, const char *type, const char *help)
{
    fprintf(out, "# HELP %s %s\n# TYPE %s %s\n", name, help, name, type);
}

static void put_gauge(FILE *out, const char *name, const char *help, double value)
{
    put_head(out, name, "gauge", help);
    fprintf(out, "%s %.17g\n", name, value);
}

/* A text of unknown origin as the value of a label. */
static void put_label(FILE *out, const char *text)
{
    char *clean = text_utf8(text);
    for (const char *at = clean; *at != '\0'; at++)
        if (*at == '\n')
            fputs("\\n", out);
        else if (*at == '"' || *at == '\\')
            fprintf(out, "\\%c", *at);
        else
            putc(*at, out);
    free(clean);
}

/* ---- the farm ------------------------------------------------------------------------------------------ */

static void put_farm(FILE *out, const http_server_t *server)
{
    totals_t totals = totals_take(server->master.farm);
    put_head(out, "lightmill_build_info", "gauge", "The version of the master.");
    fprintf(out, "lightmill_build_info{version=\"%s\"} 1\n", LIGHTMILL_VERSION);
    put_gauge(out, "lightmill_uptime_seconds", "How long the master has run.", clock_now() - server->started);
    put_gauge(out, "lightmill_workers", "Workers that are connected.", totals.workers);
    put_gauge(out, "lightmill_workers_aside", "Of them those that are given no work.", totals.aside);
    put_gauge(out, "lightmill_workers_wanted", "Workers that would end all work in ten minutes.",
              (double)totals_wanted(&totals));
    put_gauge(out, "lightmill_threads", "Render threads of the connected workers.", (double)totals.threads);
    put_gauge(out, "lightmill_samples_per_second", "Pixel samples that the workers render a second.",
              totals.speed);
    put_head(out, "lightmill_renders", "gauge", "Renders that the master knows, by state.");
    for (uint32_t state = JOB_QUEUED; state < TOTALS_STATES; state++)
        fprintf(out, "lightmill_renders{state=\"%s\"} %" PRIu64 "\n", job_state_name(state),
                totals.jobs[state]);
}

/* ---- renders ------------------------------------------------------------------------------------------- */

static double samples_done(const job_report_t *job)
{
    return (double)job->record.samples_done;
}
static double samples_wanted(const job_report_t *job)
{
    return (double)job->samples_total;
}
static double error(const job_report_t *job)
{
    return job->error;
}
static double error_target(const job_report_t *job)
{
    return job->record.settings.error;
}
static double elapsed(const job_report_t *job)
{
    return job->record.elapsed;
}
static double checkpoint_age(const job_report_t *job)
{
    return job->checkpoint_age;
}
static double workers(const job_report_t *job)
{
    return job->workers;
}
static double batches(const job_report_t *job)
{
    return (double)job->record.batches;
}
static double batches_refused(const job_report_t *job)
{
    return (double)job->record.batches_refused;
}
static double units_reissued(const job_report_t *job)
{
    return (double)job->record.units_reissued;
}
static double checks_failed(const job_report_t *job)
{
    return (double)job->record.checks_failed;
}
static double bytes(const job_report_t *job)
{
    return (double)job->record.bytes;
}

static const struct {
    const char *name, *type, *help;
    double (*value)(const job_report_t *job);
    double least; /* a value below it is not known, and left out */
} render_metrics[] = {
    {"lightmill_render_samples_total", "counter", "Pixel samples that are in the image.", samples_done, 0},
    {"lightmill_render_samples_wanted", "gauge", "Pixel samples that end the render.", samples_wanted, 1},
    {"lightmill_render_error_ratio", "gauge", "Estimated relative error of the image.", error, 1e-300},
    {"lightmill_render_error_target_ratio", "gauge", "The error that ends the render.", error_target, 1e-300},
    {"lightmill_render_work_seconds_total", "counter", "Time for which the render was worked on.", elapsed,
     0},
    {"lightmill_render_checkpoint_age_seconds", "gauge", "Age of the last checkpoint.", checkpoint_age, 0},
    {"lightmill_render_workers", "gauge", "Workers that hold units of the render.", workers, 0},
    {"lightmill_render_batches_total", "counter", "Batches that were merged.", batches, 0},
    {"lightmill_render_batches_refused_total", "counter", "Batches that were refused.", batches_refused, 0},
    {"lightmill_render_units_reissued_total", "counter", "Units that were given out again.", units_reissued,
     0},
    {"lightmill_render_checks_failed_total", "counter", "Checks of workers that failed.", checks_failed, 0},
    {"lightmill_render_received_bytes_total", "counter", "Bytes of batches that came.", bytes, 0},
};

static void put_info(FILE *out, const job_report_t *jobs, size_t count)
{
    put_head(out, "lightmill_render_info", "gauge", "Name and state of the render.");
    for (size_t i = 0; i < count; i++) {
        if (job_state_final((uint32_t)jobs[i].record.state)) continue;
        fprintf(out, "lightmill_render_info{render=\"%" PRIu64 "\",name=\"", jobs[i].record.job);
        put_label(out, jobs[i].record.terms.name);
        fprintf(out, "\",state=\"%s\"} 1\n", job_state_name((uint32_t)jobs[i].record.state));
    }
}

static void put_renders(FILE *out, farm_t *farm)
{
    size_t count;
    uint32_t connected;
    job_report_t *jobs = farm_report(farm, clock_now(), 0, &count, &connected);
    put_info(out, jobs, count);
    for (size_t m = 0; m < ARRAY_LENGTH(render_metrics); m++) {
        put_head(out, render_metrics[m].name, render_metrics[m].type, render_metrics[m].help);
        for (size_t i = 0; i < count; i++) {
            double value = render_metrics[m].value(&jobs[i]);
            if (job_state_final((uint32_t)jobs[i].record.state) || !(value >= render_metrics[m].least))
                continue;
            fprintf(out, "%s{render=\"%" PRIu64 "\"} %.17g\n", render_metrics[m].name, jobs[i].record.job,
                    value);
        }
    }
    free(jobs);
}

/* ---- answers ------------------------------------------------------------------------------------------- */

static void show_metrics(http_request_t *request)
{
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    if (out != NULL) {
        put_farm(out, request->server);
        put_renders(out, request->master->farm);
    }
    if (out != NULL && fclose(out) == 0) {
        http_reply(request, MHD_HTTP_OK, "text/plain; version=0.0.4; charset=utf-8", text, size,
                   MHD_RESPMEM_MUST_FREE);
        return;
    }
    free(text);
    http_reply_problem(request, MHD_HTTP_INTERNAL_SERVER_ERROR, "memory ran out");
}

static void reply_text(http_request_t *request, unsigned status, const char *text)
{
    http_reply(request, status, "text/plain; charset=utf-8", (void *)text, strlen(text),
               MHD_RESPMEM_PERSISTENT);
}

/* The farm's lock can be had: the process is alive, and not stuck. */
static void show_health(http_request_t *request)
{
    size_t count;
    uint32_t connected;
    free(farm_report(request->master->farm, clock_now(), UINT64_MAX, &count, &connected));
    reply_text(request, MHD_HTTP_OK, "ok\n");
}

/* This server is started when all the rest of the master is, and ends first. */
static void show_ready(http_request_t *request)
{
    http_server_t *server = request->server;
    pthread_mutex_lock(&server->lock);
    bool ending = server->ending;
    pthread_mutex_unlock(&server->lock);
    reply_text(request, ending ? MHD_HTTP_SERVICE_UNAVAILABLE : MHD_HTTP_OK, ending ? "ending\n" : "ready\n");
}

static const http_route_t routes[] = {{"GET", "/metrics", HTTP_VIEW, show_metrics},
                                      {"GET", "/healthz", HTTP_ANYBODY, show_health},
                                      {"GET", "/readyz", HTTP_ANYBODY, show_ready}};
const http_table_t http_metrics_routes = {routes, ARRAY_LENGTH(routes)};
