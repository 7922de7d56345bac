/* media: see media.h.
 *
 * A name gets an entry when it is first said, by either directive. An interface keeps entries; what they are
 * is asked when a shape or a light has the interface, as in pbrt-v3, where a name may change its meaning. In
 * v4 it cannot, but may come later: a reference to such a medium is LATE and an entry, until the end. */
#include "client/import/pbrt/materials/media.h"

#include "client/import/pbrt/materials/materials.h"
#include "client/import/pbrt/materials/medium_fields.h"
#include "client/import/pbrt/materials/named_media.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/values.h"
#include "client/import/scene/mesh.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LATE = 1u << 31 };

/* ---- names --------------------------------------------------------------------------------------------- */

/* 1 + the entry of a name; 0 of "", which is empty space. */
static uint32_t entry_of(pbrt_t *p, const char *name, position_t at)
{
    uint32_t index;
    if (*name == '\0') return 0;
    if (names_find(&p->medium_names, name, &index)) return index + 1;
    p->media = grow(p->media, &p->medium_capacity, p->medium_count + 1, sizeof *p->media);
    index = (uint32_t)p->medium_count++;
    p->media[index] = (medium_t){.at = at, .name = mem_strdup(name)};
    names_add(&p->medium_names, name, index);
    return index + 1;
}

/* About a medium that is none, since its type is not supported (v4) or nothing has made it: said once. */
static result_t refuse(pbrt_t *p, medium_t *medium)
{
    if (medium->told) return result_ok();
    medium->told = true;
    if (medium->made)
        return report_refuse(p->report, medium->at,
                             "medium \"%.60s\": the type \"%.40s\" is not supported; the nearest is empty "
                             "space",
                             medium->name, medium->type);
    return pbrt_slip(p, medium->at, "that is empty space", "there is no MakeNamedMedium \"%.60s\"",
                     medium->name);
}

static result_t find(pbrt_t *p, uint32_t entry, blob_ref_t *ref)
{
    *ref = 0;
    if (entry == 0) return result_ok();
    medium_t *medium = &p->media[entry - 1];
    *ref = medium->record;
    if (*ref != 0) return result_ok();
    if (medium->made || p->dialect.dialect == DIALECT_V3) return refuse(p, medium);
    medium->awaited = true;
    *ref = LATE | (entry - 1);
    return result_ok();
}

/* ---- what a medium is made of -------------------------------------------------------------------------- */

static bool is_rate(rgb_t c)
{
    return c.x >= 0 && c.y >= 0 && c.z >= 0 && (double)v_max(c) <= BLOB_MAX_NUMBER;
}

/* The coefficients of a medium that names a preset, or of one that says nothing. */
static result_t read_preset(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium, bool *known)
{
    const char *preset = "";
    bool v3 = p->dialect.dialect == DIALECT_V3;
    medium->absorption = v3 ? vec3(0.0011f, 0.0024f, 0.014f) : vec3(1, 1, 1);
    medium->scattering = v3 ? vec3(2.55f, 3.21f, 3.77f) : vec3(1, 1, 1);
    *known = false;
    TRY(params_string(params, "preset", &preset));
    if (*preset == '\0') return result_ok();
    *known = named_medium_coefficients(preset, &medium->absorption, &medium->scattering);
    if (*known) return result_ok();
    return report_tolerate(p->report, params_where(params, "preset", at),
                           "no preset is called \"%.60s\"; it is ignored, as by pbrt", preset);
}

static result_t read_g(params_t *params, position_t at, blob_medium_t *medium)
{
    double g = 0;
    TRY(params_float(params, "g", &g));
    medium->g = (float)g;
    if (medium->g > -1 && medium->g < 1) return result_ok();
    return error_at(params_where(params, "g", at), "g is %g, but must be over -1 and below 1", g);
}

static result_t scale_coefficients(params_t *params, position_t at, blob_medium_t *medium)
{
    double scale = 1;
    TRY(params_float_in(params, "scale", 0, 1e30, &scale));
    medium->absorption = v_scale(medium->absorption, (float)scale);
    medium->scattering = v_scale(medium->scattering, (float)scale);
    if (is_rate(medium->absorption) && is_rate(medium->scattering)) return result_ok();
    return error_at(at, "sigma_a and sigma_s, times the scale, must be from 0 to %g", BLOB_MAX_NUMBER);
}

