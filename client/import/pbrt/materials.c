/* materials: Material, MakeNamedMaterial, NamedMaterial, and the table of materials.
 *
 * A directive only stores its parameters. The blob's record is made when the first shape wears the material;
 * a v3 shape whose own parameters override the material's gets a record of its own. */
#include "client/import/pbrt/directives.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    entry_t entry;
    /* Fills the record (zero but for the name) from the parameters; NULL: not supported yet. */
    result_t (*make)(pbrt_t *p, params_t *params, position_t at, blob_material_t *material);
} material_entry_t;

/* What every material may have and Lightmill does not do yet. */
static const param_rule_t common_rules[] = {
    {"bumpmap", PARAM_REFUSE, "bump maps are not supported yet"},
    {"displacement", PARAM_REFUSE, "displacement is not supported yet"},
    {"normalmap", PARAM_REFUSE, "normal maps are not supported yet"},
};

/* ---- roughness ----------------------------------------------------------------------------------------- */

/* pbrt-v3's fit of a Trowbridge-Reitz alpha to its older Blinn exponent (TrowbridgeReitzDistribution::
 * RoughnessToAlpha). */
static double alpha_v3(double roughness)
{
    double x = log(fmax(roughness, 1e-3));
    return 1.62142 + x * (0.819955 + x * (0.1734 + x * (0.0171201 + x * 0.000640711)));
}

/* Reads roughness, uroughness, vroughness and remaproughness; alphas come as pbrt's distributions hold them.
 */
static result_t read_alphas(pbrt_t *p, params_t *params, double roughness, position_t at, double alpha[2])
{
    bool v3 = p->dialect.dialect == DIALECT_V3, remap = true;
    TRY(pbrt_float_value(p, params, "roughness", &roughness));
    alpha[0] = alpha[1] = roughness;
    TRY(pbrt_float_value(p, params, "uroughness", &alpha[0]));
    TRY(pbrt_float_value(p, params, "vroughness", &alpha[1]));
    TRY(params_bool(params, "remaproughness", &remap));
    for (int i = 0; i < 2; ++i) {
        if (remap) alpha[i] = v3 ? alpha_v3(alpha[i]) : sqrt(alpha[i]);
        if (alpha[i] > 10)
            return error_at(
                params_where(params, i ? "vroughness" : "uroughness", params_where(params, "roughness", at)),
                "this roughness makes an alpha of %g; the most is 10", alpha[i]);
        if (v3) alpha[i] = fmax(alpha[i], 1e-3); /* v3 knows no smooth metal */
    }
    if (!v3) { /* v4 takes a tiny alpha for a smooth surface */
        bool smooth = fmax(alpha[0], alpha[1]) < 1e-3;
        for (int i = 0; i < 2; ++i) alpha[i] = smooth ? 0 : fmax(alpha[i], 1e-4);
    }
    return result_ok();
}

/* For materials that are only supported smooth. */
static result_t require_smooth(pbrt_t *p, params_t *params, position_t at)
{
    static const char *const names[] = {"roughness", "uroughness", "vroughness"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        double value = 0;
        if (i == 0 && p->dialect.dialect == DIALECT_V3) continue; /* v3's glass has only the other two */
        TRY(pbrt_float_value(p, params, names[i], &value));
        if (value != 0)
            return error_at(params_where(params, names[i], at),
                            "rough glass is not supported yet; \"%s\" must be 0", names[i]);
    }
    bool remap; /* means nothing for a smooth surface */
    return params_bool(params, "remaproughness", &remap);
}

/* ---- pbrt-v3 ------------------------------------------------------------------------------------------- */

static result_t make_matte(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    double sigma = 0;
    material->kind = MATERIAL_DIFFUSE;
    material->reflectance = vec3(0.5f, 0.5f, 0.5f);
    TRY(pbrt_colour(p, params, "Kd", COLOUR_REFLECTANCE, &material->reflectance));
    TRY(pbrt_float_value(p, params, "sigma", &sigma));
    if (sigma != 0)
        return error_at(params_where(params, "sigma", at),
                        "a matte surface with sigma %g (Oren-Nayar) is not supported yet; sigma must be 0",
                        sigma);
    return result_ok();
}

