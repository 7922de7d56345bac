/* Tests of tile_routes.c: a real master, real sockets, and questions of all sorts. */
#include "master/http/access/tokens.h"
#include "master/http/pace.h"
#include "master/master.h"
#include "tests/http_client.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

typedef struct {
    char *folder;
    master_t *master;
    int port;
    uint64_t job; /* 50 x 40 pixels, nothing rendered */
    http_tokens_t tokens;
} trial_t;

static void submit(trial_t *trial)
{
    peer_t *peer = peer_new(master_control_port(trial->master));
    hash_t blob;
    uint64_t size;
    uint8_t *bytes = peer_blob(0, &size, &blob);
    assert_int_equal(peer_put_blob(peer, bytes, size, &blob, WIRE_MAX_CHUNK).code, RESULT_OK);
    free(bytes);
    job_settings_t settings = job_settings_default();
    settings.width = 50;
    settings.height = 40;
    settings.features = false;
    assert_int_equal(peer_submit(peer, "a test", &settings, &blob, &trial->job).code, RESULT_OK);
    peer_destroy(&peer);
}

static int set_up(void **state)
{
    trial_t *trial = mem_zalloc(1, sizeof *trial);
    log_init("test", LOG_ERROR);
    trial->folder = scratch_new();
    master_options_t options = master_options_default();
    options.control_endpoint = options.bulk_endpoint = "tcp://127.0.0.1:*";
    options.data_dir = trial->folder;
    options.http.listen = "0";
    assert_int_equal(master_start(&options, &trial->master).code, RESULT_OK);
    assert_int_equal(sscanf(master_page_url(trial->master), "http://127.0.0.1:%d/", &trial->port), 1);
    assert_int_equal(http_tokens_read(trial->folder, &trial->tokens).code, RESULT_OK);
    submit(trial);
    *state = trial;
    return 0;
}

static int tear_down(void **state)
{
    trial_t *trial = *state;
    master_stop(&trial->master);
    scratch_destroy(&trial->folder);
    free(trial);
    return 0;
}

/* Asks for the tiles of a job, with this query. */
static http_answer_t ask(trial_t *trial, uint64_t job, const char *query)
{
    char *path = mem_printf("/api/v1/jobs/%llu/tiles%s", (unsigned long long)job, query);
    http_answer_t answer = http_ask(trial->port, "GET", path, trial->tokens.view, NULL);
    free(path);
    return answer;
}

static void test_a_job_without_samples_has_a_size_and_no_tiles(void **state)
{
    trial_t *trial = *state;
    http_answer_t answer = ask(trial, trial->job, "?layer=eye&level=0&since=7&x0=0&y0=0&x1=50&y1=40");
    assert_int_equal(answer.status, 200);
    assert_non_null(strstr(answer.head, "application/octet-stream"));
    const uint8_t head[28] = {'L', 'M', 'T', '1', 0, 0, 0,  0, 50, 0, 0, 0, 40, 0,
                              0,   0,   0,   0,   0, 0, 64, 0, 0,  0, 0, 0, 0,  0};
    assert_int_equal(answer.size, sizeof head);
    assert_memory_equal(answer.body, head, sizeof head);
    http_answer_free(&answer);
}

static void test_a_wrong_question_is_refused_with_the_reason(void **state)
{
    trial_t *trial = *state;
    const struct {
        const char *query, *reason;
        int status;
    } cases[] = {{"?layer=beauty", "layer is picture, eye", 400},
                 {"?layer=", "layer is picture, eye", 400},
                 {"?layer=albedo", "has no layer albedo", 409},
                 {"?level=1", "there is no level 1", 400},
                 {"?level=-1", "level is a whole number", 400},
                 {"?level=99999999999", "level is a whole number", 400},
                 {"?since=4294967296", "since is a whole number", 400},
                 {"?x1=1e9", "x1 is a whole number", 400}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        http_answer_t answer = ask(trial, trial->job, cases[i].query);
        if (answer.status != cases[i].status || strstr(answer.body, cases[i].reason) == NULL)
            fail_msg("%s: %d %s", cases[i].query, answer.status, answer.body);
        http_answer_free(&answer);
    }
}

static void test_strangers_and_unknown_jobs_get_nothing(void **state)
{
    trial_t *trial = *state;
    assert_int_equal(http_status_of(ask(trial, 4711, "")), 404);
    assert_int_equal(http_status_of(http_ask(trial->port, "GET", "/api/v1/jobs/1/tiles", NULL, NULL)), 401);
    assert_int_equal(
        http_status_of(http_ask(trial->port, "POST", "/api/v1/jobs/1/tiles", trial->tokens.operate, "{}")),
        405);
}

