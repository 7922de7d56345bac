/* A master that dies and comes back: killed at any moment, also while it writes a checkpoint; with damaged
 * files; on a full disk; asked to end. Real processes; the job always ends with the pixels of an undisturbed
 * render, and its own account shows that no sample was lost or counted twice. */
#include "tests/peer.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double INTERVAL = 0.2; /* seconds between batches */
static const char *const QUICK[] = {"--checkpoint", "0.1", NULL};

typedef struct {
    rig_t *rig;
    char *data, *films; /* the data directory: in memory, so that the tests do not wait for a disk */
} restart_t;

static int set_up(void **state)
{
    restart_t *t = mem_zalloc(1, sizeof *t);
    const char *before = getenv("TMPDIR");
    char *kept = before != NULL ? mem_strdup(before) : NULL;
    if (access("/dev/shm", W_OK) == 0) setenv("TMPDIR", "/dev/shm", 1);
    t->data = scratch_new();
    if (kept != NULL)
        setenv("TMPDIR", kept, 1);
    else
        unsetenv("TMPDIR");
    free(kept);
    t->films = mem_printf("%s/films", t->data);
    t->rig = rig_new();
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    restart_t *t = *state;
    rig_destroy(&t->rig);
    scratch_destroy(&t->data);
    free(t->films);
    free(t);
    return 0;
}

static void start_master(restart_t *t)
{
    rig_start_master_on(t->rig, t->data, INTERVAL, QUICK);
}

static void restart_master(restart_t *t)
{
    rig_kill_master(t->rig);
    start_master(t);
}

static uint64_t samples_of(const job_settings_t *settings)
{
    return (uint64_t)settings->width * (uint64_t)settings->height * settings->spp;
}

/* The job ends with the pixels that it must have, and with an account that adds up. */
static void assert_reference(restart_t *t, uint64_t job)
{
    rig_status_t status = rig_assert_reference(t->rig, job);
    assert_true(status.counted == status.samples_done && status.out == 0);
    assert_true(status.issued == status.counted + status.returned);
}

/* Generations of checkpoints of job 1 that are there, latest first, at most 8; returns how many. */
static int generations(const restart_t *t, unsigned found[8])
{
    int count = 0;
    DIR *directory = opendir(t->films);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;) {
        unsigned generation, end = 0;
        if (sscanf(entry->d_name, "job-1.%u.film%n", &generation, (int *)&end) != 1) continue;
        if (end == 0 || entry->d_name[end] != '\0' || count == 8) continue;
        int at = count++;
        for (; at > 0 && found[at - 1] < generation; at--) found[at] = found[at - 1];
        found[at] = generation;
    }
    if (directory != NULL) closedir(directory);
    return count;
}

static void wait_generations(restart_t *t, int wanted)
{
    unsigned found[8];
    double deadline = clock_now() + 240;
    while (generations(t, found) < wanted) {
        if (clock_now() > deadline) fail_msg("no %d checkpoints", wanted);
        rig_sleep(0.02);
    }
}

/* A master, so many workers, and a job of which something is counted. */
static uint64_t begin_job_of(restart_t *t, uint32_t workers, uint32_t spp)
{
    start_master(t);
    for (uint32_t i = 0; i < workers; i++) rig_start_worker(t->rig);
    rig_wait_workers(t->rig, workers);
    job_settings_t settings = rig_settings();
    settings.spp = spp;
    uint64_t job = rig_submit(t->rig, &settings);
    rig_wait_samples(t->rig, job, 4 * RIG_PIXELS);
    return job;
}

/* One worker, and a job without an end. */
static uint64_t begin_job(restart_t *t)
{
    return begin_job_of(t, 1, JOB_MAX_SPP);
}

/* ---- kills --------------------------------------------------------------------------------------------- */

/* Waits until a checkpoint is being written: its temporary is there. */
static void wait_for_writing(restart_t *t)
{
    double deadline = clock_now() + 3;
    while (clock_now() < deadline) {
        bool writing = false;
        DIR *directory = opendir(t->films);
        for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;)
            writing = writing || strstr(entry->d_name, ".part") != NULL;
        if (directory != NULL) closedir(directory);
        if (writing) return;
        rig_sleep(5e-4);
    }
}

