/* film: exact sums of an image, and the batch, the portion of such sums that one message carries.
 *
 * Sums are 64-bit fixed-point integers in units of 2^-scale radiance. Every contribution is rounded to that
 * grid once, when the sample is made, and integers add associatively: samples may be split into units, units
 * into batches, and batches merged in any order, always with the same bits. With the default scale of 32 a
 * contribution is rounded by at most 2^-33: below the rounding of a float result for pixels over 2^-9, and
 * after the mean of N samples below it by a further sqrt(N). A sum may reach 2^31 radiance units; a film for
 * a brighter scene takes a smaller scale. Overflow is detected (counts.overflows) and the job is ended by it;
 * a sum never wraps.
 *
 * Two estimators, two normalisations: eye sums divide by their own pixel's samples, splat sums by the light
 * paths traced for the whole film. Both come in two halves (even and odd sample indices) that are independent
 * estimates of the same image; their difference gives the noise, splats included.
 *
 * Features are what the eye rays meet first: albedo, normal, position and so on, for denoising and
 * compositing. They are sums of the same kind, of the first FEATURE_SAMPLES samples of each pixel: enough for
 * smooth edges, and a bound on what is sent. They have one half only, and a scale of their own, since they do
 * not depend on how bright a scene is.
 */
#ifndef LIGHTMILL_FILM_H
#define LIGHTMILL_FILM_H

#include "common/job.h"

enum {
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
    uint32_t pixel; /* y * width + x, with the half (0 or 1) in the top bit */
    float rgb[3];
} splat_t;
#define SPLAT_HALF_BIT 0x80000000u

/* Radiance to fixed point, rounded to nearest even. A value that does not fit is saturated at +-2^62 and
 * shows as an overflow when it is added. The caller has dropped NaN and infinity. */
int64_t film_quantise(float value, int scale);
/* Rounds one contribution to the film's grid and adds it to the sums of a pixel. Returns how many of the
 * three additions would have overflowed; these are left out. */
uint64_t film_add(int64_t sum[3], const float rgb[3], int scale);

/* Adds `count` sums, each `factor` times: a weight of 1 to JOB_MAX_BOOST, negative to take out what was
 * added. The arrays do not overlap. Returns how many additions would have overflowed; these are left out. */
uint64_t film_add_sums(int64_t *sum, const int64_t *more, size_t count, int factor);

/* The result of one unit, in memory that is reused from unit to unit. */
typedef struct {
    unit_t unit;
    int64_t *eye;        /* [2 halves][tile height][tile width][3], fixed point */
    size_t eye_capacity; /* int64_t's allocated */
    int64_t *features;   /* [tile height][tile width][FEATURE_VALUES] when has_features */
    size_t feature_capacity;
    bool has_features;
    splat_t *splats; /* in the order they were made */
    size_t splat_count, splat_capacity;
    film_counts_t counts;
} unit_result_t;

/* Makes an empty result for a unit: zeroed eye sums and, where the unit has them, features; no splats. */
void unit_result_reset(unit_result_t *result, const job_settings_t *settings, const unit_t *unit);
void unit_result_free(unit_result_t *result);
/* Adds what one sample met to a pixel (y * tile width + x in the tile). Values beyond +-2^25 are clamped, so
 * that no sum can overflow; a sample with a NaN or an infinity is dropped whole and counted as such. Does
 * nothing beyond FEATURE_SAMPLES and in units without features. */
void unit_result_feature(unit_result_t *result, size_t pixel, uint32_t sample, const first_hit_t *hit);

/* Units closed together: their eye tiles and one splat frame that covers exactly those units.
 * Thread-safe only where said. */
typedef struct {
    job_settings_t settings;
    unit_t *units;
    size_t unit_count, unit_capacity;
    int64_t *eye; /* tiles one after the other in the order of `units`, each as in unit_result_t */
    size_t eye_count, eye_capacity;
    int64_t *features; /* of the units that have them, one after the other, each as in unit_result_t */
    size_t feature_count, feature_capacity;
    int64_t *splat; /* [2 halves][height][width][3]; NULL as long as no unit had a splat */
    film_counts_t counts;
} batch_t;

/* An empty batch for a job with these (checked) settings. */
void batch_init(batch_t *batch, const job_settings_t *settings);
/* Empties the batch and keeps its memory. */
void batch_clear(batch_t *batch);
void batch_free(batch_t *batch);
/* Adds a finished unit. */
void batch_add(batch_t *batch, const unit_result_t *result);
/* Adds a batch of the same job to a sum of batches: tiles and features one after the other, splat frames
 * added. An addition that would overflow is left out and counted, as in a film. */
