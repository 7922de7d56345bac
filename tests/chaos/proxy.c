/* proxy: see proxy.h. One process, one thread, one poll. */
#include "tests/chaos/proxy.h"

#include "tests/chaos/dice.h"
#include "tests/chaos/stream.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MAX_CONNECTIONS = 200, READ_BYTES = 64 << 10, MAX_INHERITED = 1024 };
static const double TICK = 0.02; /* seconds: how soon an order of the driver is seen */

/* Side 0 is the one who called, side 1 the master. way[0] goes from 0 to 1. */
typedef struct {
    int socket[2]; /* socket[0] < 0: the place is free */
    stream_t way[2];
    proxy_link_t *link;
    bool connected; /* to the master */
    bool ending;    /* a side has closed: what is on its way is delivered, then the other is closed too */
} connection_t;

typedef struct {
    int socket;
    struct sockaddr_in target;
    proxy_link_t *link;
    bool bulk; /* of the second port */
} listener_t;

struct proxy {
    proxy_link_t *links; /* shared with the process */
    size_t count;
    pid_t process;
    /* Of the process. */
    listener_t listeners[PROXY_MAX_LINKS * PROXY_PORTS];
    size_t listener_count;
    unsigned cuts_seen[PROXY_MAX_LINKS];
    connection_t connections[MAX_CONNECTIONS];
    dice_t dice;
};

/* ---- connections -------------------------------------------------------------------------------------- */

static void close_connection(connection_t *connection, bool reset)
{
    struct linger linger = {.l_onoff = 1, .l_linger = 0}; /* close() then sends a reset */
    for (int side = 0; side < 2; side++) {
        if (reset) setsockopt(connection->socket[side], SOL_SOCKET, SO_LINGER, &linger, sizeof linger);
        close(connection->socket[side]);
        stream_free(&connection->way[side]);
        connection->socket[side] = -1;
    }
}

static void no_delay(int socket)
{
    int yes = 1;
    setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
}

