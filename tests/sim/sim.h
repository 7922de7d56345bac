/* sim: a farm with a real master, in a process of its own, and very many simulated workers (crowd.h), watched
 * from outside: what one master can take, and whether anything grows. */
#ifndef LIGHTMILL_SIM_H
#define LIGHTMILL_SIM_H

#include "tests/sim/crowd.h"

#include <stdio.h>

typedef struct {
    int workers;
    int width, height;
    double seconds;      /* how long it is measured, after all have joined */
    double interval;     /* seconds between batches */
    double power;        /* of a worker, in cores of this machine */
    double row;          /* seconds between lines of the table */
    bool no_learn;       /* the job does not learn */
    int relays;          /* between the workers and the master; 0: none */
    int batch_megabytes; /* the master's --batch-memory; 0: its default */
    bool pause_merging;  /* the master is stopped for a second now and then */
    const char *scene;
    const char *master; /* options for lightmill-master in addition, separated by spaces; NULL: none */
    FILE *table;        /* where the table goes; NULL: nowhere */
} sim_options_t;

/* What was measured. */
typedef struct {
    crowd_report_t all;             /* while it was measured */
    double relay_cpu, relay_memory; /* of all relays, cores; of the largest, bytes at most */
    double batches, raw, wire;      /* a second: batches, bytes of raw splat frames, bytes on the wire */
    double master_cpu, own_cpu;     /* cores */
    double memory_early, memory_late,
        memory_most;                        /* bytes: the master's mean in the first and the last third */
    double sent_early, sent_late;           /* batches without an answer, likewise */
    double interval;                        /* seconds between batches of a worker */
    double beat_median, beat_99, beat_most; /* seconds */
    uint64_t samples, samples_counted; /* by the workers' account and by the master's; of the whole run */
} sim_report_t;

sim_options_t sim_options_default(void);
result_t sim_run(const sim_options_t *options, sim_report_t *report);

#endif
