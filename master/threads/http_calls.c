/* http_calls: see http_calls.h. */
#include "master/threads/http_calls.h"

#include <stdlib.h>

/* Who is to be told of an order. */
typedef struct {
    http_done_fn done;
    void *ticket;
} waiter_t;

static void on_written(void *context, const journal_writer_answer_t *answer)
{
    waiter_t waiter = *(waiter_t *)context;
    free(context);
    waiter.done(waiter.ticket, &answer->result, answer->job);
}

static result_t order(void *context, const job_order_t *order, http_done_fn done, void *ticket)
{
    const http_calls_t *calls = context;
    waiter_t *waiter = mem_alloc(sizeof *waiter);
    *waiter = (waiter_t){done, ticket};
    journal_writer_request_t request = {
        .done = on_written, .context = waiter, .kind = JOURNAL_WRITER_ORDER, .order = *order};
    result_t result = journal_writer_ask(calls->journal_writer, &request);
    if (result.code != RESULT_OK) free(waiter);
    return result;
}

/* Who is to be given an image. */
typedef struct {
    http_image_fn done;
    void *ticket;
} receiver_t;

static void on_image(void *context, const result_t *result, const image_file_t *file)
{
    receiver_t receiver = *(receiver_t *)context;
    free(context);
    http_image_t image = {.descriptor = -1};
    if (result->code == RESULT_OK)
        image = (http_image_t){file->descriptor, file->size, file->version, file->over};
    receiver.done(receiver.ticket, result, &image);
}

static result_t image(void *context, const http_image_query_t *query, http_image_fn done, void *ticket)
{
    const http_calls_t *calls = context;
    receiver_t *receiver = mem_alloc(sizeof *receiver);
    *receiver = (receiver_t){done, ticket};
    image_request_t request = {.done = on_image,
                               .context = receiver,
                               .job = query->job,
                               .at = query->at,
                               .format = {query->half, query->halves, query->png, query->exposure}};
    result_t result = image_writer_ask(calls->image_writer, &request);
    if (result.code != RESULT_OK) free(receiver);
    return result;
}

http_master_t http_calls_master(http_calls_t *calls, farm_t *farm, gate_t *gate)
{
    return (http_master_t){.context = calls,
                           .farm = farm,
                           .gate = gate,
                           .order = order,
                           .image = image,
                           .image_path = image_writer_image_path};
}
