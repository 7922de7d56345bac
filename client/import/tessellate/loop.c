/* loop: Loop subdivision surfaces (Loop 1987, "Smooth Subdivision Surfaces Based on Triangles"; masks of the
 * boundary, the limit and the tangents after Hoppe et al. 1994, "Piecewise Smooth Surface Reconstruction",
 * with the weights that pbrt uses).
 *
 * A level is an indexed mesh with neighbours: face f has across its edge k, from v[k] to v[k + 1], the face
 * next[k]. Refinement keeps the old vertices' numbers and appends one vertex for each edge; face f becomes
 * the faces 4 f + 0, 1, 2 at its corners, which keep the corner's place, and 4 f + 3 in the middle. All
 * orders are those of the file, so that the same file gives the same bits.
 */
#include "client/import/tessellate/grid.h"
#include "client/import/tessellate/tessellate.h"

#include <inttypes.h>
#include <stdlib.h>

enum { EVEN_BOUNDARY = 8, LIMIT_BOUNDARY = 5 }; /* one over the weight of each neighbour on the boundary */
#define NO_FACE BLOB_NONE

typedef struct {
    uint32_t v[3], next[3];
} face_t;

typedef struct {
    dvec3_t *positions;
    uint32_t *starts; /* a face at each vertex */
    bool *boundary;   /* of each vertex: its faces are a fan, not a ring */
    face_t *faces;
    uint32_t vertex_count, face_count;
} level_t;

static int after(int k)
{
    return (k + 1) % 3;
}

static int before(int k)
{
    return (k + 2) % 3;
}

static int corner_of(const face_t *face, uint32_t vertex)
{
    return face->v[0] == vertex ? 0 : face->v[1] == vertex ? 1 : 2;
}

static void level_free(level_t *level)
{
    free(level->positions);
    free(level->starts);
    free(level->boundary);
    free(level->faces);
    *level = (level_t){0};
}

static void level_alloc(level_t *level, uint32_t vertices, uint32_t faces)
{
    *level = (level_t){.vertex_count = vertices, .face_count = faces};
    level->positions = mem_alloc((size_t)vertices * sizeof *level->positions);
    level->starts = mem_alloc((size_t)vertices * sizeof *level->starts);
    level->boundary = mem_zalloc(vertices, sizeof *level->boundary);
    level->faces = mem_alloc((size_t)faces * sizeof *level->faces);
}

/* ---- the control mesh --------------------------------------------------------------------------------- */

static result_t read_face(const loop_t *in, uint32_t f, position_t at, level_t *level)
{
    uint32_t *v = level->faces[f].v;
    for (size_t k = 0; k < 3; ++k)
        TRY(take_index(in->indices[3 * (size_t)f + k], in->vertex_count, 3 * (size_t)f + k, at, &v[k]));
    for (int k = 0; k < 3; ++k)
        if (v[k] == v[after(k)])
            return error_at(at, "triangle %" PRIu32 " uses vertex %" PRIu32 " twice", f, v[k]);
    return result_ok();
}

/* Reads the vertices that the faces use, and renames them in the faces. */
static void read_positions(const loop_t *in, level_t *level)
{
    uint32_t *names = mem_zalloc(in->vertex_count, sizeof *names), used = 0;
    for (uint32_t f = 0; f < level->face_count; ++f)
        for (int k = 0; k < 3; ++k) names[level->faces[f].v[k]] = 1;
    for (size_t i = 0; i < in->vertex_count; ++i) {
        if (!names[i]) continue;
        level->positions[used] = d_vec3(in->positions + 3 * i);
        names[i] = used++;
    }
    for (uint32_t f = 0; f < level->face_count; ++f)
        for (int k = 0; k < 3; ++k) level->faces[f].v[k] = names[level->faces[f].v[k]];
    free(names);
    level->vertex_count = used;
}

/* One edge as one face has it. */
typedef struct {
    uint32_t low, high; /* its vertices */
    uint32_t face, k;
} half_edge_t;

static int compare_edges(const void *a, const void *b)
{
    const half_edge_t *p = a, *q = b;
    if (p->low != q->low) return p->low < q->low ? -1 : 1;
    if (p->high != q->high) return p->high < q->high ? -1 : 1;
    return p->face < q->face ? -1 : p->face > q->face;
}

static bool same_edge(const half_edge_t *p, const half_edge_t *q)
{
    return p->low == q->low && p->high == q->high;
}

