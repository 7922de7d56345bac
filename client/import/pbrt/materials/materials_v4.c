/* materials_v4: pbrt-v4's materials. */
#include "client/import/pbrt/materials/material_kinds.h"

result_t material_make_diffuse(pbrt_t *p, params_t *params, const material_t *material,
                               blob_material_t *record)
{
    (void)material;
    static const value_rule_t rules[] = {{"reflectance", VALUE_REFLECTANCE, REFLECTANCE, 0.5f}};
    record->kind = MATERIAL_DIFFUSE;
    READ_VALUES(rules);
    return result_ok();
}

result_t material_make_conductor(pbrt_t *p, params_t *params, const material_t *material,
                                 blob_material_t *record)
{
    record->kind = MATERIAL_CONDUCTOR;
    record->values[VALUE_REFLECTANCE] = blob_constant(1);
    TRY(material_read_metal_v4(p, params, "eta", "k", VALUE_ETA, true, record));
    return material_read_roughness(p, params, material_all_axes, 0, true, material->at, record);
}

result_t material_make_dielectric(pbrt_t *p, params_t *params, const material_t *material,
                                  blob_material_t *record)
{
    record->kind = MATERIAL_DIELECTRIC;
    record->values[VALUE_REFLECTANCE] = record->values[VALUE_TRANSMITTANCE] = blob_constant(1);
    TRY(material_read_index(p, params, "eta", VALUE_ETA, 1.5f, material->at, record));
    return material_read_roughness(p, params, material_all_axes, 0, true, material->at, record);
}

result_t material_make_thin_dielectric(pbrt_t *p, params_t *params, const material_t *material,
                                       blob_material_t *record)
{
    record->kind = MATERIAL_DIELECTRIC;
    record->flags |= MATERIAL_THIN;
    record->values[VALUE_REFLECTANCE] = record->values[VALUE_TRANSMITTANCE] = blob_constant(1);
    return material_read_index(p, params, "eta", VALUE_ETA, 1.5f, material->at, record);
}

static const param_rule_t coat_rules[] = {
    {"maxdepth", PARAM_ACCEPT, NULL}, /* how pbrt samples its coat, not what it looks like */
    {"nsamples", PARAM_ACCEPT, NULL},
};

static result_t read_coat(pbrt_t *p, params_t *params, blob_material_t *record)
{
    static const value_rule_t rules[] = {{"thickness", VALUE_THICKNESS, NUMBER, 0.01f},
                                         {"albedo", VALUE_ALBEDO, REFLECTANCE, 0}};
    READ_VALUES(rules);
    record->values[VALUE_G] = blob_constant(0);
    TRY(pbrt_signed_value(p, params, "g", &record->values[VALUE_G]));
    return params_apply(params, coat_rules, ARRAY_LENGTH(coat_rules), p->report);
}

result_t material_make_coated_diffuse(pbrt_t *p, params_t *params, const material_t *material,
                                      blob_material_t *record)
{
    static const value_rule_t rules[] = {{"reflectance", VALUE_REFLECTANCE, REFLECTANCE, 0.5f}};
    record->kind = MATERIAL_COATED_DIFFUSE;
    READ_VALUES(rules);
    TRY(read_coat(p, params, record));
    TRY(material_read_index(p, params, "eta", VALUE_ETA, 1.5f, material->at, record));
    return material_read_roughness(p, params, material_all_axes, 0, true, material->at, record);
}

result_t material_make_coated_conductor(pbrt_t *p, params_t *params, const material_t *material,
                                        blob_material_t *record)
{
    static const char *const coat[3] = {"interface.roughness", "interface.uroughness",
                                        "interface.vroughness"};
    static const char *const base[3] = {"conductor.roughness", "conductor.uroughness",
                                        "conductor.vroughness"};
    record->kind = MATERIAL_COATED_CONDUCTOR;
    TRY(read_coat(p, params, record));
    TRY(material_read_index(p, params, "interface.eta", VALUE_ETA, 1.5f, material->at, record));
    TRY(material_read_metal_v4(p, params, "conductor.eta", "conductor.k", VALUE_BASE_ETA, false, record));
    TRY(material_read_axes(p, params, coat, 0, VALUE_ROUGHNESS_U, record));
    TRY(material_read_axes(p, params, base, 0, VALUE_BASE_ROUGHNESS_U, record));
    TRY(material_finish_roughness(p, params, material->at, VALUE_ROUGHNESS_U, 2, true, record));
    return material_finish_roughness(p, params, material->at, VALUE_BASE_ROUGHNESS_U, 2, true, record);
}

result_t material_make_diffuse_transmission(pbrt_t *p, params_t *params, const material_t *material,
                                            blob_material_t *record)
{
    (void)material;
    static const value_rule_t rules[] = {{"reflectance", VALUE_REFLECTANCE, REFLECTANCE, 0.25f},
                                         {"transmittance", VALUE_TRANSMITTANCE, REFLECTANCE, 0.25f}};
    double scale = 1;
    record->kind = MATERIAL_DIFFUSE_TRANSMISSION;
    READ_VALUES(rules);
    TRY(params_float_in(params, "scale", 0, 1e6, &scale));
    for (size_t i = 0; i < ARRAY_LENGTH(rules); ++i) {
        blob_value_t *value = &record->values[rules[i].slot];
        value->factor = v_scale(value->factor, (float)scale);
    }
    return result_ok();
}
