/* lessons: what samples teach later passes (common/film/learning.h): which number stands in which place, and
 * what a sample notes. What becomes of them is plan.c's business.
 *
 * All are about the picture in terms of how bright it is there, so that dark parts count as much as bright
 * ones; in units of 2^-LESSON_BITS, rays and excess in their own.
 */
#ifndef LIGHTMILL_LESSONS_H
#define LIGHTMILL_LESSONS_H

#include "worker/render/integrator/integrator.h"

enum {
    LESSON_BITS = 14,
    LESSON_RAY_BITS = 4,
    LESSON_EXCESS_BITS = 10,
    LESSON_BLOCKS_SIDE = 64, /* the film is cut into so many squared blocks */
    LESSON_MOST_MASK = 255   /* of setup_t.teaching_mask */
};
#define LESSON_NOBODY UINT32_MAX
/* The most that a contribution counts as. */
static const float LESSON_MOST = 4;

/* Places. */
enum {
    LESSON_OWN_SQUARES, /* of what samples have without light subpaths */
    LESSON_OWN_RAYS,    /* that this took */
    LESSON_EXCESS,      /* of squares of what is beyond LESSON_MOST */
    LESSON_OWN,         /* [block] sums of what is squared above */
    LESSON_LIGHTS =
        LESSON_OWN + LESSON_BLOCKS_SIDE * LESSON_BLOCKS_SIDE /* the rest: light_guide.h, and caustics.h */
};

/* What decides whether a pixel teaches: its lowest bits are 0 for evenly spread pixels. */
static inline uint32_t lesson_turn(uint32_t x, uint32_t y)
{
    return x + 5 * y;
}

/* True when the sample teaches. */
static inline bool lesson_due(const sample_t *sample)
{
    uint32_t mask = sample->setup->teaching_mask;
    return mask != LESSON_NOBODY && (lesson_turn(sample->pixel_x, sample->pixel_y) & mask) == 0;
}

/* The block of a pixel. */
static inline uint32_t lesson_block(const job_settings_t *settings, uint32_t x, uint32_t y)
{
    uint32_t row = y * LESSON_BLOCKS_SIDE / (uint32_t)settings->height;
    return row * LESSON_BLOCKS_SIDE + x * LESSON_BLOCKS_SIDE / (uint32_t)settings->width;
}

/* So many small contributions a sample may add to one place, beside a large one; */
enum { LESSON_PART_BITS = LEARNING_BITS - 14, LESSON_PARTS_MOST = 1 << 13 };
/* or so many lights that its eye subpath ran into. */
enum { LESSON_HIT_BITS = LEARNING_BITS - 4, LESSON_HITS_MOST = 8 };

/* Adds to a place so many units of 2^-bits, less than 2^bound, rounded by u: 0.5, or by chance. */
static inline void lesson_add(const sample_t *sample, uint32_t place, float lesson, int bits, int bound,
                              float u)
{
    const float most = (float)((1 << bound) - 1);
    float units = lesson * (float)(1 << bits);
    unit_result_teach(sample->result, place, (uint64_t)((units < most ? units : most) + u));
}

/* Adds to a place, in units of 2^-bits. One contribution that is far brighter than the rest says little, so
 * that what it says is bounded. */
static inline void lesson_note(const sample_t *sample, uint32_t place, float lesson, int bits)
{
    lesson_add(sample, place, lesson, bits, LEARNING_BITS - 1, 0.5f);
}

/* The same for one of up to LESSON_HITS_MOST lights. */
static inline void lesson_note_hit(const sample_t *sample, uint32_t place, float lesson, int bits)
{
    lesson_add(sample, place, lesson, bits, LESSON_HIT_BITS, 0.5f);
}

/* The same for one of up to LESSON_PARTS_MOST small ones. They are rounded by chance; u is a uniform number.
 */
static inline void lesson_note_part(const sample_t *sample, uint32_t place, float lesson, int bits, float u)
{
    lesson_add(sample, place, lesson, bits, LESSON_PART_BITS, u);
}

#endif
