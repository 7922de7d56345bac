/* crowd: see crowd.h.
 *
 * DESIGN. A few threads with a share of the workers each. A thread sleeps on the descriptors of all its
 * sockets (epoll, edge-triggered, as ZMQ_FD wants it: after every wake-up and every message sent a socket is
 * read until it is empty) and goes through its workers' clocks some hundred times a second. Control and bulk
 * sockets have contexts of their own, so that heartbeats do not wait for this process's own batches. */
#include "tests/sim/crowd.h"

#include "proto/uplink/issued.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <unistd.h>

static const double TICK = 0.005;          /* seconds */
static const double HOLD_SECONDS = 1.0;    /* of work, as a worker holds it ahead */
static const double UNIT_SECONDS = 0.4;    /* in a good unit, likewise */
static const double REQUEST_TIMEOUT = 5.0; /* seconds before work is asked for again */
static const double OFFER_TIMEOUT = 20.0;  /* seconds before an offer is repeated */
enum { MAX_EVENTS = 256, CHUNK = 1 << 20 };

typedef struct {
    crowd_t *crowd;
    struct squad *squad;
    void *control, *bulk;
    double join_at;
    bool said_hello;
    uint64_t id; /* 0: not welcome yet */
    uint64_t request, beat_request, work_request, offer_request;
    double heartbeat, batch_interval;
    double next_beat, beat_sent, next_work, offered_at;

    uint64_t job;
    uint32_t plans; /* passes whose plans were asked for */
    bool starved;   /* the master had no work, and nothing came since */
    unit_t *queue;  /* assigned, not "rendered" yet */
    size_t queued, queue_capacity;
    issued_t issued;  /* how they were issued, and those of the open batch */
    double head_done; /* clock, when its first unit is finished */
    unit_t *open;     /* the open batch */
    size_t opened, open_capacity;
    double open_since, open_seconds; /* clock; CPU seconds in it */
    size_t under_way;                /* units of the batch that was sent */
    uint64_t sequence, samples, bytes;
    double sent_at, closed_before; /* clock */
} member_t;

typedef struct squad {
    crowd_t *crowd;
    pthread_t thread;
    int epoll;
    member_t *members;
    int count;
    pthread_mutex_t lock; /* guards report */
    crowd_report_t report;
} squad_t;

struct crowd {
    crowd_options_t options;
    void *control_context, *bulk_context;
    squad_t *squads;
    double start;
    atomic_bool ending, quit;
};

/* ---- messages ------------------------------------------------------------------------------------------ */

static void drain(member_t *member, bool bulk);

static void send_message(member_t *member, bool bulk, Lm__Envelope *envelope, zmq_msg_t *payload,
                         int payloads)
{
    envelope->request = ++member->request;
    result_t result = wire_send(bulk ? member->bulk : member->control, NULL, 0, envelope, payload, payloads);
    if (result.code != RESULT_OK) member->squad->report.failed++;
}

static void say_hello(member_t *member)
{
    Lm__Hello hello = LM__HELLO__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    char *capabilities[] = {"raw", "planes", "streams"};
    hello.protocol_version = WIRE_VERSION;
    hello.software = "a simulated worker";
    hello.name = "simulated";
    hello.threads = 1;
    hello.n_capabilities = ARRAY_LENGTH(capabilities);
    hello.capabilities = capabilities;
    envelope.body_case = LM__ENVELOPE__BODY_HELLO;
    envelope.hello = &hello;
    member->said_hello = true;
    send_message(member, false, &envelope, NULL, 0);
}

static void send_beat(member_t *member, double now)
{
    Lm__Heartbeat beat = LM__HEARTBEAT__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    beat.worker = member->id;
    beat.job = member->job;
    beat.units_held = (uint32_t)(member->queued + member->opened + member->under_way);
    envelope.body_case = LM__ENVELOPE__BODY_HEARTBEAT;
    envelope.heartbeat = &beat;
    send_message(member, false, &envelope, NULL, 0);
    member->beat_request = member->request;
    member->beat_sent = now;
    member->next_beat = now + member->heartbeat;
}

