/* http_calls: see http_calls.h. */
#include "master/threads/http_calls.h"

#include "master/threads/image_writer.h"

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

http_master_t http_calls_master(http_calls_t *calls, farm_t *farm, gate_t *gate)
{
    return (http_master_t){
        .context = calls, .farm = farm, .gate = gate, .order = order, .image_path = image_writer_image_path};
}
