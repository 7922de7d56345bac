/* link: see link.h. */
#include "proto/uplink/link.h"

#include "common/wake.h"
#include "proto/wire/wire.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double REOPEN_INTERVAL = 0.25; /* seconds between sockets, when a connection breaks at once */

static void drop_sockets(link_t *link)
{
    const int at_once = 0;
    if (link->monitor != NULL) {
        zmq_socket_monitor(link->socket, NULL, 0);
        zmq_close(link->monitor);
    }
    if (link->socket != NULL) {
        zmq_setsockopt(link->socket, ZMQ_LINGER, &at_once, sizeof at_once);
        zmq_close(link->socket);
    }
    link->socket = link->monitor = NULL;
}

/* Without a monitor the link works; a lost batch is then noticed by the silence. */
static void watch(link_t *link)
{
    char address[80];
    snprintf(address, sizeof address, "inproc://link-%p-%llu", (void *)link,
             (unsigned long long)link->conversation);
    if (zmq_socket_monitor(link->socket, address, ZMQ_EVENT_DISCONNECTED) != 0) return;
    link->monitor = zmq_socket(link->context, ZMQ_PAIR);
    if (link->monitor != NULL && zmq_connect(link->monitor, address) == 0) return;
    if (link->monitor != NULL) zmq_close(link->monitor);
    link->monitor = NULL;
    zmq_socket_monitor(link->socket, NULL, 0);
}

static void open_sockets(link_t *link)
{
    drop_sockets(link);
    link->broken = false;
    link->conversation++;
    link->opened = clock_now();
    result_t result = wire_socket(link->context, ZMQ_DEALER, &link->socket);
    if (result.code == RESULT_OK) result = dial_keys_apply(link->keys, link->socket);
    if (result.code != RESULT_OK) {
        log_error("%s", result.message);
        drop_sockets(link);
        link->broken = true;
        return;
    }
    watch(link);
    if (zmq_connect(link->socket, link->endpoint) == 0) return;
    log_error("cannot connect to %s: %s", link->endpoint, zmq_strerror(zmq_errno()));
    drop_sockets(link);
    link->broken = true;
}

bool link_set(link_t *link, const char *endpoint)
{
    bool same = endpoint == NULL ? link->endpoint == NULL
                                 : link->endpoint != NULL && strcmp(endpoint, link->endpoint) == 0;
    if (same) return false;
    free(link->endpoint);
    link->endpoint = endpoint != NULL ? mem_strdup(endpoint) : NULL;
    if (link->endpoint != NULL)
        open_sockets(link);
    else
        drop_sockets(link);
    return true;
}

/* Reads what the monitor says: only broken connections are asked for. */
static bool disconnected(link_t *link)
{
    bool broke = false;
    zmq_msg_t frame;
    if (link->monitor == NULL) return false;
    zmq_msg_init(&frame);
    while (zmq_msg_recv(&frame, link->monitor, ZMQ_DONTWAIT) >= 0) {
        uint16_t event = 0;
        if (zmq_msg_more(&frame) && zmq_msg_size(&frame) >= sizeof event)
            memcpy(&event, zmq_msg_data(&frame), sizeof event);
        broke = broke || event == ZMQ_EVENT_DISCONNECTED;
    }
    zmq_msg_close(&frame);
    return broke;
}

bool link_refresh(link_t *link)
{
    if (link->endpoint == NULL) return false;
    if (!link->broken && disconnected(link)) {
        log_debug("the connection to %s broke", link->endpoint);
        link->broken = true;
    }
    if (!link->broken || clock_now() - link->opened < REOPEN_INTERVAL) return false;
    open_sockets(link);
    return true;
}

void link_wait(link_t *link, int wake, double seconds)
{
    zmq_pollitem_t items[3] = {{.fd = wake, .events = ZMQ_POLLIN}};
    int count = 1;
    if (link->broken && seconds > REOPEN_INTERVAL) seconds = REOPEN_INTERVAL;
    if (link->socket != NULL && !link->broken) {
        items[count++] = (zmq_pollitem_t){.socket = link->socket, .events = ZMQ_POLLIN};
        if (link->monitor != NULL)
            items[count++] = (zmq_pollitem_t){.socket = link->monitor, .events = ZMQ_POLLIN};
    }
    zmq_poll(items, count, seconds > 0 ? (long)(1e3 * seconds) + 1 : 0);
    if (items[0].revents & ZMQ_POLLIN) wake_clear(wake);
}

void link_close(link_t *link)
{
    drop_sockets(link);
    free(link->endpoint);
    *link = (link_t){0};
}
