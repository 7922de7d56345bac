/* checks: see checks.h. */
#include "worker/checks.h"

#include "proto/uplink/unit_queue.h"

#include <stdlib.h>
#include <string.h>

static void check_free(unit_check_t *check)
{
    for (size_t i = 0; i < check->count; i++) unit_result_free(&check->results[i]);
    free(check->results);
    free(check->units);
    batch_free(&check->batch);
    free(check);
}

void checks_push(checks_t *checks, const job_settings_t *settings, uint64_t number, unit_t *units,
                 const uint64_t *macs, size_t count)
{
    if (checks->count == CHECKS_MAX || count == 0) {
        free(units);
        return;
    }
    if (checks->count == checks->capacity) {
        checks->capacity = 2 * checks->capacity + 16;
        checks->list = mem_realloc(checks->list, checks->capacity * sizeof(unit_check_t *));
    }
    unit_check_t *check = mem_zalloc(1, sizeof *check);
    check->number = number;
    check->units = units;
    check->macs = macs;
    check->count = count;
    check->results = mem_zalloc(count, sizeof *check->results);
    batch_init(&check->batch, settings);
    checks->list[checks->count++] = check;
}

/* The first that is wanted. */
static unit_check_t *head(const checks_t *checks)
{
    for (size_t i = 0; i < checks->count; i++)
        if (!checks->list[i]->dropped) return checks->list[i];
    return NULL;
}

unit_check_t *checks_next(const checks_t *checks)
{
    unit_check_t *check = head(checks);
    return check != NULL && check->begun < check->count ? check : NULL;
}

void checks_finish(checks_t *checks, unit_check_t *check, size_t unit, unit_result_t *result)
{
    check->rendering--;
    if (result != NULL) {
        batch_take_beside(&check->batch, result); /* megabytes, which tiles wait without */
        check->results[unit] = *result;
        *result = (unit_result_t){0};
        check->done++;
    } else {
        check->dropped = true;
    }
    checks_sweep(checks);
}

void checks_close(unit_check_t *check)
{
    for (size_t i = 0; i < check->count; i++) {
        batch_add(&check->batch, &check->results[i]);
        unit_result_free(&check->results[i]);
    }
    check->under_way = true;
}

uint64_t checks_bytes(const unit_check_t *check, const job_settings_t *settings)
{
    uint64_t tiles = 0;
    for (size_t i = 0; i < check->count; i++) tiles += sum_unit_bytes(settings, &check->units[i]);
    return tiles + (check->batch.sums[SUM_SPLAT].count > 0 ? sum_frame_bytes(settings) : 0);
}

unit_check_t *checks_complete(const checks_t *checks)
{
    unit_check_t *check = head(checks);
    return check != NULL && check->done == check->count && !check->under_way ? check : NULL;
}

unit_check_t *checks_find(const checks_t *checks, uint64_t number)
{
    for (size_t i = 0; i < checks->count; i++) {
        unit_check_t *check = checks->list[i];
        if (check->number == number && check->done == check->count && !check->dropped) return check;
    }
    return NULL;
}

size_t checks_units(const checks_t *checks)
{
    size_t units = 0;
    for (size_t i = 0; i < checks->count; i++)
        if (!checks->list[i]->dropped) units += checks->list[i]->count;
    return units;
}

uint64_t checks_samples_left(const checks_t *checks, const job_settings_t *settings)
{
    uint64_t samples = 0;
    for (size_t i = 0; i < checks->count; i++) {
        const unit_check_t *check = checks->list[i];
        for (size_t u = check->begun; u < check->count && !check->dropped; u++)
            samples += unit_samples(settings, &check->units[u]);
    }
    return samples;
}

void checks_drop(checks_t *checks, bool all)
{
    for (size_t i = 0; i < checks->count; i++)
        if (all || checks->list[i]->begun < checks->list[i]->count) checks->list[i]->dropped = true;
    checks_sweep(checks);
}

void checks_sweep(checks_t *checks)
{
    size_t kept = 0;
    for (size_t i = 0; i < checks->count; i++) {
        unit_check_t *check = checks->list[i];
        if (check->dropped && check->rendering == 0 && !check->under_way)
            check_free(check);
        else
            checks->list[kept++] = check;
    }
    checks->count = kept;
    if (kept > 0) return;
    free(checks->list);
    *checks = (checks_t){0};
}