/* Shows that the bulk socket is reached: work is given to no others. */
static void send_probe(member_t *member)
{
    Lm__Probe probe = LM__PROBE__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    zmq_msg_t payload;
    zmq_msg_init(&payload);
    probe.worker = member->id;
    envelope.body_case = LM__ENVELOPE__BODY_PROBE;
    envelope.probe = &probe;
    send_message(member, true, &envelope, &payload, 1);
}

static double speed(const member_t *member)
{
    return prepared_speed(member->crowd->options.prepared) * member->crowd->options.power;
}

static double samples_of(const member_t *member, const unit_t *unit)
{
    return (double)unit->count *
           job_tile_pixels(prepared_settings(member->crowd->options.prepared), unit->tile);
}

static void ask_for_work(member_t *member, double now, double samples)
{
    Lm__WorkRequest request = LM__WORK_REQUEST__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    request.worker = member->id;
    request.job = member->job;
    request.samples = (uint64_t)samples;
    request.unit_samples = (uint64_t)fmax(256, UNIT_SECONDS * speed(member));
    envelope.body_case = LM__ENVELOPE__BODY_WORK_REQUEST;
    envelope.work_request = &request;
    send_message(member, false, &envelope, NULL, 0);
    member->work_request = member->request;
    member->next_work = now + REQUEST_TIMEOUT;
}

/* A plan, in chunks; what comes is thrown away. */
static void fetch_plan(member_t *member, const Lm__Plan *plan)
{
    size_t size = learning_plan_bytes();
    for (size_t at = 0; at < size; at += CHUNK) {
        Lm__BlobGet get = LM__BLOB_GET__INIT;
        Lm__Envelope envelope = LM__ENVELOPE__INIT;
        get.blob = plan->blob;
        get.offset = at;
        get.length = size - at < CHUNK ? (uint32_t)(size - at) : CHUNK;
        envelope.body_case = LM__ENVELOPE__BODY_BLOB_GET;
        envelope.blob_get = &get;
        send_message(member, true, &envelope, NULL, 0);
    }
    member->plans |= UINT32_C(1) << plan->pass;
}

static void make_offer(member_t *member, double now)
{
    Lm__BatchOffer offer = LM__BATCH_OFFER__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    offer.worker = member->id;
    offer.job = member->job;
    offer.bytes = prepared_bytes(member->crowd->options.prepared, member->open_seconds) * 5 / 4;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_OFFER;
    envelope.batch_offer = &offer;
    send_message(member, true, &envelope, NULL, 0);
    member->offer_request = member->request;
    member->offered_at = now;
}

/* Closes the open batch and sends it. */
static void send_batch(member_t *member, double now)
{
    Lm__BatchResult body = LM__BATCH_RESULT__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    zmq_msg_t payload[BATCH_PAYLOADS];
    film_counts_t counts = {.rays = 1, .cpu_us = (uint64_t)(1e6 * member->open_seconds)};
    Lm__Counts counts_message = LM__COUNTS__INIT;
    member->samples = 0;
    for (size_t i = 0; i < member->opened; i++) {
        uint64_t pixels = (uint64_t)(samples_of(member, &member->open[i]) / member->open[i].count);
        for (int half = 0; half < 2; half++)
            counts.light_paths[half] += pixels * unit_half_count(&member->open[i], half);
        member->samples += pixels * member->open[i].count;
    }
    wire_counts_put(&counts, &counts_message);
    prepared_payloads(member->crowd->options.prepared, member->open, member->opened, member->open_seconds,
                      payload);
    member->bytes = 0;
    for (int i = 0; i < BATCH_PAYLOADS; i++) member->bytes += zmq_msg_size(&payload[i]);
    body.worker = member->id;
    body.job = member->job;
    body.sequence = ++member->sequence;
    body.n_units = member->opened;
    issue_t *issues = mem_alloc((member->opened + 1) * sizeof *issues);
    issued_find(&member->issued, member->open, member->opened, issues);
    issued_keep(&member->issued, member->queue, member->queued);
    body.units = wire_units_new(member->open, issues, member->opened);
    free(issues);
    body.counts = &counts_message;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
    envelope.batch_result = &body;
    member->under_way = member->opened;
    member->opened = 0;
    member->offer_request = 0;
    if (member->closed_before > 0) {
        member->squad->report.intervals++;
        member->squad->report.interval_sum += now - member->closed_before;
    }
    member->sent_at = member->closed_before = now;
    send_message(member, true, &envelope, payload, payload_count(payload));
    free(body.units);
}

