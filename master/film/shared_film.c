/* shared_film: see shared_film.h. This file has the pages, their locks and the snapshots; shared_film_merge.c
 * knows what a batch is.
 *
 * DESIGN. The arrays of a film are cut into pages of a megabyte with a mutex each, so that many threads add
 * to one film: they meet at a page for some 50 microseconds, and decode their batches apart. Above that is a
 * lock that mergers share and readers have alone. It prefers readers, who come seldom, so that a farm that
 * merges all the time cannot keep them waiting.
 *
 * A snapshot marks all pages as wanted, under that lock. Whoever is about to change a wanted page copies it
 * first; the reader of the snapshot takes the copy, or the page itself when nobody has changed it. */
#include "master/film/shared_film_pages.h"

#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#define NO_PAGE SIZE_MAX

struct shared_film_snapshot {
    shared_film_t *shared_film;
    film_counts_t counts;
};

/* ---- pages --------------------------------------------------------------------------------------------- */

static size_t sum_bytes(const job_settings_t *settings, sum_kind_t kind)
{
    return sum_image_values(settings, kind) * film_sums[kind].bytes;
}

static size_t pages_of(const job_settings_t *settings, sum_kind_t kind)
{
    return (sum_bytes(settings, kind) + SHARED_FILM_PAGE_BYTES - 1) / SHARED_FILM_PAGE_BYTES;
}

size_t shared_film_page_count(const job_settings_t *settings)
{
    size_t count = 0;
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) count += pages_of(settings, k);
    return count;
}

/* Bytes of the page that begins at byte `start` of one of the sums. */
static size_t page_bytes(const job_settings_t *settings, sum_kind_t kind, size_t start)
{
    size_t left = sum_bytes(settings, kind) - start;
    return left < SHARED_FILM_PAGE_BYTES ? left : SHARED_FILM_PAGE_BYTES;
}

void *shared_film_page(const film_t *film, size_t index, size_t *size)
{
    const sum_kind_t *kind = film_page_order;
    for (; index >= pages_of(&film->settings, *kind); kind++) index -= pages_of(&film->settings, *kind);
    *size = page_bytes(&film->settings, *kind, index * SHARED_FILM_PAGE_BYTES);
    return (uint8_t *)film_values(film, *kind) + index * SHARED_FILM_PAGE_BYTES;
}

/* ---- life ---------------------------------------------------------------------------------------------- */

/* Large pages of the machine: a merge goes through all of a film, and spares itself most look-ups of
 * addresses. */
static void ask_for_huge_pages(uint8_t *array, size_t bytes)
{
    enum { HUGE_PAGE = 2 << 20 };
    uintptr_t first = ((uintptr_t)array + HUGE_PAGE - 1) / HUGE_PAGE * HUGE_PAGE;
    uintptr_t end = ((uintptr_t)array + bytes) / HUGE_PAGE * HUGE_PAGE;
    if (array != NULL && end > first && madvise((void *)first, end - first, MADV_HUGEPAGE) != 0)
        log_debug("no huge pages");
}

shared_film_t *shared_film_new(film_t *film)
{
    shared_film_t *shared_film = mem_zalloc(1, sizeof *shared_film);
    pthread_rwlockattr_t attributes;
    shared_film->film = film;
    pthread_rwlockattr_init(&attributes);
    pthread_rwlockattr_setkind_np(&attributes, PTHREAD_RWLOCK_PREFER_WRITER_NONRECURSIVE_NP);
    pthread_rwlock_init(&shared_film->lock, &attributes);
    pthread_rwlockattr_destroy(&attributes);
    pthread_mutex_init(&shared_film->counting, NULL);
    for (int i = 0; i < FILM_SUMS; i++) {
        sum_kind_t kind = film_page_order[i];
        shared_film->first_page[kind] = shared_film->page_count;
        shared_film->page_count += pages_of(&film->settings, kind);
        ask_for_huge_pages(film_values(film, kind), sum_bytes(&film->settings, kind));
    }
    shared_film->pages = mem_zalloc(shared_film->page_count, sizeof *shared_film->pages);
    for (size_t i = 0; i < shared_film->page_count; i++)
        pthread_mutex_init(&shared_film->pages[i].lock, NULL);
    return shared_film;
}

