/* materials: Material, MakeNamedMaterial, NamedMaterial, and how shapes get what they make.
 *
 * A directive only stores its parameters. The blob's record is made when the first shape has the material;
 * a v3 shape whose own parameters override the material's gets a record of its own. Interfaces between media
 * have no record but one for all shapes that part two media; their other shapes are left out.
 */
#include "client/import/pbrt/materials/materials.h"

#include "client/import/pbrt/materials/material_table.h"
#include "client/import/pbrt/materials/textures.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/values.h"

/* ---- mixes -------------------------------------------------------------------------------------------- */

static result_t make_once(pbrt_t *p, material_t *material);

/* The name of a part of a mix, in the blob's order: AMOUNT is the share of the second, which is v3's first.
 */
static result_t part_name(pbrt_t *p, params_t *params, position_t at, int part, const char **name)
{
    *name = NULL;
    if (p->dialect.dialect == DIALECT_V3) {
        const char *parameter = part == 0 ? "namedmaterial2" : "namedmaterial1";
        TRY(params_string(params, parameter, name));
        if (*name) return result_ok();
        *name = "";
        return pbrt_slip(p, at, "that is \"matte\"", "a mix needs \"string %s\"", parameter);
    }
    const params_t *owner;
    const param_t *item = params_find(params, "materials", PARAM_BIT(PARAM_STRING), &owner);
    if (!item || item->count != 2)
        return error_at(params_where(params, "materials", at), "a mix needs two \"string materials\"");
    *name = params_text(owner, item, (size_t)part);
    return result_ok();
}

/* The parts that are known by name when the mix is; v4 lets it name materials that come later. */
static result_t find_parts(pbrt_t *p, material_t *material)
{
    for (int i = 0; i < 2; ++i) {
        const char *name;
        uint32_t index;
        TRY(part_name(p, material->params, material->at, i, &name));
        if (material->parts[i] == 0 && names_find(&p->material_names, name, &index))
            material->parts[i] = index + 1;
    }
    return result_ok();
}

static int mix_depth(const blob_material_t *records, uint32_t index)
{
    if (records[index].kind != MATERIAL_MIX) return 0;
    return 1 +
           int_max(mix_depth(records, records[index].parts[0]), mix_depth(records, records[index].parts[1]));
}

static result_t make_part(pbrt_t *p, params_t *params, const material_t *material, int i,
                          blob_material_t *record)
{
    const char *name;
    uint32_t index = material->parts[i] - 1;
    TRY(part_name(p, params, material->at, i, &name));
    if (material->parts[i] == 0 && !names_find(&p->material_names, name, &index)) {
        TRY(pbrt_slip(p, material->at, "that is \"matte\"", "no MakeNamedMaterial \"%.60s\" for this mix",
                      name));
        index = 0; /* the default */
    }
    material_t *part = &p->materials[index];
    if (part->making) return error_at(material->at, "this mix contains itself");
    TRY(make_once(p, part));
    if (part->index == BLOB_NONE)
        return error_at(material->at, "a mix with the interface \"%.60s\" is not supported", name);
    record->parts[i] = part->index;
    if (mix_depth(blob_builder_records(p->builder->blob, BLOB_SECTION_MATERIALS), part->index) >=
        BLOB_MAX_MIX_DEPTH)
        return error_at(material->at, "mixes are nested deeper than %d", BLOB_MAX_MIX_DEPTH);
    return result_ok();
}

/* Below a mix is what is below its parts. */
static result_t share_body(pbrt_t *p, const material_t *material, blob_material_t *record)
{
    const blob_material_t *records = blob_builder_records(p->builder->blob, BLOB_SECTION_MATERIALS);
    blob_ref_t first = records[record->parts[0]].body, second = records[record->parts[1]].body;
    record->body = first != 0 ? first : second;
    if (first == 0 || second == 0 || first == second) return result_ok();
    return report_refuse(
        p->report, material->at,
        "both parts of this mix scatter light below the surface, each in its own way, which is "
        "not supported; the nearest is that of one of them");
}

static result_t make_parts(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record)
{
    TRY(make_part(p, params, material, 0, record));
    TRY(make_part(p, params, material, 1, record));
    TRY(share_body(p, material, record));
    if (p->dialect.dialect != DIALECT_V3) {
        scene_choose_parts(p->builder, record);
        return result_ok();
    }
    /* In pbrt-v3 the lobes of both move into the frame that namedmaterial1 has made. */
    const blob_material_t *records = blob_builder_records(p->builder->blob, BLOB_SECTION_MATERIALS);
    record->bump = records[record->parts[1]].bump;
    return result_ok();
}

