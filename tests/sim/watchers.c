/* watchers: see watchers.h. */
#include "tests/sim/watchers.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <math.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

/* What the page asks for. */
typedef enum { ASK_JOBS, ASK_WORKERS, ASK_HISTORY, ASK_TILES, ASKS } ask_t;

/* The page's pace: web/app.js and web/tiles.js. */
static const double least[ASKS] = {0.5, 1, 1, 1}; /* seconds between two of a kind */
static const double every = 25;                   /* seconds after which all but tiles are asked for anyway */
static const double tile_speed = 2.5e6;           /* bytes a second of tiles, at most */
static const double first_pause = 0.2;            /* while the first tiles are being made */

enum { HEAD = 4096, BUFFER = 65536 };

typedef struct {
    watchers_t *all;
    pthread_t thread;
    int stream, connection, tiles; /* as browsers do, one more connection for what is asked meanwhile */
    bool tiles_asked;
    bool wanted[ASKS];
    double earliest[ASKS], next_round;
    uint64_t latest, version; /* of the image: there is, and we have */
    char line[HEAD];          /* of the stream, as far as it has come */
    size_t line_size;
    bool image; /* the line before said that an image follows */
    watched_t seen;
} watcher_t;

struct watchers {
    watchers_options_t options;
    int stop; /* eventfd */
    watcher_t *watchers;
};

/* ---- requests ------------------------------------------------------------------------------------------ */

