/* Tests of the relay's pool by its calls: what it takes from workers and what it does not, whom it gives
 * what, and what it makes of a master that gives old numbers to new jobs. Sockets come in test_relay.c, but
 * for one towards the master, which answers requests for scenes or does not. */
#include "proto/uplink/bulk.h"
#include "relay/pool.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cmocka.h>

enum { JOB = 3, INTERVAL = 10, WINDOW = 4, CHUNK = 1 << 20 };
static const double PATIENCE = 20;    /* seconds for anything */
static const uint64_t MUCH = 1 << 30; /* pixel samples: more than there are */

typedef struct {
    pool_t *pool;
    uplink_handler_t handler; /* what the master's side calls, */
    serve_handler_t serve;    /* and the workers' */
    job_settings_t settings;
    hash_t blob;
    uint64_t ada, bob; /* workers */
    unit_t *units;     /* of the last assignment to one, */
    issue_t *issues;   /* and how they were issued */
    int bulk_wake;
    hash_t plans[LEARNING_PASSES]; /* of what was taken last */
} test_t;

static uint64_t hello_from(test_t *t, const char *name, const char *address)
{
    identity_t identity = {{1}, 1};
    worker_hello_t said = {.name = name, .key = "", .address = address, .threads = 1};
    uint64_t worker = 0;
    assert_int_equal(t->serve.calls->hello(t->pool, 0, &identity, &said, &worker).code, RESULT_OK);
    assert_int_equal(t->serve.calls->reached(t->pool, 0, worker).code, RESULT_OK);
    return worker;
}

static uint64_t hello(test_t *t, const char *name)
{
    return hello_from(t, name, NULL);
}

/* A pool with so many bytes of memory, and two workers. */
static void open_pool(test_t *t, uint64_t memory)
{
    pool_options_t options = {.lease = 1000,
                              .batch_interval = INTERVAL,
                              .memory = memory,
                              .control_wake = -1,
                              .bulk_wake = t->bulk_wake,
                              .notice_wake = -1,
                              .grant_wake = -1};
    t->pool = pool_new(&options);
    t->handler = pool_uplink(t->pool);
    t->serve = pool_serve(t->pool);
    t->ada = hello(t, "ada");
    t->bob = hello(t, "bob");
}

static int set_up(void **state)
{
    test_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->bulk_wake = eventfd(0, EFD_NONBLOCK);
    open_pool(t, (uint64_t)1 << 30);
    t->settings = job_settings_default();
    t->settings.learn = false;
    t->settings.width = t->settings.height = 64;
    t->blob = hash_bytes("blob", 4);
    t->units = mem_alloc(WIRE_MAX_UNITS * sizeof *t->units);
    t->issues = mem_alloc(WIRE_MAX_UNITS * sizeof *t->issues);
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    test_t *t = *state;
    pool_destroy(&t->pool);
    close(t->bulk_wake);
    free(t->units);
    free(t->issues);
    free(t);
    return 0;
}

/* ---- the master ---------------------------------------------------------------------------------------- */

/* What the master sends with a unit here. */
static uint64_t master_mac(const unit_t *unit)
{
    return ((uint64_t)unit->tile << 40 ^ (uint64_t)unit->first << 20 ^ unit->count) + 1;
}

static void assign_by_plans(test_t *t, uint64_t job, const hash_t *blob, uint64_t blob_size,
                            const unit_t *units, size_t count, const hash_t plans[LEARNING_PASSES])
{
    assignment_t assignment = {.job = job,
                               .settings = t->settings,
                               .blob = *blob,
                               .blob_size = blob_size,
                               .content = job_content_hash(&t->settings, blob),
                               .unit_count = count};
    /* In one piece of memory, which begins with the units. */
    uint64_t *memory = mem_alloc((3 * count + 1) * sizeof *memory);
    assignment.units = memcpy(memory, units, count * sizeof *units);
    assignment.macs = memory + 2 * count;
    for (size_t i = 0; i < count; i++) assignment.macs[i] = master_mac(&units[i]);
    memcpy(assignment.plans, plans, sizeof assignment.plans);
    t->handler.calls->assign(t->handler.self, &assignment);
}