/* ---- answers ------------------------------------------------------------------------------------------- */

static void connect_bulk(member_t *member, uint32_t port)
{
    char *endpoint = mem_printf("tcp://%s:%u", member->crowd->options.host, port);
    int descriptor;
    size_t size = sizeof descriptor;
    if (wire_socket(member->crowd->bulk_context, ZMQ_DEALER, &member->bulk).code != RESULT_OK ||
        zmq_connect(member->bulk, endpoint) != 0)
        log_error("cannot connect to %s", endpoint);
    zmq_getsockopt(member->bulk, ZMQ_FD, &descriptor, &size);
    struct epoll_event event = {.events = EPOLLIN | EPOLLET, .data.ptr = member};
    epoll_ctl(member->squad->epoll, EPOLL_CTL_ADD, descriptor, &event);
    free(endpoint);
}

static void on_welcome(member_t *member, const Lm__Welcome *welcome, double now)
{
    member->id = welcome->worker;
    member->heartbeat = 1e-3 * welcome->heartbeat_ms;
    member->batch_interval = 1e-3 * welcome->batch_ms;
    member->next_beat = now;
    member->next_work = now + REQUEST_TIMEOUT;
    if (member->bulk == NULL) connect_bulk(member, welcome->bulk_port);
    send_probe(member);
}

static void on_assignment(member_t *member, const Lm__Assignment *assignment, double now)
{
    size_t count = member->queued + assignment->n_units;
    if (count > member->queue_capacity) {
        member->queue = mem_realloc(member->queue, 2 * count * sizeof *member->queue);
        member->queue_capacity = 2 * count;
    }
    if (member->queued == 0 && assignment->n_units > 0) member->head_done = fmax(member->head_done, now);
    job_settings_t settings = *prepared_settings(member->crowd->options.prepared);
    if (wire_units_get(assignment->units, assignment->n_units, &settings, member->queue + member->queued,
                       NULL)
            .code != RESULT_OK) {
        member->squad->report.failed++;
    } else {
        for (size_t i = 0; i < assignment->n_units; i++)
            issued_add(&member->issued, &member->queue[member->queued + i], &assignment->units[i]->mac, 1);
        member->queued = count;
    }
    member->job = assignment->job;
    member->starved = false;
    for (size_t i = 0; i < assignment->n_plans; i++)
        if ((member->plans >> assignment->plans[i]->pass & 1) == 0) fetch_plan(member, assignment->plans[i]);
}

static void on_beat(member_t *member, const Lm__HeartbeatReply *answer, double now)
{
    crowd_report_t *report = &member->squad->report;
    double seconds = now - member->beat_sent;
    int class = (int)(4 * log2(fmax(1, 1e6 * seconds)));
    report->beats[class < CROWD_BEATS ? class : CROWD_BEATS - 1]++;
    report->beat_most = fmax(report->beat_most, seconds);
    member->beat_request = 0;
    if (answer->known) return;
    report->lost++;
    member->queued = member->opened = 0;
    member->said_hello = false;
    member->id = 0;
}

