/* medium: what fills space: it absorbs, scatters and emits light on its way (blob_medium_t).
 *
 * Light along a ray is followed by tracking: distances are drawn by how much the medium scatters, and what it
 * absorbs is in the weight, so that nothing is lost where light is only dimmed. Where coefficients differ
 * between channels, the channel that distances are drawn by is chosen by what the path carries, and the
 * density is that of all channels together (Wilkie, Nawaz, Droske, Weidlich and Hanika 2014, "Hero Wavelength
 * Spectral Sampling"; here of three channels), so that no weight exceeds what the path carries.
 *
 * In a grid distances are drawn by delta tracking with local bounds (density.h); at each tentative collision
 * scattering is chosen by the mean over the channels, and all else goes into the weight (Novak, Georgiev,
 * Hanika and Jarosz 2018, "Monte Carlo Methods for Volumetric Light Transport Simulation", section 5). What
 * is left of light between two points is estimated by ratio tracking (Novak, Selle and Jarosz 2014, "Residual
 * Ratio Tracking for Estimating Attenuation in Participating Media").
 *
 * All numbers are given by the caller: what happens is a function of the sample and the ray alone.
 */
#ifndef LIGHTMILL_MEDIUM_H
#define LIGHTMILL_MEDIUM_H

#include "common/sampler.h"
#include "common/scene/scene_blob.h"
#include "worker/render/bsdf/bsdf.h"
#include "worker/render/medium/density.h"
#include "worker/render/spectral/waves.h"

typedef struct media media_t;

/* What fills the space along a ray: nothing, the inside of absorbing glass, or one of the scene's media. */
typedef struct {
    rgb_t attenuation; /* of the glass, per unit length; 0: a vacuum */
    blob_ref_t number; /* of the medium; 0: none */
} medium_t;

/* The numbers that a ray takes: `first`, which is well stratified, and then as many as it wants; and the
 * wavelengths of its channels. */
typedef struct {
    float first; /* below 0: used up */
    bool exact;  /* so well that it is worth an exact integral over a small grid: */
    way_t *way;  /* where that is kept for others who ask; or NULL */
    uint64_t key;
    const waves_t *waves; /* NULL: red, green and blue */
    float faint; /* what is left of light when Russian roulette decides about it, at most 1; for grids */
} media_numbers_t;

/* Prepares the media of a scene, which must outlive them; NULL when it has none. `empty`: they do nothing. */
media_t *media_new(const scene_blob_t *blob, bool empty);
/* Frees them and sets *media to NULL. */
void media_destroy(media_t **media);

/* Follows light through a medium, from a point in a unit direction, for a distance that may be INFINITY.
 * True when it is scattered at the distance *at. *throughput: the light before, and what is left of it then,
 * over the density; when it is scattered times the coefficient of scattering. */
bool media_scatter(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction, float distance,
                   media_numbers_t *numbers, rgb_t *throughput, float *at);
/* What is left of light over a distance that may be INFINITY: an estimate where there is a grid. */
rgb_t media_transmittance(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction,
                          float distance, media_numbers_t *numbers);
/* About the chance to get over a distance without being scattered, for weights: a function of the medium and
 * the distance alone, and 1 where there is a grid. */
float media_fade(const media_t *media, blob_ref_t medium, float distance);
/* What a medium emits on such a way, as it arrives at its start: an estimate where there is a grid, by
 * other numbers than the first. */
rgb_t media_emission(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction, float distance,
                     media_numbers_t *numbers);
bool media_emits(const media_t *media, blob_ref_t medium);
/* Whether it is the body of a material (blob_material_t), which may be asked of 0, and where there are no
 * media. */
bool media_is_body(const media_t *media, blob_ref_t medium);
/* Whether it lies in a grid; likewise. */
bool media_is_grid(const media_t *media, blob_ref_t medium);
/* Whether some medium is one. */
bool media_has_bodies(const media_t *media);
/* How it scatters at a point; wo is the unit direction to where the path came from. */
void media_bsdf(const media_t *media, blob_ref_t medium, vec3_t wo, bsdf_t *bsdf);

#endif
