/* Tests of proto/serve/bulk_server.c on a farm with real sockets: what it does with batches while nothing can
 * be merged, because somebody reads the film. */
#include "master/state/state.h"
#include "master/threads/farm_service.h"
#include "proto/serve/bulk_server.h"
#include "tests/films.h"
#include "tests/peer.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cmocka.h>

enum { PEERS = 6 };
static const double PATIENCE = 20, MOMENT = 0.3; /* seconds: for what must come, and for what must not */

/* A worker with a socket; the farm is spoken to directly. */
typedef struct {
    void *socket;
    uint64_t worker, request;
    issue_t issues[WIRE_MAX_UNITS];
    batch_t batch;
} sender_t;

typedef struct {
    char *folder;
    void *context;
    int wake;
    farm_t *farm;
    blob_store_t *store;
    farm_service_t service;
    bulk_server_t *server;
    job_settings_t settings;
    uint64_t job;
    sender_t senders[PEERS];
} test_t;

static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

static int set_up(void **state)
{
    test_t *t = mem_zalloc(1, sizeof *t);
    *state = t;
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    t->context = zmq_ctx_new();
    t->wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    farm_options_t farm = {.lease = 60,
                           .batch_interval = 1,
                           .film_limit = (uint64_t)1 << 30,
                           .first_job = 1,
                           .control_wake = -1,
                           .image_wake = -1,
                           .journal_writer_wake = -1,
                           .news_wake = -1,
                           .checkpoint_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC),
                           .grant_wake = t->wake};
    t->farm = farm_new(&farm);
    char *blobs = scratch_path(t->folder, "blobs");
    must(blob_store_open(&(blob_store_options_t){.directory = blobs, .limit = 1 << 20}, &t->store));
    free(blobs);
    t->service = (farm_service_t){t->farm, t->store};
    server_options_t options = {.bulk_wake = t->wake,
                                .batch_memory = 1, /* so two of the largest batches */
                                .merge_threads = 2};
    served_socket_t bulk = {.handler = farm_service_handler(&t->service)};
    must(wire_socket(t->context, ZMQ_ROUTER, &bulk.socket));
    assert_int_equal(zmq_bind(bulk.socket, "inproc://bulk"), 0);
    must(bulk_server_start(&options, &bulk, &t->server));
    t->settings = job_settings_default();
    t->settings.width = 400;
    t->settings.height = 300;
    t->settings.features = false;
    t->settings.spp = 100;
    t->settings.learn = false; /* so that units may be any samples */
    return 0;
}

static int tear_down(void **state)
{
    test_t *t = *state;
    for (int i = 0; i < PEERS; i++) {
        if (t->senders[i].socket != NULL) zmq_close(t->senders[i].socket);
        batch_free(&t->senders[i].batch);
    }
    bulk_server_stop(&t->server);
    assert_null(t->server);
    close(t->farm->options.checkpoint_wake);
    farm_destroy(&t->farm);
    blob_store_close(&t->store);
    zmq_ctx_term(t->context);
    close(t->wake);
    scratch_destroy(&t->folder);
    free(t);
    return 0;
}

/* ---- senders ------------------------------------------------------------------------------------------- */

static void hello(test_t *t, sender_t *sender)
{
    static const identity_t nobody = {{0}, 0};
    worker_hello_t said = {.name = "w", .key = "", .threads = 1};
    must(farm_hello(t->farm, clock_now(), &nobody, &said, &sender->worker));
    must(farm_worker_reached(t->farm, clock_now(), sender->worker));
    must(wire_socket(t->context, ZMQ_DEALER, &sender->socket));
    assert_int_equal(zmq_connect(sender->socket, "inproc://bulk"), 0);
}

/* Takes some units, and renders them. */
static void work(test_t *t, sender_t *sender)
{
    static const identity_t nobody = {{0}, 0};
    unit_t *units = mem_alloc(WIRE_MAX_UNITS * sizeof *units);
    work_t work = {.units = units, .issues = sender->issues};
    must(farm_take(t->farm, clock_now(), &nobody, sender->worker, 0, 10000, 5000, &work));
    assert_int_equal(work.job, t->job);
    assert_true(work.unit_count > 0);
    sender->batch = peer_render(&t->settings, units, work.unit_count);
    free(units);
}

static void start_job(test_t *t)
{
    job_terms_t terms = {.name = "test"};
    hash_t blob = {{0}};
    must(farm_submit(t->farm, clock_now(), &terms, &t->settings, &blob, 1, &t->job));
    for (int i = 0; i < PEERS; i++) {
        hello(t, &t->senders[i]);
        work(t, &t->senders[i]);
    }
}

static void offer(const test_t *t, sender_t *sender, uint64_t bytes)
{
    Lm__BatchOffer body = LM__BATCH_OFFER__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    body.worker = sender->worker;
    body.job = t->job;
    body.bytes = bytes;
    hash_t blob = {{0}}, content = job_content_hash(&t->settings, &blob);
    body.content = wire_hash_put(&content);
    envelope.request = ++sender->request;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_OFFER;
    envelope.batch_offer = &body;
    must(wire_send(sender->socket, NULL, 0, &envelope, NULL, 0));
}

