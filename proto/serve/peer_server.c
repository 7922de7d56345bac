/* peer_server: see peer_server.h. */
#include "proto/serve/peer_server.h"

#include "common/own_directory.h"
#include "common/thread.h"
#include "common/wake.h"
#include "proto/serve/complaint.h"
#include "proto/serve/rate_limit.h"

#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    PEER_RATE = 2000,  /* messages a second from one connection, */
    PEER_BURST = 4000, /* and at once */
    PEERS = 16384,     /* connections that are counted apart */
    KEY_RATE = 20000,  /* from all who have the same key: thousands of workers may share one */
    KEY_BURST = 20000,
    TOKEN_BYTES = 256, /* a longer message counts as several */
    KEYS = 4096
};

struct peer_server {
    peer_server_options_t options;
    pthread_t thread;
    atomic_bool stop;
    complaint_t complaint;
    complaint_t refused;                  /* of those whom the gate or the limit refused */
    rate_limit_t *peer_limit, *key_limit; /* by connection, by key; NULL: none */
    wire_message_t *message;              /* the one that is being handled, until something takes it over */
    uint64_t messages, bytes, malformed, over_limit;
};

/* ---- answers ------------------------------------------------------------------------------------------- */

identity_t peer_identity(const wire_message_t *message)
{
    identity_t identity = {.size = message->identity_size};
    memcpy(identity.bytes, message->identity, message->identity_size);
    return identity;
}

void peer_complain(peer_server_t *server, const char *format, ...)
{
    char text[700];
    va_list arguments;
    if (!complaint_allowed(&server->complaint, clock_now())) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    log_warning("%s", text);
}

bool peer_send(peer_server_t *server, const identity_t *identity, uint64_t request,
               Lm__Envelope__BodyCase kind, void *body, zmq_msg_t *payload)
{
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.request = request;
    envelope.body_case = kind;
    envelope.refusal = body; /* all bodies are pointers in one union */
    result_t result = wire_send(server->options.socket, identity->bytes, identity->size, &envelope, payload,
                                payload != NULL);
    if (result.code != RESULT_OK) log_debug("a message was not sent: %s", result.message);
    return result.code == RESULT_OK;
}

result_t peer_told(peer_server_t *server, result_t reason)
{
    result_t told = reason;
    if (own_directory_hide(server->options.data_dir, told.message))
        peer_complain(server, "%s", reason.message);
    return told;
}

bool peer_send_refusal(peer_server_t *server, const identity_t *identity, uint64_t request, result_t reason)
{
    Lm__Refusal refusal = LM__REFUSAL__INIT;
    result_t told = peer_told(server, reason);
    refusal.code = told.code;
    refusal.reason = told.message;
    return peer_send(server, identity, request, LM__ENVELOPE__BODY_REFUSAL, &refusal, NULL);
}

static uint64_t request_of(const wire_message_t *message)
{
    return message->envelope != NULL ? message->envelope->request : 0;
}

void peer_reply(peer_server_t *server, const wire_message_t *message, Lm__Envelope__BodyCase kind, void *body,
                zmq_msg_t *payload)
{
    identity_t identity = peer_identity(message);
    peer_send(server, &identity, request_of(message), kind, body, payload);
}

void peer_refuse(peer_server_t *server, const wire_message_t *message, result_t reason)
{
    identity_t identity = peer_identity(message);
    peer_send_refusal(server, &identity, request_of(message), reason);
}

wire_message_t *peer_keep(peer_server_t *server)
{
    wire_message_t *message = server->message;
    server->message = NULL;
    return message;
}

/* ---- who may ask what ---------------------------------------------------------------------------------- */

static const char *sender_name(const wire_message_t *message)
{
    return message->key[0] != '\0' ? message->key : message->address;
}

static rate_verdict_t take_tokens(peer_server_t *server, double now, const wire_message_t *message)
{
    double tokens = 1 + (double)(message->bytes / TOKEN_BYTES);
    rate_verdict_t verdict =
        rate_limit_take(server->peer_limit, now, message->identity, message->identity_size, tokens);
    if (verdict != RATE_PASS || message->key[0] == '\0') return verdict;
    return rate_limit_take(server->key_limit, now, message->key, WIRE_KEY_TEXT, tokens);
}

/* False when the sender sends too much: the message, not decoded yet, is not looked at. It is told once. */
static bool within_limit(peer_server_t *server, const wire_message_t *message)
{
    double now = clock_now();
    rate_verdict_t verdict = server->options.limited ? take_tokens(server, now, message) : RATE_PASS;
    if (verdict == RATE_PASS) return true;
    server->over_limit++;
    if (verdict == RATE_DROP) return false;
    if (complaint_allowed(&server->refused, now))
        log_warning("messages of %s are dropped: more than %d a second", sender_name(message), PEER_RATE);
    peer_refuse(server, message,
                result_fail(RESULT_LIMIT, "more than %d messages a second: those over the limit are dropped",
                            PEER_RATE));
    return false;
}

/* False, and a refusal, when the sender's key does not give it the right. */
static bool allowed(peer_server_t *server, wire_message_t *message, unsigned right)
{
    result_t result = gate_check(server->options.gate, message, right);
    if (result.code == RESULT_OK) return true;
    if (complaint_allowed(&server->refused, clock_now()))
        log_warning("a message from %s is refused: %s", message->address, result.message);
    peer_refuse(server, message, result);
    return false;
}

