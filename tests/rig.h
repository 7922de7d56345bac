/* rig: a farm of real processes on this machine, for the tests that hurt it. Calls end the test on failure,
 * and whatever was started dies with the test. */
#ifndef LIGHTMILL_RIG_H
#define LIGHTMILL_RIG_H

#include "client/farm/remote.h"

#include <sys/types.h>

enum { RIG_MAX_PROCESSES = 32 };

/* The arguments of a program. */
#define ARGUMENTS(...) ((const char *[]){__VA_ARGS__, NULL})

typedef struct {
    char *folder; /* scratch: logs, caches, data, images */
    char *data;   /* the data directory of the last master of rig_start_master */
    int port;     /* of the master's control socket; the bulk socket has the next one */
    pid_t master; /* 0: none */
    char *keys;   /* folder of the keys master, worker and client and of the list "allow"; NULL: no keys */
    remote_t *remote;
    pid_t started[RIG_MAX_PROCESSES];
    bool ended[RIG_MAX_PROCESSES]; /* has been waited for */
    int started_count;
} rig_t;

/* Samples a pixel of the job below, as text. The renderer is many times slower under the thread sanitizer. */
#ifdef __SANITIZE_THREAD__
#define RIG_SPP "64"
#else
#define RIG_SPP "192"
#endif
enum { RIG_PIXELS = 64 * 64, RIG_MOST_SPP = 8192 };
/* What the tests render: seed-hidden, small, a few seconds of a core. Only what is hurt in the middle needs
 * as many samples. */
job_settings_t rig_settings(void);
/* The pixel hash of that job with so many samples a pixel, rendered by `lightmill render` without any farm:
 * once a program, or once for all that have the same folder in $LIGHTMILL_REFERENCES. */
hash_t rig_reference_at(uint64_t spp);
/* Of rig_settings as they are. */
hash_t rig_reference(void);

/* A port of which the next one is free too (tests/ports.h). */
int rig_free_ports(void);
/* An empty rig with a free port. */
rig_t *rig_new(void);
/* Kills everything and removes the folder. */
void rig_destroy(rig_t **rig);
/* For tests whose state is an empty rig; with rig_reference computed, so that no test takes longer for it. */
int rig_set_up(void **state);
int rig_set_up_with_reference(void **state);
int rig_tear_down(void **state);

/* Makes keys for the farm, which is to use them from now on; before anything is started. */
void rig_use_keys(rig_t *rig);

/* Starts a master on the rig's port with quick time-outs (lease 1 s) and waits until it answers. */
void rig_start_master(rig_t *rig, double batch_interval);
/* Starts a master on the data of the last one of rig_start_master, which has ended. */
void rig_restart_master(rig_t *rig, double batch_interval);
/* The same on a data directory that the caller names, with further options (NULL-terminated; NULL: none). */
void rig_start_master_on(rig_t *rig, const char *data, double batch_interval, const char *const *more);
/* Kills the master with -9. */
void rig_kill_master(rig_t *rig);
/* Starts a worker with one thread and its own cache. */
pid_t rig_start_worker(rig_t *rig);

/* Starts one of our programs with these arguments (NULL-terminated), as rig_start_command does. */
pid_t rig_start_program(rig_t *rig, const char *program, const char *const *arguments);
/* Starts the `lightmill` command with these arguments (NULL-terminated); its output goes to a file in the
 * folder: rig_output. */
pid_t rig_start_command(rig_t *rig, const char *const *arguments);
/* Waits for a process: its exit code, or 1000 + the signal that ended it. Fails the test after `seconds`. */
int rig_wait_exit(rig_t *rig, pid_t process, double seconds);
/* Both together. */
int rig_run(rig_t *rig, const char *const *arguments);
/* What a process wrote to stdout and stderr; fresh memory. */
char *rig_output(rig_t *rig, pid_t process);

/* Uploads the scene and submits a job. */
uint64_t rig_submit(rig_t *rig, const job_settings_t *settings);
uint64_t rig_submit_on(rig_t *rig, const job_settings_t *settings, const job_terms_t *terms);
/* A job of rig_settings without an end, for tests that hurt it in its middle: they wait for what they wait
 * for, and then end it. */
uint64_t rig_submit_endless(rig_t *rig);
/* Gives a job that has none an end, soon after what is handed out: something is left to render. */
void rig_end_job(rig_t *rig, uint64_t job);
typedef struct {
    uint32_t state, workers, workers_seen;
    uint64_t samples_done, samples_total, batches_refused, units_reissued;
    uint64_t issued, counted, returned, out; /* pixel samples */
    char message[200];
} rig_status_t;
rig_status_t rig_status(rig_t *rig, uint64_t job);
/* Waits until a process of the rig has written this. */
void rig_wait_output(rig_t *rig, pid_t process, const char *text);
/* Waits until so many of the job's samples are counted, or it has ended. */
void rig_wait_samples(rig_t *rig, uint64_t job, uint64_t samples);
/* Waits until so many workers have had work of the job, or it has ended. */
void rig_wait_workers_seen(rig_t *rig, uint64_t job, uint32_t workers);
/* Waits for the end of the job and returns its last status. */
rig_status_t rig_wait_job(rig_t *rig, uint64_t job);
/* Waits for the end of a job of rig_settings, or of these with other samples: it is done, and its image is
 * the reference. Returns its last status. */
rig_status_t rig_assert_reference(rig_t *rig, uint64_t job);
/* Waits until so many workers are connected. */
void rig_wait_workers(rig_t *rig, uint32_t workers);
/* The pixel hash of the job's image so far. */
hash_t rig_image_hash(rig_t *rig, uint64_t job);
/* The pixel hash of a file. */
hash_t rig_file_hash(const char *path);

void rig_sleep(double seconds);

#endif
