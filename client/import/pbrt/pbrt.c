/* pbrt: files, the table of directives, and the loop over them (see pbrt.h). */
#include "client/import/pbrt/pbrt.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/import/pbrt/cameras.h"
#include "client/import/pbrt/files.h"
#include "client/import/pbrt/lights.h"
#include "client/import/pbrt/materials/materials.h"
#include "client/import/pbrt/materials/media.h"
#include "client/import/pbrt/materials/textures.h"
#include "client/import/pbrt/options.h"
#include "client/import/pbrt/shapes/shapes.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/colour_spaces.h"
#include "client/import/pbrt/transforms.h"

static result_t parse(pbrt_t *p);

/* ---- blocks and files ---------------------------------------------------------------------------------- */

static result_t attribute_begin(pbrt_t *p, position_t at)
{
    return pbrt_push(p, SCOPE_ATTRIBUTE, at);
}

static result_t attribute_end(pbrt_t *p, position_t at)
{
    return pbrt_pop(p, SCOPE_ATTRIBUTE, "AttributeEnd", at);
}

/* v4 has them for older scenes only, and saves all of the state, like AttributeBegin. */
static scope_kind_t transform_scope(const pbrt_t *p)
{
    return p->dialect.dialect == DIALECT_V3 ? SCOPE_TRANSFORM : SCOPE_ATTRIBUTE;
}

static result_t transform_begin(pbrt_t *p, position_t at)
{
    return pbrt_push(p, transform_scope(p), at);
}

static result_t transform_end(pbrt_t *p, position_t at)
{
    return pbrt_pop(p, transform_scope(p), "TransformEnd", at);
}

static result_t reverse_orientation(pbrt_t *p, position_t at)
{
    (void)at;
    p->now.reverse = !p->now.reverse;
    return result_ok();
}

/* Attribute "shape" "float alpha" 1: parameters that later directives take as their defaults. */
static result_t attribute(pbrt_t *p, position_t at)
{
    static const char *const targets[TARGET_COUNT] = {"shape", "light", "material", "medium", "texture"};
    TRY(pbrt_read_string(p, 0, "\"shape\", \"light\", \"material\", \"medium\" or \"texture\""));
    size_t target = 0;
    while (target < TARGET_COUNT && strcmp(p->arguments[0], targets[target]) != 0) ++target;
    if (target == TARGET_COUNT)
        return error_at(at, "Attribute \"%.40s\": shape, light, material, medium and texture are known",
                        p->arguments[0]);
    TRY(pbrt_read_params_for(p, (target_t)target));
    p->kept = grow(p->kept, &p->kept_capacity, p->kept_count + 1, sizeof(params_t *));
    p->now.defaults[target] = p->kept[p->kept_count++] = p->params;
    p->params = params_new();
    return result_ok();
}

static result_t include(pbrt_t *p, position_t at)
{
    TRY(pbrt_read_string(p, 0, "the file's name"));
    return pbrt_enter(p, p->arguments[0], false, at);
}

/* Import (v4): what the file sets ends with it. */
static result_t import(pbrt_t *p, position_t at)
{
    TRY(pbrt_read_string(p, 0, "the file's name"));
    TRY(pbrt_push(p, SCOPE_IMPORT, at));
    int depth = p->open_sources;
    TRY(pbrt_enter(p, p->arguments[0], true, at));
    TRY(parse(p));
    pbrt_leave_apart(p, depth);
    const scope_t *scope = &p->scopes[p->scope_count - 1];
    if (scope->kind != SCOPE_IMPORT) return error_at(scope->at, "the imported file leaves this block open");
    return pbrt_pop(p, SCOPE_IMPORT, "Import", at);
}

static result_t world_begin(pbrt_t *p, position_t at)
{
    (void)at;
    affine_t identity = affine_identity();
    TRY(pbrt_options_finish(p));
    p->now.ctm = p->now.ctm_end = identity;
    p->now.active = ACTIVE_START | ACTIVE_END;
    pbrt_name_coordinates(p, "world", &identity, &identity);
    p->phase = PHASE_WORLD;
    return result_ok();
}

static result_t world_end(pbrt_t *p, position_t at)
{
    if (p->scope_count)
        TRY(report_tolerate(p->report, at,
                            "WorldEnd, but the block of line %" PRIu32 " is still open; it ends here, as by "
                            "pbrt-v3",
                            p->scopes[p->scope_count - 1].at.line));
    p->scope_count = 0;
    p->object = 0;
    p->phase = PHASE_DONE;
    return result_ok();
}

/* ---- objects ------------------------------------------------------------------------------------------- */

