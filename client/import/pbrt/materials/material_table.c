/* material_table: see material_table.h. Most materials are a row alone; what a row cannot say is said by its
 * `rest`. */
#include "client/import/pbrt/materials/material_table.h"

#include "client/import/pbrt/materials/bsdf_files.h"
#include "client/import/pbrt/materials/material_read.h"
#include "client/import/pbrt/materials/subsurface.h"

/* A value of the record: from a parameter, or always the same. Colours are reflectances. */
typedef enum { END, NUMBER, SIGNED, COLOUR, CONSTANT } rule_kind_t;

typedef struct {
    rule_kind_t kind;
    const char *name;
    material_value_t slot;
    float otherwise; /* in all components, where the parameter is not there */
} value_rule_t;

enum { MOST_VALUES = 12 };

typedef struct {
    dialect_entry_t entry;
    material_kind_t kind;
    uint32_t flags;
    value_rule_t values[MOST_VALUES]; /* up to an END */
    struct {
        const char *name, *older; /* older: another name; NULL: there is none */
        float otherwise;
    } index; /* see material_read_index */
    roughness_rule_t roughness;
    result_t (*rest)(pbrt_t *p, params_t *params, position_t at, blob_material_t *record);
} row_t;

/* ---- what rows cannot say ----------------------------------------------------------------------------- */

static result_t clamp_sigma(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    (void)p, (void)params, (void)at;
    blob_value_t *sigma = &record->values[VALUE_SIGMA]; /* pbrt clamps it, too */
    if (sigma->texture == 0 && sigma->factor.x > 90) *sigma = blob_constant(90);
    return result_ok();
}

static result_t read_metal(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    (void)at;
    return material_read_metal(p, params, "eta", "k", VALUE_ETA, record);
}

static result_t read_thin(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    bool thin = false;
    TRY(params_bool(params, "thin", &thin));
    if (thin) record->flags |= MATERIAL_THIN;
    return pbrt_read_scatter_distance(p, params, at, record);
}

static result_t read_coat(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    static const param_rule_t rules[] = {
        {{"maxdepth"}, PARAM_ACCEPT, NULL}, /* how pbrt samples its coat, not what it looks like */
        {{"nsamples"}, PARAM_ACCEPT, NULL},
    };
    (void)at, (void)record;
    return params_apply(params, rules, ARRAY_LENGTH(rules), p->report);
}

static result_t read_coated_metal(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    static const roughness_rule_t rule = {
        .names = {"conductor.roughness", "conductor.uroughness", "conductor.vroughness"}, .smooth = true};
    TRY(read_coat(p, params, at, record));
    TRY(material_read_metal(p, params, "conductor.eta", "conductor.k", VALUE_BASE_ETA, record));
    return material_read_roughness(p, params, &rule, VALUE_BASE_ROUGHNESS_U, at, record);
}

static result_t read_scale(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    (void)p, (void)at;
    double scale = 1;
    rgb_t *reflected = &record->values[VALUE_REFLECTANCE].factor;
    rgb_t *transmitted = &record->values[VALUE_TRANSMITTANCE].factor;
    TRY(params_float_in(params, "scale", 0, 1e6, &scale));
    *reflected = v_scale(*reflected, (float)scale);
    *transmitted = v_scale(*transmitted, (float)scale);
    return result_ok();
}

/* ---- hair --------------------------------------------------------------------------------------------- */

/* What may say how much light hair absorbs, in pbrt's order: each goes before those behind it. */
typedef struct {
    const char *name;
    material_value_t slot;
    bool given;
} pigment_t;
enum { PIGMENTS = 4 };

static result_t read_pigment(pbrt_t *p, params_t *params, pigment_t *pigment, blob_material_t *record)
{
    const params_t *owner;
    blob_value_t *value = &record->values[pigment->slot];
    bool number = pigment->slot == VALUE_EUMELANIN || pigment->slot == VALUE_PHEOMELANIN;
    unsigned types = (number ? PARAM_BIT(PARAM_FLOAT) : PARAM_COLOURS) | PARAM_BIT(PARAM_TEXTURE);
    pigment->given = params_find(params, pigment->name, types, &owner) != NULL;
    if (number) return pbrt_float_value(p, params, pigment->name, value);
    colour_use_t use = pigment->slot == VALUE_REFLECTANCE ? COLOUR_REFLECTANCE : COLOUR_UNBOUNDED;
    return pbrt_colour_value(p, params, pigment->name, use, value);
}

