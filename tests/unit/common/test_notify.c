/* Tests of common/notify: what is told, real commands and a real HTTP server that are told it, and all that
 * they may do wrong. */
#include "common/notify/notify.h"
#include "tests/hook.h"
#include "tests/scratch.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

static const news_t NEWS = {.job = 7,
                            .name = "cornell",
                            .state = "done",
                            .message = "",
                            .samples = 65536,
                            .spp = 64,
                            .error = 0.0125,
                            .elapsed = 12.5,
                            .image = "/data/job-7.exr"};

static void assert_fails(result_t result, const char *why)
{
    assert_int_equal(result.code, RESULT_IO);
    if (strstr(result.message, why) == NULL) fail_msg("not \"%s\" but \"%s\"", why, result.message);
}

/* A file as a string; fresh memory. */
static char *text_of(const char *path)
{
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    char *text = mem_zalloc(1, size + 1);
    memcpy(text, bytes, size);
    free(bytes);
    return text;
}

static void assert_has(const char *text, const char *part)
{
    if (strstr(text, part) == NULL) fail_msg("there is no \"%s\" in: %s", part, text);
}

/* ---- news ---------------------------------------------------------------------------------------------- */

static json_t *parse(const news_t *news)
{
    char *text = news_json(news);
    json_error_t error;
    json_t *object = json_loads(text, 0, &error);
    if (object == NULL) fail_msg("%s: %s", error.text, text);
    assert_null(strchr(text, '\n'));
    free(text);
    return object;
}

static void the_json_says_all_of_the_job(void **state)
{
    (void)state;
    const char *name, *job_state, *message, *text, *image, *host;
    json_int_t job, samples;
    double spp, error, elapsed;
    json_t *object = parse(&NEWS);
    assert_int_equal(json_unpack(object, "{s:I, s:s, s:s, s:s, s:s, s:I, s:F, s:F, s:F, s:s, s:s !}", "job",
                                 &job, "name", &name, "state", &job_state, "message", &message, "text", &text,
                                 "samples", &samples, "spp", &spp, "error", &error, "elapsed", &elapsed,
                                 "image", &image, "host", &host),
                     0);
    assert_int_equal(job, 7);
    assert_string_equal(name, "cornell");
    assert_string_equal(job_state, "done");
    assert_string_equal(message, "");
    assert_string_equal(text, "job 7 (cornell) is done");
    assert_int_equal(samples, 65536);
    assert_true(spp == 64 && error == 0.0125 && elapsed == 12.5);
    assert_string_equal(image, "/data/job-7.exr");
    assert_true(strlen(host) > 0);
    json_decref(object);
}

static void what_is_not_known_is_null(void **state)
{
    (void)state;
    news_t news = NEWS;
    news.state = "failed";
    news.message = "no worker can render it";
    news.error = 0;
    news.image = NULL;
    json_t *object = parse(&news);
    assert_true(json_is_null(json_object_get(object, "error")));
    assert_true(json_is_null(json_object_get(object, "image")));
    assert_string_equal(json_string_value(json_object_get(object, "text")),
                        "job 7 (cornell) failed: no worker can render it");
    json_decref(object);
}

/* A client chooses the name. */
static void names_cannot_break_lines_or_json(void **state)
{
    (void)state;
    news_t news = NEWS;
    news.name = "a\r\nBcc: all@example.org\t\"\\\xff\x1b[2J";
    json_t *object = parse(&news);
    assert_string_equal(json_string_value(json_object_get(object, "name")),
                        "a  Bcc: all@example.org \"\\? [2J");
    json_decref(object);
    news.name = "K\xc3\xbc"
                "che";
    object = parse(&news);
    assert_string_equal(json_string_value(json_object_get(object, "name")), news.name);
    json_decref(object);
}

/* ---- targets ------------------------------------------------------------------------------------------- */