/* Sends the batch; returns its bytes. */
static size_t send_batch(const test_t *t, sender_t *sender)
{
    Lm__BatchResult body = LM__BATCH_RESULT__INIT;
    Lm__Counts counts = LM__COUNTS__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    zmq_msg_t payload[BATCH_PAYLOADS];
    size_t bytes = 0;
    must(encode_either(&sender->batch, false, payload));
    for (int i = 0; i < BATCH_PAYLOADS; i++) bytes += zmq_msg_size(&payload[i]);
    wire_counts_put(&sender->batch.counts, &counts);
    body.worker = sender->worker;
    body.job = t->job;
    body.sequence = 77;
    body.units = wire_units_new(sender->batch.units, sender->issues, sender->batch.unit_count);
    body.n_units = sender->batch.unit_count;
    body.counts = &counts;
    envelope.request = ++sender->request;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
    envelope.batch_result = &body;
    must(wire_send(sender->socket, NULL, 0, &envelope, payload, BATCH_PAYLOADS));
    free(body.units);
    return bytes;
}

/* The kind of the next answer to the last request, and a refusal's code; 0: none came. A batch must be
 * merged, or refused for this reason. */
static int answer_to(sender_t *sender, double seconds, uint32_t *code, const char *reason)
{
    double deadline = clock_now() + seconds;
    do {
        wire_message_t message;
        bool received;
        must(wire_receive(sender->socket, false, &message, &received));
        if (!received) {
            usleep(2000);
            continue;
        }
        int kind = (int)message.envelope->body_case;
        assert_true(message.envelope->request == sender->request);
        *code = kind == LM__ENVELOPE__BODY_REFUSAL ? message.envelope->refusal->code : 0;
        if (kind == LM__ENVELOPE__BODY_BATCH_REPLY) {
            const Lm__BatchReply *reply = message.envelope->batch_reply;
            if (reply->accepted != (reason == NULL) ||
                (reason != NULL && strstr(reply->reason, reason) == NULL))
                fail_msg("%s", reply->reason);
            assert_int_equal(message.envelope->batch_reply->sequence, 77);
        }
        wire_free(&message);
        return kind;
    } while (clock_now() < deadline);
    return 0;
}

static int answer(sender_t *sender, double seconds, uint32_t *code)
{
    return answer_to(sender, seconds, code, NULL);
}

static void assert_not_merged(sender_t *sender, const char *reason)
{
    uint32_t code;
    assert_int_equal(answer_to(sender, PATIENCE, &code, reason), LM__ENVELOPE__BODY_BATCH_REPLY);
}

static void assert_granted(sender_t *sender)
{
    uint32_t code;
    assert_int_equal(answer(sender, PATIENCE, &code), LM__ENVELOPE__BODY_BATCH_GRANT);
}

static void assert_merged(sender_t *sender)
{
    uint32_t code;
    assert_int_equal(answer(sender, PATIENCE, &code), LM__ENVELOPE__BODY_BATCH_REPLY);
}

static void assert_no_answer(sender_t *sender)
{
    uint32_t code;
    assert_int_equal(answer(sender, MOMENT, &code), 0);
}

static void assert_refused(sender_t *sender, result_code_t expected)
{
    uint32_t code;
    assert_int_equal(answer(sender, PATIENCE, &code), LM__ENVELOPE__BODY_REFUSAL);
    assert_int_equal(code, expected);
}

static job_t *find_job(test_t *t)
{
    farm_lock(t->farm);
    job_t *job = farm_find_job(t->farm, t->job);
    farm_unlock(t->farm);
    return job;
}

static job_state_t state_of(test_t *t)
{
    farm_lock(t->farm);
    job_state_t state = farm_find_job(t->farm, t->job)->kept.state;
    farm_unlock(t->farm);
    return state;
}