static result_t make_mirror(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    (void)at;
    material->kind = MATERIAL_MIRROR;
    material->reflectance = vec3(0.9f, 0.9f, 0.9f);
    return pbrt_colour(p, params, "Kr", COLOUR_REFLECTANCE, &material->reflectance);
}

static result_t check_index(params_t *params, const char *name, double eta, position_t at)
{
    if (eta > 0) return result_ok();
    return error_at(params_where(params, name, at), "the index of refraction is %g, but must be positive",
                    eta);
}

static result_t make_glass(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    double eta = 1.5;
    const char *name = params_has(params, "eta") ? "eta" : "index";
    material->kind = MATERIAL_DIELECTRIC;
    material->reflectance = material->transmittance = vec3(1, 1, 1);
    TRY(pbrt_colour(p, params, "Kr", COLOUR_REFLECTANCE, &material->reflectance));
    TRY(pbrt_colour(p, params, "Kt", COLOUR_REFLECTANCE, &material->transmittance));
    TRY(pbrt_float_value(p, params, name, &eta));
    TRY(check_index(params, name, eta, at));
    TRY(require_smooth(p, params, at));
    material->eta = vec3((float)eta, (float)eta, (float)eta);
    return result_ok();
}

static const rgb_t copper_eta = {0.200438f, 0.924033f, 1.102212f};
static const rgb_t copper_k = {3.912949f, 2.452848f, 2.142188f};

static result_t make_metal(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    double alpha[2];
    material->kind = MATERIAL_CONDUCTOR;
    material->eta = copper_eta;
    material->k = copper_k;
    TRY(pbrt_colour(p, params, "eta", COLOUR_UNBOUNDED, &material->eta));
    TRY(pbrt_colour(p, params, "k", COLOUR_UNBOUNDED, &material->k));
    TRY(read_alphas(p, params, 0.01, at, alpha));
    material->alpha_u = (float)alpha[0];
    material->alpha_v = (float)alpha[1];
    return result_ok();
}

/* ---- pbrt-v4 ------------------------------------------------------------------------------------------- */

static result_t make_diffuse(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    (void)at;
    material->kind = MATERIAL_DIFFUSE;
    material->reflectance = vec3(0.5f, 0.5f, 0.5f);
    return pbrt_colour(p, params, "reflectance", COLOUR_REFLECTANCE, &material->reflectance);
}

/* A conductor that is given by its reflectance at normal incidence: eta = 1 and this k (pbrt-v4, 10.5.2). */
static float absorption_of(float reflectance)
{
    float r = fminf(reflectance, 0.9999f);
    return 2 * sqrtf(r) / sqrtf(1 - r);
}

static result_t read_conductor_optics(pbrt_t *p, params_t *params, blob_material_t *material)
{
    material->eta = copper_eta;
    material->k = copper_k;
    if (!params_has(params, "reflectance")) {
        TRY(pbrt_colour(p, params, "eta", COLOUR_UNBOUNDED, &material->eta));
        return pbrt_colour(p, params, "k", COLOUR_UNBOUNDED, &material->k);
    }
    position_t at = params_where(params, "reflectance", (position_t){0});
    if (params_has(params, "eta") || params_has(params, "k"))
        return error_at(at, "a conductor has either \"reflectance\" or \"eta\" and \"k\", not both");
    rgb_t r;
    TRY(pbrt_colour(p, params, "reflectance", COLOUR_REFLECTANCE, &r));
    material->eta = vec3(1, 1, 1);
    material->k = vec3(absorption_of(r.x), absorption_of(r.y), absorption_of(r.z));
    return result_ok();
}

static result_t make_conductor(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    double alpha[2];
    material->kind = MATERIAL_CONDUCTOR;
    TRY(read_conductor_optics(p, params, material));
    TRY(read_alphas(p, params, 0, at, alpha));
    material->alpha_u = (float)alpha[0];
    material->alpha_v = (float)alpha[1];
    return result_ok();
}