/* In v4 a preset goes before coefficients, which are left unread. */
static result_t read_coefficients(pbrt_t *p, params_t *params, position_t at, bool presets,
                                  blob_medium_t *medium)
{
    bool known = false;
    medium->absorption = medium->scattering = vec3(1, 1, 1);
    if (presets) TRY(read_preset(p, params, at, medium, &known));
    if (!known || p->dialect.dialect == DIALECT_V3) {
        TRY(pbrt_colour(p, params, "sigma_a", COLOUR_UNBOUNDED, &medium->absorption));
        TRY(pbrt_colour(p, params, "sigma_s", COLOUR_UNBOUNDED, &medium->scattering));
    }
    TRY(scale_coefficients(params, at, medium));
    return read_g(params, at, medium);
}

/* What a medium of v4 shines: `Le` is the radiance of an infinite depth of what absorbs and does not scatter.
 */
static result_t read_emission(pbrt_t *p, params_t *params, position_t at, double scale, blob_medium_t *medium)
{
    rgb_t radiance = vec3(0, 0, 0);
    TRY(pbrt_colour(p, params, "Le", COLOUR_LIGHT, &radiance));
    medium->emission = v_scale(v_mul(medium->absorption, radiance), (float)scale);
    if (is_rate(medium->emission)) return result_ok();
    return error_at(params_where(params, "Le", at), "Le, times sigma_a, must be from 0 to %g",
                    BLOB_MAX_NUMBER);
}

/* ---- the types ----------------------------------------------------------------------------------------- */

static result_t make_homogeneous(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    double scale = 1;
    TRY(read_coefficients(p, params, at, true, medium));
    if (p->dialect.dialect == DIALECT_V3) return result_ok();
    TRY(params_float_in(params, "Lescale", 0, 1e30, &scale));
    return read_emission(p, params, at, scale, medium);
}

/* Whether the same share of light is lost in all colours. */
static bool is_grey(const blob_medium_t *medium)
{
    rgb_t loss = v_add(medium->absorption, medium->scattering);
    return v_max(loss) - fminf(fminf(loss.x, loss.y), loss.z) <= 1e-5f * v_max(loss);
}

static result_t make_heterogeneous(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    TRY(read_coefficients(p, params, at, true, medium));
    if (!is_grey(medium))
        report_warning(p->report, at,
                       "sigma_a + sigma_s differs between colours: pbrt-v3 takes that of red for all, here "
                       "each colour has its own");
    return medium_density_cells(p, params, at, medium);
}

static result_t make_uniform_grid(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    TRY(read_coefficients(p, params, at, false, medium));
    TRY(medium_density_cells(p, params, at, medium));
    if (params_has(params, "temperature"))
        TRY(medium_temperature_cells(p, params, at, medium));
    else
        TRY(read_emission(p, params, at, 1, medium));
    return medium_emission_cells(p, params, at, medium);
}

static result_t make_rgb_grid(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    medium->absorption = medium->scattering = vec3(1, 1, 1);
    TRY(scale_coefficients(params, at, medium));
    TRY(medium_tints(p, params, at, medium));
    return read_g(params, at, medium);
}

static result_t make_cloud(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    TRY(read_coefficients(p, params, at, false, medium));
    return medium_cloud(p, params, at, medium);
}

static result_t make_nanovdb(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    TRY(read_coefficients(p, params, at, false, medium));
    return medium_nanovdb(p, params, at, medium);
}

typedef struct {
    dialect_entry_t entry;
    result_t (*make)(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);
} medium_entry_t;

static const medium_entry_t types[] = {
    {{"homogeneous", DIALECT_BOTH}, make_homogeneous},
    {{"heterogeneous", DIALECT_V3}, make_heterogeneous},
    {{"uniformgrid", DIALECT_V4}, make_uniform_grid},
    {{"rgbgrid", DIALECT_V4}, make_rgb_grid},
    {{"cloud", DIALECT_V4}, make_cloud},
    {{"nanovdb", DIALECT_V4}, make_nanovdb},
};

/* ---- the directives ------------------------------------------------------------------------------------ */

static result_t make_medium(pbrt_t *p, position_t at, const char *type, uint32_t index)
{
    size_t row;
    blob_medium_t record = {0};
    TRY(entry_find(types, ARRAY_LENGTH(types), sizeof *types, "medium", type, &p->dialect,
                   params_where(p->params, "type", at), &row));
    TRY(types[row].make(p, p->params, at, &record));
    record.name = blob_builder_string(p->builder->blob, p->media[index].name);
    p->media[index].record = 1 + blob_builder_add(p->builder->blob, BLOB_SECTION_MEDIA, &record, 1);
    return pbrt_finish_params(p, "MakeNamedMedium", p->media[index].name);
}

