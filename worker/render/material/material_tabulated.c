/* material_tabulated: materials that are tables of BSDFs. They have no other values. */
#include "worker/render/material/material.h"

/* What scales the value when a lobe's scale is its albedo. */
static rgb_t reciprocal(rgb_t albedo)
{
    return vec3(1 / albedo.x, 1 / albedo.y, 1 / albedo.z);
}

/* The albedo of a table in the channels. */
static rgb_t albedo_of(const shading_t *shading, rgb_t albedo)
{
    return shading->waves == NULL ? albedo : waves_reflectance(shading->waves, albedo);
}

void material_fourier(const shading_t *shading)
{
    const scene_blob_t *blob = scene_blob(shading->scene);
    const blob_fourier_t *table = &blob->fouriers[shading->material->table];
    rgb_t albedo = albedo_of(shading, table->albedo);
    lobe_t *lobe = shading_add(shading, &lobe_fourier, albedo, v_max(albedo));
    if (lobe == NULL) return;
    lobe->fourier = (lobe_fourier_t){.table = table,
                                     .series = blob->series + table->first_series,
                                     .numbers = blob->numbers,
                                     .waves = shading->waves,
                                     .factor = reciprocal(albedo)};
}

void material_measured(const shading_t *shading)
{
    const scene_blob_t *blob = scene_blob(shading->scene);
    const blob_measured_t *table = &blob->measurements[shading->material->table];
    rgb_t albedo = albedo_of(shading, table->albedo);
    lobe_t *lobe = shading_add(shading, &lobe_measured, albedo, v_max(albedo));
    if (lobe == NULL) return;
    lobe->measured = (lobe_measured_t){
        .table = table, .numbers = blob->numbers, .waves = shading->waves, .factor = reciprocal(albedo)};
}
