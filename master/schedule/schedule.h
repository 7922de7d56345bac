/* schedule: which samples of which tile of one job are free, issued to a worker, counted or skipped.
 *
 * A pure data structure: it knows no sockets, no clock and no lock (the farm locks). Workers are known by the
 * number that the farm gave them. The invariants:
 *
 *   - every sample of every tile that a round allows is exactly one of free, issued (to one worker), counted
 *     or skipped; what is free of a pass that is not open is not handed out;
 *   - a counted sample is in the film, once, until schedule_uncount says that it was taken out.
 *
 * Units are handed out so that the image converges evenly: always from a tile whose lowest free sample is
 * lowest (by weight, where a round gives tiles different numbers of samples).
 */
#ifndef LIGHTMILL_SCHEDULE_H
#define LIGHTMILL_SCHEDULE_H

#include "common/job.h"

typedef struct schedule schedule_t;

/* `settings` have passed job_settings_check. A job that is not planned (job_is_planned) has one round, of all
 * tiles up to spp with weight 1, and all its samples are free; one that is planned has none yet. */
schedule_t *schedule_new(const job_settings_t *settings);
/* Frees the schedule and sets *schedule to NULL. */
void schedule_destroy(schedule_t **schedule);

/* What a worker asks for. */
typedef struct {
    uint64_t worker;
    uint64_t samples;      /* pixel samples wanted in all */
    uint64_t unit_samples; /* pixel samples that make a good unit */
    uint32_t threads;      /* of this worker */
    uint32_t farm_threads; /* of all workers that share the job, this one among them */
} schedule_wish_t;

/* Issues units to a worker, at most `capacity`; returns how many. A unit has unit_samples pixel samples, at
 * least one a pixel, less while the image is young and near a round's end (see the note in schedule.c), and
 * lies within one round and one pass. */
size_t schedule_take(schedule_t *schedule, const schedule_wish_t *wish, unit_t *units, size_t capacity);

/* Counts the units, all or none. RESULT_MISMATCH names a unit that was counted or skipped before, is in the
 * list twice, or does not lie within one open round and pass; then nothing has changed. The units are valid
 * for the
 * job; who holds them does not matter, and holders of what is counted now lose it. */
result_t schedule_accept(schedule_t *schedule, const unit_t *units, size_t count);

/* Frees what the worker holds of these units; returns the number of pieces. */
size_t schedule_release_units(schedule_t *schedule, uint64_t worker, const unit_t *units, size_t count);
/* Frees all that the worker holds; returns the number of pieces. */
size_t schedule_release(schedule_t *schedule, uint64_t worker);

/* True while there are free samples in open passes. */
bool schedule_available(const schedule_t *schedule);
/* Pixel samples that are free in open passes. */
uint64_t schedule_free(const schedule_t *schedule);
/* Units that a worker holds. */
size_t schedule_held(const schedule_t *schedule, uint64_t worker);
/* Workers that hold units; the farm itself is none. */
size_t schedule_holders(const schedule_t *schedule);
/* Pixel samples counted. */
uint64_t schedule_done(const schedule_t *schedule);

/* ---- rounds (next_round.h) ---- */

enum { SCHEDULE_MAX_ROUNDS = 1000 };

/* Allows tile t to be sampled up to ends[t], the new samples with weight weights[t]; of a planned job.
 * ends[t] is at least the tile's present end. */
void schedule_open_round(schedule_t *schedule, const uint32_t *ends, const uint32_t *weights);
/* A job is to go on beyond its end, or to end elsewhere: spp, error and time_limit are taken from `settings`,
 * whose other fields are the job's. If it does not follow the noise (job_follows_noise), its latest round
 * then ends at spp, or at the milestone before; if it does, nothing is opened, but a round without end (it
 * was to be ended by time) is cut to what has been handed out. Where tiles have more samples already,
 * settings->spp is raised to them. */