static result_t take(const char *text)
{
    const char *field = NULL;
    option_t option = {.name = "notify"};
    result_t result = option_notify(&option, text, &field);
    if (result.code == RESULT_OK) assert_ptr_equal(field, text);
    return result;
}

static void only_what_can_be_told_is_taken(void **state)
{
    (void)state;
    static const char *const good[] = {"http://h",     "HTTPS://h/x?y", "mail me",
                                       "curl ftp://h", "./a://b",       "URL=x://y tell"};
    static const char *const bad[] = {"", "  ", "ftp://h/x", "file:///etc/passwd", "gopher://h tell"};
    for (size_t i = 0; i < ARRAY_LENGTH(good); i++) assert_int_equal(take(good[i]).code, RESULT_OK);
    for (size_t i = 0; i < ARRAY_LENGTH(bad); i++) assert_int_equal(take(bad[i]).code, RESULT_USAGE);
}

static void the_log_sees_no_secrets(void **state)
{
    (void)state;
    static const char *const labels[][2] = {
        {"https://hooks.example.org/T0/SECRET", "https://hooks.example.org"},
        {"http://me:SECRET@host:81?SECRET", "http://host:81"},
        {"http://me:SEC@RET@host/", "http://host"},
        {"http://host", "http://host"},
        {"curl -H 'Authorization: SECRET' https://h", "the command"}};
    for (size_t i = 0; i < ARRAY_LENGTH(labels); i++) {
        char *label = notify_label(labels[i][0]);
        assert_string_equal(label, labels[i][1]);
        free(label);
    }
}

/* ---- commands ------------------------------------------------------------------------------------------ */

typedef struct {
    char *folder, *input, *other;
} place_t;

static int set_up(void **state)
{
    place_t *place = mem_zalloc(1, sizeof *place);
    place->folder = scratch_new();
    place->input = scratch_path(place->folder, "input");
    place->other = scratch_path(place->folder, "other");
    setenv("FOLDER", place->folder, 1);
    *state = place;
    return 0;
}

static int tear_down(void **state)
{
    place_t *place = *state;
    free(place->input);
    free(place->other);
    scratch_destroy(&place->folder);
    free(place);
    return 0;
}

static void a_command_gets_the_json_and_variables(void **state)
{
    place_t *place = *state;
    news_t news = NEWS;
    news.name = "x; touch $FOLDER/pwned `touch $FOLDER/pwned` $(touch $FOLDER/pwned)";
    setenv("LIGHTMILL_NOTIFY", "a secret", 1);
    setenv("LIGHTMILL_STATE", "a lie", 1);
    setenv("LIGHTMILL_MASTER", "first", 1);
    result_t result = notify_once("cat >$FOLDER/input; env >$FOLDER/other; echo $LIGHTMILL_NAME >/dev/null",
                                  &news, 10, NULL);
    unsetenv("LIGHTMILL_NOTIFY");
    unsetenv("LIGHTMILL_STATE");
    unsetenv("LIGHTMILL_MASTER");
    assert_int_equal(result.code, RESULT_OK);
    char *json = news_json(&news), *input = text_of(place->input), *other = text_of(place->other);
    assert_string_equal(input, json);
    static const char *const variables[] = {"\nLIGHTMILL_JOB=7\n",
                                            "\nLIGHTMILL_NAME=x; touch",
                                            "\nLIGHTMILL_STATE=done\n",
                                            "\nLIGHTMILL_MESSAGE=\n",
                                            "\nLIGHTMILL_TEXT=job 7",
                                            "\nLIGHTMILL_SAMPLES=65536\n",
                                            "\nLIGHTMILL_SPP=64\n",
                                            "\nLIGHTMILL_ERROR=0.0125\n",
                                            "\nLIGHTMILL_ELAPSED=12.5\n",
                                            "\nLIGHTMILL_HOST=",
                                            "\nLIGHTMILL_IMAGE=/data/job-7.exr\n",
                                            "\nLIGHTMILL_MASTER=first\n"};
    for (size_t i = 0; i < ARRAY_LENGTH(variables); i++) assert_has(other, variables[i]);
    assert_null(strstr(other, "a secret"));
    assert_null(strstr(other, "a lie"));
    assert_int_equal(scratch_count(place->folder), 2); /* nothing of the name was run */
    free(json);
    free(input);
    free(other);
}

