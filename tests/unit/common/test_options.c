/* Tests of command lines: how a table of options is read, and what it says when it is not understood. */
#include "common/options/options.h"
#include "tests/scratch.h"

#include <limits.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { KIND_RED = 1, KIND_GREEN, KIND_BLUE };

typedef struct {
    bool flag;
    const char *text;
    int32_t whole;
    uint32_t count;
    uint64_t large, bytes;
    double real, share, pause;
    int kind;
    option_list_t list;
} part_t;

typedef struct {
    int before; /* so that the part is not at offset 0 */
    part_t part;
} values_t;

static const char *const kinds[] = {"red", "green", "blue", NULL};

static const option_t rows[] = {
    OPTION(part_t, flag, "flag", NULL, "a flag"),
    OPTION(part_t, text, "text", "TEXT", "a text", .letter = 't', .environment = "LIGHTMILL_TEST_TEXT"),
    OPTION(part_t, whole, "whole", "N", "a whole number", OPTION_RANGE(-5, 5)),
    OPTION(part_t, count, "count", "N", "a count", OPTION_RANGE(1, 100)),
    OPTION(part_t, large, "large", "N", "a large count", OPTION_RANGE(0, 1e15)),
    OPTION(part_t, real, "real", "X", "a number", OPTION_RANGE(0.5, 2)),
    OPTION_BY(option_share, part_t, share, "share", "SHARE", "a share"),
    OPTION_BY(option_gigabytes, part_t, bytes, "bytes", "GB", "gigabytes", OPTION_RANGE(0, 1e6)),
    OPTION_BY(option_choice, part_t, kind, "kind", "KIND", "a kind", .choices = kinds),
    OPTION(part_t, pause, "pause", "SECONDS", "a pause", OPTION_RANGE(1, 9), .implied = "2"),
    OPTION(part_t, list, "list", "A B ...", "a list", .many = true),
};
static const option_group_t group = OPTION_GROUP("Parts", rows);

/* What the last run of the command saw. */
static values_t seen;
static char seen_arguments[200], seen_list[200];

static void join(char *text, int count, const char *const *words)
{
    text[0] = '\0';
    for (int i = 0; i < count; i++) {
        if (i > 0) strcat(text, " ");
        strcat(text, words[i]);
    }
}

static result_t run(const call_t *call)
{
    seen = *(values_t *)call->values;
    join(seen_arguments, call->count, (const char *const *)call->arguments);
    join(seen_list, (int)seen.part.list.count, seen.part.list.texts);
    return result_ok();
}

static void begin(void *data)
{
    ((values_t *)data)->part.whole = -4;
}

static const command_t command = {.name = "test part",
                                  .arguments = "[A] [B] [C]",
                                  .summary = "a test",
                                  .about = "Tests.",
                                  .groups = {{&group, offsetof(values_t, part)}},
                                  .size = sizeof(values_t),
                                  .begin = begin,
                                  .run = run};

static result_t read_line(const char *first, va_list list)
{
    char *argv[16] = {"part"};
    int argc = 1;
    for (const char *word = first; word != NULL && argc < 15; word = va_arg(list, const char *))
        argv[argc++] = (char *)word;
    return command_run(&command, argc, argv);
}

