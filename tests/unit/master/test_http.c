/* Tests of the master's HTTP server: a real master, real sockets. */
#include "master/http/access/tokens.h"
#include "master/http/routes.h"
#include "master/master.h"
#include "tests/http_client.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

typedef struct {
    char *folder;
    master_t *master;
    peer_t *peer;
    hash_t blob; /* of a scene that the master has */
    int port;
    http_tokens_t tokens;
} http_test_t;

static master_options_t options_of(const char *folder)
{
    master_options_t options = master_options_default();
    options.control_endpoint = options.bulk_endpoint = "tcp://127.0.0.1:*";
    options.data_dir = folder;
    options.http.listen = "0";
    return options;
}

static void begin(http_test_t *t)
{
    master_options_t options = options_of(t->folder);
    result_t result = master_start(&options, &t->master);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    assert_int_equal(sscanf(master_page_url(t->master), "http://127.0.0.1:%d/", &t->port), 1);
    assert_int_equal(http_tokens_read(t->folder, &t->tokens).code, RESULT_OK);
}

static int set_up(void **state)
{
    http_test_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    begin(t);
    t->peer = peer_new(master_control_port(t->master));
    uint64_t size;
    uint8_t *bytes = peer_blob(0, &size, &t->blob);
    assert_int_equal(peer_put_blob(t->peer, bytes, size, &t->blob, WIRE_MAX_CHUNK).code, RESULT_OK);
    free(bytes);
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    http_test_t *t = *state;
    peer_destroy(&t->peer);
    master_stop(&t->master);
    scratch_destroy(&t->folder);
    free(t);
    return 0;
}

static uint64_t submit(http_test_t *t)
{
    uint64_t job;
    job_settings_t settings = job_settings_default();
    settings.width = 50;
    settings.height = 40;
    settings.spp = 8;
    assert_int_equal(peer_submit(t->peer, "a \"test\"", &settings, &t->blob, &job).code, RESULT_OK);
    return job;
}

static int status(http_test_t *t, const char *method, const char *path, const char *token, const char *body)
{
    return http_status_of(http_ask(t->port, method, path, token, body));
}

/* The status of a GET with these lines and the token to operate. */
static int status_with(http_test_t *t, const char *path, const char *lines)
{
    char *all = mem_printf("%sAuthorization: Bearer %s\r\n", lines, t->tokens.operate);
    int got = http_status_of(http_ask_raw(t->port, "GET", path, all, NULL));
    free(all);
    return got;
}

static const char *text_of(const json_t *object, const char *key)
{
    return json_string_value(json_object_get(object, key));
}

static json_int_t count_of(const json_t *object, const char *key)
{
    return json_integer_value(json_object_get(object, key));
}

/* ---- who may ----------------------------------------------------------------------------------------- */

static void the_api_needs_a_token(void **state)
{
    http_test_t *t = *state;
    char wrong[HTTP_TOKEN_TEXT + 1];
    memset(wrong, 'a', HTTP_TOKEN_TEXT);
    wrong[HTTP_TOKEN_TEXT] = '\0';
    assert_int_equal(status(t, "GET", "/api/v1/jobs", NULL, NULL), 401);
    assert_int_equal(status(t, "GET", "/api/v1/jobs", "", NULL), 401);
    assert_int_equal(status(t, "GET", "/api/v1/jobs", wrong, NULL), 401);
    assert_int_equal(status(t, "GET", "/api/v1/jobs", t->tokens.view, NULL), 200);
    assert_int_equal(status(t, "GET", "/api/v1/jobs", t->tokens.operate, NULL), 200);
    t->tokens.view[HTTP_TOKEN_TEXT - 1] ^= 1; /* the last digit is wrong */
    assert_int_equal(status(t, "GET", "/api/v1/jobs", t->tokens.view, NULL), 401);
    http_answer_t answer = http_ask(t->port, "GET", "/api/v1/workers", NULL, NULL);
    assert_non_null(strstr(answer.head, "WWW-Authenticate: Bearer"));
    assert_non_null(strstr(answer.head, "Content-Type: application/problem+json"));
    assert_non_null(strstr(answer.head, "Cache-Control: no-store"));
    json_t *problem = http_json_of(answer, 401);
    assert_int_equal(count_of(problem, "status"), 401);
    assert_non_null(strstr(text_of(problem, "detail"), "lightmill open"));
    json_decref(problem);
}

