/* lobe_schlick: where the lobes of glTF's materials keep their numbers (lobe_schlick.c). */
#ifndef LIGHTMILL_LOBE_SCHLICK_H
#define LIGHTMILL_LOBE_SCHLICK_H

#include "worker/render/bsdf/lobe.h"

/* Alphas are at LOBE_ALPHA_U and LOBE_ALPHA_V. */
enum {
    SCHLICK_COAT = 3,   /* weight of a clear coat above */
    SCHLICK_F0 = 4,     /* reflectance at normal incidence, a colour */
    SCHLICK_F90 = 7,    /* at grazing incidence */
    SCHLICK_FACTOR = 10 /* on the value, of the lobes that are what reflection leaves */
};

/* The reflectance of a clear coat at normal incidence: index 1.5. */
#define SCHLICK_COAT_F0 0.04f

#endif