/* As if the units of its batch had been issued to the sender by an earlier process. */
static void issue(test_t *t, sender_t *sender)
{
    toy_issue(t->farm, sender->worker, t->job, 0, sender->batch.units, sender->batch.unit_count,
              sender->issues);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void batches_wait_at_the_workers_while_nothing_is_merged(void **state)
{
    test_t *t = *state;
    start_job(t);
    sender_t *s = t->senders;
    shared_film_t *shared_film = job_film_hold(t->farm, find_job(t));
    shared_film_lock(shared_film); /* somebody writes an image for ever */
    uint64_t bytes = sum_image_values(&t->settings, SUM_SPLAT) * sizeof(int64_t) * 5 / 4;
    for (int i = 0; i < 5; i++) {
        offer(t, &s[i], bytes);
        if (i < 2) assert_granted(&s[i]);
    }
    assert_no_answer(&s[2]);
    for (int i = 0; i < 2; i++) {
        assert_true(send_batch(t, &s[i]) <= bytes);
        assert_no_answer(&s[i]);
    }
    send_batch(t, &s[5]); /* without having asked */
    assert_refused(&s[5], RESULT_LIMIT);
    assert_no_answer(&s[3]);
    zmq_close(s[2].socket); /* whose turn would be next */
    s[2].socket = NULL;
    job_report_t *report;
    size_t count;
    uint32_t workers;
    report = farm_report(t->farm, clock_now(), t->job, &count, &workers); /* the farm answers meanwhile */
    assert_int_equal(report->record.batches, 0);
    free(report);
    shared_film_unlock(shared_film);
    assert_merged(&s[0]);
    assert_merged(&s[1]);
    for (int i = 3; i < 5; i++) {
        assert_granted(&s[i]);
        send_batch(t, &s[i]);
        assert_merged(&s[i]);
    }
    send_batch(t, &s[5]); /* now there is room for it */
    assert_merged(&s[5]);
    /* Nothing is missing or doubled. */
    film_t *film;
    must(film_new(&t->settings, &film));
    for (int i = 0; i < PEERS; i++)
        if (i != 2) merge_plainly(film, &s[i].batch);
    const film_t *merged = shared_film_lock(shared_film);
    for (size_t i = 0; i < shared_film_page_count(&t->settings); i++) {
        size_t size;
        const void *page = shared_film_page(film, i, &size);
        assert_memory_equal(page, shared_film_page(merged, i, &size), size);
    }
    shared_film_unlock(shared_film);
    film_destroy(&film);
    job_film_let_go(t->farm, find_job(t));
}

static void offers_that_are_not_wanted_are_refused(void **state)
{
    test_t *t = *state;
    start_job(t);
    sender_t *s = t->senders;
    t->job++;
    offer(t, &s[0], 1000);
    assert_refused(&s[0], RESULT_INPUT);
    t->job--;
    uint64_t known = s[1].worker;
    s[1].worker = 12345;
    offer(t, &s[1], 1000);
    assert_refused(&s[1], RESULT_UNREACHABLE);
    s[1].worker = known;
    offer(t, &s[1], 1000);
    assert_granted(&s[1]);
    must(farm_order(t->farm, clock_now(), &(job_order_t){.job = t->job, .kind = ORDER_CANCEL}));
    for (int i = 0; i < PEERS; i++) farm_goodbye(t->farm, clock_now(), s[i].worker, 0, "");
    offer(t, &s[2], 1000);
    assert_refused(&s[2], RESULT_CANCELLED);
}

/* A job that waits in the queue does not begin for an offer, nor for a batch of units that nobody was given.
 */
static void only_who_was_given_units_begins_a_job(void **state)
{
    test_t *t = *state;
    job_terms_t terms = {.name = "waits"};
    hash_t blob = {{0}};
    must(farm_submit(t->farm, clock_now(), &terms, &t->settings, &blob, 1, &t->job));
    sender_t *s = t->senders;
    const unit_t unit = {3, 0, 4};
    for (int i = 0; i < 2; i++) {
        hello(t, &s[i]);
        s[i].batch = peer_render(&t->settings, &unit, 1);
        if (i == 1) issue(t, &s[i]);
        offer(t, &s[i], 1000);
        assert_granted(&s[i]);
        assert_int_equal(state_of(t), JOB_QUEUED);
        send_batch(t, &s[i]);
        if (i == 0)
            assert_not_merged(&s[i], "not issued");
        else
            assert_merged(&s[i]);
        assert_int_equal(state_of(t), i == 0 ? JOB_QUEUED : JOB_RUNNING);
    }
}

/* A worker had a batch when the master ended; the film is loaded while it waits. */
static void an_offer_waits_for_the_film_of_its_job(void **state)
{
    test_t *t = *state;
    job_record_t record = {.job = 5,
                           .settings = t->settings,
                           .terms = {.name = "test"},
                           .state = JOB_RUNNING,
                           .elapsed = 10,
                           .batches = 1};
    sender_t *s = t->senders;
    farm_restore(t->farm, clock_now(), &record);
    t->job = 5;
    hello(t, &s[0]);
    offer(t, &s[0], 1000);
    assert_no_answer(&s[0]);
    job_t *job = farm_next_load(t->farm);
    assert_non_null(job);
    must(farm_loaded(t->farm, clock_now(), job, NULL, NULL)); /* there was no checkpoint */
    farm_unpin(t->farm, job);
    assert_granted(&s[0]);
    const unit_t units[] = {{3, 0, 4}, {7, 4, 4}};
    s[0].batch = peer_render(&t->settings, units, 2);
    issue(t, &s[0]);
    send_batch(t, &s[0]);
    assert_merged(&s[0]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(batches_wait_at_the_workers_while_nothing_is_merged, set_up,
                                        tear_down),
        cmocka_unit_test_setup_teardown(offers_that_are_not_wanted_are_refused, set_up, tear_down),
        cmocka_unit_test_setup_teardown(only_who_was_given_units_begins_a_job, set_up, tear_down),
        cmocka_unit_test_setup_teardown(an_offer_waits_for_the_film_of_its_job, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("bulk", tests, NULL, NULL);
}
