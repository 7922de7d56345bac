/* Tests of the worker's cache of scenes: what is in it has the right bytes, a download that broke off goes
 * on, one of several processes fetches, and the limit holds. */
#include "common/scene/blob_builder.h"
#include "proto/uplink/blob_cache.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <fcntl.h>
#include <sched.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

static const uint64_t ROOMY = 1 << 30;

typedef struct {
    char *folder, *dir;
    blob_cache_t *cache;
    uint8_t *bytes; /* of a scene */
    uint64_t size;
    hash_t hash;
} fixture_t;

static int set_up(void **state)
{
    fixture_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    t->dir = scratch_path(t->folder, "a/cache");
    assert_int_equal(blob_cache_new(t->dir, ROOMY, &t->cache).code, RESULT_OK);
    t->bytes = peer_blob(0, &t->size, &t->hash);
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    fixture_t *t = *state;
    blob_cache_destroy(&t->cache);
    assert_null(t->cache);
    scratch_destroy(&t->folder);
    free(t->dir);
    free(t->bytes);
    free(t);
    return 0;
}

static char *entry(fixture_t *t, const hash_t *hash, const char *suffix)
{
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(hash, hex);
    return mem_printf("%s/%s%s", t->dir, hex, suffix);
}

static bool in_cache(fixture_t *t, const hash_t *hash)
{
    scene_blob_t blob;
    bool found;
    assert_int_equal(blob_cache_open(t->cache, hash, &blob, &found).code, RESULT_OK);
    if (found) {
        assert_true(hash_equal(&blob.hash, hash));
        blob_close(&blob);
    }
    return found;
}

static blob_download_t begin(fixture_t *t, const hash_t *hash, uint64_t size)
{
    blob_download_t download;
    bool busy;
    assert_int_equal(blob_cache_download(t->cache, 0, hash, size, &download, &busy).code, RESULT_OK);
    assert_false(busy);
    return download;
}

static void fetch(fixture_t *t, const uint8_t *bytes, uint64_t size, const hash_t *hash)
{
    scene_blob_t blob;
    blob_download_t download = begin(t, hash, size);
    assert_int_equal(blob_download_append(&download, bytes, size).code, RESULT_OK);
    assert_int_equal(blob_download_finish(t->cache, &download, &blob).code, RESULT_OK);
    assert_int_equal(blob.size, size);
    assert_memory_equal(blob.bytes, bytes, size);
    blob_close(&blob);
}

static void a_scene_is_fetched_once(void **state)
{
    fixture_t *t = *state;
    assert_false(in_cache(t, &t->hash));
    fetch(t, t->bytes, t->size, &t->hash);
    assert_true(in_cache(t, &t->hash));
    assert_int_equal(scratch_count(t->dir), 1);
    /* Another worker that wanted it, too, looks again. */
    blob_download_t download;
    bool busy;
    assert_int_equal(blob_cache_download(t->cache, 0, &t->hash, t->size, &download, &busy).code, RESULT_OK);
    assert_true(busy);
}

static void a_broken_download_goes_on(void **state)
{
    fixture_t *t = *state;
    blob_download_t download = begin(t, &t->hash, t->size);
    assert_int_equal(download.have, 0);
    assert_int_equal(blob_download_append(&download, t->bytes, 10).code, RESULT_OK);
    blob_download_close(&download);
    blob_download_close(&download);
    assert_false(in_cache(t, &t->hash));
    download = begin(t, &t->hash, t->size);
    assert_int_equal(download.have, 10);
    assert_int_equal(blob_download_append(&download, t->bytes + 10, t->size - 10).code, RESULT_OK);
    assert_int_equal(blob_download_append(&download, t->bytes, 1).code, RESULT_PROTOCOL); /* too much */
    scene_blob_t blob;
    assert_int_equal(blob_download_finish(t->cache, &download, &blob).code, RESULT_OK);
    blob_close(&blob);
    assert_true(in_cache(t, &t->hash));
}

static void a_part_that_is_too_long_begins_anew(void **state)
{
    fixture_t *t = *state;
    char *part = entry(t, &t->hash, ".part");
    uint8_t *junk = mem_zalloc(1, t->size + 1);
    scratch_write(part, junk, t->size + 1);
    blob_download_t download = begin(t, &t->hash, t->size);
    assert_int_equal(download.have, 0);
    blob_download_close(&download);
    free(junk);
    free(part);
}