/* ---- the directives ------------------------------------------------------------------------------------ */

static uint32_t store(pbrt_t *p, size_t entry, params_t *params, position_t at, char *name)
{
    p->materials = grow(p->materials, &p->material_capacity, p->material_count + 1, sizeof *p->materials);
    material_t *material = &p->materials[p->material_count];
    *material = (material_t){.entry = entry,
                             .params = params,
                             .at = at,
                             .colour_space = p->now.colour_space,
                             .name = name,
                             .textures = {p->texture_names[0].count, p->texture_names[1].count}};
    if (params && material_kind(entry) == MATERIAL_MIX)
        (void)find_parts(p, material); /* made, it says what is wrong */
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
    size_t entry;
    position_t at = {.path = "default material"};
    (void)material_find(p, p->dialect.dialect == DIALECT_V3 ? "matte" : "diffuse", at,
                        &entry); /* which are rows */
    p->now.material = store(p, entry, params_new(), at, mem_strdup("default material"));
}

result_t pbrt_material(pbrt_t *p, position_t at)
{
    size_t entry;
    TRY(pbrt_read_string(p, 0, "the material's type"));
    TRY(pbrt_read_params_for(p, TARGET_MATERIAL));
    TRY(material_find(p, p->arguments[0], at, &entry));
    p->now.material = store(p, entry, take_params(p), at, mem_printf("%s:%u", p->source->label, at.line));
    return result_ok();
}

/* A material that was named before it is made. */
static void fill(pbrt_t *p, uint32_t index, size_t entry, position_t at)
{
    char *name = p->materials[index].name;
    size_t last = store(p, entry, take_params(p), at, name); /* which may move the materials */
    p->materials[index] = p->materials[last];
    --p->material_count;
}

result_t pbrt_make_named_material(pbrt_t *p, position_t at)
{
    size_t entry;
    uint32_t old;
    const char *type = NULL;
    TRY(pbrt_read_string(p, 0, "the material's name"));
    TRY(pbrt_read_params_for(p, TARGET_MATERIAL));
    TRY(params_string(p->params, "type", &type));
    if (!type) {
        TRY(pbrt_slip(p, at, "that is an interface between media",
                      "MakeNamedMaterial needs a parameter \"string type\""));
        type = "";
    }
    TRY(material_find(p, type, params_where(p->params, "type", at), &entry));
    if (names_find(&p->material_names, p->arguments[0], &old)) {
        if (!p->materials[old].params) {
            fill(p, old, entry, at);
            return result_ok();
        }
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
    if (!names_find(&p->material_names, p->arguments[0], &index)) {
        if (p->dialect.dialect == DIALECT_V3)
            return pbrt_slip(p, at, "the material stays what it was",
                             "no MakeNamedMaterial \"%.60s\" came before", p->arguments[0]);
        index = store(p, 0, NULL, at, mem_strdup(p->arguments[0])); /* v4 lets it come later */
        names_add(&p->material_names, p->arguments[0], index);
    }
    p->now.material = index;
    return result_ok();
}

/* ---- making them --------------------------------------------------------------------------------------- */

/* pbrt-v4's normal map takes the place of bumps. */
static result_t read_normal_map(pbrt_t *p, params_t *params, blob_material_t *record)
{
    const char *filename = NULL;
    TRY(params_string(params, "normalmap", &filename));
    if (!filename) return result_ok();
    if (record->bump != 0)
        report_warning(p->report, params_where(params, "displacement", (position_t){.path = ""}),
                       "\"displacement\" is ignored, since there is \"normalmap\", as in pbrt-v4");
    record->bump = 0;
    record->flags |= MATERIAL_NORMALS_V4;
    position_t at = params_where(params, "normalmap", (position_t){.path = ""});
    return pbrt_normal_map(p, filename, at, &record->normal_map);
}

/* What every material may have: bumps (v3's bumpmap, v4's displacement) and v4's normal map. */
static result_t read_relief(pbrt_t *p, params_t *params, blob_material_t *record)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    if (record->kind == MATERIAL_HAIR) return result_ok(); /* has none */
    const char *name = v3 ? "bumpmap" : "displacement";
    blob_value_t bump = blob_constant(0);
    record->normal_scale = 1;
    if (v3 && record->kind == MATERIAL_MIX) return result_ok(); /* has that of a part */
    TRY(pbrt_signed_value(p, params, name, &bump));
    if (bump.texture != 0 && !(bump.factor.x == 1 && bump.factor.y == 1 && bump.factor.z == 1)) {
        blob_texture_t scaled = {.kind = TEXTURE_SCALE, .inputs = {bump, blob_constant(1)}};
        bump = scene_add_texture(p->builder, &scaled);
    }
    record->bump = bump.texture; /* a constant turns no normal */
    return v3 ? result_ok() : read_normal_map(p, params, record);
}

