/* desk: see desk.h. */
#include "relay/desk.h"

#include "proto/serve/complaint.h"

#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>

enum { TURN_MS = 100, MESSAGES_A_TURN = 256 };

struct desk {
    desk_options_t options;
    pthread_t thread;
    atomic_bool stop;
    complaint_t complaint;
    uint64_t messages, bytes, malformed;
};

/* ---- answers ------------------------------------------------------------------------------------------- */

void desk_reply(desk_t *desk, const wire_message_t *message, Lm__Envelope *answer, zmq_msg_t *payload)
{
    answer->request = message->envelope != NULL ? message->envelope->request : 0;
    result_t result = wire_send(desk->options.socket, message->identity, message->identity_size, answer,
                                payload, payload != NULL);
    if (result.code != RESULT_OK) log_debug("an answer was not sent: %s", result.message);
}

void desk_refuse(desk_t *desk, const wire_message_t *message, result_t reason)
{
    Lm__Refusal refusal = LM__REFUSAL__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    refusal.code = reason.code;
    refusal.reason = reason.message;
    answer.body_case = LM__ENVELOPE__BODY_REFUSAL;
    answer.refusal = &refusal;
    desk_reply(desk, message, &answer, NULL);
}

bool desk_send(desk_t *desk, const uint8_t *identity, size_t size, Lm__Envelope *envelope)
{
    result_t result = wire_send(desk->options.socket, identity, size, envelope, NULL, 0);
    if (result.code != RESULT_OK) log_debug("a message was not sent: %s", result.message);
    return result.code == RESULT_OK;
}

void desk_complain(desk_t *desk, const char *format, ...)
{
    char text[700];
    va_list arguments;
    if (!complaint_allowed(&desk->complaint, clock_now())) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    log_warning("%s", text);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void on_malformed(desk_t *desk, const wire_message_t *message, result_t reason)
{
    desk->malformed++;
    desk_complain(desk, "a peer sent nonsense to the %s socket: %s", desk->options.name, reason.message);
    if (message->identity_size > 0) desk_refuse(desk, message, reason);
}

static void handle(desk_t *desk, wire_message_t **message)
{
    result_t result = gate_check(desk->options.gate, *message);
    if (result.code == RESULT_OK) {
        desk->options.handle(desk->options.self, desk, message);
    } else {
        desk_complain(desk, "a message from %s is refused: %s", (*message)->address, result.message);
        desk_refuse(desk, *message, result);
    }
}

/* Handles the next message; false when there is none. */
static bool receive_one(desk_t *desk)
{
    wire_message_t *message = mem_alloc(sizeof *message);
    bool received;
    result_t result = wire_receive(desk->options.socket, true, message, &received);
    bool any = received || result.code == RESULT_PROTOCOL;
    if (any) {
        desk->messages++;
        desk->bytes += message->bytes;
    }
    if (received)
        handle(desk, &message);
    else if (any)
        on_malformed(desk, message, result);
    if (message != NULL) wire_free(message);
    free(message);
    return any;
}

static void *desk_run(void *argument)
{
    desk_t *desk = argument;
    bool more = false;
    while (!atomic_load(&desk->stop)) {
        zmq_pollitem_t items[] = {{.socket = desk->options.socket, .events = ZMQ_POLLIN},
                                  {.fd = desk->options.wake, .events = ZMQ_POLLIN}};
        zmq_poll(items, (int)ARRAY_LENGTH(items), more ? 0 : TURN_MS);
        eventfd_t count;
        if (items[1].revents != 0) eventfd_read(desk->options.wake, &count);
        more = true;
        for (int i = 0; i < MESSAGES_A_TURN && more && !atomic_load(&desk->stop); i++)
            more = receive_one(desk);
        desk->options.turn(desk->options.self, desk, !more);
    }
    log_info("%s socket: %llu messages, %.1f MB, %llu malformed", desk->options.name,
             (unsigned long long)desk->messages, 1e-6 * (double)desk->bytes,
             (unsigned long long)desk->malformed);
    zmq_close(desk->options.socket);
    return NULL;
}

result_t desk_start(const desk_options_t *options, desk_t **out)
{
    desk_t *desk = mem_zalloc(1, sizeof *desk);
    desk->options = *options;
    int error = pthread_create(&desk->thread, NULL, desk_run, desk);
    if (error == 0) {
        pthread_setname_np(desk->thread, options->name);
        *out = desk;
        return result_ok();
    }
    free(desk);
    return result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
}

void desk_stop(desk_t **out)
{
    desk_t *desk = *out;
    if (desk == NULL) return;
    atomic_store(&desk->stop, true);
    eventfd_write(desk->options.wake, 1);
    pthread_join(desk->thread, NULL);
    free(desk);
    *out = NULL;
}
