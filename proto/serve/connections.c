/* connections: see connections.h.
 *
 * DESIGN. The frames of different messages do not mix on a connection, so while one message does not end, no
 * other is taken from it. What has come over TCP since the last message that was taken (TCP_INFO) is
 * therefore what libzmq holds of the next ones, or at most a little more: whole ones that were not looked at
 * yet, which ZMQ_RCVHWM bounds.
 *
 * libzmq cannot be told to end a connection. It does say which file descriptors it has, and when one is shut
 * down it takes that for the end, and throws away what it holds. A descriptor may be closed, and its number
 * given to another connection, before we are told: at worst a peer has to dial again, which peers do. */
#include "proto/serve/connections.h"

#include <arpa/inet.h>
#include <linux/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

typedef struct {
    bool open, spoke;            /* it is there; a message of it was taken */
    char text[INET6_ADDRSTRLEN]; /* its host; empty: not known */
    double opened;               /* seconds */
    uint32_t messages;           /* of heard_t, when it was last looked at, or closed */
    uint64_t taken;              /* bytes that had come when the last message was taken, */
    uint64_t unfinished;         /* and since */
} connection_t;

struct connections {
    const char *name;
    connection_limits_t limits;
    heard_t *heard;
    connection_t *list; /* by descriptor */
    int capacity, end;  /* of the list; one more than the highest descriptor in it that was ever open */
};

connections_t *connections_new(const char *name, const connection_limits_t *limits, heard_t *heard)
{
    connections_t *connections = mem_zalloc(1, sizeof *connections);
    *connections = (connections_t){.name = name, .limits = *limits, .heard = heard};
    return connections;
}

void connections_destroy(connections_t **connections)
{
    if (*connections == NULL) return;
    free((*connections)->list);
    free(*connections);
    *connections = NULL;
}

/* NULL when it is not watched. */
static connection_t *find(const connections_t *connections, int descriptor)
{
    bool known = descriptor >= 0 && descriptor < connections->end;
    return known && connections->list[descriptor].open ? &connections->list[descriptor] : NULL;
}

static connection_t *make(connections_t *connections, int descriptor)
{
    if (descriptor < 0 || descriptor >= CONNECTIONS_MAX) return NULL;
    if (descriptor >= connections->capacity) {
        int capacity = int_max(descriptor + 1, 2 * connections->capacity);
        connections->list = mem_realloc(connections->list, (size_t)capacity * sizeof *connections->list);
        memset(&connections->list[connections->capacity], 0,
               (size_t)(capacity - connections->capacity) * sizeof *connections->list);
        connections->capacity = capacity;
    }
    connections->end = int_max(connections->end, descriptor + 1);
    return &connections->list[descriptor];
}

static void find_address(int descriptor, char text[INET6_ADDRSTRLEN])
{
    struct sockaddr_storage address = {0};
    socklen_t size = sizeof address;
    /* It may be closed by now: then the address stays unknown. */
    if (getpeername(descriptor, (struct sockaddr *)&address, &size) != 0) return;
    const void *host = address.ss_family == AF_INET6
                           ? (const void *)&((struct sockaddr_in6 *)&address)->sin6_addr
                           : (const void *)&((struct sockaddr_in *)&address)->sin_addr;
    if (address.ss_family == AF_INET || address.ss_family == AF_INET6)
        inet_ntop(address.ss_family, host, text, INET6_ADDRSTRLEN);
}

void connections_opened(connections_t *connections, double now, int descriptor)
{
    connection_t *connection = make(connections, descriptor);
    if (connection == NULL) return;
    /* It may have been heard already, before we are told of it. */
    *connection = (connection_t){.open = true, .opened = now, .messages = connection->messages};
    find_address(descriptor, connection->text);
}

void connections_closed(connections_t *connections, int descriptor)
{
    connection_t *connection = find(connections, descriptor);
    if (connection == NULL) return;
    connection->open = false;
    connection->messages = atomic_load(&connections->heard->messages[descriptor]);
    atomic_store(&connections->heard->expected[descriptor], 0);
}

const char *connections_address(const connections_t *connections, int descriptor)
{
    const connection_t *connection = find(connections, descriptor);
    return connection != NULL && connection->text[0] != '\0' ? connection->text : "somewhere";
}

/* ---- the patrol ---------------------------------------------------------------------------------------- */

static uint64_t bytes_received(int descriptor)
{
    struct tcp_info info = {0};
    socklen_t size = sizeof info;
    return getsockopt(descriptor, IPPROTO_TCP, TCP_INFO, &info, &size) == 0 ? info.tcpi_bytes_received : 0;
}

static void look(connections_t *connections, int descriptor, connection_t *connection)
{
    uint32_t messages = atomic_load(&connections->heard->messages[descriptor]);
    uint64_t received = bytes_received(descriptor);
    if (messages != connection->messages) {
        connection->spoke = true;
        connection->messages = messages;
        connection->taken = received;
    }
    connection->unfinished = received > connection->taken ? received - connection->taken : 0;
}

/* `complaint` NULL: nobody need know. */
static void end_connection(connections_t *connections, int descriptor, complaint_t *complaint,
                           const char *why)
{
    if (complaint == NULL || complaint_allowed(complaint, clock_now()))
        log_write(complaint != NULL ? LOG_WARNING : LOG_DEBUG,
                  "a connection from %s to the %s socket is closed: %s",
                  connections_address(connections, descriptor), connections->name, why);
    shutdown(descriptor, SHUT_RDWR);
    connections_closed(connections, descriptor);
}

/* Ends the connection if it is beyond a limit of its own. */
static void judge(connections_t *connections, double now, int descriptor, complaint_t *complaint)
{
    const connection_t *connection = &connections->list[descriptor];
    const connection_limits_t *limits = &connections->limits;
    uint64_t expected = atomic_load(&connections->heard->expected[descriptor]);
    char why[120];
    if (connection->unfinished > limits->unfinished &&
        connection->unfinished - limits->unfinished > expected) {
        snprintf(why, sizeof why, "a message of more than %.1f MB that has not come to its end",
                 1e-6 * (double)connection->unfinished);
        end_connection(connections, descriptor, complaint, why);
    } else if (!connection->spoke && now - connection->opened > limits->silence) {
        snprintf(why, sizeof why, "no message in %.0f s", now - connection->opened);
        /* Honest peers do so too: a client that waits for its image. They dial again. */
        end_connection(connections, descriptor, NULL, why);
    }
}

/* All together are within their limit when those that hold most are gone. */
static void judge_all(connections_t *connections, complaint_t *complaint)
{
    for (;;) {
        uint64_t sum = 0;
        int largest = -1;
        for (int i = 0; i < connections->end; i++) {
            if (!connections->list[i].open) continue;
            sum += connections->list[i].unfinished;
            if (largest < 0 || connections->list[i].unfinished > connections->list[largest].unfinished)
                largest = i;
        }
        if (sum <= connections->limits.all || largest < 0) return;
        end_connection(connections, largest, complaint,
                       "messages that have not come to their end take too much memory, and its takes most");
    }
}

void connections_patrol(connections_t *connections, double now, complaint_t *complaint)
{
    for (int i = 0; i < connections->end; i++) {
        if (!connections->list[i].open) continue;
        look(connections, i, &connections->list[i]);
        judge(connections, now, i, complaint);
    }
    judge_all(connections, complaint);
}