static void other_hosts_and_origins_are_refused(void **state)
{
    http_test_t *t = *state;
    const char *path = "/api/v1/jobs";
    char *own = mem_printf("Host: LocalHost:%d\r\nOrigin: http://localhost:%d\r\n", t->port, t->port);
    assert_int_equal(status_with(t, path, own), 200);
    free(own);
    assert_int_equal(status_with(t, path, "Host: localhost\r\n"), 200); /* behind a proxy at port 80 */
    assert_int_equal(status_with(t, path, "Host: [::1]:7480\r\n"), 200);
    assert_int_equal(status_with(t, path, ""), 400);
    assert_int_equal(status_with(t, path, "Host: evil.example\r\n"), 421);
    assert_int_equal(status_with(t, "/", "Host: evil.example\r\n"), 421); /* the page too */
    assert_int_equal(status_with(t, path, "Host: localhost.evil.example\r\n"), 421);
    assert_int_equal(status_with(t, path, "Host: localhost:80@evil.example\r\n"), 421);
    assert_int_equal(status_with(t, path, "Host: [::1\r\n"), 421);
    assert_int_equal(status_with(t, path, "Host: localhost\r\nOrigin: http://evil.example\r\n"), 403);
    assert_int_equal(status_with(t, path, "Host: localhost\r\nOrigin: http://localhost:81\r\n"), 403);
    assert_int_equal(status_with(t, path, "Host: localhost\r\nOrigin: null\r\n"), 403);
    assert_int_equal(status_with(t, path, "Host: localhost\r\nSec-Fetch-Site: cross-site\r\n"), 403);
    assert_int_equal(status_with(t, path, "Host: localhost\r\nSec-Fetch-Site: same-site\r\n"), 403);
    assert_int_equal(status_with(t, path, "Host: localhost\r\nSec-Fetch-Site: same-origin\r\n"), 200);
    /* Somebody follows a link to the page; another site's script loads it. */
    assert_int_equal(
        status_with(t, "/", "Host: localhost\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\n"),
        200);
    assert_int_equal(
        status_with(t, "/app.js",
                    "Host: localhost\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\n"),
        403);
}

static void a_host_that_is_named_is_known(void **state)
{
    http_test_t *t = *state;
    static const char *names[] = {"farm.example"};
    char *folder = scratch_new();
    master_options_t options = options_of(folder);
    options.http.hosts = (option_list_t){names, 1};
    master_t *master;
    int port;
    assert_int_equal(master_start(&options, &master).code, RESULT_OK);
    assert_int_equal(sscanf(master_page_url(master), "http://farm.example:%d/", &port), 1);
    assert_int_equal(http_status_of(http_ask_raw(port, "GET", "/", "Host: farm.example\r\n", NULL)), 200);
    assert_int_equal(http_status_of(http_ask_raw(t->port, "GET", "/", "Host: farm.example\r\n", NULL)), 421);
    master_stop(&master);
    scratch_destroy(&folder);
}

static void other_machines_need_tls(void **state)
{
    http_test_t *t = *state;
    char *folder = scratch_new();
    master_t *master;
    master_options_t options = options_of(folder);
    options.http.listen = "0.0.0.0:0";
    result_t result = master_start(&options, &master);
    assert_int_equal(result.code, RESULT_USAGE);
    assert_non_null(strstr(result.message, "--http-cert"));
    assert_non_null(strstr(result.message, "proxy"));
    options.http.cert = "nothing.pem";
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE); /* no key */
    options.http = (http_options_t){.listen = "80x"};
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE);
    options.http = (http_options_t){.cert = "a", .key = "b"};
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE);
    char *taken = mem_printf("%d", t->port);
    options.http = (http_options_t){.listen = taken};
    assert_int_equal(master_start(&options, &master).code, RESULT_IO);
    free(taken);
    scratch_destroy(&folder);
}