static void a_master_killed_at_any_moment_loses_nothing(void **state)
{
    restart_t *t = *state;
    uint64_t job = begin_job_of(t, 2, rig_settings().spp);
    uint64_t random = 4711;
    for (int kills = 0; kills < 8 && !job_state_final(rig_status(t->rig, job).state); kills++) {
        random = random * 6364136223846793005u + 1442695040888963407u;
        if (kills % 2 == 0)
            wait_for_writing(t);
        else
            rig_sleep(1e-3 * (double)((random >> 33) % 900));
        restart_master(t);
    }
    assert_reference(t, job);
}

/* Killed again before anything could happen: the checkpoint that there is serves as often as it takes. */
static void many_kills_in_a_row_cost_no_more_than_one(void **state)
{
    restart_t *t = *state;
    uint64_t job = begin_job(t);
    wait_generations(t, 1);
    uint64_t done = rig_status(t->rig, job).samples_done;
    for (int i = 0; i < 4; i++) restart_master(t);
    rig_wait_samples(t->rig, job, 1);
    assert_true(done > 0 && rig_status(t->rig, job).samples_done > 0);
    rig_end_job(t->rig, job);
    assert_reference(t, job);
    restart_master(t); /* it is over and stays over */
    assert_reference(t, job);
}

static void a_queue_survives(void **state)
{
    restart_t *t = *state;
    job_settings_t settings = rig_settings(), other = settings;
    settings.spp = 32;
    other.spp = 8;
    other.seed++;
    start_master(t);
    uint64_t first = rig_submit(t->rig, &other), second = rig_submit(t->rig, &settings);
    uint64_t third = rig_submit(t->rig, &other);
    assert_int_equal(remote_cancel(t->rig->remote, first).code, RESULT_OK);
    assert_int_equal(remote_order(t->rig->remote, &(job_order_t){.job = third, .kind = ORDER_PAUSE}).code,
                     RESULT_OK);
    restart_master(t);
    assert_int_equal(rig_status(t->rig, first).state, JOB_CANCELLED);
    assert_int_equal(rig_status(t->rig, second).state, JOB_QUEUED);
    assert_int_equal(rig_status(t->rig, third).state, JOB_PAUSED);
    assert_int_equal(remote_order(t->rig->remote, &(job_order_t){.job = first, .kind = ORDER_DELETE}).code,
                     RESULT_OK);
    restart_master(t);
    wire_message_t message;
    assert_int_equal(remote_status(t->rig->remote, first, &message).code, RESULT_INPUT);
    assert_true(rig_submit(t->rig, &other) > third); /* no number is given twice */
    rig_start_worker(t->rig);
    assert_reference(t, second);
}

/* The image was about to be written, or the job about to be called done. */
static void a_job_that_was_ending_ends(void **state)
{
    restart_t *t = *state;
    start_master(t);
    rig_start_worker(t->rig);
    rig_start_worker(t->rig);
    job_settings_t settings = rig_settings();
    settings.spp = 64;
    uint64_t job = rig_submit(t->rig, &settings);
    while (rig_status(t->rig, job).state <= JOB_RUNNING) rig_sleep(0.002);
    restart_master(t);
    assert_reference(t, job);
}

/* True when the history of a job's error has a point of so many samples. */
static bool has_point(restart_t *t, uint64_t job, uint64_t samples)
{
    bool found = false;
    wire_message_t message;
    assert_int_equal(remote_history(t->rig->remote, job, &message).code, RESULT_OK);
    const Lm__JobStatus *status = message.envelope->job_status_reply->jobs[0];
    for (size_t i = 0; i < status->n_history; i++) found = found || status->history[i]->samples == samples;
    wire_free(&message);
    return found;
}

