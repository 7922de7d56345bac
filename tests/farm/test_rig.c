/* The rig itself: what it compares images with. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* References that no other test here asks for: the rig keeps those it has. */
enum { FOUND = 3, TORN = 2, NEW = 1 };

static void write_reference(const char *folder, int spp, const hash_t *hash, size_t size)
{
    char *path = mem_printf("%s/rig-%d", folder, spp);
    scratch_write(path, hash, size);
    free(path);
}

static void assert_written(const char *folder, int spp, const hash_t *hash)
{
    char *path = mem_printf("%s/rig-%d", folder, spp);
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    assert_int_equal(size, sizeof *hash);
    assert_memory_equal(bytes, hash, sizeof *hash);
    free(bytes);
    free(path);
}

/* What another program rendered is taken. What one that was killed has half written is not. */
static void programs_share_references(void **state)
{
    (void)state;
    char *folder = scratch_new(), *before = getenv("LIGHTMILL_REFERENCES");
    if (before != NULL) before = mem_strdup(before);
    assert_int_equal(setenv("LIGHTMILL_REFERENCES", folder, 1), 0);
    hash_t invented;
    memset(&invented, 0x5a, sizeof invented);
    write_reference(folder, FOUND, &invented, sizeof invented);
    write_reference(folder, TORN, &invented, sizeof invented / 2);
    hash_t found = rig_reference_at(FOUND), torn = rig_reference_at(TORN), new = rig_reference_at(NEW);
    assert_true(hash_equal(&found, &invented));
    assert_false(hash_equal(&torn, &invented));
    assert_written(folder, TORN, &torn);
    assert_written(folder, NEW, &new);
    if (before != NULL)
        setenv("LIGHTMILL_REFERENCES", before, 1);
    else
        unsetenv("LIGHTMILL_REFERENCES");
    free(before);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(programs_share_references)};
    return cmocka_run_group_tests_name("rig", tests, NULL, NULL);
}
