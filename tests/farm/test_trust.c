/* Whom a master trusts: workers that lie, that die of certain units, that hang, that send nonsense, or that
 * make other bits. A master and workers as they are, and peers of the test's own that do the harm. */
#include "common/image/image.h"
#include "tests/peer.h"
#include "tests/rig.h"
#include "worker/render/fingerprint.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double BATCH_INTERVAL = 0.2; /* seconds */

static void assert_reference(rig_t *rig, uint64_t job)
{
    rig_status_t status = rig_assert_reference(rig, job);
    assert_true(status.issued == status.counted + status.returned);
}

/* What the list of workers says of one; NULL when it is not there. The message is to be freed. */
static const Lm__WorkerStatus *find_worker(rig_t *rig, const char *name, wire_message_t *message)
{
    result_t result = remote_workers(rig->remote, message);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    const Lm__WorkerList *list = message->envelope->worker_list;
    for (size_t i = 0; i < list->n_workers; i++)
        if (strcmp(list->workers[i]->name, name) == 0) return list->workers[i];
    return NULL;
}

static void assert_aside(rig_t *rig, const char *name, const char *why)
{
    wire_message_t message;
    const Lm__WorkerStatus *worker = find_worker(rig, name, &message);
    assert_non_null(worker);
    if (strstr(worker->aside, why) == NULL) fail_msg("%s is aside: '%s'", name, worker->aside);
    wire_free(&message);
}

static void assert_address(rig_t *rig, const char *name, const char *address)
{
    wire_message_t message;
    const Lm__WorkerStatus *worker = find_worker(rig, name, &message);
    assert_non_null(worker);
    assert_string_equal(worker->address, address);
    wire_free(&message);
}

/* ---- lies ---------------------------------------------------------------------------------------------- */

/* Sends sums that are valid and wrong, until the master has had enough. Returns why it is sent away. */
static result_t lie(rig_t *rig, peer_t *liar, uint64_t job, int *lies)
{
    static peer_work_t work;
    result_t refused = result_ok();
    *lies = 0;
    double deadline = clock_now() + 240;
    peer_hello(liar, WIRE_VERSION, 1, NULL);
    while (!job_state_final(rig_status(rig, job).state)) {
        if (clock_now() > deadline) fail_msg("nobody finds a lie");
        peer_work(liar, 4096, 2048, &work);
        if (work.refused.code == RESULT_UNREACHABLE) {
            peer_hello(liar, WIRE_VERSION, 1, &refused);
            if (refused.code != RESULT_OK) break;
            continue;
        }
        if (work.job != 0) {
            batch_t batch = peer_render(&work.settings, work.units, work.unit_count);
            *lies += peer_send_check(liar, work.job, work.check, &batch).code == RESULT_OK;
            batch_free(&batch);
        }
        rig_sleep(0.05);
    }
    return refused;
}

/* Two honest workers and a liar: its sums are found to be wrong, taken out and rendered again. */
static void the_image_is_right_though_a_worker_lies(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    peer_t *liar = peer_new(rig->port);
    liar->name = "liar:1";
    assert_int_equal(renderer_fingerprint(&liar->fingerprint).code, RESULT_OK);
    rig_start_worker(rig);
    rig_start_worker(rig);
    rig_wait_workers(rig, 2);
    job_settings_t settings = rig_settings();
    settings.spp = JOB_MAX_SPP;
    uint64_t job = rig_submit_on(rig, &settings, &(job_terms_t){.name = "verified", .verify = 0.5});
    int lies;
    result_t refused = lie(rig, liar, job, &lies);
    assert_true(lies > 0);
    assert_int_equal(refused.code, RESULT_CANCELLED);
    assert_non_null(strstr(refused.message, "sent other sums than two others"));
    assert_aside(rig, "liar:1", "sent other sums");
    rig_end_job(rig, job);
    assert_reference(rig, job);
    wire_message_t message;
    const Lm__JobStatus *status = peer_status(liar, job, &message);
    assert_true(status->checks_failed > 0);
    assert_true(status->checks_passed > 0);
    wire_free(&message);
    peer_destroy(&liar);
}