static void a_job_that_is_over_is_extended(void **state)
{
    restart_t *t = *state;
    start_master(t);
    rig_start_worker(t->rig);
    job_settings_t settings = rig_settings(), part = settings;
    settings.spp /= 3;
    part.spp = 16;
    uint64_t job = rig_submit(t->rig, &part);
    assert_int_equal(rig_wait_job(t->rig, job).state, JOB_DONE);
    restart_master(t);
    job_order_t more = {.job = job, .kind = ORDER_EXTEND, .spp = settings.spp};
    assert_int_equal(remote_order(t->rig->remote, &more).code, RESULT_OK);
    rig_wait_samples(t->rig, job, samples_of(&part) + 1);
    restart_master(t);
    assert_reference(t, job);
    assert_true(has_point(t, job, samples_of(&part)) && has_point(t, job, samples_of(&settings)));
    unsigned found[8];
    assert_int_equal(generations(t, found), 1); /* of a job that is over only the last stays */
}

static void sigterm_saves_everything(void **state)
{
    restart_t *t = *state;
    /* No checkpoint is due for a long time. */
    rig_start_master_on(t->rig, t->data, INTERVAL, (const char *[]){"--checkpoint", "1000", NULL});
    rig_start_worker(t->rig);
    uint64_t job = rig_submit_endless(t->rig);
    rig_wait_samples(t->rig, job, 4 * RIG_PIXELS);
    uint64_t done = rig_status(t->rig, job).samples_done;
    pid_t master = t->rig->master;
    kill(master, SIGTERM);
    assert_int_equal(rig_wait_exit(t->rig, master, 30), 0);
    char *output = rig_output(t->rig, master);
    assert_non_null(strstr(output, "job 1 is saved"));
    free(output);
    start_master(t);
    rig_wait_output(t->rig, t->rig->master, "its film is here");
    assert_true(rig_status(t->rig, job).samples_done >= done);
    rig_end_job(t->rig, job);
    assert_reference(t, job);
}

/* ---- damage -------------------------------------------------------------------------------------------- */

/* Changes a byte in the middle. */
static void damage_file(const char *path)
{
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    bytes[size / 2] ^= 0x10;
    scratch_write(path, bytes, size);
    free(bytes);
}

static void damage_generation(const restart_t *t, unsigned generation)
{
    char *path = mem_printf("%s/job-1.%u.film", t->films, generation);
    damage_file(path);
    free(path);
}

static void a_damaged_checkpoint_costs_one_generation(void **state)
{
    restart_t *t = *state;
    unsigned found[8];
    uint64_t job = begin_job(t);
    wait_generations(t, 2);
    rig_kill_master(t->rig);
    assert_int_equal(generations(t, found), 2);
    damage_generation(t, found[0]);
    start_master(t);
    rig_wait_output(t->rig, t->rig->master, "A CHECKPOINT IS DAMAGED");
    rig_wait_output(t->rig, t->rig->master, "the one before is; ");
    rig_wait_output(t->rig, t->rig->master, "pixel samples are rendered again");
    assert_non_null(strstr(rig_status(t->rig, job).message, "a checkpoint could not be used"));
    assert_true(rig_status(t->rig, job).samples_done > 0);
    rig_end_job(t->rig, job);
    assert_reference(t, job);
}

static void without_any_good_checkpoint_the_job_begins_anew(void **state)
{
    restart_t *t = *state;
    unsigned found[8];
    uint64_t job = begin_job(t);
    wait_generations(t, 1);
    rig_kill_master(t->rig);
    for (int i = generations(t, found) - 1; i >= 0; i--) damage_generation(t, found[i]);
    start_master(t);
    rig_wait_output(t->rig, t->rig->master, "the job begins anew");
    rig_end_job(t->rig, job);
    assert_reference(t, job);
}

/* What the journal has lost comes back from the films. */
static void a_damaged_journal_is_rebuilt(void **state)
{
    restart_t *t = *state;
    uint64_t job = begin_job(t);
    wait_generations(t, 1);
    rig_kill_master(t->rig);
    char *path = scratch_path(t->data, "lightmill.db"), *log = scratch_path(t->data, "lightmill.db-wal");
    scratch_write(path, "this is not a database, and it is long enough to look like one", 62);
    (void)unlink(log); /* SQLite would mend the file from it */
    free(log);
    start_master(t);
    rig_wait_output(t->rig, t->rig->master, "THE JOURNAL IS DAMAGED");
    assert_true(rig_status(t->rig, job).samples_done > 0);
    rig_end_job(t->rig, job);
    assert_reference(t, job);
    job_settings_t settings = rig_settings();
    settings.spp = 1;
    assert_true(rig_submit(t->rig, &settings) > job);
    free(path);
}

