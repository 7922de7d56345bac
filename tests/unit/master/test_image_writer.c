/* Images that clients fetch: who shares one, what is told of it while it is made, what becomes of it when
 * nobody waits, and how much room they take. Farm, image writer, bulk server and clients are real and speak
 * over sockets. An image takes as long as the test wants, which keeps the film locked and moves the clock. */
#include "client/farm/remote.h"
#include "common/thread.h"
#include "common/wake.h"
#include "master/state/state.h"
#include "master/threads/client_bulk.h"
#include "master/threads/farm_service.h"
#include "proto/serve/bulk_server.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { CLIENTS = 3 };

static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

/* ---- the clock of this process ------------------------------------------------------------------------- */

static atomic_long ahead; /* seconds */

int clock_gettime(clockid_t clock, struct timespec *time)
{
    int code = (int)syscall(SYS_clock_gettime, clock, time);
    if (clock == CLOCK_MONOTONIC) time->tv_sec += atomic_load(&ahead);
    return code;
}

static void pass(long seconds)
{
    atomic_fetch_add(&ahead, seconds);
}

/* ---- what is tested ------------------------------------------------------------------------------------ */

typedef struct test test_t;

/* A client that fetches an image, on a thread of its own. */
typedef struct {
    test_t *test;
    pthread_t thread;
    uint64_t job;
    atomic_int told;    /* how often it was told how the image gets on, */
    atomic_uint before; /* and what, the last time */
    atomic_uint percent;
    atomic_bool done;
    result_t result;
    hash_t hash;
    size_t size;
} client_t;

struct test {
    char *folder, *snapshots;
    void *context;
    int bulk_wake, image_wake;
    farm_t *farm;
    farm_service_t service;
    client_bulk_t client_bulk;
    bulk_server_t *server;
    image_writer_t *image_writer;
    shared_film_t *locked; /* by hold; NULL: nothing is */
    void *raw[2];          /* sockets of clients that will not wait */
    int raw_count;
    client_t clients[CLIENTS];
};

static void start_serving(test_t *t, uint64_t limit)
{
    image_writer_options_t writer = {.farm = t->farm,
                                     .data_dir = t->folder,
                                     .image_wake = t->image_wake,
                                     .answer_wake = t->bulk_wake,
                                     .snapshot_limit = limit};
    must(image_writer_start(&writer, &t->image_writer));
    t->client_bulk = (client_bulk_t){.image_writer = t->image_writer};
    server_options_t options = {.bulk_wake = t->bulk_wake, .merge_threads = 1};
    served_socket_t bulk = {.handler = farm_service_handler(&t->service),
                            .more = client_bulk_table(&t->client_bulk)};
    must(wire_socket(t->context, ZMQ_ROUTER, &bulk.socket));
    assert_int_equal(zmq_bind(bulk.socket, "inproc://bulk"), 0);
    must(bulk_server_start(&options, &bulk, &t->server));
}

static int set_up(void **state)
{
    test_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    t->snapshots = scratch_path(t->folder, "snapshots");
    t->context = zmq_ctx_new();
    must(wake_new(&t->bulk_wake));
    must(wake_new(&t->image_wake));
    farm_options_t farm = {.lease = 1e6,
                           .batch_interval = 1,
                           .film_limit = (uint64_t)1 << 30,
                           .first_job = 1,
                           .control_wake = -1,
                           .image_wake = t->image_wake,
                           .journal_writer_wake = -1,
                           .news_wake = -1,
                           .checkpoint_wake = -1,
                           .grant_wake = t->bulk_wake};
    t->farm = farm_new(&farm);
    t->service = (farm_service_t){.farm = t->farm};
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    test_t *t = *state;
    if (t->locked != NULL) shared_film_unlock(t->locked); /* the test has failed */
    for (int i = 0; i < t->raw_count; i++) zmq_close(t->raw[i]);
    bulk_server_stop(&t->server);
    image_writer_stop(&t->image_writer);
    farm_destroy(&t->farm);
    zmq_ctx_term(t->context);
    wake_close(t->bulk_wake);
    wake_close(t->image_wake);
    free(t->snapshots);
    scratch_destroy(&t->folder);
    free(t);
    return 0;
}