/* Joins the faces on both sides of each edge of the sorted list. */
static result_t join_faces(const half_edge_t *edges, size_t count, position_t at, level_t *level)
{
    for (size_t i = 0; i < count; ++i) {
        const half_edge_t *p = &edges[i];
        level->faces[p->face].next[p->k] = NO_FACE;
        if (i + 1 == count || !same_edge(p, p + 1)) continue;
        const half_edge_t *q = &edges[++i];
        if (i + 1 < count && same_edge(q, q + 1))
            return error_at(at,
                            "triangles %" PRIu32 ", %" PRIu32 " and %" PRIu32 " share an edge: a subdivision "
                            "surface must be a manifold, with one or two triangles at an edge",
                            p->face, q->face, q[1].face);
        if (level->faces[p->face].v[p->k] == level->faces[q->face].v[q->k])
            return error_at(
                at, "triangles %" PRIu32 " and %" PRIu32 " turn opposite ways; reverse the vertices of one",
                p->face, q->face);
        level->faces[p->face].next[p->k] = q->face;
        level->faces[q->face].next[q->k] = p->face;
    }
    return result_ok();
}

static result_t find_neighbours(position_t at, level_t *level)
{
    size_t count = 3 * (size_t)level->face_count;
    half_edge_t *edges = mem_alloc(count * sizeof *edges);
    for (uint32_t f = 0; f < level->face_count; ++f) {
        for (int k = 0; k < 3; ++k) {
            uint32_t a = level->faces[f].v[k], b = level->faces[f].v[after(k)];
            edges[3 * (size_t)f + k] = (half_edge_t){a < b ? a : b, a < b ? b : a, f, (uint32_t)k};
        }
    }
    qsort(edges, count, sizeof *edges, compare_edges);
    result_t result = join_faces(edges, count, at, level);
    free(edges);
    return result;
}

/* The face about a vertex behind `face`, across the edge that leaves the vertex (clockwise where faces turn
 * counterclockwise) or the one that comes in. */
static uint32_t clockwise(const level_t *level, uint32_t face, uint32_t vertex)
{
    const face_t *f = &level->faces[face];
    return f->next[corner_of(f, vertex)];
}

static uint32_t counterclockwise(const level_t *level, uint32_t face, uint32_t vertex)
{
    const face_t *f = &level->faces[face];
    return f->next[before(corner_of(f, vertex))];
}

/* Finds which vertices are on the boundary; the faces at a vertex must be one ring or one fan. *largest is
 * the largest number of neighbours. */
static result_t find_boundary(position_t at, level_t *level, uint32_t *largest)
{
    uint32_t *uses = mem_zalloc(level->vertex_count, sizeof *uses);
    for (uint32_t f = 0; f < level->face_count; ++f)
        for (int k = 0; k < 3; ++k) {
            ++uses[level->faces[f].v[k]];
            level->starts[level->faces[f].v[k]] = f;
        }
    result_t result = result_ok();
    for (uint32_t v = 0; v < level->vertex_count && result.code == RESULT_OK; ++v) {
        uint32_t start = level->starts[v], seen = 1, f = clockwise(level, start, v);
        for (; f != NO_FACE && f != start; f = clockwise(level, f, v)) ++seen;
        level->boundary[v] = f == NO_FACE;
        if (f == NO_FACE)
            for (f = counterclockwise(level, start, v); f != NO_FACE; f = counterclockwise(level, f, v))
                ++seen;
        if (seen != uses[v])
            result = error_at(
                at,
                "only one vertex joins parts of the mesh at (%g %g %g), a corner of triangle %" PRIu32
                ": a subdivision surface must be a manifold",
                level->positions[v].x, level->positions[v].y, level->positions[v].z, start);
        if (seen + 1 > *largest) *largest = seen + 1;
    }
    free(uses);
    return result;
}

/* ---- masks -------------------------------------------------------------------------------------------- */

/* Writes the neighbours of a vertex and returns their number: all about it clockwise, or on the boundary from
 * one end of the fan to the other counterclockwise. */
static uint32_t one_ring(const level_t *level, uint32_t vertex, dvec3_t *ring)
{
    uint32_t count = 0, start = level->starts[vertex], f = start;
    if (!level->boundary[vertex]) {
        do {
            const face_t *face = &level->faces[f];
            ring[count++] = level->positions[face->v[after(corner_of(face, vertex))]];
            f = face->next[corner_of(face, vertex)];
        } while (f != start);
        return count;
    }
    for (uint32_t ahead = f; ahead != NO_FACE; ahead = clockwise(level, ahead, vertex)) f = ahead;
    ring[count++] = level->positions[level->faces[f].v[after(corner_of(&level->faces[f], vertex))]];
    for (; f != NO_FACE; f = counterclockwise(level, f, vertex))
        ring[count++] = level->positions[level->faces[f].v[before(corner_of(&level->faces[f], vertex))]];
    return count;
}

static dvec3_t weigh_ring(dvec3_t p, const dvec3_t *ring, uint32_t count, double weight)
{
    dvec3_t sum = d_scale(p, 1 - count * weight);
    for (uint32_t i = 0; i < count; ++i) sum = d_mad(sum, weight, ring[i]);
    return sum;
}

