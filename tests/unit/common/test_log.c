/* Tests of log_write (common/base.h): what a stranger's name can do to the log. */
#include "common/base.h"
#include "tests/scratch.h"

#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* "2026-01-31T09:05:00+01:00 " */
static const char TIME[] = "dddd-dd-ddTdd:dd:dd+dd:dd ";

/* True when the text begins like TIME, in which d stands for a digit, and + for a sign. */
static bool begins_with_a_time(const char *text)
{
    for (const char *t = TIME; *t != '\0'; t++, text++) {
        bool fits = *t == 'd'   ? *text >= '0' && *text <= '9'
                    : *t == '+' ? *text == '+' || *text == '-'
                                : *t == *text;
        if (!fits) return false;
    }
    return true;
}

static char offset[7]; /* from UTC, in the last line that was looked at */

/* What the log says of a name, without the time; fresh memory. */
static char *logged(const char *name)
{
    char *folder = scratch_new(), *path = scratch_path(folder, "log");
    int old = dup(STDERR_FILENO), file = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    char text[1200];
    assert_true(old >= 0 && file >= 0);
    log_init("test", LOG_INFO);
    dup2(file, STDERR_FILENO);
    log_info("job 1: %s", name);
    dup2(old, STDERR_FILENO);
    ssize_t size = pread(file, text, sizeof text - 1, 0);
    close(old);
    close(file);
    scratch_destroy(&folder);
    free(path);
    assert_true(size > 0);
    text[size] = '\0';
    assert_true(begins_with_a_time(text));
    snprintf(offset, sizeof offset, "%.6s", text + strlen("2026-01-31T09:05:00"));
    return mem_strdup(text + sizeof TIME - 1);
}

static void a_name_commands_no_terminal_and_begins_no_line(void **state)
{
    (void)state;
    static const struct {
        const char *name, *line;
    } cases[] = {{"plain", "test info: job 1: plain\n"},
                 {"Größe λ", "test info: job 1: Größe λ\n"},
                 {"a\n12:00:00 master error: b", "test info: job 1: a?12:00:00 master error: b\n"},
                 {"\x1b[2J\r\t\x7f", "test info: job 1: ?[2J???\n"},
                 {"\xc2\x9b"
                  "2J\xc2\xa0\xc2",
                  "test info: job 1: ?2J\xc2\xa0?\n"},
                 {"moc.\u202elive\u2069", "test info: job 1: moc.?live?\n"},
                 {"\xff\xc0\x80\xed\xa0\x80", "test info: job 1: ??????\n"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        char *line = logged(cases[i].name);
        assert_string_equal(line, cases[i].line);
        free(line);
    }
}

static void the_time_is_that_of_the_machines_zone(void **state)
{
    (void)state;
    static const struct {
        const char *zone, *offset;
    } cases[] = {{"UTC0", "+00:00"}, {"AAA-5:30", "+05:30"}, {"BBB3:30", "-03:30"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        setenv("TZ", cases[i].zone, 1);
        tzset();
        free(logged("a"));
        assert_int_equal(strncmp(offset, cases[i].offset, 6), 0);
    }
    unsetenv("TZ");
    tzset();
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_name_commands_no_terminal_and_begins_no_line),
                                       cmocka_unit_test(the_time_is_that_of_the_machines_zone)};
    return cmocka_run_group_tests_name("log", tests, NULL, NULL);
}
