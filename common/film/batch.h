/* batch: what a renderer makes: the result of a unit, and the batch, the portion of sums that one message
 * carries. film_sums.h says which sums there are and what they look like.
 */
#ifndef LIGHTMILL_BATCH_H
#define LIGHTMILL_BATCH_H

#include "common/film/film_sums.h"
#include "common/film/learning.h"

/* What the eye ray of one sample met first. */
typedef struct {
    bool hit;
    float albedo[3];           /* part of the light that is reflected, 0 to 1 */
    float normal[3];           /* shading normal on the side that is seen, world space */
    float position[3];         /* world space */
    float depth;               /* distance from the camera along the ray */
    uint32_t object, material; /* ids from 1 */
} first_hit_t;

/* What happened while samples were made; adds up like the sums. */
typedef struct {
    uint64_t light_paths[2]; /* light subpaths traced, by half; the divisor of splats. 0 for `path` */
    uint64_t dropped;        /* contributions that were NaN or infinite, and left out */
    uint64_t overflows;      /* additions that would have wrapped, and were left out: the job must fail */
    uint64_t rays;           /* rays traced */
    uint64_t cpu_us;         /* CPU microseconds spent rendering; not part of what must be reproducible */
} film_counts_t;

void film_counts_add(film_counts_t *sum, const film_counts_t *more);
/* Takes out what was added. */
void film_counts_take_out(film_counts_t *sum, const film_counts_t *less);

/* The most that any one count of a batch may be, but light paths, which its samples bound. */
#define BATCH_MAX_COUNT ((uint64_t)1 << 48)

/* One splat, kept by a unit until it is complete. */
typedef struct {
    uint32_t
        pixel; /* y * width + x in the lower bits, the light group above, the half (0 or 1) in the top bit */
    float rgb[3];
} splat_t;
#define SPLAT_HALF_BIT 0x80000000u
enum { SPLAT_GROUP_SHIFT = 27, SPLAT_PIXEL_MASK = (1 << SPLAT_GROUP_SHIFT) - 1 };
_Static_assert(JOB_MAX_PIXELS - 1 <= SPLAT_PIXEL_MASK, "a splat has too few bits for its pixel");
_Static_assert(LIGHT_GROUPS_MAX <= 1 << (31 - SPLAT_GROUP_SHIFT), "or for its light group");
/* The light group of a splat; 0 in jobs without groups. */
static inline size_t splat_group(const splat_t *splat)
{
    return (splat->pixel & ~SPLAT_HALF_BIT) >> SPLAT_GROUP_SHIFT;
}

/* A unit teaches few places: which of so many groups of them it did is noted, so that others cost nothing. */
enum { LESSON_GROUP = 64, LESSON_GROUPS = LEARNING_PLACES / LESSON_GROUP };

/* The result of one unit, in memory that is reused from unit to unit. */
typedef struct {
    unit_t unit;
    sum_array_t sums[BATCH_SUMS]; /* the unit's tile of each; none of what it does not have */
    splat_t *splats;              /* in the order they were made */
    size_t splat_count, splat_capacity;
    uint64_t *lessons;             /* [LEARNING_PLACES] (learning.h); NULL in a job that does not learn */
    uint8_t taught[LESSON_GROUPS]; /* 1 where a lesson of the group may not be 0 */
    film_counts_t counts;
} unit_result_t;

/* Makes an empty result for a unit: zeroed tiles of the sums that it has; no splats. */
void unit_result_reset(unit_result_t *result, const job_settings_t *settings, const unit_t *unit);
void unit_result_free(unit_result_t *result);
/* Adds to a lesson, of a job that learns. */
static inline void unit_result_teach(unit_result_t *result, uint32_t place, uint64_t value)
{
    result->lessons[place] += value;
    result->taught[place / LESSON_GROUP] = 1;
}
/* Adds what one sample met to a pixel (y * tile width + x in the tile), to its features and its mattes.
 * Values beyond +-2^25 are clamped, so that no sum can overflow; a sample with a NaN or an infinity is
 * dropped whole from the features and counted as such. Does nothing beyond FEATURE_SAMPLES, and in units
 * without features and mattes. Once for each sample. */
void unit_result_feature(unit_result_t *result, size_t pixel, uint32_t sample, const first_hit_t *hit);

/* Units closed together, and the sums of exactly those units. */
typedef struct {
    job_settings_t settings;
    unit_t *units;
    size_t unit_count, unit_capacity;
    sum_array_t sums[BATCH_SUMS]; /* the tiles of the units that have some, one after the other in the order
                                     of `units`; of frames the whole image, or nothing as long as no unit
                                     added to it */
    film_counts_t counts;
} batch_t;

/* An empty batch for a job with these (checked) settings. */
void batch_init(batch_t *batch, const job_settings_t *settings);
/* Empties the batch and keeps its memory. */
void batch_clear(batch_t *batch);
void batch_free(batch_t *batch);
/* Adds a finished unit, which in a job that learns lies within one pass. */
void batch_add(batch_t *batch, const unit_result_t *result);
/* Adds the splats and the lessons of a finished unit alone and frees their memory: a result that waits for
 * batch_add is smaller without. They are sums of integers, so their order is of no account. */
void batch_take_beside(batch_t *batch, unit_result_t *result);
/* Adds a batch of the same job to a sum of batches: tiles one after the other, frames added. An addition that
 * would overflow is left out and counted, as in a film. */
void batch_merge(batch_t *sum, const batch_t *more);
/* Makes the frame of a sum, of zeroes, where the batch has none yet; returns its values. */
int64_t *batch_frame(batch_t *batch, sum_kind_t kind);
/* RESULT_PROTOCOL when a batch claims counts that its units, which are valid, cannot have: light paths, which
 * splats are divided by, are one a sample, or none in a job without splats. */
result_t batch_check_counts(const batch_t *batch);
/* What lessons a batch can have, by pass: 0, or more but less than its limit. So who knows that units count
 * once knows that lessons do not overflow. */
typedef struct {
    uint64_t limit[LEARNING_PASSES];
} lesson_limits_t;
lesson_limits_t batch_lesson_limits(const batch_t *batch);
/* Whether a batch can have such a value at an index of SUM_LESSONS. */
static inline bool lesson_possible(const lesson_limits_t *limits, size_t index, int64_t value)
{
    return value == 0 || (value > 0 && (uint64_t)value < limits->limit[index / LEARNING_PLACES]);
}
/* RESULT_PROTOCOL when it has sums that no renderer makes of its units (sum_possible, lesson_possible). */
result_t batch_check_sums(const batch_t *batch);
/* RESULT_LIMIT when its tiles, unfolded, would be more than so many bytes. */
result_t batch_check_size(const batch_t *batch, uint64_t limit);
/* Values that its units make of it: of all tiles, or of the whole image. */
size_t batch_expected_values(const batch_t *batch, sum_kind_t kind);
/* Values of its tiles. */
size_t batch_tile_values(const batch_t *batch);
/* Bytes of all its sums. */
size_t batch_bytes(const batch_t *batch);
/* BLAKE2b-256 of the units, the numbers of light paths, and all sums: renderings of the same units have the
 * same digest when all their bits agree, whatever the order of the units, and whether sums that are all zero
 * are there or missing. */
void batch_digest(const batch_t *batch, hash_t *hash);

#endif