/* ---- units that kill ----------------------------------------------------------------------------------- */

enum { MACHINES = 3, DEADLY_TILE = 2 };

/* The image itself says what is missing. */
static void assert_note(rig_t *rig, peer_t *client, uint64_t job, const char *text)
{
    char *path = mem_printf("%s/noted.exr", rig->folder);
    image_t image;
    bool found = false;
    assert_int_equal(peer_fetch(client, job, false, 1 << 20, path).code, RESULT_OK);
    assert_int_equal(image_read_exr(path, &image).code, RESULT_OK);
    for (size_t i = 0; i < image.attribute_count; i++)
        if (strcmp(image.attributes[i].name, "lightmill.note") == 0)
            found = strstr(image.attributes[i].text, text) != NULL;
    assert_true(found);
    image_free(&image);
    free(path);
}

/* Workers of two machines, each in its own life after the other. */
typedef struct {
    int port, lives;
    peer_t *peers[MACHINES];
    char names[MACHINES][30];
    double dies[MACHINES]; /* clock, when it is missed; 0: it lives */
} machines_t;

static void come_to_life(machines_t *machines, int i)
{
    snprintf(machines->names[i], sizeof machines->names[i], "machine-%c:%d", 'a' + i % 2, ++machines->lives);
    machines->peers[i] = peer_new_from(i % 2 ? "127.0.0.2" : "127.0.0.3", machines->port);
    machines->peers[i]->name = machines->names[i];
    peer_hello(machines->peers[i], WIRE_VERSION, 1, NULL);
    machines->dies[i] = 0;
}

static bool is_deadly(const peer_work_t *work)
{
    for (size_t i = 0; i < work->unit_count; i++)
        if (work->units[i].tile == DEADLY_TILE) return true;
    return false;
}

/* Asks for work and delivers it, or dies of it: then it is not heard of any more. */
static void live_on(machines_t *machines, int i)
{
    static peer_work_t work;
    if (machines->peers[i] == NULL) {
        if (clock_now() > machines->dies[i]) come_to_life(machines, i);
        return;
    }
    peer_work(machines->peers[i], 4096, 1024, &work);
    if (work.refused.code == RESULT_OK && is_deadly(&work)) {
        peer_destroy(&machines->peers[i]);
        machines->dies[i] = clock_now() + 1.5; /* a lease is 1 s */
    } else if (work.job != 0) {
        batch_t batch = peer_render(&work.settings, work.units, work.unit_count);
        assert_int_equal(peer_send_check(machines->peers[i], work.job, work.check, &batch).code, RESULT_OK);
        batch_free(&batch);
    }
}

static void a_unit_that_kills_workers_is_left_out(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    machines_t machines = {.port = rig->port};
    peer_t *client = peer_new(rig->port);
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 64; /* four tiles */
    settings.spp = 4;
    uint64_t size, job;
    hash_t hash;
    uint8_t *blob = peer_blob(0, &size, &hash);
    assert_int_equal(peer_put_blob(client, blob, size, &hash, 1 << 20).code, RESULT_OK);
    assert_int_equal(peer_submit(client, "deadly", &settings, &hash, &job).code, RESULT_OK);
    free(blob);
    for (int i = 0; i < MACHINES; i++) come_to_life(&machines, i);
    wire_message_t message;
    double begun = clock_now();
    for (bool over = false; !over;) {
        for (int i = 0; i < MACHINES; i++) live_on(&machines, i);
        rig_sleep(0.05);
        over = job_state_final(rig_status(rig, job).state);
        if (clock_now() - begun > 120) fail_msg("the job does not end: %s", rig_status(rig, job).message);
    }
    const Lm__JobStatus *status = peer_status(client, job, &message);
    assert_int_equal(status->state, JOB_DONE);
    assert_non_null(strstr(status->message, "tile 2, samples"));
    assert_non_null(strstr(status->message, "left out"));
    assert_int_equal(status->samples_skipped, 32 * 32 * 4);
    assert_int_equal(status->samples_counted, 3 * 32 * 32 * 4);
    assert_int_equal(status->samples_issued, status->samples_counted + status->samples_returned);
    assert_note(rig, client, job, "left out");
    print_message("%d lives in %.0f s\n", machines.lives, clock_now() - begun);
    wire_free(&message);
    for (int i = 0; i < MACHINES; i++)
        if (machines.peers[i] != NULL) peer_destroy(&machines.peers[i]);
    peer_destroy(&client);
}