static void assign_job(test_t *t, uint64_t job, const hash_t *blob, uint64_t blob_size, const unit_t *units,
                       size_t count)
{
    assign_by_plans(t, job, blob, blob_size, units, count, (hash_t[LEARNING_PASSES]){{{0}}});
}

static void assign(test_t *t, const unit_t *units, size_t count)
{
    assign_job(t, JOB, &t->blob, 4, units, count);
}

static duty_t duty_of(test_t *t)
{
    return t->handler.calls->duty(t->handler.self, 0, 0);
}

static result_t load(test_t *t, const hash_t *hash)
{
    scene_blob_t blob = {.bytes = (const void *)"blob", .size = 4, .hash = *hash};
    return t->handler.calls->loaded(t->handler.self, JOB, &blob);
}

static void begin(test_t *t, const unit_t *units, size_t count)
{
    assign(t, units, count);
    assert_int_equal(duty_of(t).kind, DUTY_LOAD);
    assert_int_equal(load(t, &t->blob).code, RESULT_OK);
}

/* ---- the workers --------------------------------------------------------------------------------------- */

/* Asks for work; returns how many units came. */
static size_t take(test_t *t, double now, uint64_t worker, uint64_t samples)
{
    identity_t identity = {{1}, 1};
    work_request_t request = {.worker = worker, .samples = samples, .unit_samples = 1};
    work_t work = {.units = t->units, .issues = t->issues};
    assert_int_equal(t->serve.calls->take(t->pool, now, &identity, &request, &work).code, RESULT_OK);
    memcpy(t->plans, work.plans, sizeof t->plans);
    return work.job != 0 ? work.unit_count : 0;
}

/* As the relay issues units of the job to either worker: its secret is all zeroes, and they are one party. */
static void issue(const test_t *t, const unit_t *units, size_t count, issue_t *issues)
{
    hash_t content = job_content_hash(&t->settings, &t->blob);
    unit_mac_t mac = unit_mac(&(unit_secret_t){{0}}, "", JOB, &content, 0);
    unit_mac_issue(&mac, units, count, issues);
}

static result_t deliver_as(test_t *t, uint64_t worker, uint64_t check, const batch_t *batch,
                           const issue_t *issues)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    batch_t bare = {
        .unit_count = batch->unit_count, .unit_capacity = batch->unit_count, .counts = batch->counts};
    assert_int_equal(payload_encode(batch, payload).code, RESULT_OK);
    bare.units = mem_alloc(batch->unit_count * sizeof *bare.units);
    memcpy(bare.units, batch->units, batch->unit_count * sizeof *bare.units);
    incoming_batch_t incoming = {
        .worker = worker, .job = JOB, .check = check, .batch = &bare, .issues = issues, .payload = payload};
    result_t result = t->serve.calls->add(t->pool, 0, &incoming);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&bare);
    return result;
}

/* As if all had been issued to the worker. */
static result_t deliver(test_t *t, uint64_t worker, const batch_t *batch)
{
    issue_t *issues = mem_alloc(batch->unit_count * sizeof *issues);
    issue(t, batch->units, batch->unit_count, issues);
    result_t result = deliver_as(t, worker, 0, batch, issues);
    free(issues);
    return result;
}

static result_t render(test_t *t, uint64_t worker, const unit_t *units, size_t count)
{
    batch_t batch = peer_render(&t->settings, units, count);
    result_t result = deliver(t, worker, &batch);
    batch_free(&batch);
    return result;
}

/* ---- tests --------------------------------------------------------------------------------------------- */