void shared_film_destroy(shared_film_t **pointer)
{
    shared_film_t *shared_film = *pointer;
    if (shared_film == NULL) return;
    for (size_t i = 0; i < shared_film->page_count; i++) pthread_mutex_destroy(&shared_film->pages[i].lock);
    free(shared_film->pages);
    film_destroy(&shared_film->film);
    pthread_rwlock_destroy(&shared_film->lock);
    pthread_mutex_destroy(&shared_film->counting);
    free(shared_film);
    *pointer = NULL;
}

void shared_film_enter(shared_film_t *shared_film)
{
    pthread_rwlock_rdlock(&shared_film->lock);
}

void shared_film_leave(shared_film_t *shared_film)
{
    pthread_rwlock_unlock(&shared_film->lock);
}

film_counts_t shared_film_counts(shared_film_t *shared_film)
{
    pthread_mutex_lock(&shared_film->counting);
    film_counts_t counts = shared_film->film->counts;
    pthread_mutex_unlock(&shared_film->counting);
    return counts;
}

const film_t *shared_film_lock(shared_film_t *shared_film)
{
    pthread_rwlock_wrlock(&shared_film->lock);
    return shared_film->film;
}

void shared_film_unlock(shared_film_t *shared_film)
{
    pthread_rwlock_unlock(&shared_film->lock);
}

void shared_film_settle(shared_film_t *shared_film, uint32_t passes)
{
    shared_film->film->settled = passes;
}

const int64_t *shared_film_lessons(const shared_film_t *shared_film)
{
    return shared_film->film->sums[SUM_LESSONS];
}

/* ---- snapshots ----------------------------------------------------------------------------------------- */

shared_film_snapshot_t *shared_film_snapshot(shared_film_t *shared_film)
{
    shared_film_snapshot_t *snapshot = mem_alloc(sizeof *snapshot);
    *snapshot = (shared_film_snapshot_t){shared_film, shared_film_counts(shared_film)};
    for (size_t i = 0; i < shared_film->page_count; i++) {
        pthread_mutex_lock(&shared_film->pages[i].lock);
        shared_film->pages[i].wanted = true;
        pthread_mutex_unlock(&shared_film->pages[i].lock);
    }
    return snapshot;
}

film_counts_t shared_film_snapshot_counts(const shared_film_snapshot_t *snapshot)
{
    return snapshot->counts;
}

/* The page is not wanted any more. */
static void forget_page(page_t *page)
{
    free(page->copy);
    page->copy = NULL;
    page->wanted = false;
}

size_t shared_film_snapshot_read(shared_film_snapshot_t *snapshot, size_t index, void *bytes)
{
    size_t size;
    page_t *page = &snapshot->shared_film->pages[index];
    const void *now = shared_film_page(snapshot->shared_film->film, index, &size);
    pthread_mutex_lock(&page->lock);
    memcpy(bytes, page->copy != NULL ? page->copy : now, size);
    forget_page(page);
    pthread_mutex_unlock(&page->lock);
    return size;
}

void shared_film_snapshot_free(shared_film_snapshot_t **pointer)
{
    shared_film_snapshot_t *snapshot = *pointer;
    if (snapshot == NULL) return;
    for (size_t i = 0; i < snapshot->shared_film->page_count; i++) {
        page_t *page = &snapshot->shared_film->pages[i];
        pthread_mutex_lock(&page->lock);
        forget_page(page);
        pthread_mutex_unlock(&page->lock);
    }
    free(snapshot);
    *pointer = NULL;
}

/* ---- adding -------------------------------------------------------------------------------------------- */

adder_t adder_new(shared_film_t *shared_film, add_mode_t mode, bool negative, uint64_t limit)
{
    return (adder_t){
        .shared_film = shared_film, .mode = mode, .negative = negative, .limit = limit, .held = NO_PAGE};
}

void adder_rest(adder_t *adder)
{
    if (adder->held != NO_PAGE) pthread_mutex_unlock(&adder->shared_film->pages[adder->held].lock);
    adder->held = NO_PAGE;
}

/* Locks the page of a byte of one of the sums, for changing it; *room is what is left from there on of a page
 * of full length. */
