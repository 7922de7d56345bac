/* shape_mesh: shapes that become triangle meshes: those that are given as such, and those that the
 * tessellators turn into one. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "client/import/files/ply.h"
#include "client/import/pbrt/shapes/shapes.h"
#include "client/import/tessellate/tessellate.h"

/* ---- into the blob ------------------------------------------------------------------------------------ */

/* Appends the mesh, if `made` is a success, and frees it; its normals are reversed on demand. */
static result_t finish_reversed(pbrt_t *p, shape_work_t *work, mesh_t *mesh, bool reverse, result_t made)
{
    size_t triangles = mesh->triangle_count;
    if (made.code == RESULT_OK) made = scene_charge(p->builder, SCENE_TRIANGLES, triangles, work->at);
    if (made.code != RESULT_OK) {
        mesh_free(mesh);
        return made;
    }
    TRY(mesh_add(p->builder, mesh, &work->placed, reverse, work->at, &work->shape));
    if (work->shape.geometry == BLOB_NONE) return result_ok();
    if (work->emitters == 0) work->emitters = triangles;
    if (p->now.emits) work->area = mesh_area(p->builder, work->shape.geometry);
    return result_ok();
}

static result_t finish_mesh(pbrt_t *p, shape_work_t *work, mesh_t *mesh, result_t made)
{
    return finish_reversed(p, work, mesh, p->now.reverse, made);
}

/* The same of a quadric, which a mirroring transform turns inside out (see shape_quadric.c). */
static result_t finish_quadric(pbrt_t *p, shape_work_t *work, mesh_t *mesh, result_t made)
{
    bool emits = p->now.emits && p->object == 0, mirrored = affine_determinant(&work->placed) < 0;
    work->inside_out = mirrored && emits;
    return finish_reversed(p, work, mesh, p->now.reverse != (mirrored && !emits), made);
}

/* The same of a mesh that is one in pbrt, too: v3 has its own idea of bumps on vertex normals. */
static result_t finish_triangles(pbrt_t *p, shape_work_t *work, mesh_t *mesh, result_t made)
{
    bool smooth = mesh->normals != NULL;
    TRY(finish_mesh(p, work, mesh, made));
    if (smooth && p->dialect.dialect == DIALECT_V3) work->shape.flags |= SHAPE_BUMPS_V3;
    return result_ok();
}

/* ---- triangle meshes ---------------------------------------------------------------------------------- */

static vec3_t *copy_vec3(const double *numbers, size_t count)
{
    vec3_t *copy = mem_alloc((count + 1) * sizeof *copy);
    for (size_t i = 0; i < count; ++i)
        copy[i] = vec3((float)numbers[3 * i], (float)numbers[3 * i + 1], (float)numbers[3 * i + 2]);
    return copy;
}

/* About a mesh that pbrt-v3 leaves out: it has no triangles. */
static result_t leave_out(pbrt_t *p, mesh_t *mesh, position_t at, const char *what)
{
    mesh->triangle_count = 0;
    return pbrt_slip(p, at, "the shape is left out", "%s", what);
}

static result_t read_positions(pbrt_t *p, params_t *params, position_t at, mesh_t *mesh)
{
    const double *numbers;
    size_t count;
    TRY(params_array(params, "P", PARAM_BIT(PARAM_POINT3), 3, &numbers, &count));
    if (count == 0)
        return leave_out(p, mesh, params_where(params, "P", at),
                         "a triangle mesh needs vertices: \"point3 P\"");
    if (count / 3 >= BLOB_NONE) return error_at(at, "too many vertices");
    mesh->vertex_count = (uint32_t)(count / 3);
    mesh->positions = copy_vec3(numbers, mesh->vertex_count);
    return result_ok();
}

static result_t read_normals(pbrt_t *p, params_t *params, position_t at, mesh_t *mesh)
{
    const double *numbers;
    size_t count;
    TRY(params_array(params, "N", PARAM_BIT(PARAM_NORMAL3) | PARAM_BIT(PARAM_VECTOR3), 3, &numbers, &count));
    if (count == 0) return result_ok();
    if (count / 3 != mesh->vertex_count)
        return report_tolerate(p->report, params_where(params, "N", at),
                               "%zu normals for %" PRIu32 " vertices; they are ignored, as by pbrt",
                               count / 3, mesh->vertex_count);
    mesh->normals = copy_vec3(numbers, mesh->vertex_count);
    return result_ok();
}

