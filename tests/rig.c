/* rig: see rig.h. */
#include "tests/rig.h"

#include "client/scene/loaded_scene.h"
#include "common/image/image.h"
#include "tests/ports.h"
#include "tests/scratch.h"

#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const char SCENE[] = "scenes/seed-hidden";
static const double PATIENCE = 240; /* seconds for anything, on a machine that does other things too */
static const double ANSWER = 60;    /* seconds, of the master: no test measures it */
/* Samples a pixel: that a job without an end still has when it is given one, and of which this end is a
 * multiple. So there are few different ends, and few references are rendered. */
enum { LEFT_TO_RENDER = 12, END_STEP = 32 };

/* Ends the test with the message of a failed result. */
static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

void rig_sleep(double seconds)
{
    struct timespec time = {.tv_sec = (time_t)seconds,
                            .tv_nsec = (long)(1e9 * (seconds - (double)(time_t)seconds))};
    while (nanosleep(&time, &time) != 0 && errno == EINTR) {
    }
}

/* ---- processes ---------------------------------------------------------------------------------------- */

/* The path of one of our programs: this test is BUILD/tests/farm/NAME. The caller frees it. */
static char *program_path(const char *program)
{
    char self[4000];
    ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    assert_true(length > 0);
    self[length] = '\0';
    for (int i = 0; i < 3; i++) {
        char *slash = strrchr(self, '/');
        assert_non_null(slash);
        *slash = '\0';
    }
    return mem_printf("%s/%s", self, program);
}

static char *output_path(const rig_t *rig, int index)
{
    return mem_printf("%s/output-%d", rig->folder, index);
}

