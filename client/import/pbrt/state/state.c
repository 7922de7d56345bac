/* state: see state.h. */
#include "client/import/pbrt/state/state.h"

#include <errno.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- life ---------------------------------------------------------------------------------------------- */

void pbrt_begin(pbrt_t *p, scene_builder_t *builder)
{
    *p = (pbrt_t){.report = builder->report, .builder = builder, .phase = PHASE_OPTIONS};
    p->params = params_new();
    p->now.ctm = p->now.ctm_end = affine_identity();
    p->now.active = ACTIVE_START | ACTIVE_END;
    p->camera[0] = p->camera[1] = affine_identity();
    p->transform_times[1] = p->shutter[1] = p->gain = 1;
    p->balance = vec3(1, 1, 1);
    p->film_diagonal = 35;
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
    for (size_t i = 0; i < p->medium_count; ++i) free(p->media[i].name);
    for (size_t i = 0; i < p->kept_count; ++i) params_destroy(&p->kept[i]);
    for (int i = 0; i < ARGUMENTS; ++i) free(p->arguments[i]);
    for (int i = 0; i < SETTING_COUNT; ++i) {
        free(p->settings[i].type);
        params_destroy(&p->settings[i].params);
    }
}

void pbrt_end(pbrt_t *p)
{
    free_lists(p);
    params_destroy(&p->params);
    names_free(&p->coordinates);
    names_free(&p->material_names);
    names_free(&p->medium_names);
    for (int i = 0; i < 2; ++i) names_free(&p->texture_names[i]);
    names_free(&p->bsdf_files);
    names_free(&p->object_names);
    names_free(&p->object_lines);
    free(p->files);
    intern_free(&p->seen);
    free(p->folder);
    free(p->kept);
    free(p->scopes);
    free(p->systems);
    free(p->materials);
    free(p->media);
    free(p->textures);
    *p = (pbrt_t){0};
}

void pbrt_set_defaults(pbrt_t *p, dialect_choice_t dialect)
{
    bool v3 = dialect.dialect == DIALECT_V3;
    p->dialect = dialect;
    p->scene = blob_default_scene();
    p->scene.integrator = INTEGRATOR_PATH;
    p->knows_media = !v3; /* whose default is path, v4's is volpath */
    p->scene.focal_distance = 1e6f;
    p->scene.width = 1280;
    p->scene.height = 720;
    p->scene.filter = v3 ? (blob_filter_t){FILTER_BOX, 0.5f, 0.5f, {0}}
                         : (blob_filter_t){FILTER_GAUSSIAN, 1.5f, 1.5f, {0.5f}};
    p->crop[1] = p->crop[3] = INT32_MAX;
}

/* ---- slips --------------------------------------------------------------------------------------------- */

