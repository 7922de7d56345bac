/* mesh: see mesh.h. */
#include "client/import/scene/mesh.h"

#include <float.h>
#include <inttypes.h>
#include <stdlib.h>

/* Embree wants coordinates below 2^60 or so; nobody models in such units. */
static const float largest_coordinate = 1e18f;

void mesh_free(mesh_t *mesh)
{
    free(mesh->positions);
    free(mesh->normals);
    free(mesh->tangents);
    free(mesh->bitangents);
    free(mesh->uvs);
    free(mesh->uvs2);
    free(mesh->colours);
    free(mesh->triangles);
    *mesh = (mesh_t){0};
}

static bool coordinates_usable(vec3_t p)
{
    return fabsf(p.x) < largest_coordinate && fabsf(p.y) < largest_coordinate &&
           fabsf(p.z) < largest_coordinate;
}

/* The times at which the mesh is given. */
static uint32_t steps_of(const mesh_t *mesh)
{
    return mesh->steps ? mesh->steps : 1;
}

/* What the mesh is at one of them; the arrays stay the mesh's. */
static mesh_t at_step(const mesh_t *mesh, uint32_t step)
{
    mesh_t out = *mesh;
    size_t first = (size_t)step * mesh->vertex_count;
    out.positions += first;
    if (out.normals) out.normals += first;
    return out;
}

static result_t transform_positions(mesh_t *mesh, const affine_t *object_from_mesh, position_t at)
{
    for (size_t i = 0; i < (size_t)mesh->vertex_count * steps_of(mesh); ++i) {
        vec3_t p = mesh->positions[i];
        mesh->positions[i] = affine_point(object_from_mesh, p);
        if (!coordinates_usable(mesh->positions[i]))
            return error_at(at, "vertex %zu lies at (%g %g %g): coordinates must be finite and below 1e18",
                            i % mesh->vertex_count, (double)p.x, (double)p.y, (double)p.z);
    }
    return result_ok();
}

static result_t check_uvs(const vec2_t *uvs, uint32_t count, position_t at)
{
    for (uint32_t i = 0; uvs && i < count; ++i)
        if (!isfinite(uvs[i].x) || !isfinite(uvs[i].y))
            return error_at(at, "the uv coordinates of vertex %" PRIu32 " are not finite", i);
    return result_ok();
}

static result_t check_colours(const mesh_t *mesh, position_t at)
{
    for (uint32_t i = 0; mesh->colours && i < mesh->vertex_count; ++i) {
        const blob_colour_t *c = &mesh->colours[i];
        if (!isfinite(c->r) || !isfinite(c->g) || !isfinite(c->b) || !isfinite(c->a))
            return error_at(at, "the colour of vertex %" PRIu32 " is not finite", i);
    }
    return result_ok();
}

static result_t check_indices(const mesh_t *mesh, position_t at)
{
    for (uint32_t i = 0; i < mesh->triangle_count; ++i)
        for (int k = 0; k < 3; ++k)
            if (mesh->triangles[i].v[k] >= mesh->vertex_count)
                return error_at(at,
                                "triangle %" PRIu32 " uses vertex %" PRIu32 ", but there are %" PRIu32
                                " vertices, counted from 0",
                                i, mesh->triangles[i].v[k], mesh->vertex_count);
    return result_ok();
}

/* Twice the area, along (p1 - p0) x (p2 - p0). */
static vec3_t triangle_normal(const mesh_t *mesh, const blob_triangle_t *t)
{
    vec3_t p = mesh->positions[t->v[0]];
    return v_cross(v_sub(mesh->positions[t->v[1]], p), v_sub(mesh->positions[t->v[2]], p));
}

/* Whether a triangle has an area, at any time, whose square is not a denormal, which the renderer flushes. */
static bool has_area(const mesh_t *mesh, const blob_triangle_t *triangle)
{
    for (uint32_t k = 0; k < steps_of(mesh); ++k) {
        mesh_t now = at_step(mesh, k);
        if (v_length2(triangle_normal(&now, triangle)) >= FLT_MIN) return true;
    }
    return false;
}

