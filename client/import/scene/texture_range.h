/* texture_range: what a value comes to over a whole surface, as far as that can be told without looking at
 * the surface: for what cannot vary, as a medium below it. */
#ifndef LIGHTMILL_TEXTURE_RANGE_H
#define LIGHTMILL_TEXTURE_RANGE_H

#include "client/import/scene/scene_builder.h"

/* A bound on each component of a colour value; 1 stands for the textures of noise and the colours of meshes.
 * Of textures that scene_check_textures has passed. */
rgb_t scene_value_most(const scene_builder_t *scene, const blob_value_t *value);
/* About its mean: that of all pixels of an image, of both fields of a pattern; 0.5 for textures of noise. */
rgb_t scene_value_mean(const scene_builder_t *scene, const blob_value_t *value);

#endif