/* The master would refuse the whole sum for them, and put the relay aside. */
static void what_the_master_would_refuse_is_refused_here(void **state)
{
    test_t *t = *state;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}};
    begin(t, units, 2);
    assert_int_equal(take(t, 0, t->ada, MUCH), 2);
    batch_t batch = peer_render(&t->settings, units, 2);
    assert_true(batch.sums[SUM_FEATURES].count > 0);
    batch.sums[SUM_FEATURES].values[batch.sums[SUM_FEATURES].count - 5] = (int64_t)1 << 60;
    result_t result = deliver(t, t->ada, &batch);
    assert_int_equal(result.code, RESULT_PROTOCOL);
    assert_non_null(strstr(result.message, "feature sums"));
    batch_free(&batch);
    /* Its units go to others. */
    assert_int_equal(take(t, 0, t->bob, MUCH), 2);
    assert_int_equal(render(t, t->bob, units, 2).code, RESULT_OK);
    duty_t duty = duty_of(t);
    assert_int_equal(duty.kind, DUTY_OFFER);
    closed_batch_t closed = t->handler.calls->close(t->handler.self, &duty.offer);
    assert_int_equal(closed.batch->unit_count, 2);
    t->handler.calls->sent(t->handler.self, &closed, true);
    free(closed.issues);
}

/* A master that lost its data gives the number to another job while the old one's scene is on its way. */
static void a_scene_goes_to_the_job_that_it_is_of(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4};
    hash_t old = t->blob;
    uint64_t size;
    assign(t, &unit, 1);
    duty_t duty = duty_of(t);
    assert_true(hash_equal(&duty.assignment.blob, &old));
    t->blob = hash_bytes("another", 7);
    assign(t, &unit, 1);
    assert_int_equal(load(t, &old).code, RESULT_CANCELLED);
    assert_int_equal(t->serve.calls->blob_size(t->pool, &t->blob, &size).code, RESULT_INPUT);
    duty = duty_of(t);
    assert_int_equal(duty.kind, DUTY_LOAD);
    assert_true(hash_equal(&duty.assignment.blob, &t->blob));
    assert_int_equal(load(t, &t->blob).code, RESULT_OK);
    assert_int_equal(t->serve.calls->blob_size(t->pool, &t->blob, &size).code, RESULT_OK);
}

/* A worker that waits for a grant loses nothing; one that does not even offer does. */
static void who_is_made_to_wait_keeps_its_units(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4};
    const batch_offer_t offer = {.worker = t->ada, .job = JOB};
    double now = 0;
    begin(t, &unit, 1);
    assert_int_equal(take(t, now, t->ada, MUCH), 1);
    for (; now < 20 * INTERVAL; now += INTERVAL) {
        assert_int_equal(t->serve.calls->wanted(t->pool, now, &offer).code, RESULT_OK);
        assert_int_equal(take(t, now, t->bob, MUCH), 0);
    }
    assert_int_equal(take(t, now + 10 * INTERVAL, t->bob, MUCH), 1);
}

/* So does one that offers batches of a job that is not here. */
static void who_offers_what_is_not_wanted_loses_its_units(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4};
    const batch_offer_t offer = {.worker = t->ada, .job = JOB + 1};
    double now = 0;
    begin(t, &unit, 1);
    assert_int_equal(take(t, now, t->ada, MUCH), 1);
    for (; now < 20 * INTERVAL; now += INTERVAL)
        assert_int_not_equal(t->serve.calls->wanted(t->pool, now, &offer).code, RESULT_OK);
    assert_int_equal(take(t, now, t->bob, MUCH), 1);
}

/* Sums of all jobs have one bound. */
static void sums_of_one_job_keep_others_waiting(void **state)
{
    test_t *t = *state;
    const unit_t units[] = {{0, 0, 1}, {1, 0, 1}};
    pool_destroy(&t->pool);
    open_pool(t, 1 << 20);
    begin(t, units, 2);
    assign_job(t, JOB + 1, &t->blob, 4, units, 2);
    assert_int_equal(take(t, 0, t->ada, MUCH), 2);
    const batch_offer_t offer = {.worker = t->bob, .job = JOB + 1};
    assert_int_equal(t->serve.calls->wanted(t->pool, 0, &offer).code, RESULT_OK);
    for (int i = 0; i < 2; i++) assert_int_equal(render(t, t->ada, &units[i], 1).code, RESULT_OK);
    assert_int_equal(t->serve.calls->wanted(t->pool, 0, &offer).code, RESULT_LIMIT);
}

