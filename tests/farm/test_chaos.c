/* A short storm of `make chaos`, with a fixed list of faults: real processes are killed, stopped, cut off and
 * fed garbage, and every image still has the bits of an undisturbed render. */
#include "tests/chaos/process.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static void nothing_is_lost_in_a_storm(void **state)
{
    (void)state;
    char *program = process_program("tests/chaos/chaos");
    fflush(NULL);
    pid_t process = fork();
    if (process == 0) {
        /* At this length: some 20 faults, and 4 or 5 deaths of the master. */
        const char *folder = getenv("TMPDIR");
        execl(program, program, "--seconds", "16", "--pause", "0.6", "--seed", "3", "--least", "8",
              "--least-kills", "2", "--smaller", "2", "--folder", folder ? folder : "/tmp", NULL);
        _exit(127);
    }
    int status = -1;
    assert_int_equal(waitpid(process, &status, 0), process);
    assert_true(WIFEXITED(status));
    assert_int_equal(WEXITSTATUS(status), 0);
    free(program);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nothing_is_lost_in_a_storm),
    };
    return cmocka_run_group_tests_name("chaos", tests, NULL, NULL);
}