static void tokens_are_private_and_stay(void **state)
{
    http_test_t *t = *state;
    http_tokens_t before = t->tokens;
    struct stat file;
    char *path = scratch_path(t->folder, "keys/http"), *url = http_url_path(t->folder);
    assert_int_equal(stat(path, &file), 0);
    assert_int_equal(file.st_mode & 0777, 0600);
    assert_int_equal(access(url, F_OK), 0);
    master_stop(&t->master);
    assert_int_not_equal(access(url, F_OK), 0);
    begin(t);
    assert_string_equal(before.view, t->tokens.view);
    assert_string_equal(before.operate, t->tokens.operate);
    assert_string_not_equal(before.view, before.operate);
    master_stop(&t->master);
    scratch_write(path, "view 12\n", 8);
    master_options_t options = options_of(t->folder);
    result_t result = master_start(&options, &t->master);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "keys/http:1"));
    assert_int_equal(unlink(path), 0);
    begin(t);
    assert_string_not_equal(before.view, t->tokens.view);
    free(path);
    free(url);
}

/* ---- what it says -------------------------------------------------------------------------------------- */

static void the_page_is_served_without_a_token(void **state)
{
    http_test_t *t = *state;
    http_answer_t page = http_ask(t->port, "GET", "/", NULL, NULL);
    assert_int_equal(page.status, 200);
    assert_non_null(strstr(page.body, "<title>Lightmill"));
    assert_non_null(strstr(page.head, "Content-Type: text/html"));
    assert_non_null(strstr(page.head, "Content-Security-Policy: default-src 'none'; script-src 'self';"));
    assert_non_null(strstr(page.head, "frame-ancestors 'none'"));
    assert_non_null(strstr(page.head, "X-Content-Type-Options: nosniff"));
    char etag[64];
    assert_int_equal(sscanf(strstr(page.head, "ETag: "), "ETag: %63[^\r]", etag), 1);
    char *lines = mem_printf("Host: localhost\r\nIf-None-Match: %s\r\n", etag);
    http_answer_t again = http_ask_raw(t->port, "GET", "/index.html", lines, NULL);
    assert_int_equal(again.status, 304);
    assert_int_equal(again.size, 0);
    free(lines);
    http_answer_free(&page);
    http_answer_free(&again);
    page = http_ask(t->port, "HEAD", "/app.js", NULL, NULL);
    assert_int_equal(page.status, 200);
    assert_int_equal(page.size, 0);
    assert_non_null(strstr(page.head, "Content-Type: text/javascript"));
    http_answer_free(&page);
    assert_int_equal(status(t, "GET", "/../Makefile", NULL, NULL), 404);
    assert_int_equal(status(t, "POST", "/", NULL, "x"), 405);
    assert_int_equal(status(t, "DELETE", "/api/v1/jobs", t->tokens.operate, NULL), 405);
}

static void jobs_and_workers_are_told(void **state)
{
    http_test_t *t = *state;
    uint64_t job = submit(t);
    peer_hello(t->peer, WIRE_VERSION, 3, NULL);
    json_t *root = http_json_of(http_ask(t->port, "GET", "/api/v1/jobs", t->tokens.view, NULL), 200);
    const json_t *first = json_array_get(json_object_get(root, "jobs"), 0);
    assert_int_equal(count_of(root, "workers"), 1);
    assert_int_equal(count_of(first, "job"), job);
    assert_string_equal(text_of(first, "name"), "a \"test\"");
    assert_string_equal(text_of(first, "state"), "queued");
    assert_int_equal(count_of(first, "samples_total"), 50 * 40 * 8);
    json_decref(root);
    char *path = mem_printf("/api/v1/jobs/%llu", (unsigned long long)job);
    root = http_json_of(http_ask(t->port, "GET", path, t->tokens.view, NULL), 200);
    assert_int_equal(count_of(root, "width"), 50);
    json_decref(root);
    free(path);
    root = http_json_of(http_ask(t->port, "GET", "/api/v1/workers", t->tokens.view, NULL), 200);
    assert_int_equal(count_of(json_array_get(json_object_get(root, "workers"), 0), "threads"), 3);
    json_decref(root);
    root = http_json_of(http_ask(t->port, "GET", "/api/v1/farm", t->tokens.view, NULL), 200);
    assert_string_equal(text_of(root, "version"), LIGHTMILL_VERSION);
    assert_int_equal(count_of(root, "workers"), 1);
    assert_int_equal(count_of(root, "threads"), 3);
    assert_int_equal(count_of(json_object_get(root, "jobs"), "queued"), 1);
    assert_true(json_real_value(json_object_get(root, "uptime")) < 60);
    json_decref(root);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/99", t->tokens.view, NULL), 404);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/0", t->tokens.view, NULL), 404);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/99999999999999999999999", t->tokens.view, NULL), 404);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/1x", t->tokens.view, NULL), 404);
}

