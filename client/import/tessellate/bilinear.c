/* bilinear: meshes of bilinear patches.
 *
 * p(u, v) = p00 + u (p10 - p00) + v (p01 - p00) + u v t with the twist t = p00 - p10 - p01 + p11. Without
 * twist the patch is a parallelogram and two triangles are exact, its uv too. Otherwise a cell of an n x n
 * grid has the twist t / n^2, and its triangles leave the surface by at most a quarter of that: n follows
 * from it.
 */
#include "client/import/tessellate/grid.h"
#include "client/import/tessellate/tessellate.h"

enum { MOST_CELLS = 64 };
static const double largest_deviation = 1.0 / 4096; /* of the longest edge */
static const double least_twist = 1e-6;             /* of the longest edge: that much rounding of the file */

typedef struct {
    uint32_t v[4]; /* p00, p10, p01, p11 */
    dvec3_t p[4];
} patch_t;

static result_t read_patch(const bilinear_t *in, size_t index, position_t at, patch_t *patch)
{
    for (size_t k = 0; k < 4; ++k) {
        patch->v[k] = (uint32_t)k;
        if (in->indices)
            TRY(take_index(in->indices[4 * index + k], in->vertex_count, 4 * index + k, at, &patch->v[k]));
        patch->p[k] = d_vec3(in->positions + 3 * (size_t)patch->v[k]);
    }
    return result_ok();
}

/* Cells along each side; 1 for a parallelogram, which `flat` tells apart from a patch that is nearly one. */
static uint32_t cells_of(const patch_t *patch, bool *flat)
{
    const dvec3_t *p = patch->p;
    double longest = fmax(fmax(d_length(d_sub(p[1], p[0])), d_length(d_sub(p[3], p[2]))),
                          fmax(d_length(d_sub(p[2], p[0])), d_length(d_sub(p[3], p[1]))));
    double twist = d_length(d_sub(d_add(p[0], p[3]), d_add(p[1], p[2])));
    *flat = !(twist > least_twist * longest);
    if (*flat) return 1;
    double cells = ceil(sqrt(twist / longest / (4 * largest_deviation)));
    return cells < MOST_CELLS ? (uint32_t)fmax(cells, 1) : MOST_CELLS;
}

static dvec3_t blend3(const dvec3_t p[4], double u, double v)
{
    return d_lerp(v, d_lerp(u, p[0], p[1]), d_lerp(u, p[2], p[3]));
}

static dvec3_t cross_at(const patch_t *patch, double u, double v)
{
    const dvec3_t *p = patch->p;
    return d_cross(d_lerp(v, d_sub(p[1], p[0]), d_sub(p[3], p[2])),
                   d_lerp(u, d_sub(p[2], p[0]), d_sub(p[3], p[1])));
}

/* dp/du x dp/dv; where an edge has no length, its limit from within. */
static vec3_t surface_normal(const patch_t *patch, double u, double v)
{
    dvec3_t normal = cross_at(patch, u, v), inside = cross_at(patch, 0.5, 0.5);
    if (!(d_length(normal) > 1e-9 * d_length(inside)))
        normal = cross_at(patch, u + 1e-3 * (0.5 - u), v + 1e-3 * (0.5 - v));
    return d_direction(normal);
}

static vec3_t given_normal(const bilinear_t *in, const patch_t *patch, double u, double v)
{
    dvec3_t corners[4];
    for (int k = 0; k < 4; ++k) corners[k] = d_vec3(in->normals + 3 * (size_t)patch->v[k]);
    return d_direction(blend3(corners, u, v));
}

static vec2_t uv_at(const bilinear_t *in, const patch_t *patch, double u, double v)
{
    if (!in->uvs) return (vec2_t){(float)u, (float)v};
    dvec3_t corners[4];
    for (int k = 0; k < 4; ++k) {
        const double *uv = in->uvs + 2 * (size_t)patch->v[k];
        corners[k] = (dvec3_t){uv[0], uv[1], 0};
    }
    dvec3_t uv = blend3(corners, u, v);
    return (vec2_t){(float)uv.x, (float)uv.y};
}

static void add_patch(const bilinear_t *in, const patch_t *patch, uint32_t cells, mesh_t *mesh)
{
    uint32_t first = mesh->vertex_count;
    for (uint32_t j = 0; j <= cells; ++j) {
        for (uint32_t i = 0; i <= cells; ++i) {
            double u = (double)i / cells, v = (double)j / cells;
            uint32_t vertex = mesh->vertex_count++;
            mesh->positions[vertex] = d_to_float(blend3(patch->p, u, v));
            mesh->uvs[vertex] = uv_at(in, patch, u, v);
            if (!mesh->normals) continue;
            if (in->normals) mesh->normals[vertex] = given_normal(in, patch, u, v);
            if (!in->normals || v_is_zero(mesh->normals[vertex]))
                mesh->normals[vertex] = surface_normal(patch, u, v);
        }
    }
    mesh_grid(mesh, first, cells + 1, cells + 1);
}

static result_t check_counts(const bilinear_t *in, position_t at)
{
    if (in->vertex_count == 0 || in->vertex_count >= BLOB_NONE)
        return error_at(at, "a bilinear mesh of %zu vertices \"P\"", in->vertex_count);
    if (in->indices ? in->index_count == 0 || in->index_count % 4 != 0 : in->vertex_count != 4)
        return error_at(
            at,
            "a bilinear mesh of %zu vertices and %zu indices: four indices make a patch, and only "
            "a single patch of four vertices needs none",
            in->vertex_count, in->indices ? in->index_count : 0);
    if (in->normals && in->normal_count != in->vertex_count)
        return error_at(at, "%zu normals for %zu vertices", in->normal_count, in->vertex_count);
    if (in->uvs && in->uv_count != in->vertex_count)
        return error_at(at, "%zu uv coordinates for %zu vertices", in->uv_count, in->vertex_count);
    return result_ok();
}

result_t tessellate_bilinear(const bilinear_t *bilinear, position_t at, mesh_t *mesh)
{
    TRY(check_counts(bilinear, at));
    size_t patches = bilinear->indices ? bilinear->index_count / 4 : 1, vertices = 0, triangles = 0;
    bool curved = false, flat;
    patch_t patch;
    for (size_t i = 0; i < patches; ++i) {
        TRY(read_patch(bilinear, i, at, &patch));
        size_t cells = cells_of(&patch, &flat);
        curved = curved || !flat;
        vertices += (cells + 1) * (cells + 1);
        triangles += 2 * cells * cells;
        if (triangles >= TESSELLATE_MAX_TRIANGLES)
            return error_at(at, "the bilinear mesh takes more than %u triangles",
                            TESSELLATE_MAX_TRIANGLES - 1);
    }
    mesh_reserve(mesh, vertices, triangles, curved || bilinear->normals, true);
    for (size_t i = 0; i < patches; ++i) {
        TRY(read_patch(bilinear, i, at, &patch));
        add_patch(bilinear, &patch, cells_of(&patch, &flat), mesh);
    }
    return result_ok();
}
