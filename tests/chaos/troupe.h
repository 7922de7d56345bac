/* troupe: the master, the relay and the workers of a run: real processes, started again when a fault has
 * ended them. One that ends by itself is a violation. */
#ifndef LIGHTMILL_TROUPE_H
#define LIGHTMILL_TROUPE_H

#include "tests/chaos/dice.h"
#include "tests/chaos/passes.h"
#include "tests/chaos/report.h"
#include "tests/chaos/world.h"

#include <stdbool.h>
#include <sys/types.h>

enum { TROUPE_MAX_WORKERS = 12, TROUPE_MAX_FROZEN = 4, TROUPE_RELAY_PORT = 10, TROUPE_PORT = 7420 };

/* Any process of the troupe. */
typedef struct {
    char *name, *log;
    world_t *world; /* NULL: it sees all as it is */
    pid_t process;  /* 0: none */
    double back_at; /* when it is started again, clock_now(); INFINITY: it is not */
    bool stopped;   /* SIGSTOP */
    bool leaving;   /* it was told to end */
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
} troupe_worker_t;

typedef struct {
    report_t *report;
    const char *folder; /* logs, caches */
    const char *data;   /* the master's */
    const char *listen; /* the master's address, without port */
    const passes_t *passes;
    bool worlds; /* clocks can jump, and disks be slow */
    int port;
    double lease;
    /* Made by troupe_init. */
    char *master_program, *worker_program, *relay_program;
    member_t master, relay;
    char *relay_address; /* of the master, as the relay sees it; NULL: there is no relay */
    troupe_worker_t workers[TROUPE_MAX_WORKERS];
    size_t worker_count;
    bool disk_full; /* a master that does not come up is forgiven */
    unsigned master_failures;
    pid_t frozen[TROUPE_MAX_FROZEN];
    size_t frozen_count;
    double now; /* of the last tick */
} troupe_t;

/* Fills in what is the troupe's own, after what is the caller's. */
void troupe_init(troupe_t *troupe);
/* Kills everyone. */
void troupe_free(troupe_t *troupe);
/* Adds a worker, which is started at once or (`later`) by troupe_start_worker. */
troupe_worker_t *troupe_add_worker(troupe_t *troupe, const char *host, int network, bool later);
/* Starts the relay, which dials the master at `host` and listens TROUPE_RELAY_PORT ports above it. */
void troupe_add_relay(troupe_t *troupe, const char *host);
/* Adds a worker behind the relay. */
void troupe_add_relay_worker(troupe_t *troupe);
void troupe_start_worker(troupe_t *troupe, troupe_worker_t *worker);
/* Starts whoever is due; notices who has ended. */
void troupe_tick(troupe_t *troupe, double now);

/* Kill -9; it is back after so many seconds. False when there is nobody to kill. */
bool troupe_kill(troupe_t *troupe, member_t *member, double away);
/* Stops it for ever, and leaves it alone until the end; another takes its place. */
bool troupe_freeze(troupe_t *troupe, troupe_worker_t *worker, double away);
/* SIGTERM; it is back so many seconds after it has left. */
bool troupe_dismiss(troupe_t *troupe, member_t *member, double away);
bool troupe_stop(member_t *member);
bool troupe_continue(member_t *member);
/* A worker that is idle in the sense that no fault is at work on it; NULL when there is none. `pick` chooses.
 */
troupe_worker_t *troupe_pick_worker(troupe_t *troupe, uint64_t pick);
/* Everyone goes on, and whoever is away is back at once. */
void troupe_heal(troupe_t *troupe);
/* True when a process said what a sanitizer says; reported as a violation. */
void troupe_check_logs(troupe_t *troupe);

#endif
