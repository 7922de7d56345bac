/* schedule: see schedule.h.
 *
 * DESIGN. A tile has a sorted list of spans: sample ranges that are counted or issued. What lies between
 * spans and after the last one is free, so giving units back is deleting spans, and nothing has to remember
 * that they were returned. Counted neighbours are joined: however long a job runs, a tile has one counted
 * span and a few issued ones.
 *
 * A binary heap holds the tiles by their lowest free sample, ties by tile number. The next unit comes from
 * the top. So returned samples, which are lower than those of other tiles, go out first, and no tile runs
 * ahead of another by more than one unit: all tiles get sample range k before k + 1.
 *
 * The size of a unit follows the worker's wish, with two exceptions. While a tile is young, a unit at most
 * doubles its samples, starting from FIRST_PASS when the job is to reach a number of samples and from one
 * when only the clock ends it: the whole image is covered early, and a render of a minute has no black tiles.
 * (A unit costs an eye tile on the wire, so fewer is better.) And when the free samples run out, a worker
 * gets no more than half of its share of them by threads, in units that leave a few for each of its threads:
 * all workers finish together.
 *
 * Spans name their holder by an index in a small table, so that they stay small; an index is used again when
 * its worker holds nothing. Losing a worker walks over all tiles, which is rare and cheap next to rendering
 * one unit. */
#include "master/schedule.h"

#include <stdlib.h>
#include <string.h>

enum {
    FIRST_PASS = 4,       /* samples a pixel of the first unit of a tile, where spp ends the job */
    UNITS_A_THREAD = 2,   /* in a grant, so that a worker's threads are all busy */
    COUNTED = UINT16_MAX, /* span_t.holder of what is in the film */
    MAX_HOLDERS = COUNTED
};
#define NONE_FREE UINT32_MAX

/* The samples [first, end) of a tile. */
typedef struct {
    uint32_t first, end;
    uint32_t holder; /* index in the table of holders, or COUNTED */
} span_t;

typedef struct {
    span_t *spans;
    uint32_t count, capacity;
    uint32_t lowest_free; /* NONE_FREE: all issued or counted; the key in the heap */
    uint32_t heap_index;
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
    holder_t *holders;
    size_t holder_count;
    size_t span_count;
    uint64_t counted, issued, total; /* pixel samples */
};

/* ---- the heap of tiles --------------------------------------------------------------------------------- */