static void on_verdict(member_t *member, const Lm__BatchReply *answer, double now)
{
    crowd_report_t *report = &member->squad->report;
    if (member->under_way == 0 || answer->sequence != member->sequence) return;
    report->batches++;
    report->bytes += member->bytes;
    report->answer_sum += now - member->sent_at;
    if (answer->accepted) {
        report->units += member->under_way;
        report->samples += member->samples;
    } else {
        report->refused++;
        log_debug("a batch was refused: %s", answer->reason);
    }
    member->under_way = 0;
}

static void on_refusal(member_t *member, const Lm__Envelope *envelope)
{
    member->squad->report.failed++;
    log_debug("refused: %s", envelope->refusal->reason);
    if (envelope->request == member->offer_request) member->offer_request = 0;
}

static void on_message(member_t *member, const Lm__Envelope *envelope, double now)
{
    switch (envelope->body_case) {
    case LM__ENVELOPE__BODY_WELCOME:
        on_welcome(member, envelope->welcome, now);
        break;
    case LM__ENVELOPE__BODY_HEARTBEAT_REPLY:
        if (envelope->request == member->beat_request) on_beat(member, envelope->heartbeat_reply, now);
        break;
    case LM__ENVELOPE__BODY_ASSIGNMENT:
        on_assignment(member, envelope->assignment, now);
        member->work_request = 0;
        member->next_work = now;
        break;
    case LM__ENVELOPE__BODY_NO_WORK:
        member->work_request = 0;
        member->starved = true;
        member->next_work = now + 1e-3 * envelope->no_work->retry_ms;
        break;
    case LM__ENVELOPE__BODY_PROBE_REPLY:
        member->next_work = now;
        break;
    case LM__ENVELOPE__BODY_JOB_READY:
        if (member->work_request == 0) member->next_work = now;
        break;
    case LM__ENVELOPE__BODY_BATCH_GRANT:
        if (envelope->request == member->offer_request && member->opened > 0) send_batch(member, now);
        break;
    case LM__ENVELOPE__BODY_BATCH_REPLY:
        on_verdict(member, envelope->batch_reply, now);
        break;
    case LM__ENVELOPE__BODY_REFUSAL:
        on_refusal(member, envelope);
        break;
    default:
        break;
    }
}

/* Reads a socket until it is empty. */
static void drain(member_t *member, bool bulk)
{
    for (;;) {
        void *socket = bulk ? member->bulk : member->control;
        wire_message_t message;
        bool received = false;
        if (socket == NULL) return;
        result_t result = wire_receive(socket, false, &message, &received);
        if (result.code == RESULT_OK && !received) return;
        if (result.code != RESULT_OK) {
            member->squad->report.failed++;
            continue;
        }
        on_message(member, message.envelope, clock_now());
        wire_free(&message);
    }
}

/* ---- clocks -------------------------------------------------------------------------------------------- */

/* Moves what is "rendered" by now to the open batch. */
static void render(member_t *member, double now)
{
    size_t done = 0;
    while (done < member->queued) {
        double seconds = samples_of(member, &member->queue[done]) / speed(member);
        if (member->head_done + seconds > now) break;
        if (member->opened == member->open_capacity) {
            member->open_capacity = 2 * member->open_capacity + 64;
            member->open = mem_realloc(member->open, member->open_capacity * sizeof *member->open);
        }
        if (member->opened == 0) {
            member->open_since = now;
            member->open_seconds = 0;
        }
        member->open[member->opened++] = member->queue[done++];
        member->open_seconds += seconds * member->crowd->options.power;
        member->head_done += seconds;
    }
    member->queued -= done;
    if (done > 0) memmove(member->queue, member->queue + done, member->queued * sizeof *member->queue);
}

static void keep_busy(member_t *member, double now)
{
    double held = 0, hold = fmax(HOLD_SECONDS, UNIT_SECONDS) * speed(member);
    if (now < member->next_work) return;
    for (size_t i = 0; i < member->queued; i++) held += samples_of(member, &member->queue[i]);
    if (held < 0.5 * hold) ask_for_work(member, now, hold - held);
}

