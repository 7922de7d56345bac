/* http_calls: see http_calls.h. */
#include "master/threads/http_calls.h"

#include <stdlib.h>

/* ---- who waits ----------------------------------------------------------------------------------------- */

/* Who is to be told. */
typedef struct {
    http_done_fn done;
    void *ticket;
} waiter_t;

static waiter_t *new_waiter(http_done_fn done, void *ticket)
{
    waiter_t *waiter = mem_alloc(sizeof *waiter);
    *waiter = (waiter_t){done, ticket};
    return waiter;
}

/* Tells the waiter, and frees it. */
static void tell(void *context, const result_t *result, uint64_t value)
{
    waiter_t waiter = *(waiter_t *)context;
    free(context);
    waiter.done(waiter.ticket, result, value);
}

/* ---- orders and submissions ---------------------------------------------------------------------------- */

static void on_written(void *context, const journal_writer_answer_t *answer)
{
    tell(context, &answer->result, answer->job);
}

static result_t ask_journal(const http_calls_t *calls, journal_writer_request_t *request, http_done_fn done,
                            void *ticket)
{
    waiter_t *waiter = new_waiter(done, ticket);
    request->done = on_written;
    request->context = waiter;
    result_t result = journal_writer_ask(calls->journal_writer, request);
    if (result.code != RESULT_OK) free(waiter);
    return result;
}

static result_t order(void *context, const job_order_t *order, http_done_fn done, void *ticket)
{
    journal_writer_request_t request = {.kind = JOURNAL_WRITER_ORDER, .order = *order};
    return ask_journal(context, &request, done, ticket);
}

/* What the scene asks for is read at once: only its head and its lights are looked at. */
static result_t submit(void *context, const http_submission_t *submission, http_done_fn done, void *ticket)
{
    const http_calls_t *calls = context;
    scene_blob_t blob;
    journal_writer_request_t request = {
        .kind = JOURNAL_WRITER_SUBMIT, .terms = submission->terms, .blob = submission->blob};
    TRY(job_terms_check(&request.terms));
    TRY(blob_store_peek(calls->store, &submission->blob, &blob));
    result_t result = overrides_apply(&submission->overrides, &blob, &request.settings);
    blob_close(&blob);
    return result.code == RESULT_OK ? ask_journal(calls, &request, done, ticket) : result;
}

/* ---- scenes -------------------------------------------------------------------------------------------- */

static result_t put_blob(void *context, const http_piece_t *piece, http_done_fn done, void *ticket)
{
    const http_calls_t *calls = context;
    waiter_t *waiter = new_waiter(done, ticket);
    blob_piece_t put = {.hash = piece->blob,
                        .offset = piece->offset,
                        .size = piece->size,
                        .bytes = piece->bytes,
                        .length = piece->length,
                        .done = tell,
                        .context = waiter};
    result_t result = blob_writer_put(calls->blob_writer, &put);
    if (result.code != RESULT_OK) free(waiter);
    return result;
}

static uint64_t find_blob(void *context, const hash_t *hash, bool *complete)
{
    const http_calls_t *calls = context;
    uint64_t bytes = 0;
    *complete = blob_store_find(calls->store, hash, &bytes);
    if (!*complete) blob_store_find_part(calls->store, hash, &bytes);
    return bytes;
}

/* ---- images -------------------------------------------------------------------------------------------- */

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
                           .submit = submit,
                           .put_blob = put_blob,
                           .find_blob = find_blob,
                           .image = image,
                           .image_path = image_writer_image_path};
}
