/* checks: units that a master wants rendered twice, to compare the results. Each such assignment makes a
 * batch of its own.
 *
 * They are worked on one after the other: the next begins when the batch of the first was sent. Results are
 * put together in the order of the units, so that every worker makes the same batch. Not thread-safe: the
 * owner locks. */
#ifndef LIGHTMILL_CHECKS_H
#define LIGHTMILL_CHECKS_H

#include "common/film/batch.h"

enum { CHECKS_MAX = 4096 };

typedef struct {
    uint64_t number;
    unit_t *units;
    const uint64_t *macs; /* of these (assignment_t); NULL: not known */
    size_t count;
    unit_result_t *results; /* one for each unit */
    size_t begun;           /* units that were taken, */
    size_t rendering;       /* are in a thread's hands now, */
    size_t done;            /* and are finished */
    bool under_way;         /* the batch is closed and being sent: nobody else touches it */
    bool dropped;           /* nobody wants it: it goes when nothing of it is rendering or under way */
    batch_t batch;          /* splats and lessons of what is finished; the rest comes by checks_close */
} unit_check_t;

/* Zeroed to begin with, freed when all were dropped and swept. */
typedef struct {
    unit_check_t **list;
    size_t count, capacity;
} checks_t;

/* Adds a check of units of a job with these settings; the units, with their MACs, are taken over. Beyond
 * CHECKS_MAX, which only a master reaches that gives without being asked, it is dropped. */
void checks_push(checks_t *checks, const job_settings_t *settings, uint64_t number, unit_t *units,
                 const uint64_t *macs, size_t count);
/* The one to take the next unit of (units[begun]); NULL when there is none. */
unit_check_t *checks_next(const checks_t *checks);
/* A unit of the check was finished. Its result's memory is taken over; NULL: the unit was given up, and the
 * whole check is dropped. */
void checks_finish(checks_t *checks, unit_check_t *check, size_t unit, unit_result_t *result);
/* The one whose batch is complete and to be sent; NULL when there is none. */
unit_check_t *checks_complete(const checks_t *checks);
/* The complete one that bears a number; NULL when there is none. */
unit_check_t *checks_find(const checks_t *checks, uint64_t number);
/* Makes the batch of a complete one, which is under way from now on. */
void checks_close(unit_check_t *check);
/* Bytes that the batch of a complete one will take. */
uint64_t checks_bytes(const unit_check_t *check, const job_settings_t *settings);
/* Units in all that are wanted. */
size_t checks_units(const checks_t *checks);
/* Pixel samples of those that were not begun. */
uint64_t checks_samples_left(const checks_t *checks, const job_settings_t *settings);
/* Drops those of which not every unit was begun, or all. */
void checks_drop(checks_t *checks, bool all);
/* Frees checks that were dropped or sent and of which nothing is rendering or under way. */
void checks_sweep(checks_t *checks);

#endif
