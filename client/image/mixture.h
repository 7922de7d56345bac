/* mixture: an image of its light groups (common/light_groups.h), each times a factor or a colour: what the
 * picture would be with brighter, darker or coloured lights.
 *
 * Groups are told by the channels of the image: group.NAME.eye.R G B and group.NAME.light.R G B, either of
 * which may be missing.
 */
#ifndef LIGHTMILL_MIXTURE_H
#define LIGHTMILL_MIXTURE_H

#include "common/image/image.h"

enum { MIXTURE_MAX_GROUPS = 64, MIXTURE_PARTS = 2 };

typedef struct {
    char name[64];
    const image_channel_t *parts[MIXTURE_PARTS][3]; /* eye and light; NULL: none */
    double factor[3];                               /* of red, green, blue */
    bool set;                                       /* by mixture_set */
} mixture_group_t;

typedef struct {
    const image_t *image; /* kept by the caller */
    mixture_group_t groups[MIXTURE_MAX_GROUPS];
    size_t count;
} mixture_t;

/* Finds the groups of an image, all with the factor 1. RESULT_INPUT, which names `path`, when it has none. */
result_t mixture_of(const image_t *image, const char *path, mixture_t *mixture);
/* Takes "GROUP=FACTOR" or "GROUP=R,G,B", numbers of at least 0. RESULT_USAGE says what is wrong, and what
 * groups there are. */
result_t mixture_set(mixture_t *mixture, const char *text);
/* Puts out all groups but one. */
result_t mixture_solo(mixture_t *mixture, const char *name);
/* Makes the image: R G B, eye.R G B and light.R G B, and what the other one has that no light changes: its
 * features, and its attributes with one more, lightmill.mix. Channels are views of it where they can be, so
 * it must outlive the new one, which the caller frees, after a failure too. With all factors 1 the picture is
 * that of the image, bit by bit. `half`: as picture_write_exr. RESULT_LIMIT when memory lacks. */
result_t mixture_make(const mixture_t *mixture, bool half, image_t *mixed);

#endif