static json_int_t wanted(http_test_t *t)
{
    json_t *root = http_json_of(http_ask(t->port, "GET", "/api/v1/demand", t->tokens.view, NULL), 200);
    json_int_t workers = count_of(root, "workers");
    json_decref(root);
    return workers;
}

static void workers_are_wanted_while_there_is_work(void **state)
{
    http_test_t *t = *state;
    assert_int_equal(wanted(t), 0);
    uint64_t job = submit(t);
    assert_int_equal(wanted(t), 1);
    assert_int_equal(peer_cancel(t->peer, job).code, RESULT_OK);
    assert_int_equal(wanted(t), 0);
}

/* ---- orders -------------------------------------------------------------------------------------------- */

/* Posts an order to the job; returns the status. */
static int post(http_test_t *t, uint64_t job, const char *what, const char *token, const char *body)
{
    char *path = mem_printf("/api/v1/jobs/%llu/%s", (unsigned long long)job, what);
    int got = status(t, "POST", path, token, body);
    free(path);
    return got;
}

/* The job's state as clients of the other sockets see it. */
static uint32_t state_of(http_test_t *t, uint64_t job)
{
    wire_message_t message;
    uint32_t got = peer_status(t->peer, job, &message)->state;
    wire_free(&message);
    return got;
}

static void orders_need_the_token_to_operate(void **state)
{
    http_test_t *t = *state;
    uint64_t job = submit(t);
    assert_int_equal(post(t, job, "pause", NULL, NULL), 401);
    assert_int_equal(post(t, job, "pause", t->tokens.view, NULL), 403);
    assert_int_equal(status(t, "DELETE", "/api/v1/jobs/1", t->tokens.view, NULL), 403);
    assert_int_equal(state_of(t, job), JOB_QUEUED);
    char *lines = mem_printf("Host: localhost\r\nOrigin: http://evil.example\r\nAuthorization: Bearer %s\r\n",
                             t->tokens.operate);
    assert_int_equal(http_status_of(http_ask_raw(t->port, "POST", "/api/v1/jobs/1/pause", lines, "")), 403);
    assert_int_equal(state_of(t, job), JOB_QUEUED);
    free(lines);
}

static void orders_are_carried_out(void **state)
{
    http_test_t *t = *state;
    uint64_t job = submit(t);
    const char *token = t->tokens.operate;
    json_t *root = http_json_of(http_ask(t->port, "POST", "/api/v1/jobs/1/pause", token, NULL), 200);
    assert_int_equal(job, 1);
    assert_string_equal(text_of(root, "state"), "paused");
    json_decref(root);
    assert_int_equal(state_of(t, job), JOB_PAUSED);
    assert_int_equal(post(t, job, "pause", token, NULL), 409);
    assert_int_equal(post(t, job, "resume", token, "{}"), 200);
    assert_int_equal(state_of(t, job), JOB_QUEUED);
    assert_int_equal(post(t, job, "extend", token, "{\"spp\": 64}"), 200);
    assert_int_equal(post(t, job, "priority", token, "{\"priority\": -7}"), 200);
    assert_int_equal(post(t, job, "retain", token, NULL), 200);
    root = http_json_of(http_ask(t->port, "GET", "/api/v1/jobs/1", token, NULL), 200);
    assert_int_equal(count_of(root, "spp"), 64);
    assert_int_equal(count_of(root, "priority"), -7);
    assert_true(json_is_true(json_object_get(root, "retained")));
    json_decref(root);
    assert_int_equal(status(t, "DELETE", "/api/v1/jobs/1", token, NULL), 409); /* it is not over */
    assert_int_equal(post(t, job, "cancel", token, NULL), 200);
    peer_wait(t->peer, job, 30);
    assert_int_equal(status(t, "DELETE", "/api/v1/jobs/1", token, NULL), 204);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/1", token, NULL), 404);
    assert_int_equal(post(t, job, "pause", token, NULL), 404);
}