static void who_asks_for_nothing_gets_nothing(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4};
    begin(t, &unit, 1);
    assert_int_equal(take(t, 0, t->ada, 0), 0);
    assert_int_equal(take(t, 0, t->ada, 1), 1);
}

/* Whoever is not of this relay may make other bits; nor is its batch a way to take units of others away. */
static void a_stranger_delivers_nothing(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4};
    begin(t, &unit, 1);
    assert_int_equal(take(t, 0, t->ada, MUCH), 1);
    assert_int_equal(render(t, 0, &unit, 1).code, RESULT_UNREACHABLE);
    assert_int_equal(render(t, t->ada ^ t->bob, &unit, 1).code, RESULT_UNREACHABLE);
    assert_int_equal(take(t, 0, t->bob, MUCH), 0);
    assert_int_equal(render(t, t->ada, &unit, 1).code, RESULT_OK);
    assert_int_equal(render(t, t->ada, &unit, 1).code, RESULT_MISMATCH); /* nothing counts twice */
}

/* They are not known before the pool looks at them; what the sender has of the job stays its own. */
static void units_that_are_not_of_the_job_are_refused(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4}, wrong[] = {{999, 0, 4}, {0, 0, 0}, {0, UINT32_MAX, 4}};
    hash_t content = job_content_hash(&t->settings, &t->blob);
    begin(t, &unit, 1);
    assert_int_equal(take(t, 0, t->ada, MUCH), 1);
    batch_t batch = peer_render(&t->settings, &unit, 1);
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++) {
        issue_t how;
        issue(t, &wrong[i], 1, &how);
        claim_t claim = {t->bob, JOB, &content, &wrong[i], &how, 1};
        t->serve.calls->claim(t->pool, 0, &claim);
        batch.units[0] = wrong[i];
        assert_int_equal(deliver(t, t->ada, &batch).code, i == 1 ? RESULT_DENIED : RESULT_PROTOCOL);
        assert_int_equal(take(t, 0, t->bob, MUCH), 0);
    }
    batch.units[0] = unit;
    assert_int_equal(deliver(t, t->ada, &batch).code, RESULT_OK);
    batch_free(&batch);
}

/* As the master does, the relay takes from a worker what it gave to its party. */
static void what_was_not_issued_is_refused(void **state)
{
    test_t *t = *state;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}};
    uint64_t eve = hello_from(t, "eve", "192.0.2.1");
    begin(t, units, 2);
    assert_int_equal(take(t, 0, t->ada, 1), 1);
    issue_t issues[2] = {t->issues[0], t->issues[0]};
    assert_int_equal(t->units[0].tile, 0);
    batch_t both = peer_render(&t->settings, units, 2), one = peer_render(&t->settings, units, 1);
    assert_int_equal(deliver_as(t, t->ada, 0, &both, issues).code, RESULT_DENIED);
    assert_int_equal(deliver_as(t, eve, 0, &one, issues).code, RESULT_DENIED);
    assert_int_equal(deliver_as(t, t->ada, 7, &one, issues).code, RESULT_DENIED);
    issues[0].mac ^= 1;
    assert_int_equal(deliver_as(t, t->ada, 0, &one, issues).code, RESULT_DENIED);
    hash_t content = job_content_hash(&t->settings, &t->blob);
    claim_t claim = {eve, JOB, &content, &units[1], &issues[1], 1};
    t->serve.calls->claim(t->pool, 0, &claim);
    assert_int_equal(take(t, 0, t->bob, MUCH),
                     2); /* what ada held went back with the batch; eve got nothing */
    issues[0].mac ^= 1;
    assert_int_equal(deliver_as(t, t->ada, 0, &one, issues).code, RESULT_OK);
    batch_free(&both);
    batch_free(&one);
}

