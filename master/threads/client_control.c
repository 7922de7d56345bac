/* client_control: see client_control.h. Lists come from control_reports.h; what is to outlive the process
 * goes through the journal writer, and is answered when it is safe. */
#include "master/threads/client_control.h"

#include "master/threads/control_reports.h"

static journal_writer_request_t journal_writer_request(const wire_message_t *message,
                                                       journal_writer_kind_t kind)
{
    return (journal_writer_request_t){
        .identity = peer_identity(message), .request = message->envelope->request, .kind = kind};
}

static result_t submit(client_control_t *client, const wire_message_t *message)
{
    const Lm__JobSubmit *submission = message->envelope->job_submit;
    journal_writer_request_t request = journal_writer_request(message, JOURNAL_WRITER_SUBMIT);
    TRY(wire_settings_get(submission->settings, &request.settings));
    TRY(wire_terms_get(submission->terms, submission->name, &request.terms));
    if (!wire_hash_get(&submission->blob, &request.blob))
        return result_fail(RESULT_PROTOCOL, "the scene's hash has %zu bytes, not %d", submission->blob.len,
                           HASH_BYTES);
    return journal_writer_ask(client->journal_writer, &request);
}

static void on_submit(void *self, peer_server_t *server, const wire_message_t *message)
{
    result_t result = submit(self, message);
    if (result.code != RESULT_OK) peer_refuse(server, message, result);
}

static void on_order(void *self, peer_server_t *server, const wire_message_t *message)
{
    client_control_t *client = self;
    journal_writer_request_t request = journal_writer_request(message, JOURNAL_WRITER_ORDER);
    result_t result = wire_order_get(message->envelope->job_order, &request.order);
    char key[KEY_TEXT + 1];
    if (gate_find_key(client->gate, request.order.who, key))
        snprintf(request.order.who, sizeof request.order.who, "%s", key);
    if (result.code == RESULT_OK) result = journal_writer_ask(client->journal_writer, &request);
    if (result.code != RESULT_OK) peer_refuse(server, message, result);
}

/* Who asks for a report. */
typedef struct {
    peer_server_t *server;
    const wire_message_t *message;
} question_t;

static void send_report(void *context, Lm__Envelope__BodyCase kind, void *body)
{
    const question_t *question = context;
    peer_reply(question->server, question->message, kind, body, NULL);
}

static void on_status(void *self, peer_server_t *server, const wire_message_t *message)
{
    client_control_t *client = self;
    question_t question = {server, message};
    result_t result = report_jobs(client->farm, clock_now(), message->envelope->job_status_request,
                                  client->bulk_port, send_report, &question);
    if (result.code != RESULT_OK) peer_refuse(server, message, result);
}

static void on_worker_list(void *self, peer_server_t *server, const wire_message_t *message)
{
    client_control_t *client = self;
    question_t question = {server, message};
    report_workers(client->farm, client->gate, clock_now(), message->envelope->worker_list_request,
                   send_report, &question);
}

/* Of drain and purge. */
static result_t order_workers(client_control_t *client, const Lm__WorkerOrder *order, uint32_t *count)
{
    switch (order->kind) {
    case WORKERS_DRAIN:
        *count = (uint32_t)farm_drain(client->farm, order->who);
        if (*count == 0)
            return result_fail(RESULT_INPUT,
                               "no worker called \"%.100s\" is connected, nor one on a host of this name",
                               order->who);
        return result_ok();
    case WORKERS_PURGE:
        *count = (uint32_t)farm_purge(client->farm, clock_now());
        return result_ok();
    default:
        return result_fail(RESULT_PROTOCOL, "an order to workers of the unknown kind %u", order->kind);
    }
}

static void on_worker_order(void *self, peer_server_t *server, const wire_message_t *message)
{
    Lm__WorkerOrdered ordered = LM__WORKER_ORDERED__INIT;
    result_t result = order_workers(self, message->envelope->worker_order, &ordered.count);
    if (result.code == RESULT_OK)
        peer_reply(server, message, LM__ENVELOPE__BODY_WORKER_ORDERED, &ordered, NULL);
    else
        peer_refuse(server, message, result);
}

static void answer(peer_server_t *server, const journal_writer_answer_t *written)
{
    Lm__JobAccepted accepted = LM__JOB_ACCEPTED__INIT;
    Lm__Done done = LM__DONE__INIT;
    accepted.job = written->job;
    accepted.save_at = written->save_at;
    accepted.halves = written->halves;
    if (written->result.code != RESULT_OK)
        peer_send_refusal(server, &written->identity, written->request, written->result);
    else if (written->kind == JOURNAL_WRITER_ORDER)
        peer_send(server, &written->identity, written->request, LM__ENVELOPE__BODY_DONE, &done, NULL);
    else
        peer_send(server, &written->identity, written->request, LM__ENVELOPE__BODY_JOB_ACCEPTED, &accepted,
                  NULL);
}

/* Tells what the journal writer has seen to. */
static void turn(void *self, peer_server_t *server, bool more)
{
    client_control_t *client = self;
    (void)more;
    for (journal_writer_answer_t written; journal_writer_next_answer(client->journal_writer, &written);)
        answer(server, &written);
}

/* proto/serve/control_server.c says what a new kind takes. */
static const message_kind_t kinds[] = {{LM__ENVELOPE__BODY_JOB_SUBMIT, RIGHT_CLIENT, on_submit},
                                       {LM__ENVELOPE__BODY_JOB_STATUS_REQUEST, RIGHT_CLIENT, on_status},
                                       {LM__ENVELOPE__BODY_WORKER_LIST_REQUEST, RIGHT_CLIENT, on_worker_list},
                                       {LM__ENVELOPE__BODY_WORKER_ORDER, RIGHT_CLIENT, on_worker_order},
                                       {LM__ENVELOPE__BODY_JOB_ORDER, RIGHT_CLIENT, on_order}};

message_table_t client_control_table(client_control_t *client)
{
    return (message_table_t){kinds, ARRAY_LENGTH(kinds), turn, client};
}