/* A job of which something is counted. */
static uint64_t begin_job(test_t *t)
{
    job_settings_t settings = toy_settings();
    settings.spp = 1 << 20;
    return toy_submit(t->farm, clock_now(), &settings, 0);
}

/* Counts one batch more, of the only job that is not paused. */
static void count_batch(test_t *t)
{
    uint64_t worker = toy_hello(t->farm, clock_now(), 1);
    toy_work_t work = toy_take(t->farm, clock_now(), worker, 1, 1);
    must(toy_deliver_work(t->farm, clock_now(), worker, &work, 0));
}

/* Nothing is read from the film of a job until let_go. */
static void hold(test_t *t, uint64_t job)
{
    farm_lock(t->farm);
    job_t *found = farm_find_job(t->farm, job);
    farm_unlock(t->farm);
    t->locked = job_film_hold(t->farm, found);
    shared_film_lock(t->locked);
}

static void let_go(test_t *t, uint64_t job)
{
    shared_film_unlock(t->locked);
    t->locked = NULL;
    farm_lock(t->farm);
    job_t *found = farm_find_job(t->farm, job);
    farm_unlock(t->farm);
    job_film_let_go(t->farm, found);
}

/* ---- clients ------------------------------------------------------------------------------------------- */

static void note_making(void *context, uint32_t before, double share)
{
    client_t *client = context;
    atomic_store(&client->before, before);
    atomic_store(&client->percent, (unsigned)(100 * share));
    atomic_fetch_add(&client->told, 1);
}

static void *fetch(void *argument)
{
    client_t *client = argument;
    remote_t *remote;
    uint8_t *bytes = NULL;
    void *context = client->test->context;
    const image_wish_t wish = {.job = client->job, .making = note_making, .context = client};
    client->result = remote_open(context, "inproc://control", "inproc://bulk", 5, &remote);
    if (client->result.code == RESULT_OK)
        client->result = remote_fetch_image(remote, &wish, &bytes, &client->size);
    if (client->result.code == RESULT_OK) client->hash = hash_bytes(bytes, client->size);
    free(bytes);
    remote_close(&remote);
    atomic_store(&client->done, true);
    return NULL;
}

static client_t *start_fetch(test_t *t, int number, uint64_t job)
{
    client_t *client = &t->clients[number];
    *client = (client_t){.test = t, .job = job};
    must(thread_start(&client->thread, "client", fetch, client));
    return client;
}

static void end_fetch(client_t *client)
{
    pthread_join(client->thread, NULL);
    must(client->result);
}

static void fetch_once(test_t *t, int number, uint64_t job)
{
    end_fetch(start_fetch(t, number, job));
}

