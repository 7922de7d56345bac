/* processes: the master, the relay and the workers of a run: real processes, started again when a fault has
 * ended them. One that ends by itself is a violation. */
#ifndef LIGHTMILL_CHAOS_PROCESSES_H
#define LIGHTMILL_CHAOS_PROCESSES_H

#include "tests/chaos/dice.h"
#include "tests/chaos/passes.h"
#include "tests/chaos/report.h"
#include "tests/chaos/world.h"

#include <stdbool.h>
#include <sys/types.h>

enum {
    PROCESSES_MAX_WORKERS = 12,
    PROCESSES_MAX_FROZEN = 4,
    PROCESSES_RELAY_PORT = 10,
    PROCESSES_PORT = 7420
};

/* Any of the processes. */
typedef struct {
    char *name, *log;
    world_t *world; /* NULL: it sees all as it is */
    pid_t process;  /* 0: none */
    double back_at; /* when it is started again, clock_now(); INFINITY: it is not */
    bool stopped;   /* SIGSTOP */
    bool leaving;   /* it was told to end, */
    bool young;     /* a moment after its start */
    bool busy;      /* a fault is at work on it */
    bool retired;   /* it is not started again when it has left */
    double started;
    unsigned starts;
} member_t;

typedef struct {
    member_t member;
    char *address; /* of the master, as this worker sees it */
    char *cache;
    int network;               /* namespace; -1: the driver's */
    const char *const *passes; /* what it shows */
} processes_worker_t;

typedef struct {
    report_t *report;
    const char *folder; /* logs, caches */
    const char *data;   /* the master's */
    const char *listen; /* the master's address, without port */
    const passes_t *passes;
    bool worlds; /* clocks can jump, and disks be slow */
    int port;
    double lease;
    /* Made by processes_init. */
    char *master_program, *worker_program, *relay_program;
    member_t master, relay;
    char *relay_address; /* of the master, as the relay sees it; NULL: there is no relay */
    processes_worker_t workers[PROCESSES_MAX_WORKERS];
    size_t worker_count;
    bool disk_full; /* a master that does not come up is forgiven */
    unsigned master_failures;
    pid_t frozen[PROCESSES_MAX_FROZEN];
    size_t frozen_count;
    double now; /* of the last tick */
} processes_t;

/* Fills in what is its own, after what is the caller's. */
void processes_init(processes_t *processes);
/* Kills everyone. */
void processes_free(processes_t *processes);
/* Adds a worker, which is started at once or (`later`) by processes_start_worker. */
processes_worker_t *processes_add_worker(processes_t *processes, const char *host, int network, bool later);
/* Starts the relay, which dials the master at `host` and listens PROCESSES_RELAY_PORT ports above it. */
void processes_add_relay(processes_t *processes, const char *host);
/* Adds a worker behind the relay. */
void processes_add_relay_worker(processes_t *processes);
void processes_start_worker(processes_t *processes, processes_worker_t *worker);
/* Starts whoever is due; notices who has ended. */
void processes_tick(processes_t *processes, double now);

/* Kill -9; it is back after so many seconds. False when there is nobody to kill. */
bool processes_kill(processes_t *processes, member_t *member, double away);
/* Stops it for ever, and leaves it alone until the end; another takes its place. */
bool processes_freeze(processes_t *processes, processes_worker_t *worker, double away);
/* SIGTERM; it is back so many seconds after it has left. */
bool processes_dismiss(processes_t *processes, member_t *member, double away);
bool processes_stop(member_t *member);
bool processes_continue(member_t *member);
/* A worker that is idle in the sense that no fault is at work on it; NULL when there is none. `pick` chooses.
 */
processes_worker_t *processes_pick_worker(processes_t *processes, uint64_t pick);
/* Everyone goes on, and whoever is away is back at once. */
void processes_heal(processes_t *processes);
/* True when a process said what a sanitizer says; reported as a violation. */
void processes_check_logs(processes_t *processes);

#endif
