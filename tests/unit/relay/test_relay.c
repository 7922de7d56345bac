/* Tests of the relay as its master and its workers see it: a real relay and real workers in this process, and
 * a master that does as the test says (tests/scripted.h). */
#include "relay/relay.h"
#include "tests/films.h"
#include "tests/render_here.h"
#include "tests/scratch.h"
#include "tests/scripted.h"
#include "worker/worker.h"

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { JOB = 3, WORKERS = 2 };
static const double PATIENCE = 60; /* seconds for anything */

/* A relay or a worker in a thread of its own. */
typedef struct {
    relay_options_t relay;
    worker_options_t worker;
    bool is_relay, running;
    atomic_int stop, port;
    pthread_t thread;
    result_t outcome;
} runner_t;

typedef struct {
    char *folder;
    test_scene_t scene;
    scripted_t *script;
    char *endpoint, *below, *data, *caches[WORKERS];
    runner_t relay, workers[WORKERS];
} fixture_t;

static void *run_in_thread(void *argument)
{
    runner_t *runner = argument;
    runner->outcome = runner->is_relay ? relay_run(&runner->relay, &runner->stop, &runner->port)
                                       : worker_run(&runner->worker, &runner->stop);
    return NULL;
}

static void start(runner_t *runner)
{
    assert_int_equal(pthread_create(&runner->thread, NULL, run_in_thread, runner), 0);
    runner->running = true;
}

static result_t join(runner_t *runner)
{
    if (runner->running) pthread_join(runner->thread, NULL);
    runner->running = false;
    return runner->outcome;
}

static int set_up(void **state)
{
    fixture_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    t->data = scratch_path(t->folder, "relay");
    t->scene = test_scene_begin((vec3_t){0, 0, -0.9f}, 60, 64);
    blob_material_t diffuse = {.kind = MATERIAL_DIFFUSE};
    diffuse.values[VALUE_REFLECTANCE] = blob_constant(0.5f);
    uint32_t grey = test_scene_material(&t->scene, diffuse);
    test_scene_room(&t->scene, (vec3_t){-1, -1, -1}, (vec3_t){1, 1, 1}, grey, (rgb_t){0.2f, 0.2f, 0.2f});
    test_scene_finish(&t->scene);
    job_settings_t settings = blob_default_settings(&t->scene.blob);
    settings.learn = false; /* its units are of any samples */
    settings.spp = 1 << 20;
    settings.tile_size = 32;
    settings.max_depth = 3;
    t->script = scripted_new(&t->scene.blob, &settings);
    t->endpoint = scripted_endpoint(t->script);
    t->relay.is_relay = true;
    t->relay.relay = relay_options_default();
    t->relay.relay.master_endpoint = t->endpoint;
    t->relay.relay.control_endpoint = t->relay.relay.bulk_endpoint = "tcp://127.0.0.1:*";
    t->relay.relay.data_dir = t->data;
    t->relay.relay.heartbeat = 0.1;
    t->relay.relay.lease = 2;
    t->relay.relay.batch_interval = 0.1;
    t->relay.relay.name = "the relay";
    t->relay.relay.grace = PATIENCE;
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    fixture_t *t = *state;
    for (int i = 0; i < WORKERS; i++) {
        atomic_store(&t->workers[i].stop, 2);
        join(&t->workers[i]);
        free(t->caches[i]);
    }
    atomic_store(&t->relay.stop, 2);
    join(&t->relay);
    scripted_destroy(&t->script);
    test_scene_end(&t->scene);
    scratch_destroy(&t->folder);
    free(t->endpoint);
    free(t->below);
    free(t->data);
    free(t);
    return 0;
}

static void start_relay(fixture_t *t)
{
    start(&t->relay);
    scripted_run(t->script, atomic_load(&t->relay.port) > 0, PATIENCE);
    t->below = mem_printf("tcp://127.0.0.1:%d", atomic_load(&t->relay.port));
}

static void start_worker(fixture_t *t, int i)
{
    runner_t *runner = &t->workers[i];
    t->caches[i] = mem_printf("%s/cache-%d", t->folder, i);
    runner->worker = worker_options_default();
    runner->worker.control_endpoint = t->below;
    runner->worker.cache_dir = t->caches[i];
    runner->worker.threads = 1;
    runner->worker.grace = PATIENCE;
    start(runner);
}

/* What these units make, bit for bit, is what came. */
static void assert_renders(fixture_t *t, const scripted_batch_t *came)
{
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    batch_t again;
    batch_init(&again, &t->script->settings);
    assert_int_equal(renderer_new(&t->scene.blob, &t->script->settings, &renderer).code, RESULT_OK);
    for (size_t i = 0; i < came->batch.unit_count; i++) {
        assert_true(renderer_unit(renderer, &came->batch.units[i], &result, &cancel));
        batch_add(&again, &result);
    }
    assert_true(same_sums(&again, &came->batch));
    for (int half = 0; half < 2; half++)
        assert_true(again.counts.light_paths[half] == came->batch.counts.light_paths[half]);
    assert_true(again.counts.rays == came->batch.counts.rays);
    batch_free(&again);
    unit_result_free(&result);
    renderer_destroy(&renderer);
}

