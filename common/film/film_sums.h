/* film_sums: the sums that a film and a batch are made of: which there are, how each is laid out, and how
 * they add up. The table film_sums describes each of them; payloads, pages and checkpoints walk over it and
 * name none.
 *
 * Sums are 64-bit fixed-point integers in units of 2^-scale radiance. Every contribution is rounded to that
 * grid once, when the sample is made, and integers add associatively: samples may be split into units, units
 * into batches, and batches merged in any order, always with the same bits. With the default scale of 32 a
 * contribution is rounded by at most 2^-33: below the rounding of a float result for pixels over 2^-9, and
 * after the mean of N samples below it by a further sqrt(N). A sum may reach 2^31 radiance units; a film for
 * a brighter scene takes a smaller scale. Overflow is detected (film_counts_t.overflows) and the job is ended
 * by it; a sum never wraps.
 *
 * Features are what the eye rays meet first: albedo, normal, position and so on, for denoising and
 * compositing. They are sums of the same kind, of the first FEATURE_SAMPLES samples of each pixel: enough for
 * smooth edges, and a bound on what is sent. They have one half only, and a scale of their own, since they do
 * not depend on how bright a scene is.
 *
 * Mattes are what the same samples met, one by one: a slot for each sample holds a code of the shape, so that
 * adding, which only ever adds to an empty slot, merges them exactly. Who resolves the film counts them.
 *
 * Lessons are what renderers note for those who render later samples (learning.h). They belong to no pixel.
 */
#ifndef LIGHTMILL_FILM_SUMS_H
#define LIGHTMILL_FILM_SUMS_H

#include "common/job.h"

#include <math.h>

/* Which sums there are. */
typedef enum {
    SUM_EYE,                  /* radiance of the strategies with t >= 2 eye vertices, by pixel */
    SUM_SPLAT,                /* radiance of those with t = 1, which may land anywhere */
    SUM_FEATURES,             /* what the eye rays meet first: FEATURE_ALBEDO and so on */
    SUM_MATTES,               /* which shape each eye ray meets first: MATTE_SAMPLES and so on */
    SUM_GROUP_EYE,            /* what of SUM_EYE comes from each group of lights (common/light_groups.h), */
    SUM_GROUP_SPLAT,          /* and what of SUM_SPLAT */
    SUM_LESSONS,              /* what a job learns: LEARNING_PLACES values for each pass that teaches */
    BATCH_SUMS,               /* those above travel in a batch, a payload each in this order */
    SUM_SAMPLES = BATCH_SUMS, /* a film has these beside: eye samples, each as often as it weighs */
    FILM_SUMS
} sum_kind_t;

enum {
    SUM_MAX_GROUPS = 6,
    SUM_GROUP_VALUES = 3, /* values of a group, at most; the frame of an image has one group of so many */
    FEATURE_SAMPLES = 32, /* samples of a pixel, from index 0, that contribute */
    FEATURE_SCALE = 32    /* measured values count in units of 2^-32 */
};

/* The sums of a pixel's features, an int64_t each. */
enum {
    FEATURE_ALBEDO = 0,   /* 3 */
    FEATURE_NORMAL = 3,   /* 3 */
    FEATURE_POSITION = 6, /* 3 */
    FEATURE_DEPTH = 9,
    FEATURE_COUNT = 10,  /* samples that are in the sums; whole numbers, here and below */
    FEATURE_HITS = 11,   /* those of them that met something */
    FEATURE_OBJECT = 12, /* of sample 0 alone, so that it is an id and not a mean of ids */
    FEATURE_MATERIAL = 13,
    FEATURE_VALUES = 14
};

/* The sums of a pixel's mattes: MATTE_SLOTS samples in each, that of the lower index in the lower bits. A
 * code is MATTE_FIRST_SHAPE + the index of a shape of the blob. */
enum {
    MATTE_SAMPLES = FEATURE_SAMPLES,
    MATTE_SLOTS = 2,
    MATTE_BITS = 28,
    MATTE_VALUES = MATTE_SAMPLES / MATTE_SLOTS,
    MATTE_NO_SAMPLE = 0, /* the sample is not in the film */
    MATTE_NOTHING = 1,   /* it met nothing, or a shape that has no code */
    MATTE_FIRST_SHAPE = 2,
    MATTE_MAX_CODE = (1 << MATTE_BITS) - 1
};

/* How one of them is laid out: [planes][height][width][values], of the image or of a tile. Planes are the two
 * halves of the samples, even and odd indices apart; or one for all samples; or one for each light group, or
 * each pass that teaches. */
