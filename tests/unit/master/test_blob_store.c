/* The blob store: uploads go on where they ended, whatever ended them; there is a limit, and what goes first
 * is what nobody needs. (tests/unit/master/test_master.c has uploads over a real socket.) */
#include "master/store/blob_store.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <fcntl.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

/* A valid blob. */
typedef struct {
    uint8_t *bytes;
    uint64_t size;
    hash_t hash;
} scene_bytes_t;

typedef struct {
    char *folder;
    blob_store_t *store;
    scene_bytes_t scenes[4];
} fixture_t;

static void open_store(fixture_t *fixture, uint64_t limit)
{
    blob_store_close(&fixture->store);
    must(blob_store_open(&(blob_store_options_t){.directory = fixture->folder, .limit = limit},
                         &fixture->store));
}

static int set_up(void **state)
{
    fixture_t *fixture = mem_zalloc(1, sizeof *fixture);
    fixture->folder = scratch_new();
    for (uint32_t i = 0; i < ARRAY_LENGTH(fixture->scenes); i++)
        fixture->scenes[i].bytes = peer_blob(i, &fixture->scenes[i].size, &fixture->scenes[i].hash);
    open_store(fixture, 1 << 30);
    *state = fixture;
    return 0;
}

static int tear_down(void **state)
{
    fixture_t *fixture = *state;
    blob_store_close(&fixture->store);
    for (size_t i = 0; i < ARRAY_LENGTH(fixture->scenes); i++) free(fixture->scenes[i].bytes);
    scratch_destroy(&fixture->folder);
    free(fixture);
    return 0;
}

static result_t put(fixture_t *fixture, int scene, uint64_t offset, uint64_t length, uint64_t *next)
{
    const scene_bytes_t *s = &fixture->scenes[scene];
    return blob_store_put(fixture->store, &s->hash, offset, s->size, s->bytes + offset, (size_t)length, next);
}

static void put_all(fixture_t *fixture, int scene)
{
    uint64_t next;
    must(put(fixture, scene, 0, fixture->scenes[scene].size, &next));
    assert_true(next == fixture->scenes[scene].size);
}

static bool has(fixture_t *fixture, int scene)
{
    uint64_t size;
    return blob_store_find(fixture->store, &fixture->scenes[scene].hash, &size);
}

/* Makes a blob look as if it had been used last so many seconds ago, to a store that is opened afterwards. */
static void make_old(fixture_t *fixture, int scene, long seconds)
{
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(&fixture->scenes[scene].hash, hex);
    char *path = mem_printf("%s/%s.%s", fixture->folder, hex, has(fixture, scene) ? "blob" : "part");
    struct timespec times[2] = {{.tv_sec = time(NULL) - seconds}, {.tv_sec = time(NULL) - seconds}};
    assert_int_equal(utimensat(AT_FDCWD, path, times, 0), 0);
    free(path);
}

/* ---- uploads ------------------------------------------------------------------------------------------- */

static void an_upload_goes_on_after_a_restart(void **state)
{
    fixture_t *fixture = *state;
    uint64_t next, size = fixture->scenes[0].size;
    must(put(fixture, 0, 0, size / 2, &next));
    assert_true(next == size / 2);
    open_store(fixture, 1 << 30);
    must(put(fixture, 0, 0, 0, &next));
    assert_true(next == size / 2);
    must(put(fixture, 0, next, size - next, &next));
    assert_true(next == size && has(fixture, 0));
    uint64_t bytes;
    assert_int_equal(blob_store_count(fixture->store, &bytes), 1);
    assert_true(bytes == size);
}

/* A limit on the size of files stands for a full disk. */
static void an_upload_goes_on_after_a_full_disk(void **state)
{
    fixture_t *fixture = *state;
    uint64_t next, size = fixture->scenes[0].size;
    struct rlimit before, small;
    getrlimit(RLIMIT_FSIZE, &before);
    small = (struct rlimit){size / 3, before.rlim_max};
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    result_t result = put(fixture, 0, 0, size, &next);
    setrlimit(RLIMIT_FSIZE, &before);
    assert_int_equal(result.code, RESULT_IO);
    must(put(fixture, 0, 0, 0, &next));
    assert_true(next == size / 3); /* what could be written is there */
    must(put(fixture, 0, next, size - next, &next));
    assert_true(next == size && has(fixture, 0));
}