/* ---- stragglers ---------------------------------------------------------------------------------------- */

/* A peer takes some of the last units, lives and delivers nothing: the others finish the job. */
static void nobody_waits_for_a_straggler(void **state)
{
    rig_t *rig = *state;
    static peer_work_t work;
    rig_start_master(rig, BATCH_INTERVAL);
    peer_t *slow = peer_new(rig->port);
    slow->name = "slow:1";
    assert_int_equal(renderer_fingerprint(&slow->fingerprint).code, RESULT_OK);
    rig_start_worker(rig);
    rig_wait_workers(rig, 1);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_samples(rig, job, 4 * RIG_PIXELS);
    peer_hello(slow, WIRE_VERSION, 1, NULL);
    double until = clock_now() + 60;
    do {
        rig_sleep(0.02);
        peer_work(slow, 8 * RIG_PIXELS, 4096, &work);
    } while (work.job == 0 && clock_now() < until); /* a pass may wait for its plan */
    assert_int_equal(work.job, job);
    rig_end_job(rig, job);
    while (!job_state_final(rig_status(rig, job).state) && clock_now() < until) {
        assert_true(peer_heartbeat(slow, job, (uint32_t)work.unit_count));
        rig_sleep(0.2);
    }
    assert_reference(rig, job);
    assert_true(rig_status(rig, job).units_reissued >= work.unit_count);
    peer_destroy(&slow);
}

/* ---- put aside ----------------------------------------------------------------------------------------- */

/* Sends a batch whose payload is cut short. */
static void send_nonsense(peer_t *peer, const peer_work_t *work)
{
    Lm__BatchResult body = LM__BATCH_RESULT__INIT;
    Lm__Counts counts = LM__COUNTS__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    zmq_msg_t payload[BATCH_PAYLOADS];
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        zmq_msg_init_size(&payload[i], 3);
        memset(zmq_msg_data(&payload[i]), 0, 3);
    }
    body.worker = peer->worker;
    body.job = work->job;
    body.n_units = work->unit_count;
    body.units = wire_units_new(work->units, work->issues, work->unit_count);
    body.counts = &counts;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
    envelope.batch_result = &body;
    wire_message_t answer = peer_ask_bulk(peer, &envelope, payload, BATCH_PAYLOADS);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_BATCH_REPLY);
    assert_false(answer.envelope->batch_reply->accepted);
    wire_free(&answer);
    free(body.units);
}

static void who_sends_nonsense_is_put_aside(void **state)
{
    rig_t *rig = *state;
    static peer_work_t work;
    rig_start_master(rig, BATCH_INTERVAL);
    peer_t *peer = peer_new_from("127.0.0.2", rig->port);
    peer->name = "broken:1";
    assert_int_equal(renderer_fingerprint(&peer->fingerprint).code, RESULT_OK);
    job_settings_t settings = rig_settings();
    settings.spp = 32;
    uint64_t job = rig_submit(rig, &settings);
    peer_hello(peer, WIRE_VERSION, 1, NULL);
    for (int i = 0; i < 3; i++) {
        peer_work(peer, 4096, 1024, &work);
        assert_int_equal(work.job, job);
        send_nonsense(peer, &work);
    }
    peer_work(peer, 4096, 1024, &work);
    assert_int_equal(work.refused.code, RESULT_UNREACHABLE);
    result_t refused;
    peer->name = "other:2"; /* a new name is no new party */
    peer_hello(peer, WIRE_VERSION, 1, &refused);
    assert_int_equal(refused.code, RESULT_CANCELLED);
    assert_non_null(strstr(refused.message, "malformed"));
    assert_aside(rig, "broken:1", "malformed");
    assert_address(rig, "broken:1", "127.0.0.2");
    rig_start_worker(rig);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    peer_destroy(&peer);
}