/* The sum bears the master's MACs of the units that its own lie in. */
static void a_sum_shows_how_its_units_were_issued(void **state)
{
    test_t *t = *state;
    const unit_t units[] = {{0, 0, 8}, {1, 4, 4}}, pieces[] = {{1, 4, 4}, {0, 6, 2}, {0, 1, 3}, {0, 0, 1}};
    const uint32_t before[] = {0, 6, 1, 0}, after[] = {0, 0, 4, 7};
    issue_t issues[4];
    begin(t, units, 2);
    assert_int_equal(take(t, 0, t->ada, MUCH), 2);
    for (int i = 0; i < 4; i++)
        issues[i] = (issue_t){t->issues[pieces[i].tile == t->units[0].tile ? 0 : 1].mac, before[i], after[i]};
    batch_t batch = peer_render(&t->settings, pieces, 4);
    assert_int_equal(deliver_as(t, t->ada, 0, &batch, issues).code, RESULT_OK);
    batch_free(&batch);
    duty_t duty = duty_of(t);
    assert_int_equal(duty.kind, DUTY_OFFER);
    closed_batch_t closed = t->handler.calls->close(t->handler.self, &duty.offer);
    assert_int_equal(closed.batch->unit_count, 4);
    for (int i = 0; i < 4; i++) {
        assert_true(closed.issues[i].mac == master_mac(&units[pieces[i].tile]));
        assert_int_equal(closed.issues[i].before, before[i]);
        assert_int_equal(closed.issues[i].after, after[i]);
    }
    /* The rest of a unit is known after that, too. */
    t->handler.calls->sent(t->handler.self, &closed, true);
    free(closed.issues);
    const unit_t rest = {0, 4, 2};
    assert_int_equal(render(t, t->ada, &rest, 1).code, RESULT_OK);
    duty = duty_of(t);
    closed = t->handler.calls->close(t->handler.self, &duty.offer);
    assert_true(closed.issues[0].mac == master_mac(&units[0]) && closed.issues[0].before == 4);
    t->handler.calls->sent(t->handler.self, &closed, true);
    free(closed.issues);
}

/* Its workers were told to drop what they have not rendered: whoever asks gets it. */
static void a_job_that_goes_on_at_once_goes_on_whole(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 4};
    begin(t, &unit, 1);
    assert_int_equal(take(t, 0, t->ada, MUCH), 1);
    t->handler.calls->job_over(t->handler.self, JOB, true);
    assign(t, &unit, 1);
    assert_int_equal(take(t, 0, t->bob, MUCH), 1);
    assert_int_equal(render(t, t->bob, &unit, 1).code, RESULT_OK);
    assert_int_equal(render(t, t->ada, &unit, 1).code, RESULT_MISMATCH);
}

/* Neither keeps the other away, however long it takes. */
static void sums_and_scenes_take_turns(void **state)
{
    test_t *t = *state;
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}};
    hash_t next = hash_bytes("next", 4);
    begin(t, units, 2);
    assert_int_equal(take(t, 0, t->ada, MUCH), 2);
    assign_job(t, JOB + 1, &next, 4, units, 1);
    assert_false(t->handler.calls->pressing(t->handler.self));
    assert_int_equal(duty_of(t).kind, DUTY_LOAD);
    assert_int_equal(render(t, t->ada, units, 2).code, RESULT_OK);
    assert_true(t->handler.calls->pressing(t->handler.self));
    for (int i = 0; i < 3; i++) {
        duty_t duty = duty_of(t); /* the sum stays, as if it were not granted */
        assert_int_equal(duty.kind, DUTY_OFFER);
        assert_int_equal(duty.offer.job, JOB);
        duty = duty_of(t);
        assert_int_equal(duty.kind, DUTY_LOAD);
        assert_int_equal(duty.assignment.job, JOB + 1);
    }
}

/* ---- a master's bulk socket ---------------------------------------------------------------------------- */

typedef struct {
    char *folder;
    void *context, *socket;
    bulk_t *bulk;
} uplink_t;

