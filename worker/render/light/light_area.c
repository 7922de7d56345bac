/* light_area: diffuse emission of a shape, on one side or both, the same everywhere or by a texture.
 *
 * Points of a mesh are drawn uniformly by area. The triangle is chosen by stretching one of the numbers that
 * then draw the point, so that places drawn by well stratified numbers are well stratified, too; among many
 * triangles too little of the number would be left, and they are chosen by a number of their own. Quadrics
 * are sampled uniformly in their own space. Where the shape lets rays through (alpha), as much of the
 * emission is missing. A light that is unseen lets all rays through, and has all of its emission: no subpath
 * runs into it, as into one without extent. A picture lights nothing: it has no power, so that it is never
 * chosen.
 *
 * What sampling needs of each triangle is kept in one place: it would else take four dependent look-ups in
 * the blob and a square root.
 */
#include "worker/render/light/light.h"

#include "worker/render/sampling/alias.h"
#include "worker/render/sampling/warp.h"

#include <stdlib.h>

typedef struct {
    vec3_t corner, e1, e2;
    vec3_t n; /* of unit length, along e1 x e2; where the shape is flipped, the other way */
} triangle_t;

/* Up to so many triangles are chosen by stretching. */
enum { STRETCHED_MOST = 64 };

typedef struct {
    const blob_shape_t *shape;
    const quadric_t *quadric; /* NULL: a mesh */
    double area;
    uint32_t count;              /* of triangles */
    float up_to[STRETCHED_MOST]; /* share of the area of triangles 0 ... i; where they are few */
    alias_t alias;               /* where they are many */
    bool plain;                  /* emits the same everywhere, and nothing shines through */
    bool curved;                 /* has vertex normals, which tell the side */
    triangle_t triangles[];
} area_state_t;

/* A point of the light. */
typedef struct {
    vec3_t p, n; /* n: on the emitting side */
    float pdf;   /* per area, the choice of the light included */
    uint32_t primitive;
    vec2_t place; /* on the triangle */
} spot_t;

static const area_state_t *state_of(const light_t *light)
{
    return light->state;
}

static bool is_two_sided(const light_t *light)
{
    return light->record->flags & LIGHT_TWO_SIDED;
}

static bool is_unseen(const light_t *light)
{
    return light->record->flags & LIGHT_UNSEEN;
}

static double triangle_area(const triangle_t *t)
{
    return 0.5 * (double)v_length(v_cross(t->e1, t->e2));
}

/* Shares out the area among the triangles, for their choice. */
static void share_out(area_state_t *state)
{
    double *areas = mem_alloc((state->count + 1) * sizeof *areas), sum = 0;
    for (uint32_t i = 0; i < state->count; i++) state->area += areas[i] = triangle_area(&state->triangles[i]);
    if (state->count > STRETCHED_MOST) alias_init(&state->alias, areas, state->count);
    for (uint32_t i = 0; i < state->count && state->count <= STRETCHED_MOST && state->area > 0; i++)
        state->up_to[i] = (float)((sum += areas[i]) / state->area);
    free(areas);
}

static void *prepare(const light_t *light)
{
    const scene_blob_t *blob = scene_blob(light->scene);
    const blob_shape_t *shape = &blob->shapes[light->record->shape];
    const blob_mesh_t *mesh = shape->kind == SHAPE_MESH ? &blob->meshes[shape->geometry] : NULL;
    uint32_t count = mesh != NULL ? mesh->triangle_count : 0;
    area_state_t *state = mem_zalloc(1, sizeof *state + count * sizeof *state->triangles);
    state->shape = shape;
    state->count = count;
    bool opaque = is_unseen(light) || (shape->alpha.texture == 0 && shape->alpha.factor.x >= 1);
    state->plain = light->record->radiance.texture == 0 && opaque;
    state->curved = mesh != NULL && mesh->first_normal != BLOB_NONE;
    if (shape->kind == SHAPE_QUADRIC) state->quadric = scene_quadric(light->scene, shape);
    for (uint32_t i = 0; i < count; i++) {
        const vec3_t *p = blob->positions + mesh->first_position;
        const uint32_t *v = blob->triangles[mesh->first_triangle + i].v;
        triangle_t *t = &state->triangles[i];
        *t = (triangle_t){.corner = p[v[0]], .e1 = v_sub(p[v[1]], p[v[0]]), .e2 = v_sub(p[v[2]], p[v[0]])};
        t->n = v_normalize(v_cross(t->e1, t->e2));
        if (!state->curved && shape->flags & SHAPE_FLIP) t->n = v_neg(t->n);
    }
    if (state->quadric != NULL)
        state->area = state->quadric->area;
    else
        share_out(state);
    return state;
}