static void tend(member_t *member, double now)
{
    if (!member->said_hello && now >= member->join_at) say_hello(member);
    if (member->id == 0) return;
    bool unanswered = member->beat_request != 0 && now - member->beat_sent < REQUEST_TIMEOUT;
    if (now >= member->next_beat && !unanswered) send_beat(member, now);
    if (atomic_load(&member->crowd->ending)) return;
    render(member, now);
    keep_busy(member, now);
    bool last = member->starved && member->queued == 0;
    bool due = member->opened > 0 && member->under_way == 0 &&
               (last || now - member->open_since >= member->batch_interval);
    bool waiting = member->offer_request != 0 && now - member->offered_at < OFFER_TIMEOUT;
    if (due && !waiting) make_offer(member, now);
}

static void *squad_run(void *argument)
{
    squad_t *squad = argument;
    double next_tick = 0;
    prctl(PR_SET_NAME, "sim-crowd");
    while (!atomic_load(&squad->crowd->quit)) {
        struct epoll_event events[MAX_EVENTS];
        double wait = next_tick - clock_now();
        int count = epoll_wait(squad->epoll, events, MAX_EVENTS, wait > 0 ? (int)(1e3 * wait) + 1 : 0);
        pthread_mutex_lock(&squad->lock);
        for (int i = 0; i < count; i++) {
            drain(events[i].data.ptr, false);
            drain(events[i].data.ptr, true);
        }
        double now = clock_now();
        for (int i = 0; now >= next_tick && i < squad->count; i++) {
            tend(&squad->members[i], now);
            drain(&squad->members[i], false);
            drain(&squad->members[i], true);
        }
        pthread_mutex_unlock(&squad->lock);
        if (now >= next_tick) next_tick = now + TICK;
    }
    return NULL;
}

/* ---- life ---------------------------------------------------------------------------------------------- */

static result_t member_open(crowd_t *crowd, squad_t *squad, member_t *member, int index)
{
    const crowd_options_t *options = &crowd->options;
    int descriptor;
    size_t size = sizeof descriptor;
    *member = (member_t){.crowd = crowd, .squad = squad};
    member->join_at = crowd->start + options->spread * index / options->workers;
    TRY(wire_socket(crowd->control_context, ZMQ_DEALER, &member->control));
    char *endpoint = mem_printf("tcp://%s:%d", options->host, options->ports[index % options->port_count]);
    bool connected = zmq_connect(member->control, endpoint) == 0;
    free(endpoint);
    if (!connected || zmq_getsockopt(member->control, ZMQ_FD, &descriptor, &size) != 0)
        return result_fail(RESULT_IO, "cannot connect: %s", zmq_strerror(zmq_errno()));
    struct epoll_event event = {.events = EPOLLIN | EPOLLET, .data.ptr = member};
    if (epoll_ctl(squad->epoll, EPOLL_CTL_ADD, descriptor, &event) != 0)
        return result_fail(RESULT_LIMIT, "cannot watch a socket");
    return result_ok();
}

static void *context_new(int sockets)
{
    void *context = zmq_ctx_new();
    zmq_ctx_set(context, ZMQ_MAX_SOCKETS, sockets);
    return context;
}

static result_t open_squads(crowd_t *crowd)
{
    const crowd_options_t *options = &crowd->options;
    for (int s = 0, next = 0; s < options->threads; s++) {
        squad_t *squad = &crowd->squads[s];
        int end = (int)((int64_t)options->workers * (s + 1) / options->threads);
        squad->crowd = crowd;
        squad->epoll = epoll_create1(EPOLL_CLOEXEC);
        squad->members = mem_zalloc((size_t)(end - next) + 1, sizeof *squad->members);
        pthread_mutex_init(&squad->lock, NULL);
        for (; next < end; next++) {
            TRY(member_open(crowd, squad, &squad->members[squad->count], next));
            squad->count++;
        }
    }
    return result_ok();
}

