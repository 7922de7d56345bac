/* tests/census.sh on a small folder: what came of each scene, and the table. */
#include "tests/scratch.h"

#include "common/base.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* Sanitizers reserve more addresses than any scene needs. */
#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__
static const char memory[] = "unlimited";
#else
static const char memory[] = "4096";
#endif

/* As the test was called. */
static const char *program;

static void expect_text(const char *text, const char *part)
{
    if (!strstr(text, part)) fail_msg("expected \"%s\" in \"%s\"", part, text);
}

static void write_text(const char *folder, const char *name, const char *text)
{
    char *path = scratch_path(folder, name);
    scratch_write(path, text, strlen(text));
    free(path);
}

static char *read_text(const char *path)
{
    size_t size;
    uint8_t *data = scratch_read(path, &size);
    char *text = mem_printf("%.*s", (int)size, (char *)data);
    free(data);
    return text;
}

/* BUILD, of which this test is tests/farm/NAME; in fresh memory. */
static char *build_folder(void)
{
    char *build = mem_strdup(program);
    for (int i = 0; i < 3; i++) {
        char *slash = strrchr(build, '/');
        assert_non_null(slash);
        *slash = '\0';
    }
    return build;
}

/* What the census prints of the folder's scenes; its report goes to folder/report. */
static char *census(const char *folder, const char *output)
{
    char *build = build_folder();
    char *command = mem_printf("CENSUS_REPORT='%s/report' CENSUS_SECONDS=50 CENSUS_MEGABYTES=%s "
                               "tests/census.sh '%s/scenes' '%s' >'%s' 2>&1",
                               folder, memory, folder, build, output);
    free(build);
    assert_int_equal(system(command), 0);
    free(command);
    return read_text(output);
}

static void scenes_are_counted_by_what_becomes_of_them(void **state)
{
    (void)state;
    char *folder = scratch_new(), *output = scratch_path(folder, "output"),
         *report = scratch_path(folder, "report");
    char *scenes = scratch_path(folder, "scenes"), *inner = scratch_path(folder, "scenes/inner");
    assert_int_equal(mkdir(scenes, 0700), 0);
    assert_int_equal(mkdir(inner, 0700), 0);
    write_text(inner, "good.pbrt", "WorldBegin\nShape \"sphere\"\n");
    write_text(inner, "slip.pbrt", "Film \"rgb\" Film \"rgb\"\nWorldBegin\nShape \"sphere\"\n");
    write_text(inner, "fork.pbrt", "Integrator \"own\"\nWorldBegin\nShape \"sphere\"\n");
    write_text(inner, "part.pbrt", "Shape \"sphere\"\n"); /* no scene */
    write_text(scenes, "bad.pbrt", "WorldBegin\nWurst\n");
    char *table = census(folder, output);
    expect_text(table,
                "inner                                          3       1         2          3        0");
    expect_text(table,
                "~ all                                          4       1         2          3        1");
    expect_text(table, "1 unknown directive \"...\"");
    char *lines = read_text(report);
    expect_text(lines, "strict\tinner/good.pbrt\t");
    expect_text(lines, "warned\tinner/slip.pbrt\tlightmill: ");
    expect_text(lines, "lenient\tinner/fork.pbrt\tlightmill: ");
    expect_text(lines, "refused\tbad.pbrt\tlightmill: ");
    free(lines);
    free(table);
    free(inner);
    free(scenes);
    free(report);
    free(output);
    scratch_destroy(&folder);
}

int main(int argc, char **argv)
{
    (void)argc;
    program = argv[0];
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scenes_are_counted_by_what_becomes_of_them),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
