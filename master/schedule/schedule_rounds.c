/* schedule_rounds: how far each tile may be sampled, and with which weights (schedule.h, "rounds"). */
#include "master/schedule/schedule_state.h"

#include <stdlib.h>
#include <string.h>

uint32_t schedule_round_end(const schedule_t *s, uint32_t round, uint32_t tile)
{
    return s->ends[(size_t)round * s->tile_count + tile];
}

static uint32_t round_weight(const schedule_t *s, uint32_t round, uint32_t tile)
{
    return s->weights[(size_t)round * s->tile_count + tile];
}

uint32_t schedule_tile_end(const schedule_t *s, uint32_t tile)
{
    return s->round_count == 0 ? 0 : schedule_round_end(s, s->round_count - 1, tile);
}

uint32_t schedule_round_of(const schedule_t *s, uint32_t tile, uint32_t sample)
{
    uint32_t low = 0, high = s->round_count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (schedule_round_end(s, middle, tile) > sample)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

uint64_t schedule_weight_below(const schedule_t *s, uint32_t tile, uint32_t sample)
{
    uint64_t weight = 0;
    for (uint32_t r = 0, from = 0; r < s->round_count && from < sample; r++) {
        uint32_t end = schedule_round_end(s, r, tile), to = end < sample ? end : sample;
        weight += (uint64_t)(to - from) * round_weight(s, r, tile);
        from = to;
    }
    return weight;
}

bool schedule_in_one_round(const schedule_t *s, const unit_t *unit)
{
    uint32_t round = schedule_round_of(s, unit->tile, unit->first);
    return round < s->round_count && unit->count > 0 &&
           unit->count <= schedule_round_end(s, round, unit->tile) - unit->first;
}

/* ---- opening rounds ------------------------------------------------------------------------------------ */

/* Moves the end of a tile's latest round. */
static void move_end(schedule_t *s, uint32_t tile, uint32_t end)
{
    uint32_t *last = &s->ends[(size_t)(s->round_count - 1) * s->tile_count + tile];
    s->open -= (uint64_t)*last * job_tile_pixels(&s->settings, tile);
    s->open += (uint64_t)end * job_tile_pixels(&s->settings, tile);
    schedule_pass_add(s, s->allowed, tile, *last, end, 1);
    schedule_pass_add(s, s->allowed, tile, end, *last, -1);
    *last = end;
    schedule_tile_refresh(s, tile);
}

void schedule_open_round(schedule_t *s, const uint32_t *ends, const uint32_t *weights)
{
    size_t old = (size_t)s->round_count * s->tile_count, values = old + s->tile_count;
    s->ends = mem_realloc(s->ends, values * sizeof *s->ends);
    s->weights = mem_realloc(s->weights, values * sizeof *s->weights);
    for (uint32_t t = 0; t < s->tile_count; t++) s->ends[old + t] = schedule_tile_end(s, t);
    memcpy(s->weights + old, weights, s->tile_count * sizeof *weights);
    s->round_count++;
    for (uint32_t t = 0; t < s->tile_count; t++) move_end(s, t, ends[t]);
}

/* The first round of a job that is not planned; its ends are set afterwards. */
static void open_only_round(schedule_t *s)
{
    uint32_t *ends = mem_zalloc(s->tile_count, sizeof *ends);
    uint32_t *weights = mem_alloc(s->tile_count * sizeof *weights);
    for (uint32_t t = 0; t < s->tile_count; t++) weights[t] = 1;
    schedule_open_round(s, ends, weights);
    free(ends);
    free(weights);
}

/* Where a tile's latest round begins. */
static uint32_t round_start(const schedule_t *s, uint32_t tile)
{
    return s->round_count > 1 ? schedule_round_end(s, s->round_count - 2, tile) : 0;
}

/* Where the samples of a tile end that are counted, issued or skipped, or belong to an earlier round. */
static uint32_t tile_reached(const schedule_t *s, uint32_t index)
{
    const tile_t *tile = &s->tiles[index];
    uint32_t reached = tile->count > 0 ? tile->spans[tile->count - 1].end : 0;
    uint32_t before = round_start(s, index);
    return reached > before ? reached : before;
}

/* Where the tile ends at least when a job is extended. */
static uint32_t least_end(const schedule_t *s, uint32_t tile, bool keeps_round)
{
    uint32_t end = schedule_tile_end(s, tile);
    return keeps_round && end < JOB_MAX_SPP ? end : tile_reached(s, tile);
}

/* Where a tile's latest round ends when it may be moved: at spp, or at the milestone before. */
static uint32_t moved_end(const schedule_t *s, uint32_t tile, const job_settings_t *settings)
{
    uint32_t milestone = job_next_milestone(settings, round_start(s, tile));
    return milestone < settings->spp ? milestone : settings->spp;
}

void schedule_extend(schedule_t *s, job_settings_t *settings)
{
    bool keeps_round = job_follows_noise(settings);
    uint32_t boost = settings->adaptive ? JOB_MAX_BOOST : 1;
    if (s->round_count == 0 && !job_is_planned(settings)) open_only_round(s);
    for (uint32_t t = 0; s->round_count > 0 && t < s->tile_count; t++) {
        uint32_t spp = (least_end(s, t, keeps_round) + boost - 1) / boost;
        if (settings->spp < spp) settings->spp = spp;
    }
    for (uint32_t t = 0; s->round_count > 0 && t < s->tile_count; t++) {
        uint32_t end = keeps_round ? least_end(s, t, keeps_round) : moved_end(s, t, settings);
        if (end != schedule_tile_end(s, t)) move_end(s, t, end);
    }
    s->settings.spp = settings->spp;
    s->settings.error = settings->error;
    s->settings.time_limit = settings->time_limit;
}

uint32_t schedule_round_count(const schedule_t *s)
{
    return s->round_count;
}

bool schedule_round_counted(const schedule_t *s)
{
    return s->counted + s->skipped == s->open;
}

const uint32_t *schedule_round_ends(const schedule_t *s)
{
    return s->round_count == 0 ? NULL : s->ends + (size_t)(s->round_count - 1) * s->tile_count;
}

const uint32_t *schedule_round_weights(const schedule_t *s)
{
    return s->round_count == 0 ? NULL : s->weights + (size_t)(s->round_count - 1) * s->tile_count;
}

uint32_t schedule_round_start(const schedule_t *s)
{
    return round_start(s, 0);
}

uint32_t schedule_even_end(const schedule_t *s)
{
    uint32_t end = schedule_tile_end(s, 0);
    for (uint32_t t = 1; t < s->tile_count; t++)
        if (schedule_tile_end(s, t) != end) return 0;
    return end;
}

uint32_t schedule_weight(const schedule_t *s, const unit_t *unit)
{
    uint32_t round = schedule_round_of(s, unit->tile, unit->first);
    return round < s->round_count ? round_weight(s, round, unit->tile) : 1;
}
