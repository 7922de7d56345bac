/* transforms: the directives that change the current transform. */
#ifndef LIGHTMILL_PBRT_TRANSFORMS_H
#define LIGHTMILL_PBRT_TRANSFORMS_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_identity(pbrt_t *p, position_t at);
result_t pbrt_translate(pbrt_t *p, position_t at);
result_t pbrt_scale(pbrt_t *p, position_t at);
result_t pbrt_rotate(pbrt_t *p, position_t at);
result_t pbrt_look_at(pbrt_t *p, position_t at);
result_t pbrt_transform(pbrt_t *p, position_t at);
result_t pbrt_concat_transform(pbrt_t *p, position_t at);
result_t pbrt_coordinate_system(pbrt_t *p, position_t at);
result_t pbrt_coord_sys_transform(pbrt_t *p, position_t at);
result_t pbrt_active_transform(pbrt_t *p, position_t at);
result_t pbrt_transform_times(pbrt_t *p, position_t at);

#endif
