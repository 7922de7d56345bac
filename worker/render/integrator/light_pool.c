/* light_pool: see light_pool.h.
 *
 * DESIGN. Every eye vertex looks at every light vertex of its block, some two hundred. So what it looks at is
 * kept apart from the vertices themselves, in lanes of LANES, which the compiler makes vector instructions
 * of.
 *
 * The estimate takes both surfaces for Lambertian ones: throughput x albedo x geometry, times the weight that
 * this gives (subpath.h). Where they are, and nothing is in the way, it is exact but for colours. Others are
 * helped by a FLOOR below which no chance falls, as a part of the mean chance.
 */
#include "worker/render/integrator/light_pool.h"

#include <stdlib.h>
#include <string.h>

enum { LANES = 8 };
static const float FLOOR = 0.05f;

/* What an eye vertex looks at, of LANES light vertices. */
typedef struct {
    float p[3][LANES];
    float n[3][LANES];    /* shading normal, on the side that light comes from */
    float through[LANES]; /* 1: scatters to both sides; else 0 */
    float level[LANES];   /* throughput x albedo; 0 in lanes without a vertex */
    float share[LANES];   /* of the light side, over the squared geometry */
    float depth[LANES];
    float chance[LANES];   /* of being chosen, for the eye vertex at hand, without the floor; of any scale */
    float possible[LANES]; /* 1: can contribute; else 0 */
} group_t;

struct light_pool {
    int pixels;
    int path_count, count, group_capacity;
    light_path_t paths[BLOCK_PIXELS];
    group_t *groups;      /* [group_capacity] */
    uint8_t *path_of;     /* [group_capacity * LANES] */
    size_t *start_of;     /* of each vertex in `bytes`; [group_capacity * LANES] */
    unsigned char *bytes; /* vertices, one behind the other, each without the lobes that it does not have */
    size_t used, capacity;
};

light_pool_t *light_pool_new(void)
{
    return mem_zalloc(1, sizeof(light_pool_t));
}

void light_pool_destroy(light_pool_t **pool)
{
    if (*pool == NULL) return;
    free((*pool)->groups);
    free((*pool)->path_of);
    free((*pool)->start_of);
    free((*pool)->bytes);
    free(*pool);
    *pool = NULL;
}

void light_pool_reset(light_pool_t *pool, int pixels)
{
    pool->pixels = pixels;
    pool->path_count = pool->count = 0;
    pool->used = 0;
}

int light_pool_pixels(const light_pool_t *pool)
{
    return pool->pixels;
}

light_path_t *light_pool_add_path(light_pool_t *pool, const light_path_t *path)
{
    assert(pool->path_count < pool->pixels);
    pool->paths[pool->path_count] = *path;
    return &pool->paths[pool->path_count++];
}

light_path_t *light_pool_paths(light_pool_t *pool, int *count)
{
    *count = pool->path_count;
    return pool->paths;
}

/* ---- what an eye vertex looks at ----------------------------------------------------------------------- */

/* The shading normal on the side that the subpath comes from. */
static vec3_t facing_normal(const vertex_t *vertex)
{
    const bsdf_t *bsdf = &vertex->bsdf;
    return v_dot(vertex->wo, bsdf->ng) < 0 ? v_neg(bsdf->ns) : bsdf->ns;
}

/* 1 when light may go through, else 0. */
static float passes(const vertex_t *vertex)
{
    const bsdf_t *bsdf = &vertex->bsdf;
    for (int i = 0; i < bsdf->count; i++)
        if ((bsdf->lobes[i].kind->flags & (LOBE_TRANSMITS | LOBE_SPECULAR)) == LOBE_TRANSMITS) return 1;
    return 0;
}

/* The share of the vertex's side in weights over the squared geometry, were both surfaces Lambertian. */
static float estimated_share(const vertex_t *vertex, float count)
{
    float back = vertex_cosine(vertex, vertex->wo) * INV_PI_F;
    return (square(count) * vertex->direct + square(back) * vertex->inner) * square(INV_PI_F / inner_worth);
}

static void grow_groups(light_pool_t *pool)
{
    pool->group_capacity = 2 * pool->group_capacity + 16;
    size_t vertices = (size_t)pool->group_capacity * LANES;
    pool->groups = mem_realloc(pool->groups, (size_t)pool->group_capacity * sizeof *pool->groups);
    pool->path_of = mem_realloc(pool->path_of, vertices * sizeof *pool->path_of);
    pool->start_of = mem_realloc(pool->start_of, vertices * sizeof *pool->start_of);
}

static void keep_vertex(light_pool_t *pool, const vertex_t *vertex)
{
    size_t size = offsetof(vertex_t, bsdf.lobes) + (size_t)vertex->bsdf.count * sizeof *vertex->bsdf.lobes;
    size = (size + _Alignof(vertex_t) - 1) / _Alignof(vertex_t) * _Alignof(vertex_t);
    if (pool->used + sizeof *vertex > pool->capacity) {
        pool->capacity = 2 * pool->capacity + 64 * sizeof *vertex;
        pool->bytes = mem_realloc(pool->bytes, pool->capacity);
    }
    memcpy(pool->bytes + pool->used, vertex, size);
    pool->start_of[pool->count] = pool->used;
    pool->used += size;
}