static void release(void *state)
{
    alias_free(&((area_state_t *)state)->alias);
    free(state);
}

/* ---- power --------------------------------------------------------------------------------------------- */

/* Over the unit square of (u, v), which most light textures fill. */
static rgb_t mean_radiance(const light_t *light)
{
    enum { SIDE = 32 };
    const blob_value_t *value = &light->record->radiance;
    if (value->texture == 0) return value->factor;
    rgb_t sum = vec3(0, 0, 0);
    for (int i = 0; i < SIDE * SIDE; i++) {
        vec2_t uv = {((float)(i % SIDE) + 0.5f) / SIDE, ((float)(i / SIDE) + 0.5f) / SIDE};
        texture_point_t at = {.uv = uv, .uv2 = uv, .n = {0, 0, 1}, .colour = {1, 1, 1, 1}};
        sum = v_add(sum, textures_value(scene_textures(light->scene), value, &at));
    }
    /* A texture that is dark on the grid may still shine elsewhere. */
    return v_add(v_scale(sum, 1.0f / (SIDE * SIDE)), v_scale(value->factor, 1e-3f));
}

static double power(const light_t *light)
{
    if (light->record->flags & LIGHT_PICTURE) return 0;
    return state_of(light)->area * M_PI * (double)rgb_luminance(mean_radiance(light)) *
           (is_two_sided(light) ? 2 : 1);
}

static void box(const light_t *light, vec3_t *low, vec3_t *high)
{
    const area_state_t *state = state_of(light);
    if (state->quadric != NULL) {
        float from[3], to[3];
        quadric_bounds(state->quadric, from, to);
        *low = vec3(from[0], from[1], from[2]);
        *high = vec3(to[0], to[1], to[2]);
        return;
    }
    *low = *high = state->triangles[0].corner;
    for (uint32_t i = 0; i < state->count; i++) {
        const triangle_t *t = &state->triangles[i];
        const vec3_t corners[] = {t->corner, v_add(t->corner, t->e1), v_add(t->corner, t->e2)};
        for (int k = 0; k < 3; k++) {
            *low = v_low(*low, corners[k]);
            *high = v_high(*high, corners[k]);
        }
    }
}

/* ---- places -------------------------------------------------------------------------------------------- */

/* True when the vertex normals say that the light shines to the other side of e1 x e2. */
static bool is_turned(const light_t *light, uint32_t primitive, vec2_t b, vec3_t n)
{
    const scene_blob_t *blob = scene_blob(light->scene);
    const blob_mesh_t *mesh = &blob->meshes[state_of(light)->shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + primitive].v;
    const vec3_t *normals = blob->normals + mesh->first_normal;
    vec3_t ns = v_add(v_scale(normals[v[0]], 1 - b.x - b.y),
                      v_add(v_scale(normals[v[1]], b.x), v_scale(normals[v[2]], b.y)));
    return v_dot(ns, n) < 0;
}

/* Density of the places of a mesh, per area. */
static float mesh_density(const light_t *light)
{
    return light->chance * (float)(1 / state_of(light)->area);
}

/* A triangle in proportion to its area. Stretches the number that chose it to [0, 1) again. */
static uint32_t choose_triangle(const area_state_t *state, float choice, float *u)
{
    if (state->count > STRETCHED_MOST) return alias_sample(&state->alias, &choice);
    uint32_t i = 0;
    while (i + 1 < state->count && *u >= state->up_to[i]) i++;
    float low = i > 0 ? state->up_to[i - 1] : 0;
    *u = float_clamp((*u - low) / (state->up_to[i] - low), 0, 0x1.fffffep-1f);
    return i;
}