static int dial(const watchers_options_t *options)
{
    struct sockaddr_in address = {.sin_family = AF_INET,
                                  .sin_port = htons((uint16_t)options->port),
                                  .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    struct timeval patience = {.tv_sec = 60};
    int connection = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    setsockopt(connection, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    if (connect(connection, (struct sockaddr *)&address, sizeof address) == 0) return connection;
    close(connection);
    return -1;
}

static void send_request(const watchers_options_t *options, int connection, const char *path)
{
    char *text =
        mem_printf("GET /api/v1%s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nAuthorization: Bearer %s\r\n\r\n", path,
                   options->port, options->token);
    if (send(connection, text, strlen(text), MSG_NOSIGNAL) < 0) log_debug("a watcher's connection is cut");
    free(text);
}

static char *path_of(const watcher_t *watcher, ask_t what)
{
    const watchers_options_t *options = &watcher->all->options;
    unsigned long long job = options->job;
    switch (what) {
    case ASK_JOBS:
        return mem_strdup("/jobs");
    case ASK_WORKERS:
        return mem_strdup("/workers");
    case ASK_HISTORY:
        return mem_printf("/jobs/%llu/history", job);
    default:
        return mem_printf("/jobs/%llu/tiles?layer=picture&level=%u&since=%llu&x0=0&y0=0&x1=%d&y1=%d", job,
                          options->level, (unsigned long long)watcher->version, options->width,
                          options->height);
    }
}

/* Reads an answer with a length. Returns its status, 0 when there is none; *start gets the first bytes of the
 * body. */
static int read_answer(watcher_t *watcher, int connection, char start[8], size_t *length)
{
    char head[HEAD + 1];
    static _Thread_local char rest[BUFFER];
    size_t got = 0;
    char *body = NULL;
    while (body == NULL) {
        ssize_t more = got < HEAD ? read(connection, head + got, HEAD - got) : 0;
        if (more <= 0) return 0;
        got += (size_t)more;
        head[got] = '\0';
        body = strstr(head, "\r\n\r\n");
    }
    const char *field = strstr(head, "Content-Length: ");
    *length = field != NULL ? strtoul(field + 16, NULL, 10) : 0;
    size_t have = got - (size_t)(body + 4 - head);
    memcpy(start, body + 4, have < 8 ? have : 8);
    watcher->seen.bytes += (double)got;
    while (have < *length) {
        size_t room = *length - have < BUFFER ? *length - have : BUFFER;
        ssize_t more = read(connection, rest, room);
        if (more <= 0) return 0;
        for (size_t i = 0; i < (size_t)more && have + i < 8; i++) start[have + i] = rest[i];
        have += (size_t)more;
        watcher->seen.bytes += (double)more;
    }
    return atoi(head + 9);
}

/* Sends a question. False when there is no connection. */
static bool put_question(watcher_t *watcher, ask_t what, int *connection)
{
    const watchers_options_t *options = &watcher->all->options;
    if (*connection < 0) *connection = dial(options);
    char *path = path_of(watcher, what);
    if (*connection >= 0) send_request(options, *connection, path);
    free(path);
    watcher->seen.requests++;
    watcher->wanted[what] = false;
    watcher->earliest[what] = clock_now() + least[what];
    return *connection >= 0;
}

/* True for an answer that is good. */
static bool take_answer(watcher_t *watcher, ask_t what, int *connection, char start[8], size_t *length)
{
    int status = *connection < 0 ? 0 : read_answer(watcher, *connection, start, length);
    if (status == 200) return true;
    watcher->seen.refused++;
    watcher->earliest[what] = clock_now() + 3;
    if (status == 0 && *connection >= 0) {
        close(*connection);
        *connection = -1;
    }
    return false;
}

static void take_tiles(watcher_t *watcher)
{
    char start[8] = {0};
    size_t length = 0;
    watcher->tiles_asked = false;
    if (!take_answer(watcher, ASK_TILES, &watcher->tiles, start, &length)) return;
    uint32_t version;
    memcpy(&version, start + 4, sizeof version); /* little-endian, as this machine is */
    watcher->version = version;
    watcher->seen.tile_bytes += (double)length;
    watcher->seen.pictures += length > 28;
    double pause = version == 0 ? first_pause : fmax(least[ASK_TILES], (double)length / tile_speed);
    watcher->earliest[ASK_TILES] = clock_now() + pause;
}

static void ask(watcher_t *watcher, ask_t what)
{
    char start[8];
    size_t length;
    if (what == ASK_TILES)
        watcher->tiles_asked = put_question(watcher, what, &watcher->tiles);
    else if (put_question(watcher, what, &watcher->connection))
        take_answer(watcher, what, &watcher->connection, start, &length);
}

/* ---- events -------------------------------------------------------------------------------------------- */

static void take_line(watcher_t *watcher, const char *line)
{
    if (strncmp(line, "event: ", 7) == 0) {
        const char *type = line + 7;
        watcher->seen.events++;
        watcher->image = strcmp(type, "image") == 0;
        if (strcmp(type, "lost") == 0) watcher->seen.lost++;
        if (strcmp(type, "worker") == 0 || strcmp(type, "lost") == 0) watcher->wanted[ASK_WORKERS] = true;
        if (strcmp(type, "worker") != 0) watcher->wanted[ASK_JOBS] = true;
        if (watcher->image) watcher->wanted[ASK_HISTORY] = true;
    } else if (watcher->image && strncmp(line, "data: ", 6) == 0) {
        const char *version = strstr(line, "\"version\":");
        if (version != NULL) watcher->latest = strtoull(version + 10, NULL, 10);
        watcher->image = false;
    }
}

static bool read_events(watcher_t *watcher)
{
    char bytes[HEAD];
    ssize_t got = recv(watcher->stream, bytes, sizeof bytes, MSG_DONTWAIT);
    if (got <= 0) return false;
    watcher->seen.bytes += (double)got;
    for (ssize_t i = 0; i < got; i++) {
        if (bytes[i] != '\n' && watcher->line_size + 1 < HEAD) watcher->line[watcher->line_size++] = bytes[i];
        if (bytes[i] != '\n') continue;
        watcher->line[watcher->line_size] = '\0';
        take_line(watcher, watcher->line);
        watcher->line_size = 0;
    }
    return true;
}

/* ---- a watcher ----------------------------------------------------------------------------------------- */

static bool is_wanted(const watcher_t *watcher, ask_t what)
{
    if (what != ASK_TILES) return watcher->wanted[what];
    return !watcher->tiles_asked && (watcher->version == 0 || watcher->latest > watcher->version);
}

/* Asks for all whose turn it is. Returns when the next one's is. */
static double ask_due(watcher_t *watcher)
{
    double now = clock_now();
    if (now >= watcher->next_round) {
        watcher->next_round = now + every;
        for (int a = 0; a < ASK_TILES; a++) watcher->wanted[a] = true;
    }
    double next = watcher->next_round;
    for (int a = 0; a < ASKS; a++) {
        if (is_wanted(watcher, (ask_t)a) && now >= watcher->earliest[a]) ask(watcher, (ask_t)a);
        if (is_wanted(watcher, (ask_t)a)) next = fmin(next, watcher->earliest[a]);
    }
    return next;
}

/* Waits for events, until then at most; false when all ends. */
static bool wait_for_events(watcher_t *watcher, double until)
{
    double left = fmax(0, until - clock_now());
    struct pollfd waits[] = {{.fd = watcher->all->stop, .events = POLLIN},
                             {.fd = watcher->stream, .events = POLLIN},
                             {.fd = watcher->tiles_asked ? watcher->tiles : -1, .events = POLLIN}};
    poll(waits, 3, (int)(1e3 * left) + 1);
    if (waits[2].revents != 0) take_tiles(watcher);
    if (waits[1].revents != 0 && !read_events(watcher)) {
        close(watcher->stream);
        watcher->stream = -1; /* poll passes over it */
        watcher->seen.refused++;
    }
    return waits[0].revents == 0;
}

static void *watcher_run(void *context)
{
    watcher_t *watcher = context;
    const watchers_options_t *options = &watcher->all->options;
    bool deaf = watcher - watcher->all->watchers < options->deaf;
    watcher->stream = dial(options);
    watcher->connection = dial(options);
    send_request(options, watcher->stream, "/events");
    if (deaf) {
        char *path = path_of(watcher, ASK_TILES);
        send_request(options, watcher->connection, path);
        free(path);
        struct pollfd wait = {.fd = watcher->all->stop, .events = POLLIN};
        poll(&wait, 1, -1);
    } else {
        while (wait_for_events(watcher, ask_due(watcher))) {
        }
    }
    if (watcher->stream >= 0) close(watcher->stream);
    if (watcher->connection >= 0) close(watcher->connection);
    if (watcher->tiles >= 0) close(watcher->tiles);
    return NULL;
}

/* ---- all of them --------------------------------------------------------------------------------------- */

result_t watchers_start(const watchers_options_t *options, watchers_t **out)
{
    watchers_t *watchers = mem_zalloc(1, sizeof *watchers);
    watchers->options = *options;
    watchers->stop = eventfd(0, EFD_CLOEXEC);
    watchers->watchers = mem_zalloc((size_t)options->count, sizeof *watchers->watchers);
    *out = watchers;
    for (int i = 0; i < options->count; i++) {
        watcher_t *watcher = &watchers->watchers[i];
        *watcher = (watcher_t){.all = watchers, .stream = -1, .connection = -1, .tiles = -1};
        /* They do not come all at once. */
        watcher->next_round = clock_now() + every * i / options->count;
        if (pthread_create(&watcher->thread, NULL, watcher_run, watcher) == 0) continue;
        watchers->options.count = i;
        watchers_stop(out);
        return result_fail(RESULT_LIMIT, "cannot start %d threads", options->count);
    }
    return result_ok();
}

watched_t watchers_stop(watchers_t **out)
{
    watchers_t *watchers = *out;
    watched_t sum = {0};
    eventfd_write(watchers->stop, 1);
    for (int i = 0; i < watchers->options.count; i++) {
        const watched_t *seen = &watchers->watchers[i].seen;
        pthread_join(watchers->watchers[i].thread, NULL);
        sum.bytes += seen->bytes;
        sum.tile_bytes += seen->tile_bytes;
        sum.requests += seen->requests;
        sum.pictures += seen->pictures;
        sum.events += seen->events;
        sum.lost += seen->lost;
        sum.refused += seen->refused;
    }
    close(watchers->stop);
    free(watchers->watchers);
    free(watchers);
    *out = NULL;
    return sum;
}
