/* grid: see grid.h. */
#include "client/import/tessellate/grid.h"

void mesh_reserve(mesh_t *mesh, size_t vertices, size_t triangles, bool normals, bool uvs)
{
    mesh->positions = mem_alloc((vertices + 1) * sizeof *mesh->positions);
    mesh->triangles = mem_alloc((triangles + 1) * sizeof *mesh->triangles);
    if (normals) mesh->normals = mem_alloc((vertices + 1) * sizeof *mesh->normals);
    if (uvs) mesh->uvs = mem_alloc((vertices + 1) * sizeof *mesh->uvs);
}

static bool same_place(const mesh_t *mesh, uint32_t a, uint32_t b)
{
    vec3_t p = mesh->positions[a], q = mesh->positions[b];
    return p.x == q.x && p.y == q.y && p.z == q.z;
}

void mesh_triangle(mesh_t *mesh, uint32_t a, uint32_t b, uint32_t c)
{
    if (same_place(mesh, a, b) || same_place(mesh, b, c) || same_place(mesh, c, a)) return;
    mesh->triangles[mesh->triangle_count++] = (blob_triangle_t){{a, b, c}};
}

void mesh_grid(mesh_t *mesh, uint32_t first, uint32_t columns, uint32_t rows)
{
    for (uint32_t v = 0; v + 1 < rows; ++v) {
        for (uint32_t u = 0; u + 1 < columns; ++u) {
            uint32_t corner = first + v * columns + u;
            mesh_triangle(mesh, corner, corner + 1, corner + columns + 1);
            mesh_triangle(mesh, corner, corner + columns + 1, corner + columns);
        }
    }
}

result_t take_index(double index, size_t limit, size_t place, position_t at, uint32_t *out)
{
    if (!(index >= 0 && index < (double)limit) || index != floor(index))
        return error_at(at, "index number %zu is %g, but must be an integer from 0 to %zu", place, index,
                        limit - 1);
    *out = (uint32_t)index;
    return result_ok();
}
