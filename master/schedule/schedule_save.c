/* schedule_save: writes a schedule as a checkpoint keeps it, and reads it back (schedule.h, "accounts and
 * checkpoints"). The file may be damaged or forged, so everything in it is checked before it is used. */
#include "common/film/film_sums.h"
#include "master/schedule/schedule_state.h"

#include <stdlib.h>
#include <string.h>

/* The ranges of all tiles that have this holder. */
static unit_t *save_spans(const schedule_t *s, uint32_t holder, size_t *count)
{
    unit_t *ranges = mem_alloc((s->span_count + 1) * sizeof *ranges);
    *count = 0;
    for (uint32_t t = 0; t < s->tile_count; t++)
        for (uint32_t i = 0; i < s->tiles[t].count; i++) {
            span_t span = s->tiles[t].spans[i];
            if (span.holder == holder) ranges[(*count)++] = (unit_t){t, span.first, span.end - span.first};
        }
    return mem_realloc(ranges, (*count + 1) * sizeof *ranges);
}

static uint32_t *copy_values(const uint32_t *values, size_t count)
{
    uint32_t *copy = mem_alloc((count + 1) * sizeof *copy);
    if (count > 0) memcpy(copy, values, count * sizeof *copy);
    return copy;
}

void schedule_save(const schedule_t *s, schedule_state_t *state)
{
    size_t values = (size_t)s->round_count * s->tile_count;
    *state = (schedule_state_t){.round_count = s->round_count,
                                .tile_count = s->tile_count,
                                .ends = copy_values(s->ends, values),
                                .weights = copy_values(s->weights, values),
                                .issued = s->issued,
                                .returned = s->returned,
                                .settled = s->settled_passes};
    state->counted = save_spans(s, SPAN_COUNTED, &state->counted_count);
    state->skipped = save_spans(s, SPAN_SKIPPED, &state->skipped_count);
}

void schedule_state_free(schedule_state_t *state)
{
    free(state->ends);
    free(state->weights);
    free(state->counted);
    free(state->skipped);
    *state = (schedule_state_t){0};
}

/* The rounds of one tile: ends that do not fall, and weights that the film can count. */
static result_t check_tile_rounds(const schedule_state_t *state, uint32_t tile, uint32_t most_weight)
{
    uint64_t weight = 0;
    uint32_t end = 0;
    for (uint32_t r = 0; r < state->round_count; r++) {
        size_t i = (size_t)r * state->tile_count + tile;
        if (state->ends[i] < end || state->ends[i] > JOB_MAX_SPP)
            return result_fail(RESULT_INPUT, "round %u of tile %u ends at sample %u, after %u", r, tile,
                               state->ends[i], end);
        if (state->weights[i] < 1 || state->weights[i] > most_weight)
            return result_fail(RESULT_INPUT, "round %u of tile %u has weight %u, must be from 1 to %u", r,
                               tile, state->weights[i], most_weight);
        weight += (uint64_t)(state->ends[i] - end) * state->weights[i];
        end = state->ends[i];
    }
    if (weight <= JOB_MAX_SPP) return result_ok();
    return result_fail(RESULT_INPUT, "the samples of tile %u weigh %llu, at most %d is possible", tile,
                       (unsigned long long)weight, JOB_MAX_SPP);
}

static result_t check_rounds(const job_settings_t *settings, const schedule_state_t *state)
{
    if (state->tile_count != job_tile_count(settings))
        return result_fail(RESULT_INPUT, "it is of %u tiles, the job has %u", state->tile_count,
                           job_tile_count(settings));
    if (state->round_count > SCHEDULE_MAX_ROUNDS)
        return result_fail(RESULT_INPUT, "it has %u rounds, at most %d are possible", state->round_count,
                           SCHEDULE_MAX_ROUNDS);
    for (uint32_t t = 0; t < state->tile_count; t++)
        TRY(check_tile_rounds(state, t, settings->adaptive ? JOB_MAX_BOOST : 1));
    return result_ok();
}

