/* microfacet: the Trowbridge-Reitz (GGX) distribution of normals, in shading coordinates, with Smith's
 * shadowing and the sampling of visible normals. Directions may be on either side of the surface: all of it
 * depends on the squares of their components. */
#ifndef LIGHTMILL_MICROFACET_H
#define LIGHTMILL_MICROFACET_H

#include "common/vec.h"

/* Density of microfacet normals at m, per steradian and unit area (Walter et al. 2007, equation 33;
 * anisotropic as in Heitz 2014, "Understanding the Masking-Shadowing Function", equation 85). */
static inline float microfacet_distribution(float ax, float ay, vec3_t m)
{
    float x = m.x / ax, y = m.y / ay, d = x * x + y * y + m.z * m.z;
    return 1 / (PI_F * ax * ay * d * d);
}

/* Smith's Lambda (Heitz 2014, equation 86). */
static inline float microfacet_lambda(float ax, float ay, vec3_t w)
{
    float x = ax * w.x, y = ay * w.y, z2 = w.z * w.z;
    return 0.5f * (sqrtf(1 + (x * x + y * y) / z2) - 1);
}

/* A normal visible from w, w.z > 0, with density D(m) w.m / ((1 + Lambda(w)) w.z) per steradian (Dupuy and
 * Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps"). */
static inline vec3_t microfacet_sample(float ax, float ay, vec3_t w, vec2_t u)
{
    vec3_t stretched = v_normalize(vec3(ax * w.x, ay * w.y, w.z));
    float z = (1 - u.y) * (1 + stretched.z) - stretched.z, r = sqrtf(float_clamp(1 - z * z, 0, 1));
    float phi = TWO_PI_F * u.x;
    vec3_t half = v_add(vec3(r * cosf(phi), r * sinf(phi), z), stretched);
    return v_normalize(vec3(ax * half.x, ay * half.y, float_max(0, half.z)));
}

/* Both directions turned over so that wo is above the surface: none of the lobes but for their refractive
 * index can tell the sides apart. */
static inline void microfacet_upright(vec3_t *wo, vec3_t *wi)
{
    if (wo->z > 0) return;
    *wo = v_neg(*wo);
    *wi = v_neg(*wi);
}

/* What a microfacet BRDF is made of. */
typedef struct {
    float cos;     /* between either direction and the microfacet's normal */
    float density; /* D / (4 wo.z wi.z): the BRDF without Fresnel and shadowing, per steradian */
    float lambda_o, lambda_i;
    float pdf, pdf_rev; /* of reflecting about a visible normal, per steradian */
} microfacet_t;

/* Closer to the surface shadowing takes all, and its formulas overflow. */
#define MICROFACET_LEAST_COSINE 1e-6f

/* False unless both directions are above the surface. */
static inline bool microfacet_reflection(float ax, float ay, vec3_t wo, vec3_t wi, microfacet_t *facet)
{
    if (!(wo.z > MICROFACET_LEAST_COSINE && wi.z > MICROFACET_LEAST_COSINE)) return false;
    vec3_t m = v_normalize(v_add(wo, wi));
    float d = microfacet_distribution(ax, ay, m);
    facet->cos = float_min(v_dot(wo, m), 1);
    if (!(facet->cos > 0)) return false;
    facet->lambda_o = microfacet_lambda(ax, ay, wo);
    facet->lambda_i = microfacet_lambda(ax, ay, wi);
    facet->density = d / (4 * wo.z * wi.z);
    /* The visible density of m over the Jacobian 4 cos of reflection. */
    facet->pdf = d / (4 * (1 + facet->lambda_o) * wo.z);
    facet->pdf_rev = d / (4 * (1 + facet->lambda_i) * wi.z);
    return true;
}

/* Smith's height-correlated shadowing and masking (Heitz 2014, equation 99). */
static inline float microfacet_correlated(float lambda_o, float lambda_i)
{
    return 1 / (1 + lambda_o + lambda_i);
}

/* Shadowing and masking as if they were independent of each other (Heitz 2014, equation 98). */
static inline float microfacet_separable(float lambda_o, float lambda_i)
{
    return 1 / ((1 + lambda_o) * (1 + lambda_i));
}

/* Mirrors w, w.z > 0, about a visible normal. False when the ray would go into the surface. */
static inline bool microfacet_mirror(float ax, float ay, vec3_t w, vec2_t u, vec3_t *wi)
{
    vec3_t m = microfacet_sample(ax, ay, w, u);
    *wi = v_sub(v_scale(m, 2 * v_dot(w, m)), w);
    return wi->z > 0;
}

#endif
