/* unit_queue: the units that a worker has been given and not begun, in order. */
#ifndef LIGHTMILL_UNIT_QUEUE_H
#define LIGHTMILL_UNIT_QUEUE_H

#include "common/film/learning.h"

/* Zeroed to begin with. */
typedef struct {
    unit_t *units;
    size_t first, end, capacity;
    uint64_t samples; /* pixel samples queued */
} unit_queue_t;

size_t unit_queue_length(const unit_queue_t *queue);
/* Appends a unit without the samples that one of `held` has: in none, one or several pieces. */
void unit_queue_push(unit_queue_t *queue, const job_settings_t *settings, unit_t unit, const unit_t *held,
                     size_t held_count);
/* Takes the first unit that can be rendered with the plans of these passes (learning_ready); false when there
 * is none. */
bool unit_queue_pop(unit_queue_t *queue, const job_settings_t *settings, uint32_t plans, unit_t *unit);
/* The pass of the first unit that waits for its plan; LEARNING_PASSES: none does. */
uint32_t unit_queue_lacks(const unit_queue_t *queue, const job_settings_t *settings, uint32_t plans);
void unit_queue_clear(unit_queue_t *queue);
void unit_queue_free(unit_queue_t *queue);

#endif