/* The file of the only scene in the data directory. The caller frees it. */
static char *scene_path(const restart_t *t)
{
    char *blobs = mem_printf("%s/blobs", t->data), *path = NULL;
    DIR *directory = opendir(blobs);
    for (const struct dirent *entry; (entry = readdir(directory)) != NULL;) {
        if (entry->d_name[0] == '.') continue;
        assert_null(path);
        path = mem_printf("%s/%s", blobs, entry->d_name);
    }
    closedir(directory);
    assert_non_null(path);
    free(blobs);
    return path;
}

/* Another job brings the scene back, and the one that paused for it can go on to the end. */
static void bring_scene_back(restart_t *t, uint64_t job)
{
    job_settings_t other = rig_settings();
    other.spp = 1;
    rig_submit(t->rig, &other);
    job_order_t resume = {.job = job, .kind = ORDER_RESUME};
    assert_int_equal(remote_order(t->rig->remote, &resume).code, RESULT_OK);
    rig_end_job(t->rig, job);
    assert_reference(t, job);
}

/* The scene is gone: the job waits for it and says so. */
static void a_lost_scene_pauses_its_job(void **state)
{
    restart_t *t = *state;
    uint64_t job = begin_job(t);
    wait_generations(t, 1);
    rig_kill_master(t->rig);
    char *path = scene_path(t);
    assert_int_equal(unlink(path), 0);
    start_master(t);
    rig_status_t status = rig_status(t->rig, job);
    assert_int_equal(status.state, JOB_PAUSED);
    assert_non_null(strstr(status.message, "scene"));
    job_order_t resume = {.job = job, .kind = ORDER_RESUME};
    assert_int_equal(remote_order(t->rig->remote, &resume).code, RESULT_INPUT);
    bring_scene_back(t, job);
    free(path);
}

static void a_damaged_scene_pauses_its_job(void **state)
{
    restart_t *t = *state;
    uint64_t job = begin_job(t);
    wait_generations(t, 1);
    rig_kill_master(t->rig);
    char *path = scene_path(t);
    damage_file(path);
    start_master(t);
    rig_wait_output(t->rig, t->rig->master, "A SCENE IS DAMAGED");
    rig_wait_output(t->rig, t->rig->master, "is paused: its scene is not in the data directory");
    assert_int_equal(rig_status(t->rig, job).state, JOB_PAUSED);
    assert_int_equal(access(path, F_OK), -1);
    bring_scene_back(t, job);
    free(path);
}

/* ---- a full disk --------------------------------------------------------------------------------------- */

/* A small disk in the data directory's place; false where that is not allowed. */
static bool mount_small(restart_t *t, const char *size)
{
    char *options = mem_printf("size=%s", size);
    bool mounted = mount("tmpfs", t->data, "tmpfs", 0, options) == 0;
    if (!mounted) printf("skipped: a small disk cannot be mounted here (%s)\n", strerror(errno));
    free(options);
    return mounted;
}

/* Fills it to the last byte. */
static void fill_disk(const restart_t *t)
{
    char *path = scratch_path(t->data, "filler");
    int file = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    assert_true(file >= 0);
    char bytes[4096] = {0};
    while (write(file, bytes, sizeof bytes) > 0) {
    }
    close(file);
    free(path);
}

static void make_room(const restart_t *t)
{
    char *path = scratch_path(t->data, "filler");
    assert_int_equal(unlink(path), 0);
    free(path);
}

