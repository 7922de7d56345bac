/* issued: see issued.h.
 *
 * DESIGN. A list that is sorted by tile and first sample when it is searched. Units that were issued once lie
 * apart, so the search ends at the first; where they overlap (a master gave some out again) it goes back as
 * far as one reaches. */
#include "proto/uplink/issued.h"

#include <stdlib.h>

void issued_add(issued_t *issued, const unit_t *units, const uint64_t *macs, size_t count)
{
    if (macs == NULL || count == 0) return;
    if (issued->count + count > issued->capacity) {
        issued->capacity = 2 * issued->capacity + count;
        issued->list = mem_realloc(issued->list, issued->capacity * sizeof *issued->list);
    }
    for (size_t i = 0; i < count; i++)
        issued->list[issued->count++] =
            (issued_unit_t){.unit = units[i], .mac = macs[i], .age = ++issued->came};
    issued->sorted = false;
}

static void sort(issued_t *issued)
{
    if (issued->sorted) return;
    if (issued->count > 0) qsort(issued->list, issued->count, sizeof *issued->list, unit_order);
    for (size_t i = 0; i < issued->count; i++) {
        issued_unit_t *here = &issued->list[i], *before = i > 0 ? here - 1 : NULL;
        here->reach = unit_end(&here->unit);
        if (before != NULL && before->unit.tile == here->unit.tile && before->reach > here->reach)
            here->reach = before->reach;
    }
    issued->sorted = true;
}

/* How many of a sorted list of what begins with a unit_t, each of `size` bytes, begin before a sample. */
static size_t count_before(const void *list, size_t size, size_t count, uint32_t tile, uint64_t sample)
{
    size_t low = 0, high = count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        const unit_t *at = (const void *)((const char *)list + middle * size);
        if (at->tile < tile || (at->tile == tile && at->first < sample))
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The one that came last of those that the unit lies in; NULL when there is none. */
static const issued_unit_t *find(const issued_t *issued, const unit_t *unit)
{
    const issued_unit_t *found = NULL;
    size_t begun = count_before(issued->list, sizeof *issued->list, issued->count, unit->tile,
                                (uint64_t)unit->first + 1);
    for (size_t i = begun; i > 0; i--) {
        const issued_unit_t *at = &issued->list[i - 1];
        if (at->unit.tile != unit->tile || at->reach < unit_end(unit)) break;
        if (unit_end(&at->unit) >= unit_end(unit) && (found == NULL || at->age > found->age)) found = at;
    }
    return found;
}

void issued_find(issued_t *issued, const unit_t *units, size_t count, issue_t *issues)
{
    sort(issued);
    for (size_t i = 0; i < count; i++) {
        const issued_unit_t *found = find(issued, &units[i]);
        issues[i] = (issue_t){0};
        if (found == NULL) continue;
        issues[i].mac = found->mac;
        issues[i].before = units[i].first - found->unit.first;
        issues[i].after = unit_end(&found->unit) - unit_end(&units[i]);
    }
}

/* True when one of the sorted units, which lie apart, shares samples with this one. */
static bool shares(const unit_t *sorted, size_t count, const unit_t *unit)
{
    size_t begun = count_before(sorted, sizeof *sorted, count, unit->tile, unit_end(unit));
    return begun > 0 && sorted[begun - 1].tile == unit->tile && unit_end(&sorted[begun - 1]) > unit->first;
}

void issued_keep(issued_t *issued, const unit_t *units, size_t count)
{
    unit_t *sorted = count > 0 ? units_sorted(units, count) : NULL;
    size_t kept = 0;
    for (size_t i = 0; i < issued->count; i++)
        if (shares(sorted, count, &issued->list[i].unit)) issued->list[kept++] = issued->list[i];
    free(sorted);
    if (kept < issued->count) issued->sorted = false; /* the reaches were of all */
    issued->count = kept;
}

void issued_clear(issued_t *issued)
{
    issued->count = 0;
    issued->sorted = false;
}

void issued_free(issued_t *issued)
{
    free(issued->list);
    *issued = (issued_t){0};
}
