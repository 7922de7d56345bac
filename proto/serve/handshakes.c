/* handshakes: see handshakes.h.
 *
 * DESIGN. libzmq says on a monitor that a handshake failed, but not whose it was. It does say which file
 * descriptors it accepts and closes, and it closes a connection right after its handshake has failed; so the
 * address is noted when a connection is accepted, and looked up when one is closed after a failure. Where
 * several threads of libzmq accept at a time, the addresses of two failures may be taken for one another:
 * they are for people. */
#include "proto/serve/handshakes.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

static const int EVENTS = ZMQ_EVENT_ACCEPTED | ZMQ_EVENT_DISCONNECTED | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                          ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL;

struct handshakes {
    void *monitor;
    const char *name;
    uint16_t failed; /* event that the next closed connection is about; 0: none */
    uint32_t detail; /* its value */
    bool keys;
    connections_t *connections;
};

result_t handshakes_watch(void *context, void *socket, const char *name, bool keys,
                          connections_t *connections, handshakes_t **out)
{
    char endpoint[64];
    handshakes_t *handshakes = mem_zalloc(1, sizeof *handshakes);
    handshakes->name = name;
    handshakes->keys = keys;
    handshakes->connections = connections;
    snprintf(endpoint, sizeof endpoint, "inproc://handshakes-%p", socket);
    *out = handshakes;
    if (zmq_socket_monitor(socket, endpoint, EVENTS) == 0) {
        handshakes->monitor = zmq_socket(context, ZMQ_PAIR);
        if (handshakes->monitor != NULL && zmq_connect(handshakes->monitor, endpoint) == 0)
            return result_ok();
    }
    result_t result = result_fail(RESULT_IO, "cannot watch a socket: %s", zmq_strerror(errno));
    handshakes_destroy(out);
    return result;
}

void *handshakes_socket(const handshakes_t *handshakes)
{
    return handshakes->monitor;
}

void handshakes_destroy(handshakes_t **handshakes)
{
    if (*handshakes == NULL) return;
    if ((*handshakes)->monitor != NULL) zmq_close((*handshakes)->monitor);
    free(*handshakes);
    *handshakes = NULL;
}

static const char *reason(uint16_t event, uint32_t detail, bool keys)
{
    if (event == ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL)
        return keys ? "it broke off without showing a key" : "it broke off before it had begun";
    switch (detail) {
    case ZMQ_PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH:
        return keys ? "it uses no keys" : "it uses keys, and this socket does not";
    case ZMQ_PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC:
        return "it was made for the key of another master";
    default:
        return "it does not follow the protocol";
    }
}

static void on_closed(handshakes_t *handshakes, int descriptor, complaint_t *complaint)
{
    const char *address = connections_address(handshakes->connections, descriptor);
    if (handshakes->failed != 0 && complaint_allowed(complaint, clock_now()))
        log_warning("refused a connection from %s to the %s socket: %s", address, handshakes->name,
                    reason(handshakes->failed, handshakes->detail, handshakes->keys));
    handshakes->failed = 0;
    connections_closed(handshakes->connections, descriptor);
}

static void on_event(handshakes_t *handshakes, uint16_t event, uint32_t value, complaint_t *complaint)
{
    switch (event) {
    case ZMQ_EVENT_ACCEPTED:
        connections_opened(handshakes->connections, clock_now(), (int)value);
        break;
    case ZMQ_EVENT_DISCONNECTED:
        on_closed(handshakes, (int)value, complaint);
        break;
    default:
        handshakes->failed = event;
        handshakes->detail = value;
    }
}

void handshakes_report(handshakes_t *handshakes, complaint_t *complaint)
{
    for (;;) {
        uint8_t frame[6]; /* the number of an event and its value; a second frame names the endpoint */
        uint16_t event;
        uint32_t value;
        int more = 0;
        size_t size = sizeof more;
        int received = zmq_recv(handshakes->monitor, frame, sizeof frame, ZMQ_DONTWAIT);
        if (received < 0) return;
        zmq_getsockopt(handshakes->monitor, ZMQ_RCVMORE, &more, &size);
        if (!more || received != (int)sizeof frame) continue;
        memcpy(&event, frame, sizeof event);
        memcpy(&value, frame + sizeof event, sizeof value);
        on_event(handshakes, event, value, complaint);
    }
}
