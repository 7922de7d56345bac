/* routes: the tables of all that the HTTP server answers, and the search in them. A new table is declared and
 * entered here. */
#ifndef LIGHTMILL_HTTP_ROUTES_H
#define LIGHTMILL_HTTP_ROUTES_H

#include "master/http/request.h"

extern const http_table_t http_report_routes;  /* jobs, workers, the farm: reports.c */
extern const http_table_t http_metrics_routes; /* /metrics, /healthz, /readyz: metrics.c */
extern const http_table_t http_order_routes;   /* orders.c */
extern const http_table_t http_tile_routes;    /* images as they converge: tile_routes.c */
extern const http_table_t http_image_routes;   /* images as files: images.c */
extern const http_table_t http_upload_routes;  /* scenes: uploads.c */

/* Sets request->route, ->numbers and ->hash for a method and request->path. 0, or the HTTP status of the
 * refusal: 404, or 405 with request->allowed set. */
unsigned http_route_find(http_request_t *request, const char *method);

/* Answers with a job as it is now; or 404. */
void http_reply_job(http_request_t *request, unsigned status, uint64_t job);
/* Answers that there is no such job. */
void http_reply_no_job(http_request_t *request, uint64_t job);

#endif