/* ---- other bits ---------------------------------------------------------------------------------------- */

/* A worker whose C library rounds otherwise. */
static pid_t start_other_worker(rig_t *rig)
{
    setenv("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-FMA,-AVX2", 1);
    pid_t worker = rig_start_worker(rig);
    unsetenv("GLIBC_TUNABLES");
    return worker;
}

static void wait_for_message(rig_t *rig, uint64_t job, const char *text)
{
    for (int i = 0; i < 300 && strstr(rig_status(rig, job).message, text) == NULL; i++) rig_sleep(0.1);
    assert_non_null(strstr(rig_status(rig, job).message, text));
}

static void a_job_stays_with_machines_of_the_same_bits(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    pid_t workers[] = {rig_start_worker(rig), rig_start_worker(rig)};
    start_other_worker(rig);
    rig_wait_workers(rig, 3);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_samples(rig, job, 100);
    for (int i = 0; i < 2; i++) kill(workers[i], SIGKILL);
    wait_for_message(rig, job, "waits for a machine that makes the same bits");
    assert_int_equal(rig_status(rig, job).state, JOB_RUNNING);
    rig_end_job(rig, job);
    rig_start_worker(rig);
    assert_reference(rig, job);
    /* A mixed job takes everybody, and tells. */
    job_settings_t settings = rig_settings();
    settings.spp = JOB_MAX_SPP;
    uint64_t mixed = rig_submit_on(rig, &settings, &(job_terms_t){.name = "mixed", .mixed = true});
    rig_wait_workers_seen(rig, mixed, 2);
    rig_end_job(rig, mixed);
    assert_int_equal(rig_wait_job(rig, mixed).state, JOB_DONE);
    assert_int_equal(rig_status(rig, mixed).workers_seen, 2);
    assert_non_null(strstr(rig_status(rig, mixed).message, "depend on which machine"));
}

/* Workers of another version join a long job, and those of the old one leave: the job waits, and its message
 * says for what. It goes on when it is told to. (These make other bits as another version does.) */
static void workers_are_upgraded_during_a_job(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    pid_t old = rig_start_worker(rig);
    rig_wait_workers(rig, 1);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_samples(rig, job, 100);
    start_other_worker(rig);
    rig_wait_workers(rig, 2);
    kill(old, SIGTERM);
    wait_for_message(rig, job, "waits for a machine that makes the same bits");
    uint64_t counted = rig_status(rig, job).samples_done;
    job_order_t order = {.job = job, .kind = ORDER_REBIND};
    result_t result = remote_order(rig->remote, &order);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    rig_end_job(rig, job);
    rig_status_t status = rig_wait_job(rig, job);
    assert_int_equal(status.state, JOB_DONE);
    assert_true(counted > 0 && counted < status.samples_total);
    assert_int_equal(status.samples_done, status.samples_total);
    assert_int_equal(status.issued, status.counted + status.returned);
    assert_non_null(strstr(status.message, "made of two kinds of bits"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_RIG(test) cmocka_unit_test_setup_teardown(test, rig_set_up, rig_tear_down)
        WITH_RIG(the_image_is_right_though_a_worker_lies),
        WITH_RIG(a_unit_that_kills_workers_is_left_out),
        WITH_RIG(nobody_waits_for_a_straggler),
        WITH_RIG(who_sends_nonsense_is_put_aside),
        WITH_RIG(a_job_stays_with_machines_of_the_same_bits),
        WITH_RIG(workers_are_upgraded_during_a_job),
    };
    return cmocka_run_group_tests_name("trust", tests, NULL, NULL);
}
