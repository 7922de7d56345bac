/* state: see state.h. */
#include "client/import/pbrt/state.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "client/import/pbrt/directives.h"

/* ---- life ---------------------------------------------------------------------------------------------- */

void pbrt_begin(pbrt_t *p, blob_builder_t *builder, report_t *report)
{
    *p = (pbrt_t){.report = report, .builder = builder, .phase = PHASE_OPTIONS};
    p->params = params_new();
    p->now.ctm = affine_identity();
    p->objects = grow(NULL, &p->object_capacity, 1, sizeof *p->objects);
    p->objects[p->object_count++] = (object_t){0}; /* the world */
}

static void free_lists(pbrt_t *p)
{
    for (size_t i = 0; i < p->file_count; ++i) {
        free(p->files[i]->path);
        free(p->files[i]->label);
        free(p->files[i]->data);
        free(p->files[i]);
    }
    for (size_t i = 0; i < p->material_count; ++i) {
        params_destroy(&p->materials[i].params);
        free(p->materials[i].name);
    }
    for (size_t i = 0; i < p->kept_count; ++i) params_destroy(&p->kept[i]);
    for (size_t i = 0; i < p->object_count; ++i) free(p->objects[i].shapes);
    for (size_t i = 0; i < p->image_count; ++i) free(p->images[i].path);
    for (int i = 0; i < ARGUMENTS; ++i) free(p->arguments[i]);
}

void pbrt_end(pbrt_t *p)
{
    free_lists(p);
    params_destroy(&p->params);
    names_free(&p->coordinates);
    names_free(&p->material_names);
    for (int i = 0; i < 2; ++i) names_free(&p->texture_names[i]);
    names_free(&p->object_names);
    free(p->files);
    free(p->folder);
    free(p->kept);
    free(p->scopes);
    free(p->systems);
    free(p->materials);
    free(p->textures);
    free(p->images);
    free(p->objects);
    *p = (pbrt_t){0};
}

void pbrt_set_defaults(pbrt_t *p, dialect_choice_t dialect)
{
    bool v3 = dialect.dialect == DIALECT_V3;
    p->dialect = dialect;
    p->scene = (blob_scene_t){.world_from_camera = xform_identity(),
                              .fov = 90,
                              .width = v3 ? 640 : 1280,
                              .height = v3 ? 480 : 720,
                              .max_depth = 5,
                              .spp = 16,
                              .integrator = INTEGRATOR_PATH,
                              .sampler = SAMPLER_SOBOL};
    p->scene.filter =
        v3 ? (blob_filter_t){FILTER_BOX, 0.5f, 0.5f, 0} : (blob_filter_t){FILTER_GAUSSIAN, 1.5f, 1.5f, 0.5f};
    pbrt_default_material(p);
}

/* ---- scopes -------------------------------------------------------------------------------------------- */

result_t pbrt_push(pbrt_t *p, scope_kind_t kind, position_t at)
{
    if (p->scope_count == MAX_SCOPES) return error_at(at, "blocks are nested deeper than %d", MAX_SCOPES);
    p->scopes = grow(p->scopes, &p->scope_capacity, p->scope_count + 1, sizeof *p->scopes);
    p->scopes[p->scope_count++] =
        (scope_t){.kind = kind,
                  .at = at,
                  .saved = p->now,
                  .textures = {p->texture_names[0].count, p->texture_names[1].count},
                  .materials = p->material_names.count};
    return result_ok();
}

result_t pbrt_pop(pbrt_t *p, scope_kind_t kind, const char *directive, position_t at)
{
    static const char *const begins[] = {"AttributeBegin", "TransformBegin", "ObjectBegin"};
    if (p->scope_count == 0) return error_at(at, "%s without %s", directive, begins[kind]);
    const scope_t *scope = &p->scopes[p->scope_count - 1];
    if (scope->kind != kind)
        return error_at(at, "%s, but the innermost open block is the %s of line %" PRIu32, directive,
                        begins[scope->kind], scope->at.line);
    --p->scope_count;
    if (kind == SCOPE_TRANSFORM) {
        p->now.ctm = scope->saved.ctm;
        return result_ok();
    }
    p->now = scope->saved;
    if (p->dialect.dialect == DIALECT_V3) {
        for (int i = 0; i < 2; ++i) names_cut(&p->texture_names[i], scope->textures[i]);
        names_cut(&p->material_names, scope->materials);
    }
    return result_ok();
}