/* v4 ignores those that are too many as well; here the rest of them is left out. */
static result_t read_uvs(pbrt_t *p, params_t *params, position_t at, mesh_t *mesh)
{
    const char *name = params_has(params, "uv") ? "uv" : "st";
    const double *numbers;
    size_t count;
    unsigned types = PARAM_BIT(PARAM_FLOAT) | PARAM_BIT(PARAM_POINT2) | PARAM_BIT(PARAM_VECTOR2);
    TRY(params_array(params, name, types, 2, &numbers, &count));
    if (count == 0) return result_ok();
    at = params_where(params, name, at);
    if (count / 2 < mesh->vertex_count)
        return report_tolerate(p->report, at,
                               "%zu uv coordinates for %" PRIu32 " vertices; they are ignored, as by pbrt",
                               count / 2, mesh->vertex_count);
    if (count / 2 > mesh->vertex_count)
        report_warning(p->report, at, "%zu uv coordinates for %" PRIu32 " vertices; the rest is left out",
                       count / 2, mesh->vertex_count);
    mesh->uvs = mem_alloc(mesh->vertex_count * sizeof *mesh->uvs);
    for (size_t i = 0; i < mesh->vertex_count; ++i)
        mesh->uvs[i] = (vec2_t){(float)numbers[2 * i], (float)numbers[2 * i + 1]};
    return result_ok();
}

/* `count` is a multiple of three. */
static result_t copy_triangles(pbrt_t *p, position_t at, const double *numbers, size_t count, mesh_t *mesh)
{
    mesh->triangle_count = (uint32_t)(count / 3);
    mesh->triangles = mem_alloc(mesh->triangle_count * sizeof *mesh->triangles);
    for (size_t i = 0; i < count; ++i) {
        if (!(numbers[i] >= 0 && numbers[i] < mesh->vertex_count) || numbers[i] != floor(numbers[i])) {
            char what[120];
            snprintf(what, sizeof what, "index number %zu is %g, but must be an integer from 0 to %" PRIu32,
                     i, numbers[i], mesh->vertex_count - 1);
            return leave_out(p, mesh, at, what);
        }
        mesh->triangles[i / 3].v[i % 3] = (uint32_t)numbers[i];
    }
    return result_ok();
}

static result_t read_triangles(pbrt_t *p, params_t *params, position_t at, mesh_t *mesh)
{
    static const double one_triangle[3] = {0, 1, 2};
    const double *numbers;
    size_t count;
    TRY(params_array(params, "indices", PARAM_BIT(PARAM_INTEGER), 1, &numbers, &count));
    at = params_where(params, "indices", at);
    if (count == 0) {
        if (params_has(params, "indices") || mesh->vertex_count != 3)
            return leave_out(p, mesh, at, "a mesh of more than three vertices needs \"integer indices\"");
        numbers = one_triangle;
        count = 3;
    }
    if (count / 3 >= BLOB_NONE) return error_at(at, "too many triangles");
    if (count % 3 != 0)
        TRY(report_tolerate(p->report, at,
                            "parameter \"indices\" takes groups of 3 numbers, but has %zu; the rest is left "
                            "out, as by pbrt",
                            count));
    return copy_triangles(p, at, numbers, count - count % 3, mesh);
}

static const param_rule_t trianglemesh_rules[] = {
    {{"S"}, PARAM_IGNORE, "tangents only turn anisotropic reflection"},
    {{"faceIndices"}, PARAM_IGNORE, "only ptex textures use them"},
    {{"discarddegenerateUVs"}, PARAM_IGNORE, "such triangles are handled anyway"},
};

static const param_rule_t left_out_rules[] = {
    {{"N", "uv", "st", "indices", "S", "faceIndices"}, PARAM_ACCEPT, NULL},
};

static result_t fill_trianglemesh(pbrt_t *p, params_t *params, position_t at, mesh_t *mesh)
{
    TRY(read_positions(p, params, at, mesh));
    if (mesh->vertex_count == 0) /* what else it has has no use */
        return params_apply(params, left_out_rules, ARRAY_LENGTH(left_out_rules), p->report);
    TRY(read_normals(p, params, at, mesh));
    TRY(read_uvs(p, params, at, mesh));
    TRY(read_triangles(p, params, at, mesh));
    return params_apply(params, trianglemesh_rules, ARRAY_LENGTH(trianglemesh_rules), p->report);
}

result_t pbrt_make_trianglemesh(pbrt_t *p, shape_work_t *work)
{
    mesh_t mesh = {0};
    return finish_triangles(p, work, &mesh, fill_trianglemesh(p, work->params, work->at, &mesh));
}

static const param_rule_t plymesh_rules[] = {
    {{"displacement"}, PARAM_REFUSE, "displacement is not supported"},
    {{"edgelength"}, PARAM_IGNORE, "it only matters for displacement"},
};