/* A pigment is left out where one of those before it is there. Both melanins go together. */
static void drop_pigments(pbrt_t *p, params_t *params, position_t at, pigment_t pigments[PIGMENTS],
                          blob_material_t *record)
{
    const pigment_t *counts = NULL;
    for (int i = 0; i < PIGMENTS; ++i) {
        if (!pigments[i].given) continue;
        if (!counts) counts = &pigments[i];
        if (&pigments[i] == counts || counts->slot == VALUE_EUMELANIN) continue;
        report_warning(p->report, params_where(params, pigments[i].name, at),
                       "\"%s\" is ignored, since there is \"%s\"", pigments[i].name, counts->name);
        record->values[pigments[i].slot] = blob_constant(0);
    }
    if (!counts) record->values[VALUE_EUMELANIN] = blob_constant(1.3f);
    if (counts && counts->slot == VALUE_REFLECTANCE) record->flags |= MATERIAL_DYED;
}

static result_t check_roughness_of_hair(pbrt_t *p, params_t *params, const char *name, position_t at,
                                        const blob_value_t *beta)
{
    position_t where = params_where(params, name, at);
    if (beta->texture != 0 || beta->factor.x <= 1) return result_ok();
    if (p->dialect.dialect == DIALECT_V3)
        return error_at(where, "\"%s\" is %g, but must be from 0 to 1", name, (double)beta->factor.x);
    report_warning(p->report, where, "\"%s\" is %g, and counts as 1, as in pbrt", name,
                   (double)beta->factor.x);
    return result_ok();
}

static result_t read_hair(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    bool v4 = p->dialect.dialect == DIALECT_V4 && !params_has(params, "color");
    pigment_t pigments[PIGMENTS] = {{"sigma_a", VALUE_ATTENUATION, false},
                                    {v4 ? "reflectance" : "color", VALUE_REFLECTANCE, false},
                                    {"eumelanin", VALUE_EUMELANIN, false},
                                    {"pheomelanin", VALUE_PHEOMELANIN, false}};
    TRY(check_roughness_of_hair(p, params, "beta_m", at, &record->values[VALUE_ROUGHNESS_U]));
    TRY(check_roughness_of_hair(p, params, "beta_n", at, &record->values[VALUE_ROUGHNESS_V]));
    for (int i = 0; i < PIGMENTS; ++i) TRY(read_pigment(p, params, &pigments[i], record));
    drop_pigments(p, params, at, pigments, record);
    return result_ok();
}

/* ---- the table ---------------------------------------------------------------------------------------- */

/* clang-format off */
#define BOTH_AXES    {"roughness", NULL, NULL}, false
#define EACH_AXIS    {NULL, "uroughness", "vroughness"}, false
#define ALL_AXES     {"roughness", "uroughness", "vroughness"}, false
#define AXES_OF_UBER {"roughness", "uroughness", "vroughness"}, true
#define WHITE     {CONSTANT, NULL, VALUE_REFLECTANCE, 1}
#define CLEAR     {CONSTANT, NULL, VALUE_TRANSMITTANCE, 1}
#define KR_AND_KT {COLOUR, "Kr", VALUE_REFLECTANCE, 1}, {COLOUR, "Kt", VALUE_TRANSMITTANCE, 1}
#define COAT      {NUMBER, "thickness", VALUE_THICKNESS, 0.01f}, {COLOUR, "albedo", VALUE_ALBEDO, 0}, \
                  {SIGNED, "g", VALUE_G, 0}
