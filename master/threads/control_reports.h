/* control_reports: the messages that tell clients about jobs and workers. A list that does not fit into one
 * message comes in several: the answer says where to go on. */
#ifndef LIGHTMILL_CONTROL_REPORTS_H
#define LIGHTMILL_CONTROL_REPORTS_H

#include "master/farm/farm.h"
#include "proto/serve/gate.h"

/* Sends an answer: the Lm__ struct of `kind`, which lives for the call only. */
typedef void (*report_send_fn)(void *context, Lm__Envelope__BodyCase kind, void *body);

/* RESULT_INPUT, and nothing is sent, when there is no such job. */
result_t report_jobs(farm_t *farm, double now, const Lm__JobStatusRequest *request, uint32_t bulk_port,
                     report_send_fn send, void *context);
/* Keys are told by the names that the gate's list has for them. */
void report_workers(farm_t *farm, gate_t *gate, double now, const Lm__WorkerListRequest *request,
                    report_send_fn send, void *context);

#endif
