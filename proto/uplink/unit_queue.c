/* unit_queue: see unit_queue.h. */
#include "proto/uplink/unit_queue.h"

#include <stdlib.h>
#include <string.h>

size_t unit_queue_length(const unit_queue_t *queue)
{
    return queue->end - queue->first;
}

static void append(unit_queue_t *queue, const job_settings_t *settings, unit_t unit)
{
    if (queue->end == queue->capacity && queue->first > 0) {
        memmove(queue->units, queue->units + queue->first, unit_queue_length(queue) * sizeof *queue->units);
        queue->end -= queue->first;
        queue->first = 0;
    }
    if (queue->end == queue->capacity) {
        queue->capacity = 2 * queue->capacity + 64;
        queue->units = mem_realloc(queue->units, queue->capacity * sizeof *queue->units);
    }
    queue->units[queue->end++] = unit;
    queue->samples += unit_samples(settings, &unit);
}

void unit_queue_push(unit_queue_t *queue, const job_settings_t *settings, unit_t unit, const unit_t *held,
                     size_t held_count)
{
    uint32_t end = unit_end(&unit);
    for (size_t i = 0; i < held_count; i++) {
        uint32_t held_end = unit_end(&held[i]);
        if (held[i].tile != unit.tile || held[i].first >= end || held_end <= unit.first) continue;
        /* What lies before and behind it may meet others of those that follow. */
        if (held[i].first > unit.first)
            unit_queue_push(queue, settings, (unit_t){unit.tile, unit.first, held[i].first - unit.first},
                            held + i + 1, held_count - i - 1);
        if (held_end >= end) return;
        unit = (unit_t){unit.tile, held_end, end - held_end};
    }
    append(queue, settings, unit);
}

bool unit_queue_pop(unit_queue_t *queue, const job_settings_t *settings, uint32_t plans, unit_t *unit)
{
    size_t at = queue->first;
    while (at < queue->end && !learning_ready(settings, queue->units[at].first, plans)) at++;
    if (at == queue->end) return false;
    *unit = queue->units[at];
    memmove(queue->units + queue->first + 1, queue->units + queue->first,
            (at - queue->first) * sizeof *queue->units);
    queue->first++;
    queue->samples -= unit_samples(settings, unit);
    return true;
}

uint32_t unit_queue_lacks(const unit_queue_t *queue, const job_settings_t *settings, uint32_t plans)
{
    for (size_t i = queue->first; i < queue->end; i++)
        if (!learning_ready(settings, queue->units[i].first, plans))
            return learning_pass(settings, queue->units[i].first);
    return LEARNING_PASSES;
}

void unit_queue_clear(unit_queue_t *queue)
{
    queue->first = queue->end = 0;
    queue->samples = 0;
}

void unit_queue_free(unit_queue_t *queue)
{
    free(queue->units);
    *queue = (unit_queue_t){0};
}
