/* light_pool: see light_pool.h.
 *
 * DESIGN. An eye vertex looks at the light vertices of its block, some two hundred, before it chooses. So
 * what it looks at is kept apart from the vertices themselves, in groups of LANES, which the compiler makes
 * vector instructions of. Deeper eye vertices, which matter less, look at a part of the groups only, evenly
 * spread; where there are many so does the first.
 *
 * The estimate takes both surfaces for Lambertian ones: throughput x albedo x geometry, times the weight that
 * this gives (subpath.h). Where they are, and nothing is in the way, it is exact but for colours. For
 * others there is a FLOOR below which no chance falls, a part of the mean chance.
 */
#include "worker/render/integrator/light_pool.h"

#include <stdlib.h>
#include <string.h>

enum {
    LANES = 8,
    GROUPS_FIRST = 32, /* that the first eye vertex looks at, at most */
    GROUPS_DEEPER = 8
};
static const float FLOOR = 0.05f;
/* One choice for so much light that is expected, in terms of a sample's noise; where that is not known: */
static const float LIGHT_OF_CHOICE = 0.6f;
enum { CHOICES_UNKNOWN = 2 };

/* What an eye vertex looks at, of LANES light vertices. */
typedef struct {
    float p[3][LANES];
    float n[3][LANES];       /* shading normal, on the side that light comes from */
    float through[LANES];    /* 1: scatters to both sides; else 0 */
    float everywhere[LANES]; /* what stands for a cosine, in a medium; else 0 */
    float level[LANES];      /* throughput x albedo; 0 in lanes without a vertex */
    float share[LANES];      /* of the light side, over the squared geometry */
    float length[LANES];
    float chance[LANES];   /* of being chosen, for the eye vertex at hand, without the floor; of any scale */
    float possible[LANES]; /* 1: can contribute; else 0 */
} group_t;

struct light_pool {
    int pixels;
    int path_count, count, group_capacity;
    bool in_media; /* some of the vertices are */
    light_path_t paths[POOL_PIXELS];
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
    pool->in_media = false;
    pool->used = 0;
}

int light_pool_pixels(const light_pool_t *pool)
{
    return pool->pixels;
}

void light_pool_add_path(light_pool_t *pool, const light_path_t *path)
{
    assert(pool->path_count < pool->pixels);
    pool->paths[pool->path_count++] = *path;
}

/* ---- what an eye vertex looks at ----------------------------------------------------------------------- */

/* The shading normal on the side that the subpath comes from. What is reflected leaves on this side, since
 * directions about whose sides the two normals disagree are black (bsdf_eval). */
static vec3_t facing_normal(const vertex_t *vertex)
{
    vec3_t ns = vertex->bsdf.ns;
    if (vertex->kind == VERTEX_MEDIUM) return vec3(0, 0, 0);
    return v_dot(vertex->wo, ns) < 0 ? v_neg(ns) : ns;
}

/* 1 when light may go through, else 0. */
static float passes(const vertex_t *vertex)
{
    const bsdf_t *bsdf = &vertex->bsdf;
    for (int i = 0; i < bsdf->count; i++)
        if ((bsdf->lobes[i].kind->flags & (LOBE_TRANSMITS | LOBE_SPECULAR)) == LOBE_TRANSMITS) return 1;
    return 0;
}

/* What stands for the cosine to a surface, so that over pi it is the mean over all directions. */
static float everywhere(const vertex_t *vertex)
{
    return vertex->kind == VERTEX_MEDIUM ? 0.25f : 0;
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
    group->everywhere[lane] = everywhere(vertex);
    pool->in_media = pool->in_media || vertex->kind == VERTEX_MEDIUM;
    group->level[lane] = level;
    group->share[lane] = estimated_share(vertex, strategy_count(vertex, path->last));
    group->length[lane] = (float)vertex->length;
    keep_vertex(pool, vertex);
    pool->path_of[pool->count++] = (uint8_t)(pool->path_count - 1);
}

/* ---- choosing ------------------------------------------------------------------------------------------ */

/* The groups that an eye vertex looks at, and what it finds. */
typedef struct {
    int start, stride, end;
    float lanes[LANES]; /* sums of chances, floor included */
    float floor, total;
} look_t;