static result_t object_begin(pbrt_t *p, position_t at)
{
    uint32_t old;
    TRY(pbrt_read_string(p, 0, "the object's name"));
    if (p->object)
        TRY(pbrt_slip(p, at, "the first ends here",
                      "an object inside an object; close the first with ObjectEnd"));
    if (names_find(&p->object_lines, p->arguments[0], &old))
        TRY(pbrt_slip(p, at, "it is replaced for what follows",
                      "the object \"%.60s\" has been defined before, in line %" PRIu32, p->arguments[0],
                      old));
    TRY(pbrt_push(p, SCOPE_OBJECT, at));
    p->object = scene_add_object(p->builder);
    names_add(&p->object_names, p->arguments[0], p->object);
    names_add(&p->object_lines, p->arguments[0], at.line);
    return result_ok();
}

static result_t object_end(pbrt_t *p, position_t at)
{
    if (!p->object && p->scope_count > 0)
        TRY(pbrt_slip(p, at, "it ends the innermost block", "ObjectEnd outside of an object"));
    p->object = 0;
    return pbrt_pop(p, SCOPE_OBJECT, "ObjectEnd", at);
}

static result_t object_instance(pbrt_t *p, position_t at)
{
    uint32_t object;
    size_t shapes;
    affine_t open, close;
    TRY(pbrt_read_string(p, 0, "the object's name"));
    if (p->object)
        return pbrt_slip(p, at, "it is left out",
                         "an instance inside an object is not supported, as in pbrt");
    if (!names_find(&p->object_names, p->arguments[0], &object))
        return pbrt_slip(p, at, "it is left out", "no object \"%.60s\" has been defined before",
                         p->arguments[0]);
    scene_shapes(p->builder, object, &shapes);
    if (shapes == 0) {
        report_warning(p->report, at, "the object \"%.60s\" is empty", p->arguments[0]);
        return result_ok();
    }
    pbrt_motion(p, at, &open, &close);
    return scene_add_instance(p->builder, object, &open, &close, at);
}

/* ---- pbrt-v2 ------------------------------------------------------------------------------------------- */

static result_t surface_integrator(pbrt_t *p, position_t at)
{
    TRY(report_refuse(
        p->report, at,
        "SurfaceIntegrator is pbrt-v2's, whose scenes are not supported; the nearest is to read "
        "this one as pbrt-v3's"));
    return pbrt_integrator(p, at);
}

/* What else comes with it. */
static result_t drop_v2(pbrt_t *p, position_t at)
{
    TRY(pbrt_read_string(p, 0, "the type"));
    TRY(pbrt_read_params(p));
    return report_refuse(p->report, at,
                         "\"%.40s\" belongs to a directive of pbrt-v2; the nearest is to leave it out",
                         p->arguments[0]);
}

/* ---- the table ----------------------------------------------------------------------------------------- */

typedef struct {
    dialect_entry_t entry;
    unsigned phases; /* phase_t in which it may stand */
    result_t (*run)(pbrt_t *p, position_t at);
} directive_t;

enum { ANY_PHASE = PHASE_OPTIONS | PHASE_WORLD };

