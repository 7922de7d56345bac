/* fresnel: reflectance of smooth interfaces for unpolarised light. */
#ifndef LIGHTMILL_FRESNEL_H
#define LIGHTMILL_FRESNEL_H

#include "common/vec.h"

/* Fresnel reflectance between two dielectrics. `eta` is the index on the far side over that on the near side,
 * `cos_i` >= 0 the cosine on the near side; *cos_t receives the cosine on the far side, 0 at total internal
 * reflection (Born and Wolf, Principles of Optics, section 1.5.2). */
static inline float fresnel_dielectric(float cos_i, float eta, float *cos_t)
{
    float sin2_t = (1 - cos_i * cos_i) / (eta * eta);
    if (sin2_t >= 1) {
        *cos_t = 0;
        return 1;
    }
    *cos_t = sqrtf(1 - sin2_t);
    float parallel = (eta * cos_i - *cos_t) / (eta * cos_i + *cos_t);
    float perpendicular = (cos_i - eta * *cos_t) / (cos_i + eta * *cos_t);
    return 0.5f * (parallel * parallel + perpendicular * perpendicular);
}

/* About the mean of it over the hemisphere on the near side, weighed by the cosine: of Schlick's
 * approximation from the thinner side; what enters the denser medium fills only a cone of it, whence the
 * other side. */
static inline float fresnel_dielectric_mean(float eta)
{
    float thin = eta >= 1 ? eta : 1 / eta, f0 = (thin - 1) / (thin + 1);
    f0 *= f0;
    float mean = f0 + (1 - f0) / 21;
    return eta >= 1 ? mean : 1 - (1 - mean) * eta * eta;
}

/* The weight of grazing incidence in Schlick's approximation (1994): (1 - cos)^5. */
static inline float fresnel_schlick_weight(float cos_i)
{
    float m = float_clamp(1 - cos_i, 0, 1), m2 = m * m;
    return m2 * m2 * m;
}

/* Fresnel reflectance of a conductor with relative index eta and absorption k, one channel (same source,
 * section 14.2). */
static inline float fresnel_conductor_channel(float cos_i, float eta, float k)
{
    float c2 = cos_i * cos_i, s2 = 1 - c2, eta2 = eta * eta, k2 = k * k;
    float t0 = eta2 - k2 - s2, a2b2 = sqrtf(t0 * t0 + 4 * eta2 * k2);
    float t1 = a2b2 + c2, a = sqrtf(float_max(0, 0.5f * (a2b2 + t0))), t2 = 2 * cos_i * a;
    float perpendicular = (t1 - t2) / (t1 + t2);
    float t3 = c2 * a2b2 + s2 * s2, t4 = t2 * s2;
    return 0.5f * perpendicular * (1 + (t3 - t4) / (t3 + t4));
}

static inline rgb_t fresnel_conductor(float cos_i, rgb_t eta, rgb_t k)
{
    cos_i = float_clamp(cos_i, 1e-6f, 1); /* at 0 the formula may be 0 / 0 */
    return vec3(fresnel_conductor_channel(cos_i, eta.x, k.x), fresnel_conductor_channel(cos_i, eta.y, k.y),
                fresnel_conductor_channel(cos_i, eta.z, k.z));
}

#endif
