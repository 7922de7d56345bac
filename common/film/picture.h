/* picture: a resolved film as a file: the OpenEXR with its layers and its history.
 *
 * Layers of the EXR: R G B (the picture), eye.* and light.* (strategies with t >= 2 eye vertices, and t = 1),
 * noise.* (estimated standard error of R G B), samples (eye samples of each pixel). Where the job has
 * features (film_sums.h): albedo.R G B, normal.X Y Z and position.X Y Z in world space, depth.Z, object.id
 * and material.id, coverage. Where they are wanted: half0.R G B and half1.R G B, the picture of the even and
 * of the odd samples alone, two independent estimates; and mattes after the Cryptomatte specification,
 * crypto_object00.R G B A and so on, with the attributes that it asks for. Where the job has light groups
 * (common/light_groups.h): group.NAME.eye.R G B and group.NAME.light.R G B, what of eye.* and light.* comes
 * from the lights of each. The attributes, all named lightmill.*, hold what it takes to make the same bits
 * again.
 */
#ifndef LIGHTMILL_PICTURE_H
#define LIGHTMILL_PICTURE_H

#include "common/film/film.h"
#include "common/image/image.h"

/* The history of a picture. */
typedef struct {
    hash_t scene;             /* of the scene blob */
    const char *scene_name;   /* for people, such as the file it came from; NULL for none */
    job_settings_t settings;  /* what was asked for */
    film_counts_t counts;     /* what was done, CPU time and all */
    uint32_t workers;         /* that took part */
    double wall_seconds;      /* from the first assignment to now */
    hash_t bits;              /* fingerprint of the machines that made it; all zero: not known */
    const mattes_t *mattes;   /* of the scene, where the image has mattes; NULL: it has none */
    image_writing_t *writing; /* see image.h; NULL: nobody asks how far it is */
    const char *note;         /* what is to be known of it; NULL or empty: nothing */
} picture_meta_t;

/* Writes the EXR, whole or not at all, as 32-bit floats or, with `half`, as halves where
 * picture_half_fits. */
result_t picture_write_exr(const char *path, const film_image_t *film, const picture_meta_t *meta, bool half);
/* Writes the picture alone as a PNG, as image_write_png does. */
result_t picture_write_png(const char *path, const film_image_t *film, float exposure);
/* Sets the attributes of a picture, of so many pixel samples, on an image that is to be written. */
void picture_describe(image_t *image, const picture_meta_t *meta, uint64_t samples);
/* False for a channel whose values need more than the 11 bits of a half: counts, ids, places. Cryptomatte
 * asks for floats. */
bool picture_half_fits(const char *channel);
/* The name of the PNG that goes with an image file: its extension replaced by .png, or .png appended when it
 * has none; fresh memory. */
char *picture_png_path(const char *path);

#endif
