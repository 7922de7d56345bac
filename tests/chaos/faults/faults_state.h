/* faults_state: what the kinds of faults and their course share. The kinds are in death_and_sleep.c,
 * machine.c and network.c, the course in faults.c. */
#ifndef LIGHTMILL_FAULTS_STATE_H
#define LIGHTMILL_FAULTS_STATE_H

#include "tests/chaos/command.h"
#include "tests/chaos/dice.h"
#include "tests/chaos/faults/faults.h"
#include "tests/chaos/faults/watch_films.h"

enum { FAULT_CHANCES = 3, MAX_FAULT_KINDS = 64, MAX_FAULT_CARDS = 200, MAX_ACTIVE_FAULTS = 64 };

typedef struct fault fault_t;

/* A kind of fault. `begin` returns false when it cannot be now; `end` undoes it. */
typedef struct {
    const char *name;
    unsigned cards;     /* of the deck */
    double least, most; /* seconds that it lasts */
    bool (*begin)(faults_t *, fault_t *);
    void (*end)(faults_t *, fault_t *); /* NULL: there is nothing to undo */
    bool (*possible)(const faults_t *); /* on this machine; NULL: always */
    proxy_mischief_t mischief;          /* of the kinds that are one */
} fault_kind_t;

typedef struct {
    const fault_kind_t *list;
    size_t count;
} fault_family_t;

/* Of the master, the relay and the workers; of clocks, disks and clients; of lines. */
extern const fault_family_t PROCESS_FAULTS, MACHINE_FAULTS, NETWORK_FAULTS;

struct fault {
    const fault_kind_t *kind; /* NULL: the place is free */
    size_t kind_index;        /* in faults->kinds */
    size_t number;
    uint64_t pick;
    double chance[FAULT_CHANCES]; /* from 0 to 1, for whatever it needs */
    double duration, ends;
    bool spoilt;   /* it hit nobody: it is not counted */
    unsigned hits; /* how often it struck, of the kinds that count it */
    char victim[80];
    /* What it works on. */
    processes_worker_t *worker;
    member_t *member; /* the worker, the relay or the master */
    size_t index;     /* of a link or a site */
    film_event_t event;
    unsigned done; /* what the link had done before */
    command_t client;
};

struct faults {
    faults_setup_t setup;
    dice_t dice;
    double next;
    size_t dealt;
    fault_t active[MAX_ACTIVE_FAULTS];
    const fault_kind_t *kinds[MAX_FAULT_KINDS]; /* that are wanted, and possible here */
    size_t kind_count;
    size_t counts[MAX_FAULT_KINDS], hits[MAX_FAULT_KINDS];
    size_t deck[MAX_FAULT_CARDS], deck_left; /* indices of kinds */
    bool link_busy[PROXY_MAX_LINKS], site_busy[NETWORK_MAX_SITES], disk_busy;
    processes_worker_t *late[PROCESSES_MAX_WORKERS]; /* workers that join late */
    film_watch_t films;
    fault_t *waiting; /* for a checkpoint */
    size_t count, kills, torn;
};

/* Names whom it hits. */
void fault_victim(fault_t *fault, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* A number for a chance: even; or as likely between 1 and 10 as between 10 and 100. */
double fault_between(double chance, double least, double most);
double fault_scales(double chance, double least, double most);

/* A worker that no other fault is at work on; false when there is none. */
bool fault_pick_worker(faults_t *faults, fault_t *fault);
/* Every write of the master's takes so many seconds more. */
void fault_slow_master_disk(faults_t *faults, double seconds);
/* A checkpoint begins or is there: the master is killed if a fault waits for it. */
void faults_on_film(faults_t *faults, film_event_t event);

#endif