static result_t make_dielectric(pbrt_t *p, params_t *params, position_t at, blob_material_t *material)
{
    material->kind = MATERIAL_DIELECTRIC;
    material->reflectance = material->transmittance = vec3(1, 1, 1);
    const params_t *owner;
    const param_t *item = params_find(params, "eta", &owner);
    if (item && item->type == PARAM_SPECTRUM) {
        TRY(pbrt_colour(p, params, "eta", COLOUR_UNBOUNDED, &material->eta));
    } else {
        double eta = 1.5;
        TRY(pbrt_float_value(p, params, "eta", &eta));
        material->eta = vec3((float)eta, (float)eta, (float)eta);
    }
    TRY(check_index(params, "eta", (double)material->eta.x, at));
    return require_smooth(p, params, at);
}

static const material_entry_t materials[] = {
    {{"matte", DIALECT_V3}, make_matte},
    {{"mirror", DIALECT_V3}, make_mirror},
    {{"glass", DIALECT_V3}, make_glass},
    {{"metal", DIALECT_V3}, make_metal},
    {{"plastic", DIALECT_V3}, NULL},
    {{"substrate", DIALECT_V3}, NULL},
    {{"translucent", DIALECT_V3}, NULL},
    {{"uber", DIALECT_V3}, NULL},
    {{"disney", DIALECT_V3}, NULL},
    {{"fourier", DIALECT_V3}, NULL},
    {{"kdsubsurface", DIALECT_V3}, NULL},
    {{"none", DIALECT_V3}, NULL},
    {{"", DIALECT_BOTH}, NULL},
    {{"diffuse", DIALECT_V4}, make_diffuse},
    {{"conductor", DIALECT_V4}, make_conductor},
    {{"dielectric", DIALECT_V4}, make_dielectric},
    {{"thindielectric", DIALECT_V4}, NULL},
    {{"coateddiffuse", DIALECT_V4}, NULL},
    {{"coatedconductor", DIALECT_V4}, NULL},
    {{"diffusetransmission", DIALECT_V4}, NULL},
    {{"measured", DIALECT_V4}, NULL},
    {{"interface", DIALECT_V4}, NULL},
    {{"mix", DIALECT_BOTH}, NULL},
    {{"hair", DIALECT_BOTH}, NULL},
    {{"subsurface", DIALECT_BOTH}, NULL},
};

/* ---- the directives ------------------------------------------------------------------------------------ */

static uint32_t store(pbrt_t *p, size_t entry, params_t *params, position_t at, char *name)
{
    p->materials = grow(p->materials, &p->material_capacity, p->material_count + 1, sizeof *p->materials);
    p->materials[p->material_count] = (material_t){.entry = entry, .params = params, .at = at, .name = name};
    return (uint32_t)p->material_count++;
}

/* The state's parameter list goes to the material and is replaced by a fresh one. */
static params_t *take_params(pbrt_t *p)
{
    params_t *params = p->params;
    p->params = params_new();
    return params;
}

void pbrt_default_material(pbrt_t *p)
{
    const char *name = p->dialect.dialect == DIALECT_V3 ? "matte" : "diffuse";
    size_t entry = 0;
    while (strcmp(materials[entry].entry.name, name) != 0) ++entry;
    p->now.material = store(p, entry, params_new(), (position_t){.path = "default material"},
                            mem_strdup("default material"));
}

static result_t find_entry(const pbrt_t *p, const char *name, position_t at, size_t *entry)
{
    return entry_find(materials, ARRAY_LENGTH(materials), sizeof *materials, "material", name, &p->dialect,
                      at, entry);
}

result_t pbrt_material(pbrt_t *p, position_t at)
{
    size_t entry;
    TRY(pbrt_read_string(p, 0, "the material's type"));
    TRY(pbrt_read_params_for(p, TARGET_MATERIAL));
    TRY(find_entry(p, p->arguments[0], at, &entry));
    p->now.material = store(p, entry, take_params(p), at, mem_printf("%s:%u", p->source->label, at.line));
    return result_ok();
}

