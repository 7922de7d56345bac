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
 */
#ifndef LIGHTMILL_FILM_H
#define LIGHTMILL_FILM_H

#include "common/job.h"

enum { FILM_DEFAULT_SCALE = 32, FILM_MIN_SCALE = 0, FILM_MAX_SCALE = 40 };

/* What happened while samples were made; adds up like the sums. */
typedef struct {
    uint64_t light_paths[2]; /* light subpaths traced, by half; the divisor of splats. 0 for `path` */
    uint64_t dropped;        /* contributions that were NaN or infinite, and left out */
    uint64_t overflows;      /* additions that would have wrapped, and were left out: the job must fail */
    uint64_t rays;           /* rays traced */
    uint64_t cpu_us;         /* CPU microseconds spent rendering; not part of what must be reproducible */
} film_counts_t;

void film_counts_add(film_counts_t *sum, const film_counts_t *more);

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

/* The result of one unit, in memory that is reused from unit to unit. */
typedef struct {
    unit_t unit;
    int64_t *eye;        /* [2 halves][tile height][tile width][3], fixed point */
    size_t eye_capacity; /* int64_t's allocated */
    splat_t *splats;     /* in the order they were made */
    size_t splat_count, splat_capacity;
    film_counts_t counts;
} unit_result_t;

/* Makes an empty result for a unit: zeroed eye sums, no splats. */
void unit_result_reset(unit_result_t *result, const job_settings_t *settings, const unit_t *unit);
void unit_result_free(unit_result_t *result);

/* Units closed together: their eye tiles and one splat frame that covers exactly those units.
 * Thread-safe only where said. */
typedef struct {
    job_settings_t settings;
    unit_t *units;
    size_t unit_count, unit_capacity;
    int64_t *eye; /* tiles one after the other in the order of `units`, each as in unit_result_t */
    size_t eye_count, eye_capacity;
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
/* int64_t's that the eye tile of a unit takes: 2 * pixels * 3. */
size_t batch_tile_values(const job_settings_t *settings, uint32_t tile);
/* int64_t's of a splat frame: 2 * width * height * 3. */
size_t batch_splat_values(const job_settings_t *settings);

/* The sums of a whole job. Not thread-safe: the owner locks. */
typedef struct {
    job_settings_t settings;
    int64_t *eye;      /* [2 halves][height][width][3] */
    int64_t *splat;    /* [2 halves][height][width][3] */
    uint32_t *samples; /* [2 halves][height][width] eye samples */
    film_counts_t counts;
} film_t;

/* Allocates the zeroed sums; settings must have passed job_settings_check. RESULT_LIMIT when memory lacks. */
result_t film_new(const job_settings_t *settings, film_t **film);
/* Frees the film and sets *film to NULL. */
void film_destroy(film_t **film);
/* Adds a batch whose units are valid for this job. The caller sees to it that no unit is counted twice.
 * Overflowing additions are left out and counted. */
void film_merge(film_t *film, const batch_t *batch);

/* Float images of the sums so far, each [height][width][3] unless said otherwise. */
typedef struct {
    int width, height;
    float *sum;     /* eye + light: the picture */
    float *eye;     /* strategies with t >= 2 eye vertices */
    float *light;   /* t = 1 splats */
    float *noise;   /* estimated standard error of `sum`: |half 0 - half 1| scaled; one degree of freedom a
                       pixel */
    float *samples; /* [height][width] eye samples */
} film_image_t;

/* Resolves the sums: eye / own samples + splat * pixels / light paths. Pixels without samples are black. */
void film_resolve(const film_t *film, film_image_t *image);
void film_image_free(film_image_t *image);

#endif
