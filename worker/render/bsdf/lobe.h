/* lobe: what the lobes and the materials that make them agree on: where a lobe keeps its numbers. */
#ifndef LIGHTMILL_LOBE_H
#define LIGHTMILL_LOBE_H

#include "worker/render/bsdf/bsdf.h"
#include "worker/render/bsdf/fresnel.h"

/* Places of a lobe's numbers; colours take three. */
enum {
    /* Microfacet lobes, and the smooth ones that bsdf_regularize makes into such. */
    LOBE_ALPHA_U = 0, /* of the Trowbridge-Reitz distribution, along s */
    LOBE_ALPHA_V = 1, /* along t */
    /* Dielectrics: factors on what is reflected and transmitted. */
    LOBE_IOR = 2,       /* index inside (below the surface) over that outside */
    LOBE_SEPARABLE = 3, /* 1: shadowing and masking are independent */
    LOBE_R = 4,
    LOBE_T = 7,
    /* Conductors. */
    LOBE_ETA = 4,
    LOBE_K = 7,
    /* Oren-Nayar. */
    LOBE_OREN_A = 0,
    LOBE_OREN_B = 1,
    /* Fresnel blend. */
    LOBE_DIFFUSE = 4,
    LOBE_GLOSSY = 7,
    LOBE_FACTOR = 10, /* on the value: 1 / the scale, which is about the albedo */
    /* Disney's diffuse reflection: shares of its parts. */
    LOBE_DISNEY_BASE = 0,
    LOBE_DISNEY_FLAT = 1,
    LOBE_DISNEY_RETRO = 2,
    LOBE_DISNEY_ROUGHNESS = 3,
    /* Disney's specular reflection: as a dielectric, and */
    LOBE_DISNEY_METALLIC = 7,
    LOBE_DISNEY_R0 = 8,
    LOBE_DISNEY_FACTOR = 11, /* as LOBE_FACTOR */
    /* Disney's clear coat. */
    LOBE_DISNEY_ALPHA = 0
};

/* An index of refraction that differs from 1 by less does not turn light enough to tell a rough surface. */
#define LOBE_LEAST_REFRACTION 1e-3f

/* Roughens alphas below 0.3 (pbrt-v4's rule: twice the alpha, from 0.1 to 0.3). */
void lobe_regularize_alphas(lobe_t *lobe);

/* Adds a dielectric interface, smooth or rough, a pane, or a rough transmission: factors `r` and `t` on what
 * is reflected and transmitted, `ior` of the inside over the outside. NULL as shading_add, and when both are
 * black. */
lobe_t *lobe_add_dielectric(const shading_t *shading, const lobe_kind_t *kind, rgb_t r, rgb_t t, float ior,
                            const float alpha[2]);
/* Adds its reflection alone, rough, with the factor `r`. */
lobe_t *lobe_add_reflection(const shading_t *shading, rgb_t r, float ior, const float alpha[2]);

/* An index of refraction within sensible limits; 0 counts as 1, no interface. */
static inline float lobe_sane_ior(float ior)
{
    return ior == 0 ? 1 : float_clamp(ior, 0.01f, 100);
}

/* The probability of reflecting, where the Fresnel reflectance is `f` and the rest is transmitted, each with
 * its factor. False when neither carries anything. */
static inline bool lobe_reflect_chance(float f, rgb_t reflected, rgb_t transmitted, float *chance)
{
    float r = f * v_max(reflected), t = (1 - f) * v_max(transmitted);
    if (!(r + t > 0)) return false;
    *chance = r / (r + t);
    return true;
}

#endif
