/* status_message: the reports of jobs and workers as the messages that tell clients of them. */
#ifndef LIGHTMILL_STATUS_MESSAGE_H
#define LIGHTMILL_STATUS_MESSAGE_H

#include "master/farm/farm.h"
#include "proto/serve/gate.h"

/* One job's report as messages that point into it and into one another. */
typedef struct {
    Lm__JobStatus status;
    Lm__Settings settings;
    Lm__Terms terms;
    Lm__Counts counts;
} status_message_t;

/* Both messages point into the report, which must outlive them. */
void status_message_fill(job_report_t *report, status_message_t *message);
/* The report's key becomes the name that the gate's list has for it, where it has one. */
void worker_message_fill(gate_t *gate, worker_report_t *report, Lm__WorkerStatus *status);

#endif