static void wrong_bytes_never_get_the_name(void **state)
{
    fixture_t *t = *state;
    scene_blob_t blob;
    blob_download_t download = begin(t, &t->hash, t->size);
    uint8_t *wrong = mem_alloc(t->size);
    memcpy(wrong, t->bytes, t->size);
    wrong[t->size - 1] ^= 1;
    assert_int_equal(blob_download_append(&download, wrong, t->size).code, RESULT_OK);
    assert_int_equal(blob_download_finish(t->cache, &download, &blob).code, RESULT_INPUT);
    assert_false(in_cache(t, &t->hash));
    assert_int_equal(scratch_count(t->dir), 0);
    fetch(t, t->bytes, t->size, &t->hash);
    free(wrong);
}

static void a_file_that_rotted_is_fetched_again(void **state)
{
    fixture_t *t = *state;
    fetch(t, t->bytes, t->size, &t->hash);
    char *path = entry(t, &t->hash, ".blob");
    uint8_t *wrong = mem_alloc(t->size);
    memcpy(wrong, t->bytes, t->size);
    wrong[t->size / 2] ^= 0x10;
    scratch_write(path, wrong, t->size);
    assert_false(in_cache(t, &t->hash));
    fetch(t, t->bytes, t->size, &t->hash);
    scratch_write(path, wrong, 3); /* truncated */
    assert_false(in_cache(t, &t->hash));
    free(wrong);
    free(path);
}

/* The lock of a process that was killed is gone, its bytes are not. */
static void another_process_has_the_download(void **state)
{
    fixture_t *t = *state;
    int ready[2];
    char byte;
    assert_int_equal(pipe(ready), 0);
    pid_t child = fork();
    if (child == 0) {
        blob_download_t download = begin(t, &t->hash, t->size);
        bool good = blob_download_append(&download, t->bytes, 20).code == RESULT_OK;
        if (!good || write(ready[1], "x", 1) != 1) _exit(1);
        pause();
    }
    assert_int_equal(read(ready[0], &byte, 1), 1);
    blob_download_t download;
    bool busy;
    assert_int_equal(blob_cache_download(t->cache, 0, &t->hash, t->size, &download, &busy).code, RESULT_OK);
    assert_true(busy);
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    download = begin(t, &t->hash, t->size);
    assert_int_equal(download.have, 20);
    blob_download_close(&download);
    close(ready[0]);
    close(ready[1]);
}

/* Looks at a download that another process has; true when this one may begin its own. */
static bool may_begin(fixture_t *t, double now, blob_download_t *download)
{
    bool busy;
    assert_int_equal(blob_cache_download(t->cache, now, &t->hash, t->size, download, &busy).code, RESULT_OK);
    return !busy;
}

static blob_cache_t *other_cache(fixture_t *t)
{
    blob_cache_t *other;
    assert_int_equal(blob_cache_new(t->dir, ROOMY, &other).code, RESULT_OK);
    return other;
}

/* Lets another one have the part that all share and stand still, and leaves a part of its own. */
static blob_download_t begin_alone(fixture_t *t, blob_cache_t *other)
{
    blob_download_t stopped, download;
    bool busy;
    assert_int_equal(blob_cache_download(other, 0, &t->hash, t->size, &stopped, &busy).code, RESULT_OK);
    assert_false(busy);
    assert_false(may_begin(t, 0, &download));
    assert_true(may_begin(t, 60, &download));
    assert_int_equal(blob_download_append(&download, t->bytes, 10).code, RESULT_OK);
    assert_int_equal(scratch_count(t->dir), 2);
    blob_download_close(&download);
    return stopped;
}