static void wrong_orders_are_refused(void **state)
{
    http_test_t *t = *state;
    uint64_t job = submit(t);
    static const char *const bodies[] = {
        "{\"spp\": 0}",      "{\"spp\": 1.5}", "{\"spp\": \"64\"}", "{\"error\": -1}",
        "{\"samples\": 64}", "[64]",           "{\"spp\": 64",      "{}",
        "\xff\xfe",          "{\"spp\": 1e99}"};
    for (size_t i = 0; i < ARRAY_LENGTH(bodies); i++) {
        int got = post(t, job, "extend", t->tokens.operate, bodies[i]);
        if (got != 400 && got != 409) fail_msg("%s: %d", bodies[i], got);
    }
    assert_int_equal(post(t, job, "priority", t->tokens.operate, NULL), 400);
    assert_int_equal(post(t, job, "priority", t->tokens.operate, "{\"priority\": 1001}"), 400);
    assert_int_equal(post(t, job, "pause", t->tokens.operate, "{\"spp\": 1}"), 400);
    assert_int_equal(post(t, job, "burn", t->tokens.operate, NULL), 404);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/1/pause", t->tokens.operate, NULL), 405);
    json_t *root = http_json_of(http_ask(t->port, "GET", "/api/v1/jobs/1", t->tokens.view, NULL), 200);
    assert_int_equal(count_of(root, "spp"), 8);
    json_decref(root);
}

/* What the API ordered outlives the process. */
static void orders_are_durable(void **state)
{
    http_test_t *t = *state;
    uint64_t job = submit(t);
    assert_int_equal(post(t, job, "pause", t->tokens.operate, NULL), 200);
    peer_destroy(&t->peer);
    master_stop(&t->master);
    begin(t);
    t->peer = peer_new(master_control_port(t->master));
    assert_int_equal(state_of(t, job), JOB_PAUSED);
}

static void the_error_has_a_history(void **state)
{
    http_test_t *t = *state;
    submit(t);
    json_t *root =
        http_json_of(http_ask(t->port, "GET", "/api/v1/jobs/1/history", t->tokens.view, NULL), 200);
    assert_int_equal(json_array_size(json_object_get(root, "points")), 0);
    json_decref(root);
    assert_int_equal(status(t, "GET", "/api/v1/jobs/2/history", t->tokens.view, NULL), 404);
}

/* ---- events -------------------------------------------------------------------------------------------- */

/* Opens the stream of events; `last` is the Last-Event-ID, NULL: none. */
static int listen_to(http_test_t *t, const char *last)
{
    char *bytes = mem_printf("GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer %s\r\n"
                             "%s%s\r\n\r\n",
                             t->tokens.view, last ? "Last-Event-ID: " : "X: x", last ? last : "");
    int connection = http_open(t->port, bytes);
    free(bytes);
    return connection;
}

/* Waits for a text; fails the test without it. */
static char *expect_text(int connection, const char *text)
{
    char *got = http_read_until(connection, text, 10);
    if (got == NULL) fail_msg("'%s' has not come", text);
    return got;
}

static void events_tell_what_happens(void **state)
{
    http_test_t *t = *state;
    int stream = listen_to(t, NULL);
    char *head = expect_text(stream, "retry:");
    assert_non_null(strstr(head, "HTTP/1.1 200"));
    assert_non_null(strstr(head, "text/event-stream"));
    uint64_t job = submit(t);
    char *text = expect_text(stream, "\"state\":\"queued\"");
    assert_non_null(strstr(text, "event: job\ndata: {\"job\":1,"));
    free(text);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    free(expect_text(stream, "\"what\":\"joined\""));
    peer_goodbye(t->peer);
    free(expect_text(stream, "\"what\":\"left\""));
    assert_int_equal(post(t, job, "pause", t->tokens.operate, NULL), 200);
    free(expect_text(stream, "\"state\":\"paused\""));
    assert_int_equal(post(t, job, "extend", t->tokens.operate, "{\"spp\": 70000, \"time\": 5.5}"), 200);
    free(expect_text(stream, "event: note\ndata: {\"job\":1,\"what\":\"extended\",\"why\":"
                             "\"to 70000 samples a pixel or 5.5 s\"}"));
    free(head);
    close(stream);
}

