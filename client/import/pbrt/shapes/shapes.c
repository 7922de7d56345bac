/* shapes: the Shape directive: the table of shapes, and what all kinds have in common: alpha, material, light
 * and motion. */
#include "client/import/pbrt/shapes/shapes.h"
#include "client/import/pbrt/materials/materials.h"
#include "client/import/pbrt/materials/media.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/values.h"

typedef struct {
    dialect_entry_t entry;
    result_t (*make)(pbrt_t *p, shape_work_t *work);
    bool v3_alpha; /* pbrt-v3 knows its alpha; v4 knows that of all shapes */
} shape_entry_t;

static const shape_entry_t shapes[] = {
    {{"trianglemesh", DIALECT_BOTH}, pbrt_make_trianglemesh, true},
    {{"plymesh", DIALECT_BOTH}, pbrt_make_plymesh, true},
    {{"sphere", DIALECT_BOTH}, pbrt_make_sphere, false},
    {{"disk", DIALECT_BOTH}, pbrt_make_disk, false},
    {{"cylinder", DIALECT_BOTH}, pbrt_make_cylinder, false},
    {{"cone", DIALECT_V3}, pbrt_make_cone, false},
    {{"paraboloid", DIALECT_V3}, pbrt_make_paraboloid, false},
    {{"hyperboloid", DIALECT_V3}, pbrt_make_hyperboloid, false},
    {{"curve", DIALECT_BOTH}, pbrt_make_curve, false},
    {{"loopsubdiv", DIALECT_BOTH}, pbrt_make_loopsubdiv, false},
    {{"nurbs", DIALECT_V3}, pbrt_make_nurbs, false},
    {{"heightfield", DIALECT_V3}, pbrt_make_heightfield, false},
    {{"bilinearmesh", DIALECT_V4}, pbrt_make_bilinearmesh, false},
};

/* ---- alpha -------------------------------------------------------------------------------------------- */

static bool is_opaque(const blob_value_t *alpha)
{
    return alpha->texture == 0 && alpha->factor.x >= 1;
}

/* pbrt-v3's bidirectional integrators join their subpaths by rays that do not ask for it. */
static result_t read_shadow_alpha(pbrt_t *p, shape_work_t *work)
{
    blob_value_t *value = &work->shape.shadow_alpha;
    TRY(pbrt_float_value(p, work->params, "shadowalpha", value));
    if (is_opaque(value) || p->scene.integrator != INTEGRATOR_BDPT) return result_ok();
    *value = blob_constant(1);
    report_warning(p->report, params_where(work->params, "shadowalpha", work->at),
                   "parameter \"shadowalpha\" is ignored, as by pbrt-v3's integrator \"bdpt\"");
    return result_ok();
}

/* v3 cuts out what is exactly 0, of meshes alone; v4 lets a ray through by chance. */
static result_t read_alpha(pbrt_t *p, const shape_entry_t *entry, shape_work_t *work)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    blob_shape_t *shape = &work->shape;
    shape->alpha = shape->shadow_alpha = blob_constant(1);
    if (v3 && !entry->v3_alpha) return result_ok();
    TRY(pbrt_float_value(p, work->params, "alpha", &shape->alpha));
    if (v3) TRY(read_shadow_alpha(p, work));
    if (v3 && !(is_opaque(&shape->alpha) && is_opaque(&shape->shadow_alpha))) shape->flags |= SHAPE_CUTOUT;
    if (shape->kind == SHAPE_CURVES && !is_opaque(&shape->alpha)) {
        shape->alpha = blob_constant(1);
        return report_refuse(p->report, params_where(work->params, "alpha", work->at),
                             "curves that are partly transparent are not supported; they are opaque");
    }
    return result_ok();
}

/* ---- media -------------------------------------------------------------------------------------------- */

