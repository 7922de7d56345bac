/* events: see events.h. */
#include "master/http/events.h"

#include "common/thread.h"
#include "master/http/changes.h"

#include <inttypes.h>
#include <pthread.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

enum {
    EVENTS_KEPT = 4096, /* in the ring, unless it is told otherwise */
    SOCKET = 64 << 10,  /* bytes of a stream that the kernel keeps, about */
    STREAMS = 128,      /* at a time; connections are left for everything else */
    CALM = 4,           /* streams for which events come a second later: who hears of something asks for it */
    BLOCK = 4096        /* bytes of a stream's buffer */
};
static const double BEAT = 15;  /* seconds of silence after which a comment is sent */
static const double GRACE = 30; /* seconds for which events are written after the last reader has left */

typedef struct stream stream_t;
struct stream {
    http_events_t *events;
    struct MHD_Connection *connection;
    uint64_t next;   /* event */
    char *text;      /* what is being sent, */
    size_t size, at; /* and how far */
    double sent;     /* when something was sent last */
    bool beat;       /* a comment is due */
    bool suspended;
    stream_t *link;
};

struct http_events {
    farm_t *farm;
    pthread_t thread;
    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t listened_to;
    bool ending, watching; /* somebody listens, or did a while ago: `changes` has what was told last */
    double left;           /* when the last reader went */
    stream_t *streams;
    size_t stream_count;
    uint32_t life; /* tells this process from the one before, in the ids of events */
    char **ring;
    size_t kept;
    uint64_t first, next; /* events from here, to before here, are in the ring */
    changes_t changes;
};

/* ---- the ring; all under the lock ---------------------------------------------------------------------- */

static void write_event(void *context, const char *type, json_t *data)
{
    http_events_t *events = context;
    char *json = json_dumps(data, JSON_COMPACT | JSON_REAL_PRECISION(9)),
         **place = &events->ring[events->next % events->kept];
    json_decref(data);
    free(*place);
    *place = mem_printf("id: %08" PRIx32 "-%" PRIu64 "\nevent: %s\ndata: %s\n\n", events->life, events->next,
                        type, json != NULL ? json : "{}");
    free(json);
    events->next++;
    if (events->next - events->first > events->kept) events->first = events->next - events->kept;
}

/* What happens from now on is written. */
static void watch(http_events_t *events)
{
    if (events->watching) return;
    events->watching = true;
    changes_begin(&events->changes, events->farm);
    pthread_cond_signal(&events->listened_to);
}

/* What happens from now on is lost: the number that it would have had is left out. */
static void unwatch(http_events_t *events)
{
    events->watching = false;
    events->next++;
    events->first = events->next;
}

/* ---- streams ------------------------------------------------------------------------------------------- */

static void load(stream_t *stream, char *text)
{
    free(stream->text);
    stream->text = text;
    stream->size = strlen(text);
    stream->at = 0;
}

static bool has_more(const stream_t *stream)
{
    return stream->at < stream->size || stream->next < stream->events->next || stream->beat;
}

static char *lost_text(stream_t *stream)
{
    http_events_t *events = stream->events;
    stream->next = events->next;
    return mem_printf("id: %08" PRIx32 "-%" PRIu64 "\nevent: lost\ndata: {}\n\n", events->life,
                      events->next - 1);
}

/* Loads what is to be sent next; false when there is nothing. */
static bool load_next(stream_t *stream)
{
    http_events_t *events = stream->events;
    if (stream->next < events->first)
        load(stream, lost_text(stream));
    else if (stream->next < events->next)
        load(stream, mem_strdup(events->ring[stream->next++ % events->kept]));
    else if (stream->beat)
        load(stream, mem_strdup(":\n\n"));
    else
        return false;
    stream->beat = false;
    return true;
}

static size_t copy(stream_t *stream, char *bytes, size_t room)
{
    size_t copied = 0;
    while (copied < room && (stream->at < stream->size || load_next(stream))) {
        size_t size = stream->size - stream->at;
        if (size > room - copied) size = room - copied;
        memcpy(bytes + copied, stream->text + stream->at, size);
        stream->at += size;
        copied += size;
    }
    return copied;
}

/* Is called when the connection takes more. */
static ssize_t on_room(void *context, uint64_t position, char *bytes, size_t room)
{
    (void)position;
    stream_t *stream = context;
    http_events_t *events = stream->events;
    pthread_mutex_lock(&events->lock);
    ssize_t copied = events->ending ? MHD_CONTENT_READER_END_OF_STREAM : (ssize_t)copy(stream, bytes, room);
    if (copied == 0) {
        stream->suspended = true;
        MHD_suspend_connection(stream->connection);
    } else {
        stream->sent = clock_now();
    }
    pthread_mutex_unlock(&events->lock);
    return copied;
}