void schedule_extend(schedule_t *schedule, job_settings_t *settings);
uint32_t schedule_round_count(const schedule_t *schedule);
/* True when all samples of the open rounds are counted or skipped; true before the first round. */
bool schedule_round_counted(const schedule_t *schedule);
/* The latest round's ends and weights, one for each tile; NULL before the first. */
const uint32_t *schedule_round_ends(const schedule_t *schedule);
const uint32_t *schedule_round_weights(const schedule_t *schedule);
/* Where the latest round began, in samples; 0 when it is the first, or there is none. Of a job that is not
 * adaptive. */
uint32_t schedule_round_start(const schedule_t *schedule);
/* The samples that every pixel has when the latest round is counted; 0 when tiles have different numbers, or
 * there is no round. */
uint32_t schedule_even_end(const schedule_t *schedule);
/* How often a sample of the unit counts; units lie within one round. */
uint32_t schedule_weight(const schedule_t *schedule, const unit_t *unit);

/* ---- passes (common/film/learning.h) ---- */

/* Passes, from 0 on, that are open: at first those that need no plan. Passes open one after the other and are
 * never closed, even if samples that their plans were made of are taken out of the film. */
uint32_t schedule_open_passes(const schedule_t *schedule);
/* The pass that comes next, when there are samples of it to render and all that rounds allow of the passes
 * that make its plan is counted or skipped; else 0. */
uint32_t schedule_next_pass(const schedule_t *schedule);
/* True when there are samples that a pass which is to open will free. */
bool schedule_goes_on(const schedule_t *schedule);
/* The lessons of the passes that make the plan of the next pass are settled, */
void schedule_teach(schedule_t *schedule);
/* and there is the plan. */
void schedule_open_pass(schedule_t *schedule);

/* ---- particular units ---- */

/* Issues exactly this unit; false, and nothing has changed, unless all of it is free and lies in one open
 * round and pass. The worker may be 0: the farm itself keeps it from others. */
bool schedule_issue(schedule_t *schedule, uint64_t worker, const unit_t *unit);
/* The units that a worker holds, in fresh memory (the caller frees it); *count is 0 and the result NULL when
 * none. */
unit_t *schedule_units_of(const schedule_t *schedule, uint64_t worker, size_t *count);
/* What is counted of the units becomes free again: its sums were taken out of the film. */
void schedule_uncount(schedule_t *schedule, const unit_t *units, size_t count);
/* What is free of the unit will never be counted; the job completes without it. */
void schedule_skip(schedule_t *schedule, const unit_t *unit);

/* ---- accounts and checkpoints ---- */

/* Pixel samples since the job began: issued = counted + returned + out, whatever happened. What is accepted
 * from a worker that did not hold it any more counts as issued once more. */
typedef struct {
    uint64_t issued, counted, returned, out, skipped;
} schedule_account_t;
schedule_account_t schedule_account(const schedule_t *schedule);
/* The number of counted samples of each tile, */
void schedule_tile_samples(const schedule_t *schedule, uint32_t *samples);
/* and written to each of its pixels, of the rows from y0 to before y1, [y1 - y0][width]: what the "samples"
 * layer of an image shows of an adaptive job, whose film knows their weight only (film_image_t.samples). */
void schedule_show_samples(const job_settings_t *settings, const uint32_t *tile_samples, int y0, int y1,
                           float *samples);

/* All that outlives the process. */
typedef struct {
    uint32_t round_count, tile_count;
    uint32_t *ends, *weights;  /* [round][tile] */
    unit_t *counted, *skipped; /* sample ranges, sorted by tile and sample */
    size_t counted_count, skipped_count;
    uint64_t issued, returned; /* pixel samples */
    uint32_t settled;          /* passes whose lessons are settled (film_t.settled) */
} schedule_state_t;
/* Copies the state into fresh memory. */
void schedule_save(const schedule_t *schedule, schedule_state_t *state);
void schedule_state_free(schedule_state_t *state);
/* Pixel samples counted in it. */
uint64_t schedule_state_samples(const job_settings_t *settings, const schedule_state_t *state);
/* A schedule from a state that was read from a file: RESULT_INPUT, naming what is wrong, unless it fits the
 * settings. What was out when it was saved is returned. The settings may have been extended since then (see
 * schedule_extend, also for what happens to settings->spp). */
result_t schedule_restore(job_settings_t *settings, const schedule_state_t *state, schedule_t **schedule);

#endif