static const directive_t directives[] = {
    {{"Shape", DIALECT_BOTH}, PHASE_WORLD, pbrt_shape},
    {{"AttributeBegin", DIALECT_BOTH}, ANY_PHASE, attribute_begin},
    {{"AttributeEnd", DIALECT_BOTH}, ANY_PHASE, attribute_end},
    {{"TransformBegin", DIALECT_BOTH}, ANY_PHASE, transform_begin},
    {{"TransformEnd", DIALECT_BOTH}, ANY_PHASE, transform_end},
    {{"Attribute", DIALECT_V4}, ANY_PHASE, attribute},
    {{"ReverseOrientation", DIALECT_BOTH}, PHASE_WORLD, reverse_orientation},
    {{"Include", DIALECT_BOTH}, ANY_PHASE, include},
    {{"Import", DIALECT_V4}, PHASE_WORLD, import},

    {{"Identity", DIALECT_BOTH}, ANY_PHASE, pbrt_identity},
    {{"Translate", DIALECT_BOTH}, ANY_PHASE, pbrt_translate},
    {{"Scale", DIALECT_BOTH}, ANY_PHASE, pbrt_scale},
    {{"Rotate", DIALECT_BOTH}, ANY_PHASE, pbrt_rotate},
    {{"LookAt", DIALECT_BOTH}, ANY_PHASE, pbrt_look_at},
    {{"Transform", DIALECT_BOTH}, ANY_PHASE, pbrt_transform},
    {{"ConcatTransform", DIALECT_BOTH}, ANY_PHASE, pbrt_concat_transform},
    {{"CoordinateSystem", DIALECT_BOTH}, ANY_PHASE, pbrt_coordinate_system},
    {{"CoordSysTransform", DIALECT_BOTH}, ANY_PHASE, pbrt_coord_sys_transform},
    {{"ActiveTransform", DIALECT_BOTH}, ANY_PHASE, pbrt_active_transform},
    {{"TransformTimes", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_transform_times},

    {{"Camera", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_camera},
    {{"Film", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_film},
    {{"Sampler", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_sampler},
    {{"Integrator", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_integrator},
    {{"SurfaceIntegrator", DIALECT_V3}, PHASE_OPTIONS, surface_integrator},
    {{"VolumeIntegrator", DIALECT_V3}, PHASE_OPTIONS, drop_v2},
    {{"Renderer", DIALECT_V3}, PHASE_OPTIONS, drop_v2},
    {{"PixelFilter", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_pixel_filter},
    {{"Accelerator", DIALECT_BOTH}, PHASE_OPTIONS, pbrt_accelerator},
    {{"ColorSpace", DIALECT_V4}, ANY_PHASE, pbrt_color_space},
    {{"Option", DIALECT_V4}, PHASE_OPTIONS, pbrt_option},
    {{"WorldBegin", DIALECT_BOTH}, PHASE_OPTIONS, world_begin},
    {{"WorldEnd", DIALECT_V3}, PHASE_WORLD, world_end},

    {{"Material", DIALECT_BOTH}, ANY_PHASE, pbrt_material},
    {{"MakeNamedMaterial", DIALECT_BOTH}, ANY_PHASE, pbrt_make_named_material},
    {{"NamedMaterial", DIALECT_BOTH}, ANY_PHASE, pbrt_named_material},
    {{"Texture", DIALECT_BOTH}, ANY_PHASE, pbrt_texture},
    {{"AreaLightSource", DIALECT_BOTH}, PHASE_WORLD, pbrt_area_light},
    {{"LightSource", DIALECT_BOTH}, PHASE_WORLD, pbrt_light},
    {{"MakeNamedMedium", DIALECT_BOTH}, ANY_PHASE, pbrt_make_named_medium},
    {{"MediumInterface", DIALECT_BOTH}, ANY_PHASE, pbrt_medium_interface},
    {{"Volume", DIALECT_V3}, PHASE_WORLD, drop_v2},

    {{"ObjectBegin", DIALECT_BOTH}, PHASE_WORLD, object_begin},
    {{"ObjectEnd", DIALECT_BOTH}, PHASE_WORLD, object_end},
    {{"ObjectInstance", DIALECT_BOTH}, PHASE_WORLD, object_instance},
};

static bool is_directive(const token_t *token)
{
    for (size_t i = 0; i < ARRAY_LENGTH(directives); ++i)
        if (token_is(token, directives[i].entry.name)) return true;
    return false;
}

/* Goes past all that follows a directive's name. */
static result_t skip_arguments(pbrt_t *p)
{
    for (;;) {
        token_t token;
        TRY(lexer_peek(&p->lexer, &token));
        if (token.kind == TOKEN_END || (token.kind == TOKEN_WORD && is_directive(&token))) return result_ok();
        TRY(lexer_next(&p->lexer, &token));
    }
}

static result_t wrong_phase(pbrt_t *p, const directive_t *directive, position_t at)
{
    const char *name = directive->entry.name;
    if (directive->run == world_begin && p->phase == PHASE_WORLD)
        TRY(pbrt_slip(p, at, "it is left out", "a second WorldBegin; a file holds one scene"));
    else
        TRY(pbrt_slip(p, at, "it is left out", "%s must come %s WorldBegin", name,
                      p->phase == PHASE_OPTIONS ? "after" : "before"));
    return skip_arguments(p);
}

static result_t run_directive(pbrt_t *p, const token_t *token)
{
    char name[TOKEN_QUOTE_SIZE];
    if (token->kind != TOKEN_WORD)
        return error_at(token->at, "expected a directive, found %s", token_quote(token, name));
    size_t index;
    snprintf(name, sizeof name, "%.*s", (int)(token->length < 40 ? token->length : 40), token->text);
    TRY(entry_find(directives, ARRAY_LENGTH(directives), sizeof *directives, "directive", name, &p->dialect,
                   token->at, &index));
    const directive_t *directive = &directives[index];
    if (!(directive->phases & p->phase)) return wrong_phase(p, directive, token->at);
    return directive->run(p, token->at);
}

/* ---- the end ------------------------------------------------------------------------------------------- */

/* Parameters of an Attribute that no directive has read are most likely misspelled. */
static result_t check_defaults(pbrt_t *p)
{
    for (size_t i = 0; i < p->kept_count; ++i) TRY(params_finish(p->kept[i], "Attribute", false, p->report));
    return result_ok();
}

/* Of a light, or of what shines by itself. */
static result_t gain(const pbrt_t *p, position_t at, rgb_t *value)
{
    if (p->gain != 1) *value = v_scale(*value, (float)p->gain);
    *value = v_mul(*value, p->balance);
    if (v_is_finite(*value)) return result_ok();
    return error_at(p->film_at.line ? p->film_at : at, "the scene's lights are too bright: infinite");
}

/* The film's gain is put into lights and glowing media, and into what ambient occlusion shows. */
static result_t apply_gain(pbrt_t *p, position_t at)
{
    blob_builder_t *blob = p->builder->blob;
    uint32_t count = blob_builder_count(blob, BLOB_SECTION_LIGHTS);
    uint32_t media = blob_builder_count(blob, BLOB_SECTION_MEDIA);
    blob_light_t *lights = blob_builder_records(blob, BLOB_SECTION_LIGHTS);
    blob_medium_t *medium = blob_builder_records(blob, BLOB_SECTION_MEDIA);
    rgb_t *open = &p->scene.occlusion_radiance;
    *open = v_mul(v_scale(*open, (float)p->gain), p->balance);
    bool tints = p->balance.x != p->balance.y || p->balance.y != p->balance.z;
    for (uint32_t i = 0; i < count; ++i) {
        TRY(gain(p, at, &lights[i].radiance.factor));
        if (tints) lights[i].radiance.spectrum = 0; /* it is another one */
    }
    for (uint32_t i = 0; i < media; ++i) {
        TRY(gain(p, at, &medium[i].emission));
        if ((double)v_max(medium[i].emission) > BLOB_MAX_NUMBER)
            return error_at(p->film_at.line ? p->film_at : at,
                            "what a medium emits, times the film's exposure, is over 1e9");
    }
    if (!v_is_finite(*open))
        return error_at(p->film_at.line ? p->film_at : at, "the film's scale is too large");
    return result_ok();
}

/* Lays out scene, objects and shapes in the builder, and says what looks forgotten. `at` is the end of the
 * file. */
static result_t finish(pbrt_t *p, position_t at)
{
    if (p->phase == PHASE_OPTIONS) TRY(pbrt_options_finish(p)); /* something else may be wrong first */
    if (p->phase == PHASE_OPTIONS)
        return error_at(at, "the file ends before WorldBegin; is it a whole scene?");
    if (p->scope_count) {
        const scope_t *open = &p->scopes[p->scope_count - 1];
        return error_at(open->at, "this block is never closed");
    }
    if (p->phase == PHASE_WORLD && p->dialect.dialect == DIALECT_V3)
        return error_at(at, "the file ends before WorldEnd; is it truncated?");
    TRY(pbrt_finish_materials(p));
    TRY(pbrt_finish_media(p, at));
    pbrt_check_unused_materials(p);
    TRY(check_defaults(p));
    TRY(apply_gain(p, at));
    TRY(scene_finish(p->builder, &p->scene, at));
    bool needs_light = p->scene.integrator != INTEGRATOR_AO;
    if (needs_light && !scene_has_light(p->builder) && !scene_gets_environment(p->builder))
        report_warning(p->report, at,
                       "the scene has no light: its picture is black; --environment gives it one");
    return result_ok();
}

/* ---- the loop ------------------------------------------------------------------------------------------ */

/* Runs directives up to the end of the file that stands apart: the main one, or one that is imported. */
static result_t parse(pbrt_t *p)
{
    for (;;) {
        token_t token;
        TRY(lexer_next(&p->lexer, &token));
        pbrt_drop_left_files(p);
        pbrt_tell_progress(p);
        if (token.kind == TOKEN_END) return result_ok();
        if (p->phase == PHASE_DONE) {
            report_warning(p->report, token.at, "what follows WorldEnd is ignored");
            return result_ok();
        }
        TRY(run_directive(p, &token));
    }
}

/* Reads the main file and all that it includes. */
static result_t parse_scene(pbrt_t *p, const char *path, const char *label)
{
    TRY(pbrt_open_main(p, path, label));
    source_t *source = p->source;
    pbrt_set_defaults(p, dialect_detect(source->path, (const char *)source->data, source->size));
    if (p->dialect.dialect == DIALECT_V3) p->lexer.forgiving = p->report;
    pbrt_default_material(p);
    TRY(parse(p));
    return finish(p, lexer_position(&p->lexer));
}

result_t pbrt_import(const char *path, scene_builder_t *builder)
{
    pbrt_t *p = mem_alloc(sizeof *p);
    pbrt_begin(p, builder);
    const char *slash = strrchr(path, '/');
    p->folder = slash ? mem_printf("%.*s", (int)(slash + 1 - path), path) : mem_strdup("");
    result_t result = parse_scene(p, path, slash ? slash + 1 : path);
    pbrt_end(p);
    free(p);
    return result;
}