/* Ranges inside the rounds, in order, without overlap. */
static result_t check_ranges(const schedule_state_t *state, const unit_t *ranges, size_t count,
                             const char *what)
{
    for (size_t i = 0; i < count; i++) {
        unit_t range = ranges[i];
        size_t last = (size_t)(state->round_count - 1) * state->tile_count + range.tile;
        if (state->round_count == 0 || range.tile >= state->tile_count || range.count == 0 ||
            range.first >= state->ends[last] || range.count > state->ends[last] - range.first)
            return result_fail(RESULT_INPUT, "tile %u, samples %u + %u are %s, which no round allows",
                               range.tile, range.first, range.count, what);
        if (i > 0 &&
            (range.tile < ranges[i - 1].tile ||
             (range.tile == ranges[i - 1].tile && range.first < ranges[i - 1].first + ranges[i - 1].count)))
            return result_fail(RESULT_INPUT, "tile %u, samples %u + %u are %s twice or out of order",
                               range.tile, range.first, range.count, what);
    }
    return result_ok();
}

/* No sample is in both lists. */
static result_t check_apart(const schedule_state_t *state)
{
    for (size_t c = 0, k = 0; c < state->counted_count && k < state->skipped_count;) {
        unit_t counted = state->counted[c], skipped = state->skipped[k];
        bool before = counted.tile < skipped.tile ||
                      (counted.tile == skipped.tile && counted.first + counted.count <= skipped.first);
        bool after = counted.tile > skipped.tile ||
                     (counted.tile == skipped.tile && skipped.first + skipped.count <= counted.first);
        if (!before && !after)
            return result_fail(RESULT_INPUT, "tile %u, samples %u + %u are counted and skipped", counted.tile,
                               counted.first, counted.count);
        c += before;
        k += after;
    }
    return result_ok();
}

uint64_t schedule_state_samples(const job_settings_t *settings, const schedule_state_t *state)
{
    uint64_t samples = 0;
    for (size_t i = 0; i < state->counted_count; i++) samples += unit_samples(settings, &state->counted[i]);
    return samples;
}

static result_t check_account(const job_settings_t *settings, const schedule_state_t *state)
{
    uint64_t counted = schedule_state_samples(settings, state);
    if (state->issued >= counted && state->returned <= state->issued - counted) return result_ok();
    return result_fail(RESULT_INPUT, "%llu pixel samples were issued, but %llu counted and %llu returned",
                       (unsigned long long)state->issued, (unsigned long long)counted,
                       (unsigned long long)state->returned);
}

static result_t check_settled(const job_settings_t *settings, const schedule_state_t *state)
{
    size_t most = sum_planes(settings, SUM_LESSONS);
    if (state->settled <= most) return result_ok();
    return result_fail(RESULT_INPUT, "the lessons of %u passes are settled, at most %zu are noted",
                       state->settled, most);
}

result_t schedule_restore(job_settings_t *settings, const schedule_state_t *state, schedule_t **schedule)
{
    TRY(check_rounds(settings, state));
    TRY(check_ranges(state, state->counted, state->counted_count, "counted"));
    TRY(check_ranges(state, state->skipped, state->skipped_count, "skipped"));
    TRY(check_apart(state));
    TRY(check_account(settings, state));
    TRY(check_settled(settings, state));
    schedule_t *s = schedule_new_empty(settings);
    schedule_passes_init(s, state->settled);
    for (uint32_t r = 0; r < state->round_count; r++) {
        size_t first = (size_t)r * state->tile_count;
        schedule_open_round(s, state->ends + first, state->weights + first);
    }
    for (size_t i = 0; i < state->counted_count; i++) schedule_count_range(s, &state->counted[i]);
    for (size_t i = 0; i < state->skipped_count; i++) schedule_skip(s, &state->skipped[i]);
    s->issued = state->issued;
    s->returned = state->issued - s->counted;
    schedule_extend(s, settings);
    *schedule = s;
    return result_ok();
}
