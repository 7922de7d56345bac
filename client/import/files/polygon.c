/* polygon: see polygon.h. */
#include "client/import/files/polygon.h"

#include <stdbool.h>

enum { MOST_EARS = 1024 };

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

static bool is_convex(const vec3_t *p, size_t count, vec3_t n)
{
    for (size_t i = 0; i < count; ++i)
        if (turn(p[i], p[(i + 1) % count], p[(i + 2) % count], n) < 0) return false;
    return true;
}

/* The corners that are left of a polygon, and how many of them may still be looked at. */
typedef struct {
    const vec3_t *corners;
    vec3_t normal;
    uint32_t left[MOST_EARS];
    size_t count, patience;
} polygon_t;

/* Whether the triangle of corner i and its neighbours lies inside and holds none of the others. */
static bool is_ear(polygon_t *p, size_t i)
{
    size_t before = (i + p->count - 1) % p->count, after = (i + 1) % p->count;
    vec3_t a = p->corners[p->left[before]], b = p->corners[p->left[i]], c = p->corners[p->left[after]];
    if (!(turn(a, b, c, p->normal) > 0)) return false;
    for (size_t k = 0; k < p->count && p->patience > 0; ++k, --p->patience) {
        if (k == before || k == i || k == after) continue;
        vec3_t q = p->corners[p->left[k]];
        if (turn(a, b, q, p->normal) >= 0 && turn(b, c, q, p->normal) >= 0 && turn(c, a, q, p->normal) >= 0)
            return false;
    }
    return true;
}

/* Cuts off the first ear; false when none is found. */
static bool cut_ear(polygon_t *p, uint32_t *triangle)
{
    size_t ear = 0;
    while (ear < p->count && !is_ear(p, ear)) ++ear;
    if (ear >= p->count || p->patience == 0) return false;
    triangle[0] = p->left[(ear + p->count - 1) % p->count];
    triangle[1] = p->left[ear];
    triangle[2] = p->left[(ear + 1) % p->count];
    for (size_t k = ear; k + 1 < p->count; ++k) p->left[k] = p->left[k + 1];
    --p->count;
    return true;
}

void polygon_cut(const vec3_t *corners, size_t count, uint32_t *triangles)
{
    polygon_t p = {.corners = corners, .normal = normal_of(corners, count), .patience = 512 * count};
    if (count > MOST_EARS || is_convex(corners, count, p.normal)) {
        for (uint32_t i = 1; i + 1 < count; ++i, triangles += 3)
            triangles[0] = 0, triangles[1] = i, triangles[2] = i + 1;
        return;
    }
    for (p.count = 0; p.count < count; ++p.count) p.left[p.count] = (uint32_t)p.count;
    for (; p.count > 3 && cut_ear(&p, triangles); triangles += 3) continue;
    for (size_t i = 1; i + 1 < p.count; ++i, triangles += 3)
        triangles[0] = p.left[0], triangles[1] = p.left[i], triangles[2] = p.left[i + 1];
}