static pid_t start(rig_t *rig, const char *program, const char *const *arguments)
{
    char *path = program_path(program);
    const char *argv[64] = {path};
    for (size_t i = 0; arguments[i]; i++) {
        assert_true(i + 2 < ARRAY_LENGTH(argv));
        argv[i + 1] = arguments[i];
    }
    assert_true(rig->started_count < RIG_MAX_PROCESSES);
    char *output = output_path(rig, rig->started_count);
    int file = open(output, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    assert_true(file >= 0);
    pid_t process = fork();
    if (process == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        dup2(file, STDOUT_FILENO);
        dup2(file, STDERR_FILENO);
        execv(path, (char *const *)argv);
        _exit(127);
    }
    assert_true(process > 0);
    close(file);
    free(output);
    free(path);
    rig->started[rig->started_count++] = process;
    return process;
}

static int index_of(const rig_t *rig, pid_t process)
{
    for (int i = 0; i < rig->started_count; i++)
        if (rig->started[i] == process) return i;
    fail_msg("process %d is not of this rig", (int)process);
    return -1;
}

int rig_wait_exit(rig_t *rig, pid_t process, double seconds)
{
    double deadline = clock_now() + seconds;
    int status, index = index_of(rig, process);
    while (waitpid(process, &status, WNOHANG) != process) {
        if (clock_now() > deadline) fail_msg("process %d did not end within %g s", (int)process, seconds);
        rig_sleep(0.01);
    }
    rig->ended[index] = true;
    return WIFSIGNALED(status) ? 1000 + WTERMSIG(status) : WEXITSTATUS(status);
}

char *rig_output(rig_t *rig, pid_t process)
{
    char *path = output_path(rig, index_of(rig, process));
    uint8_t *data;
    size_t size;
    must(file_read(path, 1 << 24, &data, &size));
    free(path);
    return (char *)data;
}

pid_t rig_start_program(rig_t *rig, const char *program, const char *const *arguments)
{
    return start(rig, program, arguments);
}

pid_t rig_start_command(rig_t *rig, const char *const *arguments)
{
    return start(rig, "lightmill", arguments);
}

int rig_run(rig_t *rig, const char *const *arguments)
{
    return rig_wait_exit(rig, rig_start_command(rig, arguments), PATIENCE);
}

/* ---- the farm ----------------------------------------------------------------------------------------- */

int rig_free_ports(void)
{
    return ports_choose(2);
}

rig_t *rig_new(void)
{
    rig_t *rig = mem_zalloc(1, sizeof *rig);
    rig->folder = scratch_new();
    rig->port = rig_free_ports();
    return rig;
}

/* Prints what a sanitizer found in any of the processes; false when there is something. */
static bool sanitizers_silent(rig_t *rig)
{
    bool silent = true;
    for (int i = 0; i < rig->started_count; i++) {
        char *text = rig_output(rig, rig->started[i]);
        const char *report = strstr(text, "Sanitizer");
        if (report == NULL) report = strstr(text, "runtime error");
        if (report)
            fprintf(stderr, "---- process %d\n%.6000s\n", i, report - text > 100 ? report - 100 : text);
        silent = silent && report == NULL;
        free(text);
    }
    return silent;
}

void rig_destroy(rig_t **rig_pointer)
{
    rig_t *rig = *rig_pointer;
    if (rig == NULL) return;
    remote_close(&rig->remote);
    for (int i = 0; i < rig->started_count; i++)
        if (!rig->ended[i]) kill(rig->started[i], SIGKILL);
    for (int i = 0; i < rig->started_count; i++)
        if (!rig->ended[i]) waitpid(rig->started[i], NULL, 0);
    bool silent = sanitizers_silent(rig);
    scratch_destroy(&rig->folder);
    free(rig->keys);
    free(rig->data);
    free(rig);
    *rig_pointer = NULL;
    if (!silent) fail_msg("a sanitizer found something");
}

int rig_set_up(void **state)
{
    *state = rig_new();
    return 0;
}

int rig_set_up_with_reference(void **state)
{
    rig_reference();
    return rig_set_up(state);
}

int rig_tear_down(void **state)
{
    rig_destroy((rig_t **)state);
    return 0;
}

void rig_use_keys(rig_t *rig)
{
    key_pair_t master, worker, client;
    rig->keys = scratch_path(rig->folder, "keys");
    must(key_files_make(rig->keys, "master", &master));
    must(key_files_make(rig->keys, "worker", &worker));
    must(key_files_make(rig->keys, "client", &client));
    char *path = scratch_path(rig->keys, "allow");
    char *list = mem_printf("worker %s farm\nclient %s test\n", worker.open, client.open);
    scratch_write(path, list, strlen(list));
    free(list);
    free(path);
}

/* The path of a file among the keys; NULL when there are none. */
static char *key_path(const rig_t *rig, const char *name)
{
    return rig->keys ? scratch_path(rig->keys, name) : NULL;
}

static void connect_remote(rig_t *rig)
{
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", rig->port);
    char *secret = key_path(rig, "client.secret"), *master = key_path(rig, "master.key");
    dial_options_t options = {.role = "client", .key = secret, .master_key = master, .insecure = !rig->keys};
    dial_keys_t keys;
    remote_close(&rig->remote);
    must(dial_keys_find(&options, "127.0.0.1", &keys));
    must(remote_open_with(NULL, endpoint, NULL, ANSWER, &keys, &rig->remote));
    free(endpoint);
    free(secret);
    free(master);
    wire_message_t message;
    must(remote_status(rig->remote, 0, &message));
    wire_free(&message);
}

void rig_start_master_on(rig_t *rig, const char *data, double batch_interval, const char *const *more)
{
    char *listen = mem_printf("127.0.0.1:%d", rig->port), *interval = mem_printf("%g", batch_interval);
    char *key = key_path(rig, "master.secret"), *allow = key_path(rig, "allow");
    const char *arguments[40] = {"--listen", listen, "--data",           data,     "--heartbeat", "0.2",
                                 "--lease",  "1",    "--batch-interval", interval, "--verbose"};
    const char *const keys[] = {"--key", key, "--allow", allow};
    size_t count = 11;
    for (size_t i = 0; i < ARRAY_LENGTH(keys) && key != NULL; i++) arguments[count++] = keys[i];
    for (; more != NULL && *more != NULL; more++) {
        assert_true(count + 1 < ARRAY_LENGTH(arguments));
        arguments[count++] = *more;
    }
    rig->master = start(rig, "lightmill-master", arguments);
    free(listen);
    free(interval);
    free(key);
    free(allow);
    connect_remote(rig);
}

void rig_start_master(rig_t *rig, double batch_interval)
{
    free(rig->data);
    rig->data = mem_printf("%s/data-%d", rig->folder, rig->started_count);
    rig_restart_master(rig, batch_interval);
}

void rig_restart_master(rig_t *rig, double batch_interval)
{
    rig_start_master_on(rig, rig->data, batch_interval, NULL);
}

void rig_kill_master(rig_t *rig)
{
    kill(rig->master, SIGKILL);
    assert_int_equal(rig_wait_exit(rig, rig->master, 10), 1000 + SIGKILL);
    rig->master = 0;
}

pid_t rig_start_worker(rig_t *rig)
{
    char *address = mem_printf("127.0.0.1:%d", rig->port);
    char *cache = mem_printf("%s/cache-%d", rig->folder, rig->started_count);
    char *name = mem_printf("%d", rig->started_count);
    char *key = key_path(rig, "worker.secret"), *master = key_path(rig, "master.key");
    pid_t worker =
        start(rig, "lightmill-worker",
              (const char *[]){address, "--threads", "1", "--cache", cache, "--name", name, "--verbose",
                               key ? "--key" : NULL, key, "--master-key", master, NULL});
    free(address);
    free(cache);
    free(name);
    free(key);
    free(master);
    return worker;
}

/* ---- jobs --------------------------------------------------------------------------------------------- */

job_settings_t rig_settings(void)
{
    loaded_scene_t scene;
    must(scene_load(SCENE, NULL, &scene));
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.width = settings.height = 64;
    settings.spp = (uint32_t)strtoul(RIG_SPP, NULL, 10);
    settings.seed = 7;
    settings.film_scale = blob_film_scale(&scene.blob);
    scene_free(&scene);
    return settings;
}

uint64_t rig_submit(rig_t *rig, const job_settings_t *settings)
{
    return rig_submit_on(rig, settings, &(job_terms_t){.name = "test"});
}

uint64_t rig_submit_on(rig_t *rig, const job_settings_t *settings, const job_terms_t *terms)
{
    loaded_scene_t scene;
    uint64_t job;
    must(scene_load(SCENE, NULL, &scene));
    must(remote_put_blob(rig->remote, &scene.blob, NULL, NULL));
    must(remote_submit_job(rig->remote, terms, settings, &scene.blob.hash, &job));
    scene_free(&scene);
    return job;
}

uint64_t rig_submit_endless(rig_t *rig)
{
    job_settings_t settings = rig_settings();
    settings.spp = JOB_MAX_SPP;
    return rig_submit(rig, &settings);
}

rig_status_t rig_status(rig_t *rig, uint64_t job)
{
    wire_message_t message;
    must(remote_status(rig->remote, job, &message));
    const Lm__JobStatus *status = message.envelope->job_status_reply->jobs[0];
    rig_status_t copy = {.state = status->state,
                         .workers = status->workers,
                         .workers_seen = status->workers_seen,
                         .samples_done = status->samples_done,
                         .samples_total = status->samples_total,
                         .batches_refused = status->batches_refused,
                         .units_reissued = status->units_reissued,
                         .issued = status->samples_issued,
                         .counted = status->samples_counted,
                         .returned = status->samples_returned,
                         .out = status->samples_out};
    snprintf(copy.message, sizeof copy.message, "%s", status->message);
    wire_free(&message);
    return copy;
}

/* Prints the logs of all processes: what one needs to see when a farm hangs. */
static void dump_logs(rig_t *rig)
{
    for (int i = 0; i < rig->started_count; i++) {
        char *text = rig_output(rig, rig->started[i]);
        size_t length = strlen(text);
        fprintf(stderr, "---- process %d\n%s", i, length > 6000 ? text + length - 6000 : text);
        free(text);
    }
}

static void check_patience(rig_t *rig, double start_time, const char *what)
{
    if (clock_now() - start_time < PATIENCE) return;
    dump_logs(rig);
    fail_msg("waited %g s for %s", PATIENCE, what);
}

void rig_wait_output(rig_t *rig, pid_t process, const char *text)
{
    for (double start_time = clock_now();; rig_sleep(0.02)) {
        char *output = rig_output(rig, process);
        bool found = strstr(output, text) != NULL;
        free(output);
        if (found) return;
        check_patience(rig, start_time, text);
    }
}

void rig_wait_samples(rig_t *rig, uint64_t job, uint64_t samples)
{
    for (double start_time = clock_now();; rig_sleep(0.02)) {
        rig_status_t status = rig_status(rig, job);
        if (status.samples_done >= samples || job_state_final(status.state)) return;
        check_patience(rig, start_time, "samples");
    }
}

void rig_wait_workers_seen(rig_t *rig, uint64_t job, uint32_t workers)
{
    for (double start_time = clock_now();; rig_sleep(0.02)) {
        rig_status_t status = rig_status(rig, job);
        if (status.workers_seen >= workers || job_state_final(status.state)) return;
        check_patience(rig, start_time, "workers of the job");
    }
}

/* Extends the job to the next multiple of END_STEP samples a pixel. */
static void end_at_step(rig_t *rig, uint64_t job, uint64_t spp)
{
    uint64_t end = (spp + END_STEP - 1) / END_STEP * END_STEP;
    must(remote_order(rig->remote, &(job_order_t){.job = job, .kind = ORDER_EXTEND, .spp = (uint32_t)end}));
}

void rig_end_job(rig_t *rig, uint64_t job)
{
    rig_status_t status = rig_status(rig, job);
    end_at_step(rig, job, (status.counted + status.out) / RIG_PIXELS + LEFT_TO_RENDER);
    /* Where a tile was further already, the job ends there. */
    uint64_t end = rig_status(rig, job).samples_total / RIG_PIXELS;
    if (end % END_STEP != 0) end_at_step(rig, job, end);
}

rig_status_t rig_wait_job(rig_t *rig, uint64_t job)
{
    for (double start_time = clock_now();; rig_sleep(0.02)) {
        rig_status_t status = rig_status(rig, job);
        if (job_state_final(status.state)) return status;
        check_patience(rig, start_time, "the end of the job");
    }
}

void rig_wait_workers(rig_t *rig, uint32_t workers)
{
    for (double start_time = clock_now();; rig_sleep(0.02)) {
        wire_message_t message;
        must(remote_status(rig->remote, 0, &message));
        uint32_t connected = message.envelope->job_status_reply->workers;
        wire_free(&message);
        if (connected == workers) return;
        check_patience(rig, start_time, "workers");
    }
}

hash_t rig_file_hash(const char *path)
{
    image_t image;
    must(image_read_exr(path, &image));
    hash_t hash = image_hash(&image);
    image_free(&image);
    return hash;
}

hash_t rig_image_hash(rig_t *rig, uint64_t job)
{
    uint8_t *bytes;
    size_t size;
    must(remote_fetch_image(rig->remote, &(image_wish_t){.job = job}, &bytes, &size));
    char *path = scratch_path(rig->folder, "fetched.exr");
    scratch_write(path, bytes, size);
    hash_t hash = rig_file_hash(path);
    free(path);
    free(bytes);
    return hash;
}

static hash_t render_reference(uint64_t spp)
{
    rig_t *rig = rig_new();
    char *path = scratch_path(rig->folder, "reference.exr"), *count = mem_printf("%d", (int)spp);
    assert_int_equal(rig_run(rig, (const char *[]){"render", SCENE, "--resolution", "64x64", "--spp", count,
                                                   "--seed", "7", "--quiet", "-o", path, NULL}),
                     0);
    hash_t hash = rig_file_hash(path);
    free(count);
    free(path);
    rig_destroy(&rig);
    return hash;
}

/* From the folder that the programs of one run share (tests/run.sh): the first that asks renders, and the
 * others wait for it. Its lock ends with its process, so that another renders when it was killed. */
static hash_t shared_reference(const char *folder, uint64_t spp)
{
    char *path = mem_printf("%s/rig-%d", folder, (int)spp);
    int file = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    assert_true(file >= 0);
    struct flock lock = {.l_type = F_WRLCK, .l_whence = SEEK_SET}; /* the process's: it can lock again */
    while (fcntl(file, F_SETLKW, &lock) != 0) assert_int_equal(errno, EINTR);
    hash_t hash;
    if (pread(file, &hash, sizeof hash, 0) != sizeof hash) {
        hash = render_reference(spp);
        assert_true(pwrite(file, &hash, sizeof hash, 0) == sizeof hash);
    }
    close(file);
    free(path);
    return hash;
}

hash_t rig_reference_at(uint64_t spp)
{
    /* The one thing here that outlives a test: made by the first that asks. */
    static hash_t references[RIG_MOST_SPP + 1];
    static bool made[RIG_MOST_SPP + 1];
    assert_true(spp <= RIG_MOST_SPP);
    if (made[spp]) return references[spp];
    const char *folder = getenv("LIGHTMILL_REFERENCES");
    references[spp] = folder != NULL ? shared_reference(folder, spp) : render_reference(spp);
    made[spp] = true;
    return references[spp];
}

hash_t rig_reference(void)
{
    return rig_reference_at(strtoul(RIG_SPP, NULL, 10));
}

rig_status_t rig_assert_reference(rig_t *rig, uint64_t job)
{
    rig_status_t status = rig_wait_job(rig, job);
    assert_int_equal(status.state, JOB_DONE);
    assert_true(status.samples_done == status.samples_total);
    hash_t hash = rig_image_hash(rig, job), reference = rig_reference_at(status.samples_total / RIG_PIXELS);
    assert_true(hash_equal(&hash, &reference));
    return status;
}
