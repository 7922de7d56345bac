/* images: a job's image as a file, OpenEXR or PNG, as it is now or as it was at a milestone. The master
 * writes the file meanwhile; it is sent from its descriptor. */
#include "master/http/routes.h"
#include "master/http/server_state.h"

#include <ctype.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MAX_EXPOSURE = 50, TAG_TEXT = 160, MAX_STEM = 64 };

/* What a request for an image has until it ends. */
typedef struct {
    http_image_query_t query;
    http_image_t image;
} showing_t;

/* ---- what was asked ------------------------------------------------------------------------------------ */

static result_t read_exposure(const http_request_t *request, float *exposure)
{
    const char *text = http_query(request, "exposure");
    if (text == NULL || http_stops_parse(text, MAX_EXPOSURE, exposure)) return result_ok();
    return result_fail(RESULT_USAGE, "exposure is a number of stops from -%d to %d, not '%.60s'",
                       MAX_EXPOSURE, MAX_EXPOSURE, text);
}

static result_t read_query(const http_request_t *request, bool png, http_image_query_t *query)
{
    static const char *const exr_names[] = {"at", "half", "halves", NULL}, *const png_names[] = {
                                                                               "at", "exposure", NULL};
    uint64_t at, half, halves;
    *query = (http_image_query_t){.job = request->numbers[0], .png = png};
    TRY(http_query_only(request, png ? png_names : exr_names));
    TRY(http_query_number(request, "at", 1, JOB_MAX_SPP, 0, &at));
    TRY(http_query_number(request, "half", 0, 1, 0, &half));
    TRY(http_query_number(request, "halves", 0, 1, 0, &halves));
    query->at = (uint32_t)at;
    query->halves = halves != 0;
    query->half = half != 0;
    return read_exposure(request, &query->exposure);
}

/* ---- names of images ----------------------------------------------------------------------------------- */

/* The same tag stands for the same picture: of a job that is told by its number and when it was submitted,
 * and of a version that, while the job goes on, is one of this process, since a master that was killed may
 * count anew. It is a weak tag: the same picture, written twice, may say that it took another time. */
static void make_tag(const http_server_t *server, const job_record_t *record, const http_image_query_t *query,
                     const http_image_t *image, char tag[TAG_TEXT])
{
    uint64_t submitted = (uint64_t)(1000 * record->submitted), life = (uint64_t)(1e6 * server->started);
    const char *format = query->png ? "png" : query->half ? "half" : "float";
    snprintf(tag, TAG_TEXT, "W/\"%" PRIu64 "-%" PRIx64 "-%" PRIx64 "-%" PRIu64 "-%" PRIu32 "-%s%g%s\"",
             query->job, submitted, image->over ? 0 : life, image->version, query->at, format,
             (double)query->exposure, query->halves ? "-halves" : "");
}

/* "name.exr" or "name-0016.png", of letters that all systems take. */
static char *make_file_name(const job_record_t *record, const http_image_query_t *query)
{
    char at[16] = "";
    if (query->at > 0) snprintf(at, sizeof at, "-%04" PRIu32, query->at);
    char *name =
        mem_printf("%.*s%s.%s", MAX_STEM, record->terms.name[0] != '\0' ? record->terms.name : "image", at,
                   query->png ? "png" : "exr");
    for (char *c = name; *c != '\0'; c++)
        if (!isalnum((unsigned char)*c) && strchr("-_.", *c) == NULL) *c = '_';
    return name;
}

/* The job as it is now, in fresh memory; NULL, and answered, when there is none. */
static job_report_t *find_job(http_request_t *request)
{
    size_t count;
    uint32_t workers;
    job_report_t *report =
        farm_report(request->master->farm, clock_now(), request->numbers[0], &count, &workers);
    if (report == NULL) http_reply_no_job(request, request->numbers[0]);
    return report;
}

/* The version that an image would have now. */
static http_image_t image_now(const http_request_t *request, const http_image_query_t *query)
{
    http_image_t image = {.descriptor = -1, .over = true};
    job_t *job = query->at == 0 ? farm_pin(request->master->farm, query->job) : NULL;
    if (job == NULL) return image;
    image.version = farm_image_version(request->master->farm, job, &image.over);
    farm_unpin(request->master->farm, job);
    return image;
}

static bool has_it(http_request_t *request, const http_image_query_t *query, const job_record_t *record)
{
    char tag[TAG_TEXT];
    http_image_t now = image_now(request, query);
    make_tag(request->server, record, query, &now, tag);
    return http_reply_unchanged(request, tag);
}

/* ---- the answer ---------------------------------------------------------------------------------------- */

static void release(http_request_t *request)
{
    showing_t *showing = request->own;
    if (showing->image.descriptor >= 0) close(showing->image.descriptor);
    free(showing);
    request->server->images--;
}

static void send_file(http_request_t *request, const job_record_t *record)
{
    showing_t *showing = request->own;
    char tag[TAG_TEXT];
    char *name = make_file_name(record, &showing->query);
    char *disposition = mem_printf("attachment; filename=\"%s\"", name);
    struct MHD_Response *response =
        MHD_create_response_from_fd64(showing->image.size, showing->image.descriptor);
    if (response != NULL) {
        showing->image.descriptor = -1; /* the response's now */
        make_tag(request->server, record, &showing->query, &showing->image, tag);
        MHD_add_response_header(response, MHD_HTTP_HEADER_ETAG, tag);
        MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_DISPOSITION, disposition);
    }
    http_reply_response(request, MHD_HTTP_OK, showing->query.png ? "image/png" : "image/x-exr", response);
    free(disposition);
    free(name);
}

/* The file is there, or not. */
static void answer(http_request_t *request)
{
    job_report_t *report = find_job(request);
    if (report == NULL) return;
    if (request->result.code != RESULT_OK)
        http_reply_failure(request, &request->result);
    else
        send_file(request, &report->record);
    free(report);
}

static void on_image(void *ticket, const result_t *result, const http_image_t *image)
{
    http_request_t *request = ticket;
    showing_t *showing = request->own;
    request->result = *result;
    if (result->code == RESULT_OK) showing->image = *image;
    http_go(request);
}

static void ask(http_request_t *request, const http_image_query_t *query)
{
    if (request->server->images >= HTTP_MAX_IMAGES) {
        http_reply_problem(request, MHD_HTTP_SERVICE_UNAVAILABLE,
                           "too many images are asked for or read already: try again");
        return;
    }
    showing_t *showing = mem_alloc(sizeof *showing);
    *showing = (showing_t){*query, {.descriptor = -1}};
    request->own = showing;
    request->release = release;
    request->server->images++;
    if (!http_wait(request, answer)) return;
    result_t result = request->master->image(request->master->context, query, on_image, request);
    if (result.code != RESULT_OK) on_image(request, &result, NULL);
}

static void show(http_request_t *request, bool png)
{
    http_image_query_t query;
    result_t result = read_query(request, png, &query);
    if (result.code != RESULT_OK) {
        http_reply_failure(request, &result);
        return;
    }
    job_report_t *report = find_job(request);
    if (report == NULL) return;
    if (!has_it(request, &query, &report->record)) ask(request, &query);
    free(report);
}

static void show_exr(http_request_t *request)
{
    show(request, false);
}

static void show_png(http_request_t *request)
{
    show(request, true);
}

static const http_route_t routes[] = {{"GET", "/api/v1/jobs/#/image.exr", HTTP_VIEW, show_exr},
                                      {"GET", "/api/v1/jobs/#/image.png", HTTP_VIEW, show_png}};
const http_table_t http_image_routes = {routes, ARRAY_LENGTH(routes)};