static void wrong_bytes_are_thrown_away(void **state)
{
    fixture_t *fixture = *state;
    uint64_t next, size = fixture->scenes[0].size;
    fixture->scenes[0].bytes[size / 2] ^= 1;
    assert_int_equal(put(fixture, 0, 0, size, &next).code, RESULT_INPUT);
    fixture->scenes[0].bytes[size / 2] ^= 1;
    must(put(fixture, 0, 0, 0, &next));
    assert_true(next == 0);
    put_all(fixture, 0);
}

/* ---- the limit ----------------------------------------------------------------------------------------- */

static void the_oldest_that_nobody_needs_goes_first(void **state)
{
    fixture_t *fixture = *state;
    for (int i = 0; i < 3; i++) put_all(fixture, i);
    make_old(fixture, 0, 100);
    make_old(fixture, 1, 300);
    make_old(fixture, 2, 200);
    open_store(fixture, 3 * fixture->scenes[0].size);
    put_all(fixture, 3);
    assert_true(has(fixture, 0) && !has(fixture, 1) && has(fixture, 2) && has(fixture, 3));
}

static void what_a_job_needs_stays(void **state)
{
    fixture_t *fixture = *state;
    uint64_t next;
    for (int i = 0; i < 2; i++) put_all(fixture, i);
    make_old(fixture, 0, 300);
    open_store(fixture, 2 * fixture->scenes[0].size);
    blob_store_need(fixture->store, &fixture->scenes[0].hash, 1, true);
    blob_store_need(fixture->store, &fixture->scenes[0].hash, 2, true);
    put_all(fixture, 2);
    assert_true(has(fixture, 0) && !has(fixture, 1) && has(fixture, 2));
    blob_store_need(fixture->store, &fixture->scenes[2].hash, 3, true);
    result_t result = put(fixture, 3, 0, 100, &next);
    assert_int_equal(result.code, RESULT_LIMIT);
    assert_non_null(strstr(result.message, "--blob-limit"));
    blob_store_need(fixture->store, &fixture->scenes[0].hash, 1, false);
    assert_int_equal(put(fixture, 3, 0, 100, &next).code, RESULT_LIMIT); /* the other job needs it too */
    blob_store_need(fixture->store, &fixture->scenes[0].hash, 2, false);
    put_all(fixture, 3);
    assert_true(!has(fixture, 0) && has(fixture, 2) && has(fixture, 3));
}

/* Two uploads at once cannot both have the last place. */
static void an_upload_holds_its_place(void **state)
{
    fixture_t *fixture = *state;
    uint64_t next;
    open_store(fixture, fixture->scenes[0].size + 10);
    must(put(fixture, 0, 0, 100, &next));
    assert_int_equal(put(fixture, 1, 0, 100, &next).code, RESULT_LIMIT);
    must(put(fixture, 0, 100, fixture->scenes[0].size - 100, &next));
    assert_true(has(fixture, 0));
    put_all(fixture, 1);
    assert_false(has(fixture, 0));
    open_store(fixture, 10);
    assert_int_equal(put(fixture, 2, 0, 100, &next).code, RESULT_LIMIT); /* it never fits */
    assert_true(has(fixture, 1));
}

static void uploads_that_were_left_go(void **state)
{
    fixture_t *fixture = *state;
    uint64_t next;
    must(put(fixture, 0, 0, 100, &next));
    must(put(fixture, 1, 0, 100, &next));
    make_old(fixture, 0, 30 * 24 * 3600);
    open_store(fixture, 1 << 30);
    must(put(fixture, 0, 0, 0, &next));
    assert_true(next == 0);
    must(put(fixture, 1, 0, 0, &next));
    assert_true(next == 100);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(an_upload_goes_on_after_a_restart, set_up, tear_down),
        cmocka_unit_test_setup_teardown(an_upload_goes_on_after_a_full_disk, set_up, tear_down),
        cmocka_unit_test_setup_teardown(wrong_bytes_are_thrown_away, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_oldest_that_nobody_needs_goes_first, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_a_job_needs_stays, set_up, tear_down),
        cmocka_unit_test_setup_teardown(an_upload_holds_its_place, set_up, tear_down),
        cmocka_unit_test_setup_teardown(uploads_that_were_left_go, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
