/* How people reach the page: lightmill open, and lightmill render --http. */
#include "tests/http_client.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { TOKEN = 64 }; /* characters */

/* The port and the token of the page's address in what a process has written. */
static int read_address(rig_t *rig, pid_t process, char token[TOKEN + 1])
{
    int port = 0;
    char *output = rig_output(rig, process);
    const char *address = strstr(output, "http://127.0.0.1:");
    if (address == NULL || sscanf(address, "http://127.0.0.1:%d/#token=%64[0-9a-f]", &port, token) != 2)
        fail_msg("no address in: %s", output);
    assert_int_equal(strlen(token), TOKEN);
    free(output);
    return port;
}

/* It serves the page a moment after it answers workers. */
static void start_master_with_page(rig_t *rig, const char *data)
{
    rig_start_master_on(rig, data, 1, ARGUMENTS("--http", "0"));
    rig_wait_output(rig, rig->master, "the page is at");
}

static void open_finds_the_page_of_a_master(void **state)
{
    rig_t *rig = *state;
    char token[TOKEN + 1], *data = scratch_path(rig->folder, "data");
    pid_t nobody = rig_start_command(rig, ARGUMENTS("open", "--print", "--data", data));
    assert_int_equal(rig_wait_exit(rig, nobody, 20), RESULT_INPUT);
    char *said = rig_output(rig, nobody);
    assert_non_null(strstr(said, "--http"));
    free(said);
    start_master_with_page(rig, data);
    pid_t process = rig_start_command(rig, ARGUMENTS("open", "--print", "--data", data));
    assert_int_equal(rig_wait_exit(rig, process, 20), 0);
    int port = read_address(rig, process, token);
    assert_int_equal(http_status_of(http_ask(port, "POST", "/api/v1/jobs/7/pause", token, NULL)), 404);
    process = rig_start_command(rig, ARGUMENTS("open", "--print", "--view", "--data", data));
    assert_int_equal(rig_wait_exit(rig, process, 20), 0);
    assert_int_equal(read_address(rig, process, token), port);
    assert_int_equal(http_status_of(http_ask(port, "GET", "/api/v1/jobs", token, NULL)), 200);
    assert_int_equal(http_status_of(http_ask(port, "POST", "/api/v1/jobs/7/pause", token, NULL)), 403);
    free(data);
}

/* A program "xdg-open" in a folder that PATH names first: it writes down what it is called with, and does not
 * end. */
static void put_opener_on_path(rig_t *rig)
{
    char *opener = scratch_path(rig->folder, "xdg-open"),
         *path = mem_printf("%s:%s", rig->folder, getenv("PATH"));
    char *script =
        mem_printf("#!/bin/sh\nprintf '%%s\\n' \"$@\" >%s/called.part && mv %s/called.part %s/called\n"
                   "exec sleep 30 </dev/null\n",
                   rig->folder, rig->folder, rig->folder);
    scratch_write(opener, script, strlen(script));
    assert_int_equal(chmod(opener, 0700), 0);
    setenv("PATH", path, 1);
    setenv("DISPLAY", ":test", 1);
    free(script);
    free(path);
    free(opener);
}

static char *wait_for_file(const char *path)
{
    for (int i = 0; access(path, F_OK) != 0; i++) {
        assert_true(i < 200);
        rig_sleep(0.1);
    }
    size_t size;
    char *text = (char *)scratch_read(path, &size);
    text = mem_realloc(text, size + 1);
    text[size] = '\0';
    return text;
}

static void open_gives_the_browser_a_private_file_and_does_not_wait_for_it(void **state)
{
    rig_t *rig = *state;
    char token[TOKEN + 1], *data = scratch_path(rig->folder, "data"), *keys = scratch_path(data, "keys");
    char *called = scratch_path(rig->folder, "called"), *stale = scratch_path(keys, "open-1.html");
    char *other = scratch_path(keys, "open-source.html");
    struct stat status;
    put_opener_on_path(rig);
    start_master_with_page(rig, data);
    scratch_write(stale, "", 0);
    scratch_write(other, "", 0);
    assert_int_equal(utimes(stale, (struct timeval[2]){{1000, 0}, {1000, 0}}), 0);
    assert_int_equal(utimes(other, (struct timeval[2]){{1000, 0}, {1000, 0}}), 0);
    pid_t process = rig_start_command(rig, ARGUMENTS("open", "--data", data));
    assert_int_equal(rig_wait_exit(rig, process, 20), 0); /* the opener sleeps for longer */
    int port = read_address(rig, process, token);
    char *page = wait_for_file(called);
    page[strcspn(page, "\n")] = '\0';
    assert_int_equal(page[0], '/');
    assert_null(strstr(page, token));
    assert_int_equal(stat(page, &status), 0);
    assert_int_equal(status.st_mode & 0777, 0600);
    char *text = wait_for_file(page),
         *target = mem_printf("url=http://127.0.0.1:%d/#token=%s\"", port, token);
    assert_non_null(strstr(text, target));
    assert_int_not_equal(access(stale, F_OK), 0);
    assert_int_equal(access(other, F_OK), 0);
    char *garbage[] = {text, target, page, other, stale, called, keys, data};
    for (size_t i = 0; i < ARRAY_LENGTH(garbage); i++) free(garbage[i]);
}

static void open_gives_no_token_to_the_address_of_a_dead_master(void **state)
{
    rig_t *rig = *state;
    char *data = scratch_path(rig->folder, "data"), *file = scratch_path(data, "http");
    start_master_with_page(rig, data);
    rig_kill_master(rig);
    assert_int_equal(access(file, F_OK), 0);
    pid_t process = rig_start_command(rig, ARGUMENTS("open", "--print", "--data", data));
    assert_int_equal(rig_wait_exit(rig, process, 20), RESULT_INPUT);
    char *said = rig_output(rig, process);
    assert_null(strstr(said, "token"));
    free(said);
    free(file);
    free(data);
}

static void a_render_on_this_machine_has_a_page(void **state)
{
    rig_t *rig = *state;
    char token[TOKEN + 1], *image = scratch_path(rig->folder, "a.exr");
    pid_t process = rig_start_command(rig, ARGUMENTS("render", "scenes/cornell", "--resolution", "64x64",
                                                     "--time", "600", "--quiet", "--http", "0", "-o", image));
    rig_wait_output(rig, process, "#token=");
    int port = read_address(rig, process, token);
    /* One without samples would be cancelled without an image. */
    for (json_int_t samples = 0; samples == 0; rig_sleep(0.1)) {
        json_t *root = http_json_of(http_ask(port, "GET", "/api/v1/jobs", token, NULL), 200);
        const json_t *job = json_array_get(json_object_get(root, "jobs"), 0);
        samples = json_integer_value(json_object_get(job, "samples_done"));
        json_decref(root);
    }
    assert_int_equal(http_status_of(http_ask(port, "POST", "/api/v1/jobs/1/cancel", token, NULL)), 200);
    assert_int_equal(rig_wait_exit(rig, process, 60), 0);
    free(image);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(open_finds_the_page_of_a_master, rig_set_up, rig_tear_down),
        cmocka_unit_test_setup_teardown(open_gives_the_browser_a_private_file_and_does_not_wait_for_it,
                                        rig_set_up, rig_tear_down),
        cmocka_unit_test_setup_teardown(open_gives_no_token_to_the_address_of_a_dead_master, rig_set_up,
                                        rig_tear_down),
        cmocka_unit_test_setup_teardown(a_render_on_this_machine_has_a_page, rig_set_up, rig_tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
