/* shading_frame: the shading frame of a surface with known derivatives: its tangents, and a normal that a map
 * has turned. */
#ifndef LIGHTMILL_SHADING_FRAME_H
#define LIGHTMILL_SHADING_FRAME_H

#include "worker/render/bsdf/bsdf.h"
#include "worker/render/scene/scene.h"

/* Sets the frame (s, t, ns): s along dp/du as far as the shading normal allows. `bsdf` has its geometric and
 * its unturned shading normal; so has `at` its place. Always a valid frame, however degenerate the
 * derivatives or the maps. */
void shading_frame_turn(bsdf_t *bsdf, const scene_t *scene, const blob_material_t *material,
                        const surface_details_t *details, const texture_point_t *at);
/* The normal of a coat that has its own (MATERIAL_COAT_NORMAL), in the coordinates of that frame. */
vec3_t shading_frame_coat(const bsdf_t *bsdf, const scene_t *scene, const blob_material_t *material,
                          const surface_details_t *details, const texture_point_t *at);

#endif