/* Waits until the client was told once more. */
static void await_news(client_t *client)
{
    int told = atomic_load(&client->told);
    for (int i = 0; i < 6000 && atomic_load(&client->told) == told; i++) usleep(5000);
    assert_true(atomic_load(&client->told) > told);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

/* Longer than a client waits for a master that says nothing. */
static void a_fetch_waits_as_long_as_the_master_gets_on(void **state)
{
    test_t *t = *state;
    start_serving(t, 0);
    uint64_t job = begin_job(t);
    count_batch(t);
    hold(t, job);
    client_t *client = start_fetch(t, 0, job);
    for (int i = 0; i < 6; i++) {
        await_news(client);
        assert_false(atomic_load(&client->done));
        pass(50);
    }
    assert_int_equal(atomic_load(&client->before), 0);
    let_go(t, job);
    end_fetch(client);
    assert_true(client->size > 1000);
}

/* What comes while it is made, and shortly after, gets the same, although more was counted. */
static void who_asks_at_the_same_time_gets_the_same_image(void **state)
{
    test_t *t = *state;
    start_serving(t, 0);
    uint64_t job = begin_job(t);
    count_batch(t);
    hold(t, job);
    client_t *first = start_fetch(t, 0, job);
    await_news(first);
    client_t *second = start_fetch(t, 1, job);
    await_news(second);
    assert_int_equal(atomic_load(&second->before), 0); /* it is its own that is being made */
    pass(20);
    let_go(t, job);
    end_fetch(first);
    count_batch(t);
    end_fetch(second);
    fetch_once(t, 2, job);
    assert_true(hash_equal(&first->hash, &second->hash));
    assert_true(hash_equal(&first->hash, &t->clients[2].hash));
    assert_int_equal(scratch_count(t->snapshots), 1);
    pass(30); /* it took 20 s: it is too old now */
    fetch_once(t, 2, job);
    assert_false(hash_equal(&first->hash, &t->clients[2].hash));
    pass(SNAPSHOTS_KEEP + 1);
    for (int i = 0; i < 1000 && scratch_count(t->snapshots) > 0; i++) usleep(5000);
    assert_int_equal(scratch_count(t->snapshots), 0);
}

/* What takes no time shows what was counted before it was asked for. */
static void a_small_image_is_made_anew_when_something_was_counted(void **state)
{
    test_t *t = *state;
    start_serving(t, 0);
    uint64_t job = begin_job(t);
    count_batch(t);
    fetch_once(t, 0, job);
    fetch_once(t, 1, job);
    count_batch(t);
    fetch_once(t, 2, job);
    assert_true(hash_equal(&t->clients[0].hash, &t->clients[1].hash));
    assert_false(hash_equal(&t->clients[0].hash, &t->clients[2].hash));
}

static void who_waits_is_told_how_many_are_before(void **state)
{
    test_t *t = *state;
    start_serving(t, 0);
    uint64_t job = begin_job(t);
    count_batch(t);
    must(toy_order(t->farm, clock_now(), job, ORDER_PAUSE));
    uint64_t other = begin_job(t);
    count_batch(t);
    hold(t, job);
    client_t *first = start_fetch(t, 0, job);
    await_news(first);
    client_t *second = start_fetch(t, 1, other);
    await_news(second);
    assert_int_equal(atomic_load(&second->before), 1);
    let_go(t, job);
    end_fetch(first);
    end_fetch(second);
}

/* ---- clients that go ----------------------------------------------------------------------------------- */

/* Asks by hand, as a client that will not wait for the answer. */
static void *ask(test_t *t, uint64_t job)
{
    void *socket;
    assert_true(t->raw_count < (int)ARRAY_LENGTH(t->raw));
    Lm__ImageGet get = LM__IMAGE_GET__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    get.job = job;
    get.length = 1000;
    get.progress = true;
    envelope.request = 7;
    envelope.body_case = LM__ENVELOPE__BODY_IMAGE_GET;
    envelope.image_get = &get;
    must(wire_socket(t->context, ZMQ_DEALER, &socket));
    t->raw[t->raw_count++] = socket;
    assert_int_equal(zmq_connect(socket, "inproc://bulk"), 0);
    must(wire_send(socket, NULL, 0, &envelope, NULL, 0));
    return socket;
}

/* Waits until the master has told somebody how an image gets on. */
static void await_progress(void *socket)
{
    wire_message_t message;
    bool received = false;
    for (int i = 0; i < 6000 && !received; i++) {
        must(wire_receive(socket, false, &message, &received));
        if (!received) usleep(5000);
    }
    assert_true(received);
    assert_int_equal(message.envelope->body_case, LM__ENVELOPE__BODY_IMAGE_PROGRESS);
    assert_int_equal(message.envelope->request, 7);
    wire_free(&message);
}

/* All of them go. */
static void leave(test_t *t)
{
    while (t->raw_count > 0) zmq_close(t->raw[--t->raw_count]);
}

/* Waits until nobody waits for anything. */
static void await_quiet(test_t *t)
{
    image_news_t news[IMAGE_WRITER_MAX_NEWS];
    for (int i = 0; i < 6000 && image_writer_news(t->image_writer, news) > 0; i++) usleep(5000);
    assert_int_equal(image_writer_news(t->image_writer, news), 0);
}

static void nothing_is_made_for_who_is_gone(void **state)
{
    test_t *t = *state;
    start_serving(t, 0);
    uint64_t job = begin_job(t);
    count_batch(t);
    must(toy_order(t->farm, clock_now(), job, ORDER_PAUSE));
    uint64_t other = begin_job(t);
    count_batch(t);
    hold(t, job);
    void *current = ask(t, job);
    await_progress(current);
    void *waiting = ask(t, other);
    await_progress(waiting);
    leave(t);
    await_quiet(t);
    let_go(t, job);
    fetch_once(t, 0, other); /* so that the writer has come past the first */
    assert_int_equal(scratch_count(t->snapshots), 1);
}

static void an_image_that_another_waits_for_is_made(void **state)
{
    test_t *t = *state;
    start_serving(t, 0);
    uint64_t job = begin_job(t);
    count_batch(t);
    hold(t, job);
    void *gone = ask(t, job);
    await_progress(gone);
    client_t *stays = start_fetch(t, 0, job);
    await_news(stays);
    leave(t);
    await_news(stays);
    await_news(stays);
    pass(10);
    let_go(t, job);
    end_fetch(stays);
    assert_int_equal(scratch_count(t->snapshots), 1); /* it was not made twice */
}

/* ---- room ---------------------------------------------------------------------------------------------- */

static void snapshots_have_a_limit(void **state)
{
    test_t *t = *state;
    start_serving(t, 1000);
    uint64_t job = begin_job(t);
    count_batch(t);
    pthread_join(start_fetch(t, 0, job)->thread, NULL);
    assert_int_equal(t->clients[0].result.code, RESULT_LIMIT);
    assert_non_null(strstr(t->clients[0].result.message, "--snapshot-limit"));
    assert_int_equal(scratch_count(t->snapshots), 0);
}

/* Reads the first bytes of an image: who does so is taken to go on. */
static void begin_reading(test_t *t, uint64_t job)
{
    void *socket = ask(t, job);
    wire_message_t message;
    bool received = false;
    for (int i = 0; i < 6000 && !received; i++) {
        must(wire_receive(socket, false, &message, &received));
        if (!received) usleep(5000);
    }
    assert_true(received);
    assert_int_equal(message.envelope->body_case, LM__ENVELOPE__BODY_IMAGE_CHUNK);
    wire_free(&message);
}

static void what_nobody_reads_makes_room(void **state)
{
    test_t *t = *state;
    start_serving(t, 32000);
    uint64_t job = begin_job(t);
    for (int i = 0; i < 8; i++) count_batch(t); /* all tiles */
    fetch_once(t, 0, job);
    assert_in_range(t->clients[0].size, 17000, 31000); /* there is no room for two */
    count_batch(t);
    fetch_once(t, 1, job); /* the first has been read to its end: it goes */
    assert_int_equal(scratch_count(t->snapshots), 1);
    count_batch(t);
    begin_reading(t, job);
    count_batch(t);
    pthread_join(start_fetch(t, 0, job)->thread, NULL);
    assert_int_equal(t->clients[0].result.code, RESULT_LIMIT);
    assert_non_null(strstr(t->clients[0].result.message, "others fetch"));
    pass(40); /* that reader does not come back */
    fetch_once(t, 1, job);
    assert_int_equal(scratch_count(t->snapshots), 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_fetch_waits_as_long_as_the_master_gets_on, set_up, tear_down),
        cmocka_unit_test_setup_teardown(who_asks_at_the_same_time_gets_the_same_image, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_small_image_is_made_anew_when_something_was_counted, set_up,
                                        tear_down),
        cmocka_unit_test_setup_teardown(who_waits_is_told_how_many_are_before, set_up, tear_down),
        cmocka_unit_test_setup_teardown(nothing_is_made_for_who_is_gone, set_up, tear_down),
        cmocka_unit_test_setup_teardown(an_image_that_another_waits_for_is_made, set_up, tear_down),
        cmocka_unit_test_setup_teardown(snapshots_have_a_limit, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_nobody_reads_makes_room, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("image_writer", tests, NULL, NULL);
}
