/* shading: a material at a point while it adds its lobes: its values there, and what several materials add.
 */
#ifndef LIGHTMILL_SHADING_H
#define LIGHTMILL_SHADING_H

#include "worker/render/bsdf/lobe.h"
#include "worker/render/scene/scene.h"
#include "worker/render/spectral/waves.h"

/* A material about to add its lobes. */
typedef struct shading shading_t;
/* Adds the material's lobes. */
typedef void material_shade_t(const shading_t *shading);
struct shading {
    const scene_t *scene;
    const blob_material_t *material;
    const texture_point_t *at;
    rgb_t scale; /* of all lobes: what a mix leaves to this part */
    bsdf_t *bsdf;
    material_shade_t *shade; /* any material, by its kind */
    vec3_t coat_normal;      /* of a coat, in the BSDF's frame: (0, 0, 1) where it has none of its own */
    const waves_t *waves;    /* of the channels; NULL: they are red, green and blue */
};

/* A random number that is a function of a place: all paths that meet there have the same. Its lower half is
 * for coats, its upper one for mixes. */
uint64_t shading_point_key(vec3_t p);

/* Values of the material at the point, bounded by 1e6; colours are not negative. A colour is what it is in
 * each channel; */
rgb_t shading_colour(const shading_t *shading, material_value_t value);
/* and this the luminance of the same. */
float shading_luminance(const shading_t *shading, material_value_t value);
/* The root of a colour that is at most 1. */
rgb_t shading_root(const shading_t *shading, material_value_t value);
float shading_number(const shading_t *shading, material_value_t value);
/* The absorption index of a metal in each channel. Where its eta is 1 it was made of a reflectance r at
 * normal incidence, as k = 2 sqrt(r / (1 - r)): that is the colour then. */
rgb_t shading_absorption_index(const shading_t *shading, material_value_t eta);
/* The indices of refraction of a body in each channel, where they differ: those of a measured spectrum.
 * False: they do not, or not in RGB, or light is hardly refracted. */
bool shading_disperses(const shading_t *shading, material_value_t value, float iors[3]);
/* The same, of glass with this index at 587.56 nm and the Abbe number 20 / `dispersion`: in RGB as far apart
 * as KHR_materials_dispersion has it, for wavelengths by Cauchy's formula. */
void shading_spread(const shading_t *shading, float ior, float dispersion, float iors[3]);
/* The alphas of the Trowbridge-Reitz distribution from the values `u` and `v`, remapped as the material's
 * flags say, at least 1e-4 each; false when the surface counts as smooth. */
bool shading_alphas(const shading_t *shading, material_value_t u, material_value_t v, float alpha[2]);
/* Adds a lobe; `share` >= 0 is its chance of being sampled relative to the others', mostly its expected
 * albedo. All else in it is zero. NULL when `scale` is black or there is no room left. */
lobe_t *shading_add(const shading_t *shading, const lobe_kind_t *kind, rgb_t scale, float share);
/* Adds a dielectric interface, smooth or rough, a pane, or a rough transmission: factors `r` and `t` on what
 * is reflected and transmitted, `ior` of the inside over the outside. NULL as shading_add, and when both are
 * black. */
lobe_t *shading_add_dielectric(const shading_t *shading, const lobe_kind_t *kind, rgb_t r, rgb_t t, float ior,
                               const float alpha[2]);
/* Adds its reflection alone, rough, with the factor `r`. */
lobe_t *shading_add_reflection(const shading_t *shading, rgb_t r, float ior, const float alpha[2]);
/* Lets another material shade in this one's place. */
void shading_delegate(const shading_t *shading, uint32_t material, rgb_t scale);

#endif