static dvec3_t weigh_ends(dvec3_t p, const dvec3_t *ring, uint32_t count, double weight)
{
    return d_mad(d_scale(p, 1 - 2 * weight), weight, d_add(ring[0], ring[count - 1]));
}

/* Of each neighbour in a refined interior vertex. Warren's weights; 1/16 at the regular valence 6. */
static double beta(uint32_t valence)
{
    return valence == 3 ? 3.0 / 16 : 3.0 / (8 * (double)valence);
}

static dvec3_t refined_position(const level_t *level, uint32_t vertex, dvec3_t *ring)
{
    uint32_t count = one_ring(level, vertex, ring);
    dvec3_t p = level->positions[vertex];
    if (level->boundary[vertex]) return weigh_ends(p, ring, count, 1.0 / EVEN_BOUNDARY);
    return weigh_ring(p, ring, count, beta(count));
}

static dvec3_t limit_position(const level_t *level, uint32_t vertex, dvec3_t *ring)
{
    uint32_t count = one_ring(level, vertex, ring);
    dvec3_t p = level->positions[vertex];
    if (level->boundary[vertex]) return weigh_ends(p, ring, count, 1.0 / LIMIT_BOUNDARY);
    return weigh_ring(p, ring, count, 1 / (count + 3 / (8 * beta(count))));
}

/* The tangent across the boundary, into the surface. */
static dvec3_t tangent_across(dvec3_t p, const dvec3_t *ring, uint32_t count)
{
    dvec3_t ends = d_add(ring[0], ring[count - 1]);
    if (count == 2) return d_mad(ends, -2, p);
    if (count == 3) return d_sub(ring[1], p);
    if (count == 4) return d_mad(d_sub(d_scale(d_add(ring[1], ring[2]), 2), ends), -2, p);
    double theta = 3.14159265358979323846 / (count - 1);
    dvec3_t sum = d_scale(ends, -sin(theta));
    for (uint32_t k = 1; k + 1 < count; ++k) sum = d_mad(sum, (2 - 2 * cos(theta)) * sin(k * theta), ring[k]);
    return sum;
}

/* The product of two tangents. Like pbrt it takes them from limit positions. */
static dvec3_t limit_normal(const level_t *level, uint32_t vertex, dvec3_t *ring)
{
    uint32_t count = one_ring(level, vertex, ring);
    if (level->boundary[vertex])
        return d_cross(d_sub(ring[count - 1], ring[0]),
                       tangent_across(level->positions[vertex], ring, count));
    dvec3_t s = {0}, t = {0};
    for (uint32_t i = 0; i < count; ++i) {
        double angle = 2 * 3.14159265358979323846 * i / count;
        s = d_mad(s, cos(angle), ring[i]);
        t = d_mad(t, sin(angle), ring[i]);
    }
    return d_cross(s, t);
}

/* ---- refinement --------------------------------------------------------------------------------------- */

/* Numbers the edges: edges[3 f + k] is edge k of face f. Returns how many there are. */
static uint32_t number_edges(const level_t *level, uint32_t *edges)
{
    uint32_t count = 0;
    for (uint32_t f = 0; f < level->face_count; ++f) {
        const face_t *face = &level->faces[f];
        for (int k = 0; k < 3; ++k) {
            const face_t *other = face->next[k] < f ? &level->faces[face->next[k]] : NULL;
            edges[3 * (size_t)f + k] =
                other ? edges[3 * (size_t)face->next[k] + corner_of(other, face->v[after(k)])] : count++;
        }
    }
    return count;
}

static dvec3_t edge_position(const level_t *level, const face_t *face, int k)
{
    dvec3_t ends = d_add(level->positions[face->v[k]], level->positions[face->v[after(k)]]);
    if (face->next[k] == NO_FACE) return d_scale(ends, 0.5);
    const face_t *other = &level->faces[face->next[k]];
    uint32_t opposite = other->v[before(corner_of(other, face->v[after(k)]))];
    dvec3_t wings = d_add(level->positions[face->v[before(k)]], level->positions[opposite]);
    return d_mad(d_scale(ends, 0.375), 0.125, wings);
}

/* The child of `face` at a vertex. */
static uint32_t child_at(const level_t *level, uint32_t face, uint32_t vertex)
{
    return face == NO_FACE ? NO_FACE : 4 * face + (uint32_t)corner_of(&level->faces[face], vertex);
}

