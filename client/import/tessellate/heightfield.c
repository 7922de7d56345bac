/* heightfield: heights over the unit square. */
#include "client/import/tessellate/grid.h"
#include "client/import/tessellate/tessellate.h"

result_t tessellate_heightfield(const heightfield_t *field, position_t at, mesh_t *mesh)
{
    double nu = field->nu, nv = field->nv, triangles = 2 * (nu - 1) * (nv - 1);
    if (!(nu >= 2 && nv >= 2) || nu != floor(nu) || nv != floor(nv))
        return error_at(at, "a heightfield of nu %g by nv %g heights: both must be integers of at least 2",
                        nu, nv);
    if (!(triangles < TESSELLATE_MAX_TRIANGLES))
        return error_at(at, "a heightfield of %g by %g heights has %g triangles, over the limit of %u", nu,
                        nv, triangles, TESSELLATE_MAX_TRIANGLES - 1);
    if (nu * nv != (double)field->height_count)
        return error_at(at, "%zu heights \"Pz\" for a heightfield of %g by %g", field->height_count, nu, nv);
    uint32_t columns = (uint32_t)nu, rows = (uint32_t)nv;
    mesh_reserve(mesh, field->height_count, (size_t)triangles, false, true);
    for (uint32_t y = 0; y < rows; ++y) {
        for (uint32_t x = 0; x < columns; ++x) {
            uint32_t i = mesh->vertex_count++;
            vec2_t uv = {(float)x / (float)(columns - 1), (float)y / (float)(rows - 1)};
            mesh->positions[i] = vec3(uv.x, uv.y, (float)field->heights[i]);
            mesh->uvs[i] = uv;
        }
    }
    mesh_grid(mesh, 0, columns, rows);
    return result_ok();
}