static void crowd_free(crowd_t *crowd)
{
    for (int s = 0; s < crowd->options.threads; s++) {
        squad_t *squad = &crowd->squads[s];
        for (int i = 0; i < squad->count; i++) {
            member_t *member = &squad->members[i];
            int linger = 0;
            zmq_close(member->control);
            if (member->bulk != NULL) {
                zmq_setsockopt(member->bulk, ZMQ_LINGER, &linger, sizeof linger);
                zmq_close(member->bulk);
            }
            free(member->queue);
            issued_free(&member->issued);
            free(member->open);
        }
        if (squad->epoll > 0) close(squad->epoll);
        pthread_mutex_destroy(&squad->lock);
        free(squad->members);
    }
    zmq_ctx_term(crowd->control_context);
    zmq_ctx_term(crowd->bulk_context);
    free(crowd->squads);
    free(crowd);
}

result_t crowd_start(const crowd_options_t *options, crowd_t **out)
{
    crowd_t *crowd = mem_zalloc(1, sizeof *crowd);
    crowd->options = *options;
    crowd->start = clock_now();
    crowd->control_context = context_new(options->workers + 10);
    crowd->bulk_context = context_new(options->workers + 10);
    crowd->squads = mem_zalloc((size_t)options->threads, sizeof *crowd->squads);
    result_t result = open_squads(crowd);
    if (result.code != RESULT_OK) {
        crowd_free(crowd);
        return result;
    }
    for (int s = 0; s < options->threads; s++)
        if (pthread_create(&crowd->squads[s].thread, NULL, squad_run, &crowd->squads[s]) != 0) abort();
    *out = crowd;
    return result_ok();
}

void crowd_report_add(crowd_report_t *sum, const crowd_report_t *more)
{
    sum->batches += more->batches;
    sum->refused += more->refused;
    sum->units += more->units;
    sum->bytes += more->bytes;
    sum->samples += more->samples;
    for (int i = 0; i < CROWD_BEATS; i++) sum->beats[i] += more->beats[i];
    sum->beat_most = fmax(sum->beat_most, more->beat_most);
    sum->intervals += more->intervals;
    sum->interval_sum += more->interval_sum;
    sum->answer_sum += more->answer_sum;
    sum->lost += more->lost;
    sum->failed += more->failed;
}

crowd_report_t crowd_report(crowd_t *crowd)
{
    crowd_report_t report = {0};
    for (int s = 0; s < crowd->options.threads; s++) {
        squad_t *squad = &crowd->squads[s];
        pthread_mutex_lock(&squad->lock);
        crowd_report_add(&report, &squad->report);
        squad->report = (crowd_report_t){0};
        for (int i = 0; i < squad->count; i++) {
            const member_t *member = &squad->members[i];
            report.joined += member->id != 0;
            report.idle += member->id != 0 && member->queued == 0;
            report.waiting += member->offer_request != 0;
            report.sent += member->under_way > 0;
        }
        pthread_mutex_unlock(&squad->lock);
    }
    return report;
}

void crowd_stop(crowd_t **out, double seconds, crowd_report_t *last)
{
    crowd_t *crowd = *out;
    double deadline = clock_now() + seconds;
    *last = (crowd_report_t){0};
    atomic_store(&crowd->ending, true);
    do {
        usleep(20000);
        crowd_report_t report = crowd_report(crowd);
        crowd_report_add(last, &report);
        last->sent = report.sent;
    } while (last->sent > 0 && clock_now() < deadline);
    atomic_store(&crowd->quit, true);
    for (int s = 0; s < crowd->options.threads; s++) pthread_join(crowd->squads[s].thread, NULL);
    crowd_free(crowd);
    *out = NULL;
}

double crowd_beat(const crowd_report_t *report, double share)
{
    uint64_t all = 0, sum = 0;
    for (int i = 0; i < CROWD_BEATS; i++) all += report->beats[i];
    for (int i = 0; i < CROWD_BEATS; i++) {
        sum += report->beats[i];
        if ((double)sum >= share * (double)all) return 1e-6 * exp2((i + 1) / 4.0);
    }
    return 0;
}