/* Two workers that call themselves the same are two. */
static void workers_of_one_name_are_told_apart(void **state)
{
    http_test_t *t = *state;
    int stream = listen_to(t, NULL);
    free(expect_text(stream, "retry:"));
    peer_t *second = peer_new(master_control_port(t->master));
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    free(expect_text(stream, "\"what\":\"joined\""));
    peer_hello(second, WIRE_VERSION, 1, NULL);
    free(expect_text(stream, "\"what\":\"joined\""));
    peer_goodbye(second);
    free(expect_text(stream, "\"what\":\"left\""));
    peer_destroy(&second);
    close(stream);
}

static void a_reader_that_comes_back_loses_nothing(void **state)
{
    http_test_t *t = *state;
    char id[64];
    int stream = listen_to(t, NULL);
    free(expect_text(stream, "retry:"));
    uint64_t job = submit(t);
    char *text = expect_text(stream, "\"queued\"");
    assert_int_equal(sscanf(strstr(text, "id: "), "id: %63[^\n]", id), 1);
    free(text);
    close(stream);
    assert_int_equal(post(t, job, "pause", t->tokens.operate, NULL), 200);
    usleep(3000000); /* it is written while nobody listens */
    assert_int_equal(post(t, job, "resume", t->tokens.operate, NULL), 200);
    stream = listen_to(t, id);
    text = expect_text(stream, "\"queued\""); /* both may come at once */
    assert_non_null(strstr(text, "\"paused\""));
    assert_null(strstr(text, "event: lost"));
    free(text);
    close(stream);
}

/* The id of another life of the master, and one that never was. */
static void who_has_lost_events_is_told(void **state)
{
    http_test_t *t = *state;
    const char *const ids[] = {"01234567-1", "x", "01234567-99999999999999999999999"};
    for (size_t i = 0; i < ARRAY_LENGTH(ids); i++) {
        int stream = listen_to(t, ids[i]);
        free(expect_text(stream, "event: lost\ndata: {}\n\n"));
        close(stream);
    }
}

/* Starts the master again, with few events kept, and one second for headers. */
static void begin_short(http_test_t *t)
{
    peer_destroy(&t->peer);
    master_stop(&t->master);
    master_options_t options = options_of(t->folder);
    options.http.events_kept = 64;
    options.http.patience = 1;
    assert_int_equal(master_start(&options, &t->master).code, RESULT_OK);
    assert_int_equal(sscanf(master_page_url(t->master), "http://127.0.0.1:%d/", &t->port), 1);
    t->peer = peer_new(master_control_port(t->master));
}

static void post_all(http_test_t *t, uint64_t first, uint64_t last, const char *what)
{
    for (uint64_t job = first; job <= last; job++)
        assert_int_equal(post(t, job, what, t->tokens.operate, NULL), 200);
}

/* More events than are kept: who comes back is told so, and so is who has listened all the time and not read.
 */
static void a_ring_that_runs_over_is_told(void **state)
{
    http_test_t *t = *state;
    enum { JOBS = 80, ROUNDS = 10 };
    begin_short(t);
    uint64_t first = submit(t), last = first;
    int deaf = listen_to(t, NULL), stream = listen_to(t, NULL);
    free(expect_text(deaf, "retry:"));
    free(expect_text(stream, "retry:"));
    assert_int_equal(post(t, first, "pause", t->tokens.operate, NULL), 200);
    char id[64], *text = expect_text(stream, "\"paused\"");
    assert_int_equal(sscanf(strstr(text, "id: "), "id: %63[^\n]", id), 1);
    free(text);
    close(stream);
    while (last < first + JOBS) last = submit(t);
    for (int round = 0; round < ROUNDS; round++) {
        post_all(t, first + 1, last, round % 2 == 0 ? "pause" : "resume");
        usleep(1100000); /* they are written once a second */
    }
    stream = listen_to(t, id);
    free(expect_text(stream, "event: lost\ndata: {}\n\n"));
    free(expect_text(deaf, "event: lost\ndata: {}\n\n"));
    assert_int_equal(post(t, first, "resume", t->tokens.operate, NULL), 200);
    free(expect_text(stream, "\"queued\"")); /* what happens from now on comes */
    free(expect_text(deaf, "\"queued\""));
    close(stream);
    close(deaf);
}

