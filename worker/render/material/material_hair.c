/* material_hair: pbrt's hair (lobe_hair.c): what its values, made for artists, are in terms of the model
 * (Chiang et al. 2016, section 4). */
#include "worker/render/material/material.h"

/* At most 1, and not so smooth that the arithmetic overflows, as in pbrt-v4. */
static float sane_roughness(float roughness)
{
    return float_clamp(roughness, 0.01f, 1);
}

/* x to the power 2^n. */
static float squared(float x, int n)
{
    for (int i = 0; i < n; i++) x *= x;
    return x;
}

/* What absorbs so much that a dense heap of such hairs has the colour c (Chiang et al., equation 9, with the
 * coefficients of the authors' implementation). */
static rgb_t absorption_of(rgb_t c, float beta)
{
    float b = beta * (-0.215f + beta * (2.532f + beta * (-10.73f + beta * (5.574f + beta * 0.245f))));
    float scale = 1 / (5.969f + b);
    rgb_t log = vec3(logf(float_clamp(c.x, 1e-30f, 1)), logf(float_clamp(c.y, 1e-30f, 1)),
                     logf(float_clamp(c.z, 1e-30f, 1)));
    log = v_scale(log, scale);
    return v_mul(log, log);
}

/* The pigments' absorption for each unit of concentration (d'Eon et al. 2011). */
static rgb_t absorption(const shading_t *shading, float beta)
{
    static const rgb_t eumelanin = {0.419f, 0.697f, 1.37f}, pheomelanin = {0.187f, 0.4f, 1.05f};
    if (shading->material->flags & MATERIAL_DYED)
        return absorption_of(shading_colour(shading, VALUE_REFLECTANCE), beta);
    rgb_t sum = shading_colour(shading, VALUE_ATTENUATION), eu = eumelanin, pheo = pheomelanin;
    if (shading->waves != NULL) {
        eu = waves_coefficient(shading->waves, eu);
        pheo = waves_coefficient(shading->waves, pheo);
    }
    sum = v_mad(sum, float_max(shading_number(shading, VALUE_EUMELANIN), 0), eu);
    return v_mad(sum, float_max(shading_number(shading, VALUE_PHEOMELANIN), 0), pheo);
}

/* The variance of R along the hair (Chiang et al., equation 7), as 1 / v of TRT, which has four times it. */
static void set_roughness(lobe_hair_t *hair, float along, float about)
{
    float along4 = squared(along, 2), about4 = squared(about, 2);
    float root = 0.726f * along + 0.812f * along * along + 3.7f * squared(along, 4) * along4;
    hair->narrowness = 0.25f / (root * root);
    hair->gap = expf(-2 * hair->narrowness);
    /* The scale of the logistic distribution (equation 8); sqrt(pi / 8) makes it as wide as a Gaussian. */
    float s = 0.626657069f *
              (0.265f * about + 1.194f * about * about + 5.372f * squared(about, 4) * about4 * about * about);
    hair->inv_scale = 1 / s;
    float end = expf(-PI_F / s);
    hair->norm = (1 + end) / (1 - end);
}

/* Scales turn R by -2 alpha, TT by alpha and TRT by 4 alpha. */
static void set_tilt(lobe_hair_t *hair, float alpha)
{
    float s = sinf(alpha), c = cosf(alpha), s2 = 2 * s * c, c2 = c * c - s * s;
    hair->sine[0] = -s2, hair->sine[1] = s, hair->sine[2] = 2 * s2 * c2;
    hair->cosine[0] = c2, hair->cosine[1] = c, hair->cosine[2] = c2 * c2 - s2 * s2;
}

void material_hair(const shading_t *shading)
{
    float along = sane_roughness(shading_number(shading, VALUE_ROUGHNESS_U)),
          about = sane_roughness(shading_number(shading, VALUE_ROUGHNESS_V));
    lobe_hair_t hair = {.h = float_clamp(2 * shading->at->uv.y - 1, -1, 1),
                        .ior = lobe_sane_ior(shading_number(shading, VALUE_ETA)),
                        .absorption = absorption(shading, about)};
    hair.gamma = 0.5f * PI_F - acosf(hair.h);
    set_roughness(&hair, along, about);
    set_tilt(&hair, float_clamp(shading_number(shading, VALUE_TILT), -360, 360) * (PI_F / 180));
    const float least = 1e-3f; /* of an albedo that is divided by */
    rgb_t albedo = v_high(lobe_hair_albedo(&hair), vec3(least, least, least));
    lobe_t *lobe = shading_add(shading, &lobe_hair, albedo, v_max(albedo));
    if (lobe == NULL) return;
    hair.factor = vec3(1 / albedo.x, 1 / albedo.y, 1 / albedo.z);
    lobe->hair = hair;
}