result_t pbrt_make_named_material(pbrt_t *p, position_t at)
{
    size_t entry;
    uint32_t old;
    const char *type = NULL;
    TRY(pbrt_read_string(p, 0, "the material's name"));
    TRY(pbrt_read_params_for(p, TARGET_MATERIAL));
    TRY(params_string(p->params, "type", &type));
    if (!type) return error_at(at, "MakeNamedMaterial needs a parameter \"string type\"");
    TRY(find_entry(p, type, params_where(p->params, "type", at), &entry));
    if (names_find(&p->material_names, p->arguments[0], &old)) {
        if (p->dialect.dialect == DIALECT_V4)
            return error_at(at, "the material \"%.60s\" has been made before, in line %u", p->arguments[0],
                            p->materials[old].at.line);
        report_warning(p->report, at, "the material \"%.60s\" of line %u is replaced", p->arguments[0],
                       p->materials[old].at.line);
    }
    names_add(&p->material_names, p->arguments[0],
              store(p, entry, take_params(p), at, mem_strdup(p->arguments[0])));
    return result_ok();
}

result_t pbrt_named_material(pbrt_t *p, position_t at)
{
    uint32_t index;
    TRY(pbrt_read_string(p, 0, "the material's name"));
    if (!names_find(&p->material_names, p->arguments[0], &index))
        return error_at(at, "no MakeNamedMaterial \"%.60s\" came before", p->arguments[0]);
    p->now.material = index;
    return result_ok();
}

/* ---- making them --------------------------------------------------------------------------------------- */

static result_t make(pbrt_t *p, const material_t *material, params_t *params, blob_material_t *record)
{
    const material_entry_t *entry = &materials[material->entry];
    *record = (blob_material_t){0};
    if (!entry->make)
        return error_at(material->at, "material \"%s\" is not supported yet", entry->entry.name);
    TRY(entry->make(p, params, material->at, record));
    return params_apply(params, common_rules, ARRAY_LENGTH(common_rules), p->report);
}

static uint32_t append(pbrt_t *p, const material_t *material, blob_material_t record)
{
    record.name = blob_builder_string(p->builder, material->name);
    return blob_builder_add(p->builder, BLOB_SECTION_MATERIALS, &record, 1);
}

static result_t make_once(pbrt_t *p, material_t *material)
{
    if (material->made) return result_ok();
    blob_material_t record;
    TRY(make(p, material, material->params, &record));
    TRY(params_finish(material->params, "this material", p->dialect.dialect == DIALECT_V4, p->report));
    material->index = append(p, material, record);
    material->made = true;
    return result_ok();
}

result_t pbrt_wear_material(pbrt_t *p, params_t *shape_params, uint32_t *index)
{
    material_t *material = &p->materials[p->now.material];
    TRY(make_once(p, material));
    *index = material->index;
    size_t unread = params_unread(shape_params);
    if (p->dialect.dialect != DIALECT_V3 || unread == 0) return result_ok();

    blob_material_t record;
    params_set_fallback(shape_params, material->params);
    result_t result = make(p, material, shape_params, &record);
    params_set_fallback(shape_params, NULL);
    TRY(result);
    if (params_unread(shape_params) < unread) *index = append(p, material, record);
    return result_ok();
}

void pbrt_check_unused_materials(pbrt_t *p)
{
    for (size_t i = 1; i < p->material_count; ++i) { /* 0 is the default */
        material_t *material = &p->materials[i];
        if (material->made) continue;
        blob_material_t record;
        result_t result = make(p, material, material->params, &record);
        if (result.code == RESULT_OK)
            result = params_finish(material->params, "this material", true, p->report);
        if (result.code != RESULT_OK)
            report_warning(p->report, material->at, "a material that no shape has: %s", result.message);
    }
}