static void open_uplink(test_t *t, uplink_t *up, double patience)
{
    char endpoint[64];
    size_t size = sizeof endpoint;
    up->folder = scratch_new();
    up->context = zmq_ctx_new();
    assert_int_equal(wire_socket(up->context, ZMQ_ROUTER, &up->socket).code, RESULT_OK);
    assert_int_equal(zmq_bind(up->socket, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(up->socket, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    bulk_options_t options = {.context = up->context,
                              .handler = t->handler,
                              .wake = t->bulk_wake,
                              .control_wake = -1,
                              .cache_dir = up->folder,
                              .cache_limit = 1 << 30,
                              .patience = patience};
    assert_int_equal(bulk_start(&options, &up->bulk).code, RESULT_OK);
    bulk_link_up(up->bulk, endpoint, 1, 0);
}

static void close_uplink(uplink_t *up)
{
    bulk_stop(&up->bulk);
    zmq_close(up->socket);
    zmq_ctx_term(up->context);
    scratch_destroy(&up->folder);
}

/* Answers a request and frees it. */
static void answer(uplink_t *up, wire_message_t *request, Lm__Envelope *envelope, zmq_msg_t *payload)
{
    envelope->request = request->envelope->request;
    assert_int_equal(
        wire_send(up->socket, request->identity, request->identity_size, envelope, payload, payload != NULL)
            .code,
        RESULT_OK);
    wire_free(request);
}

static void answer_probe(uplink_t *up, wire_message_t *request)
{
    Lm__ProbeReply reply = LM__PROBE_REPLY__INIT;
    answer(up, request, &WIRE_ENVELOPE(PROBE_REPLY, probe_reply, &reply), NULL);
}

/* What the relay says next, which is of this kind; the caller frees it. */
static wire_message_t hear(uplink_t *up, Lm__Envelope__BodyCase kind)
{
    wire_message_t message;
    bool received = false;
    for (double start = clock_now(); !received;) {
        zmq_pollitem_t item = {.socket = up->socket, .events = ZMQ_POLLIN};
        zmq_poll(&item, 1, 10);
        assert_int_equal(wire_receive(up->socket, true, &message, &received).code, RESULT_OK);
        if (received && message.envelope->body_case == LM__ENVELOPE__BODY_PROBE) {
            answer_probe(up, &message);
            received = false;
        }
        if (clock_now() - start > PATIENCE) fail_msg("no message of kind %d comes", (int)kind);
    }
    assert_int_equal(message.envelope->body_case, kind);
    return message;
}

/* Hears the requests for a window of chunks, the first one at `offset`. */
static void hear_window(uplink_t *up, uint64_t offset, wire_message_t *requests)
{
    for (uint64_t i = 0; i < WINDOW; i++) {
        requests[i] = hear(up, LM__ENVELOPE__BODY_BLOB_GET);
        assert_int_equal(requests[i].envelope->blob_get->offset, offset + i * CHUNK);
        assert_int_equal(requests[i].identity_size, requests[0].identity_size);
        assert_memory_equal(requests[i].identity, requests[0].identity, requests[0].identity_size);
    }
}

static void answer_chunk(uplink_t *up, wire_message_t *request)
{
    Lm__BlobChunk chunk = LM__BLOB_CHUNK__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    zmq_msg_t payload;
    chunk.offset = request->envelope->blob_get->offset;
    zmq_msg_init_size(&payload, CHUNK);
    memset(zmq_msg_data(&payload), 0, CHUNK);
    envelope.body_case = LM__ENVELOPE__BODY_BLOB_CHUNK;
    envelope.blob_chunk = &chunk;
    answer(up, request, &envelope, &payload);
}

/* Takes in a batch from its offer to its verdict. */
static void count_batch(uplink_t *up)
{
    Lm__BatchGrant grant = LM__BATCH_GRANT__INIT;
    Lm__BatchReply reply = LM__BATCH_REPLY__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    wire_message_t message = hear(up, LM__ENVELOPE__BODY_BATCH_OFFER);
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_GRANT;
    envelope.batch_grant = &grant;
    answer(up, &message, &envelope, NULL);
    message = hear(up, LM__ENVELOPE__BODY_BATCH_RESULT);
    reply.sequence = message.envelope->batch_result->sequence;
    reply.accepted = true;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_REPLY;
    envelope.batch_reply = &reply;
    answer(up, &message, &envelope, NULL);
}

/* A scene that takes minutes does not keep the sums of another job back, and no byte of it comes twice. */
static void a_sum_does_not_wait_for_a_scene(void **state)
{
    test_t *t = *state;
    uplink_t up;
    wire_message_t requests[WINDOW];
    const unit_t units[] = {{0, 0, 4}, {1, 0, 4}};
    hash_t next = hash_bytes("next", 4);
    begin(t, units, 2);
    assert_int_equal(take(t, 0, t->ada, MUCH), 2);
    assign_job(t, JOB + 1, &next, 16 * CHUNK, units, 1);
    open_uplink(t, &up, PATIENCE);
    for (int i = 0; i < 2; i++) {
        hear_window(&up, (uint64_t)i * WINDOW * CHUNK, requests);
        assert_int_equal(render(t, t->ada, &units[i], 1).code, RESULT_OK);
        for (int k = 0; k < WINDOW; k++) answer_chunk(&up, &requests[k]);
        count_batch(&up);
    }
    hear_window(&up, (uint64_t)2 * WINDOW * CHUNK, requests);
    for (int k = 0; k < WINDOW; k++) wire_free(&requests[k]);
    close_uplink(&up);
}

/* What is not answered is asked on another connection, so it cannot fill the queue of one. */
static void requests_for_a_scene_do_not_pile_up(void **state)
{
    test_t *t = *state;
    uplink_t up;
    wire_message_t requests[WINDOW], earlier[WINDOW];
    const unit_t unit = {0, 0, 4};
    hash_t next = hash_bytes("next", 4);
    assign_job(t, JOB, &next, 16 * CHUNK, &unit, 1);
    open_uplink(t, &up, 0.5);
    hear_window(&up, 0, earlier);
    for (int i = 0; i < 3; i++) {
        hear_window(&up, 0, requests);
        assert_true(requests[0].identity_size != earlier[0].identity_size ||
                    memcmp(requests[0].identity, earlier[0].identity, earlier[0].identity_size) != 0);
        for (int k = 0; k < WINDOW; k++) wire_free(&earlier[k]);
        memcpy(earlier, requests, sizeof earlier);
    }
    for (int k = 0; k < WINDOW; k++) wire_free(&earlier[k]);
    assert_int_equal(t->handler.calls->state(t->handler.self).failure.code, RESULT_OK);
    close_uplink(&up);
}

/* ---- plans --------------------------------------------------------------------------------------------- */

static void units_are_lent_when_their_plan_is_here(void **state)
{
    test_t *t = *state;
    enum { PASS = 2 };
    const unit_t units[] = {{0, 4, 4}, {1, 2, 2}};
    t->settings.learn = true;
    size_t size = learning_plan_bytes();
    uint8_t *bytes = mem_alloc(size), *got = mem_alloc(size);
    int64_t *lessons = mem_zalloc(LEARNING_PLACES, sizeof *lessons);
    hash_t content = job_content_hash(&t->settings, &t->blob), plans[LEARNING_PASSES] = {{{0}}};
    learning_plan_write(PASS, lessons, &content, 0, bytes, size);
    plans[PASS] = hash_bytes(bytes, size);
    assign_by_plans(t, JOB, &t->blob, 4, units, 2, plans);
    duty_t duty = duty_of(t);
    assert_int_equal(duty.kind, DUTY_PLAN);
    assert_int_equal(duty.pass, PASS);
    assert_int_equal(duty_of(t).kind, DUTY_LOAD); /* they take turns */
    assert_int_equal(load(t, &t->blob).code, RESULT_OK);
    assert_int_equal(take(t, 0, t->ada, 1 << 20), 1);
    assert_int_equal(t->units[0].tile, 1);
    assert_true(hash_is_zero(&t->plans[PASS]));
    assert_int_equal(take(t, 0, t->bob, 1 << 20), 0);
    uint64_t there;
    assert_int_equal(t->serve.calls->blob_size(t->pool, &plans[PASS], &there).code, RESULT_INPUT);
    assert_int_equal(t->handler.calls->planned(t->handler.self, &duty.assignment, PASS, bytes, size - 1).code,
                     RESULT_INPUT);
    assert_int_equal(t->handler.calls->planned(t->handler.self, &duty.assignment, PASS + 1, bytes, size).code,
                     RESULT_MISMATCH);
    assert_int_equal(take(t, 0, t->bob, 1 << 20), 0);
    assert_int_equal(t->handler.calls->planned(t->handler.self, &duty.assignment, PASS, bytes, size).code,
                     RESULT_OK);
    assert_int_equal(take(t, 0, t->bob, 1 << 20), 1);
    assert_int_equal(t->units[0].tile, 0);
    assert_true(hash_equal(&t->plans[PASS], &plans[PASS]));
    assert_int_equal(t->serve.calls->blob_size(t->pool, &plans[PASS], &there).code, RESULT_OK);
    assert_int_equal(there, size);
    assert_int_equal(t->serve.calls->blob_read(t->pool, &plans[PASS], 3, got, size - 3).code, RESULT_OK);
    assert_memory_equal(got, bytes + 3, size - 3);
    assert_int_not_equal(duty_of(t).kind, DUTY_PLAN);
    free(lessons);
    free(bytes);
    free(got);
}

/* The master refuses a sum whole for what it would refuse of one worker. */
static void wild_lessons_stay_out_of_sums(void **state)
{
    test_t *t = *state;
    const unit_t unit = {0, 0, 2};
    t->settings.learn = true;
    begin(t, &unit, 1);
    assert_int_equal(take(t, 0, t->ada, 1 << 20), 1);
    batch_t batch = peer_render(&t->settings, &unit, 1);
    batch_frame(&batch, SUM_LESSONS)[LEARNING_PLACES + 7] = 1; /* of a pass that it has no unit of */
    result_t result = deliver(t, t->ada, &batch);
    assert_int_equal(result.code, RESULT_PROTOCOL);
    assert_non_null(strstr(result.message, "lesson"));
    assert_int_equal(duty_of(t).kind, DUTY_NONE);
    batch_frame(&batch, SUM_LESSONS)[LEARNING_PLACES + 7] = 0;
    batch_frame(&batch, SUM_LESSONS)[7] = 1;
    assert_int_equal(take(t, 0, t->ada, 1 << 20), 1); /* it went to whoever asks */
    assert_int_equal(deliver(t, t->ada, &batch).code, RESULT_OK);
    assert_int_equal(duty_of(t).kind, DUTY_OFFER);
    batch_free(&batch);
}

int main(void)
{
#define POOL(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        POOL(what_the_master_would_refuse_is_refused_here),
        POOL(a_scene_goes_to_the_job_that_it_is_of),
        POOL(who_is_made_to_wait_keeps_its_units),
        POOL(who_offers_what_is_not_wanted_loses_its_units),
        POOL(sums_of_one_job_keep_others_waiting),
        POOL(who_asks_for_nothing_gets_nothing),
        POOL(a_stranger_delivers_nothing),
        POOL(units_that_are_not_of_the_job_are_refused),
        POOL(what_was_not_issued_is_refused),
        POOL(a_sum_shows_how_its_units_were_issued),
        POOL(a_job_that_goes_on_at_once_goes_on_whole),
        POOL(sums_and_scenes_take_turns),
        POOL(a_sum_does_not_wait_for_a_scene),
        POOL(requests_for_a_scene_do_not_pile_up),
        POOL(units_are_lent_when_their_plan_is_here),
        POOL(wild_lessons_stay_out_of_sums),
    };
    return cmocka_run_group_tests_name("pool", tests, NULL, NULL);
}
