/* ledger: see ledger.h.
 *
 * DESIGN. Plain lists that are searched from end to end: a relay has some thousand units at a time (the wire
 * allows 16384 in a batch), and a batch comes a few times a second. */
#include "relay/ledger.h"

#include <stdlib.h>
#include <string.h>

void ledger_init(ledger_t *ledger, const job_settings_t *settings)
{
    *ledger = (ledger_t){.settings = *settings};
}

void ledger_free(ledger_t *ledger)
{
    unit_queue_free(&ledger->free);
    free(ledger->out);
    free(ledger->summed);
    *ledger = (ledger_t){.settings = ledger->settings, .plans = ledger->plans};
}

/* Samples a pixel that two units share. */
static uint32_t overlap(const unit_t *a, const unit_t *b)
{
    uint32_t first = a->first > b->first ? a->first : b->first;
    uint32_t end = unit_end(a) < unit_end(b) ? unit_end(a) : unit_end(b);
    return a->tile == b->tile && first < end ? end - first : 0;
}

/* What is left of a unit without another that it shares samples with; returns how many pieces. */
static int cut(const unit_t *unit, const unit_t *out, unit_t pieces[2])
{
    int count = 0;
    if (unit->first < out->first)
        pieces[count++] = (unit_t){unit->tile, unit->first, out->first - unit->first};
    if (unit_end(out) < unit_end(unit))
        pieces[count++] = (unit_t){unit->tile, unit_end(out), unit_end(unit) - unit_end(out)};
    return count;
}

static void add_loan(ledger_t *ledger, uint64_t worker, const unit_t *unit)
{
    if (ledger->out_count == ledger->out_capacity) {
        ledger->out_capacity = 2 * ledger->out_capacity + 64;
        ledger->out = mem_realloc(ledger->out, ledger->out_capacity * sizeof *ledger->out);
    }
    ledger->out[ledger->out_count++] = (loan_t){*unit, worker};
}

static void add_summed(ledger_t *ledger, const unit_t *unit)
{
    if (ledger->summed_count == ledger->summed_capacity) {
        ledger->summed_capacity = 2 * ledger->summed_capacity + 64;
        ledger->summed = mem_realloc(ledger->summed, ledger->summed_capacity * sizeof *ledger->summed);
    }
    ledger->summed[ledger->summed_count++] = *unit;
}

/* ---- what comes and goes ------------------------------------------------------------------------------- */

void ledger_put(ledger_t *ledger, const unit_t *units, size_t count)
{
    size_t here_count;
    unit_t *here = ledger_all(ledger, &here_count);
    for (size_t i = 0; i < count; i++)
        unit_queue_push(&ledger->free, &ledger->settings, units[i], here, here_count);
    free(here);
}

size_t ledger_lend(ledger_t *ledger, uint64_t worker, uint64_t samples, unit_t *units, size_t capacity)
{
    size_t count = 0;
    uint64_t lent = 0;
    while (count < capacity && (count == 0 || lent < samples) &&
           unit_queue_pop(&ledger->free, &ledger->settings, ledger->plans, &units[count])) {
        lent += unit_samples(&ledger->settings, &units[count]);
        add_loan(ledger, worker, &units[count++]);
    }
    return count;
}

/* Takes the samples of a unit out of the free ones; returns how many a pixel there were. */
static uint32_t take_free(ledger_t *ledger, const unit_t *unit)
{
    unit_queue_t old = ledger->free;
    uint32_t taken = 0;
    bool found = false;
    for (size_t i = old.first; i < old.end && !found; i++) found = overlap(&old.units[i], unit) > 0;
    if (!found) return 0;
    ledger->free = (unit_queue_t){0};
    for (size_t i = old.first; i < old.end; i++) {
        unit_t pieces[2] = {old.units[i]};
        uint32_t shared = overlap(&old.units[i], unit);
        int count = shared > 0 ? cut(&old.units[i], unit, pieces) : 1;
        for (int p = 0; p < count; p++) unit_queue_push(&ledger->free, &ledger->settings, pieces[p], NULL, 0);
        taken += shared;
    }
    unit_queue_free(&old);
    return taken;
}

/* Samples a pixel of a unit that are free. */
static uint32_t count_free(const ledger_t *ledger, const unit_t *unit)
{
    uint32_t count = 0;
    for (size_t i = ledger->free.first; i < ledger->free.end; i++)
        count += overlap(&ledger->free.units[i], unit);
    return count;
}

bool ledger_lend_unit(ledger_t *ledger, uint64_t worker, const unit_t *unit)
{
    if (count_free(ledger, unit) != unit->count) return false;
    take_free(ledger, unit);
    add_loan(ledger, worker, unit);
    return true;
}