/* ---- messages ------------------------------------------------------------------------------------------ */

/* The row of a kind, and the table that it is in; NULL when it is in none. */
static const message_kind_t *find_kind(const peer_server_t *server, Lm__Envelope__BodyCase kind,
                                       const message_table_t **table)
{
    for (int t = 0; t < PEER_SERVER_TABLES; t++) {
        *table = &server->options.tables[t];
        for (size_t i = 0; i < (*table)->count; i++)
            if ((*table)->kinds[i].kind == kind) return &(*table)->kinds[i];
    }
    return NULL;
}

static result_t out_of_place(const peer_server_t *server, Lm__Envelope__BodyCase kind)
{
    if (server->options.elsewhere != NULL)
        return result_fail(RESULT_PROTOCOL, "%s", server->options.elsewhere);
    return result_fail(RESULT_PROTOCOL, "a message of kind %d does not belong on the %s socket", (int)kind,
                       server->options.name);
}

static void dispatch(peer_server_t *server, wire_message_t *message)
{
    const message_table_t *table;
    const message_kind_t *row = find_kind(server, message->envelope->body_case, &table);
    if (!allowed(server, message, row != NULL ? row->right : 0)) return;
    if (row != NULL)
        row->handle(table->self, server, message);
    else
        peer_refuse(server, message, out_of_place(server, message->envelope->body_case));
}

static void on_malformed(peer_server_t *server, const wire_message_t *message, result_t reason)
{
    server->malformed++;
    peer_complain(server, "a peer sent nonsense to the %s socket: %s", server->options.name, reason.message);
    if (message->identity_size > 0) peer_refuse(server, message, reason);
}

/* Handles the next message; false when there is none, or the socket is broken: the loop goes on at the pace
 * of its turns. */
static bool receive_one(peer_server_t *server)
{
    bool received;
    if (server->message == NULL) server->message = mem_alloc(sizeof *server->message);
    wire_message_t *message = server->message;
    result_t result = wire_receive_frames(server->options.socket, true, message, &received);
    if (!received && result.code != RESULT_PROTOCOL) return false;
    server->messages++;
    server->bytes += message->bytes;
    gate_heard(server->options.gate, message->connection);
    if (within_limit(server, message)) {
        if (received) result = wire_decode(message);
        if (result.code == RESULT_OK)
            dispatch(server, message);
        else
            on_malformed(server, message, result);
    }
    if (server->message != NULL) wire_free(message);
    return true;
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void wait_events(peer_server_t *server, bool more)
{
    const peer_server_options_t *options = &server->options;
    zmq_pollitem_t items[] = {{.socket = options->socket, .events = ZMQ_POLLIN},
                              {.fd = options->wake, .events = ZMQ_POLLIN}};
    zmq_poll(items, (int)ARRAY_LENGTH(items), more ? 0 : options->turn_ms);
    if (items[1].revents != 0) wake_clear(options->wake);
}

static void *peer_server_run(void *argument)
{
    peer_server_t *server = argument;
    const peer_server_options_t *options = &server->options;
    bool more = false;
    while (!atomic_load(&server->stop)) {
        pulse_beat(options->pulse, NULL);
        wait_events(server, more);
        more = true;
        for (int i = 0; i < options->turn_messages && more && !atomic_load(&server->stop); i++)
            more = receive_one(server);
        for (int t = 0; t < PEER_SERVER_TABLES; t++)
            if (options->tables[t].turn != NULL)
                options->tables[t].turn(options->tables[t].self, server, more);
    }
    log_info("%s socket: %llu messages, %.1f MB (%llu bytes) received, %llu malformed, %llu over the limit",
             options->name, (unsigned long long)server->messages, 1e-6 * (double)server->bytes,
             (unsigned long long)server->bytes, (unsigned long long)server->malformed,
             (unsigned long long)server->over_limit);
    zmq_close(options->socket);
    return NULL;
}

static void server_free(peer_server_t *server)
{
    rate_limit_destroy(&server->peer_limit);
    rate_limit_destroy(&server->key_limit);
    free(server->message);
    free(server);
}

result_t peer_server_start(const peer_server_options_t *options, peer_server_t **out)
{
    char name[16];
    peer_server_t *server = mem_zalloc(1, sizeof *server);
    server->options = *options;
    if (options->limited) {
        server->peer_limit = rate_limit_new(PEER_RATE, PEER_BURST, PEERS);
        server->key_limit = rate_limit_new(KEY_RATE, KEY_BURST, KEYS);
    }
    snprintf(name, sizeof name, "lm-%s", options->name);
    result_t result = thread_start(&server->thread, name, peer_server_run, server);
    if (result.code == RESULT_OK)
        *out = server;
    else
        server_free(server);
    return result;
}

void peer_server_stop(peer_server_t **out)
{
    peer_server_t *server = *out;
    if (server == NULL) return;
    atomic_store(&server->stop, true);
    wake_up(server->options.wake);
    pthread_join(server->thread, NULL);
    server_free(server);
    *out = NULL;
}