/* Removes triangles without area. */
static void drop_degenerate(mesh_t *mesh, position_t at, report_t *report)
{
    uint32_t kept = 0, total = mesh->triangle_count;
    for (uint32_t i = 0; i < total; ++i)
        if (has_area(mesh, &mesh->triangles[i])) mesh->triangles[kept++] = mesh->triangles[i];
    mesh->triangle_count = kept;
    if (kept < total)
        report_warning(report, at, "%" PRIu32 " of %" PRIu32 " triangles have no area and are left out",
                       total - kept, total);
}

/* A vertex whose normal has no direction gets the mean of its triangles' normals, weighted by area. */
static void mend_normals(mesh_t *mesh, bool flip, uint32_t missing, position_t at, report_t *report)
{
    report_warning(report, at,
                   "%" PRIu32 " of %" PRIu32 " vertex normals have no direction; the mean of the "
                   "triangles about the vertex is used",
                   missing, mesh->vertex_count);
    vec3_t *sums = mem_zalloc(mesh->vertex_count, sizeof *sums);
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        vec3_t n = triangle_normal(mesh, &mesh->triangles[i]);
        for (int k = 0; k < 3; ++k) {
            vec3_t *sum = &sums[mesh->triangles[i].v[k]];
            *sum = v_mad(*sum, flip ? -1.0f : 1.0f, n);
        }
    }
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        if (!v_is_zero(mesh->normals[i])) continue;
        bool usable = v_length2(sums[i]) >= FLT_MIN && isfinite(v_length2(sums[i]));
        mesh->normals[i] = usable ? v_normalize(sums[i]) : vec3(0, 0, 1);
    }
    free(sums);
}

static void transform_normals(mesh_t *mesh, const affine_t *inverse, bool reverse, bool flip, position_t at,
                              report_t *report)
{
    uint32_t missing = 0;
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        vec3_t n = affine_normal(inverse, mesh->normals[i]);
        mesh->normals[i] = reverse ? v_neg(n) : n;
        missing += v_is_zero(n);
    }
    if (missing) mend_normals(mesh, flip, missing, at, report);
}

static void transform_tangents(const mesh_t *mesh, const affine_t *object_from_mesh)
{
    for (size_t i = 0; mesh->tangents && i < (size_t)mesh->vertex_count * steps_of(mesh); ++i) {
        mesh->tangents[i] = affine_direction(object_from_mesh, mesh->tangents[i]);
        mesh->bitangents[i] = affine_direction(object_from_mesh, mesh->bitangents[i]);
    }
}

/* Appends an array and frees it, so that no large mesh is in memory twice. */
static uint32_t hand_over(blob_builder_t *builder, blob_section_t section, void *records, uint32_t count)
{
    uint32_t first = blob_builder_add(builder, section, records, count);
    free(records);
    return first;
}

static uint32_t append(mesh_t *mesh, blob_builder_t *builder)
{
    uint32_t vertices = mesh->vertex_count, triangles = mesh->triangle_count;
    blob_mesh_t record = {.vertex_count = vertices,
                          .triangle_count = triangles,
                          .steps = mesh->steps,
                          .first_normal = BLOB_NONE,
                          .first_uv = BLOB_NONE,
                          .first_uv2 = BLOB_NONE,
                          .first_colour = BLOB_NONE};
    uint32_t places = vertices * steps_of(mesh);
    record.first_position = hand_over(builder, BLOB_SECTION_POSITIONS, mesh->positions, places);
    if (mesh->normals) record.first_normal = hand_over(builder, BLOB_SECTION_NORMALS, mesh->normals, places);
    if (mesh->tangents) {
        record.first_tangent = 1 + hand_over(builder, BLOB_SECTION_NORMALS, mesh->tangents, places);
        hand_over(builder, BLOB_SECTION_NORMALS, mesh->bitangents, places);
    }
    if (mesh->uvs) record.first_uv = hand_over(builder, BLOB_SECTION_UVS, mesh->uvs, vertices);
    if (mesh->uvs2) record.first_uv2 = hand_over(builder, BLOB_SECTION_UVS, mesh->uvs2, vertices);
    if (mesh->colours)
        record.first_colour = hand_over(builder, BLOB_SECTION_COLOURS, mesh->colours, vertices);
    record.first_triangle = hand_over(builder, BLOB_SECTION_TRIANGLES, mesh->triangles, triangles);
    *mesh = (mesh_t){0};
    return blob_builder_add(builder, BLOB_SECTION_MESHES, &record, 1);
}

