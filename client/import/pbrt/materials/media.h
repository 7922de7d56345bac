/* media: MakeNamedMedium and MediumInterface, and how shapes, lights and the camera come to their media. */
#ifndef LIGHTMILL_PBRT_MEDIA_H
#define LIGHTMILL_PBRT_MEDIA_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_make_named_medium(pbrt_t *p, position_t at);
result_t pbrt_medium_interface(pbrt_t *p, position_t at);

/* What the interface in force has inside and outside, as a shape or a light has it; 0: empty space. In v4 a
 * medium may be made later: its reference means nothing but itself before pbrt_finish_media. RESULT_INPUT
 * when a medium is of a type that is not supported. */
result_t pbrt_media_in_force(pbrt_t *p, blob_ref_t media[2]);
/* The one outside. */
result_t pbrt_medium_outside(pbrt_t *p, blob_ref_t *medium);
/* Gives shapes and lights the media that were made after them, and the camera its own. `at` is the end of
 * the file. */
result_t pbrt_finish_media(pbrt_t *p, position_t at);

#endif
