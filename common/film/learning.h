/* learning: a job that learns goes in passes, and each is rendered by a plan that earlier ones made.
 *
 *     pass        0     1     2     3      4   ...  LEARNING_PASSES - 1
 *     samples    0-1   2-3   4-7  8-15  16-31  ...  all the rest
 *     plan from   -     -     0    0-1   0-2   ...
 *
 * Renderers note numbers beside the picture, the lessons, in places that they agree on among themselves:
 * integers, which add up exactly like the sums of a film. A plan is nothing but the sum of the lessons of
 * some passes, whole, and so has the same bits whatever the farm did meanwhile. What it means is the
 * renderer's business.
 *
 * The plan of a pass needs all but the pass right before it. So nobody waits: that pass is rendered while
 * the last results of those before it are on their way. A plan depends on no sample that it is used for, so
 * each sample is right on average whatever was learned; and a pass weighs by its samples, not by how good it
 * turned out to be, so their mean is, too (docs/learning.md).
 */
#ifndef LIGHTMILL_LEARNING_H
#define LIGHTMILL_LEARNING_H

#include "common/job.h"

enum {
    /* Few: on a large farm each takes as long as its batches take to be merged, however short it is. And what
     * is learned is known well enough then: later lessons made the picture better by 1 % or less. */
    LEARNING_PASSES = 7,
    /* An adaptive job gives tiles different numbers of samples from its second round on, so that the passes
     * of higher numbers would not be complete. */
    LEARNING_ADAPTIVE_PASSES = 5,
    LEARNING_PLACES = 131072, /* lessons of a pass */
    /* A sample adds less than 2^LEARNING_BITS to any place, and nothing that is negative. The passes that
     * make plans have at most 2^LEARNING_TAUGHT_BITS samples a pixel together, so whatever the image, no sum
     * can overflow: of a pass, or of a plan. */
    LEARNING_BITS = 26,
    LEARNING_TAUGHT_BITS = LEARNING_PASSES - 2
};
_Static_assert(LEARNING_BITS + LEARNING_TAUGHT_BITS + 27 <= 62 && JOB_MAX_PIXELS == 1 << 27,
               "lessons overflow");

/* True when the job learns: it is to, and its integrator can. */
bool job_learns(const job_settings_t *settings);
/* Passes of a job that learns, and the pass that a sample is of. */
uint32_t learning_passes(const job_settings_t *settings);
uint32_t learning_pass(const job_settings_t *settings, uint32_t sample);
/* The first sample of a pass; of pass learning_passes: UINT32_MAX. */
uint32_t learning_pass_begin(const job_settings_t *settings, uint32_t pass);
/* How many passes, from 0 on, make the plan of a pass; 0: it has none. */
uint32_t learning_teachers(uint32_t pass);
/* True when units of a sample's pass can be rendered by those who have the plans of these passes (a bit each,
 * from the lowest on). */
bool learning_ready(const job_settings_t *settings, uint32_t sample, uint32_t plans);
/* Passes whose lessons go into a plan: those of the others need not be noted. */
uint32_t learning_taught(const job_settings_t *settings);

/* A plan: the lessons of passes 0 ... teachers - 1, added up. */
typedef struct {
    uint32_t pass;
    uint32_t teachers;
    const int64_t *lessons; /* [LEARNING_PLACES]; not the plan's own */
} learning_plan_t;

/* Bytes of a plan as a blob, whatever its pass. */
size_t learning_plan_bytes(void);
/* Writes `length` bytes from `offset` on, which lie in it, of the plan of a pass that has one, as a blob.
 * `lessons` are those of the passes that make it, [learning_teachers(pass)][LEARNING_PLACES]; `content` is
 * that of the job (job_content_hash). */
void learning_plan_write(uint32_t pass, const int64_t *lessons, const hash_t *content, uint64_t offset,
                         uint8_t *bytes, size_t length);
/* The plan in a blob, which it points into (at an address that int64_t may have). RESULT_INPUT, naming what
 * is wrong, when it is none, or one of another job. */
result_t learning_plan_read(const uint8_t *bytes, size_t size, const hash_t *content, learning_plan_t *plan);

#endif