void batch_merge(batch_t *sum, const batch_t *more);
/* RESULT_PROTOCOL when a batch claims counts that its units, which are valid, cannot have. */
result_t batch_check_counts(const batch_t *batch);
/* RESULT_LIMIT when its tiles and features, unfolded, would be more than so many bytes. */
result_t batch_check_size(const batch_t *batch, uint64_t limit);
/* Bytes of all its sums. */
size_t batch_bytes(const batch_t *batch);
/* int64_t's that the eye tile of a unit takes: 2 * pixels * 3. */
size_t batch_tile_values(const job_settings_t *settings, uint32_t tile);
/* int64_t's that the features of a unit take: 0 when the job has none, or the unit's samples begin at
 * FEATURE_SAMPLES or later. */
size_t batch_feature_values(const job_settings_t *settings, const unit_t *unit);
/* int64_t's of a splat frame: 2 * width * height * 3. */
size_t batch_splat_values(const job_settings_t *settings);
/* False when no renderer makes such features of a unit that has some: a sample adds less than 2^57 to any
 * value. So the sums of those that are possible cannot overflow. */
bool unit_features_possible(const unit_t *unit, const int64_t *values, size_t count);
/* BLAKE2b-256 of the units, the numbers of light paths, and all sums: renderings of the same units have the
 * same digest when all their bits agree, whatever the order of the units, and whether sums that are all zero
 * are there or missing. */
void batch_digest(const batch_t *batch, hash_t *hash);

/* The sums of a whole job. Not thread-safe: the owner locks. */
typedef struct {
    job_settings_t settings;
    int64_t *eye;      /* [2 halves][height][width][3] */
    int64_t *splat;    /* [2 halves][height][width][3] */
    uint32_t *samples; /* [2 halves][height][width] eye samples, each as often as it weighs: in an adaptive
                          job JOB_MEAN_BOOST times the mean number of samples */
    int64_t *features; /* [height][width][FEATURE_VALUES]; NULL when the job has none */
    film_counts_t counts;
} film_t;

/* Allocates the zeroed sums; settings must have passed job_settings_check. RESULT_LIMIT when memory lacks. */
result_t film_new(const job_settings_t *settings, film_t **film);
/* Frees the film and sets *film to NULL. */
void film_destroy(film_t **film);
/* Adds a batch whose units are valid for this job. The caller sees to it that no unit is counted twice.
 * Overflowing additions are left out and counted; of features, whose true sums cannot overflow, only left
 * out. */
void film_merge(film_t *film, const batch_t *batch);
/* The same where the samples of unit i count weights[i] times, 1 to JOB_MAX_BOOST (NULL: all once). Splats
 * and features do not: splats are divided by all light paths, wherever they began. With `sign` -1 it is taken
 * out again. */
void film_merge_weighted(film_t *film, const batch_t *batch, const uint32_t *weights, int sign);

/* Float images of the sums so far, each [height][width][3] unless said otherwise. */
typedef struct {
    int width, height;
    float *sum;   /* eye + light: the picture */
    float *eye;   /* strategies with t >= 2 eye vertices */
    float *light; /* t = 1 splats */
    float *noise; /* estimated standard error of `sum`: |half 0 - half 1| scaled; one degree of freedom a
                     pixel */
    float *
        samples; /* [height][width] eye samples; of an adaptive job their mean over the image where all rounds
                    are counted (film_t.samples) until schedule_show_samples has written the real numbers */
    double error; /* film_noise of the whole image */

    /* Features; all NULL when there are none. The last five are [height][width]. */
    float *albedo;   /* mean over the samples; what met nothing counts as 0 */
    float *normal;   /* likewise; not normalised, shorter where surfaces meet or end */
    float *position; /* mean over the samples that met something; 0 where none did */
    float *depth;    /* likewise */
    float *object;   /* id of what sample 0 met; 0: nothing */
    float *material; /* likewise */
    float *coverage; /* share of the samples that met something */
} film_image_t;

/* Resolves the sums: eye / own samples + splat * pixels / light paths, and the features. Pixels without
 * samples are black. */
void film_resolve(const film_t *film, film_image_t *image);
void film_image_free(film_image_t *image);

/* Estimates the relative error of the image, splats included: the square root of the mean, over the pixels
 * that have samples and their channels, of
 *
 *     noise^2 / (value^2 + (FILM_ERROR_FLOOR * mean)^2)
 *
 * with the noise that the two halves of the pixel show, its value, and the mean of all values. So it is the
 * root of a relMSE, as client/agreement.h measures it against a reference, whose floor follows the brightness
 * of the scene. INFINITY when nothing is known: the image is black. docs/convergence.md says what to make of
 * it.
 *
 * `eye_noise`, unless NULL, gets for each tile the sum of the same terms with the noise of the eye sums
 * alone: what more samples of that tile can reduce. */
double film_noise(const film_t *film, double *eye_noise);
#define FILM_ERROR_FLOOR 0.5

#endif
