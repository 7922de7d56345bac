/* realistic: pbrt's camera behind a lens of elements. */
#ifndef LIGHTMILL_PBRT_REALISTIC_H
#define LIGHTMILL_PBRT_REALISTIC_H

#include "client/import/pbrt/state/state.h"

/* Makes the camera of the directive's parameters but those of the shutter, which are read already. The film
 * must be known. RESULT_INPUT when there is no lens file, when it is bad, or the lens cannot be focused. */
result_t pbrt_make_realistic(pbrt_t *p, params_t *params);

#endif
