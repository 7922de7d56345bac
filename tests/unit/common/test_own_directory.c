/* Tests of common/own_directory.h: what it hides. What it closes to others is in tests/farm/test_operators.c.
 */
#include "common/own_directory.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static void only_the_directorys_own_path_is_hidden(void **state)
{
    (void)state;
    static const struct {
        const char *path, *before, *after;
    } cases[] = {
        {"/srv/farm", "cannot write /srv/farm/blobs/a: it is full", "cannot write blobs/a: it is full"},
        {"/srv/farm/", "/srv/farm/a and /srv/farm//b", "a and b"},
        {"/srv/farm", "/srv/farm2/a is /srv/farm: yes", "/srv/farm2/a is : yes"},
        {"/a", "/a/a/a", "a/a"},
        {"data", "no data here, my-data/a, data/b", "no data here, my-data/a, b"},
        {".", "a sentence. And ./another.", "a sentence. And ./another."},
        {NULL, "/srv/farm/a", "/srv/farm/a"},
        {"/srv/farm", "", ""}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        char text[100];
        snprintf(text, sizeof text, "%s", cases[i].before);
        own_directory_hide(cases[i].path, text);
        assert_string_equal(text, cases[i].after);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(only_the_directorys_own_path_is_hidden)};
    return cmocka_run_group_tests_name("own_directory", tests, NULL, NULL);
}
