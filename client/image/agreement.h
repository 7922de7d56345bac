/* agreement: how far an image is from a reference, and whether noise explains the difference.
 *
 * relMSE(img) = mean over pixels and channels of (img - ref)^2 / (ref^2 + 0.01), without the worst 0.1 % of
 * the pixels (by their mean over the channels). It measures the error; the same figure of the reference's own
 * noise is the floor that a perfect image would score.
 *
 * The agreement test cuts the image into blocks of 8 x 8 pixels (a rim that does not fill a block is left
 * out). Per block and channel, z = (mean img - mean ref) / combined standard error. The z of an unbiased
 * renderer look standard normal, however noisy it is; those of a wrong one grow with the square root of the
 * samples. The variance of a block mean is the sum of its pixels' variances / 64^2, so the image's own noise
 * may be an estimate of one degree of freedom a pixel (film.h): a block then has 64, and its z is close to
 * Student's t with 64 degrees, unless a few pixels hold nearly all of the noise.
 */
#ifndef LIGHTMILL_AGREEMENT_H
#define LIGHTMILL_AGREEMENT_H

#include "common/base.h"

enum { AGREEMENT_BLOCK = 8 };

/* An RGB image and what is known of its noise; both arrays [height][width][3]. */
typedef struct {
    int width, height;
    double *mean;
    double *variance; /* of each mean; NULL when unknown */
} estimate_image_t;

void estimate_image_free(estimate_image_t *image);

typedef struct {
    int x, y; /* of the top left pixel */
    double z[3];
} block_z_t;

typedef struct {
    double relmse;
    double relmse_floor;  /* 0 when the reference's noise is unknown */
    double mean_ratio[3]; /* mean img / mean ref */
    /* The agreement test; meaningless unless `tested`. */
    bool tested;
    double rms_z, max_z; /* over blocks and channels; max_z of the absolute values */
    double mean_z[3];    /* of the image means */
    block_z_t *blocks;   /* row by row; owned */
    size_t block_count;
} agreement_t;

typedef struct {
    double max_rms, max_z, max_mean_z;
} agreement_limits_t;

/* rms of z below 1.25, no |z| above 6, image means within 4 standard errors. */
agreement_limits_t agreement_default_limits(void);

/* How many pixels have a mean that is NaN or infinite. */
size_t estimate_image_not_finite(const estimate_image_t *image);

/* Compares images of the same size without pixels that are not finite. Tests when the image's variance is
 * known and at least one block fits; a reference whose variance is unknown counts as exact. */
void agreement_measure(const estimate_image_t *image, const estimate_image_t *reference,
                       agreement_t *agreement);
void agreement_free(agreement_t *agreement);
/* True when tested and within the limits. */
bool agreement_holds(const agreement_t *agreement, const agreement_limits_t *limits);
/* Sorts the blocks by falling largest |z|. */
void agreement_sort_blocks(agreement_t *agreement);

#endif
