/* What those who run a farm rely on, with real processes: nobody else reads its data, workers go and stay
 * away when they are told to. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <fts.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* ---- the data directory -------------------------------------------------------------------------------- */

/* Calls `look` with all that is in the folder, itself included; returns how many entries those were. */
static size_t walk(const char *folder, void (*look)(const FTSENT *entry))
{
    char *const roots[] = {(char *)folder, NULL};
    FTS *tree = fts_open(roots, FTS_PHYSICAL | FTS_NOCHDIR, NULL);
    size_t count = 0;
    for (FTSENT *entry; (entry = fts_read(tree)) != NULL;) {
        if (entry->fts_info != FTS_D && entry->fts_info != FTS_F) continue;
        look(entry);
        count++;
    }
    fts_close(tree);
    return count;
}

static void expect_private(const FTSENT *entry)
{
    if (strcmp(entry->fts_name, "notes") == 0) return; /* not ours */
    if ((entry->fts_statp->st_mode & 077) != 0)
        fail_msg("%s has the mode %o", entry->fts_path, entry->fts_statp->st_mode & 07777);
}

static void open_to_all(const FTSENT *entry)
{
    assert_int_equal(chmod(entry->fts_path, entry->fts_info == FTS_D ? 0755 : 0644), 0);
}

static job_settings_t small_settings(void)
{
    job_settings_t settings = rig_settings();
    settings.width = 40;
    settings.height = 30;
    settings.spp = 4;
    return settings;
}

static void the_data_directory_is_its_owners_alone(void **state)
{
    rig_t *rig = *state;
    struct stat about;
    mode_t before = umask(0);
    job_settings_t settings = small_settings();
    rig_start_master(rig, 0.2);
    rig_start_worker(rig);
    assert_int_equal(rig_wait_job(rig, rig_submit(rig, &settings)).state, JOB_DONE);
    rig_kill_master(rig);
    /* The directory, lock, journal with its log, scene, film, image and their folders. */
    assert_true(walk(rig->data, expect_private) >= 9);
    /* As an earlier version left it, with a file of somebody else. */
    char *notes = scratch_path(rig->data, "notes");
    scratch_write(notes, "x", 1);
    assert_true(walk(rig->data, open_to_all) >= 10);
    rig_restart_master(rig, 0.2);
    walk(rig->data, expect_private);
    assert_int_equal(stat(notes, &about), 0);
    assert_int_equal(about.st_mode & 0777, 0644);
    rig_wait_output(rig, rig->master, "other users of this machine had rights to");
    free(notes);
    umask(before);
}

/* ---- what peers are told ------------------------------------------------------------------------------- */

static void a_refusal_tells_no_path_of_the_master(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, 0.2);
    char *blobs = scratch_path(rig->data, "blobs"), *port = mem_printf("127.0.0.1:%d", rig->port);
    assert_int_equal(rmdir(blobs), 0);
    pid_t submit = rig_start_command(rig, ARGUMENTS("submit", "scenes/cornell", "--master", port));
    assert_int_not_equal(rig_wait_exit(rig, submit, 20), 0);
    char *said = rig_output(rig, submit);
    assert_non_null(strstr(said, "the master cannot write blobs/"));
    assert_null(strstr(said, rig->data));
    rig_wait_output(rig, rig->master, blobs); /* who runs it sees where */
    free(said);
    free(port);
    free(blobs);
}

/* ---- workers that are to go ---------------------------------------------------------------------------- */

static char *master_of(const rig_t *rig)
{
    return mem_printf("--master=127.0.0.1:%d", rig->port);
}

/* Runs a command on the rig's master; it must end with this code and say this. */
static void expect(rig_t *rig, int code, const char *said, const char *word, const char *argument)
{
    char *master = master_of(rig);
    pid_t process = rig_start_command(rig, (const char *[]){word, master, argument, NULL});
    int got = rig_wait_exit(rig, process, 20);
    char *output = rig_output(rig, process);
    if (got != code) fail_msg("%s: exit code %d instead of %d: %s", word, got, code, output);
    if (strstr(output, said) == NULL) fail_msg("%s: '%s' is not in: %s", word, said, output);
    free(output);
    free(master);
}

static void a_drained_worker_delivers_and_ends_well(void **state)
{
    rig_t *rig = *state;
    job_settings_t settings = rig_settings();
    settings.spp = 96;
    rig_start_master(rig, 0.3);
    uint64_t job = rig_submit(rig, &settings);
    char *name = mem_printf("%d", rig->started_count); /* as the rig calls it */
    pid_t worker = rig_start_worker(rig);
    rig_wait_samples(rig, job, 1000);
    expect(rig, RESULT_INPUT, "no worker called", "drain", "nobody");
    expect(rig, 0, "1 worker asked to leave", "drain", name);
    assert_int_equal(rig_wait_exit(rig, worker, 30), 0);
    assert_int_equal(rig_status(rig, job).out, 0);
    assert_int_equal(rig_status(rig, job).batches_refused, 0);
    expect(rig, 0, name, "status", "--workers");
    expect(rig, 0, "1 worker forgotten", "purge", NULL);
    rig_start_worker(rig); /* another process of the same host is welcome */
    rig_wait_job(rig, job);
    uint64_t undisturbed = rig_submit(rig, &settings);
    rig_wait_job(rig, undisturbed);
    hash_t hash = rig_image_hash(rig, job), right = rig_image_hash(rig, undisturbed);
    assert_true(hash_equal(&hash, &right));
    free(name);
}

int main(void)
{
#define OPERATORS(test) cmocka_unit_test_setup_teardown(test, rig_set_up, rig_tear_down)
    const struct CMUnitTest tests[] = {
        OPERATORS(the_data_directory_is_its_owners_alone),
        OPERATORS(a_refusal_tells_no_path_of_the_master),
        OPERATORS(a_drained_worker_delivers_and_ends_well),
    };
    return cmocka_run_group_tests_name("operators", tests, NULL, NULL);
}