/* Every sample of these units has come once. */
static void assert_delivered(fixture_t *t, const unit_t *units, size_t count)
{
    for (uint32_t tile = 0; tile < 4; tile++) {
        uint32_t samples = 0;
        for (size_t i = 0; i < count; i++)
            if (units[i].tile == tile) samples += units[i].count;
        assert_int_equal(scripted_samples(t->script, tile), samples);
    }
    for (int i = 0; i < t->script->batch_count; i++) assert_renders(t, &t->script->batches[i]);
}

static size_t delivered_units(const scripted_t *s)
{
    size_t units = 0;
    for (int i = 0; i < s->batch_count; i++) units += s->batches[i].batch.unit_count;
    return units;
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void a_relay_without_workers_stays_away(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    start_relay(t);
    scripted_sleep(s, 0.5);
    assert_int_equal(s->hellos, 0);
    start_worker(t, 0);
    scripted_run(s, s->hellos == 1 && s->heartbeats > 0, PATIENCE);
    assert_true(s->hello->relay);
    assert_string_equal(s->hello->name, "the relay");
    assert_int_equal(s->hello->fingerprint.len, HASH_BYTES);
    start_worker(t, 1);
    scripted_run(s, s->heartbeat_threads == 2, PATIENCE);
    /* And goes when they go. */
    for (int i = 0; i < WORKERS; i++) atomic_store(&t->workers[i].stop, 1);
    scripted_run(s, s->goodbyes == 1, PATIENCE);
    for (int i = 0; i < WORKERS; i++) assert_int_equal(join(&t->workers[i]).code, RESULT_OK);
}

static void batches_become_one(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    unit_t units[16];
    for (uint32_t i = 0; i < 16; i++) units[i] = (unit_t){i % 4, 8 * (i / 4), 8};
    s->granting = false;
    s->batch_interval = 0.2;
    scripted_assign(s, JOB, 0, units, 16);
    start_relay(t);
    start_worker(t, 0);
    start_worker(t, 1);
    scripted_run(s, s->offers > 0, PATIENCE);
    scripted_sleep(s, 2); /* the sum grows as long as it is not granted */
    assert_int_equal(s->batch_count, 0);
    s->granting = true;
    scripted_grant(s);
    scripted_run(s, delivered_units(s) == 16, PATIENCE);
    assert_int_equal(s->batches[0].worker, s->worker);
    assert_delivered(t, units, 16);
}

static void a_check_passes_through(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t ordinary[] = {{0, 0, 8}, {1, 0, 8}, {2, 0, 8}}, checked[] = {{3, 0, 4}, {2, 8, 2}};
    s->batch_interval = 1000;
    scripted_assign(s, JOB, 0, ordinary, 3);
    start_relay(t);
    start_worker(t, 0);
    start_worker(t, 1);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_assign(s, JOB, 55, checked, 2);
    scripted_run(s, s->batch_count > 0 && s->batches[s->batch_count - 1].check == 55, PATIENCE);
    const scripted_batch_t *came = &s->batches[s->batch_count - 1];
    assert_int_equal(came->batch.unit_count, 2);
    assert_memory_equal(came->batch.units, checked, sizeof checked);
    assert_renders(t, came);
}

static void sums_outlive_the_master(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t units[] = {{0, 0, 8}, {1, 0, 8}, {2, 0, 8}}, again[] = {{0, 0, 8}, {3, 0, 8}};
    s->granting = false;
    scripted_assign(s, JOB, 0, units, 3);
    start_relay(t);
    start_worker(t, 0);
    scripted_run(s, s->offers > 0, PATIENCE);
    scripted_sleep(s, 1);
    scripted_restart(s, 0.5);
    scripted_assign(s, JOB, 0, again, 2);
    scripted_grant_when_taken(s, PATIENCE);
    scripted_run(s, scripted_samples(s, 3) == 8 && delivered_units(s) == 4, PATIENCE);
    assert_int_equal(s->kept_count, 3);
    const unit_t all[] = {{0, 0, 8}, {1, 0, 8}, {2, 0, 8}, {3, 0, 8}};
    assert_delivered(t, all, 4);
}

static void a_refused_sum_may_be_asked_for_again(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t unit = {0, 0, 8};
    s->counting = false;
    scripted_assign(s, JOB, 0, &unit, 1);
    start_relay(t);
    start_worker(t, 0);
    scripted_run(s, s->batch_count == 1, PATIENCE);
    s->counting = true;
    scripted_assign(s, JOB, 0, &unit, 1);
    scripted_run(s, s->batch_count == 2, PATIENCE);
    assert_renders(t, &s->batches[1]);
}

static void a_job_that_is_over_is_over_below(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    unit_t units[8];
    for (uint32_t i = 0; i < 8; i++) units[i] = (unit_t){i % 4, 4096 * (i / 4), 4096};
    scripted_assign(s, JOB, 0, units, 8);
    start_relay(t);
    start_worker(t, 0);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_job_over(s, JOB, false);
    const unit_t next = {1, 0, 4};
    scripted_assign(s, JOB + 1, 0, &next, 1);
    scripted_run(s, s->batch_count > 0 && s->batches[s->batch_count - 1].job == JOB + 1, PATIENCE);
    assert_int_equal(s->batches[s->batch_count - 1].batch.unit_count, 1);
    assert_renders(t, &s->batches[s->batch_count - 1]);
}

static void a_flush_calls_everything_in(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    unit_t units[12];
    for (uint32_t i = 0; i < 12; i++) units[i] = (unit_t){i % 4, 4 * (i / 4), 4};
    s->batch_interval = 1000;
    t->relay.relay.batch_interval = 1000;
    scripted_assign(s, JOB, 0, units, 12);
    start_relay(t);
    start_worker(t, 0);
    start_worker(t, 1);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_sleep(s, 1);
    scripted_job_over(s, JOB, true);
    scripted_run(s, s->batch_count > 0, PATIENCE);
    assert_true(delivered_units(s) > 0);
    for (int i = 0; i < s->batch_count; i++) assert_renders(t, &s->batches[i]);
}

static void a_relay_that_leaves_delivers_and_says_goodbye(void **state)
{
    fixture_t *t = *state;
    scripted_t *s = t->script;
    const unit_t units[] = {{0, 0, 8}, {1, 0, 8}, {2, 0, 8}};
    s->batch_interval = 1000;
    scripted_assign(s, JOB, 0, units, 3);
    start_relay(t);
    start_worker(t, 0);
    scripted_run(s, s->unit_count == 0, PATIENCE);
    scripted_sleep(s, 1);
    atomic_store(&t->relay.stop, 1);
    scripted_run(s, s->goodbyes == 1, PATIENCE);
    assert_int_equal(join(&t->relay).code, RESULT_OK);
    for (int i = 0; i < s->batch_count; i++) assert_renders(t, &s->batches[i]);
}

/* ---- a worker of another kind, by hand ------------------------------------------------------------------
 */

/* Says one thing to the relay and returns its answer; the caller frees it. */
static wire_message_t say(fixture_t *t, void *socket, Lm__Envelope *envelope)
{
    wire_message_t message;
    bool received = false;
    envelope->request = 1;
    assert_int_equal(wire_send(socket, NULL, 0, envelope, NULL, 0).code, RESULT_OK);
    for (double start_time = clock_now(); !received;) {
        scripted_step(t->script);
        assert_int_equal(wire_receive(socket, false, &message, &received).code, RESULT_OK);
        if (clock_now() - start_time > PATIENCE) fail_msg("the relay does not answer");
    }
    return message;
}

static void machines_of_other_bits_are_refused(void **state)
{
    fixture_t *t = *state;
    void *context = zmq_ctx_new(), *socket;
    hash_t strange = {{1, 2, 3}};
    start_relay(t);
    start_worker(t, 0);
    scripted_run(t->script, t->script->hellos == 1, PATIENCE);
    assert_int_equal(wire_socket(context, ZMQ_DEALER, &socket).code, RESULT_OK);
    assert_int_equal(zmq_connect(socket, t->below), 0);
    Lm__Hello hello = LM__HELLO__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    hello.protocol_version = WIRE_VERSION;
    hello.name = "stranger";
    hello.fingerprint = wire_hash_put(&strange);
    envelope.body_case = LM__ENVELOPE__BODY_HELLO;
    envelope.hello = &hello;
    wire_message_t answer = say(t, socket, &envelope);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_REFUSAL);
    assert_int_equal(answer.envelope->refusal->code, RESULT_MISMATCH);
    assert_non_null(strstr(answer.envelope->refusal->reason, "01020300"));
    wire_free(&answer);
    /* Nor are clients served. */
    Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_JOB_STATUS_REQUEST;
    envelope.job_status_request = &request;
    answer = say(t, socket, &envelope);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_REFUSAL);
    assert_non_null(strstr(answer.envelope->refusal->reason, t->endpoint));
    wire_free(&answer);
    zmq_close(socket);
    zmq_ctx_term(context);
}

int main(void)
{
#define WITH_FIXTURE(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        WITH_FIXTURE(a_relay_without_workers_stays_away),
        WITH_FIXTURE(batches_become_one),
        WITH_FIXTURE(a_check_passes_through),
        WITH_FIXTURE(sums_outlive_the_master),
        WITH_FIXTURE(a_refused_sum_may_be_asked_for_again),
        WITH_FIXTURE(a_job_that_is_over_is_over_below),
        WITH_FIXTURE(a_flush_calls_everything_in),
        WITH_FIXTURE(a_relay_that_leaves_delivers_and_says_goodbye),
        WITH_FIXTURE(machines_of_other_bits_are_refused),
    };
    return cmocka_run_group_tests_name("relay", tests, NULL, NULL);
}