void light_pool_add(light_pool_t *pool, const vertex_t *vertex)
{
    const light_path_t *path = &pool->paths[pool->path_count - 1];
    float level = v_max(v_mul(vertex->throughput, bsdf_albedo(&vertex->bsdf)));
    if (!(level > 0)) return;
    int lane = pool->count % LANES;
    if (pool->count == pool->group_capacity * LANES) grow_groups(pool);
    group_t *group = &pool->groups[pool->count / LANES];
    if (lane == 0) *group = (group_t){0};
    vec3_t p = vertex_point(vertex), n = facing_normal(vertex);
    group->p[0][lane] = p.x, group->p[1][lane] = p.y, group->p[2][lane] = p.z;
    group->n[0][lane] = n.x, group->n[1][lane] = n.y, group->n[2][lane] = n.z;
    group->through[lane] = passes(vertex);
    group->level[lane] = level;
    group->share[lane] = estimated_share(vertex, vertex->depth == 1 ? path->view_ratio : inner_worth);
    group->depth[lane] = (float)vertex->depth;
    keep_vertex(pool, vertex);
    pool->path_of[pool->count++] = (uint8_t)(pool->path_count - 1);
}

/* ---- choosing ------------------------------------------------------------------------------------------ */

/* Estimates what the vertices of a group bring to z, and adds up by lanes. */
static void estimate(group_t *restrict group, vec3_t p, vec3_t n, float through, float share, float least,
                     float most, float *restrict sums, float *restrict counts)
{
    for (int i = 0; i < LANES; i++) {
        float dx = group->p[0][i] - p.x, dy = group->p[1][i] - p.y, dz = group->p[2][i] - p.z;
        float distance2 = dx * dx + dy * dy + dz * dz;
        float at_z = dx * n.x + dy * n.y + dz * n.z;
        float at_y = -(dx * group->n[0][i] + dy * group->n[1][i] + dz * group->n[2][i]);
        at_z = at_z > 0 ? at_z : -at_z * through;
        at_y = at_y > 0 ? at_y : -at_y * group->through[i];
        float g = at_z * at_y / (distance2 * distance2);
        float chance = group->level[i] * g / (1 + g * g * (share + group->share[i]));
        float possible = g > 0 ? 1.0f : 0.0f;
        possible = group->level[i] > 0 ? possible : 0.0f;
        possible = group->depth[i] >= least ? possible : 0.0f;
        possible = group->depth[i] <= most ? possible : 0.0f;
        chance = chance > 0 ? chance : 0.0f; /* not a NaN either */
        chance = chance < 0x1p80f ? chance : 0x1p80f;
        group->chance[i] = chance * possible;
        group->possible[i] = possible;
        sums[i] += group->chance[i];
        counts[i] += possible;
    }
}

/* Where a number between 0 and the sum of all chances falls: the lanes one after the other, each through all
 * groups. */
static int find(const light_pool_t *pool, const float *lanes, float floor, float at)
{
    int groups = (pool->count + LANES - 1) / LANES, lane = 0, last = -1;
    for (; lane < LANES - 1 && at >= lanes[lane]; lane++) at -= lanes[lane];
    for (; lane >= 0; lane--) { /* back only if roundings have led behind the last one */
        for (int i = 0; i < groups; i++) {
            const group_t *group = &pool->groups[i];
            if (!(group->possible[lane] > 0)) continue;
            last = i * LANES + lane;
            at -= group->chance[lane] + floor;
            if (at < 0) return last;
        }
        if (last >= 0) return last;
    }
    return last;
}

int light_pool_choose(light_pool_t *pool, const vertex_t *z, int least, int most, bool weighted, int count,
                      float u, light_choice_t choices[])
{
    float sums[LANES] = {0}, counts[LANES] = {0}, sum = 0, possible = 0;
    float share = weighted ? estimated_share(z, z->depth == 1 ? 1 : inner_worth) : 0;
    vec3_t p = vertex_point(z), n = facing_normal(z);
    float through = passes(z);
    for (int i = 0; i < (pool->count + LANES - 1) / LANES; i++)
        estimate(&pool->groups[i], p, n, through, share, (float)least, (float)most, sums, counts);
    for (int i = 0; i < LANES; i++) {
        sum += sums[i];
        possible += counts[i];
    }
    if (!(possible > 0)) return 0;
    float floor = sum > 0 ? FLOOR * sum / possible : 1;
    for (int i = 0; i < LANES; i++) sums[i] += floor * counts[i];
    float total = sum + floor * possible;
    int chosen = 0;
    for (int k = 0; k < count; k++) {
        int i = find(pool, sums, floor, total * ((float)k + u) / (float)count);
        const group_t *group = &pool->groups[i / LANES];
        float factor = total / ((group->chance[i % LANES] + floor) * (float)(count * pool->pixels));
        const vertex_t *vertex = (const vertex_t *)(pool->bytes + pool->start_of[i]);
        if (chosen > 0 && choices[chosen - 1].vertex == vertex)
            choices[chosen - 1].factor += factor;
        else
            choices[chosen++] = (light_choice_t){vertex, &pool->paths[pool->path_of[i]], factor};
    }
    return chosen;
}