static void sample_triangle(const light_t *light, float choice, vec2_t u, spot_t *spot)
{
    const area_state_t *state = state_of(light);
    uint32_t primitive = choose_triangle(state, choice, &u.x);
    const triangle_t *t = &state->triangles[primitive];
    vec2_t b = warp_triangle(u);
    *spot = (spot_t){.p = v_add(t->corner, v_add(v_scale(t->e1, b.x), v_scale(t->e2, b.y))),
                     .n = t->n,
                     .pdf = mesh_density(light),
                     .primitive = primitive,
                     .place = b};
    if (state->curved && is_turned(light, primitive, b, t->n)) spot->n = v_neg(t->n);
}

/* The same at a point of a quadric. */
static float quadric_density(const light_t *light, const quadric_t *quadric, const quadric_point_t *point)
{
    return light->chance * quadric_pdf(quadric, point);
}

static void sample_spot(const light_t *light, float choice, vec2_t u, spot_t *spot)
{
    const area_state_t *state = state_of(light);
    if (state->quadric == NULL) {
        sample_triangle(light, choice, u, spot);
        return;
    }
    quadric_point_t point;
    quadric_sample(state->quadric, u, &point);
    *spot = (spot_t){.p = point.p,
                     .n = state->shape->flags & SHAPE_FLIP ? v_neg(point.n) : point.n,
                     .pdf = quadric_density(light, state->quadric, &point)};
}

/* What leaves a place, to either side on which it emits. `seen`: a ray has hit it, so alpha is done with. */
static rgb_t radiance_at(const light_t *light, const surface_t *surface, bool seen)
{
    const blob_value_t *value = &light->record->radiance;
    const blob_value_t *alpha = &surface->shape->alpha;
    bool opaque = seen || is_unseen(light) || (alpha->texture == 0 && alpha->factor.x >= 1);
    if (value->texture == 0 && opaque) return value->factor;
    surface_details_t details;
    scene_details(light->scene, surface, &details);
    const textures_t *textures = scene_textures(light->scene);
    texture_point_t at = {details.uv, details.uv2, surface->p, surface->ns, details.colour};
    rgb_t radiance = textures_value(textures, value, &at);
    radiance = vec3(float_max(radiance.x, 0), float_max(radiance.y, 0), float_max(radiance.z, 0));
    if (opaque) return radiance;
    float there = float_clamp(textures_value(textures, alpha, &at).x, 0, 1);
    if (surface->shape->flags & SHAPE_CUTOUT && there > 0) there = 1;
    return v_scale(radiance, there);
}

static rgb_t radiance_of_spot(const light_t *light, const spot_t *spot)
{
    if (state_of(light)->plain) return light->record->radiance.factor;
    const surface_t surface = {.p = spot->p,
                               .ng = spot->n,
                               .ns = spot->n,
                               .shape = state_of(light)->shape,
                               .instance = BLOB_NONE,
                               .primitive = spot->primitive,
                               .place = spot->place};
    return radiance_at(light, &surface, false);
}

/* Density, per steradian, of a ray that leaves at this cosine to the normal, without a guide */
static float plain_ray_pdf(const light_t *light, float cosine)
{
    return is_two_sided(light) ? fabsf(cosine) * (0.5f * INV_PI_F) : float_max(0, cosine) * INV_PI_F;
}

/* and with one, in direction w. */
static float ray_pdf(const light_t *light, vec3_t w, float cosine)
{
    return light_guide_direction_pdf(light->guide, plain_ray_pdf(light, cosine), w);
}

static vec3_t offset(const light_t *light, const spot_t *spot, vec3_t direction)
{
    const quadric_t *quadric = state_of(light)->quadric;
    float distance = scene_offset_at(spot->p, quadric != NULL ? quadric->reach : 0);
    return v_mad(spot->p, v_dot(spot->n, direction) < 0 ? -distance : distance, spot->n);
}