static result_t add(scene_builder_t *scene, mesh_t *mesh, const affine_t *object_from_mesh, bool reverse,
                    position_t at, blob_shape_t *shape)
{
    affine_t inverse;
    if (!affine_invert(object_from_mesh, &inverse))
        return error_at(at, "the current transform is singular or not finite");
    bool flip = reverse != (affine_determinant(object_from_mesh) < 0);
    TRY(check_indices(mesh, at));
    TRY(check_uvs(mesh->uvs, mesh->vertex_count, at));
    TRY(check_uvs(mesh->uvs2, mesh->vertex_count, at));
    TRY(check_colours(mesh, at));
    TRY(transform_positions(mesh, object_from_mesh, at));
    drop_degenerate(mesh, at, scene->report);
    shape->kind = SHAPE_MESH;
    shape->flags = flip ? SHAPE_FLIP : 0;
    shape->geometry = BLOB_NONE;
    if (mesh->triangle_count == 0) return result_ok();
    for (uint32_t k = 0; mesh->normals && k < steps_of(mesh); ++k) {
        mesh_t now = at_step(mesh, k);
        transform_normals(&now, &inverse, reverse, flip, at, scene->report);
    }
    transform_tangents(mesh, object_from_mesh);
    shape->geometry = append(mesh, scene->blob);
    return result_ok();
}

result_t mesh_add(scene_builder_t *scene, mesh_t *mesh, const affine_t *object_from_mesh, bool reverse,
                  position_t at, blob_shape_t *shape)
{
    result_t result = add(scene, mesh, object_from_mesh, reverse, at, shape);
    mesh_free(mesh);
    return result;
}

/* The angle at corner k. */
static float corner_angle(const mesh_t *mesh, const blob_triangle_t *t, int k)
{
    vec3_t p = mesh->positions[t->v[k]];
    vec3_t a = v_sub(mesh->positions[t->v[(k + 1) % 3]], p), b = v_sub(mesh->positions[t->v[(k + 2) % 3]], p);
    return atan2f(v_length(v_cross(a, b)), v_dot(a, b));
}

result_t mesh_smooth(mesh_t *mesh, position_t at)
{
    TRY(check_indices(mesh, at));
    free(mesh->normals);
    mesh->normals = mem_zalloc(mesh->vertex_count, sizeof *mesh->normals);
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        const blob_triangle_t *t = &mesh->triangles[i];
        vec3_t n = triangle_normal(mesh, t);
        float length = v_length(n);
        if (!(length > 0) || !isfinite(length)) continue;
        for (int k = 0; k < 3; ++k) {
            vec3_t *sum = &mesh->normals[t->v[k]];
            *sum = v_mad(*sum, corner_angle(mesh, t, k) / length, n);
        }
    }
    return result_ok();
}

double mesh_area(const scene_builder_t *scene, uint32_t geometry)
{
    const blob_mesh_t *mesh =
        (blob_mesh_t *)blob_builder_records(scene->blob, BLOB_SECTION_MESHES) + geometry;
    const vec3_t *v =
        (vec3_t *)blob_builder_records(scene->blob, BLOB_SECTION_POSITIONS) + mesh->first_position;
    const blob_triangle_t *t =
        (blob_triangle_t *)blob_builder_records(scene->blob, BLOB_SECTION_TRIANGLES) + mesh->first_triangle;
    double area = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        vec3_t a = v[t[i].v[0]], b = v[t[i].v[1]], c = v[t[i].v[2]];
        area += (double)v_length(v_cross(v_sub(b, a), v_sub(c, a))) / 2;
    }
    return area;
}