result_t pbrt_make_plymesh(pbrt_t *p, shape_work_t *work)
{
    const char *filename = NULL;
    TRY(params_string(work->params, "filename", &filename));
    if (!filename) return error_at(work->at, "a plymesh needs its file: \"string filename\"");
    TRY(params_apply(work->params, plymesh_rules, ARRAY_LENGTH(plymesh_rules), p->report));
    mesh_t mesh = {0};
    char *path = pbrt_resolve(p, filename);
    uint64_t size = scene_count_file(p->builder, path);
    if (pbrt_is_missing(path)) {
        result_t slip = pbrt_missing(p, work->at, path, "the shape is left out");
        free(path);
        return slip;
    }
    ply_rules_t rules = p->dialect.dialect == DIALECT_V3 ? PLY_PBRT_V3 : PLY_PBRT_V4;
    uint64_t faces = 0;
    result_t result = ply_read(path, rules, p->report, &mesh, &faces);
    work->emitters = faces;
    free(mesh.colours); /* pbrt knows none */
    mesh.colours = NULL;
    p->bytes_done += size;
    if (result.code != RESULT_OK)
        result = result_fail(result.code, "%s (asked for in %s:%" PRIu32 ":%" PRIu32 ")", result.message,
                             work->at.path, work->at.line, work->at.column);
    free(path);
    return finish_triangles(p, work, &mesh, result);
}

/* ---- subdivision surfaces and grids ------------------------------------------------------------------- */

static const unsigned point_types =
    PARAM_BIT(PARAM_POINT3) | PARAM_BIT(PARAM_VECTOR3) | PARAM_BIT(PARAM_NORMAL3);

static result_t read_points(shape_work_t *work, const char *name, const double **numbers, size_t *count)
{
    return params_array(work->params, name, point_types, 3, numbers, count);
}

static result_t read_integers(shape_work_t *work, const char *name, const double **numbers, size_t *count)
{
    return params_array(work->params, name, PARAM_BIT(PARAM_INTEGER), 1, numbers, count);
}

/* One integer, which the tessellator checks. */
static result_t read_count(shape_work_t *work, const char *name, double *value)
{
    const double *numbers;
    size_t count;
    TRY(read_integers(work, name, &numbers, &count));
    if (count > 1)
        return error_at(params_where(work->params, name, work->at),
                        "parameter \"%s\" takes one value, found %zu", name, count);
    if (count == 1) *value = numbers[0];
    return result_ok();
}

static const param_rule_t loop_rules[] = {
    {{"scheme"}, PARAM_ACCEPT, NULL}, /* only Loop's there is */
};

result_t pbrt_make_loopsubdiv(pbrt_t *p, shape_work_t *work)
{
    loop_t loop = {.levels = 3};
    TRY(read_points(work, "P", &loop.positions, &loop.vertex_count));
    loop.vertex_count /= 3;
    TRY(read_integers(work, "indices", &loop.indices, &loop.index_count));
    TRY(read_count(work, "nlevels", &loop.levels));
    TRY(read_count(work, "levels", &loop.levels));
    TRY(params_apply(work->params, loop_rules, ARRAY_LENGTH(loop_rules), p->report));
    mesh_t mesh = {0};
    return finish_triangles(p, work, &mesh, tessellate_loop(&loop, work->at, &mesh));
}

result_t pbrt_make_heightfield(pbrt_t *p, shape_work_t *work)
{
    heightfield_t field = {0};
    TRY(read_count(work, "nu", &field.nu));
    TRY(read_count(work, "nv", &field.nv));
    TRY(params_array(work->params, "Pz", PARAM_BIT(PARAM_FLOAT), 1, &field.heights, &field.height_count));
    mesh_t mesh = {0};
    return finish_mesh(p, work, &mesh, tessellate_heightfield(&field, work->at, &mesh));
}

static const param_rule_t bilinear_rules[] = {
    {{"emissionfilename"}, PARAM_REFUSE, "an image of where to sample is not supported"},
    {{"faceIndices"}, PARAM_IGNORE, "only ptex textures use them"},
};