static void a_full_disk_pauses_and_loses_nothing(void **state)
{
    restart_t *t = *state;
    if (!mount_small(t, "8m")) return;
    uint64_t job = begin_job_of(t, 1, rig_settings().spp * 2 / 3);
    wait_generations(t, 1);
    fill_disk(t);
    rig_wait_output(t->rig, t->rig->master, "CHECKPOINTS PAUSE");
    /* New jobs are refused with the reason; nothing is half done. */
    job_settings_t settings = rig_settings();
    hash_t blob = {{0}};
    wire_message_t message;
    assert_int_equal(remote_status(t->rig->remote, job, &message).code, RESULT_OK);
    wire_hash_get(&message.envelope->job_status_reply->jobs[0]->blob, &blob);
    wire_free(&message);
    uint64_t other;
    result_t result = remote_submit(t->rig->remote, "another", &settings, &blob, &other);
    if (result.code != RESULT_OK) assert_non_null(strstr(result.message, "full"));
    bool refused = result.code != RESULT_OK;
    /* Merging goes on to the end of the job, which cannot be written either: it waits. */
    rig_wait_samples(t->rig, job, rig_status(t->rig, job).samples_total);
    rig_sleep(1);
    assert_int_equal(rig_status(t->rig, job).state, JOB_FINISHING);
    make_room(t);
    assert_reference(t, job);
    rig_wait_output(t->rig, t->rig->master, "checkpoints go on");
    restart_master(t);
    assert_reference(t, job);
    if (!refused) assert_int_equal(rig_wait_job(t->rig, other).state, JOB_DONE);
}

/* Killed while the disk is full: what the last checkpoint held is there. */
static void a_kill_on_a_full_disk_costs_one_interval(void **state)
{
    restart_t *t = *state;
    if (!mount_small(t, "8m")) return;
    uint64_t job = begin_job_of(t, 1, rig_settings().spp * 2 / 3);
    wait_generations(t, 1);
    fill_disk(t);
    rig_wait_output(t->rig, t->rig->master, "CHECKPOINTS PAUSE");
    restart_master(t); /* it starts all the same, */
    rig_wait_output(t->rig, t->rig->master, "its film is here");
    assert_true(rig_status(t->rig, job).samples_done > 0);
    kill(t->rig->master, SIGTERM); /* and it ends properly, */
    assert_int_equal(rig_wait_exit(t->rig, t->rig->master, 30), 0);
    fill_disk(t);
    start_master(t); /* and starts again */
    make_room(t);
    assert_reference(t, job);
}

/* Films of jobs that are over go before a checkpoint is given up, but not those of retained jobs. */
static void films_of_the_past_make_room(void **state)
{
    restart_t *t = *state;
    if (!mount_small(t, "16m")) return;
    start_master(t);
    rig_start_worker(t->rig);
    rig_start_worker(t->rig);
    job_settings_t settings = rig_settings(), big = settings;
    settings.spp = 32;
    big.width = big.height = 256;
    big.spp = 2;
    for (uint64_t i = 1; i <= 5; i++) {
        big.seed++;
        uint64_t job = rig_submit(t->rig, &big);
        if (i == 1)
            assert_int_equal(
                remote_order(t->rig->remote, &(job_order_t){.job = job, .kind = ORDER_RETAIN}).code,
                RESULT_OK);
        assert_int_equal(rig_wait_job(t->rig, job).state, JOB_DONE);
        char *image = mem_printf("%s/job-%d.exr", t->data, (int)job);
        assert_int_equal(unlink(image), 0); /* it is films that this is about */
        free(image);
    }
    uint64_t job = rig_submit(t->rig, &settings);
    assert_reference(t, job);
    char *output = rig_output(t->rig, t->rig->master);
    assert_non_null(strstr(output, "the film of job 2"));
    assert_null(strstr(output, "the film of job 1 "));
    free(output);
    job_order_t more = {.job = 2, .kind = ORDER_EXTEND, .spp = 4};
    result_t result = remote_order(t->rig->remote, &more);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "no longer kept"));
    more.job = 1;
    assert_int_equal(remote_order(t->rig->remote, &more).code, RESULT_OK);
}

/* What the tests above mount. */
static int tear_down_mount(void **state)
{
    restart_t *t = *state;
    rig_destroy(&t->rig);
    umount2(t->data, MNT_DETACH);
    return tear_down(state);
}

/* ---- cost and time
 * ---------------------------------------------------------------------------------------------- */

/* When so many samples had been counted. */
typedef struct {
    double time;
    uint64_t samples;
} progress_t;

