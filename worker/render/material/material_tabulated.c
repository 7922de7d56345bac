/* material_tabulated: materials that are tables of BSDFs. They have no other values. */
#include "worker/render/material/material.h"

/* What scales the value when a lobe's scale is its albedo. */
static rgb_t reciprocal(rgb_t albedo)
{
    return vec3(1 / albedo.x, 1 / albedo.y, 1 / albedo.z);
}

void material_fourier(const shading_t *shading)
{
    const scene_blob_t *blob = scene_blob(shading->scene);
    const blob_fourier_t *table = &blob->fouriers[shading->material->table];
    lobe_t *lobe = shading_add(shading, &lobe_fourier, table->albedo, v_max(table->albedo));
    if (lobe == NULL) return;
    lobe->fourier = (lobe_fourier_t){.table = table,
                                     .series = blob->series + table->first_series,
                                     .numbers = blob->numbers,
                                     .factor = reciprocal(table->albedo)};
}

void material_measured(const shading_t *shading)
{
    const scene_blob_t *blob = scene_blob(shading->scene);
    const blob_measured_t *table = &blob->measurements[shading->material->table];
    lobe_t *lobe = shading_add(shading, &lobe_measured, table->albedo, v_max(table->albedo));
    if (lobe == NULL) return;
    lobe->measured =
        (lobe_measured_t){.table = table, .numbers = blob->numbers, .factor = reciprocal(table->albedo)};
}
