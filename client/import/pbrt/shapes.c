/* shapes: the Shape directive and the table of shapes. */
#include "client/import/pbrt/directives.h"

#include <inttypes.h>
#include <stdlib.h>

#include "client/import/mesh.h"
#include "client/import/ply.h"

typedef struct {
    entry_t entry;
    /* Appends the geometry and fills kind, geometry and flags; geometry BLOB_NONE when nothing is left of it.
     * NULL: not supported yet. */
    result_t (*make)(pbrt_t *p, params_t *params, position_t at, blob_shape_t *shape);
} shape_entry_t;

/* ---- meshes -------------------------------------------------------------------------------------------- */

/* Appends a mesh in the shape's own space. */
static result_t add_mesh(pbrt_t *p, mesh_t *mesh, position_t at, blob_shape_t *shape)
{
    bool flip;
    TRY(mesh_add(mesh, &p->now.ctm, p->now.reverse, at, p->report, p->builder, &shape->geometry, &flip));
    shape->kind = SHAPE_MESH;
    shape->flags = flip ? SHAPE_FLIP : 0;
    return result_ok();
}

static vec3_t *copy_vec3(const double *numbers, size_t count)
{
    vec3_t *copy = mem_alloc((count + 1) * sizeof *copy);
    for (size_t i = 0; i < count; ++i)
        copy[i] = vec3((float)numbers[3 * i], (float)numbers[3 * i + 1], (float)numbers[3 * i + 2]);
    return copy;
}

static result_t read_positions(params_t *params, position_t at, mesh_t *mesh)
{
    const double *numbers;
    size_t count;
    TRY(params_array(params, "P", PARAM_BIT(PARAM_POINT3), 3, &numbers, &count));
    if (count == 0)
        return error_at(params_where(params, "P", at), "a triangle mesh needs vertices: \"point3 P\"");
    if (count / 3 >= BLOB_NONE) return error_at(at, "too many vertices");
    mesh->vertex_count = (uint32_t)(count / 3);
    mesh->positions = copy_vec3(numbers, mesh->vertex_count);
    return result_ok();
}

static result_t read_normals(params_t *params, position_t at, mesh_t *mesh)
{
    const double *numbers;
    size_t count;
    TRY(params_array(params, "N", PARAM_BIT(PARAM_NORMAL3) | PARAM_BIT(PARAM_VECTOR3), 3, &numbers, &count));
    if (count == 0) return result_ok();
    if (count / 3 != mesh->vertex_count)
        return error_at(params_where(params, "N", at), "%zu normals for %" PRIu32 " vertices", count / 3,
                        mesh->vertex_count);
    mesh->normals = copy_vec3(numbers, mesh->vertex_count);
    return result_ok();
}

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
        return error_at(at, "%zu uv coordinates for %" PRIu32 " vertices", count / 2, mesh->vertex_count);
    if (count / 2 > mesh->vertex_count)
        report_warning(p->report, at, "%zu uv coordinates for %" PRIu32 " vertices; the rest is left out",
                       count / 2, mesh->vertex_count);
    mesh->uvs = mem_alloc(mesh->vertex_count * sizeof *mesh->uvs);
    for (size_t i = 0; i < mesh->vertex_count; ++i)
        mesh->uvs[i] = (vec2_t){(float)numbers[2 * i], (float)numbers[2 * i + 1]};
    return result_ok();
}

static result_t read_triangles(params_t *params, position_t at, mesh_t *mesh)
{
    static const double one_triangle[3] = {0, 1, 2};
    const double *numbers;
    size_t count;
    TRY(params_array(params, "indices", PARAM_BIT(PARAM_INTEGER), 3, &numbers, &count));
    at = params_where(params, "indices", at);
    if (count == 0) {
        if (params_has(params, "indices") || mesh->vertex_count != 3)
            return error_at(at, "a mesh of more than three vertices needs \"integer indices\"");
        numbers = one_triangle;
        count = 3;
    }
    if (count / 3 >= BLOB_NONE) return error_at(at, "too many triangles");
    mesh->triangle_count = (uint32_t)(count / 3);
    mesh->triangles = mem_alloc(mesh->triangle_count * sizeof *mesh->triangles);
    for (size_t i = 0; i < count; ++i) {
        if (!(numbers[i] >= 0 && numbers[i] < mesh->vertex_count) || numbers[i] != floor(numbers[i]))
            return error_at(at, "index number %zu is %g, but must be an integer from 0 to %" PRIu32, i,
                            numbers[i], mesh->vertex_count - 1);
        mesh->triangles[i / 3].v[i % 3] = (uint32_t)numbers[i];
    }
    return result_ok();
}

static const param_rule_t trianglemesh_rules[] = {
    {"S", PARAM_IGNORE, "tangents only turn anisotropic reflection"},
    {"faceIndices", PARAM_IGNORE, "only ptex textures use them"},
    {"discarddegenerateUVs", PARAM_IGNORE, "such triangles are handled anyway"},
};

static result_t fill_trianglemesh(pbrt_t *p, params_t *params, position_t at, mesh_t *mesh)
{
    TRY(read_positions(params, at, mesh));
    TRY(read_normals(params, at, mesh));
    TRY(read_uvs(p, params, at, mesh));
    TRY(read_triangles(params, at, mesh));
    return params_apply(params, trianglemesh_rules, ARRAY_LENGTH(trianglemesh_rules), p->report);
}