/* A kill in mid-render costs the work of one checkpoint interval at most. */
static void a_kill_costs_one_interval(void **state)
{
    restart_t *t = *state;
    const double interval = 1;
    static progress_t progress[2000];
    size_t count = 0;
    rig_start_master_on(t->rig, t->data, INTERVAL, (const char *[]){"--checkpoint", "1", NULL});
    rig_start_worker(t->rig);
    job_settings_t settings = rig_settings(), endless = settings;
    endless.spp = 1 << 20;
    uint64_t job = rig_submit(t->rig, &endless);
    wait_generations(t, 2);
    double end = clock_now() + 1.9;
    while (clock_now() < end && count < ARRAY_LENGTH(progress)) {
        progress[count++] = (progress_t){clock_now(), rig_status(t->rig, job).samples_done};
        rig_sleep(0.01);
    }
    rig_kill_master(t->rig);
    double killed = clock_now();
    start_master(t);
    rig_wait_output(t->rig, t->rig->master, "its film is here");
    char *output = rig_output(t->rig, t->rig->master);
    unsigned long long restored = 0;
    assert_int_equal(sscanf(strstr(output, " holds "), " holds %llu", &restored), 1);
    free(output);
    size_t at = count - 1;
    while (at > 0 && progress[at].samples > restored) at--;
    double lost = killed - progress[at].time;
    printf("killed: %.2f s of work lost, with a checkpoint every %g s; %llu of %llu samples\n", lost,
           interval, (unsigned long long)(progress[count - 1].samples - restored),
           (unsigned long long)progress[count - 1].samples);
    assert_true(restored > 0);
    assert_true(
        lost < interval + 3); /* what the writing takes, and the checkpointer's patience, on a busy machine */
}

/* However often they are asked for, checkpoints take 2% of the time. */
static void checkpoints_cost_little(void **state)
{
    restart_t *t = *state;
    start_master(t); /* ten a second, says the option */
    rig_start_worker(t->rig);
    job_settings_t settings = rig_settings();
    settings.width = settings.height = 192;
    settings.spp = 1 << 20;
    uint64_t job = rig_submit(t->rig, &settings);
    rig_wait_samples(t->rig, job, 1);
    double start = clock_now();
    wait_generations(t, 2);
    rig_sleep(2);
    double elapsed = clock_now() - start, busy = 0, seconds = 0;
    int count = 0;
    char *output = rig_output(t->rig, t->rig->master);
    for (const char *line = output; (line = strstr(line, " MB in ")) != NULL; line++)
        if (sscanf(line, " MB in %lf s, ", &seconds) == 1 && ++count > 0) busy += seconds;
    printf("%d checkpoints took %.2f s of %.1f s\n", count, busy, elapsed);
    assert_true(count >= 2);
    /* The last one may just have been made, and its pause is still to come. The log rounds to 0.01 s. */
    assert_true(busy - seconds <= 0.021 * elapsed + 0.005 * count);
    free(output);
}

/* A batch of the given units with sums like noise, which no compression makes small. */
static batch_t noisy_batch(const peer_work_t *work)
{
    batch_t batch = peer_render(&work->settings, work->units, work->unit_count);
    size_t values = sum_image_values(&work->settings, SUM_SPLAT);
    uint64_t random = 88172645463325252u;
    int64_t *splats = batch_frame(&batch, SUM_SPLAT);
    for (size_t i = 0; i < values; i++) {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        splats[i] = (int64_t)(random >> 33);
    }
    for (size_t i = 0; i < batch.sums[SUM_EYE].count; i++)
        batch.sums[SUM_EYE].values[i] += splats[i % values] >> 2;
    return batch;
}

/* Waits until the master lets the batch of the job in: it takes no large one unasked. */
static void offer(peer_t *peer, const batch_t *batch, uint64_t job)
{
    Lm__BatchOffer offer = LM__BATCH_OFFER__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_OFFER;
    envelope.batch_offer = &offer;
    offer.worker = peer->worker;
    offer.job = job;
    offer.bytes = sum_frame_bytes(&batch->settings);
    wire_message_t answer = peer_ask_bulk(peer, &envelope, NULL, 0);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_BATCH_GRANT);
    wire_free(&answer);
}