/* pbrt-v4 takes what surfaces reflect for at most 1, also where it comes from textures. */
static void limit_shares(const pbrt_t *p, blob_material_t *record)
{
    static const material_value_t shares[] = {VALUE_REFLECTANCE, VALUE_TRANSMITTANCE, VALUE_ALBEDO,
                                              VALUE_AMOUNT};
    if (p->dialect.dialect == DIALECT_V3) return;
    for (size_t i = 0; i < ARRAY_LENGTH(shares); ++i) {
        const blob_value_t *value = &record->values[shares[i]];
        if (value->texture != 0 || v_max(value->factor) > 1) record->flags |= MATERIAL_UNIT;
    }
}

static result_t make(pbrt_t *p, material_t *material, params_t *params, blob_material_t *record)
{
    const material_t *outer = p->in_the_making; /* a mix, of which this is a part */
    *record = (blob_material_t){0};
    p->has_body = false;
    p->body = (blob_medium_t){0};
    size_t colour_space = p->now.colour_space;
    p->now.colour_space = material->colour_space;
    material->making = true;
    p->in_the_making = material;
    result_t result = material_fill(p, params, material, record);
    if (result.code == RESULT_OK && record->kind == MATERIAL_MIX)
        result = make_parts(p, params, material, record);
    if (result.code == RESULT_OK) result = read_relief(p, params, record);
    material->making = false;
    p->in_the_making = outer;
    p->now.colour_space = colour_space;
    if (result.code == RESULT_OK) limit_shares(p, record);
    return result;
}

static uint32_t append(pbrt_t *p, const material_t *material, blob_material_t record)
{
    if (record.kind == 0) return BLOB_NONE;
    record.name = blob_builder_string(p->builder->blob, material->name);
    if (p->has_body) {
        p->body.name = record.name;
        record.body = 1 + blob_builder_add(p->builder->blob, BLOB_SECTION_MEDIA, &p->body, 1);
        p->has_body = false;
    }
    return blob_builder_add(p->builder->blob, BLOB_SECTION_MATERIALS, &record, 1);
}

static result_t make_once(pbrt_t *p, material_t *material)
{
    if (material->made) return result_ok();
    if (!material->params)
        return error_at(material->at, "there is no MakeNamedMaterial \"%.60s\"", material->name);
    blob_material_t record;
    TRY(make(p, material, material->params, &record));
    TRY(params_finish(material->params, "this material", p->dialect.dialect == DIALECT_V4, p->report));
    material->index = append(p, material, record);
    material->made = true;
    return result_ok();
}

uint32_t pbrt_interface_material(pbrt_t *p)
{
    blob_material_t record = {.kind = MATERIAL_INTERFACE, .normal_scale = 1};
    if (p->interface == 0)
        p->interface = 1 + blob_builder_add(p->builder->blob, BLOB_SECTION_MATERIALS, &record, 1);
    return p->interface - 1;
}

/* A light needs a surface that emits: a v3 interface that does becomes a black one, which also stops light.
 */
static uint32_t black_material(pbrt_t *p, material_t *material)
{
    if (material->black != 0) return material->black - 1;
    blob_material_t record = {.kind = MATERIAL_DIFFUSE, .normal_scale = 1};
    report_warning(p->report, material->at, "an interface that emits light is a black surface here");
    material->black = 1 + append(p, material, record);
    return material->black - 1;
}

/* ---- v4: materials that shapes have before all that they name is known -----------------------------------
 */

static bool texture_is_known(const void *context, const char *texture)
{
    const pbrt_t *p = context;
    uint32_t index;
    return names_find(&p->texture_names[0], texture, &index) ||
           names_find(&p->texture_names[1], texture, &index);
}