static result_t make_trianglemesh(pbrt_t *p, params_t *params, position_t at, blob_shape_t *shape)
{
    mesh_t mesh = {0};
    result_t result = fill_trianglemesh(p, params, at, &mesh);
    if (result.code == RESULT_OK) result = add_mesh(p, &mesh, at, shape);
    mesh_free(&mesh);
    return result;
}

static const param_rule_t plymesh_rules[] = {
    {"displacement", PARAM_REFUSE, "displacement is not supported yet"},
    {"edgelength", PARAM_IGNORE, "it only matters for displacement"},
};

static result_t make_plymesh(pbrt_t *p, params_t *params, position_t at, blob_shape_t *shape)
{
    const char *filename = NULL;
    TRY(params_string(params, "filename", &filename));
    if (!filename) return error_at(at, "a plymesh needs its file: \"string filename\"");
    TRY(params_apply(params, plymesh_rules, ARRAY_LENGTH(plymesh_rules), p->report));
    mesh_t mesh = {0};
    char *path = pbrt_resolve(p, filename);
    result_t result = ply_read(path, p->report, &mesh);
    if (result.code == RESULT_OK)
        result = add_mesh(p, &mesh, at, shape);
    else
        result = result_fail(result.code, "%s (asked for in %s:%" PRIu32 ":%" PRIu32 ")", result.message,
                             at.path, at.line, at.column);
    free(path);
    mesh_free(&mesh);
    return result;
}

/* ---- spheres ------------------------------------------------------------------------------------------- */

static result_t require_full(params_t *params, double radius, position_t at)
{
    double z_min = -radius, z_max = radius, phi_max = 360;
    TRY(params_float(params, "zmin", &z_min));
    TRY(params_float(params, "zmax", &z_max));
    TRY(params_float(params, "phimax", &phi_max));
    if (fmin(z_min, z_max) > -radius || fmax(z_min, z_max) < radius || phi_max < 360) {
        const char *name = phi_max < 360 ? "phimax" : fmin(z_min, z_max) > -radius ? "zmin" : "zmax";
        return error_at(params_where(params, name, at),
                        "parts of a sphere are not supported yet; remove \"%s\"", name);
    }
    return result_ok();
}

/* A sphere's normals point outward, also under a mirroring transform, and ReverseOrientation alone turns them
 * in. (pbrt turns them in under a mirroring where a ray hits, but not where its light is sampled; the latter
 * is what a reader of the scene expects.) */
static result_t make_sphere(pbrt_t *p, params_t *params, position_t at, blob_shape_t *shape)
{
    double radius = 1;
    TRY(params_float(params, "radius", &radius));
    if (!((float)radius > 0) || !isfinite((float)radius))
        return error_at(params_where(params, "radius", at), "the radius is %g, but must be positive", radius);
    TRY(require_full(params, radius, at));
    blob_sphere_t sphere = {affine_to_xform(&p->now.ctm), (float)radius};
    xform_t inverse;
    if (!xform_invert(&sphere.object_from_sphere, &inverse))
        return error_at(at, "the current transform is singular or not finite");
    shape->kind = SHAPE_SPHERE;
    shape->geometry = blob_builder_add(p->builder, BLOB_SECTION_SPHERES, &sphere, 1);
    shape->flags = p->now.reverse ? SHAPE_FLIP : 0;
    return result_ok();
}

/* ---- the directive ------------------------------------------------------------------------------------- */

static const shape_entry_t shapes[] = {
    {{"trianglemesh", DIALECT_BOTH}, make_trianglemesh},
    {{"plymesh", DIALECT_BOTH}, make_plymesh},
    {{"sphere", DIALECT_BOTH}, make_sphere},
    {{"disk", DIALECT_BOTH}, NULL},
    {{"cylinder", DIALECT_BOTH}, NULL},
    {{"cone", DIALECT_V3}, NULL},
    {{"paraboloid", DIALECT_V3}, NULL},
    {{"hyperboloid", DIALECT_V3}, NULL},
    {{"curve", DIALECT_BOTH}, NULL},
    {{"loopsubdiv", DIALECT_BOTH}, NULL},
    {{"nurbs", DIALECT_V3}, NULL},
    {{"heightfield", DIALECT_V3}, NULL},
    {{"bilinearmesh", DIALECT_V4}, NULL},
};

/* alpha masks: only the value that masks nothing. */
static result_t require_opaque(pbrt_t *p, params_t *params, position_t at)
{
    static const char *const names[] = {"alpha", "shadowalpha"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        double alpha = 1;
        TRY(pbrt_float_value(p, params, names[i], &alpha));
        if (alpha != 1)
            return error_at(params_where(params, names[i], at),
                            "alpha masks are not supported yet; remove \"%s\"", names[i]);
    }
    return result_ok();
}

result_t pbrt_shape(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(pbrt_read_string(p, 0, "the shape's type"));
    TRY(pbrt_read_params_for(p, TARGET_SHAPE));
    TRY(entry_find(shapes, ARRAY_LENGTH(shapes), sizeof *shapes, "shape", p->arguments[0], &p->dialect, at,
                   &index));
    if (!shapes[index].make) return error_at(at, "shape \"%s\" is not supported yet", p->arguments[0]);
    blob_shape_t shape = {.geometry = BLOB_NONE};
    TRY(shapes[index].make(p, p->params, at, &shape));
    TRY(require_opaque(p, p->params, at));
    TRY(pbrt_wear_material(p, p->params, &shape.material));
    TRY(pbrt_finish_params(p, "Shape", p->arguments[0]));
    if (shape.geometry != BLOB_NONE) pbrt_add_shape(p, shape, at);
    return result_ok();
}
