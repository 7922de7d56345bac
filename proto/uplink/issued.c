/* issued: see issued.h.
 *
 * DESIGN. A list that is sorted by tile and first sample when it is searched. Units that were issued once lie
 * apart, so the search ends at the first; where they overlap (a master gave some out again) it goes back as
 * far as one reaches. */
#include "proto/uplink/issued.h"

#include <stdlib.h>

static uint32_t end_of(const unit_t *unit)
{
    return unit->first + unit->count;
}

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
        here->reach = end_of(&here->unit);
        if (before != NULL && before->unit.tile == here->unit.tile && before->reach > here->reach)
            here->reach = before->reach;
    }
    issued->sorted = true;
}

/* How many units begin where this one does, or before. */
static size_t count_up_to(const issued_t *issued, const unit_t *unit)
{
    size_t low = 0, high = issued->count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        const unit_t *at = &issued->list[middle].unit;
        if (at->tile < unit->tile || (at->tile == unit->tile && at->first <= unit->first))
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
    for (size_t i = count_up_to(issued, unit); i > 0; i--) {
        const issued_unit_t *at = &issued->list[i - 1];
        if (at->unit.tile != unit->tile || at->reach < end_of(unit)) break;
        if (end_of(&at->unit) >= end_of(unit) && (found == NULL || at->age > found->age)) found = at;
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
        issues[i].after = end_of(&found->unit) - end_of(&units[i]);
    }
}

/* True when one of the sorted units, which lie apart, shares samples with this one. */
static bool shares(const unit_t *sorted, size_t count, const unit_t *unit)
{
    size_t low = 0, high = count; /* how many begin before its end */
    while (low < high) {
        size_t middle = (low + high) / 2;
        const unit_t *at = &sorted[middle];
        if (at->tile < unit->tile || (at->tile == unit->tile && at->first < end_of(unit)))
            low = middle + 1;
        else
            high = middle;
    }
    return low > 0 && sorted[low - 1].tile == unit->tile && end_of(&sorted[low - 1]) > unit->first;
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