void pbrt_name_coordinates(pbrt_t *p, const char *name, const affine_t *t)
{
    uint32_t index;
    if (names_find(&p->coordinates, name, &index)) {
        p->systems[index] = *t;
        return;
    }
    p->systems = grow(p->systems, &p->system_capacity, p->system_count + 1, sizeof *p->systems);
    names_add(&p->coordinates, name, (uint32_t)p->system_count);
    p->systems[p->system_count++] = *t;
}

/* ---- places and paths ---------------------------------------------------------------------------------- */

uint32_t pbrt_name_of_place(pbrt_t *p, position_t at)
{
    char *name = mem_printf("%s:%" PRIu32, p->source->label, at.line);
    uint32_t offset = blob_builder_string(p->builder, name);
    free(name);
    return offset;
}

char *pbrt_resolve(const pbrt_t *p, const char *filename)
{
    if (filename[0] == '/') return mem_strdup(filename);
    char *path = mem_printf("%s%s", p->folder, filename);
    const char *slash = strrchr(p->source->path, '/');
    if (access(path, F_OK) == 0 || !slash) return path;
    char *beside = mem_printf("%.*s%s", (int)(slash + 1 - p->source->path), p->source->path, filename);
    bool there = access(beside, F_OK) == 0;
    free(there ? path : beside);
    return there ? beside : path;
}

/* ---- the scene ----------------------------------------------------------------------------------------- */

/* A light of the world; object 0 comes first in the blob, so its shapes' indices are known already. */
static uint32_t add_light(pbrt_t *p)
{
    blob_light_t light = p->now.light;
    light.shape = (uint32_t)p->objects[0].count;
    return blob_builder_add(p->builder, BLOB_SECTION_LIGHTS, &light, 1);
}

void pbrt_add_shape(pbrt_t *p, blob_shape_t shape, position_t at)
{
    object_t *object = &p->objects[p->object];
    shape.name = pbrt_name_of_place(p, at);
    shape.light = BLOB_NONE;
    if (p->now.emits && p->object == 0 && !v_is_zero(p->now.light.radiance)) shape.light = add_light(p);
    if (p->now.emits && p->object != 0)
        report_warning(p->report, at,
                       "a shape of an object does not emit, as in pbrt; its area light is ignored");
    object->shapes = grow(object->shapes, &object->capacity, object->count + 1, sizeof *object->shapes);
    object->shapes[object->count++] = shape;
}

static void lay_out_objects(pbrt_t *p)
{
    for (size_t i = 0; i < p->object_count; ++i) {
        const object_t *object = &p->objects[i];
        blob_object_t record = {.shape_count = (uint32_t)object->count};
        record.first_shape =
            blob_builder_add(p->builder, BLOB_SECTION_SHAPES, object->shapes, (uint32_t)object->count);
        blob_builder_add(p->builder, BLOB_SECTION_OBJECTS, &record, 1);
    }
}

/* Parameters of an Attribute that no directive has read are most likely misspelled. */
static result_t check_defaults(pbrt_t *p)
{
    for (size_t i = 0; i < p->kept_count; ++i) TRY(params_finish(p->kept[i], "Attribute", false, p->report));
    return result_ok();
}

result_t pbrt_finish(pbrt_t *p, position_t at)
{
    if (p->phase == PHASE_OPTIONS)
        return error_at(at, "the file ends before WorldBegin; is it a whole scene?");
    if (p->scope_count) {
        const scope_t *open = &p->scopes[p->scope_count - 1];
        return error_at(open->at, "this block is never closed");
    }
    if (p->phase == PHASE_WORLD && p->dialect.dialect == DIALECT_V3)
        return error_at(at, "the file ends before WorldEnd; is it truncated?");
    pbrt_check_unused_materials(p);
    TRY(check_defaults(p));
    lay_out_objects(p);
    blob_builder_add(p->builder, BLOB_SECTION_SCENE, &p->scene, 1);
    if (blob_builder_count(p->builder, BLOB_SECTION_LIGHTS) == 0)
        report_warning(p->report, at, "the scene has no light: its picture is black");
    return result_ok();
}