/* Estimates what the vertices of a group bring, and adds up by lanes. `media`: some vertex lies in one. */
static inline void estimate(group_t *restrict group, bool media, vec3_t p, vec3_t n, float through,
                            float around, float share, float least, float most, float *restrict sums,
                            float *restrict counts)
{
    for (int i = 0; i < LANES; i++) {
        float dx = group->p[0][i] - p.x, dy = group->p[1][i] - p.y, dz = group->p[2][i] - p.z;
        float distance2 = dx * dx + dy * dy + dz * dz;
        float at_z = dx * n.x + dy * n.y + dz * n.z;
        float at_y = -(dx * group->n[0][i] + dy * group->n[1][i] + dz * group->n[2][i]);
        at_z = at_z > 0 ? at_z : -at_z * through;
        at_y = at_y > 0 ? at_y : -at_y * group->through[i];
        if (media) {
            float distance = sqrtf(distance2);
            at_z += around * distance;
            at_y += group->everywhere[i] * distance;
        }
        float g = at_z * at_y / (distance2 * distance2);
        float chance = group->level[i] * g / (1 + g * g * (share + group->share[i]));
        float possible = g > 0 ? 1.0f : 0.0f;
        possible = group->level[i] > 0 ? possible : 0.0f;
        possible = group->length[i] >= least ? possible : 0.0f;
        possible = group->length[i] <= most ? possible : 0.0f;
        chance = chance > 0 ? chance : 0.0f; /* not a NaN either */
        chance = chance < 0x1p80f ? chance : 0x1p80f;
        group->chance[i] = chance * possible;
        group->possible[i] = possible;
        sums[i] += group->chance[i];
        counts[i] += possible;
    }
}

/* Looks at the groups; false when no vertex can contribute. Uses up a part of *u. */
static bool look(light_pool_t *pool, const vertex_t *z, const light_wish_t *wish, float *u, look_t *l)
{
    int groups = (pool->count + LANES - 1) / LANES, enough = z->depth == 1 ? GROUPS_FIRST : GROUPS_DEEPER;
    int stride = int_max((groups + enough - 1) / enough, 1);
    float place = *u * (float)stride;
    int start = int_min((int)place, stride - 1);
    *u = place - (float)start;
    *l = (look_t){.start = start, .stride = stride, .end = groups};
    float share = wish->weighted ? estimated_share(z, strategy_count(z, splat_worth)) : 0;
    float through = passes(z), counts[LANES] = {0}, possible = 0;
    vec3_t p = vertex_point(z), n = facing_normal(z);
    float around = everywhere(z), least = (float)wish->least, most = (float)wish->most;
    if (pool->in_media || around > 0)
        for (int i = start; i < groups; i += stride)
            estimate(&pool->groups[i], true, p, n, through, around, share, least, most, l->lanes, counts);
    else
        for (int i = start; i < groups; i += stride)
            estimate(&pool->groups[i], false, p, n, through, 0, share, least, most, l->lanes, counts);
    for (int i = 0; i < LANES; i++) {
        l->total += l->lanes[i];
        possible += counts[i];
    }
    if (!(possible > 0)) return false;
    l->floor = l->total > 0 ? FLOOR * l->total / possible : 1;
    for (int i = 0; i < LANES; i++) l->lanes[i] += l->floor * counts[i];
    l->total += l->floor * possible;
    return true;
}

/* The vertex where a number between 0 and the total falls, with the lanes one after the other. */
static int find(const light_pool_t *pool, const look_t *l, float at)
{
    int lane = 0, last = -1;
    for (; lane < LANES - 1 && at >= l->lanes[lane]; lane++) at -= l->lanes[lane];
    for (; last < 0; lane--) { /* back only where rounding has led behind the last one */
        assert(lane >= 0);
        for (int i = l->start; i < l->end; i += l->stride) {
            const group_t *group = &pool->groups[i];
            if (group->possible[lane] > 0) last = i * LANES + lane;
            at -= group->chance[lane] + l->floor * group->possible[lane];
            if (at < 0 && last >= 0) return last;
        }
    }
    return last;
}

/* How many vertices are to be chosen. The value of a connection is about what was estimated, over pi for each
 * of two Lambertian surfaces. */
static int count_choices(const light_pool_t *pool, const look_t *l, float worth)
{
    if (!(worth > 0)) return CHOICES_UNKNOWN;
    float light = worth * l->total * (float)l->stride * square(INV_PI_F) / (float)pool->pixels;
    float count = 1 + light / LIGHT_OF_CHOICE;
    return count < LIGHT_CHOICES_MOST ? (int)count : LIGHT_CHOICES_MOST;
}

int light_pool_choose(light_pool_t *pool, const vertex_t *z, const light_wish_t *wish,
                      light_choice_t choices[LIGHT_CHOICES_MOST])
{
    look_t l;
    float u = wish->u / wish->often;
    if (!(u < 1) || !look(pool, z, wish, &u, &l)) return 0;
    int count = count_choices(pool, &l, wish->worth), chosen = 0;
    for (int k = 0; k < count; k++) {
        int i = find(pool, &l, l.total * ((float)k + u) / (float)count);
        const group_t *group = &pool->groups[i / LANES];
        float chance = (group->chance[i % LANES] + l.floor) / (l.total * (float)l.stride);
        float factor = 1 / (chance * wish->often * (float)(count * pool->pixels));
        const vertex_t *vertex = (const vertex_t *)(pool->bytes + pool->start_of[i]);
        if (chosen > 0 && choices[chosen - 1].vertex == vertex)
            choices[chosen - 1].factor += factor;
        else
            choices[chosen++] = (light_choice_t){vertex, &pool->paths[pool->path_of[i]], factor};
    }
    return chosen;
}
