/* crease: see crease.h. */
#include "client/import/scene/crease.h"

#include <stdlib.h>
#include <string.h>

/* ---- vertices that are alike --------------------------------------------------------------------------- */

/* Numbers by their bits, but 0 and -0 are alike: adding 0 makes one of them. */
static int compare_numbers(const float *a, const float *b, int count)
{
    int order = 0;
    for (int i = 0; i < count && order == 0; ++i) {
        const float x = a[i] + 0.0f, y = b[i] + 0.0f;
        order = memcmp(&x, &y, sizeof x);
    }
    return order;
}

static int compare_vertices(const mesh_t *mesh, uint32_t a, uint32_t b)
{
    int order = compare_numbers(&mesh->positions[a].x, &mesh->positions[b].x, 3);
    if (order == 0 && mesh->uvs) order = compare_numbers(&mesh->uvs[a].x, &mesh->uvs[b].x, 2);
    if (order == 0 && mesh->colours) order = compare_numbers(&mesh->colours[a].r, &mesh->colours[b].r, 4);
    return order;
}

/* For qsort_r: those that are alike by their numbers. */
static int compare(const void *left, const void *right, void *mesh)
{
    uint32_t a = *(const uint32_t *)left, b = *(const uint32_t *)right;
    int order = compare_vertices(mesh, a, b);
    return order != 0 ? order : (a > b) - (a < b);
}

/* An array of `count` new vertices, of which each was source[i]; frees that of the old ones. */
static void *collect(void *array, size_t size, const uint32_t *source, uint32_t count)
{
    if (!array) return NULL;
    char *made = mem_alloc(count * size);
    for (uint32_t i = 0; i < count; ++i) memcpy(made + i * size, (char *)array + source[i] * size, size);
    free(array);
    return made;
}

static void collect_all(mesh_t *mesh, const uint32_t *source, uint32_t count)
{
    mesh->positions = collect(mesh->positions, sizeof *mesh->positions, source, count);
    mesh->uvs = collect(mesh->uvs, sizeof *mesh->uvs, source, count);
    mesh->colours = collect(mesh->colours, sizeof *mesh->colours, source, count);
    mesh->vertex_count = count;
}

void mesh_join(mesh_t *mesh)
{
    uint32_t *sorted = mem_alloc(mesh->vertex_count * sizeof *sorted), kept = 0;
    uint32_t *number = mem_alloc(mesh->vertex_count * sizeof *number); /* of the first that is alike */
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) sorted[i] = i;
    qsort_r(sorted, mesh->vertex_count, sizeof *sorted, compare, mesh);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        bool alike = i > 0 && compare_vertices(mesh, sorted[i - 1], sorted[i]) == 0;
        number[sorted[i]] = alike ? number[sorted[i - 1]] : sorted[i];
    }
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) { /* the first has its new number already */
        if (number[i] == i) sorted[kept] = i;
        number[i] = number[i] == i ? kept++ : number[number[i]];
    }
    for (size_t i = 0; i < mesh->triangle_count; ++i)
        for (int k = 0; k < 3; ++k) mesh->triangles[i].v[k] = number[mesh->triangles[i].v[k]];
    free(mesh->normals);
    mesh->normals = NULL;
    collect_all(mesh, sorted, kept);
    free(sorted);
    free(number);
}

/* ---- groups of triangles ------------------------------------------------------------------------------- */

typedef struct {
    mesh_t *mesh;
    vec3_t *normals;  /* unit, of the triangles */
    uint32_t *source; /* of each new vertex, which it was */
    uint32_t count;   /* of the new vertices */
    float cosine;
} crease_t;

/* Corner k of triangle i is 3 i + k. Returns the vertex that it had. */
static uint32_t give(crease_t *c, uint32_t corner, uint32_t vertex)
{
    uint32_t *v = &c->mesh->triangles[corner / 3].v[corner % 3];
    uint32_t before = *v;
    *v = vertex;
    return before;
}

static bool are_close(const crease_t *c, vec3_t a, vec3_t b)
{
    return v_dot(a, b) > c->cosine || (a.x == b.x && a.y == b.y && a.z == b.z);
}

/* Takes the group of the first of the corners out of them; returns how many are left. */
static uint32_t take_group(crease_t *c, uint32_t *corners, uint32_t count)
{
    uint32_t left = 0, vertex = c->count++;
    vec3_t normal = c->normals[corners[0] / 3];
    c->source[vertex] = give(c, corners[0], vertex);
    for (uint32_t i = 1; i < count; ++i)
        if (are_close(c, normal, c->normals[corners[i] / 3]))
            give(c, corners[i], vertex);
        else
            corners[left++] = corners[i];
    return left;
}

/* Parts a vertex, of which those are all corners. */
static void part_vertex(crease_t *c, uint32_t *corners, uint32_t count)
{
    enum { MOST_GROUPS = 64 };
    for (int group = 0; count > 0 && group < MOST_GROUPS; ++group) count = take_group(c, corners, count);
    for (uint32_t i = 0; i < count; ++i) take_group(c, &corners[i], 1);
}

static void part_vertices(crease_t *c)
{
    const mesh_t *mesh = c->mesh;
    uint32_t corners = 3 * mesh->triangle_count;
    uint32_t *ends = mem_zalloc((size_t)mesh->vertex_count + 1, sizeof *ends);
    uint32_t *sorted = mem_alloc(corners * sizeof *sorted); /* the corners, by their vertices */
    for (uint32_t i = 0; i < corners; ++i) ++ends[mesh->triangles[i / 3].v[i % 3] + 1];
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) ends[i + 1] += ends[i];
    for (uint32_t i = 0; i < corners; ++i) sorted[ends[mesh->triangles[i / 3].v[i % 3]]++] = i;
    uint32_t first = 0; /* ends[i] is now the end of vertex i */
    for (uint32_t i = 0; i < mesh->vertex_count; first = ends[i++])
        part_vertex(c, &sorted[first], ends[i] - first);
    free(ends);
    free(sorted);
}

/* ---- the mesh ------------------------------------------------------------------------------------------ */

static vec3_t *triangle_normals(const mesh_t *mesh)
{
    vec3_t *normals = mem_alloc(mesh->triangle_count * sizeof *normals);
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        const uint32_t *v = mesh->triangles[i].v;
        vec3_t p = mesh->positions[v[0]];
        normals[i] = v_normalize(v_cross(v_sub(mesh->positions[v[1]], p), v_sub(mesh->positions[v[2]], p)));
    }
    return normals;
}

result_t mesh_crease(mesh_t *mesh, double angle, position_t at)
{
    TRY(mesh_smooth(mesh, at)); /* which looks at the indices */
    if (mesh->triangle_count > UINT32_MAX / 3) return error_at(at, "the mesh has too many triangles");
    mesh_join(mesh);
    crease_t c = {.mesh = mesh,
                  .normals = triangle_normals(mesh),
                  .source = mem_alloc(3 * (size_t)mesh->triangle_count * sizeof *c.source),
                  .cosine = (float)cos(angle * 3.14159265358979323846 / 180)};
    part_vertices(&c);
    collect_all(mesh, c.source, c.count);
    free(c.normals);
    free(c.source);
    return mesh_smooth(mesh, at);
}