/* Its process is stopped, say: it keeps the lock. */
static void a_download_that_stands_still_is_not_waited_for(void **state)
{
    fixture_t *t = *state;
    blob_cache_t *other = other_cache(t);
    blob_download_t stopped, download;
    scene_blob_t blob;
    bool busy;
    assert_int_equal(blob_cache_download(other, 0, &t->hash, t->size, &stopped, &busy).code, RESULT_OK);
    assert_false(busy);
    assert_false(may_begin(t, 100, &download));
    assert_false(may_begin(t, 125, &download));
    assert_int_equal(blob_download_append(&stopped, t->bytes, 20).code, RESULT_OK);
    assert_false(may_begin(t, 150, &download));
    assert_false(may_begin(t, 175, &download));
    assert_true(may_begin(t, 185, &download));
    assert_int_equal(download.have, 0);
    assert_int_equal(blob_download_append(&download, t->bytes, 10).code, RESULT_OK);
    blob_download_close(&download);
    assert_true(may_begin(t, 186, &download)); /* and goes on with what it has */
    assert_int_equal(download.have, 10);
    assert_int_equal(blob_download_append(&download, t->bytes + 10, t->size - 10).code, RESULT_OK);
    assert_int_equal(blob_download_finish(t->cache, &download, &blob).code, RESULT_OK);
    blob_close(&blob);
    /* The other one finishes, too, and nothing is left over. */
    assert_int_equal(blob_download_append(&stopped, t->bytes + 20, t->size - 20).code, RESULT_OK);
    assert_int_equal(blob_download_finish(other, &stopped, &blob).code, RESULT_OK);
    blob_close(&blob);
    assert_true(in_cache(t, &t->hash));
    assert_int_equal(scratch_count(t->dir), 1);
    blob_cache_destroy(&other);
}

/* The process that stood still goes on, and is faster. */
static void a_part_of_ones_own_goes_when_the_scene_is_there(void **state)
{
    fixture_t *t = *state;
    blob_cache_t *other = other_cache(t);
    blob_download_t stopped = begin_alone(t, other);
    scene_blob_t blob;
    assert_int_equal(blob_download_append(&stopped, t->bytes, t->size).code, RESULT_OK);
    assert_int_equal(blob_download_finish(other, &stopped, &blob).code, RESULT_OK);
    blob_close(&blob);
    assert_true(in_cache(t, &t->hash));
    assert_int_equal(scratch_count(t->dir), 1);
    blob_cache_destroy(&other);
}

static void parts_that_were_left_behind_make_room(void **state)
{
    fixture_t *t = *state;
    blob_cache_t *other = other_cache(t);
    blob_download_t stopped = begin_alone(t, other);
    uint64_t size;
    hash_t hash;
    uint8_t *bytes = peer_blob(5, &size, &hash);
    blob_download_close(&stopped);
    blob_cache_destroy(&other);
    blob_cache_destroy(&t->cache);
    assert_int_equal(blob_cache_new(t->dir, 1, &t->cache).code, RESULT_OK);
    fetch(t, bytes, size, &hash);
    assert_int_equal(scratch_count(t->dir), 1);
    free(bytes);
}

static void used_at(fixture_t *t, const hash_t *hash, time_t time)
{
    char *path = entry(t, hash, ".blob");
    struct timespec times[2] = {{.tv_sec = time}, {.tv_sec = time}};
    assert_int_equal(utimensat(AT_FDCWD, path, times, 0), 0);
    free(path);
}

static void the_least_recently_used_go_first(void **state)
{
    fixture_t *t = *state;
    hash_t hash[4];
    uint64_t size[4];
    uint8_t *bytes[4];
    for (uint32_t i = 0; i < 4; i++) bytes[i] = peer_blob(i + 1, &size[i], &hash[i]);
    blob_cache_destroy(&t->cache);
    assert_int_equal(blob_cache_new(t->dir, 3 * size[0], &t->cache).code, RESULT_OK);
    for (int i = 0; i < 3; i++) {
        fetch(t, bytes[i], size[i], &hash[i]);
        used_at(t, &hash[i], 1000 + i);
    }
    assert_true(in_cache(t, &hash[0])); /* and so used now */
    fetch(t, bytes[3], size[3], &hash[3]);
    assert_true(in_cache(t, &hash[0]));
    assert_false(in_cache(t, &hash[1]));
    assert_true(in_cache(t, &hash[2]));
    assert_true(in_cache(t, &hash[3]));
    for (int i = 0; i < 4; i++) free(bytes[i]);
}