/* Where the sides of the interface in force differ, the shape parts them. In pbrt a direction w lies outside
 * if dot(w, n) > 0, with the normal n where a ray hits: after ReverseOrientation exclusive-or a mirroring
 * transform, or on the side of a mesh's own normals. SHAPE_FLIP says the same of meshes and quadrics, but for
 * quadrics that emit and are mirrored, whose media change places. Curves have no inside: what is about them
 * goes on behind them. */
static result_t part_media(pbrt_t *p, shape_work_t *work)
{
    blob_ref_t media[2];
    int inside = work->inside_out ? 1 : 0;
    TRY(pbrt_media_in_force(p, media));
    work->outside = media[1];
    work->shape.media[inside] = media[0];
    work->shape.media[1 - inside] = media[1];
    if (work->inside_out) work->shape.flags |= SCENE_INSIDE_OUT;
    if (media[0] != media[1] && work->shape.kind != SHAPE_CURVES) work->shape.flags |= SHAPE_INTERFACE;
    return result_ok();
}

/* Whether the shape's material is an interface. */
static bool is_interface(const pbrt_t *p, const blob_shape_t *shape)
{
    return p->interface != 0 && shape->material == p->interface - 1;
}

/* A shape that is nothing but an interface is left out unless it parts media. */
static void settle_interface(pbrt_t *p, blob_shape_t *shape)
{
    if (shape->material == BLOB_NONE && shape->flags & SHAPE_INTERFACE)
        shape->material = pbrt_interface_material(p);
}

/* ---- light -------------------------------------------------------------------------------------------- */

/* The radiance of a light that is given by its power: pbrt-v4 makes a light of every triangle or patch, and
 * each has all of the power. */
static result_t apply_power(pbrt_t *p, const shape_work_t *work, blob_light_t *light)
{
    const area_light_t *source = &p->now.light;
    double sides = light->flags & LIGHT_TWO_SIDED ? 2 : 1, emitters = (double)work->emitters;
    double factor = source->power * emitters / (3.14159265358979323846 * work->area * sides * source->mean);
    if (work->emitters > 1)
        report_warning(p->report, work->at,
                       "as in pbrt-v4 each of the %zu parts of this shape has all of the light's \"power\"; "
                       "it is spread evenly over them",
                       work->emitters);
    light->radiance.factor = v_scale(light->radiance.factor, (float)factor);
    if (!v_is_finite(light->radiance.factor))
        return error_at(work->at,
                        "this shape is too small for the power of its light: its radiance is infinite");
    return result_ok();
}

/* A light whose alpha is the number 0: pbrt-v4 lets it shine unseen. In v3 what it lights by samples is lit,
 * and what runs into it is not. */
static void become_unseen(pbrt_t *p, const shape_work_t *work, blob_light_t *light)
{
    light->flags |= LIGHT_UNSEEN;
    if (p->dialect.dialect == DIALECT_V3)
        report_warning(p->report, work->at,
                       "a light with an alpha of 0 shines unseen; pbrt-v3 loses a part of its light");
}

/* The light that the shape emits; *emits is false when it is none. */
static result_t make_light(pbrt_t *p, shape_work_t *work, bool moves, blob_light_t *light, bool *emits)
{
    *light = p->now.light.light;
    *emits = false;
    if (is_interface(p, &work->shape)) return result_ok();
    light->medium = work->shape.flags & SHAPE_INTERFACE ? 0 : work->outside;
    if (!p->now.emits || v_is_zero(light->radiance.factor)) return result_ok();
    if (p->object != 0) {
        report_warning(p->report, work->at,
                       "a shape of an object does not emit, as in pbrt; its area light is ignored");
        return result_ok();
    }
    if (work->shape.kind == SHAPE_CURVES)
        return report_refuse(p->report, work->at, "curves that emit light are not supported; it stays dark");
    if (!(work->area > 0) || !isfinite(work->area)) {
        report_warning(p->report, work->at, "this shape has an area of %g and does not emit", work->area);
        return result_ok();
    }
    if (work->shape.alpha.texture == 0 && work->shape.alpha.factor.x == 0) become_unseen(p, work, light);
    if (moves)
        report_warning(p->report, work->at,
                       "a shape that emits does not move: it stands where it is when the shutter opens");
    *emits = true;
    return p->now.light.power > 0 ? apply_power(p, work, light) : result_ok();
}