/* Works on the job with a scripted worker until every pixel has samples. */
static void cover_image(restart_t *t, uint64_t job, uint64_t samples)
{
    peer_t *peer = peer_new(t->rig->port);
    peer_work_t *work = mem_alloc(sizeof *work);
    peer_hello(peer, WIRE_VERSION, 64, NULL);
    while (rig_status(t->rig, job).samples_done < samples) {
        peer_work(peer, samples, 1 << 16, work);
        if (work->job == 0) { /* it has more in hand than it delivers, or the merge outlived its lease */
            if (work->refused.code != RESULT_OK) peer_hello(peer, WIRE_VERSION, 64, NULL);
            rig_sleep(0.05);
            continue;
        }
        assert_true(work->job == job);
        batch_t batch = noisy_batch(work);
        offer(peer, &batch, job);
        assert_int_equal(peer_send_batch(peer, job, &batch).code, RESULT_OK);
        batch_free(&batch);
    }
    free(work);
    peer_goodbye(peer);
    peer_destroy(&peer);
}

/* The time from the start of the process to the first assignment. */
static void a_large_job_is_back_soon(void **state)
{
    restart_t *t = *state;
    job_settings_t settings = rig_settings();
    settings.width = 1920;
    settings.height = 1080;
    settings.spp = 1024;
    start_master(t);
    uint64_t job = rig_submit(t->rig, &settings);
    cover_image(t, job, (uint64_t)settings.width * (uint64_t)settings.height * 2);
    uint64_t done = rig_status(t->rig, job).samples_done;
    kill(t->rig->master, SIGTERM); /* its last checkpoint is of everything */
    assert_int_equal(rig_wait_exit(t->rig, t->rig->master, 60), 0);
    double start = clock_now();
    start_master(t);
    peer_t *peer = peer_new(t->rig->port);
    peer_work_t *work = mem_alloc(sizeof *work);
    peer_hello(peer, WIRE_VERSION, 4, NULL);
    for (peer_work(peer, 1 << 20, 1 << 16, work); work->job == 0; peer_work(peer, 1 << 20, 1 << 16, work))
        rig_sleep(0.005);
    double seconds = clock_now() - start;
    assert_true(work->job == job && rig_status(t->rig, job).samples_done == done);
    unsigned found[8];
    struct stat status = {0};
    if (generations(t, found) > 0) {
        char *path = mem_printf("%s/job-1.%u.film", t->films, found[0]);
        stat(path, &status);
        free(path);
    }
    printf("1920 x 1080, a checkpoint of %.0f MB: restart to first assignment in %.2f s\n",
           1e-6 * (double)status.st_size, seconds);
    assert_true(seconds < 20); /* 2 s on a machine that does nothing else */
    free(work);
    peer_destroy(&peer);
}

#define RESTART_TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
#define MOUNT_TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down_mount)

int main(void)
{
    const struct CMUnitTest tests[] = {
        RESTART_TEST(a_master_killed_at_any_moment_loses_nothing),
        RESTART_TEST(many_kills_in_a_row_cost_no_more_than_one),
        RESTART_TEST(a_queue_survives),
        RESTART_TEST(a_job_that_was_ending_ends),
        RESTART_TEST(a_job_that_is_over_is_extended),
        RESTART_TEST(sigterm_saves_everything),
        RESTART_TEST(a_damaged_checkpoint_costs_one_generation),
        RESTART_TEST(without_any_good_checkpoint_the_job_begins_anew),
        RESTART_TEST(a_damaged_journal_is_rebuilt),
        RESTART_TEST(a_lost_scene_pauses_its_job),
        RESTART_TEST(a_damaged_scene_pauses_its_job),
        MOUNT_TEST(a_full_disk_pauses_and_loses_nothing),
        MOUNT_TEST(a_kill_on_a_full_disk_costs_one_interval),
        MOUNT_TEST(films_of_the_past_make_room),
        RESTART_TEST(a_kill_costs_one_interval),
        RESTART_TEST(checkpoints_cost_little),
        RESTART_TEST(a_large_job_is_back_soon),
    };

    return cmocka_run_group_tests(tests, NULL, NULL);
}
