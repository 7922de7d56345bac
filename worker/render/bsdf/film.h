/* film: the reflectance of a thin film on a surface, whose colours come of interference (Belcour and Barla
 * 2017, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence"), in the form
 * that KHR_materials_iridescence gives to it. */
#ifndef LIGHTMILL_BSDF_FILM_H
#define LIGHTMILL_BSDF_FILM_H

#include "worker/render/bsdf/bsdf.h"

/* What the film and the surface below it reflect together in air, 0 to 1: `f0` is the reflectance of the
 * surface without the film at normal incidence, `cos` >= 0 the cosine in air. */
rgb_t film_reflectance(const lobe_film_t *film, rgb_t f0, float cos);

/* The reflectance `plain` of a surface that the film covers by its strength. */
static inline rgb_t film_cover(const lobe_film_t *film, rgb_t f0, rgb_t plain, float cos)
{
    if (film->strength == 0) return plain;
    return v_mad(v_scale(plain, 1 - film->strength), film->strength, film_reflectance(film, f0, cos));
}

/* What the film of an interface makes of the factors on what is reflected and transmitted there, where
 * Fresnel's reflectance is `f`. The rest is transmitted in each channel: nothing is lost. */
static inline void film_on_interface(const lobe_dielectric_t *interface, float cos, float f, rgb_t *r,
                                     rgb_t *t)
{
    if (interface->film.strength == 0 || !(f > 1e-6f && f < 0.9999f)) return;
    float f0 = interface->film_f0;
    rgb_t covered = film_cover(&interface->film, vec3(f0, f0, f0), vec3(f, f, f), cos);
    *r = v_scale(v_mul(*r, covered), 1 / f);
    *t = v_scale(v_mul(*t, v_sub(vec3(1, 1, 1), covered)), 1 / (1 - f));
}

#endif