static void *reach(adder_t *adder, sum_kind_t kind, size_t offset, size_t *room)
{
    shared_film_t *shared_film = adder->shared_film;
    uint8_t *values = film_values(shared_film->film, kind);
    size_t start = offset - offset % SHARED_FILM_PAGE_BYTES;
    size_t index = shared_film->first_page[kind] + offset / SHARED_FILM_PAGE_BYTES;
    if (adder->held != index) {
        page_t *page = &shared_film->pages[index];
        adder_rest(adder);
        pthread_mutex_lock(&page->lock);
        adder->held = index;
        if (page->wanted && page->copy == NULL) {
            size_t size = page_bytes(&shared_film->film->settings, kind, start);
            page->copy = mem_alloc(size);
            memcpy(page->copy, values + start, size);
        }
    }
    *room = start + SHARED_FILM_PAGE_BYTES - offset;
    return values + offset;
}

/* Sums wrap, as unsigned numbers do: a hostile batch that is being taken back may leave the range for a
 * moment. */
static int64_t plus(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a + (uint64_t)b);
}

static int64_t minus(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a - (uint64_t)b);
}

/* The top bit is set when a sum is out of range: bits 62 and 63 are then different. Since the film's sums
 * were in range, and the values are, no sum has wrapped. */
static uint64_t range_bit(int64_t sum)
{
    return (uint64_t)sum ^ (uint64_t)sum << 1;
}

static bool out_of_range(int64_t value)
{
    return value >= INT64_C(1) << 62 || value <= -(INT64_C(1) << 62);
}

/* Values for pixels that lie apart: `lanes` of each, every `stride`. */
typedef struct {
    size_t stride, lanes;
    const int64_t *values; /* [count * lanes] */
    size_t count;
    bool large; /* as of adder_add_marked */
} addend_t;

static void add_exact(int64_t *restrict sum, const addend_t *more, bool negative)
{
    const int64_t *restrict v = more->values;
    for (size_t i = 0; i < more->count; i++, sum += more->stride, v += more->lanes)
        for (size_t k = 0; k < more->lanes; k++) sum[k] = negative ? minus(sum[k], v[k]) : plus(sum[k], v[k]);
}

/* All or nothing. */
static bool add_strict(int64_t *restrict sum, const addend_t *more)
{
    uint64_t bad = 0;
    bool outside = false;
    const int64_t *restrict v = more->values;
    int64_t *pixel = sum;
    for (size_t i = 0; more->large && i < more->count * more->lanes; i++) outside |= out_of_range(v[i]);
    if (outside) return false;
    for (size_t i = 0; i < more->count; i++, pixel += more->stride, v += more->lanes)
        for (size_t k = 0; k < more->lanes; k++) {
            pixel[k] = plus(pixel[k], v[k]);
            bad |= range_bit(pixel[k]);
        }
    if (bad >> 63 == 0) return true;
    add_exact(sum, more, true);
    return false;
}

static uint64_t add_tolerant(int64_t *sum, const addend_t *more)
{
    uint64_t overflows = 0;
    for (size_t i = 0; i < more->count; i++)
        overflows += film_add_sums(sum + i * more->stride, more->values + i * more->lanes, more->lanes);
    return overflows;
}

/* Accounts for a step that was tried. */
static bool stepped(adder_t *adder, bool good)
{
    if (good)
        adder->steps++;
    else
        adder->overflows = 1;
    return good;
}

static bool step(adder_t *adder, int64_t *sum, const addend_t *more)
{
    if (adder->steps == adder->limit) return false;
    switch (adder->mode) {
    case ADD_STRICT:
        return stepped(adder, add_strict(sum, more));
    case ADD_TOLERANT:
        adder->overflows += add_tolerant(sum, more);
        break;
    case ADD_EXACT:
        add_exact(sum, more, adder->negative);
        break;
    case ADD_NOTHING:
        break;
    }
    return stepped(adder, true);
}

static bool add_values(adder_t *adder, sum_kind_t kind, size_t first, const int64_t *values, size_t count,
                       bool large)
{
    if (adder->mode == ADD_NOTHING) return true;
    while (count > 0) {
        size_t room;
        int64_t *sum = reach(adder, kind, first * sizeof *values, &room);
        size_t part = room / sizeof *values < count ? room / sizeof *values : count;
        addend_t more = {part, part, values, 1, large};
        if (!step(adder, sum, &more)) return false;
        first += part;
        values += part;
        count -= part;
    }
    return true;
}

static void add_marked_exact(int64_t *restrict sum, uint64_t mask, const int64_t *restrict values,
                             bool negative)
{
    for (; mask != 0; mask &= mask - 1, values += 3) {
        int64_t *pixel = sum + 3 * __builtin_ctzll(mask);
        for (int c = 0; c < 3; c++)
            pixel[c] = negative ? minus(pixel[c], values[c]) : plus(pixel[c], values[c]);
    }
}