static void split_face(const level_t *from, uint32_t f, const uint32_t *edges, level_t *to)
{
    const face_t *face = &from->faces[f];
    face_t *children = &to->faces[4 * (size_t)f];
    for (int k = 0; k < 3; ++k) {
        uint32_t odd = from->vertex_count + edges[3 * (size_t)f + k];
        children[k].v[k] = face->v[k];
        children[k].v[after(k)] = children[after(k)].v[k] = children[3].v[k] = odd;
        children[3].next[k] = 4 * f + (uint32_t)after(k);
        children[k].next[after(k)] = 4 * f + 3;
        children[k].next[k] = child_at(from, face->next[k], face->v[k]);
        children[k].next[before(k)] = child_at(from, face->next[before(k)], face->v[k]);
        to->starts[odd] = 4 * f + 3;
        to->boundary[odd] = face->next[k] == NO_FACE;
        to->positions[odd] = edge_position(from, face, k);
    }
}

static void refine(level_t *level, dvec3_t *ring)
{
    uint32_t *edges = mem_alloc(3 * (size_t)level->face_count * sizeof *edges);
    uint32_t edge_count = number_edges(level, edges);
    level_t finer;
    level_alloc(&finer, level->vertex_count + edge_count, 4 * level->face_count);
    for (uint32_t v = 0; v < level->vertex_count; ++v) {
        finer.positions[v] = refined_position(level, v, ring);
        finer.starts[v] = child_at(level, level->starts[v], v);
        finer.boundary[v] = level->boundary[v];
    }
    for (uint32_t f = 0; f < level->face_count; ++f) split_face(level, f, edges, &finer);
    free(edges);
    level_free(level);
    *level = finer;
}

/* ---- the whole ---------------------------------------------------------------------------------------- */

static void push_to_limit(level_t *level, dvec3_t *ring)
{
    dvec3_t *limits = mem_alloc((size_t)level->vertex_count * sizeof *limits);
    for (uint32_t v = 0; v < level->vertex_count; ++v) limits[v] = limit_position(level, v, ring);
    free(level->positions);
    level->positions = limits;
}

static void write_mesh(const level_t *level, dvec3_t *ring, mesh_t *mesh)
{
    mesh_reserve(mesh, level->vertex_count, level->face_count, true, false);
    mesh->vertex_count = level->vertex_count;
    for (uint32_t v = 0; v < level->vertex_count; ++v) {
        mesh->positions[v] = d_to_float(level->positions[v]);
        mesh->normals[v] = d_direction(limit_normal(level, v, ring));
    }
    for (uint32_t f = 0; f < level->face_count; ++f) {
        const uint32_t *v = level->faces[f].v;
        mesh->triangles[f] = (blob_triangle_t){{v[0], v[1], v[2]}};
    }
    mesh->triangle_count = level->face_count;
}

static result_t check_numbers(const loop_t *loop, position_t at)
{
    if (!(loop->levels >= 0 && loop->levels <= LOOP_MAX_LEVELS) || loop->levels != floor(loop->levels))
        return error_at(at, "%g levels of subdivision; they must be an integer from 0 to %d", loop->levels,
                        LOOP_MAX_LEVELS);
    if (loop->index_count == 0 || loop->index_count % 3 != 0)
        return error_at(at, "a subdivision surface needs \"indices\", three a triangle; there are %zu",
                        loop->index_count);
    if (loop->vertex_count == 0) return error_at(at, "a subdivision surface needs vertices \"P\"");
    double triangles = ldexp((double)(loop->index_count / 3), 2 * (int)loop->levels);
    uint32_t limit = loop->levels > LOOP_FREE_LEVELS ? LOOP_MAX_TRIANGLES : TESSELLATE_MAX_TRIANGLES;
    if (!(triangles < limit))
        return error_at(
            at, "%zu triangles at %g levels make %g triangles, over the limit of %u; take fewer levels",
            loop->index_count / 3, loop->levels, triangles, limit - 1);
    if (loop->vertex_count >= BLOB_NONE) return error_at(at, "too many vertices");
    return result_ok();
}

static result_t read_control_mesh(const loop_t *loop, position_t at, level_t *level, uint32_t *largest)
{
    for (uint32_t f = 0; f < level->face_count; ++f) TRY(read_face(loop, f, at, level));
    read_positions(loop, level);
    TRY(find_neighbours(at, level));
    return find_boundary(at, level, largest);
}

result_t tessellate_loop(const loop_t *loop, position_t at, mesh_t *mesh)
{
    TRY(check_numbers(loop, at));
    level_t level;
    level_alloc(&level, (uint32_t)loop->vertex_count, (uint32_t)(loop->index_count / 3));
    uint32_t largest = 6; /* what refinement adds has up to six neighbours */
    result_t result = read_control_mesh(loop, at, &level, &largest);
    if (result.code == RESULT_OK) {
        dvec3_t *ring = mem_alloc(largest * sizeof *ring);
        for (int i = 0; i < (int)loop->levels; ++i) refine(&level, ring);
        push_to_limit(&level, ring);
        write_mesh(&level, ring, mesh);
        free(ring);
    }
    level_free(&level);
    return result;
}
