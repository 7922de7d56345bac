/* Tests of tests/run.sh: all programs are run and counted, and those that wait run side by side, with ports
 * of their own. The programs here are scripts; they have the names of real ones where tests/costs.txt is to
 * know them. */
#include "common/base.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#define PASSES "echo '[  PASSED  ] 2 test(s).'\n"

typedef struct {
    char *folder; /* has the folder "tests", and what the programs write */
    char *output; /* of the last run */
    int code;     /* its exit code */
} run_t;

static int set_up(void **state)
{
    run_t *run = mem_zalloc(1, sizeof *run);
    run->folder = scratch_new();
    *state = run;
    return 0;
}

static int tear_down(void **state)
{
    run_t *run = *state;
    scratch_destroy(&run->folder);
    free(run->output);
    free(run);
    return 0;
}

/* Runs a command and returns its exit code. Takes the text over. */
static int shell(char *command)
{
    int status = system(command);
    free(command);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

/* A script for sh in $FOLDER; `name` is as "unit/test_a". */
static void add(const run_t *run, const char *name, const char *body)
{
    char *path = mem_printf("%s/tests/%s", run->folder, name);
    char *text = mem_printf("#!/bin/sh\ncd '%s'\n%s", run->folder, body);
    assert_int_equal(shell(mem_printf("mkdir -p \"$(dirname '%s')\"", path)), 0);
    scratch_write(path, text, strlen(text));
    assert_int_equal(chmod(path, 0755), 0);
    free(text);
    free(path);
}

/* Runs all that was added, each for `limit` seconds at most. */
static void run_all(run_t *run, const char *options, int limit)
{
    char *path = scratch_path(run->folder, "output");
    size_t size;
    run->code =
        shell(mem_printf("TEST_TIMEOUT=%d tests/run.sh %s $(find '%s/tests' -name 'test_*') >'%s' 2>&1",
                         limit, options, run->folder, path));
    run->output = (char *)scratch_read(path, &size);
    free(path);
}

static void assert_says(const run_t *run, const char *text)
{
    if (strstr(run->output, text) == NULL) fail_msg("no '%s' in:\n%s", text, run->output);
}

static void assert_ends_with(const run_t *run, const char *line)
{
    size_t all = strlen(run->output), length = strlen(line);
    if (all < length || strcmp(run->output + all - length, line) != 0)
        fail_msg("no '%s' at the end of:\n%s", line, run->output);
}

static void whatever_becomes_of_a_program_it_is_counted(void **state)
{
    run_t *run = *state;
    add(run, "unit/test_good", PASSES);
    add(run, "farm/test_good", PASSES);
    add(run, "statistics/test_good", PASSES);
    add(run, "unit/test_bad", PASSES "echo 'what is wrong'; echo '[  FAILED  ] 1 test(s)'; exit 1\n");
    add(run, "unit/test_crash", "kill -SEGV $$\n");
    add(run, "farm/test_slow", "sleep 20\n");
    run_all(run, "-j 2", 3);
    assert_int_equal(run->code, 1);
    assert_says(run, "what is wrong");
    assert_says(run, "(exit code 139)");
    assert_says(run, "(no end within 3 s)");
    assert_ends_with(run, "\n8 passed, 3 failed\n");
}

static void all_is_well_when_all_pass(void **state)
{
    run_t *run = *state;
    char name[40];
    for (int i = 0; i < 30; i++) {
        snprintf(name, sizeof name, "unit/test_%d", i);
        add(run, name, PASSES);
    }
    run_all(run, "-j 4", 60);
    assert_int_equal(run->code, 0);
    assert_ends_with(run, "\n60 passed, 0 failed\n");
}

/* Each says which ports are its own, and waits until the other has said so too: on one core, since both wait.
 */
static void programs_that_wait_run_together_on_ports_of_their_own(void **state)
{
    run_t *run = *state;
    static const char *const names[] = {"test_http", "test_tiles"};
    int first[2], last[2];
    for (int i = 0; i < 2; i++) {
        char *name = mem_printf("unit/master/%s", names[i]);
        char *body = mem_printf("echo $TEST_PORTS >new-%s; mv new-%s %s\n"
                                "for i in $(seq 1000); do [ -e %s ] && %s\nsleep 0.01; done; exit 1\n",
                                names[i], names[i], names[i], names[1 - i], "exec " PASSES);
        add(run, name, body);
        free(body);
        free(name);
    }
    run_all(run, "-j 1", 60);
    assert_ends_with(run, "\n4 passed, 0 failed\n");
    for (int i = 0; i < 2; i++) {
        char *path = scratch_path(run->folder, names[i]);
        size_t size;
        char *range = (char *)scratch_read(path, &size);
        assert_int_equal(sscanf(range, "%d-%d", &first[i], &last[i]), 2);
        assert_true(first[i] > 1024 && first[i] + 100 < last[i] && last[i] < 32768);
        free(range);
        free(path);
    }
    assert_true(last[0] < first[1] || last[1] < first[0]);
}

/* Under a sanitizer two that start processes do not run together, though they wait. */
static void apart_they_have_the_machine_to_themselves(void **state)
{
    run_t *run = *state;
    static const char body[] = "mkdir busy || exit 1\nsleep 0.1\nrmdir busy\n" PASSES;
    add(run, "farm/test_scale", body);
    add(run, "farm/test_links", body);
    run_all(run, "-j 2 --apart", 60);
    assert_int_equal(run->code, 0);
    assert_ends_with(run, "\n4 passed, 0 failed\n");
}

/* One leaves something in the folder, and the other finds it; nothing is left for the next run. */
static void programs_of_a_run_share_a_folder(void **state)
{
    run_t *run = *state;
    add(run, "unit/test_a", "cd \"$LIGHTMILL_REFERENCES\" && [ ! -e it ] && echo of a >it && " PASSES);
    add(run, "unit/test_b",
        "cd \"$LIGHTMILL_REFERENCES\" || exit 1\n"
        "for i in $(seq 1000); do [ -s it ] && exec " PASSES "sleep 0.01; done; exit 1\n");
    for (int i = 0; i < 2; i++) {
        run_all(run, "-j 2", 60);
        assert_ends_with(run, "\n4 passed, 0 failed\n");
        free(run->output);
        run->output = NULL;
        assert_int_equal(shell(mem_printf("rm '%s'/tests/unit/*.log", run->folder)), 0);
    }
}

/* What computes for minutes and waits for nothing stands back. */
static void statistics_have_the_lowest_priority(void **state)
{
    run_t *run = *state;
    add(run, "statistics/test_a", "[ $(nice) = 19 ] || exit 1\n" PASSES);
    run_all(run, "-j 2", 60);
    assert_ends_with(run, "\n2 passed, 0 failed\n");
}

int main(void)
{
#define RUN(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        RUN(whatever_becomes_of_a_program_it_is_counted),
        RUN(all_is_well_when_all_pass),
        RUN(programs_that_wait_run_together_on_ports_of_their_own),
        RUN(apart_they_have_the_machine_to_themselves),
        RUN(programs_of_a_run_share_a_folder),
        RUN(statistics_have_the_lowest_priority),
    };
    return cmocka_run_group_tests_name("run", tests, NULL, NULL);
}