static bool add_marked_strict(int64_t *restrict sum, uint64_t mask, const int64_t *restrict values)
{
    uint64_t bad = 0;
    const int64_t *v = values;
    for (uint64_t m = mask; m != 0; m &= m - 1, v += 3) {
        int64_t *pixel = sum + 3 * __builtin_ctzll(m);
        for (int c = 0; c < 3; c++) {
            pixel[c] = plus(pixel[c], v[c]);
            bad |= range_bit(pixel[c]);
        }
    }
    if (bad >> 63 == 0) return true;
    add_marked_exact(sum, mask, values, true);
    return false;
}

static uint64_t add_marked_tolerant(int64_t *sum, uint64_t mask, const int64_t *values)
{
    uint64_t overflows = 0;
    for (; mask != 0; mask &= mask - 1, values += 3)
        overflows += film_add_sums(sum + 3 * __builtin_ctzll(mask), values, 3);
    return overflows;
}

static bool step_marked(adder_t *adder, int64_t *sum, uint64_t mask, const int64_t *values)
{
    if (adder->steps == adder->limit) return false;
    switch (adder->mode) {
    case ADD_STRICT:
        return stepped(adder, add_marked_strict(sum, mask, values));
    case ADD_TOLERANT:
        adder->overflows += add_marked_tolerant(sum, mask, values);
        break;
    case ADD_EXACT:
        add_marked_exact(sum, mask, values, adder->negative);
        break;
    case ADD_NOTHING:
        break;
    }
    return stepped(adder, true);
}

/* The sums of the 64 pixels that come next are on their way meanwhile: a tenth less time where few are
 * marked. */
static void fetch_ahead(const int64_t *sum)
{
    enum { LINE_VALUES = 8 };
    for (int i = 0; i < 3 * 64; i += LINE_VALUES) __builtin_prefetch(sum + i, 1);
}

bool adder_add_marked(adder_t *adder, sum_kind_t kind, size_t first, uint64_t mask, const int64_t *values,
                      bool large)
{
    if (mask == 0 || adder->mode == ADD_NOTHING) return true;
    size_t room, span = 3 * (size_t)(64 - __builtin_clzll(mask));
    if (mask == UINT64_MAX) return add_values(adder, kind, first, values, span, large);
    int64_t *sum = reach(adder, kind, first * sizeof *values, &room);
    if (!large && room >= span * sizeof *values) {
        fetch_ahead(sum + 3 * 64);
        return step_marked(adder, sum, mask, values);
    }
    for (; mask != 0; mask &= mask - 1, values += 3)
        if (!add_values(adder, kind, first + 3 * (size_t)__builtin_ctzll(mask), values, 3, large))
            return false;
    return true;
}

bool adder_add_strided(adder_t *adder, sum_kind_t kind, size_t first, size_t stride, size_t lanes,
                       const int64_t *values, size_t count)
{
    if (stride == lanes) return add_values(adder, kind, first, values, count * lanes, true);
    if (adder->mode == ADD_NOTHING) return true;
    while (count > 0) {
        size_t room;
        int64_t *sum = reach(adder, kind, first * sizeof *values, &room);
        room /= sizeof *values;
        size_t fit = room >= lanes ? (room - lanes) / stride + 1 : 0, part = fit < count ? fit : count;
        addend_t more = {stride, lanes, values, part, true};
        if (part > 0) {
            if (!step(adder, sum, &more)) return false;
        } else { /* a pixel of two pages */
            if (!add_values(adder, kind, first, values, lanes, true)) return false;
            part = 1;
        }
        first += part * stride;
        values += part * lanes;
        count -= part;
    }
    return true;
}

bool adder_count(adder_t *adder, size_t first, uint32_t samples, size_t count)
{
    if (adder->mode == ADD_NOTHING) return true;
    while (count > 0) {
        size_t room;
        uint32_t *sum = reach(adder, SUM_SAMPLES, first * sizeof *sum, &room);
        size_t part = room / sizeof *sum < count ? room / sizeof *sum : count;
        if (adder->steps == adder->limit) return false;
        for (size_t i = 0; i < part; i++) sum[i] += adder->negative ? 0 - samples : samples;
        stepped(adder, true);
        first += part;
        count -= part;
    }
    return true;
}
