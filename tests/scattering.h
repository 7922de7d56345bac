/* scattering: the BSDF of one material, and what every BSDF is asked: does it draw from the density that it
 * claims, do samples and values agree, how much light does it throw back? */
#ifndef LIGHTMILL_SCATTERING_H
#define LIGHTMILL_SCATTERING_H

#include "common/scene/blob_builder.h"
#include "worker/render/material/material.h"

typedef struct {
    uint8_t *bytes;
    scene_blob_t blob;
    scene_t *scene;
    bsdf_t bsdf; /* on a surface whose frame is that of the world, if nothing turns it */
} scattering_t;

/* Makes the BSDF of the material. There is one texture, a map of the normal (0.4, -0.2, 1) everywhere. */
void scattering_begin(scattering_t *scattering, blob_material_t material);
/* The same with a builder that has the tables of the material; it is destroyed. */
void scattering_begin_in(scattering_t *scattering, blob_builder_t *builder, blob_material_t material);
void scattering_end(scattering_t *scattering);

/* Fails the test unless bsdf_sample draws from the density of bsdf_eval. What is drawn of specular lobes is
 * not looked at. */
void scattering_check_draws(const bsdf_t *bsdf, vec3_t wo);
/* Fails the test unless samples say of their densities what evaluation says of their directions, both ways.
 */
void scattering_check_densities(const bsdf_t *bsdf);

/* Fails the test unless values and densities are finite and not negative, also along the surface; `index`
 * picks the directions. */
void scattering_check_finite(const bsdf_t *bsdf, uint32_t index, float grazing);

typedef struct {
    double mean, error; /* standard error */
} scattering_mean_t;

/* The mean weight of samples, red: the albedo. */
scattering_mean_t scattering_albedo(const bsdf_t *bsdf, vec3_t wo, transport_t mode, uint32_t samples);

/* A unit vector upward, or downward where z < 0, at the azimuth `phi`. */
static inline vec3_t scattering_direction(float z, float phi)
{
    float r = sqrtf(float_max(0, 1 - z * z));
    return vec3(r * cosf(phi), r * sinf(phi), z);
}

#endif
