/* polygon: see polygon.h. */
#include "client/import/files/polygon.h"

#include <math.h>
#include <stdlib.h>

#include "common/base.h"

static const uint32_t none = UINT32_MAX;

/* Twice the area of the triangle, positive where it winds as the polygon does, whose normal is n. */
static float turn(vec3_t a, vec3_t b, vec3_t c, vec3_t n)
{
    return v_dot(v_cross(v_sub(b, a), v_sub(c, a)), n);
}

/* The polygon's normal, of the length of twice its area (Newell's method). */
static vec3_t normal_of(const vec3_t *p, size_t count)
{
    vec3_t sum = {0, 0, 0};
    for (size_t i = 1; i + 1 < count; ++i)
        sum = v_add(sum, v_cross(v_sub(p[i], p[0]), v_sub(p[i + 1], p[0])));
    return sum;
}

/* A corner that is there twice hides a turn. */
static bool is_convex(const vec3_t *p, size_t count, vec3_t n)
{
    for (size_t i = 0; i < count; ++i) {
        vec3_t a = p[i], b = p[(i + 1) % count], c = p[(i + 2) % count];
        if (turn(a, b, c, n) < 0 || v_is_zero(v_sub(b, a))) return false;
    }
    return true;
}

/* A corner in the plane, on a ring of those that are left. Those that are hollow (of 180 degrees and more)
 * are on a list besides: where a corner is in the way of an ear, a hollow one is. None becomes hollow later.
 */
typedef struct {
    double x, y;
    uint32_t before, after;
    uint32_t next_hollow;
    bool hollow;
} corner_t;

typedef struct {
    corner_t *corners;
    uint32_t first_hollow;
    size_t count;       /* that are left */
    uint64_t *patience; /* how many corners may still be looked at */
} polygon_t;

/* Twice the area, positive where a, b and c run counter-clockwise. */
static double area(const corner_t *a, const corner_t *b, const corner_t *c)
{
    return (b->x - a->x) * (c->y - a->y) - (b->y - a->y) * (c->x - a->x);
}

static double area_at(const polygon_t *p, uint32_t i)
{
    const corner_t *at = &p->corners[i];
    return area(&p->corners[at->before], at, &p->corners[at->after]);
}

static bool same_place(const corner_t *a, const corner_t *b)
{
    return a->x == b->x && a->y == b->y;
}

/* Whether q lies in the triangle or on its border, but not at a corner: one may be there twice, as where a
 * bridge leads to a hole. */
static bool holds(const corner_t *a, const corner_t *b, const corner_t *c, const corner_t *q)
{
    if (!(area(a, b, q) >= 0 && area(b, c, q) >= 0 && area(c, a, q) >= 0)) return false;
    return !same_place(a, q) && !same_place(b, q) && !same_place(c, q);
}

/* Whether the triangle of corner i and its neighbours lies inside and holds none of the others. Corners that
 * are hollow no more leave the list here. */
static bool is_ear(polygon_t *p, uint32_t i)
{
    corner_t *all = p->corners;
    const corner_t *a = &all[all[i].before], *b = &all[i], *c = &all[all[i].after];
    if (!(area(a, b, c) > 0)) return false;
    for (uint32_t *link = &p->first_hollow; *link != none && *p->patience > 0; --*p->patience) {
        corner_t *q = &all[*link];
        if (!q->hollow)
            *link = q->next_hollow;
        else if (holds(a, b, c, q))
            return false;
        else
            link = &q->next_hollow;
    }
    return *p->patience > 0;
}

static void cut(polygon_t *p, uint32_t i, uint32_t *triangle)
{
    corner_t *all = p->corners;
    uint32_t ends[2] = {all[i].before, all[i].after};
    triangle[0] = ends[0], triangle[1] = i, triangle[2] = ends[1];
    all[ends[0]].after = ends[1];
    all[ends[1]].before = ends[0];
    for (int k = 0; k < 2; ++k)
        if (area_at(p, ends[k]) > 0) all[ends[k]].hollow = false;
    --p->count;
}

/* Cuts off ears until three corners are left, a whole round has none, or there is no patience left. The next
 * ear is looked for where the last one was, since cutting that one often makes one of its neighbours an ear.
 * Returns one of the corners that are left. */
static uint32_t cut_ears(polygon_t *p, uint32_t **triangles)
{
    uint32_t at = 0;
    size_t misses = 0;
    while (p->count > 3 && misses < p->count && *p->patience != 0) {
        --*p->patience;
        if (is_ear(p, at)) {
            cut(p, at, *triangles);
            *triangles += 3;
            misses = 0;
            at = p->corners[at].before;
        } else {
            ++misses;
            at = p->corners[at].after;
        }
    }
    return at;
}

/* What is left becomes a fan. Returns twice the area of those of its triangles that wind the wrong way: of a
 * fan that is right there are none. */
static double cut_rest(const polygon_t *p, uint32_t first, uint32_t *triangles)
{
    const corner_t *all = p->corners;
    double wrong = 0;
    for (uint32_t i = all[first].after; all[i].after != first; i = all[i].after, triangles += 3) {
        triangles[0] = first, triangles[1] = i, triangles[2] = all[i].after;
        wrong += fmax(-area(&all[first], &all[i], &all[all[i].after]), 0);
    }
    return wrong;
}

/* Lays the polygon into the plane of two axes that it is seen most of. */
static void lay(const vec3_t *corners, size_t count, vec3_t n, polygon_t *p)
{
    int axis = v_longest(vec3(fabsf(n.x), fabsf(n.y), fabsf(n.z)));
    bool mirrored = v_at(n, axis) < 0;
    p->corners = mem_alloc(count * sizeof *p->corners);
    p->count = count;
    for (uint32_t i = 0; i < count; ++i) {
        double u = (double)v_at(corners[i], (axis + 1) % 3), v = (double)v_at(corners[i], (axis + 2) % 3);
        p->corners[i] = (corner_t){.x = mirrored ? v : u,
                                   .y = mirrored ? u : v,
                                   .before = i > 0 ? i - 1 : (uint32_t)count - 1,
                                   .after = i + 1 < count ? i + 1 : 0};
    }
    p->first_hollow = none;
    for (uint32_t i = (uint32_t)count; i-- > 0;) {
        if (area_at(p, i) > 0) continue;
        p->corners[i].hollow = true;
        p->corners[i].next_hollow = p->first_hollow;
        p->first_hollow = i;
    }
}

bool polygon_cut(const vec3_t *corners, size_t count, uint32_t *triangles, uint64_t *patience)
{
    vec3_t n = normal_of(corners, count);
    if (is_convex(corners, count, n)) {
        for (uint32_t i = 1; i + 1 < count; ++i, triangles += 3)
            triangles[0] = 0, triangles[1] = i, triangles[2] = i + 1;
        return true;
    }
    polygon_t p = {.patience = patience};
    lay(corners, count, n, &p);
    double whole = 0;
    for (size_t i = 1; i + 1 < count; ++i) whole += area(&p.corners[0], &p.corners[i], &p.corners[i + 1]);
    uint32_t rest = cut_ears(&p, &triangles);
    double wrong = cut_rest(&p, rest, triangles);
    free(p.corners);
    return wrong <= 1e-6 * whole;
}