static void a_command_that_reads_nothing_is_told_too(void **state)
{
    (void)state;
    assert_int_equal(notify_once("true", &NEWS, 10, NULL).code, RESULT_OK);
}

static void a_command_that_fails_says_how(void **state)
{
    (void)state;
    assert_fails(notify_once("exit 3", &NEWS, 10, NULL), "exit code 3");
    assert_fails(notify_once("kill -9 $$", &NEWS, 10, NULL), "signal 9");
    assert_fails(notify_once("/no/such/program 2>/dev/null", &NEWS, 10, NULL), "exit code 127");
}

/* Waits for the process whose number is in a file, which has become our child: the signal that ended it. */
static int signal_of(const char *path)
{
    int status;
    char *text = text_of(path);
    pid_t process = (pid_t)strtol(text, NULL, 10);
    free(text);
    assert_true(process > 1);
    double deadline = clock_now() + 20;
    while (waitpid(process, &status, WNOHANG) == 0) {
        if (clock_now() > deadline) fail_msg("process %d lives", (int)process);
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    }
    assert_true(WIFSIGNALED(status));
    return WTERMSIG(status);
}

static void a_command_that_hangs_is_killed_with_its_children(void **state)
{
    place_t *place = *state;
    prctl(PR_SET_CHILD_SUBREAPER, 1);
    double begin = clock_now();
    assert_fails(notify_once("sleep 1000 & echo $! >$FOLDER/input; wait", &NEWS, 0.3, NULL), "within 0.3 s");
    assert_true(clock_now() - begin < 5);
    assert_int_equal(signal_of(place->input), SIGTERM);
    assert_fails(notify_once("trap '' TERM; sleep 1000 & echo $! >$FOLDER/other; wait", &NEWS, 0.3, NULL),
                 "within 0.3 s");
    assert_int_equal(signal_of(place->other), SIGKILL);
    prctl(PR_SET_CHILD_SUBREAPER, 0);
}

static void a_command_inherits_no_file_and_no_ignored_signal(void **state)
{
    place_t *place = *state;
    int file = open("/dev/null", O_RDONLY); /* not to be closed by exec */
    assert_int_equal(fcntl(file, F_DUPFD, 100), 100);
    signal(SIGPIPE, SIG_IGN);
    result_t result = notify_once("test ! -e /proc/self/fd/100 && "
                                  "grep SigIgn /proc/self/status >$FOLDER/input",
                                  &NEWS, 10, NULL);
    close(100);
    close(file);
    assert_int_equal(result.code, RESULT_OK);
    char *text = text_of(place->input);
    assert_has(text, "SigIgn:");
    assert_int_equal(strtoull(text + strlen("SigIgn:"), NULL, 16) >> (SIGPIPE - 1) & 1, 0);
    free(text);
}

static atomic_bool stop;

static void *stop_soon(void *argument)
{
    (void)argument;
    nanosleep(&(struct timespec){.tv_nsec = 200000000}, NULL);
    atomic_store(&stop, true);
    return NULL;
}

/* An attempt that would last, stopped after 0.2 s. */
static void assert_stops(const char *target)
{
    pthread_t thread;
    atomic_store(&stop, false);
    assert_int_equal(pthread_create(&thread, NULL, stop_soon, NULL), 0);
    double begin = clock_now();
    assert_int_equal(notify_once(target, &NEWS, 60, &stop).code, RESULT_CANCELLED);
    assert_true(clock_now() - begin < 5);
    pthread_join(thread, NULL);
}

/* ---- URLs ---------------------------------------------------------------------------------------------- */