static bool comes_before(const schedule_t *s, uint32_t a, uint32_t b)
{
    uint32_t key_a = s->tiles[a].lowest_free, key_b = s->tiles[b].lowest_free;
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

/* Finds the lowest free sample again, after the tile's spans have changed. */
static void tile_refresh(schedule_t *s, uint32_t index)
{
    tile_t *tile = &s->tiles[index];
    uint32_t lowest = 0;
    for (uint32_t i = 0; i < tile->count && tile->spans[i].first == lowest; i++) lowest = tile->spans[i].end;
    tile->lowest_free = lowest < s->settings.spp ? lowest : NONE_FREE;
    heap_update(s, index);
}

/* ---- holders ------------------------------------------------------------------------------------------- */

static holder_t *holder_find(const schedule_t *s, uint64_t worker)
{
    for (size_t i = 0; i < s->holder_count; i++)
        if (s->holders[i].units > 0 && s->holders[i].worker == worker) return &s->holders[i];
    return NULL;
}

/* The worker's entry, a new one if need be; NULL when the table is full. */
static holder_t *holder_make(schedule_t *s, uint64_t worker)
{
    holder_t *holder = holder_find(s, worker);
    if (holder != NULL) return holder;
    size_t i = 0;
    while (i < s->holder_count && s->holders[i].units > 0) i++;
    if (i == MAX_HOLDERS) return NULL;
    if (i == s->holder_count) {
        s->holders = mem_realloc(s->holders, (i + 1) * sizeof *s->holders);
        s->holder_count++;
    }
    s->holders[i] = (holder_t){.worker = worker};
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

/* Takes [first, end) away from an issued span: it shrinks, splits or goes. Returns the index of the first
 * span that is not before `end`. */
static uint32_t span_cut(schedule_t *s, uint32_t tile_index, uint32_t at, uint32_t first, uint32_t end)
{
    tile_t *tile = &s->tiles[tile_index];
    span_t old = tile->spans[at];
    holder_t *holder = &s->holders[old.holder];
    uint32_t low = old.first > first ? old.first : first, high = old.end < end ? old.end : end;
    s->issued -= span_samples(s, tile_index, low, high);
    span_delete(s, tile, at);
    holder->units--;
    if (old.first < low) {
        span_insert(s, tile, at++, (span_t){old.first, low, old.holder});
        holder->units++;
    }
    if (high < old.end) {
        span_insert(s, tile, at, (span_t){high, old.end, old.holder});
        holder->units++;
    }
    return at;
}

static bool unit_counted(const tile_t *tile, const unit_t *unit)
{
    uint32_t end = unit->first + unit->count;
    for (uint32_t i = span_after(tile, unit->first); i < tile->count && tile->spans[i].first < end; i++)
        if (tile->spans[i].holder == COUNTED) return true;
    return false;
}

/* Marks a unit, none of which is counted, as counted, and joins it with counted neighbours. */
static void unit_count(schedule_t *s, const unit_t *unit)
{
    tile_t *tile = &s->tiles[unit->tile];
    span_t span = {unit->first, unit->first + unit->count, COUNTED};
    s->counted += span_samples(s, unit->tile, span.first, span.end);
    uint32_t at = span_after(tile, span.first);
    while (at < tile->count && tile->spans[at].first < span.end)
        at = span_cut(s, unit->tile, at, span.first, span.end);
    at = span_after(tile, span.first);
    if (at < tile->count && tile->spans[at].first == span.end && tile->spans[at].holder == COUNTED) {
        span.end = tile->spans[at].end;
        span_delete(s, tile, at);
    }
    if (at > 0 && tile->spans[at - 1].end == span.first && tile->spans[at - 1].holder == COUNTED)
        tile->spans[at - 1].end = span.end;
    else
        span_insert(s, tile, at, span);
    tile_refresh(s, unit->tile);
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

schedule_t *schedule_new(const job_settings_t *settings)
{
    schedule_t *s = mem_zalloc(1, sizeof *s);
    s->settings = *settings;
    s->tile_count = job_tile_count(settings);
    s->tiles = mem_zalloc(s->tile_count, sizeof *s->tiles);
    s->heap = mem_alloc(s->tile_count * sizeof *s->heap);
    for (uint32_t i = 0; i < s->tile_count; i++) heap_put(s, i, i);
    s->total = (uint64_t)settings->width * (uint64_t)settings->height * settings->spp;
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
    free(s);
    *schedule = NULL;
}

static uint64_t least(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

static uint64_t most(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

/* Half of what is the worker's of the free pixel samples, if they were shared out by threads. */
static uint64_t fair_share(const schedule_t *s, const schedule_wish_t *wish)
{
    uint64_t threads = most(wish->threads, 1), all = most(wish->farm_threads, threads);
    uint64_t free_samples = s->total - s->counted - s->issued;
    return most(free_samples / (2 * all), 1) * threads;
}

/* Issues one unit of about `samples` pixel samples from the tile at the top of the heap. */
static unit_t take_unit(schedule_t *s, holder_t *holder, uint64_t samples)
{
    uint32_t index = s->heap[0];
    tile_t *tile = &s->tiles[index];
    uint32_t first = tile->lowest_free, at = span_after(tile, first);
    uint32_t gap = (at < tile->count ? tile->spans[at].first : s->settings.spp) - first;
    uint64_t young = most(first, s->settings.time_limit > 0 ? 1 : FIRST_PASS);
    uint64_t count = most(samples / job_tile_pixels(&s->settings, index), 1);
    unit_t unit = {index, first, (uint32_t)least(count, least(young, gap))};
    span_insert(s, tile, at, (span_t){first, first + unit.count, (uint32_t)(holder - s->holders)});
    holder->units++;
    s->issued += span_samples(s, index, first, first + unit.count);
    tile_refresh(s, index);
    return unit;
}

size_t schedule_take(schedule_t *s, const schedule_wish_t *wish, unit_t *units, size_t capacity)
{
    if (wish->samples == 0 || capacity == 0 || !schedule_available(s)) return 0;
    holder_t *holder = holder_make(s, wish->worker);
    if (holder == NULL) return 0;
    uint64_t share = fair_share(s, wish), grant = least(wish->samples, share), taken = 0;
    uint64_t unit_samples = least(wish->unit_samples, share / (UNITS_A_THREAD * most(wish->threads, 1)));
    size_t count = 0;
    while (count < capacity && taken < grant && schedule_available(s)) {
        units[count] = take_unit(s, holder, unit_samples);
        taken += (uint64_t)units[count].count * job_tile_pixels(&s->settings, units[count].tile);
        count++;
    }
    return count;
}

static int unit_order(const void *a, const void *b)
{
    const unit_t *u = a, *v = b;
    if (u->tile != v->tile) return u->tile < v->tile ? -1 : 1;
    return u->first < v->first ? -1 : u->first > v->first;
}

/* Looks for two units of the list that share samples. */
static result_t check_overlap(const unit_t *units, size_t count)
{
    unit_t *sorted = mem_alloc((count + 1) * sizeof *sorted);
    result_t result = result_ok();
    memcpy(sorted, units, count * sizeof *sorted);
    qsort(sorted, count, sizeof *sorted, unit_order);
    for (size_t i = 1; i < count && result.code == RESULT_OK; i++)
        if (sorted[i].tile == sorted[i - 1].tile &&
            sorted[i].first - sorted[i - 1].first < sorted[i - 1].count)
            result = result_fail(RESULT_MISMATCH, "tile %u, sample %u is in the batch twice", sorted[i].tile,
                                 sorted[i].first);
    free(sorted);
    return result;
}

result_t schedule_accept(schedule_t *s, const unit_t *units, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (unit_counted(&s->tiles[units[i].tile], &units[i]))
            return result_fail(RESULT_MISMATCH, "tile %u, samples %u + %u were counted before", units[i].tile,
                               units[i].first, units[i].count);
    TRY(check_overlap(units, count));
    for (size_t i = 0; i < count; i++) unit_count(s, &units[i]);
    return result_ok();
}

/* Frees what the holder has of [first, end) of a tile. */
static size_t release_range(schedule_t *s, const holder_t *holder, uint32_t index, uint32_t first,
                            uint32_t end)
{
    tile_t *tile = &s->tiles[index];
    uint32_t name = (uint32_t)(holder - s->holders), at = span_after(tile, first);
    size_t pieces = 0;
    while (at < tile->count && tile->spans[at].first < end) {
        if (tile->spans[at].holder == name) {
            at = span_cut(s, index, at, first, end);
            pieces++;
        } else {
            at++;
        }
    }
    if (pieces > 0) tile_refresh(s, index);
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
        pieces += release_range(s, holder, i, 0, s->settings.spp);
    return pieces;
}

bool schedule_available(const schedule_t *s)
{
    return s->tiles[s->heap[0]].lowest_free != NONE_FREE;
}

bool schedule_complete(const schedule_t *s)
{
    return s->counted == s->total;
}

size_t schedule_held(const schedule_t *s, uint64_t worker)
{
    const holder_t *holder = holder_find(s, worker);
    return holder == NULL ? 0 : holder->units;
}

size_t schedule_holders(const schedule_t *s)
{
    size_t count = 0;
    for (size_t i = 0; i < s->holder_count; i++) count += s->holders[i].units > 0;
    return count;
}

uint64_t schedule_done(const schedule_t *s)
{
    return s->counted;
}

uint64_t schedule_total(const schedule_t *s)
{
    return s->total;
}

size_t schedule_spans(const schedule_t *s)
{
    return s->span_count;
}
