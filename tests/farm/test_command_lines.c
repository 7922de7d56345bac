/* Tests of what all programs say of their command lines: help, manual pages, what a shell completes. */
#include "common/base.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

/* What bash prints for a line, with our programs on its PATH (this test is BUILD/tests/farm/NAME); fresh
 * memory. */
static char *shell(const char *line)
{
    char self[4000], *output = NULL;
    size_t size = 0;
    ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    assert_true(length > 0);
    self[length] = '\0';
    for (int i = 0; i < 3; i++) *strrchr(self, '/') = '\0';
    char *command = mem_printf("exec 2>&1; export PATH='%s':$PATH; exec bash -c '%s'", self, line);
    FILE *pipe = popen(command, "r"), *memory = open_memstream(&output, &size);
    assert_non_null(pipe);
    assert_non_null(memory);
    for (int c; (c = fgetc(pipe)) != EOF;) fputc(c, memory);
    fclose(memory);
    pclose(pipe);
    free(command);
    return output;
}

static void assert_prints(const char *line, const char *expected)
{
    char *output = shell(line);
    assert_string_equal(output, expected);
    free(output);
}

/* Calls a function with each program and each subcommand: "lightmill", "lightmill render",
 * "lightmill-master". */
static void for_each(void (*check)(const char *name))
{
    char *names = shell("for i in $(lightmill --complete \"\"); do echo lightmill $i; done");
    char *rest;
    int count = 0;
    for (char *name = strtok_r(names, "\n", &rest); name != NULL; name = strtok_r(NULL, "\n", &rest), count++)
        check(name);
    assert_true(count > 15);
    free(names);
    static const char *const programs[] = {"lightmill", "lightmill-master", "lightmill-worker",
                                           "lightmill-relay"};
    for (size_t i = 0; i < ARRAY_LENGTH(programs); i++) check(programs[i]);
}

static void help_names_options(const char *name)
{
    char *line = mem_printf(
        "%s --help; for i in $(%s --complete -); do %s --help | grep -q -e \"$i[[ ]\" -e \"$i\\$\" "
        "|| echo $i is not in the help; done",
        name, name, name);
    char *output = shell(line), *usage = mem_printf("usage: %s", name);
    if (strstr(output, usage) != output || strstr(output, "--help") == NULL ||
        strstr(output, "is not in the help") != NULL)
        fail_msg("%s: %s", name, output);
    free(usage);
    free(line);
    free(output);
}

static void every_option_is_in_the_help(void **state)
{
    (void)state;
    for_each(help_names_options);
}

/* False for a line that roff would take for a request that is none of ours. */
static bool is_sound(const char *line)
{
    static const char *const requests[] = {"TH", "SH", "SS", "TP", "PP", "B", "br", "nh"};
    if (line[0] != '.') return line[0] != '\'';
    size_t length = strcspn(line + 1, " ");
    for (size_t i = 0; i < ARRAY_LENGTH(requests); i++)
        if (strlen(requests[i]) == length && strncmp(line + 1, requests[i], length) == 0) return true;
    return false;
}

/* A page has its sections, and only sound lines. */
static void page_is_sound(const char *name)
{
    static const char *const sections[] = {".TH ",          ".SH NAME\n",        ".SH SYNOPSIS\n",
                                           ".SH OPTIONS\n", ".SH DESCRIPTION\n", "\\-\\-version\n"};
    char *line = mem_printf("%s --man", name), *page = shell(line), *rest;
    for (size_t i = 0; i < ARRAY_LENGTH(sections); i++)
        if (strstr(page, sections[i]) == NULL) fail_msg("%s: %s is missing", line, sections[i]);
    for (char *text = strtok_r(page, "\n", &rest); text != NULL; text = strtok_r(NULL, "\n", &rest))
        if (!is_sound(text)) fail_msg("%s: %s", line, text);
    free(line);
    free(page);
}

/* The same with roff itself, which warns of all that it does not understand. */
static void page_has_no_warnings(const char *name)
{
    char *line = mem_printf("%s --man | groff -man -ww -Tutf8 -z", name);
    assert_prints(line, "");
    free(line);
}

static void manual_pages_are_sound(void **state)
{
    (void)state;
    for_each(page_is_sound);
    char *groff = shell("command -v groff");
    if (groff[0] != '\0') for_each(page_has_no_warnings);
    free(groff);
}

/* Presses Tab behind a line: bash completes its last word. */
static void assert_completes(const char *words, const char *expected)
{
    char *line = mem_printf(
        "source <(lightmill completion bash); COMP_WORDS=(%s); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); "
        "_lightmill ${COMP_WORDS[0]}; echo \"${COMPREPLY[@]}\"",
        words);
    assert_prints(line, expected);
    free(line);
}

static void bash_completes_what_there_is(void **state)
{
    (void)state;
    assert_completes("lightmill re", "render resume retain release\n");
    assert_completes("lightmill render --in", "--integrator\n");
    assert_completes("lightmill render --integrator \"\"", "bdpt path light ao vcm\n");
    assert_completes("lightmill render scene.pbrt --integrator p", "path\n");
    assert_completes("lightmill status --ma", "--master --master-key --man\n");
    assert_completes("lightmill keygen --right w", "worker\n");
    assert_completes("lightmill-master --ch", "--checkpoint --checkpoint-max\n");
    assert_completes("lightmill-worker host --cache", "--cache --cache-limit\n");
    assert_completes("lightmill-relay --ask", "--ask-health\n");
    /* Nothing of ours: bash goes on to files. */
    assert_completes("lightmill render scene", "\n");
    assert_completes("lightmill render -o \"\"", "\n");
    assert_prints("source <(lightmill completion bash); complete -p lightmill-relay",
                  "complete -o default -F _lightmill lightmill-relay\n");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_option_is_in_the_help),
                                       cmocka_unit_test(manual_pages_are_sound),
                                       cmocka_unit_test(bash_completes_what_there_is)};
    return cmocka_run_group_tests_name("command lines", tests, NULL, NULL);
}
