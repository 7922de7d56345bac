/* textures: the Texture directive. */
#ifndef LIGHTMILL_PBRT_TEXTURES_H
#define LIGHTMILL_PBRT_TEXTURES_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_texture(pbrt_t *p, position_t at);
/* The texture of a normal map over the surface's (u, v). */
result_t pbrt_normal_map(pbrt_t *p, const char *filename, position_t at, blob_ref_t *texture);

#endif