/* ---- the three ways -------------------------------------------------------------------------------------
 */

/* A direction by the cosine, of a light that shines to both sides on either. */
static vec3_t draw_direction(const light_t *light, vec3_t n, vec2_t u)
{
    if (is_two_sided(light)) {
        if (u.x >= 0.5f) n = v_neg(n);
        u.x = u.x < 0.5f ? 2 * u.x : 2 * u.x - 1;
    }
    vec3_t s, t, local = warp_cosine_hemisphere(u);
    v_frame(n, &s, &t);
    return v_add(v_add(v_scale(s, local.x), v_scale(t, local.y)), v_scale(n, local.z));
}

/* The medium on the side where the cosine to the normal is that. */
static blob_ref_t medium_at(const light_t *light, float cosine)
{
    const blob_shape_t *shape = &scene_blob(light->scene)->shapes[light->record->shape];
    return shape->flags & SHAPE_INTERFACE ? shape->media[cosine > 0] : light->medium;
}

static bool emit(const light_t *light, float choice, vec2_t place, vec2_t ray, light_ray_t *out)
{
    spot_t spot;
    sample_spot(light, choice, place, &spot);
    if (!light_guide_direction(light->guide, &ray, &out->direction))
        out->direction = draw_direction(light, spot.n, ray);
    float cosine = v_dot(spot.n, out->direction);
    if (!(plain_ray_pdf(light, cosine) > 0) || !(spot.pdf > 0)) return false;
    out->pdf_ray = ray_pdf(light, out->direction, cosine);
    out->start = light_guide_direction_start(light->guide_side, out->direction, out->pdf_ray);
    out->delta = is_unseen(light);
    out->point = spot.p;
    out->origin = offset(light, &spot, out->direction);
    out->pdf_place = spot.pdf;
    out->cosine = fabsf(cosine);
    out->medium = medium_at(light, cosine);
    out->throughput = v_scale(radiance_of_spot(light, &spot), out->cosine / (out->pdf_ray * spot.pdf));
    return !v_is_zero(out->throughput);
}

static bool illuminate(const light_t *light, float choice, vec3_t point, vec2_t place, light_view_t *out)
{
    spot_t spot;
    sample_spot(light, choice, place, &spot);
    vec3_t d = v_sub(spot.p, point);
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return false;
    out->w = v_scale(d, 1 / sqrtf(distance2));
    float cosine = -v_dot(spot.n, out->w);
    if (cosine == 0 || (cosine < 0 && !is_two_sided(light))) return false;
    out->radiance = radiance_of_spot(light, &spot);
    out->target = offset(light, &spot, v_neg(out->w));
    out->medium = medium_at(light, cosine);
    out->delta = is_unseen(light);
    out->pdf_place = spot.pdf;
    out->geometry = fabsf(cosine) / distance2;
    out->arrival = ray_pdf(light, v_neg(out->w), cosine) / distance2;
    out->plain_arrival = plain_ray_pdf(light, cosine) / distance2;
    return !v_is_zero(out->radiance) && spot.pdf > 0;
}

bool light_area_hit(const light_t *light, const surface_t *surface, vec3_t wo, light_hit_t *out)
{
    float cosine = v_dot(surface->ng, wo);
    if (cosine <= 0 && !is_two_sided(light)) return false;
    out->radiance = radiance_at(light, surface, true);
    out->pdf_ray = ray_pdf(light, wo, cosine);
    out->start = light_guide_direction_start(light->guide_side, wo, out->pdf_ray);
    const quadric_t *quadric = state_of(light)->quadric;
    if (quadric == NULL) {
        out->pdf_place = mesh_density(light);
    } else {
        quadric_point_t point;
        quadric_at(quadric, surface->p, &point);
        out->pdf_place = quadric_density(light, quadric, &point);
    }
    return !v_is_zero(out->radiance);
}

const light_ops_t light_area = {.prepare = prepare,
                                .release = release,
                                .power = power,
                                .box = box,
                                .emit = emit,
                                .illuminate = illuminate,
                                .guide = GUIDE_DIRECTIONS};
