/* ledger: the samples of one job that a relay has been given and has not delivered yet.
 *
 * A sample is free, issued to one worker, or summed: in a batch that the master has not answered for.
 * Delivered and returned samples leave the ledger. Samples are kept as units. Units may be cut, never joined,
 * since a unit of the master lies within one round, and two of them need not.
 *
 * A pure data structure: no sockets, no clock, no lock.
 */
#ifndef LIGHTMILL_LEDGER_H
#define LIGHTMILL_LEDGER_H

#include "proto/uplink/unit_queue.h"

/* A unit that is out. */
typedef struct {
    unit_t unit;
    uint64_t worker;
} loan_t;

/* Zeroed to begin with, but for the settings. */
typedef struct {
    job_settings_t settings;
    unit_queue_t free; /* in the order in which they came */
    uint32_t plans;    /* passes whose plans are here (learning_ready): units of the others are not lent */
    loan_t *out;
    size_t out_count, out_capacity;
    unit_t *summed;
    size_t summed_count, summed_capacity;
} ledger_t;

void ledger_init(ledger_t *ledger, const job_settings_t *settings);
void ledger_free(ledger_t *ledger);

/* Adds units as free ones, without the samples that are here already. */
void ledger_put(ledger_t *ledger, const unit_t *units, size_t count);
/* Lends free units of about `samples` pixel samples to a worker, at least one if there is any that can be
 * rendered; returns how many, at most `capacity`. */
size_t ledger_lend(ledger_t *ledger, uint64_t worker, uint64_t samples, unit_t *units, size_t capacity);
/* Lends exactly this unit if all of it is free. */
bool ledger_lend_unit(ledger_t *ledger, uint64_t worker, const unit_t *unit);
/* A worker has delivered these units: they are summed. All or none: RESULT_MISMATCH, naming the unit, when
 * samples of it are not here, are summed already or twice in the list. Who holds them does not matter. */
result_t ledger_accept(ledger_t *ledger, const unit_t *units, size_t count);
/* Summed units were answered for, and leave. */
void ledger_settle(ledger_t *ledger, const unit_t *units, size_t count);
/* All that a worker holds is free again; returns the number of units. */
size_t ledger_return(ledger_t *ledger, uint64_t worker);
/* Likewise, only of these units. */
size_t ledger_return_units(ledger_t *ledger, uint64_t worker, const unit_t *units, size_t count);
/* What is free leaves. */
void ledger_drop_free(ledger_t *ledger);

/* Units that a worker holds. */
size_t ledger_held(const ledger_t *ledger, uint64_t worker);
/* Units in all. */
size_t ledger_units(const ledger_t *ledger);
/* The units that are free, out or summed, in fresh memory. */
unit_t *ledger_all(const ledger_t *ledger, size_t *count);
/* Copies the units that are out or summed; returns how many, at most `capacity`. */
size_t ledger_list(const ledger_t *ledger, unit_t *units, size_t capacity);

#endif