static void assert_reads(const char *first, ...)
{
    va_list list;
    va_start(list, first);
    result_t result = read_line(first, list);
    va_end(list);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

static void assert_refuses(const char *reason, const char *first, ...)
{
    va_list list;
    va_start(list, first);
    result_t result = read_line(first, list);
    va_end(list);
    assert_int_equal(result.code, RESULT_USAGE);
    if (strstr(result.message, reason) == NULL) fail_msg("'%s' is not in: %s", reason, result.message);
}

static void values_follow_as_words_or_after_a_sign(void **state)
{
    (void)state;
    assert_reads("--text", "a", NULL);
    assert_string_equal(seen.part.text, "a");
    assert_reads("--text=b=c", NULL);
    assert_string_equal(seen.part.text, "b=c");
    assert_reads("-t", "d", NULL);
    assert_string_equal(seen.part.text, "d");
    assert_reads("-te", NULL);
    assert_string_equal(seen.part.text, "e");
    assert_reads("--text", "--flag", NULL);
    assert_string_equal(seen.part.text, "--flag");
    assert_false(seen.part.flag);
    assert_reads("--text", "a", "--text=b", NULL);
    assert_string_equal(seen.part.text, "b");
}

static void each_type_is_read(void **state)
{
    (void)state;
    assert_reads("--flag", "--whole", "-5", "--count=100", "--large", "5000000000", "--real=1e0", "--share",
                 "1%", "--bytes", "0.5", "--kind=blue", NULL);
    assert_true(seen.part.flag);
    assert_int_equal(seen.part.whole, -5);
    assert_int_equal(seen.part.count, 100);
    assert_true(seen.part.large == 5000000000);
    assert_true(seen.part.real == 1);
    assert_true(seen.part.share == 0.01);
    assert_true(seen.part.bytes == 500000000);
    assert_int_equal(seen.part.kind, KIND_BLUE);
    assert_int_equal(seen.before, 0);
}

static void what_is_not_said_keeps_its_value(void **state)
{
    (void)state;
    assert_reads(NULL);
    assert_int_equal(seen.part.whole, -4);
    assert_false(seen.part.flag);
    assert_null(seen.part.text);
}

static void arguments_stand_anywhere(void **state)
{
    (void)state;
    assert_reads("a", "--flag", "-", "-3", NULL);
    assert_string_equal(seen_arguments, "a - -3");
    assert_reads("--", "--flag", "-x", NULL);
    assert_string_equal(seen_arguments, "--flag -x");
    assert_false(seen.part.flag);
}

static void a_list_goes_on_to_the_next_option(void **state)
{
    (void)state;
    assert_reads("z", "--list", "a", "b", "--flag", "y", "--list=c", "d", "--", "x", NULL);
    assert_string_equal(seen_list, "a b c d");
    assert_string_equal(seen_arguments, "z y x");
}

static void a_value_that_may_be_missing_needs_the_sign(void **state)
{
    (void)state;
    assert_reads("--pause", "7", NULL);
    assert_true(seen.part.pause == 2);
    assert_string_equal(seen_arguments, "7");
    assert_reads("--pause=3", "7", NULL);
    assert_true(seen.part.pause == 3);
    assert_refuses("--pause takes a number from 1 to 9, not '0'", "--pause=0", NULL);
}

static void a_clear_beginning_is_enough(void **state)
{
    (void)state;
    assert_reads("--fl", "--wh=3", NULL);
    assert_true(seen.part.flag);
    assert_int_equal(seen.part.whole, 3);
    assert_refuses("--l may be --large or --list", "--l", "3", NULL);
}

static void the_environment_stands_in(void **state)
{
    (void)state;
    setenv("LIGHTMILL_TEST_TEXT", "there", 1);
    assert_reads(NULL);
    assert_string_equal(seen.part.text, "there");
    assert_reads("--text", "here", NULL);
    assert_string_equal(seen.part.text, "here");
    setenv("LIGHTMILL_TEST_TEXT", "", 1);
    assert_reads(NULL);
    assert_null(seen.part.text);
    unsetenv("LIGHTMILL_TEST_TEXT");
}

static void a_wrong_value_is_told_with_what_is_right(void **state)
{
    (void)state;
    assert_refuses("--whole takes a whole number from -5 to 5, not '6'", "--whole=6", NULL);
    assert_refuses("--whole takes a whole number from -5 to 5, not '1.5'", "--whole", "1.5", NULL);
    assert_refuses("--count takes a whole number from 1 to 100, not ''", "--count=", NULL);
    assert_refuses("--large takes", "--large", "99999999999999999999", NULL);
    assert_refuses("--real takes a number from 0.5 to 2, not 'nan'", "--real", "nan", NULL);
    assert_refuses("--share takes a share like 1% or 0.01, at most 1, not '101%'", "--share=101%", NULL);
    assert_refuses("--kind takes red, green or blue, not 'pink'", "--kind", "pink", NULL);
    assert_refuses("--text needs a value, TEXT", "--text", NULL);
    assert_refuses("--flag takes no value", "--flag=1", NULL);
    assert_refuses("one argument too many: 'd'", "a", "b", "c", "d", NULL);
}

static void a_mistyped_option_is_guessed(void **state)
{
    (void)state;
    assert_refuses("unknown option --fleg; did you mean --flag?", "--fleg", NULL);
    assert_refuses("unknown option --chare; did you mean --share?", "--chare=3", NULL);
    assert_refuses("unknown option --elephants; see test part --help", "--elephants", NULL);
    assert_refuses("unknown option -x", "-x", NULL);
}

static void help_has_every_option(void **state)
{
    (void)state;
    char *folder = scratch_new();
    scratch_capture_t capture = scratch_capture(folder, 1);
    result_t result = command_run(&command, 3, (char *[]){"part", "--help", "--nothing", NULL});
    char *text = scratch_uncapture(&capture);
    assert_int_equal(result.code, RESULT_OK);
    assert_non_null(strstr(text, "usage: test part [A] [B] [C] [options]\n\nTests.\n\nParts:\n"));
    assert_non_null(strstr(text, "\n  -t, --text TEXT       a text\n"));
    assert_non_null(strstr(text, "\n  --flag                a flag\n"));
    assert_non_null(strstr(text, "\n  --pause[=SECONDS]     a pause\n"));
    for (size_t i = 0; i < ARRAY_LENGTH(rows); i++) assert_non_null(strstr(text, rows[i].help));
    free(text);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(values_follow_as_words_or_after_a_sign),
                                       cmocka_unit_test(each_type_is_read),
                                       cmocka_unit_test(what_is_not_said_keeps_its_value),
                                       cmocka_unit_test(arguments_stand_anywhere),
                                       cmocka_unit_test(a_list_goes_on_to_the_next_option),
                                       cmocka_unit_test(a_value_that_may_be_missing_needs_the_sign),
                                       cmocka_unit_test(a_clear_beginning_is_enough),
                                       cmocka_unit_test(the_environment_stands_in),
                                       cmocka_unit_test(a_wrong_value_is_told_with_what_is_right),
                                       cmocka_unit_test(a_mistyped_option_is_guessed),
                                       cmocka_unit_test(help_has_every_option)};
    return cmocka_run_group_tests_name("options", tests, NULL, NULL);
}
