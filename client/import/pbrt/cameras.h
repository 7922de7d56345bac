/* cameras: the Camera directive. */
#ifndef LIGHTMILL_PBRT_CAMERAS_H
#define LIGHTMILL_PBRT_CAMERAS_H

#include "client/import/pbrt/state/state.h"

/* Stores the directive, and where it stands. */
result_t pbrt_camera(pbrt_t *p, position_t at);
/* Makes the stored camera at WorldBegin. What depends on the film as well is pbrt_options_finish's. */
result_t pbrt_make_camera(pbrt_t *p, position_t at);

#endif
