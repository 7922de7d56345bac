/* toy_farm: a master/farm/farm.h without sockets or threads, in a time of its own: a test plays the workers,
 * the image writer and the checkpointer, and what would take hours takes a moment. Batches hold sums that are
 * a function of their units, so that a film can be compared. Calls end the test on failure. */
#ifndef LIGHTMILL_TOY_FARM_H
#define LIGHTMILL_TOY_FARM_H

#include "master/farm/farm.h"

/* A farm with room for six films of toy_settings; films outlive it if `keeps`. */
farm_t *toy_farm(bool keeps);
/* The same, with a folder where jobs that are verified keep batches; it outlives the farm. It has room for
 * the films of jobs that learn. */
farm_t *toy_verifying_farm(const char *spool_dir);
/* The same with room for so many bytes of evidence. */
farm_t *toy_quota_farm(const char *spool_dir, uint64_t quota);
/* A toy_farm(true) whose operator is told of its jobs. */
farm_t *toy_telling_farm(void);
/* A farm that has room for the films of jobs that learn, too. */
farm_t *toy_roomy_farm(void);
/* A toy_farm(false) whose workers are told to deliver every so many seconds, not every ten. */
farm_t *toy_brisk_farm(double batch_interval);
/* 32 x 32 pixels in four tiles, 4 spp, no features. */
job_settings_t toy_settings(void);
uint64_t toy_submit(farm_t *farm, double now, const job_settings_t *settings, int priority);
uint64_t toy_submit_on(farm_t *farm, double now, const job_settings_t *settings, const job_terms_t *terms);
uint64_t toy_hello(farm_t *farm, double now, uint32_t threads);
/* Says hello from a host of the name's part before the colon: it is the party of workers without keys. */
result_t toy_say_hello(farm_t *farm, double now, worker_hello_t hello, uint64_t *worker);
/* A worker of some name and fingerprint (0: it does not say). */
uint64_t toy_join(farm_t *farm, double now, const char *name, uint32_t threads, uint8_t fingerprint);
/* A heartbeat; false when the worker is not known. */
bool toy_beat(farm_t *farm, double now, uint64_t worker);

/* Asks for work. */
typedef struct {
    uint64_t job; /* 0: none */
    uint64_t check;
    size_t count;
    unit_t units[64];
    issue_t issues[64];
    bool one_wrong; /* a lie is about the first unit alone */
} toy_work_t;
toy_work_t toy_take(farm_t *farm, double now, uint64_t worker, uint64_t samples, uint64_t unit_samples);
/* Fills issues[count] as if a worker had been given these units of a job, whose number it knows. */
void toy_issue(farm_t *farm, uint64_t worker, uint64_t job, uint64_t check, const unit_t *units, size_t count,
               issue_t *issues);
/* Delivers units as one batch, as if they had been issued to the worker. */
result_t toy_deliver(farm_t *farm, double now, uint64_t worker, uint64_t job, const unit_t *units,
                     size_t count);
/* The same, with the number of the assignment, and `lie` added to every sum. */
result_t toy_deliver_work(farm_t *farm, double now, uint64_t worker, const toy_work_t *work, int64_t lie);
/* The same, as the units were issued: with the MACs that they came with. */
result_t toy_deliver_as(farm_t *farm, double now, uint64_t worker, const toy_work_t *work);
/* The right sums, with the claim that some overflowed. */
result_t toy_deliver_overflow(farm_t *farm, double now, uint64_t worker, const toy_work_t *work);
/* Takes and delivers all that there is of a job, at one moment. */
void toy_work_off(farm_t *farm, double now, uint64_t worker, uint64_t job);

job_report_t toy_report(farm_t *farm, double now, uint64_t job);
job_state_t toy_state(farm_t *farm, double now, uint64_t job);
result_t toy_order(farm_t *farm, double now, uint64_t job, order_kind_t kind);

/* The image writer: writes the images that are due, with this result; returns how many. */
int toy_write_images(farm_t *farm, double now, result_t result);

/* The checkpointer: a checkpoint in memory. */
typedef struct {
    uint64_t job; /* 0: none */
    film_t *film;
    schedule_state_t state;
} toy_film_t;
/* Makes the next checkpoint, which is reported with this result; false when none is due. */
bool toy_checkpoint(farm_t *farm, double now, result_t result, toy_film_t *film);
/* Loads the film of the job that wants one, which must be this one (NULL: there is no checkpoint); false when
 * none does. */
bool toy_load(farm_t *farm, double now, toy_film_t *film);
void toy_film_free(toy_film_t *film);

/* The hash of the sums of a job that is being worked on. */
hash_t toy_sums(farm_t *farm, uint64_t job);

#endif