/* A byte now and then does not keep a connection, before its first request or after one; a stream stays. */
static void connections_that_dawdle_are_closed(void **state)
{
    http_test_t *t = *state;
    begin_short(t);
    int stream = listen_to(t, NULL), slow = http_open(t->port, "GET / HTTP/1.1\r\nHost: localhost\r\nX: "),
        second = http_open(t->port, "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n");
    free(expect_text(stream, "retry:"));
    free(expect_text(second, "HTTP/1.1 200"));
    double start = clock_now();
    bool open = true;
    while (open && clock_now() - start < 20) {
        open = send(slow, "x", 1, MSG_NOSIGNAL) == 1 || send(second, "G", 1, MSG_NOSIGNAL) == 1;
        usleep(100000);
    }
    assert_false(open);
    assert_true(clock_now() - start > 0.5);
    submit(t);
    free(expect_text(stream, "\"queued\""));
    assert_int_equal(status(t, "GET", "/healthz", NULL, NULL), 200);
    close(stream);
    close(slow);
    close(second);
}

/* A master that ends does not wait for those who listen. */
static void streams_end_with_the_master(void **state)
{
    http_test_t *t = *state;
    int streams[8];
    for (size_t i = 0; i < ARRAY_LENGTH(streams); i++) streams[i] = listen_to(t, NULL);
    for (size_t i = 0; i < ARRAY_LENGTH(streams); i += 2) free(expect_text(streams[i], "retry:"));
    double start = clock_now();
    peer_destroy(&t->peer);
    master_stop(&t->master);
    assert_true(clock_now() - start < 12);                /* the next comment comes after 15 s */
    assert_null(http_read_until(streams[0], "never", 5)); /* the end of the stream */
    assert_true(clock_now() - start < 12);                /* the next comment comes after 15 s */
    for (size_t i = 0; i < ARRAY_LENGTH(streams); i++) close(streams[i]);
    begin(t);
    t->peer = peer_new(master_control_port(t->master));
}

static void streams_leave_room_for_others(void **state)
{
    http_test_t *t = *state;
    int streams[128];
    for (size_t i = 0; i < ARRAY_LENGTH(streams); i++)
        streams[i] = listen_to(t, NULL); /* most are never read */
    free(expect_text(streams[127], "retry:"));
    int more = listen_to(t, NULL);
    free(expect_text(more, "HTTP/1.1 503"));
    assert_int_equal(status(t, "GET", "/api/v1/jobs", t->tokens.view, NULL), 200);
    for (size_t i = 0; i < ARRAY_LENGTH(streams); i++) close(streams[i]);
    close(more);
}

/* ---- monitoring ---------------------------------------------------------------------------------------- */

static void metrics_follow_the_conventions(void **state)
{
    http_test_t *t = *state;
    submit(t);
    assert_int_equal(status(t, "GET", "/metrics", NULL, NULL), 401);
    http_answer_t answer = http_ask(t->port, "GET", "/metrics", t->tokens.view, NULL);
    assert_int_equal(answer.status, 200);
    assert_non_null(strstr(answer.head, "Content-Type: text/plain; version=0.0.4"));
    assert_non_null(strstr(answer.body, "\nlightmill_renders{state=\"queued\"} 1\n"));
    assert_non_null(strstr(answer.body, "\nlightmill_render_samples_wanted{render=\"1\"} 16000\n"));
    assert_non_null(strstr(answer.body, "{render=\"1\",name=\"a \\\"test\\\"\",state=\"queued\"} 1\n"));
    char *path = scratch_path(t->folder, "metrics");
    scratch_write(path, answer.body, answer.size);
    char *command = mem_printf("promtool check metrics <%s", path);
    assert_int_equal(system(command), 0);
    free(command);
    free(path);
    http_answer_free(&answer);
}

static void the_master_says_that_it_lives(void **state)
{
    http_test_t *t = *state;
    assert_int_equal(status(t, "GET", "/healthz", NULL, NULL), 200);
    assert_int_equal(status(t, "GET", "/readyz", NULL, NULL), 200);
}

/* The description names the path and, below it, the method of each route. */
static void check_described(const char *description, const http_route_t *route)
{
    const char *name = strpbrk(route->path, "#@");
    char *line = name == NULL ? mem_printf("\n  %s:\n", route->path)
                              : mem_printf("\n  %.*s{%s}%s:\n", (int)(name - route->path), route->path,
                                           *name == '#' ? "job" : "blob", name + 1);
    char *method = mem_printf("\n    %s:", route->method);
    for (char *at = method; *at != '\0'; at++)
        if (*at >= 'A' && *at <= 'Z') *at = (char)(*at - 'A' + 'a');
    const char *path = strstr(description, line), *end = path != NULL ? strstr(path + 1, "\n  /") : NULL;
    const char *found = path != NULL ? strstr(path, method) : NULL;
    if (found == NULL || (end != NULL && found > end))
        fail_msg("docs/openapi.yaml lacks %s %s", route->method, route->path);
    free(line);
    free(method);
}