static void on_gone(void *context)
{
    stream_t *stream = context;
    http_events_t *events = stream->events;
    pthread_mutex_lock(&events->lock);
    for (stream_t **at = &events->streams; *at != NULL; at = &(*at)->link)
        if (*at == stream) {
            *at = stream->link;
            events->stream_count--;
            break;
        }
    if (events->stream_count == 0) events->left = clock_now();
    pthread_mutex_unlock(&events->lock);
    free(stream->text);
    free(stream);
}

/* Where a reader goes on that had the event of this id; before all events when it is none of this process. */
static uint64_t place_after(const http_events_t *events, const char *id)
{
    uint64_t number;
    return http_event_id_parse(id, events->life, &number) && number < events->next ? number + 1 : 0;
}

static stream_t *open_stream(http_events_t *events, http_request_t *request)
{
    const char *last = http_header(request, "Last-Event-ID");
    stream_t *stream = mem_zalloc(1, sizeof *stream);
    *stream = (stream_t){.events = events, .connection = request->connection, .sent = clock_now()};
    load(stream, mem_strdup("retry: 1000\n\n"));
    pthread_mutex_lock(&events->lock);
    bool room = !events->ending && events->stream_count < STREAMS;
    if (room) {
        watch(events);
        stream->next = last != NULL ? place_after(events, last) : events->next;
        stream->link = events->streams;
        events->streams = stream;
        events->stream_count++;
    }
    pthread_mutex_unlock(&events->lock);
    if (room) return stream;
    free(stream->text);
    free(stream);
    return NULL;
}

/* The kernel would keep megabytes for each reader who does not read. */
static void limit_socket(const http_request_t *request)
{
    const int bytes = SOCKET / 2; /* the kernel doubles it */
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(request->connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    if (info != NULL) setsockopt(info->connect_fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
}

void http_events_answer(http_events_t *events, http_request_t *request)
{
    limit_socket(request);
    stream_t *stream = open_stream(events, request);
    if (stream == NULL) {
        http_reply_problem(request, MHD_HTTP_SERVICE_UNAVAILABLE, "too many listen to events already");
        return;
    }
    struct MHD_Response *response =
        MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, BLOCK, on_room, stream, on_gone);
    if (response == NULL) on_gone(stream);
    http_reply_response(request, MHD_HTTP_OK, "text/event-stream", response);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void wake_stream(stream_t *stream)
{
    if (!stream->suspended) return;
    stream->suspended = false;
    MHD_resume_connection(stream->connection);
}

static void tick(http_events_t *events, double now)
{
    changes_tell(&events->changes, events->farm, write_event, events);
    for (stream_t *stream = events->streams; stream != NULL; stream = stream->link) {
        if (now - stream->sent >= BEAT) stream->beat = true;
        if (has_more(stream)) wake_stream(stream);
    }
    if (events->stream_count == 0 && now - events->left > GRACE) unwatch(events);
}

/* A second, and one more for each CALM that listen. */
static void wait_a_while(http_events_t *events)
{
    double until = clock_now() + 1 + (double)(events->stream_count / CALM);
    cond_wait_until(&events->listened_to, &events->lock, until);
}

static void *events_run(void *context)
{
    http_events_t *events = context;
    pthread_mutex_lock(&events->lock);
    while (!events->ending) {
        if (events->watching)
            wait_a_while(events);
        else
            pthread_cond_wait(&events->listened_to, &events->lock);
        if (events->watching && !events->ending) tick(events, clock_now());
    }
    pthread_mutex_unlock(&events->lock);
    return NULL;
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

result_t http_events_start(farm_t *farm, uint32_t kept, http_events_t **out)
{
    http_events_t *events = mem_zalloc(1, sizeof *events);
    cond_init_monotonic(&events->listened_to);
    pthread_mutex_init(&events->lock, NULL);
    events->farm = farm;
    events->kept = kept > 0 ? kept : EVENTS_KEPT;
    events->ring = mem_zalloc(events->kept, sizeof *events->ring);
    events->first = events->next = 1;
    randombytes_buf(&events->life, sizeof events->life);
    *out = events;
    result_t result = thread_start(&events->thread, "lm-events", events_run, events);
    if (result.code != RESULT_OK) http_events_free(out);
    return result;
}

void http_events_end(http_events_t *events)
{
    if (events == NULL) return;
    pthread_mutex_lock(&events->lock);
    events->ending = true;
    for (stream_t *stream = events->streams; stream != NULL; stream = stream->link) wake_stream(stream);
    pthread_cond_signal(&events->listened_to);
    pthread_mutex_unlock(&events->lock);
    pthread_join(events->thread, NULL);
}

void http_events_free(http_events_t **out)
{
    http_events_t *events = *out;
    if (events == NULL) return;
    for (size_t i = 0; i < events->kept; i++) free(events->ring[i]);
    free(events->ring);
    changes_free(&events->changes);
    pthread_cond_destroy(&events->listened_to);
    pthread_mutex_destroy(&events->lock);
    free(events);
    *out = NULL;
}
