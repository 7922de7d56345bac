/* The state of health that a process tells on a Unix socket. */
#include "common/health.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cmocka.h>

static bool report(void *context, char *text, size_t size)
{
    const atomic_bool *well = context;
    snprintf(text, size, "3 workers");
    return atomic_load(well);
}

static void tells_how_it_is(void **state)
{
    char *path = scratch_path(*state, "health"), text[100];
    atomic_bool well = true;
    health_t *health;
    assert_int_equal(health_start(path, report, &well, &health).code, RESULT_OK);
    assert_int_equal(health_ask(path, text, sizeof text).code, RESULT_OK);
    assert_string_equal(text, "3 workers");
    atomic_store(&well, false);
    result_t result = health_ask(path, text, sizeof text);
    assert_int_equal(result.code, RESULT_MISMATCH);
    assert_string_equal(result.message, "failing 3 workers");
    struct stat status;
    assert_int_equal(stat(path, &status), 0);
    assert_int_equal(status.st_mode & 077, 0); /* for the owner alone */
    health_stop(&health);
    assert_null(health);
    assert_int_equal(health_ask(path, text, sizeof text).code, RESULT_UNREACHABLE);
    assert_int_not_equal(stat(path, &status), 0);
    free(path);
}

static void a_dead_process_is_replaced_a_living_one_is_not(void **state)
{
    char *path = scratch_path(*state, "health"), text[100];
    atomic_bool well = true;
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    snprintf(address.sun_path, sizeof address.sun_path, "%s", path);
    int dead = socket(AF_UNIX, SOCK_STREAM, 0);
    assert_int_equal(bind(dead, (struct sockaddr *)&address, sizeof address), 0);
    close(dead); /* its file stays, as after a kill */
    health_t *first, *second;
    assert_int_equal(health_start(path, report, &well, &first).code, RESULT_OK);
    assert_int_equal(health_start(path, report, &well, &second).code, RESULT_USAGE);
    assert_int_equal(health_ask(path, text, sizeof text).code, RESULT_OK);
    health_stop(&first);
    free(path);
}

static void a_file_that_is_no_socket_stays(void **state)
{
    char *path = scratch_path(*state, "notes");
    health_t *health;
    scratch_write(path, "notes", 5);
    assert_int_equal(health_start(path, report, NULL, &health).code, RESULT_IO);
    assert_int_equal(access(path, F_OK), 0);
    unlink(path);
    free(path);
}

static void a_process_that_hangs_is_not_waited_for(void **state)
{
    char *path = scratch_path(*state, "health"), text[100];
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    snprintf(address.sun_path, sizeof address.sun_path, "%s", path);
    int hanging = socket(AF_UNIX, SOCK_STREAM, 0);
    assert_int_equal(bind(hanging, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(listen(hanging, 1), 0);
    assert_int_equal(health_ask(path, text, sizeof text).code, RESULT_UNREACHABLE);
    /* Nor when so many have asked in vain that there is no room for one more. */
    int asking[4];
    for (size_t i = 0; i < ARRAY_LENGTH(asking); i++) {
        asking[i] = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0);
        connect(asking[i], (struct sockaddr *)&address, sizeof address);
    }
    alarm(30);
    assert_int_equal(health_ask(path, text, sizeof text).code, RESULT_UNREACHABLE);
    health_t *health;
    assert_int_equal(health_start(path, report, NULL, &health).code, RESULT_USAGE);
    alarm(0);
    for (size_t i = 0; i < ARRAY_LENGTH(asking); i++) close(asking[i]);
    close(hanging);
    unlink(path);
    free(path);
}

static void a_pulse_tells_whether_a_loop_turns(void **state)
{
    (void)state;
    pulse_t pulse = {0};
    char text[100];
    assert_true(pulse_report(&pulse, text, sizeof text));
    assert_string_equal(text, "starting");
    pulse_beat(&pulse, "has a master");
    assert_true(pulse_report(&pulse, text, sizeof text));
    assert_string_equal(text, "has a master");
    atomic_store(&pulse.beat, (long long)(1e3 * (clock_now() - 2 * PULSE_LATE)));
    assert_false(pulse_report(&pulse, text, sizeof text));
    assert_non_null(strstr(text, "no sign of life"));
}

static void paths_that_cannot_be_are_errors(void **state)
{
    (void)state;
    char longest[300], text[100];
    health_t *health;
    memset(longest, 'x', sizeof longest);
    longest[sizeof longest - 1] = '\0';
    assert_int_equal(health_start(longest, report, NULL, &health).code, RESULT_USAGE);
    assert_int_equal(health_ask(longest, text, sizeof text).code, RESULT_USAGE);
    assert_int_equal(health_start("/no/such/directory/x", report, NULL, &health).code, RESULT_IO);
}

static int setup(void **state)
{
    *state = scratch_new();
    return 0;
}

static int teardown(void **state)
{
    scratch_destroy((char **)state);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(tells_how_it_is, setup, teardown),
        cmocka_unit_test_setup_teardown(a_file_that_is_no_socket_stays, setup, teardown),
        cmocka_unit_test_setup_teardown(a_dead_process_is_replaced_a_living_one_is_not, setup, teardown),
        cmocka_unit_test_setup_teardown(a_process_that_hangs_is_not_waited_for, setup, teardown),
        cmocka_unit_test(a_pulse_tells_whether_a_loop_turns),
        cmocka_unit_test(paths_that_cannot_be_are_errors),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