static void a_part_in_use_and_other_files_stay(void **state)
{
    fixture_t *t = *state;
    uint64_t size;
    hash_t hash;
    uint8_t *bytes = peer_blob(5, &size, &hash);
    char *other = scratch_path(t->dir, "notes.txt");
    scratch_write(other, "mine", 4);
    blob_cache_destroy(&t->cache);
    assert_int_equal(blob_cache_new(t->dir, 1, &t->cache).code, RESULT_OK);
    /* A blob over the whole limit is fetched all the same: the job needs it. */
    blob_download_t download = begin(t, &hash, size);
    assert_int_equal(blob_download_append(&download, bytes, 30).code, RESULT_OK);
    fetch(t, t->bytes, t->size, &t->hash);
    assert_int_equal(download.have, 30);
    assert_int_equal(blob_download_append(&download, bytes + 30, size - 30).code, RESULT_OK);
    scene_blob_t blob;
    assert_int_equal(blob_download_finish(t->cache, &download, &blob).code, RESULT_OK);
    blob_close(&blob);
    assert_int_equal(access(other, F_OK), 0);
    free(other);
    free(bytes);
}

static void a_folder_that_cannot_be_written_is_named(void **state)
{
    fixture_t *t = *state;
    char *file = scratch_path(t->folder, "file");
    scratch_write(file, "x", 1);
    char *below = mem_printf("%s/cache", file);
    blob_cache_t *cache = NULL;
    result_t result = blob_cache_new(below, ROOMY, &cache);
    assert_int_equal(result.code, RESULT_IO);
    assert_non_null(strstr(result.message, below));
    assert_non_null(strstr(result.message, "--cache"));
    free(below);
    free(file);
}

static void the_default_folder_is_the_users_own(void **state)
{
    (void)state;
    char *old_home = getenv("HOME") ? mem_strdup(getenv("HOME")) : NULL;
    unsetenv("XDG_CACHE_HOME");
    setenv("HOME", "/home/somebody", 1);
    char *dir = blob_cache_default_dir();
    assert_string_equal(dir, "/home/somebody/.cache/lightmill");
    free(dir);
    setenv("XDG_CACHE_HOME", "/var/cache", 1);
    dir = blob_cache_default_dir();
    assert_string_equal(dir, "/var/cache/lightmill");
    free(dir);
    setenv("XDG_CACHE_HOME", "relative", 1);
    unsetenv("HOME");
    dir = blob_cache_default_dir();
    assert_true(dir[0] == '/' && strstr(dir, "lightmill") != NULL);
    free(dir);
    unsetenv("XDG_CACHE_HOME");
    if (old_home != NULL) setenv("HOME", old_home, 1);
    free(old_home);
}

/* ---- disks that take nothing --------------------------------------------------------------------------- */

/* The part cannot be written: a device that is always full stands in its place. */
static void a_full_disk_leaves_the_scene_in_memory(void **state)
{
    fixture_t *t = *state;
    scene_blob_t blob;
    char *part = entry(t, &t->hash, ".part");
    assert_int_equal(symlink("/dev/full", part), 0);
    blob_download_t download = begin(t, &t->hash, t->size);
    result_t result = blob_download_append(&download, t->bytes, t->size);
    assert_int_equal(result.code, RESULT_IO); /* none is allowed */
    assert_non_null(strstr(result.message, "No space left"));
    assert_non_null(strstr(result.message, "does not fit into memory"));
    blob_download_close(&download);
    blob_cache_allow_memory(t->cache, t->size);
    fetch(t, t->bytes, t->size, &t->hash);
    assert_false(in_cache(t, &t->hash));
    /* A wrong one is found out there, too. */
    assert_int_equal(symlink("/dev/full", part), 0);
    download = begin(t, &t->hash, t->size);
    t->bytes[t->size - 1] ^= 1;
    assert_int_equal(blob_download_append(&download, t->bytes, t->size).code, RESULT_OK);
    assert_int_equal(blob_download_finish(t->cache, &download, &blob).code, RESULT_INPUT);
    free(part);
}

static void a_missing_directory_leaves_the_scene_in_memory(void **state)
{
    fixture_t *t = *state;
    assert_int_equal(rmdir(t->dir), 0);
    blob_cache_allow_memory(t->cache, t->size);
    fetch(t, t->bytes, t->size, &t->hash);
    assert_int_equal(mkdir(t->dir, 0700), 0); /* it works again */
    fetch(t, t->bytes, t->size, &t->hash);
    assert_true(in_cache(t, &t->hash));
}

