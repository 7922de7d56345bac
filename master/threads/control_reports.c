/* control_reports: see control_reports.h. */
#include "master/threads/control_reports.h"

#include "master/farm/status_message.h"

#include <stdlib.h>

enum {
    REPLY_BYTES = WIRE_MAX_HEADER / 2, /* of the list in one answer */
    ENTRY_BYTES = 8                    /* that an entry of the list takes beside itself */
};

/* Puts the reports from number `from` on into the answer, as many as fit. */
static void fill_jobs(job_report_t *reports, size_t count, uint64_t from, status_message_t *statuses,
                      Lm__JobStatusReply *body)
{
    size_t bytes = 0;
    for (size_t i = 0; i < count && body->next == 0; i++) {
        if (reports[i].record.job < from) continue;
        status_message_t *message = &statuses[body->n_jobs];
        status_message_fill(&reports[i], message);
        bytes += lm__job_status__get_packed_size(&message->status) + ENTRY_BYTES;
        if (bytes > REPLY_BYTES)
            body->next = reports[i].record.job;
        else
            body->jobs[body->n_jobs++] = &message->status;
    }
}

/* Adds the history of a job's error to its status; returns memory that has to live as long, for two calls of
 * free: the points themselves are in *points. */
static Lm__ErrorPoint **fill_history(farm_t *farm, Lm__JobStatus *status, Lm__ErrorPoint **points)
{
    size_t count;
    error_point_t *history = farm_job_history(farm, status->job, &count);
    Lm__ErrorPoint **list = mem_alloc((count + 1) * sizeof *list);
    *points = mem_alloc((count + 1) * sizeof **points);
    for (size_t i = 0; i < count; i++) {
        list[i] = &(*points)[i];
        lm__error_point__init(list[i]);
        list[i]->elapsed = history[i].elapsed;
        list[i]->samples = history[i].samples;
        list[i]->error = history[i].error;
    }
    free(history);
    status->n_history = count;
    status->history = list;
    return list;
}

result_t report_jobs(farm_t *farm, double now, const Lm__JobStatusRequest *request, uint32_t bulk_port,
                     report_send_fn send, void *context)
{
    size_t count;
    Lm__JobStatusReply body = LM__JOB_STATUS_REPLY__INIT;
    job_report_t *reports = farm_report(farm, now, request->job, &count, &body.workers);
    if (request->job != 0 && count == 0)
        return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)request->job);
    status_message_t *statuses = mem_alloc((count + 1) * sizeof *statuses);
    body.jobs = mem_alloc((count + 1) * sizeof(Lm__JobStatus *));
    body.bulk_port = bulk_port;
    fill_jobs(reports, count, request->job != 0 ? 0 : request->from, statuses, &body);
    Lm__ErrorPoint *points = NULL, **history = NULL;
    if (request->job != 0 && request->history) history = fill_history(farm, body.jobs[0], &points);
    send(context, LM__ENVELOPE__BODY_JOB_STATUS_REPLY, &body);
    free(history);
    free(points);
    free(body.jobs);
    free(statuses);
    free(reports);
    return result_ok();
}

void report_workers(farm_t *farm, gate_t *gate, double now, const Lm__WorkerListRequest *request,
                    report_send_fn send, void *context)
{
    size_t count, bytes = 0;
    worker_report_t *reports = farm_worker_report(farm, now, &count);
    Lm__WorkerStatus *statuses = mem_alloc((count + 1) * sizeof *statuses);
    Lm__WorkerList body = LM__WORKER_LIST__INIT;
    body.workers = mem_alloc((count + 1) * sizeof(Lm__WorkerStatus *));
    for (size_t i = request->from; i < count && body.next == 0; i++) {
        worker_message_fill(gate, &reports[i], &statuses[i]);
        bytes += lm__worker_status__get_packed_size(&statuses[i]) + ENTRY_BYTES;
        if (bytes > REPLY_BYTES)
            body.next = (uint32_t)i;
        else
            body.workers[body.n_workers++] = &statuses[i];
    }
    send(context, LM__ENVELOPE__BODY_WORKER_LIST, &body);
    free(body.workers);
    free(statuses);
    free(reports);
}