void ledger_drop_free(ledger_t *ledger)
{
    unit_queue_clear(&ledger->free);
}

/* Takes the samples of a unit away from who holds them (`worker` 0: whoever); what is taken is free again if
 * `back`. Returns how many pieces were taken. */
static size_t take_out(ledger_t *ledger, uint64_t worker, const unit_t *unit, bool back)
{
    size_t taken = 0;
    for (size_t i = 0; i < ledger->out_count;) {
        loan_t loan = ledger->out[i];
        uint32_t shared = overlap(&loan.unit, unit);
        if (shared == 0 || (worker != 0 && loan.worker != worker)) {
            i++;
            continue;
        }
        unit_t pieces[2];
        int count = cut(&loan.unit, unit, pieces);
        uint32_t first = loan.unit.first > unit->first ? loan.unit.first : unit->first;
        unit_t part = {unit->tile, first, shared};
        ledger->out[i] = ledger->out[--ledger->out_count];
        for (int p = 0; p < count; p++) add_loan(ledger, loan.worker, &pieces[p]);
        if (back) unit_queue_push(&ledger->free, &ledger->settings, part, NULL, 0);
        taken++;
    }
    return taken;
}

size_t ledger_return_units(ledger_t *ledger, uint64_t worker, const unit_t *units, size_t count)
{
    size_t returned = 0;
    for (size_t i = 0; i < count; i++) returned += take_out(ledger, worker, &units[i], true);
    return returned;
}

size_t ledger_return(ledger_t *ledger, uint64_t worker)
{
    size_t returned = 0, kept = 0;
    for (size_t i = 0; i < ledger->out_count; i++) {
        if (ledger->out[i].worker != worker) {
            ledger->out[kept++] = ledger->out[i];
            continue;
        }
        unit_queue_push(&ledger->free, &ledger->settings, ledger->out[i].unit, NULL, 0);
        returned++;
    }
    ledger->out_count = kept;
    return returned;
}

/* ---- what is delivered --------------------------------------------------------------------------------- */

/* Samples a pixel of a unit that are free or out. */
static uint32_t count_here(const ledger_t *ledger, const unit_t *unit)
{
    uint32_t count = count_free(ledger, unit);
    for (size_t i = 0; i < ledger->out_count; i++) count += overlap(&ledger->out[i].unit, unit);
    return count;
}

result_t ledger_accept(ledger_t *ledger, const unit_t *units, size_t count)
{
    TRY(units_check_apart(units, count));
    for (size_t i = 0; i < count; i++)
        if (count_here(ledger, &units[i]) != units[i].count)
            return result_fail(RESULT_MISMATCH,
                               "tile %u, samples %u + %u were delivered before, or are not wanted here",
                               units[i].tile, units[i].first, units[i].count);
    for (size_t i = 0; i < count; i++) {
        take_out(ledger, 0, &units[i], false);
        take_free(ledger, &units[i]);
        add_summed(ledger, &units[i]);
    }
    return result_ok();
}

void ledger_settle(ledger_t *ledger, const unit_t *units, size_t count)
{
    for (size_t i = 0; i < count; i++)
        for (size_t s = 0; s < ledger->summed_count; s++) {
            if (overlap(&ledger->summed[s], &units[i]) == 0) continue;
            ledger->summed[s] = ledger->summed[--ledger->summed_count];
            break;
        }
}

/* ---- questions ----------------------------------------------------------------------------------------- */

size_t ledger_held(const ledger_t *ledger, uint64_t worker)
{
    size_t held = 0;
    for (size_t i = 0; i < ledger->out_count; i++) held += ledger->out[i].worker == worker;
    return held;
}

size_t ledger_units(const ledger_t *ledger)
{
    return unit_queue_length(&ledger->free) + ledger->out_count + ledger->summed_count;
}

unit_t *ledger_all(const ledger_t *ledger, size_t *count)
{
    size_t waiting = unit_queue_length(&ledger->free);
    *count = ledger_units(ledger);
    unit_t *units = mem_alloc((*count + 1) * sizeof *units);
    size_t listed = ledger_list(ledger, units, *count);
    if (waiting > 0) memcpy(units + listed, ledger->free.units + ledger->free.first, waiting * sizeof *units);
    return units;
}

size_t ledger_list(const ledger_t *ledger, unit_t *units, size_t capacity)
{
    size_t count = 0;
    for (size_t i = 0; i < ledger->out_count && count < capacity; i++) units[count++] = ledger->out[i].unit;
    for (size_t i = 0; i < ledger->summed_count && count < capacity; i++) units[count++] = ledger->summed[i];
    return count;
}