/* ---- the directive ------------------------------------------------------------------------------------ */

/* Where the geometry goes: a shape that moves keeps its own space and becomes an instance. */
static bool place(pbrt_t *p, shape_work_t *work, affine_t *open, affine_t *close)
{
    bool moves = pbrt_motion(p, work->at, open, close);
    bool instance = moves && p->object == 0 && !p->now.emits;
    if (moves && p->object != 0)
        report_warning(p->report, work->at,
                       "a shape does not move in its object: it stands where it is when the shutter opens");
    work->placed = instance ? affine_identity() : *open;
    return moves;
}

static result_t add_shape(pbrt_t *p, shape_work_t *work, bool moves, const affine_t *open,
                          const affine_t *close)
{
    blob_light_t light;
    bool emits;
    TRY(make_light(p, work, moves, &light, &emits));
    work->shape.name = pbrt_name_of_place(p, work->at);
    if (moves && p->object == 0 && !p->now.emits) { /* as an object of its own, in its own space */
        uint32_t object = scene_add_object(p->builder);
        scene_add_shape(p->builder, object, work->shape, NULL);
        return scene_add_instance(p->builder, object, open, close, work->at);
    }
    xform_t inverse, ends[2] = {affine_to_xform(open), affine_to_xform(close)};
    if (!xform_invert(&ends[0], &inverse) || !xform_invert(&ends[1], &inverse))
        return error_at(work->at, "the current transform is singular or not finite");
    scene_add_shape(p->builder, p->object, work->shape, emits ? &light : NULL);
    return result_ok();
}

/* Shading normals that are not the geometric ones: see SHAPE_NORMALS_V3. */
static bool has_shading_normals(const pbrt_t *p, const blob_shape_t *shape)
{
    const blob_mesh_t *meshes = blob_builder_records(p->builder->blob, BLOB_SECTION_MESHES);
    const blob_material_t *materials = blob_builder_records(p->builder->blob, BLOB_SECTION_MATERIALS);
    return materials[shape->material].bump != 0 ||
           (shape->kind == SHAPE_MESH && meshes[shape->geometry].first_normal != BLOB_NONE);
}

result_t pbrt_shape(pbrt_t *p, position_t at)
{
    size_t index;
    affine_t open, close;
    TRY(PBRT_READ_KIND(p, TARGET_SHAPE, shapes, "the shape's type", "shape", at, &index));
    if (index == LEFT_OUT) return result_ok();
    shape_work_t work = {.params = p->params, .at = at, .shape = {.geometry = BLOB_NONE}};
    bool moves = place(p, &work, &open, &close);
    affine_t inverse;
    if (!affine_invert(&open, &inverse) || !affine_invert(&close, &inverse))
        return error_at(at, "the current transform is singular or not finite");
    TRY(shapes[index].make(p, &work));
    TRY(read_alpha(p, &shapes[index], &work));
    TRY(pbrt_shape_material(p, p->params,
                            &work.shape.material)); /* last: v3 takes what the shape left unread */
    TRY(pbrt_finish_params(p, "Shape", p->arguments[0]));
    if (work.shape.geometry == BLOB_NONE) return result_ok();
    TRY(part_media(p, &work));
    settle_interface(p, &work.shape);
    if (work.shape.material == BLOB_NONE) return result_ok();
    if (p->dialect.dialect == DIALECT_V3 && has_shading_normals(p, &work.shape))
        work.shape.flags |= SHAPE_NORMALS_V3;
    return add_shape(p, &work, moves, &open, &close);
}