typedef struct {
    const char *name; /* in messages */
    size_t bytes;     /* of a value */
    size_t values;    /* of a pixel in a plane */
    /* Values of a pixel that are of one kind; they are coded together. */
    size_t group_count;
    uint8_t groups[SUM_MAX_GROUPS];
    size_t places;    /* pixels in a plane of what is not shaped like an image; 0: those of the image */
    bool differences; /* neighbours are much alike: coded as differences from the pixel before */
    bool frame;       /* a batch has one frame of the whole, to which all units add, or none when it is
                         zero; otherwise a tile of each unit, one after the other */
    bool weighted;    /* a unit's tile counts as often as its samples weigh */
    /* How many planes a job has, 0 when it does not make them; NULL: two halves, in every job. */
    size_t (*planes)(const job_settings_t *settings);
    uint32_t samples; /* of a pixel, from index 0, that contribute; 0: all */
    int sample_bits;  /* one sample adds less than 2^sample_bits to any value; 0: there is no bound */
} sum_layout_t;
extern const sum_layout_t film_sums[FILM_SUMS];

/* The sums in the order in which the pages of a film, and so those of a checkpoint, are numbered. */
extern const sum_kind_t film_page_order[FILM_SUMS];

/* Planes in a job; 0 when it has none of this sum. */
size_t sum_planes(const job_settings_t *settings, sum_kind_t kind);
/* Values of the whole image, or of what else a sum is of; 0 when the job has none. */
size_t sum_image_values(const job_settings_t *settings, sum_kind_t kind);
/* Values of a unit's tile; 0 for frames, and when the job or the unit's samples have none. */
size_t sum_unit_values(const job_settings_t *settings, sum_kind_t kind, const unit_t *unit);
/* Bytes of all tiles of a unit. */
size_t sum_unit_bytes(const job_settings_t *settings, const unit_t *unit);
/* Bytes of all frames of a batch. */
size_t sum_frame_bytes(const job_settings_t *settings);
/* False when no renderer makes such values of a unit that has some. So sums that have a bound cannot
 * overflow. */
bool sum_possible(sum_kind_t kind, const unit_t *unit, const int64_t *values, size_t count);

/* An array of sums that grows; zeroed: empty. Its memory is made by the calls below alone: before the values
 * are SUM_HEADROOM bytes for who sends them as they are. */
typedef struct {
    int64_t *values;
    size_t count, capacity;
} sum_array_t;
enum { SUM_HEADROOM = 64 };

/* Makes room for so many values; those up to `count` stay. */
void sum_array_reserve(sum_array_t *array, size_t capacity);
/* Frees it and makes it one of so many zeroes. */
void sum_array_zeroes(sum_array_t *array, size_t count);
/* Frees it and makes room for so many values, a number that came from a peer. False when memory lacks. */
bool sum_array_try(sum_array_t *array, size_t capacity);
/* Frees it and makes it empty. */
void sum_array_free(sum_array_t *array);
/* Frees the values of an array that were taken out of it. */
void sum_values_free(int64_t *values);

/* Radiance to fixed point, rounded to nearest even. A value that does not fit is saturated at +-2^62 and
 * shows as an overflow when it is added. The caller has dropped NaN and infinity. */
static inline int64_t film_quantise(float value, int scale)
{
    const double limit = 0x1p62;
    double units = (double)value * (double)(UINT64_C(1) << scale);
    return units >= limit ? INT64_C(1) << 62 : units <= -limit ? -(INT64_C(1) << 62) : llrint(units);
}
/* Rounds one contribution to the film's grid and adds it to the sums of a pixel. Returns how many of the
 * three additions would have overflowed; these are left out. */
static inline uint64_t film_add(int64_t sum[3], const float rgb[3], int scale)
{
    const int64_t largest = (INT64_C(1) << 62) - 1;
    uint64_t overflows = 0;
    for (int c = 0; c < 3; c++) {
        int64_t more = film_quantise(rgb[c], scale), total = (int64_t)((uint64_t)sum[c] + (uint64_t)more);
        if ((more > largest) | (more < -largest) | (total > largest) | (total < -largest))
            overflows++;
        else
            sum[c] = total;
    }
    return overflows;
}
/* Adds `count` sums. The arrays do not overlap. Returns how many additions would have overflowed; these are
 * left out. */
uint64_t film_add_sums(int64_t *sum, const int64_t *more, size_t count);

#endif
