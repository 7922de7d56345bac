/* schedule_state: what a schedule is made of, for schedule*.c alone. schedule.c and schedule_rounds.c call
 * each other: where a tile ends is a matter of its rounds, and a round that opens frees samples of tiles. */
#ifndef LIGHTMILL_SCHEDULE_STATE_H
#define LIGHTMILL_SCHEDULE_STATE_H

#include "common/film/learning.h"
#include "common/id_table.h"
#include "master/schedule/schedule.h"

/* Holders of spans: an index in the table of holders, or one of these. */
enum {
    SPAN_COUNTED = UINT16_MAX, /* in the film */
    SPAN_SKIPPED,              /* will never be */
    SPAN_MAX_HOLDERS = SPAN_COUNTED
};
#define NONE_FREE UINT64_MAX

/* The samples [first, end) of a tile. */
typedef struct {
    uint32_t first, end, holder;
} span_t;

typedef struct {
    span_t *spans;
    uint32_t count, capacity;
    uint32_t lowest_free; /* sample, at the tile's end when none is free */
    uint32_t heap_index;
    uint64_t key; /* in the heap: the weight of the samples below the lowest free one; NONE_FREE: none is */
} tile_t;

typedef struct {
    uint64_t worker;
    size_t units; /* spans; 0: this entry is vacant */
} holder_t;

struct schedule {
    job_settings_t settings;
    tile_t *tiles;
    uint32_t *heap; /* tile numbers */
    uint32_t tile_count;
    uint32_t round_count;
    uint32_t *ends, *weights; /* [round][tile] */
    holder_t *holders;
    size_t holder_count, vacant; /* `vacant`: an entry that had none left lately */
    id_table_t by_worker;        /* indices of holders */
    size_t span_count;           /* of all tiles: it stays near the number of tiles plus that of units out */
    uint64_t open;               /* pixel samples of all rounds */
    uint32_t open_passes, settled_passes;
    uint64_t allowed[LEARNING_PASSES],
        settled[LEARNING_PASSES];   /* pixel samples of a pass: that rounds allow,
                                       and of them, that are counted or skipped */
    uint64_t counted, skipped, out; /* of them; the rest is free */
    uint64_t issued, returned;      /* since the job began */
};

/* ---- schedule.c ---- */

/* A schedule without rounds, whatever the settings ask for. */
schedule_t *schedule_new_empty(const job_settings_t *settings);
/* Finds a tile's lowest free sample again, after its spans or its end have changed. */
void schedule_tile_refresh(schedule_t *schedule, uint32_t tile);
/* Counts a range of samples, across rounds, none of which is counted or skipped. */
void schedule_count_range(schedule_t *schedule, const unit_t *range);

/* ---- schedule_passes.c ---- */

/* The pass that a sample is of, and where a pass ends. */
uint32_t schedule_pass_of(const schedule_t *schedule, uint32_t sample);
uint32_t schedule_pass_end(const schedule_t *schedule, uint32_t pass);
/* Where the last pass ends that is open. */
uint32_t schedule_open_end(const schedule_t *schedule);
/* Opens the passes that need nothing but the lessons of `settled` passes. */
void schedule_passes_init(schedule_t *schedule, uint32_t settled);
/* Adds the samples [first, end) of a tile to those of their passes, or with `sign` -1 takes them away. */
void schedule_pass_add(const schedule_t *schedule, uint64_t samples[LEARNING_PASSES], uint32_t tile,
                       uint32_t first, uint32_t end, int sign);
bool schedule_in_open_pass(const schedule_t *schedule, const unit_t *unit);

/* ---- schedule_rounds.c ---- */

uint32_t schedule_round_end(const schedule_t *schedule, uint32_t round, uint32_t tile);
/* Where the samples of a tile end that have been allowed so far. */
uint32_t schedule_tile_end(const schedule_t *schedule, uint32_t tile);
/* The round that a sample of a tile belongs to; round_count when it is not open yet. */
uint32_t schedule_round_of(const schedule_t *schedule, uint32_t tile, uint32_t sample);
/* The weight of a pixel's samples below `sample`. */
uint64_t schedule_weight_below(const schedule_t *schedule, uint32_t tile, uint32_t sample);
bool schedule_in_one_round(const schedule_t *schedule, const unit_t *unit);

#endif