static bool is_ready(pbrt_t *p, material_t *material, int depth)
{
    if (material->made || depth > BLOB_MAX_MIX_DEPTH) return true; /* too deep: making it says so */
    if (!material->params || !params_textures_known(material->params, texture_is_known, p)) return false;
    if (material_kind(material->entry) != MATERIAL_MIX || find_parts(p, material).code != RESULT_OK)
        return true;
    for (int i = 0; i < 2; ++i)
        if (material->parts[i] == 0 || !is_ready(p, &p->materials[material->parts[i] - 1], depth + 1))
            return false;
    return true;
}

enum { LATE = 1u << 31 }; /* with an index in materials: a shape's material that is made at the end */

void pbrt_warn_of_flat_curves(pbrt_t *p, position_t at)
{
    if (p->flat_curves) return;
    p->flat_curves = true;
    report_warning(p->report, at, "flat curves are taken for round ones, here and further down");
}

/* Curves that were there before it was known that they are not of hair. */
static void make_round(pbrt_t *p, const material_t *material, const blob_shape_t *shape)
{
    blob_curves_t *curves = blob_builder_records(p->builder->blob, BLOB_SECTION_CURVES);
    uint32_t *kind = &curves[shape->geometry].kind;
    if (*kind == CURVES_FLAT_FIBRE) pbrt_warn_of_flat_curves(p, material->at);
    if (curves_are_fibres(*kind)) *kind = CURVES_ROUND;
}

static result_t finish_material(pbrt_t *p, blob_shape_t *shape)
{
    if (!(shape->material & LATE)) return result_ok();
    material_t *material = &p->materials[shape->material & ~LATE];
    TRY(make_once(p, material));
    shape->material = material->index;
    if (material->index != BLOB_NONE) {
        if (shape->kind == SHAPE_CURVES && material_kind(material->entry) != MATERIAL_HAIR)
            make_round(p, material, shape);
        return result_ok();
    }
    if (!(shape->flags & SHAPE_INTERFACE) || shape->light != BLOB_NONE || shape->kind == SHAPE_CURVES)
        return error_at(material->at, "an interface must be made before a shape has it");
    shape->material = pbrt_interface_material(p);
    return result_ok();
}

result_t pbrt_finish_materials(pbrt_t *p)
{
    blob_shape_t *shapes;
    size_t count;
    for (uint32_t object = 0; object < p->builder->object_count; ++object) {
        shapes = scene_shapes(p->builder, object, &count);
        for (size_t i = 0; i < count; ++i) TRY(finish_material(p, &shapes[i]));
    }
    return result_ok();
}

result_t pbrt_shape_material(pbrt_t *p, params_t *shape_params, uint32_t *index)
{
    material_t *material = &p->materials[p->now.material];
    *index = LATE | p->now.material;
    if (p->dialect.dialect == DIALECT_V4 && !is_ready(p, material, 0)) return result_ok();
    TRY(make_once(p, material));
    *index = material->index;
    if (*index == BLOB_NONE && p->now.emits && p->object == 0) {
        if (p->dialect.dialect == DIALECT_V3)
            *index = black_material(p, material);
        else
            report_warning(p->report, material->at,
                           "an interface does not emit, as in pbrt: its area light is ignored");
    }
    size_t unread = params_unread(shape_params);
    if (p->dialect.dialect != DIALECT_V3 || unread == 0 || *index == BLOB_NONE) return result_ok();

    blob_material_t record;
    params_set_fallback(shape_params, material->params);
    result_t result = make(p, material, shape_params, &record);
    params_set_fallback(shape_params, NULL);
    TRY(result);
    if (params_unread(shape_params) < unread) *index = append(p, material, record);
    p->has_body = false; /* of a material that the shape does not change */
    return result_ok();
}

bool pbrt_material_may_be_hair(const pbrt_t *p)
{
    const material_t *material = &p->materials[p->now.material];
    if (material->params) return material_kind(material->entry) == MATERIAL_HAIR;
    return p->dialect.dialect == DIALECT_V4 && !material->made;
}

void pbrt_check_unused_materials(pbrt_t *p)
{
    for (size_t i = 1; i < p->material_count; ++i) { /* 0 is the default */
        material_t *material = &p->materials[i];
        if (material->made || !material->params) continue;
        blob_material_t record;
        result_t result = make(p, material, material->params, &record);
        if (result.code == RESULT_OK)
            result = params_finish(material->params, "this material", true, p->report);
        if (result.code != RESULT_OK)
            report_warning(p->report, material->at, "a material that no shape has: %s", result.message);
    }
}
