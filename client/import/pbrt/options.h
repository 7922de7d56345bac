/* options: the directives before WorldBegin but the camera. */
#ifndef LIGHTMILL_PBRT_OPTIONS_H
#define LIGHTMILL_PBRT_OPTIONS_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_film(pbrt_t *p, position_t at);
result_t pbrt_sampler(pbrt_t *p, position_t at);
result_t pbrt_integrator(pbrt_t *p, position_t at);
result_t pbrt_pixel_filter(pbrt_t *p, position_t at);
result_t pbrt_accelerator(pbrt_t *p, position_t at);
result_t pbrt_option(pbrt_t *p, position_t at);
/* What depends on several options, at WorldBegin. */
result_t pbrt_options_finish(pbrt_t *p);

#endif