result_t pbrt_slip(pbrt_t *p, position_t at, const char *does, const char *format, ...)
{
    char what[500];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(what, sizeof what, format, arguments);
    va_end(arguments);
    if (p->dialect.dialect != DIALECT_V3) return error_at(at, "%s", what);
    return report_tolerate(p->report, at, "%s; %s, as by pbrt-v3", what, does);
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

static const char *const begins[] = {"AttributeBegin", "TransformBegin", "ObjectBegin", "Import"};

static void restore_transform(pbrt_t *p, const scope_t *scope)
{
    p->now.ctm = scope->saved.ctm;
    p->now.ctm_end = scope->saved.ctm_end;
    p->now.active = scope->saved.active;
}

/* All of the state, and in v3 the names. */
static void restore(pbrt_t *p, const scope_t *scope)
{
    p->now = scope->saved;
    if (p->dialect.dialect != DIALECT_V3) return;
    for (int i = 0; i < 2; ++i) names_cut(&p->texture_names[i], scope->textures[i]);
    names_cut(&p->material_names, scope->materials);
}

/* pbrt-v3 has a stack of transforms, and one of the other state that AttributeBegin and ObjectBegin alone add
 * to. An End takes the top of either, whatever Begin is there. */
static void pop_two_stacks(pbrt_t *p, size_t other)
{
    size_t top = p->scope_count - 1;
    restore(p, &p->scopes[other]);
    restore_transform(p, &p->scopes[top]);
    p->scopes[other].kind = SCOPE_TRANSFORM; /* whose transform is still on its stack */
    --p->scope_count;
}

/* An End without a Begin, which is left out. */
static result_t pop_nothing(pbrt_t *p, scope_kind_t kind, const char *directive, position_t at)
{
    if (p->dialect.dialect == DIALECT_V4 && kind != SCOPE_ATTRIBUTE)
        return error_at(at, "%s without %s", directive, begins[kind]);
    return report_tolerate(p->report, at, "%s without %s; it is left out, as by pbrt", directive,
                           begins[kind]);
}

/* An End whose Begin is not the innermost one: whatever pbrt does about it. */
static result_t pop_another(pbrt_t *p, scope_kind_t kind, const char *directive, position_t at)
{
    size_t other = p->scope_count;
    while (other > 0 && p->scopes[other - 1].kind == SCOPE_TRANSFORM) --other;
    bool v3 = p->dialect.dialect == DIALECT_V3;
    if (p->scope_count == 0 || (v3 && kind != SCOPE_TRANSFORM && other == 0))
        return pop_nothing(p, kind, directive, at);
    const scope_t *scope = &p->scopes[p->scope_count - 1];
    if (!v3 || kind == SCOPE_TRANSFORM)
        return error_at(at, "%s, but the innermost open block is the %s of line %" PRIu32, directive,
                        begins[scope->kind], scope->at.line);
    TRY(report_tolerate(p->report, at,
                        "%s, but the innermost open block is the %s of line %" PRIu32
                        "; it is closed, as by pbrt-v3",
                        directive, begins[scope->kind], scope->at.line));
    pop_two_stacks(p, other - 1);
    return result_ok();
}

result_t pbrt_pop(pbrt_t *p, scope_kind_t kind, const char *directive, position_t at)
{
    if (p->scope_count == 0 || p->scopes[p->scope_count - 1].kind != kind)
        return pop_another(p, kind, directive, at);
    const scope_t *scope = &p->scopes[--p->scope_count];
    if (kind == SCOPE_TRANSFORM)
        restore_transform(p, scope);
    else
        restore(p, scope);
    return result_ok();
}

void pbrt_name_coordinates(pbrt_t *p, const char *name, const affine_t *start, const affine_t *end)
{
    uint32_t index;
    if (!names_find(&p->coordinates, name, &index)) {
        p->systems = grow(p->systems, &p->system_capacity, p->system_count + 1, sizeof *p->systems);
        index = (uint32_t)p->system_count++;
        names_add(&p->coordinates, name, index);
    }
    p->systems[index][0] = *start;
    p->systems[index][1] = *end;
}

/* ---- motion -------------------------------------------------------------------------------------------- */

/* Motion runs between the transform's times and rests outside them; the blob knows the shutter's time alone.
 */
bool pbrt_motion(pbrt_t *p, position_t at, affine_t *open, affine_t *close)
{
    affine_t start = p->now.ctm, end = p->now.ctm_end;
    *open = *close = start;
    if (memcmp(&start, &end, sizeof start) == 0) return false;
    double first = p->transform_times[0], length = p->transform_times[1] - first, part[2];
    for (int i = 0; i < 2; ++i)
        part[i] = length > 0 ? (p->shutter[i] - first) / length : p->shutter[i] > first ? 1 : 0;
    bool bends = (part[0] < 0 && part[1] > 0) || (part[0] < 1 && part[1] > 1);
    if (bends && !p->early_motion) {
        report_warning(p->report, at,
                       "motion begins or ends while the shutter is open: it is spread over all of that time");
        p->early_motion = true;
    }
    affine_interpolate(&start, &end, part[0], open);
    affine_interpolate(&start, &end, part[1], close);
    return memcmp(open, close, sizeof *open) != 0;
}

/* ---- places and paths ---------------------------------------------------------------------------------- */

uint32_t pbrt_name_of_place(pbrt_t *p, position_t at)
{
    char *name = mem_printf("%s:%" PRIu32, p->source->label, at.line);
    uint32_t offset = blob_builder_string(p->builder->blob, name);
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

bool pbrt_is_missing(const char *path)
{
    return access(path, F_OK) != 0 && errno == ENOENT;
}

result_t pbrt_missing(pbrt_t *p, position_t at, const char *path, const char *does)
{
    if (p->dialect.dialect == DIALECT_V3)
        return pbrt_slip(p, at, does, "%.300s: cannot be opened: %s", path, strerror(ENOENT));
    return report_refuse(p->report, at, "%.300s: cannot be opened: %s; the nearest: %s", path,
                         strerror(ENOENT), does);
}
