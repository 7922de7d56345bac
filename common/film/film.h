/* film: the sums of a whole job (film_sums.h), and the images that come of them.
 *
 * Two estimators, two normalisations: eye sums divide by their own pixel's samples, splat sums by the light
 * paths traced for the whole film. Both come in two halves (even and odd sample indices) that are independent
 * estimates of the same image; their difference gives the noise, splats included.
 */
#ifndef LIGHTMILL_FILM_H
#define LIGHTMILL_FILM_H

#include "common/film/batch.h"
#include "common/scene/cryptomatte.h"

/* The sums of a whole job. Not thread-safe: the owner locks. */
typedef struct {
    job_settings_t settings;
    int64_t *sums[BATCH_SUMS]; /* of the whole image (film_sums); NULL for what the job does not have */
    uint32_t *samples; /* [2 halves][height][width] eye samples, each as often as it weighs: in an adaptive
                          job JOB_MEAN_BOOST times the mean number of samples */
    film_counts_t counts;
    uint32_t settled; /* passes, from 0 on, whose lessons are what plans were made of: nothing is added to
                         them or taken out of them any more */
} film_t;

/* Allocates the zeroed sums; settings must have passed job_settings_check. RESULT_LIMIT when memory lacks. */
result_t film_new(const job_settings_t *settings, film_t **film);
/* Frees the film and sets *film to NULL. */
void film_destroy(film_t **film);
/* The values of one of its sums, of sum_image_values; NULL when the job does not have it. */
void *film_values(const film_t *film, sum_kind_t kind);
/* Bytes of a film and of the images that film_resolve makes of it. */
uint64_t film_bytes(const job_settings_t *settings);

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

    /* The picture as the even samples alone make it, and the odd ones; NULL unless they are wanted. */
    float *half[2];

    /* Mattes, likewise: ids (cryptomatte.h) and the share of the samples that show each, those of the largest
     * share first, then those of the lowest id; 0: nothing. Two ids a level, [height][width][4]. What a pixel
     * met that is nothing counts like an object, with the id 0. */
    float *mattes[MATTE_KINDS][MATTE_LEVELS];

    /* What of `eye` and `light` comes from each light group, as many as the job has; NULL beyond them,
     * group_light in a job without splats, and all unless they are wanted. */
    float *group_eye[LIGHT_GROUPS_MAX], *group_light[LIGHT_GROUPS_MAX];
} film_image_t;

/* What an image has only when it is wanted. */
typedef struct {
    bool halves, groups;
    const mattes_t *mattes; /* of the film's scene; NULL, or a film that has none: no mattes */
} film_extras_t;

/* Resolves the sums: eye / own samples + splat * pixels / light paths, and the features. Pixels without
 * samples are black. */
void film_resolve(const film_t *film, film_image_t *image);
/* Adds to a resolved image of the film, of the same moment. A half is divided by its own samples and light
 * paths; where it has none it has no light. */
void film_resolve_extras(const film_t *film, const film_extras_t *extras, film_image_t *image);
/* The part of it that is about mattes. */
void film_resolve_mattes(const film_t *film, const mattes_t *mattes, film_image_t *image);

/* Some rows of an image, and what is wanted of them beside the picture. */
typedef struct {
    int y0, y1; /* from the first to before the last, inside the image */
    bool features, halves, groups;
} film_rows_t;
/* Resolves some rows, as an image of its own: so a large film can be looked at without the memory of a large
 * image. The error is not estimated. Features are there, if they are wanted, as soon as the film has room for
 * them. */
void film_resolve_rows(const film_t *film, const film_rows_t *rows, film_image_t *image);
void film_image_free(film_image_t *image);

/* Estimates the relative error of the image, splats included: the square root of the mean, over the pixels
 * that have samples and their channels, of
 *
 *     noise^2 / (value^2 + (FILM_ERROR_FLOOR * mean)^2)
 *
 * with the noise that the two halves of the pixel show, its value, and the mean of all values. So it is the
 * root of a relMSE, as client/image/agreement.h measures it against a reference, whose floor follows the
 * brightness of the scene. INFINITY when nothing is known: the image is black. docs/convergence.md says what
 * to make of it.
 *
 * `eye_noise`, unless NULL, gets for each tile the sum of the same terms with the noise of the eye sums
 * alone: what more samples of that tile can reduce. */
double film_noise(const film_t *film, double *eye_noise);
#define FILM_ERROR_FLOOR 0.5
/* The same of rows at equal distances, as many as have `pixels` pixels, but at least one: so it takes no
 * longer in a large image. Of an image of so many pixels or less it is film_noise. */
double film_noise_of_rows(const film_t *film, size_t pixels);

#endif
