/* faults: see faults.h. */
#include "tests/chaos/disk.h"
#include "tests/chaos/faults/faults_state.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void fault_victim(fault_t *fault, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(fault->victim, sizeof fault->victim, format, arguments);
    va_end(arguments);
}

double fault_between(double chance, double least, double most)
{
    return least + chance * (most - least);
}

double fault_scales(double chance, double least, double most)
{
    return least * pow(most / least, chance);
}

/* ---- the list ----------------------------------------------------------------------------------------- */

static bool is_wanted(const faults_t *faults, const fault_kind_t *kind)
{
    if (kind->possible && !kind->possible(faults)) return false;
    if (faults->setup.only == NULL) return true;
    char *list = mem_strdup(faults->setup.only), *rest = list;
    bool found = false;
    for (char *part; (part = strsep(&rest, ",")) != NULL;) found = found || strstr(kind->name, part);
    free(list);
    return found;
}

static void choose_kinds(faults_t *faults)
{
    const fault_family_t *const families[] = {&PROCESS_FAULTS, &MACHINE_FAULTS, &NETWORK_FAULTS};
    for (size_t f = 0; f < ARRAY_LENGTH(families); f++)
        for (size_t i = 0; i < families[f]->count; i++)
            if (is_wanted(faults, &families[f]->list[i]))
                faults->kinds[faults->kind_count++] = &families[f]->list[i];
    if (faults->kind_count > 0) return;
    fputs("chaos: no fault of such a kind is possible here\n", stderr);
    exit(RESULT_USAGE);
}

static void shuffle_deck(faults_t *faults)
{
    faults->deck_left = 0;
    for (size_t kind = 0; kind < faults->kind_count; kind++)
        for (unsigned i = 0; i < faults->kinds[kind]->cards; i++) faults->deck[faults->deck_left++] = kind;
    for (size_t i = faults->deck_left; i > 1; i--) {
        size_t other = dice_below(&faults->dice, i), card = faults->deck[i - 1];
        faults->deck[i - 1] = faults->deck[other];
        faults->deck[other] = card;
    }
}

/* The next fault of the list. What it draws from the dice never depends on what goes on. */
static fault_t deal(faults_t *faults)
{
    if (faults->deck_left == 0) shuffle_deck(faults);
    size_t index = faults->deck[--faults->deck_left];
    const fault_kind_t *kind = faults->kinds[index];
    fault_t fault = {
        .kind = kind, .kind_index = index, .number = ++faults->dealt, .pick = dice_next(&faults->dice) >> 8};
    fault.duration = dice_between(&faults->dice, kind->least, kind->most);
    for (int i = 0; i < FAULT_CHANCES; i++) fault.chance[i] = dice_between(&faults->dice, 0, 1);
    return fault;
}

/* ---- the course of things ----------------------------------------------------------------------------- */

faults_t *faults_new(const faults_setup_t *setup)
{
    faults_t *faults = mem_zalloc(1, sizeof *faults);
    faults->setup = *setup;
    choose_kinds(faults);
    faults->dice = dice_new(setup->seed, 1);
    faults->next = clock_now() + setup->pause;
    size_t late = 0;
    for (size_t i = 0; i < setup->processes->worker_count; i++) {
        processes_worker_t *worker = &setup->processes->workers[i];
        if (worker->member.process != 0) continue;
        worker->member.retired = true;
        faults->late[late++] = worker;
    }
    film_watch_open(&faults->films, setup->processes->data);
    return faults;
}

void faults_free(faults_t **faults)
{
    if (*faults == NULL) return;
    film_watch_close(&(*faults)->films);
    free(*faults);
    *faults = NULL;
}

static void finish(faults_t *faults, fault_t *fault)
{
    if (fault->kind->end) fault->kind->end(faults, fault);
    if (fault->spoilt) {
        report_line(faults->setup.report, "#%zu %s: it hit nobody", fault->number, fault->kind->name);
    } else {
        faults->counts[fault->kind_index]++;
        faults->hits[fault->kind_index] += fault->hits;
        faults->count++;
    }
    fault->kind = NULL;
}

static void begin(faults_t *faults, fault_t *place)
{
    fault_t *fault = place;
    *fault = deal(faults);
    double now = clock_now();
    bool begun = fault->kind->begin(faults, fault);
    fault->ends = now + fault->duration;
    char lasting[40] = "";
    if (fault->duration > 0) snprintf(lasting, sizeof lasting, " for %.2f s", fault->duration);
    report_line(faults->setup.report, "#%zu %s%s%s%s%s", fault->number, fault->kind->name,
                fault->victim[0] ? ": " : "", fault->victim, lasting, begun ? "" : " (cannot be now)");
    if (!begun)
        fault->kind = NULL;
    else if (fault->duration == 0)
        finish(faults, fault);
    faults->next = now + (begun ? 1 : 0.2) * dice_between(&faults->dice, 0.3 * faults->setup.pause,
                                                          1.7 * faults->setup.pause);
}

void faults_tick(faults_t *faults, bool more, double seconds)
{
    faults_on_film(faults, film_watch_wait(&faults->films, seconds));
    double now = clock_now();
    fault_t *place = NULL;
    for (size_t i = 0; i < MAX_ACTIVE_FAULTS; i++) {
        fault_t *fault = &faults->active[i];
        if (fault->kind && now >= fault->ends) finish(faults, fault);
        if (fault->kind == NULL) place = fault;
    }
    if (faults->disk_busy) disk_fill(faults->setup.processes->data);
    if (more && place && now >= faults->next) begin(faults, place);
}

void faults_heal(faults_t *faults)
{
    for (size_t i = 0; i < MAX_ACTIVE_FAULTS; i++)
        if (faults->active[i].kind) finish(faults, &faults->active[i]);
}

size_t faults_count(const faults_t *faults)
{
    return faults->count;
}

size_t faults_master_kills(const faults_t *faults)
{
    return faults->kills;
}

void faults_print(const faults_t *faults)
{
    report_t *report = faults->setup.report;
    report_text(report, "%6s  %s", "faults", "kind");
    for (size_t i = 0; i < faults->kind_count; i++) {
        if (faults->counts[i] == 0) continue;
        char times[40] = "";
        if (faults->hits[i] > 0) snprintf(times, sizeof times, " (%zu times)", faults->hits[i]);
        report_text(report, "%6zu  %s%s", faults->counts[i], faults->kinds[i]->name, times);
    }
    report_text(report,
                "%6zu  in all; the master was killed %zu times, %zu times with a checkpoint half written",
                faults->count, faults->kills, faults->torn);
}