/* A medium that is made again: what has it keeps the old one, as in pbrt-v3. */
static result_t check_new(pbrt_t *p, medium_t *medium, position_t at)
{
    if (!medium->made) return result_ok();
    if (p->dialect.dialect == DIALECT_V4)
        return error_at(at, "the medium \"%.60s\" has been made before, in line %u", medium->name,
                        medium->at.line);
    report_warning(p->report, at, "the medium \"%.60s\" of line %u is replaced", medium->name,
                   medium->at.line);
    return result_ok();
}

result_t pbrt_make_named_medium(pbrt_t *p, position_t at)
{
    const char *type = NULL;
    TRY(pbrt_read_string(p, 0, "the medium's name"));
    TRY(pbrt_read_params_for(p, TARGET_MEDIUM));
    TRY(params_string(p->params, "type", &type));
    if (!type) return pbrt_slip(p, at, "it is left out", "MakeNamedMedium needs a parameter \"string type\"");
    bool known = entry_knows(types, ARRAY_LENGTH(types), sizeof *types, type);
    if (!known && p->dialect.dialect == DIALECT_V3)
        return pbrt_slip(p, at, "it is left out", "unknown type of medium \"%.40s\"", type);
    if (p->arguments[0][0] == '\0') return error_at(at, "the medium's name is empty");
    uint32_t index = entry_of(p, p->arguments[0], at) - 1;
    medium_t *medium = &p->media[index];
    TRY(check_new(p, medium, at));
    medium->made = true;
    medium->at = at;
    snprintf(medium->type, sizeof medium->type, "%s", type);
    if (known) return make_medium(p, at, type, index);
    report_warning(p->report, at,
                   "medium \"%.60s\" is ignored: the type \"%.40s\" is not supported, using it is an error",
                   medium->name, type);
    return result_ok();
}

result_t pbrt_medium_interface(pbrt_t *p, position_t at)
{
    token_t token;
    TRY(pbrt_read_string(p, 0, "the name of the medium inside"));
    p->now.media[0] = p->now.media[1] = entry_of(p, p->arguments[0], at);
    TRY(lexer_peek(&p->lexer, &token));
    if (token.kind != TOKEN_STRING) return result_ok();
    TRY(pbrt_read_string(p, 0, "the name of the medium outside"));
    p->now.media[1] = entry_of(p, p->arguments[0], at);
    return result_ok();
}

/* ---- what has them ------------------------------------------------------------------------------------- */

result_t pbrt_media_in_force(pbrt_t *p, blob_ref_t media[2])
{
    TRY(find(p, p->now.media[0], &media[0]));
    return find(p, p->now.media[1], &media[1]);
}

result_t pbrt_medium_outside(pbrt_t *p, blob_ref_t *medium)
{
    return find(p, p->now.media[1], medium);
}

/* A reference that had to wait. */
static void settle(const pbrt_t *p, blob_ref_t *ref)
{
    if (*ref & LATE) *ref = p->media[*ref & ~LATE].record;
}

static void settle_all(pbrt_t *p)
{
    size_t count = blob_builder_count(p->builder->blob, BLOB_SECTION_LIGHTS);
    blob_light_t *lights = blob_builder_records(p->builder->blob, BLOB_SECTION_LIGHTS);
    for (size_t i = 0; i < count; ++i) settle(p, &lights[i].medium);
    for (uint32_t object = 0; object < p->builder->object_count; ++object) {
        blob_shape_t *shapes = scene_shapes(p->builder, object, &count);
        for (size_t i = 0; i < 2 * count; ++i) settle(p, &shapes[i / 2].media[i % 2]);
    }
}

/* The camera stands outside of the interface in force at its directive. pbrt-v3 takes what is in force at
 * WorldEnd. */
static result_t place_camera(pbrt_t *p, position_t at)
{
    if (p->dialect.dialect == DIALECT_V3 && p->now.media[1] != p->camera_medium)
        report_warning(p->report, p->camera_at.line ? p->camera_at : at,
                       "the camera stands in the medium outside of the MediumInterface at Camera; pbrt-v3 "
                       "puts it into that at WorldEnd, which is another: let both be the same");
    return find(p, p->camera_medium, &p->scene.medium);
}