static const row_t rows[] = {
    {{"matte", DIALECT_V3}, MATERIAL_DIFFUSE,
     .values = {{COLOUR, "Kd", VALUE_REFLECTANCE, 0.5f}, {NUMBER, "sigma", VALUE_SIGMA, 0}}, .rest = clamp_sigma},
    {{"mirror", DIALECT_V3}, MATERIAL_MIRROR, .values = {{COLOUR, "Kr", VALUE_REFLECTANCE, 0.9f}}},
    {{"glass", DIALECT_V3}, MATERIAL_DIELECTRIC,
     .values = {KR_AND_KT}, .index = {"eta", "index", 1.5f}, .roughness = {EACH_AXIS, 0, true}},
    {{"metal", DIALECT_V3}, MATERIAL_CONDUCTOR,
     .values = {WHITE}, .roughness = {ALL_AXES, 0.01f, false}, .rest = read_metal},
    {{"plastic", DIALECT_V3}, MATERIAL_PLASTIC,
     .values = {{COLOUR, "Kd", VALUE_REFLECTANCE, 0.25f}, {COLOUR, "Ks", VALUE_SPECULAR, 0.25f}},
     .roughness = {BOTH_AXES, 0.1f, false}},
    {{"substrate", DIALECT_V3}, MATERIAL_SUBSTRATE,
     .values = {{COLOUR, "Kd", VALUE_REFLECTANCE, 0.5f}, {COLOUR, "Ks", VALUE_SPECULAR, 0.5f}},
     .roughness = {EACH_AXIS, 0.1f, false}},
    {{"translucent", DIALECT_V3}, MATERIAL_TRANSLUCENT,
     .values = {{COLOUR, "Kd", VALUE_REFLECTANCE, 0.25f}, {COLOUR, "Ks", VALUE_SPECULAR, 0.25f},
                {COLOUR, "reflect", VALUE_REFLECT, 0.5f}, {COLOUR, "transmit", VALUE_TRANSMIT, 0.5f}},
     .roughness = {BOTH_AXES, 0.1f, false}},
    {{"uber", DIALECT_V3}, MATERIAL_UBER,
     .values = {{COLOUR, "Kd", VALUE_REFLECTANCE, 0.25f}, {COLOUR, "Ks", VALUE_SPECULAR, 0.25f},
                {COLOUR, "Kr", VALUE_MIRROR, 0}, {COLOUR, "Kt", VALUE_TRANSMITTANCE, 0},
                {COLOUR, "opacity", VALUE_OPACITY, 1}},
     .index = {"eta", "index", 1.5f}, .roughness = {AXES_OF_UBER, 0.1f, false}},
    {{"disney", DIALECT_V3}, MATERIAL_DISNEY,
     .values = {{COLOUR, "color", VALUE_REFLECTANCE, 0.5f}, {NUMBER, "metallic", VALUE_METALLIC, 0},
                {NUMBER, "roughness", VALUE_ROUGHNESS_U, 0.5f}, {NUMBER, "speculartint", VALUE_SPECULAR_TINT, 0},
                {NUMBER, "anisotropic", VALUE_ANISOTROPIC, 0}, {NUMBER, "sheen", VALUE_SHEEN, 0},
                {NUMBER, "sheentint", VALUE_SHEEN_TINT, 0.5f}, {NUMBER, "clearcoat", VALUE_CLEARCOAT, 0},
                {NUMBER, "clearcoatgloss", VALUE_CLEARCOAT_GLOSS, 1}, {NUMBER, "spectrans", VALUE_TRANSMISSION, 0},
                {NUMBER, "flatness", VALUE_FLATNESS, 0}, {NUMBER, "difftrans", VALUE_DIFFUSE_TRANSMISSION, 1}},
     .index = {"eta", NULL, 1.5f}, .rest = read_thin},
    {{"fourier", DIALECT_V3}, MATERIAL_FOURIER, .rest = pbrt_read_fourier},
    {{"subsurface", DIALECT_V3}, MATERIAL_DIELECTRIC, .values = {KR_AND_KT},
     .index = {"eta", NULL, 1.33f}, .roughness = {EACH_AXIS, 0, true}, .rest = pbrt_read_subsurface},
    {{"kdsubsurface", DIALECT_V3}, MATERIAL_DIELECTRIC, .values = {KR_AND_KT},
     .index = {"eta", NULL, 1.33f}, .roughness = {EACH_AXIS, 0, true}, .rest = pbrt_read_kdsubsurface},
    {{"mix", DIALECT_V3}, MATERIAL_MIX, .values = {{COLOUR, "amount", VALUE_AMOUNT, 0.5f}}},

    {{"diffuse", DIALECT_V4}, MATERIAL_DIFFUSE, .values = {{COLOUR, "reflectance", VALUE_REFLECTANCE, 0.5f}}},
    {{"conductor", DIALECT_V4}, MATERIAL_CONDUCTOR,
     .values = {WHITE}, .roughness = {ALL_AXES, 0, true}, .rest = read_metal},
    {{"dielectric", DIALECT_V4}, MATERIAL_DIELECTRIC,
     .values = {WHITE, CLEAR}, .index = {"eta", NULL, 1.5f}, .roughness = {ALL_AXES, 0, true}},
    {{"thindielectric", DIALECT_V4}, MATERIAL_DIELECTRIC,
     .flags = MATERIAL_THIN, .values = {WHITE, CLEAR}, .index = {"eta", NULL, 1.5f}},
    {{"coateddiffuse", DIALECT_V4}, MATERIAL_COATED_DIFFUSE,
     .values = {{COLOUR, "reflectance", VALUE_REFLECTANCE, 0.5f}, COAT},
     .index = {"eta", NULL, 1.5f}, .roughness = {ALL_AXES, 0, true}, .rest = read_coat},
    {{"coatedconductor", DIALECT_V4}, MATERIAL_COATED_CONDUCTOR,
     .values = {COAT}, .index = {"interface.eta", NULL, 1.5f},
     .roughness = {{"interface.roughness", "interface.uroughness", "interface.vroughness"}, false, 0, true},
     .rest = read_coated_metal},
    {{"diffusetransmission", DIALECT_V4}, MATERIAL_DIFFUSE_TRANSMISSION,
     .values = {{COLOUR, "reflectance", VALUE_REFLECTANCE, 0.25f},
                {COLOUR, "transmittance", VALUE_TRANSMITTANCE, 0.25f}},
     .rest = read_scale},
    {{"subsurface", DIALECT_V4}, MATERIAL_DIELECTRIC, .values = {WHITE, CLEAR},
     .index = {"eta", NULL, 1.33f}, .roughness = {ALL_AXES, 0, true}, .rest = pbrt_read_subsurface},
    {{"measured", DIALECT_V4}, MATERIAL_MEASURED, .rest = pbrt_read_measured},
    {{"interface", DIALECT_V4}, .kind = 0},
    {{"mix", DIALECT_V4}, MATERIAL_MIX, .values = {{NUMBER, "amount", VALUE_AMOUNT, 0.5f}}},

    {{"none", DIALECT_BOTH}, .kind = 0},
    {{"", DIALECT_BOTH}, .kind = 0},
    {{"hair", DIALECT_BOTH}, MATERIAL_HAIR,
     .values = {{NUMBER, "beta_m", VALUE_ROUGHNESS_U, 0.3f}, {NUMBER, "beta_n", VALUE_ROUGHNESS_V, 0.3f},
                {SIGNED, "alpha", VALUE_TILT, 2}},
     .index = {"eta", NULL, 1.55f}, .rest = read_hair},
};
/* clang-format on */

