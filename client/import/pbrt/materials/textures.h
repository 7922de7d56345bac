/* textures: the Texture directive. */
#ifndef LIGHTMILL_PBRT_TEXTURES_H
#define LIGHTMILL_PBRT_TEXTURES_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_texture(pbrt_t *p, position_t at);
/* Refuses what a blob must not have in the textures that came since the last call: numbers that are not
 * finite, and more than BLOB_MAX_TEXTURE_COST textures in one. */
result_t pbrt_check_textures(pbrt_t *p, position_t at);
/* The texture of a normal map over the surface's (u, v). */
result_t pbrt_normal_map(pbrt_t *p, const char *filename, position_t at, blob_ref_t *texture);

#endif
