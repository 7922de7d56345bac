/* material: what a surface is made of, as a sum of lobes at a point (bsdf.h).
 *
 * A material, once per hit, reads its values and adds its lobes. A new one is a function in a material_*.c
 * and an entry in MATERIALS below.
 */
#ifndef LIGHTMILL_MATERIAL_H
#define LIGHTMILL_MATERIAL_H

#include "worker/render/material/shading.h"

/* Makes the BSDF at a surface point: shading frame, normal map, lobes. Its channels are the wavelengths, */
void material_bsdf_of(const scene_t *scene, const surface_t *surface, const waves_t *waves, bsdf_t *bsdf);
/* or red, green and blue. */
static inline void material_bsdf(const scene_t *scene, const surface_t *surface, bsdf_t *bsdf)
{
    material_bsdf_of(scene, surface, NULL, bsdf);
}

/* Every material, by its kind in the blob: the one place that a new one is entered. */
#define MATERIALS(ENTRY)                                                                                     \
    ENTRY(MATERIAL_DIFFUSE, material_diffuse)                                                                \
    ENTRY(MATERIAL_MIRROR, material_mirror)                                                                  \
    ENTRY(MATERIAL_DIELECTRIC, material_dielectric)                                                          \
    ENTRY(MATERIAL_CONDUCTOR, material_conductor)                                                            \
    ENTRY(MATERIAL_PLASTIC, material_plastic)                                                                \
    ENTRY(MATERIAL_UBER, material_uber)                                                                      \
    ENTRY(MATERIAL_SUBSTRATE, material_substrate)                                                            \
    ENTRY(MATERIAL_TRANSLUCENT, material_translucent)                                                        \
    ENTRY(MATERIAL_MIX, material_mix)                                                                        \
    ENTRY(MATERIAL_DISNEY, material_disney)                                                                  \
    ENTRY(MATERIAL_DIFFUSE_TRANSMISSION, material_diffuse_transmission)                                      \
    ENTRY(MATERIAL_COATED_DIFFUSE, material_coated_diffuse)                                                  \
    ENTRY(MATERIAL_COATED_CONDUCTOR, material_coated_conductor)                                              \
    ENTRY(MATERIAL_GLTF, material_gltf)                                                                      \
    ENTRY(MATERIAL_FOURIER, material_fourier)                                                                \
    ENTRY(MATERIAL_MEASURED, material_measured)                                                              \
    ENTRY(MATERIAL_PHONG, material_phong)                                                                    \
    ENTRY(MATERIAL_WARD, material_ward)                                                                      \
    ENTRY(MATERIAL_WARD_DUER, material_ward)                                                                 \
    ENTRY(MATERIAL_WARD_BALANCED, material_ward)                                                             \
    ENTRY(MATERIAL_HAIR, material_hair)
#define MATERIAL_DECLARE(kind, shade) extern material_shade_t shade;
MATERIALS(MATERIAL_DECLARE)
#undef MATERIAL_DECLARE

#endif
