/* schedule: see schedule.h.
 *
 * DESIGN. A tile has a sorted list of spans: sample ranges that are counted, issued or skipped. What lies
 * between spans and after the last one, up to the end of the latest round, is free, so giving units back is
 * deleting spans, and nothing has to remember that they were returned. Counted neighbours are joined: however
 * long a job runs, a tile has one counted span and a few issued ones.
 *
 * A binary heap holds the tiles by the weight that a pixel has below the tile's lowest free sample (which is
 * that sample's number where all weights are 1), ties by tile number. The next unit comes from the top. So
 * returned samples, which are lower than those of other tiles, go out first, and no tile runs ahead of
 * another by more than one unit: all tiles get sample range k before k + 1, and in a round that gives a tile
 * four times the samples, each of a quarter of the weight, that tile gets four units for one of the others.
 *
 * The size of a unit follows the worker's wish, with three exceptions. While a tile is young, a unit at most
 * doubles its samples, starting from FIRST_PASS when the job is to reach a number of samples and from one
 * when only the clock ends it: the whole image is covered early, and a render of a minute has no black tiles.
 * (A unit costs an eye tile on the wire, so fewer is better.) A unit ends where its round or its pass does,
 * or its run (job_run_end). And when the free samples run out, a worker gets no more than half of its share
 * of them by threads, in units that leave a few for each of its threads: all workers finish together, which
 * matters at the end of every round.
 *
 * Spans name their holder by an index in a small table, so that they stay small; an index is used again when
 * its worker holds nothing. Losing a worker walks over all tiles, which is rare and cheap next to rendering
 * one unit. */
#include "master/schedule/schedule_state.h"

#include <stdlib.h>
#include <string.h>

enum {
    FIRST_PASS = 4,    /* samples a pixel of the first unit of a tile, where spp ends the job */
    UNITS_A_THREAD = 2 /* in a grant, so that a worker's threads are all busy */
};

/* ---- the heap of tiles --------------------------------------------------------------------------------- */

static bool comes_before(const schedule_t *s, uint32_t a, uint32_t b)
{
    uint64_t key_a = s->tiles[a].key, key_b = s->tiles[b].key;
    return key_a != key_b ? key_a < key_b : a < b;
}

static void heap_put(schedule_t *s, uint32_t index, uint32_t tile)
{
    s->heap[index] = tile;
    s->tiles[tile].heap_index = index;
}

/* Moves a tile whose key has changed to its place. */
static void heap_update(schedule_t *s, uint32_t tile)
{
    uint32_t i = s->tiles[tile].heap_index;
    for (; i > 0 && comes_before(s, tile, s->heap[(i - 1) / 2]); i = (i - 1) / 2)
        heap_put(s, i, s->heap[(i - 1) / 2]);
    for (;;) {
        uint32_t child = 2 * i + 1;
        if (child >= s->tile_count) break;
        if (child + 1 < s->tile_count && comes_before(s, s->heap[child + 1], s->heap[child])) child++;
        if (!comes_before(s, s->heap[child], tile)) break;
        heap_put(s, i, s->heap[child]);
        i = child;
    }
    heap_put(s, i, tile);
}

void schedule_tile_refresh(schedule_t *s, uint32_t index)
{
    tile_t *tile = &s->tiles[index];
    uint32_t lowest = 0;
    for (uint32_t i = 0; i < tile->count && tile->spans[i].first == lowest; i++) lowest = tile->spans[i].end;
    tile->lowest_free = lowest;
    bool any = lowest < schedule_tile_end(s, index) && lowest < schedule_open_end(s);
    tile->key = any ? schedule_weight_below(s, index, lowest) : NONE_FREE;
    heap_update(s, index);
}

/* ---- holders ------------------------------------------------------------------------------------------- */

static holder_t *holder_find(const schedule_t *s, uint64_t worker)
{
    size_t at = id_table_find(&s->by_worker, worker);
    return at != SIZE_MAX ? &s->holders[at] : NULL;
}

/* An entry that nobody has; SPAN_MAX_HOLDERS when the table is full. */
static size_t holder_place(const schedule_t *s)
{
    if (s->vacant < s->holder_count && s->holders[s->vacant].units == 0) return s->vacant;
    if (s->holder_count < SPAN_MAX_HOLDERS) return s->holder_count;
    size_t i = 0;
    while (i < s->holder_count && s->holders[i].units > 0) i++;
    return i;
}

