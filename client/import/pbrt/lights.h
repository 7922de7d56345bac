/* lights: the directives that make light. */
#ifndef LIGHTMILL_PBRT_LIGHTS_H
#define LIGHTMILL_PBRT_LIGHTS_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_area_light(pbrt_t *p, position_t at);
result_t pbrt_light(pbrt_t *p, position_t at);

#endif
