/* schedule_passes: how far the passes of a job that learns are open, and what is counted of each (schedule.h,
 * "passes"). A job that does not learn has one pass, without end. */
#include "master/schedule/schedule_state.h"

uint32_t schedule_pass_of(const schedule_t *s, uint32_t sample)
{
    return job_learns(&s->settings) ? learning_pass(&s->settings, sample) : 0;
}

uint32_t schedule_pass_end(const schedule_t *s, uint32_t pass)
{
    return job_learns(&s->settings) ? learning_pass_begin(&s->settings, pass + 1) : UINT32_MAX;
}

uint32_t schedule_open_end(const schedule_t *s)
{
    return schedule_pass_end(s, s->open_passes - 1);
}

void schedule_passes_init(schedule_t *s, uint32_t settled)
{
    uint32_t untaught = 0;
    while (learning_teachers(untaught) == 0) untaught++;
    s->settled_passes = settled;
    s->open_passes = job_learns(&s->settings) ? untaught + settled : 1;
}

void schedule_pass_add(const schedule_t *s, uint64_t samples[LEARNING_PASSES], uint32_t tile, uint32_t first,
                       uint32_t end, int sign)
{
    while (first < end) {
        uint32_t pass = schedule_pass_of(s, first), pass_end = schedule_pass_end(s, pass);
        uint32_t to = pass_end < end ? pass_end : end;
        uint64_t more = (uint64_t)(to - first) * job_tile_pixels(&s->settings, tile);
        samples[pass] = sign < 0 ? samples[pass] - more : samples[pass] + more;
        first = to;
    }
}

bool schedule_in_open_pass(const schedule_t *s, const unit_t *unit)
{
    uint32_t pass = schedule_pass_of(s, unit->first);
    return pass < s->open_passes && unit->count <= schedule_pass_end(s, pass) - unit->first;
}

uint32_t schedule_next_pass(const schedule_t *s)
{
    uint32_t next = s->open_passes;
    if (!job_learns(&s->settings) || next == learning_passes(&s->settings) || s->allowed[next] == 0) return 0;
    for (uint32_t pass = 0; pass < learning_teachers(next); pass++)
        if (s->settled[pass] != s->allowed[pass]) return 0;
    return next;
}

void schedule_teach(schedule_t *s)
{
    s->settled_passes = learning_teachers(s->open_passes);
}

void schedule_open_pass(schedule_t *s)
{
    s->open_passes++;
    for (uint32_t t = 0; t < s->tile_count; t++) schedule_tile_refresh(s, t);
}

uint32_t schedule_open_passes(const schedule_t *s)
{
    return s->open_passes;
}
