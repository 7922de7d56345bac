/* A relay between a master and its workers: real processes, and the same bits as without. */
#include "tests/rig.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double BATCH_INTERVAL = 0.2; /* seconds */

/* One of the rig's key files, or NULL when it has none; the caller frees it. */
static char *key_file(const rig_t *rig, const char *name)
{
    return rig->keys != NULL ? mem_printf("%s/%s", rig->keys, name) : NULL;
}

/* With the rig's keys the relay is the farm's worker, and lets in who the master lets in. */
static pid_t start_relay_at(rig_t *rig, int master_port, int port, const char *interval)
{
    char *master = mem_printf("127.0.0.1:%d", master_port), *listen = mem_printf("127.0.0.1:%d", port);
    char *data = mem_printf("%s/relay-%d", rig->folder, rig->started_count);
    char *key = key_file(rig, "worker.secret"), *above = key_file(rig, "master.key");
    char *allow = key_file(rig, "allow");
    pid_t relay = rig_start_program(rig, "lightmill-relay",
                                    (const char *[]){master, "--listen", listen, "--data", data,
                                                     "--heartbeat", "0.2", "--lease", "1", "--batch-interval",
                                                     interval, "--verbose", key ? "--key" : NULL, key,
                                                     "--master-key", above, "--allow", allow, NULL});
    free(master);
    free(listen);
    free(data);
    free(key);
    free(above);
    free(allow);
    return relay;
}

/* Starts a relay at a free port. */
static pid_t start_relay(rig_t *rig, int master_port, int *port)
{
    do *port = rig_free_ports();
    while (*port == rig->port);
    pid_t relay = start_relay_at(rig, master_port, *port, "0.2");
    rig_wait_output(rig, relay, "listening on");
    return relay;
}

/* A worker that dials a port as the holder of a key, which must be one of the rig's. */
static pid_t start_worker_as(rig_t *rig, int port, const char *secret, const char *above)
{
    char *address = mem_printf("127.0.0.1:%d", port);
    char *cache = mem_printf("%s/cache-%d", rig->folder, rig->started_count);
    char *key = key_file(rig, secret), *master = key_file(rig, above);
    pid_t worker =
        rig_start_program(rig, "lightmill-worker",
                          (const char *[]){address, "--threads", "1", "--cache", cache, "--verbose",
                                           key ? "--key" : NULL, key, "--master-key", master, NULL});
    free(address);
    free(cache);
    free(key);
    free(master);
    return worker;
}

static pid_t start_worker(rig_t *rig, int port)
{
    return start_worker_as(rig, port, "worker.secret", "worker.key");
}

static uint64_t submit_short(rig_t *rig, uint32_t spp)
{
    job_settings_t settings = rig_settings();
    settings.spp = spp;
    return rig_submit(rig, &settings);
}

/* Submits a job without an end and waits until something of it is counted. */
static uint64_t begin_job(rig_t *rig)
{
    uint64_t job = rig_submit_endless(rig);
    rig_wait_samples(rig, job, 4 * RIG_PIXELS);
    return job;
}

static void nobody_can_tell_from_the_image(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, BATCH_INTERVAL);
    start_relay(rig, rig->port, &port);
    for (int i = 0; i < 3; i++) start_worker(rig, port);
    rig_wait_workers(rig, 1); /* for the master it is one */
    rig_assert_reference(rig, submit_short(rig, 64));
    rig_assert_reference(rig, submit_short(rig, 32)); /* nothing of the one before is in it */
}

static void workers_beside_and_below_share_a_job(void **state)
{
    rig_t *rig = *state;
    int upper, lower;
    rig_start_master(rig, BATCH_INTERVAL);
    start_relay(rig, rig->port, &upper);
    start_relay(rig, upper, &lower); /* a second level */
    start_worker(rig, lower);
    start_worker(rig, lower);
    start_worker(rig, upper);
    start_worker(rig, rig->port);
    rig_wait_workers(rig, 2);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_workers_seen(rig, job, 2);
    rig_end_job(rig, job);
    assert_true(rig_assert_reference(rig, job).workers_seen >= 2);
}

static void a_killed_relay_loses_nothing(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, BATCH_INTERVAL);
    pid_t relay = start_relay(rig, rig->port, &port);
    start_worker(rig, port);
    start_worker(rig, port);
    uint64_t job = begin_job(rig);
    kill(relay, SIGKILL);
    rig_wait_workers(rig, 0);
    assert_int_equal(rig_status(rig, job).state, JOB_RUNNING);
    rig_end_job(rig, job);
    start_relay_at(rig, rig->port, port, "0.2"); /* the workers find it */
    rig_assert_reference(rig, job);
}

static void a_killed_worker_is_replaced_below(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, BATCH_INTERVAL);
    start_relay(rig, rig->port, &port);
    pid_t worker = start_worker(rig, port);
    start_worker(rig, port);
    uint64_t job = begin_job(rig);
    kill(worker, SIGKILL);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