static void a_url_gets_the_json(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){204}, 1);
    assert_int_equal(notify_once(hook_url(hook), &NEWS, 10, NULL).code, RESULT_OK);
    char *request = hook_wait(hook, 0, 0), *json = news_json(&NEWS);
    assert_has(request, "POST /secret HTTP/1.1\r\n");
    assert_has(request, "\r\nContent-Type: application/json\r\n");
    assert_has(request, json);
    free(json);
    free(request);
    hook_stop(&hook);
}

static void a_url_that_fails_twice_is_told_at_last(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){503, 429, 200}, 3);
    double begin = clock_now();
    assert_int_equal(notify_insist(hook_url(hook), &NEWS, 10, 30).code, RESULT_OK);
    assert_int_equal(hook_count(hook), 3);
    assert_true(clock_now() - begin >= 2.9); /* after one second, and two more */
    hook_stop(&hook);
}

static void patience_ends(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){500}, 1);
    assert_fails(notify_insist(hook_url(hook), &NEWS, 10, 2), "status 500");
    assert_int_equal(hook_count(hook), 2); /* the third would have come after three seconds */
    hook_stop(&hook);
}

static void a_url_that_says_nothing_holds_up_for_the_limit_only(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){HOOK_SILENCE}, 1);
    double begin = clock_now();
    assert_fails(notify_once(hook_url(hook), &NEWS, 0.3, NULL), "timed out");
    assert_true(clock_now() - begin < 5);
    hook_stop(&hook);
}

/* A redirection could lead to where the operator did not want to go. */
static void redirections_are_not_followed(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){307, 200}, 2);
    assert_fails(notify_once(hook_url(hook), &NEWS, 10, NULL), "status 307: give the address");
    assert_int_equal(hook_count(hook), 1);
    hook_stop(&hook);
}

static void nobody_there_is_an_error_without_the_secret(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){200}, 1);
    char *url = mem_strdup(hook_url(hook));
    hook_stop(&hook);
    result_t result = notify_once(url, &NEWS, 10, NULL);
    assert_fails(result, "127.0.0.1");
    assert_null(strstr(result.message, "secret"));
    free(url);
}

static void an_attempt_ends_when_it_is_to_end(void **state)
{
    (void)state;
    hook_t *hook = hook_start(0, (int[]){HOOK_SILENCE}, 1);
    assert_stops(hook_url(hook));
    assert_stops("sleep 1000");
    hook_stop(&hook);
}

static void pauses_grow_to_a_minute(void **state)
{
    (void)state;
    static const double pauses[] = {1, 2, 4, 8, 16, 32, 60, 60};
    for (uint32_t i = 0; i < ARRAY_LENGTH(pauses); i++) assert_true(notify_pause(i + 1) == pauses[i]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_json_says_all_of_the_job),
        cmocka_unit_test(what_is_not_known_is_null),
        cmocka_unit_test(names_cannot_break_lines_or_json),
        cmocka_unit_test(only_what_can_be_told_is_taken),
        cmocka_unit_test(the_log_sees_no_secrets),
        cmocka_unit_test_setup_teardown(a_command_gets_the_json_and_variables, set_up, tear_down),
        cmocka_unit_test(a_command_that_reads_nothing_is_told_too),
        cmocka_unit_test(a_command_that_fails_says_how),
        cmocka_unit_test_setup_teardown(a_command_that_hangs_is_killed_with_its_children, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_command_inherits_no_file_and_no_ignored_signal, set_up, tear_down),
        cmocka_unit_test(a_url_gets_the_json),
        cmocka_unit_test(a_url_that_fails_twice_is_told_at_last),
        cmocka_unit_test(patience_ends),
        cmocka_unit_test(a_url_that_says_nothing_holds_up_for_the_limit_only),
        cmocka_unit_test(redirections_are_not_followed),
        cmocka_unit_test(nobody_there_is_an_error_without_the_secret),
        cmocka_unit_test(an_attempt_ends_when_it_is_to_end),
        cmocka_unit_test(pauses_grow_to_a_minute),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