result_t material_find(pbrt_t *p, const char *name, position_t at, size_t *entry)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    if (!entry_knows(rows, ARRAY_LENGTH(rows), sizeof *rows, name)) {
        const char *nearest = v3 ? "matte" : "diffuse";
        TRY(v3 ? pbrt_slip(p, at, "that is \"matte\"", "unknown material \"%.40s\"", name)
               : report_refuse(p->report, at, "unknown material \"%.40s\"; the nearest is \"%s\"", name,
                               nearest));
        name = nearest;
    }
    return entry_find(rows, ARRAY_LENGTH(rows), sizeof *rows, "material", name, &p->dialect, at, entry);
}

material_kind_t material_kind(size_t entry)
{
    return rows[entry].kind;
}

/* ---- filling ------------------------------------------------------------------------------------------ */

static result_t read_value(pbrt_t *p, params_t *params, const value_rule_t *rule, blob_material_t *record)
{
    blob_value_t *value = &record->values[rule->slot];
    *value = blob_constant(rule->otherwise);
    switch (rule->kind) {
    case NUMBER:
        return pbrt_float_value(p, params, rule->name, value);
    case SIGNED:
        return pbrt_signed_value(p, params, rule->name, value);
    case COLOUR:
        return pbrt_colour_value(p, params, rule->name, COLOUR_REFLECTANCE, value);
    default:
        return result_ok();
    }
}

/* The parameter with the index of refraction. pbrt-v3 asks for numbers alone: one of the older name goes
 * before a spectrum. */
static const char *index_name(params_t *params, const row_t *row)
{
    const params_t *owner;
    const unsigned number = PARAM_BIT(PARAM_FLOAT) | PARAM_BIT(PARAM_TEXTURE);
    const char *name = row->index.name, *older = row->index.older;
    if (!older || params_find(params, name, number, &owner)) return name;
    return params_find(params, older, number, &owner) || !params_has(params, name) ? older : name;
}

static result_t read_index(pbrt_t *p, params_t *params, const row_t *row, position_t at,
                           blob_material_t *record)
{
    const char *name = index_name(params, row);
    return name ? material_read_index(p, params, name, row->index.otherwise, at, record) : result_ok();
}

result_t material_fill(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record)
{
    const row_t *row = &rows[material->entry];
    const char *const *axes = row->roughness.names;
    position_t at = material->at;
    record->kind = row->kind;
    record->flags = row->flags;
    for (int i = 0; i < MOST_VALUES && row->values[i].kind != END; ++i)
        TRY(read_value(p, params, &row->values[i], record));
    TRY(read_index(p, params, row, at, record));
    if (axes[0] || axes[1])
        TRY(material_read_roughness(p, params, &row->roughness, VALUE_ROUGHNESS_U, at, record));
    return row->rest ? row->rest(p, params, at, record) : result_ok();
}