static void a_stopped_relay_goes_on(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, BATCH_INTERVAL);
    pid_t relay = start_relay(rig, rig->port, &port);
    start_worker(rig, port);
    start_worker(rig, port);
    uint64_t job = begin_job(rig);
    kill(relay, SIGSTOP);
    rig_wait_workers(rig, 0);
    rig_sleep(0.5);
    kill(relay, SIGCONT);
    rig_wait_workers(rig, 1);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

static void the_master_comes_back(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, BATCH_INTERVAL);
    start_relay(rig, rig->port, &port);
    start_worker(rig, port);
    start_worker(rig, port);
    uint64_t job = begin_job(rig);
    rig_kill_master(rig);
    rig_sleep(0.5);
    rig_restart_master(rig, BATCH_INTERVAL);
    rig_wait_workers(rig, 1);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

/* No sum is due for a long time: what is counted came with the farewell. */
static void a_relay_that_leaves_delivers(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, 1000);
    pid_t relay = start_relay(rig, rig->port, &port);
    pid_t worker = start_worker(rig, port);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_output(rig, worker, "counted after");
    kill(relay, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, relay, 30), 0);
    assert_true(rig_status(rig, job).samples_done > 0);
    rig_wait_workers(rig, 0);
}

static void a_cancelled_job_keeps_what_the_workers_had(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, 1000);
    start_relay(rig, rig->port, &port);
    pid_t worker = start_worker(rig, port);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_output(rig, worker, "counted after");
    assert_int_equal(remote_cancel(rig->remote, job).code, RESULT_OK);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_CANCELLED);
    assert_true(rig_status(rig, job).samples_done > 0);
    rig_image_hash(rig, job);
}

/* Some units are rendered twice: by a worker below one relay and by one below another. */
static void relays_vouch_for_one_another(void **state)
{
    rig_t *rig = *state;
    int ports[2];
    rig_start_master(rig, BATCH_INTERVAL);
    for (int i = 0; i < 2; i++) {
        start_relay(rig, rig->port, &ports[i]);
        start_worker(rig, ports[i]);
    }
    rig_wait_workers(rig, 2);
    job_settings_t settings = rig_settings();
    settings.spp /= 3;
    job_terms_t terms = {.name = "verified", .verify = 0.3};
    uint64_t job = rig_submit_on(rig, &settings, &terms), passed, failed;
    rig_assert_reference(rig, job);
    wire_message_t message;
    assert_int_equal(remote_status(rig->remote, job, &message).code, RESULT_OK);
    passed = message.envelope->job_status_reply->jobs[0]->checks_passed;
    failed = message.envelope->job_status_reply->jobs[0]->checks_failed;
    wire_free(&message);
    assert_true(passed > 0);
    assert_int_equal(failed, 0);
}

static void a_paused_job_goes_on_below(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_start_master(rig, BATCH_INTERVAL);
    start_relay(rig, rig->port, &port);
    start_worker(rig, port);
    start_worker(rig, port);
    uint64_t job = begin_job(rig);
    assert_int_equal(remote_order(rig->remote, &(job_order_t){.job = job, .kind = ORDER_PAUSE}).code,
                     RESULT_OK);
    rig_sleep(1);
    assert_int_equal(rig_status(rig, job).state, JOB_PAUSED);
    assert_int_equal(remote_order(rig->remote, &(job_order_t){.job = job, .kind = ORDER_RESUME}).code,
                     RESULT_OK);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

static void a_relay_has_keys_in_both_directions(void **state)
{
    rig_t *rig = *state;
    int port;
    rig_use_keys(rig);
    rig_start_master(rig, BATCH_INTERVAL);
    pid_t relay = start_relay(rig, rig->port, &port);
    pid_t stranger = start_worker_as(rig, port, "master.secret", "worker.key"); /* is not on the list */
    pid_t client = start_worker_as(rig, port, "client.secret", "worker.key");   /* may not work */
    rig_wait_output(rig, relay, "is not in");
    rig_wait_output(rig, relay, "may submit");
    rig_wait_workers(rig, 0);
    start_worker(rig, port);
    rig_wait_workers(rig, 1);
    rig_assert_reference(rig, submit_short(rig, 32));
    kill(stranger, SIGKILL);
    kill(client, SIGKILL);
}

int main(void)
{
#define RELAY(test) cmocka_unit_test_setup_teardown(test, rig_set_up, rig_tear_down)
    const struct CMUnitTest tests[] = {
        RELAY(nobody_can_tell_from_the_image),
        RELAY(workers_beside_and_below_share_a_job),
        RELAY(a_killed_relay_loses_nothing),
        RELAY(a_killed_worker_is_replaced_below),
        RELAY(a_stopped_relay_goes_on),
        RELAY(the_master_comes_back),
        RELAY(a_relay_that_leaves_delivers),
        RELAY(a_cancelled_job_keeps_what_the_workers_had),
        RELAY(a_paused_job_goes_on_below),
        RELAY(relays_vouch_for_one_another),
        RELAY(a_relay_has_keys_in_both_directions),
    };
    return cmocka_run_group_tests_name("relay", tests, NULL, NULL);
}
