/* material_read: see material_read.h. */
#include "client/import/pbrt/materials/material_read.h"

/* ---- indices of refraction ---------------------------------------------------------------------------- */

result_t material_read_index(pbrt_t *p, params_t *params, const char *name, float otherwise, position_t at,
                             blob_material_t *record)
{
    blob_value_t *eta = &record->values[VALUE_ETA];
    *eta = blob_constant(otherwise);
    TRY(pbrt_index(p, params, name, eta));
    TRY(pbrt_float_value(p, params, name, eta)); /* goes before it, as in pbrt-v4 */
    if (eta->texture != 0 || eta->factor.x > 0) return result_ok();
    return error_at(params_where(params, name, at), "the index of refraction is %g, but must be positive",
                    (double)eta->factor.x);
}

/* ---- roughness ----------------------------------------------------------------------------------------- */

static const double largest_alpha = 10;

/* pbrt-v3's fit of a Trowbridge-Reitz alpha to its older Blinn exponent (TrowbridgeReitzDistribution::
 * RoughnessToAlpha). */
static double alpha_v3(double roughness)
{
    double x = log(fmax(roughness, 1e-3));
    return 1.62142 + x * (0.819955 + x * (0.1734 + x * (0.0171201 + x * 0.000640711)));
}

static result_t read_axes(pbrt_t *p, params_t *params, const roughness_rule_t *rule, material_value_t slot,
                          blob_material_t *record)
{
    blob_value_t *axes = &record->values[slot];
    const char *const *names = rule->names;
    axes[0] = blob_constant(rule->otherwise);
    if (names[0]) TRY(pbrt_float_value(p, params, names[0], &axes[0]));
    axes[1] = axes[0];
    if (names[1]) TRY(pbrt_float_value(p, params, names[1], &axes[0]));
    if (rule->v_as_u) axes[1] = axes[0];
    if (names[2]) TRY(pbrt_float_value(p, params, names[2], &axes[1]));
    return result_ok();
}

static bool is_zero(const blob_value_t *value)
{
    return value->texture == 0 && value->factor.x == 0;
}

static result_t check_alpha(pbrt_t *p, params_t *params, position_t at, bool remap, const blob_value_t *value)
{
    double alpha = (double)value->factor.x;
    if (remap) alpha = p->dialect.dialect == DIALECT_V3 ? alpha_v3(alpha) : sqrt(alpha);
    if (value->texture != 0 || alpha <= largest_alpha) return result_ok();
    return error_at(params_where(params, "uroughness", params_where(params, "roughness", at)),
                    "this roughness makes an alpha of %g; the most is %g", alpha, largest_alpha);
}

/* How the roughnesses of both axes become alphas. */
static result_t finish_roughness(pbrt_t *p, params_t *params, position_t at, material_value_t slot,
                                 bool smooth, blob_material_t *record)
{
    bool v3 = p->dialect.dialect == DIALECT_V3, remap = true;
    const blob_value_t *axes = &record->values[slot];
    TRY(params_bool(params, "remaproughness", &remap));
    if (is_zero(&axes[0]) && is_zero(&axes[1]) && smooth) return result_ok();
    for (int i = 0; i < 2; ++i) {
        TRY(check_alpha(p, params, at, remap, &axes[i]));
        if (v3 && !remap && (axes[i].texture != 0 || axes[i].factor.x < 1e-3f))
            record->flags |= MATERIAL_ALPHA_V3;
    }
    if (remap) record->flags |= v3 ? MATERIAL_REMAP_V3 : MATERIAL_REMAP_SQRT;
    return result_ok();
}

result_t material_read_roughness(pbrt_t *p, params_t *params, const roughness_rule_t *rule,
                                 material_value_t slot, position_t at, blob_material_t *record)
{
    TRY(read_axes(p, params, rule, slot, record));
    return finish_roughness(p, params, at, slot, rule->smooth, record);
}

/* ---- metals -------------------------------------------------------------------------------------------- */

static result_t read_indices(pbrt_t *p, params_t *params, const char *eta, const char *k,
                             material_value_t eta_slot, blob_material_t *record)
{
    record->values[eta_slot] = pbrt_named_index(p, "metal-Cu-eta");
    record->values[VALUE_K] = pbrt_named_index(p, "metal-Cu-k");
    TRY(pbrt_colour_value(p, params, eta, COLOUR_INDEX, &record->values[eta_slot]));
    return pbrt_colour_value(p, params, k, COLOUR_INDEX, &record->values[VALUE_K]);
}

/* A conductor that is given by its reflectance at normal incidence: eta = 1 and this k (pbrt-v4, 10.5.2). */
static float absorption_of(float reflectance)
{
    float r = fminf(reflectance, 0.9999f);
    return 2 * sqrtf(r) / sqrtf(1 - r);
}

/* A reflectance that varies tints a metal that reflects nearly all: its tint stays at grazing angles, where
 * pbrt's metal turns white. */
result_t material_read_metal(pbrt_t *p, params_t *params, const char *eta, const char *k,
                             material_value_t eta_slot, blob_material_t *record)
{
    bool v3 = p->dialect.dialect == DIALECT_V3, can_tint = record->kind == MATERIAL_CONDUCTOR;
    if (v3 || !params_has(params, "reflectance")) return read_indices(p, params, eta, k, eta_slot, record);
    position_t at = params_where(params, "reflectance", (position_t){.path = ""});
    if (params_has(params, eta) || params_has(params, k))
        return error_at(at, "a conductor has either \"reflectance\" or \"%s\" and \"%s\", not both", eta, k);
    blob_value_t r = blob_constant(0.5f);
    TRY(pbrt_colour_value(p, params, "reflectance", COLOUR_REFLECTANCE, &r));
    if (r.texture != 0 && can_tint) {
        report_warning(p->report, at,
                       "a reflectance that varies tints the metal at all angles, also at grazing ones");
        record->values[VALUE_REFLECTANCE] = r;
        r = blob_constant(1);
    } else if (r.texture != 0) {
        TRY(report_refuse(p->report, at,
                          "a reflectance that varies is not supported under a coat; the nearest is 0.5"));
        r = blob_constant(0.5f);
    }
    record->values[eta_slot] = blob_constant(1);
    record->values[VALUE_K] = blob_colour_value(
        vec3(absorption_of(r.factor.x), absorption_of(r.factor.y), absorption_of(r.factor.z)));
    return result_ok();
}