static void every_request_is_described(void **state)
{
    (void)state;
    const http_table_t *const tables[] = {&http_report_routes, &http_order_routes, &http_metrics_routes,
                                          &http_tile_routes,   &http_image_routes, &http_upload_routes};
    uint8_t *text;
    size_t size;
    assert_int_equal(file_read("docs/openapi.yaml", 1 << 20, &text, &size).code, RESULT_OK);
    text = mem_realloc(text, size + 1);
    text[size] = '\0';
    for (size_t t = 0; t < ARRAY_LENGTH(tables); t++)
        for (size_t r = 0; r < tables[t]->count; r++)
            check_described((const char *)text, &tables[t]->routes[r]);
    free(text);
}

/* ---- bad requests -------------------------------------------------------------------------------------- */

static void large_bodies_and_headers_are_refused(void **state)
{
    http_test_t *t = *state;
    char *large = mem_alloc(64 << 10);
    memset(large, 'x', 64 << 10);
    large[(64 << 10) - 1] = '\0';
    assert_int_equal(status(t, "GET", "/api/v1/jobs", t->tokens.view, large), 413);
    assert_int_equal(status(t, "GET", "/api/v1/jobs", NULL, large), 401);
    char *lines = mem_printf("Host: localhost\r\nX: %s\r\n", large);
    int got = status_with(t, "/", lines);
    assert_true(got == 413 || got == 431);
    free(lines);
    /* One that names no length. */
    char *bytes = mem_printf(
        "GET /api/v1/jobs HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: Bearer "
        "%s\r\nTransfer-Encoding: chunked\r\n\r\nffff\r\n%s\r\n0\r\n\r\n",
        t->tokens.view, large);
    int connection = http_open(t->port, bytes);
    char *answer = http_read_until(connection, "\r\n\r\n", 10);
    assert_non_null(answer);
    assert_non_null(strstr(answer, "HTTP/1.1 413"));
    close(connection);
    free(answer);
    free(bytes);
    free(large);
}

static void garbage_does_not_hurt(void **state)
{
    http_test_t *t = *state;
    static const char *const garbage[] = {
        "\r\n\r\n",
        "GET\r\n\r\n",
        "GET / HTTP/9.9\r\n\r\n",
        "GET /%00%ff%zz HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "POST /api/v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n",
        "\x16\x03\x01\x02"};
    for (size_t i = 0; i < ARRAY_LENGTH(garbage); i++) {
        int connection = http_open(t->port, garbage[i]);
        free(http_read_until(connection, "\r\n\r\n", 0.2));
        close(connection);
    }
    assert_int_equal(status(t, "GET", "/", NULL, NULL), 200);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
        TEST(the_api_needs_a_token),
        TEST(other_hosts_and_origins_are_refused),
        TEST(a_host_that_is_named_is_known),
        TEST(other_machines_need_tls),
        TEST(tokens_are_private_and_stay),
        TEST(the_page_is_served_without_a_token),
        TEST(jobs_and_workers_are_told),
        TEST(workers_are_wanted_while_there_is_work),
        TEST(orders_need_the_token_to_operate),
        TEST(orders_are_carried_out),
        TEST(wrong_orders_are_refused),
        TEST(orders_are_durable),
        TEST(the_error_has_a_history),
        TEST(events_tell_what_happens),
        TEST(workers_of_one_name_are_told_apart),
        TEST(a_reader_that_comes_back_loses_nothing),
        TEST(who_has_lost_events_is_told),
        TEST(a_ring_that_runs_over_is_told),
        TEST(connections_that_dawdle_are_closed),
        TEST(streams_end_with_the_master),
        TEST(streams_leave_room_for_others),
        TEST(metrics_follow_the_conventions),
        TEST(the_master_says_that_it_lives),
        cmocka_unit_test(every_request_is_described),
        TEST(large_bodies_and_headers_are_refused),
        TEST(garbage_does_not_hurt),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