static void accept_one(proxy_t *proxy, const listener_t *listener)
{
    int caller = accept4(listener->socket, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (caller < 0) return;
    connection_t *place = NULL;
    for (size_t i = 0; i < MAX_CONNECTIONS && place == NULL; i++)
        if (proxy->connections[i].socket[0] < 0) place = &proxy->connections[i];
    int master = socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    bool closed = listener->bulk && atomic_load(&listener->link->bulk_closed);
    bool willing = place != NULL && master >= 0 && !closed && !atomic_load(&listener->link->refusing);
    if (willing && connect(master, (const struct sockaddr *)&listener->target, sizeof listener->target) != 0)
        willing = errno == EINPROGRESS;
    if (!willing) {
        close(caller);
        if (master >= 0) close(master);
        return;
    }
    no_delay(caller);
    no_delay(master);
    *place = (connection_t){.socket = {caller, master}, .link = listener->link};
    for (int i = 0; i < 2; i++) stream_init(&place->way[i], listener->link);
    atomic_fetch_add(&listener->link->connections, 1);
}

/* Reads from one side; false when there is nothing more to come. */
static bool read_side(proxy_t *proxy, connection_t *connection, int side, double now)
{
    uint8_t bytes[READ_BYTES];
    ssize_t n = recv(connection->socket[side], bytes, sizeof bytes, 0);
    if (n < 0) return errno == EAGAIN || errno == EINTR;
    if (n > 0) stream_take(&connection->way[side], &proxy->dice, now, bytes, (size_t)n);
    return n > 0;
}

/* What poll should wait for on a side's socket. */
static short events_of(const connection_t *connection, int side, double now)
{
    if (atomic_load(&connection->link->stalled)) return 0;
    if (side == 1 && !connection->connected) return POLLOUT;
    const stream_t *from = &connection->way[side], *to = &connection->way[!side];
    bool reads = !connection->ending && connection->connected && from->queued < STREAM_MAX_QUEUED;
    return (short)((reads ? POLLIN : 0) | (stream_due(to) <= now && to->first ? POLLOUT : 0));
}

static void serve_connection(proxy_t *proxy, connection_t *connection, const struct pollfd *polled,
                             double now)
{
    if (atomic_load(&connection->link->stalled)) return;
    bool whole = true;
    if (!connection->connected && polled[1].revents) {
        int error = 0;
        socklen_t size = sizeof error;
        getsockopt(connection->socket[1], SOL_SOCKET, SO_ERROR, &error, &size);
        connection->connected = error == 0;
        whole = error == 0;
    }
    for (int side = 0; side < 2 && whole; side++) {
        if (polled[side].revents & (POLLIN | POLLHUP | POLLERR) && !connection->ending &&
            connection->connected)
            connection->ending = !read_side(proxy, connection, side, now);
        stream_tick(&connection->way[side], &proxy->dice, now);
        if (connection->connected)
            whole = stream_send(&connection->way[side], now, connection->socket[!side]);
    }
    bool delivered = stream_idle(&connection->way[0]) && stream_idle(&connection->way[1]);
    if (!whole || (connection->ending && delivered)) close_connection(connection, !whole);
}

/* ---- the process -------------------------------------------------------------------------------------- */

static void obey_cuts(proxy_t *proxy)
{
    for (size_t i = 0; i < proxy->count; i++) {
        unsigned cuts = atomic_load(&proxy->links[i].cuts);
        if (cuts == proxy->cuts_seen[i]) continue;
        proxy->cuts_seen[i] = cuts;
        for (size_t c = 0; c < MAX_CONNECTIONS; c++) {
            connection_t *connection = &proxy->connections[c];
            if (connection->socket[0] < 0 || connection->link != &proxy->links[i]) continue;
            close_connection(connection, true);
            atomic_fetch_add(&proxy->links[i].reset, 1);
        }
    }
}

/* When a stream has something to do; the tick at the latest. */
static double next_event(const proxy_t *proxy, double now)
{
    double due = now + TICK;
    for (size_t c = 0; c < MAX_CONNECTIONS; c++) {
        const connection_t *connection = &proxy->connections[c];
        for (int way = 0; way < 2 && connection->socket[0] >= 0; way++)
            due = fmin(due, fmax(stream_due(&connection->way[way]), now + 1e-3));
    }
    return due;
}

static void serve(proxy_t *proxy)
{
    static struct pollfd polled[PROXY_MAX_LINKS * PROXY_PORTS + 2 * MAX_CONNECTIONS];
    double now = clock_now();
    obey_cuts(proxy);
    for (size_t i = 0; i < proxy->listener_count; i++)
        polled[i] = (struct pollfd){.fd = proxy->listeners[i].socket, .events = POLLIN};
    struct pollfd *rest = polled + proxy->listener_count;
    for (size_t c = 0; c < MAX_CONNECTIONS; c++)
        for (int side = 0; side < 2; side++) {
            const connection_t *connection = &proxy->connections[c];
            bool open = connection->socket[0] >= 0;
            short events = open ? events_of(connection, side, now) : 0;
            /* A socket that nothing is wanted of is left out: its hang-up would make poll spin. */
            rest[2 * c + (size_t)side] =
                (struct pollfd){.fd = events ? connection->socket[side] : -1, .events = events};
        }
    int ms = (int)ceil(1e3 * (next_event(proxy, now) - now));
    poll(polled, proxy->listener_count + 2 * MAX_CONNECTIONS, ms);
    now = clock_now();
    for (size_t c = 0; c < MAX_CONNECTIONS; c++)
        if (proxy->connections[c].socket[0] >= 0)
            serve_connection(proxy, &proxy->connections[c], rest + 2 * c, now);
    for (size_t i = 0; i < proxy->listener_count; i++)
        if (polled[i].revents) accept_one(proxy, &proxy->listeners[i]);
}

static result_t listen_on(proxy_t *proxy, size_t link, const char *host, const char *target, int port,
                          bool bulk)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)}, on = address;
    int file = socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), yes = 1;
    if (inet_pton(AF_INET, host, &address.sin_addr) != 1 || inet_pton(AF_INET, target, &on.sin_addr) != 1)
        return result_fail(RESULT_USAGE, "%s or %s is no address", host, target);
    setsockopt(file, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    proxy->listeners[proxy->listener_count++] = (listener_t){file, on, &proxy->links[link], bulk};
    if (bind(file, (struct sockaddr *)&address, sizeof address) == 0 && listen(file, 64) == 0)
        return result_ok();
    return result_fail(RESULT_IO, "the proxy cannot listen on %s:%d: %s", host, port, strerror(errno));
}

