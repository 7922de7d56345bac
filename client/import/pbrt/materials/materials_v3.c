/* materials_v3: pbrt-v3's materials. */
#include "client/import/pbrt/materials/material_kinds.h"

/* pbrt-v3's "eta", or its older name. */
static result_t read_index_v3(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    const char *name = params_has(params, "eta") ? "eta" : "index";
    return material_read_index(p, params, name, VALUE_ETA, 1.5f, at, record);
}

result_t material_make_matte(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record)
{
    (void)material;
    static const value_rule_t rules[] = {{"Kd", VALUE_REFLECTANCE, REFLECTANCE, 0.5f},
                                         {"sigma", VALUE_SIGMA, NUMBER, 0}};
    record->kind = MATERIAL_DIFFUSE;
    READ_VALUES(rules);
    blob_value_t *sigma = &record->values[VALUE_SIGMA]; /* pbrt clamps it, too */
    if (sigma->texture == 0 && sigma->factor.x > 90) *sigma = blob_constant(90);
    return result_ok();
}

result_t material_make_mirror(pbrt_t *p, params_t *params, const material_t *material,
                              blob_material_t *record)
{
    (void)material;
    static const value_rule_t rules[] = {{"Kr", VALUE_REFLECTANCE, REFLECTANCE, 0.9f}};
    record->kind = MATERIAL_MIRROR;
    READ_VALUES(rules);
    return result_ok();
}

result_t material_make_glass(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record)
{
    static const value_rule_t rules[] = {{"Kr", VALUE_REFLECTANCE, REFLECTANCE, 1},
                                         {"Kt", VALUE_TRANSMITTANCE, REFLECTANCE, 1}};
    record->kind = MATERIAL_DIELECTRIC;
    READ_VALUES(rules);
    TRY(read_index_v3(p, params, material->at, record));
    return material_read_roughness(p, params, material_each_axis, 0, true, material->at, record);
}

result_t material_make_metal(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record)
{
    record->kind = MATERIAL_CONDUCTOR;
    record->values[VALUE_REFLECTANCE] = blob_constant(1);
    TRY(material_read_metal(p, params, "eta", "k", VALUE_ETA, record));
    return material_read_roughness(p, params, material_all_axes, 0.01f, false, material->at, record);
}

result_t material_make_plastic(pbrt_t *p, params_t *params, const material_t *material,
                               blob_material_t *record)
{
    static const value_rule_t rules[] = {{"Kd", VALUE_REFLECTANCE, REFLECTANCE, 0.25f},
                                         {"Ks", VALUE_SPECULAR, REFLECTANCE, 0.25f}};
    record->kind = MATERIAL_PLASTIC;
    READ_VALUES(rules);
    return material_read_roughness(p, params, material_both_axes, 0.1f, false, material->at, record);
}

result_t material_make_substrate(pbrt_t *p, params_t *params, const material_t *material,
                                 blob_material_t *record)
{
    static const value_rule_t rules[] = {{"Kd", VALUE_REFLECTANCE, REFLECTANCE, 0.5f},
                                         {"Ks", VALUE_SPECULAR, REFLECTANCE, 0.5f}};
    record->kind = MATERIAL_SUBSTRATE;
    READ_VALUES(rules);
    return material_read_roughness(p, params, material_each_axis, 0.1f, false, material->at, record);
}

result_t material_make_translucent(pbrt_t *p, params_t *params, const material_t *material,
                                   blob_material_t *record)
{
    static const value_rule_t rules[] = {{"Kd", VALUE_REFLECTANCE, REFLECTANCE, 0.25f},
                                         {"Ks", VALUE_SPECULAR, REFLECTANCE, 0.25f},
                                         {"reflect", VALUE_REFLECT, REFLECTANCE, 0.5f},
                                         {"transmit", VALUE_TRANSMIT, REFLECTANCE, 0.5f}};
    record->kind = MATERIAL_TRANSLUCENT;
    READ_VALUES(rules);
    return material_read_roughness(p, params, material_both_axes, 0.1f, false, material->at, record);
}

result_t material_make_uber(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record)
{
    static const value_rule_t rules[] = {
        {"Kd", VALUE_REFLECTANCE, REFLECTANCE, 0.25f}, {"Ks", VALUE_SPECULAR, REFLECTANCE, 0.25f},
        {"Kr", VALUE_MIRROR, REFLECTANCE, 0},          {"Kt", VALUE_TRANSMITTANCE, REFLECTANCE, 0},
        {"opacity", VALUE_OPACITY, REFLECTANCE, 1},
    };
    record->kind = MATERIAL_UBER;
    READ_VALUES(rules);
    TRY(read_index_v3(p, params, material->at, record));
    return material_read_roughness(p, params, material_all_axes, 0.1f, false, material->at, record);
}

result_t material_make_disney(pbrt_t *p, params_t *params, const material_t *material,
                              blob_material_t *record)
{
    static const value_rule_t rules[] = {
        {"color", VALUE_REFLECTANCE, REFLECTANCE, 0.5f},
        {"metallic", VALUE_METALLIC, NUMBER, 0},
        {"roughness", VALUE_ROUGHNESS_U, NUMBER, 0.5f},
        {"speculartint", VALUE_SPECULAR_TINT, NUMBER, 0},
        {"anisotropic", VALUE_ANISOTROPIC, NUMBER, 0},
        {"sheen", VALUE_SHEEN, NUMBER, 0},
        {"sheentint", VALUE_SHEEN_TINT, NUMBER, 0.5f},
        {"clearcoat", VALUE_CLEARCOAT, NUMBER, 0},
        {"clearcoatgloss", VALUE_CLEARCOAT_GLOSS, NUMBER, 1},
        {"spectrans", VALUE_TRANSMISSION, NUMBER, 0},
        {"flatness", VALUE_FLATNESS, NUMBER, 0},
        {"difftrans", VALUE_DIFFUSE_TRANSMISSION, NUMBER, 1},
    };
    bool thin = false;
    blob_value_t distance = blob_constant(0);
    record->kind = MATERIAL_DISNEY;
    READ_VALUES(rules);
    TRY(material_read_index(p, params, "eta", VALUE_ETA, 1.5f, material->at, record));
    TRY(params_bool(params, "thin", &thin));
    if (thin) record->flags |= MATERIAL_THIN;
    TRY(pbrt_colour_value(p, params, "scatterdistance", COLOUR_UNBOUNDED, &distance));
    if (thin || (distance.texture == 0 && v_is_zero(distance.factor))) return result_ok();
    return report_refuse(p->report, params_where(params, "scatterdistance", material->at),
                         "scattering below the surface is not supported; the nearest is scatterdistance 0");
}
