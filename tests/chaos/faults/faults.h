/* faults: what goes wrong, when, and to whom. The list of faults follows from the seed alone: the kind, the
 * pick of the victim, the duration and the pause before the next. What they hit depends on what the processes
 * are doing at that moment. */
#ifndef LIGHTMILL_FAULTS_H
#define LIGHTMILL_FAULTS_H

#include "tests/chaos/network.h"
#include "tests/chaos/processes.h"
#include "tests/chaos/proxy.h"

typedef struct faults faults_t;

typedef struct {
    report_t *report;
    processes_t *processes;
    proxy_t *proxy;
    size_t links;            /* of the proxy, that workers use; the next one is for clients, */
    const char *client_host; /* on this address */
    network_t *network;      /* NULL: there are no sites */
    size_t sites;
    bool disk;          /* the data directory can be filled up */
    const char *folder; /* for what faults need */
    uint64_t seed;
    double pause;     /* mean seconds between the beginnings of faults */
    const char *only; /* a part of the names of the kinds that are wanted, several after commas; NULL: all */
} faults_setup_t;

faults_t *faults_new(const faults_setup_t *setup);
void faults_free(faults_t **faults);
/* Begins and ends what is due; with `more` false no new faults begin. Waits meanwhile, for `seconds` or until
 * a checkpoint that a fault waits for has begun. */
void faults_tick(faults_t *faults, bool more, double seconds);
/* Ends all faults. */
void faults_heal(faults_t *faults);
size_t faults_count(const faults_t *faults);
size_t faults_master_kills(const faults_t *faults);
/* The table of kinds. */
void faults_print(const faults_t *faults);

#endif