/* A scene with much text. */
static uint8_t *large_blob(uint64_t *size, hash_t *hash)
{
    static char text[100000];
    blob_builder_t *builder = blob_builder_new();
    blob_scene_t scene = blob_default_scene();
    blob_object_t world = {0};
    uint8_t *bytes;
    blob_builder_add(builder, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, &world, 1);
    memset(text, 'x', sizeof text - 1);
    blob_builder_add(builder, BLOB_SECTION_STRINGS, text, sizeof text);
    assert_int_equal(blob_builder_finish(builder, &bytes, size).code, RESULT_OK);
    blob_builder_destroy(&builder);
    *hash = hash_bytes(bytes, *size);
    return bytes;
}

/* In a file system of its own, of 40 kB: 0 when all is well, 77 when there can be none. */
static int fill_a_small_disk(const char *folder)
{
    uint64_t size;
    hash_t hash;
    scene_blob_t blob;
    blob_download_t download;
    blob_cache_t *cache;
    bool busy;
    bool separate = unshare(CLONE_NEWNS) == 0 || unshare(CLONE_NEWUSER | CLONE_NEWNS) == 0;
    if (!separate || mount("none", "/", NULL, MS_REC | MS_PRIVATE, NULL) != 0) return 77;
    if (mount("none", folder, "tmpfs", 0, "size=40k") != 0) return 77;
    uint8_t *bytes = large_blob(&size, &hash);
    if (blob_cache_new(folder, ROOMY, &cache).code != RESULT_OK) return 1;
    blob_cache_allow_memory(cache, size);
    if (blob_cache_download(cache, 0, &hash, size, &download, &busy).code != RESULT_OK || busy) return 2;
    for (uint64_t at = 0, step = 10000; at < size; at += step)
        if (blob_download_append(&download, bytes + at, size - at < step ? size - at : step).code !=
            RESULT_OK)
            return 3;
    if (download.part_path != NULL || scratch_count(folder) != 0) return 4; /* its room is given back */
    if (blob_download_finish(cache, &download, &blob).code != RESULT_OK) return 5;
    if (blob.size != size || memcmp(blob.bytes, bytes, size) != 0) return 6;
    blob_close(&blob);
    blob_cache_destroy(&cache);
    free(bytes);
    return 0;
}

static void a_disk_that_fills_up_leaves_the_scene_in_memory(void **state)
{
    fixture_t *t = *state;
    int status;
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) _exit(fill_a_small_disk(t->folder));
    assert_int_equal(waitpid(child, &status, 0), child);
    if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
        print_message("no file system of its own is allowed here\n");
        skip();
    }
    assert_int_equal(status, 0);
}

int main(void)
{
#define WITH_FIXTURE(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        WITH_FIXTURE(a_scene_is_fetched_once),
        WITH_FIXTURE(a_broken_download_goes_on),
        WITH_FIXTURE(a_part_that_is_too_long_begins_anew),
        WITH_FIXTURE(wrong_bytes_never_get_the_name),
        WITH_FIXTURE(a_file_that_rotted_is_fetched_again),
        WITH_FIXTURE(another_process_has_the_download),
        WITH_FIXTURE(a_download_that_stands_still_is_not_waited_for),
        WITH_FIXTURE(a_part_of_ones_own_goes_when_the_scene_is_there),
        WITH_FIXTURE(parts_that_were_left_behind_make_room),
        WITH_FIXTURE(the_least_recently_used_go_first),
        WITH_FIXTURE(a_part_in_use_and_other_files_stay),
        WITH_FIXTURE(a_folder_that_cannot_be_written_is_named),
        WITH_FIXTURE(the_default_folder_is_the_users_own),
        WITH_FIXTURE(a_full_disk_leaves_the_scene_in_memory),
        WITH_FIXTURE(a_missing_directory_leaves_the_scene_in_memory),
        WITH_FIXTURE(a_disk_that_fills_up_leaves_the_scene_in_memory),
    };
    return cmocka_run_group_tests_name("blob cache", tests, NULL, NULL);
}