result_t pbrt_make_bilinearmesh(pbrt_t *p, shape_work_t *work)
{
    bilinear_t bilinear = {0};
    unsigned uv = PARAM_BIT(PARAM_FLOAT) | PARAM_BIT(PARAM_POINT2) | PARAM_BIT(PARAM_VECTOR2);
    TRY(read_points(work, "P", &bilinear.positions, &bilinear.vertex_count));
    TRY(read_points(work, "N", &bilinear.normals, &bilinear.normal_count));
    TRY(params_array(work->params, "uv", uv, 2, &bilinear.uvs, &bilinear.uv_count));
    TRY(read_integers(work, "indices", &bilinear.indices, &bilinear.index_count));
    bilinear.vertex_count /= 3;
    bilinear.normal_count /= 3;
    bilinear.uv_count /= 2;
    TRY(params_apply(work->params, bilinear_rules, ARRAY_LENGTH(bilinear_rules), p->report));
    work->emitters = bilinear.indices ? bilinear.index_count / 4 : 1;
    mesh_t mesh = {0};
    return finish_mesh(p, work, &mesh, tessellate_bilinear(&bilinear, work->at, &mesh));
}

/* ---- NURBS -------------------------------------------------------------------------------------------- */

typedef struct {
    const char *count, *order, *knots, *range[2];
} axis_names_t;

static result_t read_axis(shape_work_t *work, const axis_names_t *names, nurbs_axis_t *axis)
{
    TRY(read_count(work, names->count, &axis->count));
    TRY(read_count(work, names->order, &axis->order));
    TRY(params_array(work->params, names->knots, PARAM_BIT(PARAM_FLOAT), 1, &axis->knots, &axis->knot_count));
    axis->has_range = params_has(work->params, names->range[0]) || params_has(work->params, names->range[1]);
    if (!axis->has_range) return result_ok();
    size_t order = axis->order >= 1 && axis->order < 1e9 ? (size_t)axis->order : 1;
    size_t count = axis->count >= 0 && axis->count < 1e9 ? (size_t)axis->count : 0;
    if (order - 1 < axis->knot_count) axis->range[0] = axis->knots[order - 1];
    if (count < axis->knot_count) axis->range[1] = axis->knots[count];
    TRY(params_float(work->params, names->range[0], &axis->range[0]));
    return params_float(work->params, names->range[1], &axis->range[1]);
}

result_t pbrt_make_nurbs(pbrt_t *p, shape_work_t *work)
{
    static const axis_names_t u = {"nu", "uorder", "uknots", {"u0", "u1"}},
                              v = {"nv", "vorder", "vknots", {"v0", "v1"}};
    nurbs_t nurbs = {0};
    TRY(read_axis(work, &u, &nurbs.u));
    TRY(read_axis(work, &v, &nurbs.v));
    TRY(read_points(work, "P", &nurbs.points, &nurbs.number_count));
    if (nurbs.number_count == 0) {
        TRY(params_array(work->params, "Pw", PARAM_BIT(PARAM_FLOAT), 4, &nurbs.points, &nurbs.number_count));
        nurbs.rational = true;
    }
    mesh_t mesh = {0};
    return finish_triangles(p, work, &mesh, tessellate_nurbs(&nurbs, work->at, &mesh));
}

/* ---- surfaces of revolution --------------------------------------------------------------------------- */

result_t pbrt_make_cone(pbrt_t *p, shape_work_t *work)
{
    cone_t cone = {1, 1, 360};
    TRY(params_float(work->params, "radius", &cone.radius));
    TRY(params_float(work->params, "height", &cone.height));
    TRY(params_float(work->params, "phimax", &cone.phi_max));
    mesh_t mesh = {0};
    return finish_quadric(p, work, &mesh, tessellate_cone(&cone, work->at, &mesh));
}

result_t pbrt_make_paraboloid(pbrt_t *p, shape_work_t *work)
{
    paraboloid_t paraboloid = {1, 0, 1, 360};
    TRY(params_float(work->params, "radius", &paraboloid.radius));
    TRY(params_float(work->params, "zmin", &paraboloid.z_min));
    TRY(params_float(work->params, "zmax", &paraboloid.z_max));
    TRY(params_float(work->params, "phimax", &paraboloid.phi_max));
    mesh_t mesh = {0};
    return finish_quadric(p, work, &mesh, tessellate_paraboloid(&paraboloid, work->at, &mesh));
}

result_t pbrt_make_hyperboloid(pbrt_t *p, shape_work_t *work)
{
    hyperboloid_t hyperboloid = {{0, 0, 0}, {1, 1, 1}, 360};
    TRY(params_point(work->params, "p1", point_types, hyperboloid.p1));
    TRY(params_point(work->params, "p2", point_types, hyperboloid.p2));
    TRY(params_float(work->params, "phimax", &hyperboloid.phi_max));
    mesh_t mesh = {0};
    return finish_quadric(p, work, &mesh, tessellate_hyperboloid(&hyperboloid, work->at, &mesh));
}
