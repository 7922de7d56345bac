/* material_empirical: a diffuse surface and a highlight that is a formula, as Mitsuba has them: Phong's, and
 * Ward's in three models. */
#include "worker/render/material/material.h"

/* The highlight, after the diffuse part. */
static lobe_t *add_lobes(const shading_t *shading, const lobe_kind_t *kind)
{
    rgb_t diffuse = shading_colour(shading, VALUE_REFLECTANCE),
          glossy = shading_colour(shading, VALUE_SPECULAR);
    shading_add(shading, &lobe_lambert, diffuse, v_max(diffuse));
    return shading_add(shading, kind, glossy, v_max(glossy));
}

void material_phong(const shading_t *shading)
{
    lobe_t *lobe = add_lobes(shading, &lobe_phong);
    if (lobe != NULL) lobe->phong.exponent = float_max(shading_number(shading, VALUE_EXPONENT), 0);
}

void material_ward(const shading_t *shading)
{
    lobe_t *lobe = add_lobes(shading, &lobe_ward);
    if (lobe == NULL) return;
    shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, lobe->alpha);
    lobe->ward.model = shading->material->kind;
}