/* A job of eight megabytes of tiles, of which something has been rendered. */
static uint64_t large_job(trial_t *trial, peer_t *peer)
{
    hash_t blob;
    uint64_t size, job;
    free(peer_blob(0, &size, &blob)); /* the master has it */
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 1024;
    settings.features = false;
    assert_int_equal(peer_cancel(peer, trial->job).code, RESULT_OK);
    assert_int_equal(peer_submit(peer, "large", &settings, &blob, &job).code, RESULT_OK);
    peer_work_t work;
    peer_hello(peer, WIRE_VERSION, 1, NULL);
    peer_work(peer, 4096, 4096, &work);
    assert_int_equal(work.job, job);
    batch_t batch = peer_render(&work.settings, work.units, work.unit_count);
    assert_int_equal(peer_send_batch(peer, job, &batch).code, RESULT_OK);
    batch_free(&batch);
    return job;
}

/* Asks; returns the bytes of the answer, and how long it took. */
static size_t ask_timed(trial_t *trial, uint64_t job, const char *query, double *seconds)
{
    double start = clock_now();
    http_answer_t answer = ask(trial, job, query);
    assert_int_equal(answer.status, 200);
    size_t size = answer.size;
    http_answer_free(&answer);
    *seconds = clock_now() - start;
    return size;
}

/* Eight megabytes are two seconds' worth. Who has something to show waits until they are paid for; who has
 * nothing yet does not, nor does who would get nothing new. */
static void test_watchers_take_turns(void **state)
{
    trial_t *trial = *state;
    double seconds;
    peer_t *peer = peer_new(master_control_port(trial->master));
    uint64_t job = large_job(trial, peer);
    size_t whole = 256 * (8 + 64 * 64 * 8) + 28, got = 0;
    for (int i = 0; i < 500 && got < whole; i++, usleep(20000)) got = ask_timed(trial, job, "", &seconds);
    assert_int_equal(got, whole);
    assert_int_equal(ask_timed(trial, job, "?since=1", &seconds), 28);
    assert_true(seconds < 1);
    assert_int_equal(ask_timed(trial, job, "?since=0", &seconds), whole);
    assert_int_equal(ask_timed(trial, job, "?since=7", &seconds), whole); /* of another life of the master */
    assert_true(seconds > 2 && seconds < PACE_PATIENCE);
    peer_destroy(&peer);
}

/* Somebody who asks again and again as if for the first time is sent more than there is; others are not left
 * out for it. */
static void test_newcomers_do_not_take_all(void **state)
{
    trial_t *trial = *state;
    double seconds;
    peer_t *peer = peer_new(master_control_port(trial->master));
    uint64_t job = large_job(trial, peer);
    size_t whole = 0;
    for (int i = 0; i < 500 && whole <= 28; i++, usleep(20000)) whole = ask_timed(trial, job, "", &seconds);
    for (int i = 0; i < 9; i++) ask_timed(trial, job, "", &seconds); /* more than 20 seconds are to be paid */
    assert_int_equal(ask_timed(trial, job, "?since=7", &seconds), whole);
    assert_true(seconds > 2 && seconds < 12);
    peer_destroy(&peer);
}

/* A master that ends does not keep who waits. */
static void test_who_waits_is_answered_at_the_end(void **state)
{
    trial_t *trial = *state;
    double seconds;
    peer_t *peer = peer_new(master_control_port(trial->master));
    uint64_t job = large_job(trial, peer);
    size_t got = 0;
    for (int i = 0; i < 500 && got <= 28; i++, usleep(20000)) got = ask_timed(trial, job, "", &seconds);
    for (int i = 0; i < 3; i++) ask_timed(trial, job, "", &seconds); /* eight seconds are to be paid */
    char *question = mem_printf("GET /api/v1/jobs/%llu/tiles?since=7 HTTP/1.1\r\nHost: localhost\r\n"
                                "Authorization: Bearer %s\r\n\r\n",
                                (unsigned long long)job, trial->tokens.view);
    int connection = http_open(trial->port, question);
    assert_null(http_read_until(connection, "HTTP", 1)); /* it waits */
    double start = clock_now();
    peer_destroy(&peer);
    master_stop(&trial->master);
    assert_true(clock_now() - start < 5);
    close(connection);
    free(question);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_a_job_without_samples_has_a_size_and_no_tiles, set_up,
                                        tear_down),
        cmocka_unit_test_setup_teardown(test_a_wrong_question_is_refused_with_the_reason, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_watchers_take_turns, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_newcomers_do_not_take_all, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_who_waits_is_answered_at_the_end, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_strangers_and_unknown_jobs_get_nothing, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
