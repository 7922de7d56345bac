/* Tests of proto/serve/allow_edit.h: what changes in a list of keys, and all that does not. */
#include "proto/serve/allow_edit.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#define A "rq:rM>}U?@Lns47E1%kR.o@n%FcmmsL/@{H8]yf7"
#define B "Yne@$w-vo<fVvi]a<NY6T1ed:M$fCG*[IaLV{hID"
#define C "D:)Q[IlAW!ahhC2ac:9*A}h:p?([4%wOTJ%JR%cs"

static const char LIST[] =
    "# the farm\n\nworker " A "   node-1   # by the window\n\tclient " B "\tada\r\n# the end";

typedef struct {
    char *folder, *path;
} bench_t;

static int set_up(void **state)
{
    bench_t *bench = mem_zalloc(1, sizeof *bench);
    bench->folder = scratch_new();
    bench->path = scratch_path(bench->folder, "allow");
    scratch_write(bench->path, LIST, sizeof LIST - 1);
    *state = bench;
    return 0;
}

static int tear_down(void **state)
{
    bench_t *bench = *state;
    scratch_destroy(&bench->folder);
    free(bench->path);
    free(bench);
    return 0;
}

static char *text_of(const bench_t *bench)
{
    size_t size;
    char *bytes = (char *)scratch_read(bench->path, &size), *text = mem_zalloc(1, size + 1);
    memcpy(text, bytes, size);
    free(bytes);
    return text;
}

static void expect_unchanged(const bench_t *bench)
{
    char *text = text_of(bench);
    assert_string_equal(text, LIST);
    free(text);
}

static void a_line_is_added_behind_all_that_is_there(void **state)
{
    bench_t *bench = *state;
    allow_entry_t entry;
    struct stat about;
    bool there;
    assert_int_equal(chmod(bench->path, 0640), 0);
    assert_int_equal(allow_edit_add(bench->path, "worker " C " node-2", &entry, &there).code, RESULT_OK);
    assert_false(there);
    assert_string_equal(entry.name, "node-2");
    char *text = text_of(bench), *expected = mem_printf("%s\nworker %s node-2\n", LIST, C);
    assert_string_equal(text, expected);
    assert_int_equal(stat(bench->path, &about), 0);
    assert_int_equal(about.st_mode & 0777, 0640); /* whoever reads it may still do so */
    assert_int_equal(allow_edit_add(bench->path, "worker " C, &entry, &there).code, RESULT_OK);
    assert_true(there);
    free(text);
    text = text_of(bench);
    assert_string_equal(text, expected);
    free(text);
    free(expected);
}

static void a_line_that_is_none_changes_nothing(void **state)
{
    bench_t *bench = *state;
    static const char *const lines[] = {"",
                                        "# worker " C,
                                        "worker",
                                        "worker " C "x",
                                        "boss " C " me",
                                        "worker " C " a\nall " A " b",
                                        "client " A " node-1", /* it has another right */
                                        "worker rq:rM>}U? node-1"};
    for (size_t i = 0; i < ARRAY_LENGTH(lines); i++) {
        allow_entry_t entry;
        bool there;
        assert_int_equal(allow_edit_add(bench->path, lines[i], &entry, &there).code, RESULT_INPUT);
        expect_unchanged(bench);
    }
}

static void an_excluded_line_becomes_a_comment_and_may_come_back(void **state)
{
    bench_t *bench = *state;
    allow_entry_t entry;
    allow_list_t list;
    bool there;
    assert_int_equal(allow_edit_remove(bench->path, "node-1", &entry).code, RESULT_OK);
    assert_string_equal(entry.key, A);
    assert_int_equal(entry.line, 3);
    assert_int_equal(allow_edit_remove(bench->path, B, &entry).code, RESULT_OK);
    char *text = text_of(bench);
    assert_int_equal(strncmp(text, "# the farm\n\n# excluded 2", 24), 0);
    assert_non_null(strstr(text, ": worker " A "   node-1   # by the window\n# excluded "));
    assert_non_null(strstr(text, ": \tclient " B "\tada\r\n# the end"));
    assert_int_equal(allow_list_read(bench->path, &list).code, RESULT_OK);
    assert_int_equal(list.count, 0);
    allow_list_free(&list);
    assert_int_equal(allow_edit_add(bench->path, "worker " A " node-1", &entry, &there).code, RESULT_OK);
    assert_int_equal(allow_list_read(bench->path, &list).code, RESULT_OK);
    assert_int_equal(list.count, 1);
    allow_list_free(&list);
    free(text);
}

static void who_is_not_one_key_is_refused(void **state)
{
    bench_t *bench = *state;
    allow_entry_t entry;
    bool there;
    assert_int_equal(allow_edit_remove(bench->path, "node", &entry).code, RESULT_INPUT);
    assert_int_equal(allow_edit_remove(bench->path, "", &entry).code, RESULT_INPUT);
    expect_unchanged(bench);
    assert_int_equal(allow_edit_add(bench->path, "worker " C " node-1", &entry, &there).code, RESULT_OK);
    result_t result = allow_edit_remove(bench->path, "node-1", &entry);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "say which key"));
    assert_int_equal(allow_edit_remove("/nowhere/allow", "node-1", &entry).code, RESULT_INPUT);
}

/* The list may be a link to where the machines' settings are kept. */
static void a_link_stays_a_link(void **state)
{
    bench_t *bench = *state;
    allow_entry_t entry;
    struct stat about;
    bool there;
    char *link = scratch_path(bench->folder, "link");
    assert_int_equal(symlink("allow", link), 0);
    assert_int_equal(allow_edit_add(link, "worker " C, &entry, &there).code, RESULT_OK);
    assert_int_equal(lstat(link, &about), 0);
    assert_true(S_ISLNK(about.st_mode));
    char *text = text_of(bench);
    assert_non_null(strstr(text, "worker " C "\n"));
    free(text);
    free(link);
}

int main(void)
{
#define WITH_LIST(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        WITH_LIST(a_line_is_added_behind_all_that_is_there),
        WITH_LIST(a_line_that_is_none_changes_nothing),
        WITH_LIST(an_excluded_line_becomes_a_comment_and_may_come_back),
        WITH_LIST(who_is_not_one_key_is_refused),
        WITH_LIST(a_link_stays_a_link),
    };
    return cmocka_run_group_tests_name("allow_edit", tests, NULL, NULL);
}