static result_t open_links(proxy_t *proxy, const char *const *hosts, const char *target, int port)
{
    size_t bytes = proxy->count * sizeof *proxy->links;
    proxy->links = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (proxy->links == MAP_FAILED) return result_fail(RESULT_LIMIT, "no memory for the proxy");
    for (size_t i = 0; i < proxy->count; i++)
        for (int p = 0; p < PROXY_PORTS; p++) TRY(listen_on(proxy, i, hosts[i], target, port + p, p > 0));
    return result_ok();
}

/* Closes what the process inherited: a port that its owner closes is to be free. */
static void close_others(const proxy_t *proxy)
{
    for (int file = STDERR_FILENO + 1; file < MAX_INHERITED; file++) {
        bool ours = false;
        for (size_t i = 0; i < proxy->listener_count; i++) ours = ours || proxy->listeners[i].socket == file;
        if (!ours) close(file);
    }
}

result_t proxy_start(const char *const *hosts, size_t count, const char *target, int port, uint64_t seed,
                     proxy_t **proxy_pointer)
{
    proxy_t *proxy = mem_zalloc(1, sizeof *proxy);
    proxy->count = count;
    proxy->dice = dice_new(seed, 77);
    for (size_t i = 0; i < MAX_CONNECTIONS; i++) proxy->connections[i].socket[0] = -1;
    TRY(open_links(proxy, hosts, target, port));
    int ready[2]; /* the process closes what it inherited, and with it this pipe */
    if (pipe2(ready, O_CLOEXEC) != 0 || (proxy->process = fork()) < 0)
        return result_fail(RESULT_LIMIT, "cannot start the proxy: %s", strerror(errno));
    if (proxy->process == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        prctl(PR_SET_NAME, "proxy");
        close_others(proxy);
        for (;;) serve(proxy);
    }
    for (size_t i = 0; i < proxy->listener_count; i++) close(proxy->listeners[i].socket);
    close(ready[1]);
    char end;
    while (read(ready[0], &end, 1) < 0 && errno == EINTR) {
    }
    close(ready[0]);
    *proxy_pointer = proxy;
    return result_ok();
}

proxy_link_t *proxy_link(proxy_t *proxy, size_t index)
{
    return &proxy->links[index];
}

void proxy_heal(proxy_link_t *link)
{
    atomic_store(&link->delay_ms, 0);
    atomic_store(&link->jitter_ms, 0);
    atomic_store(&link->bytes_per_second, 0);
    atomic_store(&link->stalled, false);
    atomic_store(&link->refusing, false);
    atomic_store(&link->bulk_closed, false);
    for (int i = 0; i < PROXY_MISCHIEFS; i++) atomic_store(&link->todo[i], 0);
}

bool proxy_alive(proxy_t *proxy)
{
    return waitpid(proxy->process, NULL, WNOHANG) == 0;
}

void proxy_stop(proxy_t **proxy_pointer)
{
    proxy_t *proxy = *proxy_pointer;
    if (proxy == NULL) return;
    kill(proxy->process, SIGKILL);
    waitpid(proxy->process, NULL, 0);
    munmap(proxy->links, proxy->count * sizeof *proxy->links);
    free(proxy);
    *proxy_pointer = NULL;
}