/* The worker's entry, a new one if need be; NULL when the table is full. */
static holder_t *holder_make(schedule_t *s, uint64_t worker)
{
    holder_t *holder = holder_find(s, worker);
    if (holder != NULL) return holder;
    size_t i = holder_place(s);
    if (i == SPAN_MAX_HOLDERS) return NULL;
    if (i == s->holder_count)
        s->holders = mem_realloc(s->holders, ++s->holder_count * sizeof *s->holders);
    else
        id_table_remove(&s->by_worker, s->holders[i].worker);
    s->holders[i] = (holder_t){.worker = worker};
    id_table_put(&s->by_worker, worker, i);
    return &s->holders[i];
}

/* ---- spans --------------------------------------------------------------------------------------------- */

static uint64_t span_samples(const schedule_t *s, uint32_t tile, uint32_t first, uint32_t end)
{
    return (uint64_t)(end - first) * job_tile_pixels(&s->settings, tile);
}

/* The first span that ends after `sample`. */
static uint32_t span_after(const tile_t *tile, uint32_t sample)
{
    uint32_t low = 0, high = tile->count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (tile->spans[middle].end > sample)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

static void span_insert(schedule_t *s, tile_t *tile, uint32_t at, span_t span)
{
    if (tile->count == tile->capacity) {
        tile->capacity = tile->capacity == 0 ? 2 : 2 * tile->capacity;
        tile->spans = mem_realloc(tile->spans, tile->capacity * sizeof *tile->spans);
    }
    memmove(tile->spans + at + 1, tile->spans + at, (tile->count - at) * sizeof *tile->spans);
    tile->spans[at] = span;
    tile->count++;
    s->span_count++;
}

static void span_delete(schedule_t *s, tile_t *tile, uint32_t at)
{
    tile->count--;
    s->span_count--;
    memmove(tile->spans + at, tile->spans + at + 1, (tile->count - at) * sizeof *tile->spans);
}

/* Takes [first, end) away from a span: it shrinks, splits or goes. Returns the index of the first span that
 * is not before `end`. */
static uint32_t span_cut(schedule_t *s, uint32_t tile_index, uint32_t at, uint32_t first, uint32_t end)
{
    tile_t *tile = &s->tiles[tile_index];
    span_t old = tile->spans[at];
    holder_t *holder = old.holder < SPAN_MAX_HOLDERS ? &s->holders[old.holder] : NULL;
    uint32_t low = old.first > first ? old.first : first, high = old.end < end ? old.end : end;
    if (holder != NULL) {
        s->out -= span_samples(s, tile_index, low, high);
        holder->units += (size_t)(old.first < low) + (high < old.end);
        holder->units--;
        if (holder->units == 0) s->vacant = old.holder;
    }
    span_delete(s, tile, at);
    if (old.first < low) span_insert(s, tile, at++, (span_t){old.first, low, old.holder});
    if (high < old.end) span_insert(s, tile, at, (span_t){high, old.end, old.holder});
    return at;
}

/* Makes a free range an issued one. */
static void span_issue(schedule_t *s, holder_t *holder, const unit_t *unit)
{
    tile_t *tile = &s->tiles[unit->tile];
    uint32_t end = unit->first + unit->count;
    span_insert(s, tile, span_after(tile, unit->first),
                (span_t){unit->first, end, (uint32_t)(holder - s->holders)});
    holder->units++;
    s->out += span_samples(s, unit->tile, unit->first, end);
    s->issued += span_samples(s, unit->tile, unit->first, end);
    schedule_tile_refresh(s, unit->tile);
}

/* True when the unit has samples that are counted, or will never be. */
static bool unit_settled(const tile_t *tile, const unit_t *unit)
{
    uint32_t end = unit->first + unit->count;
    for (uint32_t i = span_after(tile, unit->first); i < tile->count && tile->spans[i].first < end; i++)
        if (tile->spans[i].holder >= SPAN_MAX_HOLDERS) return true;
    return false;
}

/* Joins the range with counted neighbours. */
void schedule_count_range(schedule_t *s, const unit_t *unit)
{
    tile_t *tile = &s->tiles[unit->tile];
    span_t span = {unit->first, unit->first + unit->count, SPAN_COUNTED};
    uint64_t samples = span_samples(s, unit->tile, span.first, span.end), out = s->out;
    uint32_t at = span_after(tile, span.first);
    while (at < tile->count && tile->spans[at].first < span.end)
        at = span_cut(s, unit->tile, at, span.first, span.end);
    s->counted += samples;
    schedule_pass_add(s, s->settled, unit->tile, span.first, span.end, 1);
    s->issued += samples - (out - s->out); /* what nobody held any more counts as issued once more */
    at = span_after(tile, span.first);
    if (at < tile->count && tile->spans[at].first == span.end && tile->spans[at].holder == SPAN_COUNTED) {
        span.end = tile->spans[at].end;
        span_delete(s, tile, at);
    }
    if (at > 0 && tile->spans[at - 1].end == span.first && tile->spans[at - 1].holder == SPAN_COUNTED)
        tile->spans[at - 1].end = span.end;
    else
        span_insert(s, tile, at, span);
    schedule_tile_refresh(s, unit->tile);
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

schedule_t *schedule_new_empty(const job_settings_t *settings)
{
    schedule_t *s = mem_zalloc(1, sizeof *s);
    s->settings = *settings;
    s->tile_count = job_tile_count(settings);
    schedule_passes_init(s, 0);
    s->tiles = mem_zalloc(s->tile_count, sizeof *s->tiles);
    s->heap = mem_alloc(s->tile_count * sizeof *s->heap);
    for (uint32_t i = 0; i < s->tile_count; i++) {
        s->tiles[i].key = NONE_FREE;
        heap_put(s, i, i);
    }
    return s;
}

schedule_t *schedule_new(const job_settings_t *settings)
{
    schedule_t *s = schedule_new_empty(settings);
    job_settings_t same = *settings;
    schedule_extend(s, &same);
    return s;
}

void schedule_destroy(schedule_t **schedule)
{
    schedule_t *s = *schedule;
    if (s == NULL) return;
    for (uint32_t i = 0; i < s->tile_count; i++) free(s->tiles[i].spans);
    free(s->tiles);
    free(s->heap);
    free(s->holders);
    id_table_free(&s->by_worker);
    free(s->ends);
    free(s->weights);
    free(s);
    *schedule = NULL;
}

/* ---- issuing ------------------------------------------------------------------------------------------- */

static uint64_t least(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

static uint64_t most(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

bool schedule_goes_on(const schedule_t *s)
{
    return s->open - s->counted - s->skipped - s->out > schedule_free(s);
}

/* Half of what is the worker's of the free pixel samples, if they were shared out by threads. Where only a
 * pass ends, all that it wishes for: else all workers of a large farm would have a batch to send before the
 * next pass can open, each with next to nothing in it, and to merge these would take longer than the pass. */
static uint64_t fair_share(const schedule_t *s, const schedule_wish_t *wish)
{
    uint64_t threads = most(wish->threads, 1), all = most(wish->farm_threads, threads);
    uint64_t share = most(schedule_free(s) / (2 * all), 1) * threads;
    return schedule_goes_on(s) ? most(share, wish->samples) : share;
}

/* Issues one unit of about `samples` pixel samples from the tile at the top of the heap. */
static unit_t take_unit(schedule_t *s, holder_t *holder, uint64_t samples)
{
    uint32_t index = s->heap[0];
    const tile_t *tile = &s->tiles[index];
    uint32_t first = tile->lowest_free, at = span_after(tile, first);
    uint64_t end = schedule_round_end(s, schedule_round_of(s, index, first), index);
    end = least(end, schedule_pass_end(s, schedule_pass_of(s, first)));
    end = least(end, job_run_end(&s->settings, first));
    if (at < tile->count) end = least(end, tile->spans[at].first);
    uint64_t young = most(first, s->settings.time_limit > 0 ? 1 : FIRST_PASS);
    uint64_t count = most(samples / job_tile_pixels(&s->settings, index), 1);
    unit_t unit = {index, first, (uint32_t)least(count, least(young, end - first))};
    span_issue(s, holder, &unit);
    return unit;
}

size_t schedule_take(schedule_t *s, const schedule_wish_t *wish, unit_t *units, size_t capacity)
{
    if (wish->samples == 0 || capacity == 0 || !schedule_available(s)) return 0;
    holder_t *holder = holder_make(s, wish->worker);
    if (holder == NULL) return 0;
    uint64_t share = fair_share(s, wish), grant = least(wish->samples, share), taken = 0;
    uint64_t wished = least(wish->unit_samples, share / (UNITS_A_THREAD * most(wish->threads, 1)));
    size_t count = 0;
    while (count < capacity && taken < grant && schedule_available(s)) {
        units[count] = take_unit(s, holder, wished);
        taken += unit_samples(&s->settings, &units[count]);
        count++;
    }
    return count;
}

bool schedule_issue(schedule_t *s, uint64_t worker, const unit_t *unit)
{
    const tile_t *tile = &s->tiles[unit->tile];
    if (!schedule_in_one_round(s, unit) || !schedule_in_open_pass(s, unit)) return false;
    uint32_t at = span_after(tile, unit->first);
    if (at < tile->count && tile->spans[at].first < unit->first + unit->count) return false;
    holder_t *holder = holder_make(s, worker);
    if (holder != NULL) span_issue(s, holder, unit);
    return holder != NULL;
}

/* ---- counting and giving back -------------------------------------------------------------------------- */

/* Whether a unit may be counted at all. */
static result_t check_unit(const schedule_t *s, const unit_t *unit)
{
    if (!schedule_in_one_round(s, unit) || !schedule_in_open_pass(s, unit))
        return result_fail(RESULT_MISMATCH, "tile %u, samples %u + %u are not wanted (yet)", unit->tile,
                           unit->first, unit->count);
    if (unit_settled(&s->tiles[unit->tile], unit))
        return result_fail(RESULT_MISMATCH, "tile %u, samples %u + %u were counted before, or given up",
                           unit->tile, unit->first, unit->count);
    return result_ok();
}

result_t schedule_accept(schedule_t *s, const unit_t *units, size_t count)
{
    for (size_t i = 0; i < count; i++) TRY(check_unit(s, &units[i]));
    TRY(units_check_apart(units, count));
    for (size_t i = 0; i < count; i++) schedule_count_range(s, &units[i]);
    return result_ok();
}

/* Frees what the holder has of [first, end) of a tile. */
static size_t release_range(schedule_t *s, const holder_t *holder, uint32_t index, uint32_t first,
                            uint32_t end)
{
    tile_t *tile = &s->tiles[index];
    uint32_t name = (uint32_t)(holder - s->holders), at = span_after(tile, first);
    uint64_t out = s->out;
    size_t pieces = 0;
    while (at < tile->count && tile->spans[at].first < end) {
        if (tile->spans[at].holder == name) {
            at = span_cut(s, index, at, first, end);
            pieces++;
        } else {
            at++;
        }
    }
    s->returned += out - s->out;
    if (pieces > 0) schedule_tile_refresh(s, index);
    return pieces;
}

size_t schedule_release_units(schedule_t *s, uint64_t worker, const unit_t *units, size_t count)
{
    const holder_t *holder = holder_find(s, worker);
    size_t pieces = 0;
    for (size_t i = 0; holder != NULL && i < count; i++)
        pieces += release_range(s, holder, units[i].tile, units[i].first, units[i].first + units[i].count);
    return pieces;
}

size_t schedule_release(schedule_t *s, uint64_t worker)
{
    const holder_t *holder = holder_find(s, worker);
    size_t pieces = 0;
    for (uint32_t i = 0; holder != NULL && holder->units > 0 && i < s->tile_count; i++)
        pieces += release_range(s, holder, i, 0, UINT32_MAX);
    return pieces;
}

void schedule_uncount(schedule_t *s, const unit_t *units, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        tile_t *tile = &s->tiles[units[i].tile];
        uint32_t first = units[i].first, end = first + units[i].count, at = span_after(tile, first);
        while (at < tile->count && tile->spans[at].first < end) {
            span_t span = tile->spans[at];
            if (span.holder != SPAN_COUNTED) {
                at++;
                continue;
            }
            uint32_t low = span.first > first ? span.first : first, high = span.end < end ? span.end : end;
            uint64_t samples = span_samples(s, units[i].tile, low, high);
            schedule_pass_add(s, s->settled, units[i].tile, low, high, -1);
            s->counted -= samples;
            s->returned += samples;
            at = span_cut(s, units[i].tile, at, first, end);
        }
        schedule_tile_refresh(s, units[i].tile);
    }
}

void schedule_skip(schedule_t *s, const unit_t *unit)
{
    tile_t *tile = &s->tiles[unit->tile];
    uint32_t end = (uint32_t)least((uint64_t)unit->first + unit->count, schedule_tile_end(s, unit->tile));
    for (uint32_t from = unit->first; from < end;) {
        uint32_t at = span_after(tile, from);
        uint32_t to = at < tile->count && tile->spans[at].first < end ? tile->spans[at].first : end;
        if (from < to) {
            span_insert(s, tile, at++, (span_t){from, to, SPAN_SKIPPED});
            s->skipped += span_samples(s, unit->tile, from, to);
            schedule_pass_add(s, s->settled, unit->tile, from, to, 1);
        }
        from = at < tile->count && to < end ? tile->spans[at].end : end;
    }
    schedule_tile_refresh(s, unit->tile);
}

/* ---- what is known of it ------------------------------------------------------------------------------- */

bool schedule_available(const schedule_t *s)
{
    return s->tiles[s->heap[0]].key != NONE_FREE;
}

uint64_t schedule_free(const schedule_t *s)
{
    uint64_t open = 0;
    for (uint32_t pass = 0; pass < s->open_passes; pass++) open += s->allowed[pass];
    return open - s->counted - s->skipped - s->out;
}

size_t schedule_held(const schedule_t *s, uint64_t worker)
{
    const holder_t *holder = holder_find(s, worker);
    return holder == NULL ? 0 : holder->units;
}

size_t schedule_holders(const schedule_t *s)
{
    size_t count = 0;
    for (size_t i = 0; i < s->holder_count; i++)
        count += s->holders[i].units > 0 && s->holders[i].worker != 0;
    return count;
}

unit_t *schedule_units_of(const schedule_t *s, uint64_t worker, size_t *count)
{
    const holder_t *holder = holder_find(s, worker);
    *count = 0;
    if (holder == NULL || holder->units == 0) return NULL;
    uint32_t name = (uint32_t)(holder - s->holders);
    unit_t *units = mem_alloc(holder->units * sizeof *units);
    for (uint32_t t = 0; t < s->tile_count && *count < holder->units; t++)
        for (uint32_t i = 0; i < s->tiles[t].count; i++) {
            span_t span = s->tiles[t].spans[i];
            if (span.holder == name) units[(*count)++] = (unit_t){t, span.first, span.end - span.first};
        }
    return units;
}

uint64_t schedule_done(const schedule_t *s)
{
    return s->counted;
}

schedule_account_t schedule_account(const schedule_t *s)
{
    return (schedule_account_t){.issued = s->issued,
                                .counted = s->counted,
                                .returned = s->returned,
                                .out = s->out,
                                .skipped = s->skipped};
}

void schedule_tile_samples(const schedule_t *s, uint32_t *samples)
{
    for (uint32_t t = 0; t < s->tile_count; t++) {
        samples[t] = 0;
        for (uint32_t i = 0; i < s->tiles[t].count; i++) {
            span_t span = s->tiles[t].spans[i];
            if (span.holder == SPAN_COUNTED) samples[t] += span.end - span.first;
        }
    }
}

void schedule_show_samples(const job_settings_t *settings, const uint32_t *tile_samples, int y0, int y1,
                           float *samples)
{
    for (uint32_t t = 0; t < job_tile_count(settings); t++) {
        rect_t rect = job_tile_rect(settings, t);
        for (int y = int_max(rect.y0, y0); y < int_min(rect.y1, y1); y++)
            for (int x = rect.x0; x < rect.x1; x++)
                samples[(size_t)(y - y0) * (size_t)settings->width + (size_t)x] = (float)tile_samples[t];
    }
}
