/* lobe_layered: where the lobes of layered materials keep their numbers (lobe_layered.c). The layers are,
 * from the outside: the interface of a dielectric (the coat), a medium, and an opaque base, Lambertian or
 * metal. From below the surface the same layers are met in the same order. */
#ifndef LIGHTMILL_LOBE_LAYERED_H
#define LIGHTMILL_LOBE_LAYERED_H

#include "worker/render/bsdf/lobe.h"

/* Alphas and index of the coat are at LOBE_ALPHA_U, LOBE_ALPHA_V and LOBE_IOR, as of any dielectric. */
enum {
    LAYERED_THICKNESS = 3,   /* in mean free paths of the medium */
    LAYERED_REFLECTANCE = 4, /* of a Lambertian base; a metal has its indices at LOBE_ETA and LOBE_K */
    LAYERED_RETURNS = 7,     /* lobe_coated_lambert: share of the light leaving the base that comes back */
    LAYERED_BASE_ALPHA_U = 10,
    LAYERED_BASE_ALPHA_V = 11,
    LAYERED_ALBEDO = 12, /* of the medium; black: it only absorbs */
    LAYERED_G = 15,
    LAYERED_FACTOR = 16, /* on the value: 1 / the scale, which is about the albedo */
    LAYERED_KIND = 19,   /* flags below */
    LAYERED_SEED = 20    /* of the walks: differs from point to point */
};
enum { LAYERED_METAL = 1, LAYERED_SMOOTH = 2 /* the coat, whose mirror reflection is a lobe of its own */ };

/* The share of the light leaving a Lambertian base that a smooth coat, or the way there and back through an
 * absorbing medium, sends back to it: the integral over the hemisphere of 2 cos R(cos) exp(-2 thickness /
 * cos) where R is the Fresnel reflectance from inside. `ior` is that of the inside over the outside. */
float layered_returns(float ior, float thickness);

#endif