/* Whether no shape that lets light through says that there is empty space beyond a medium. */
static bool is_open(const pbrt_t *p, blob_ref_t medium)
{
    const blob_material_t *materials = blob_builder_records(p->builder->blob, BLOB_SECTION_MATERIALS);
    for (uint32_t object = 0; object < p->builder->object_count; ++object) {
        size_t count;
        const blob_shape_t *shapes = scene_shapes(p->builder, object, &count);
        for (size_t i = 0; i < count; ++i) {
            const blob_ref_t *media = shapes[i].media;
            bool ends = (media[0] == medium && media[1] == 0) || (media[0] == 0 && media[1] == medium);
            if (materials[shapes[i].material].kind == MATERIAL_INTERFACE && ends) return false;
        }
    }
    return true;
}

/* Puts an interface around a grid: the faces of its box, a little larger, since a room that it fills has its
 * walls there. Light from infinity gets in, which would start beside the grid otherwise. */
static result_t enclose(pbrt_t *p, blob_ref_t medium, const blob_field_t *field, position_t at)
{
    static const blob_triangle_t faces[12] = {{{0, 2, 1}}, {{1, 2, 3}}, {{4, 5, 6}}, {{5, 7, 6}},
                                              {{0, 1, 4}}, {{1, 5, 4}}, {{2, 6, 3}}, {{3, 6, 7}},
                                              {{0, 4, 2}}, {{2, 4, 6}}, {{1, 3, 5}}, {{3, 7, 5}}};
    static const float face[2] = {-0.0005f, 1.0005f};
    affine_t world_from_box;
    for (size_t i = 0; i < 12; ++i) world_from_box.m[i / 4][i % 4] = field->world_from_field.m[i / 4][i % 4];
    mesh_t mesh = {.vertex_count = 8, .triangle_count = ARRAY_LENGTH(faces)};
    mesh.positions = mem_alloc(mesh.vertex_count * sizeof *mesh.positions);
    mesh.triangles = mem_alloc(sizeof faces);
    memcpy(mesh.triangles, faces, sizeof faces);
    for (int i = 0; i < 8; ++i) mesh.positions[i] = vec3(face[i & 1], face[i >> 1 & 1], face[i >> 2]);
    blob_shape_t shape = {.material = pbrt_interface_material(p),
                          .media = {medium, 0},
                          .alpha = blob_constant(1),
                          .shadow_alpha = blob_constant(1)};
    TRY(mesh_add(p->builder, &mesh, &world_from_box, false, at, &shape));
    shape.flags |= SHAPE_INTERFACE;
    if (shape.geometry != BLOB_NONE) scene_add_shape(p->builder, 0, shape, NULL);
    return result_ok();
}

static bool has_light_at_infinity(const pbrt_t *p)
{
    const blob_light_t *lights = blob_builder_records(p->builder->blob, BLOB_SECTION_LIGHTS);
    for (uint32_t i = 0; i < blob_builder_count(p->builder->blob, BLOB_SECTION_LIGHTS); ++i)
        if (lights[i].kind == LIGHT_DISTANT || lights[i].kind == LIGHT_INFINITE) return true;
    return scene_gets_environment(p->builder);
}

/* What is about the camera, and has no border that light from infinity could come in by. */
static result_t end_camera_medium(pbrt_t *p, position_t at)
{
    const blob_medium_t *records = blob_builder_records(p->builder->blob, BLOB_SECTION_MEDIA);
    const blob_medium_t *record = &records[p->scene.medium - 1];
    blob_ref_t box = record->density != 0           ? record->density
                     : record->absorption_tint != 0 ? record->absorption_tint
                                                    : record->scattering_tint;
    if (box != 0) {
        const blob_field_t *fields = blob_builder_records(p->builder->blob, BLOB_SECTION_FIELDS);
        return enclose(p, p->scene.medium, &fields[box - 1], at);
    }
    report_warning(p->report, at,
                   "the camera stands in a medium without an end, and a light is at infinity: how much of it "
                   "arrives is not defined; put a shape of an interface around all, with that medium inside "
                   "and \"\" outside");
    return result_ok();
}

result_t pbrt_finish_media(pbrt_t *p, position_t at)
{
    TRY(place_camera(p, at));
    bool made = false;
    for (size_t i = 0; i < p->medium_count; ++i) {
        if (p->media[i].awaited && p->media[i].record == 0) TRY(refuse(p, &p->media[i]));
        made = made || p->media[i].record != 0;
    }
    settle_all(p);
    if (p->scene.medium != 0 && has_light_at_infinity(p) && is_open(p, p->scene.medium))
        TRY(end_camera_medium(p, at));
    if (!p->knows_media && made)
        report_warning(p->report, p->integrator_at.line ? p->integrator_at : at,
                       "the scene has media, which pbrt's integrator does not show; here they are shown, as "
                       "by \"volpath\"");
    return result_ok();
}
