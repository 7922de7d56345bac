/* status_json: jobs and workers as JSON objects, for `lightmill status --json` and for the master's HTTP
 * server: the same names in both. */
#ifndef LIGHTMILL_STATUS_JSON_H
#define LIGHTMILL_STATUS_JSON_H

#include "common/text/json.h"
#include "proto/wire/wire.h"

/* A new object, which the caller frees. */
json_t *status_json_job(const Lm__JobStatus *job);
json_t *status_json_worker(const Lm__WorkerStatus *worker);

#endif
