/* light_sky: lights at infinity: the distant one, in a single direction, and the infinite one, in all. Their
 * rays start on the upright box about the scene, evenly as their direction sees it; those of an infinite
 * light with a portal on the portal, or rather so far before it that all of the scene is in front of them. */
#include "worker/render/light/light_map.h"
#include "worker/render/light/light_portal.h"
#include "worker/render/sampling/warp.h"

#include <stdlib.h>

typedef struct {
    vec3_t towards; /* the distant light's direction, in the world */
    xform_t light_from_world;
    light_map_t map; /* of an infinite light with an image; with a portal of values alone */
    light_portal_t portal;
} sky_state_t;

static const sky_state_t *state_of(const light_t *light)
{
    return light->state;
}

static bool has_portal(const light_t *light)
{
    return (light->record->flags & LIGHT_PORTAL) != 0;
}

static void *prepare(const light_t *light)
{
    const xform_t *t = &light->record->world_from_light;
    sky_state_t *state = mem_zalloc(1, sizeof *state);
    state->towards = v_normalize(vec3(t->m[0][2], t->m[1][2], t->m[2][2]));
    xform_invert(t, &state->light_from_world);
    if (light->record->image != 0)
        (has_portal(light) ? light_map_init_values : light_map_init)(&state->map, light);
    return state;
}

static void release(void *state)
{
    light_map_free(&((sky_state_t *)state)->map);
    light_portal_free(&((sky_state_t *)state)->portal);
    free(state);
}

/* Of the disc that the sphere about the scene shows. */
static double disc_area(const light_t *light)
{
    return M_PI * (double)light->radius * (double)light->radius;
}

/* What the faces of the box about the scene across x, y and z show of their area in the direction w. */
static vec3_t faces_seen(const light_t *light, vec3_t w)
{
    vec3_t h = light->half_sides;
    return vec3(4 * fabsf(w.x) * h.y * h.z, 4 * fabsf(w.y) * h.z * h.x, 4 * fabsf(w.z) * h.x * h.y);
}

/* The square that guides cut lies across the direction w and covers the sphere about the scene. */
static double square_area(const light_t *light)
{
    return 4 * (double)light->radius * (double)light->radius;
}

/* Where the line through the point along w crosses the square. */
static vec2_t square_at(const light_t *light, vec3_t w, vec3_t point)
{
    vec3_t s, t, d = v_scale(v_sub(point, light->centre), 0.5f / light->radius);
    v_frame(w, &s, &t);
    return (vec2_t){0.5f + v_dot(d, s), 0.5f + v_dot(d, t)};
}

/* A point of that line before the scene. */
static vec3_t square_point(const light_t *light, vec3_t w, vec2_t at)
{
    vec3_t s, t, from = v_mad(light->centre, light->radius, w);
    float side = 2 * light->radius;
    v_frame(w, &s, &t);
    return v_mad(v_mad(from, side * (at.x - 0.5f), s), side * (at.y - 0.5f), t);
}

/* Density, per area across it, of a ray from direction w without a guide, */
static float plain_ray_pdf(const light_t *light, vec3_t w)
{
    vec3_t seen = faces_seen(light, w);
    return 1 / (seen.x + seen.y + seen.z);
}

/* and with one where it crosses the square, if such numbers draw the direction. */
static float ray_pdf(const light_t *light, vec3_t w, vec2_t place, vec2_t at)
{
    float plain = plain_ray_pdf(light, w), area = (float)square_area(light);
    if (light->guide == NULL) return plain;
    return light_guide_square_pdf(light->guide, place, plain * area, at) / area;
}

/* A point on one of the three faces of the box that w sees. */
static vec3_t box_point(const light_t *light, vec3_t w, vec2_t u)
{
    vec3_t seen = faces_seen(light, w), h = light->half_sides, at;
    float x = u.x * (seen.x + seen.y + seen.z), y = 2 * u.y - 1;
    if (x < seen.x)
        at = vec3(copysignf(h.x, w.x), h.y * (2 * x / seen.x - 1), h.z * y);
    else if (x - seen.x < seen.y)
        at = vec3(h.x * y, copysignf(h.y, w.y), h.z * (2 * (x - seen.x) / seen.y - 1));
    else
        at = vec3(h.x * (2 * float_min((x - seen.x - seen.y) / seen.z, 1) - 1), h.y * y, copysignf(h.z, w.z));
    return v_add(light->centre, at);
}

/* The start of a ray that crosses the square there, with such a density of the numbers and of the ray. */
static light_start_t start_of(const light_t *light, vec2_t place, float place_density, vec2_t at,
                              float ray_density)
{
    float density = place_density * ray_density * (float)square_area(light);
    return light_guide_square_start(light->guide_kind, light->guide_side, place, at, density);
}

/* A ray from the sky's direction w, which was drawn by the numbers `place` with such a density. */
static void start_ray(const light_t *light, vec3_t w, vec2_t place, float place_density, vec2_t u,
                      light_ray_t *out)
{
    vec2_t at;
    if (light_guide_square(light->guide, place, &u, &at)) {
        out->origin = square_point(light, w, at);
    } else {
        out->origin = box_point(light, w, u);
        at = square_at(light, w, out->origin);
    }
    out->direction = v_neg(w);
    out->pdf_ray = ray_pdf(light, w, place, at);
    out->start = start_of(light, place, place_density, at, out->pdf_ray);
    out->at_infinity = true;
}

/* A shadow ray to the direction w, which was drawn by the numbers `place`, leaves the scene. */
static void look_at(const light_t *light, vec3_t point, vec3_t w, vec2_t place, light_view_t *out)
{
    out->w = w;
    out->target = v_mad(point, v_length(v_sub(point, light->centre)) + 2 * light->radius, w);
    out->geometry = 1;
    out->arrival = ray_pdf(light, w, place, square_at(light, w, point));
    out->plain_arrival = plain_ray_pdf(light, w);
    out->at_infinity = true;
}

/* ---- distant ------------------------------------------------------------------------------------------- */

static bool distant_emit(const light_t *light, float choice, vec2_t place, vec2_t ray, light_ray_t *out)
{
    (void)choice, (void)place;
    start_ray(light, state_of(light)->towards, (vec2_t){0, 0}, 1, ray, out);
    out->pdf_place = light->chance;
    out->delta = true;
    out->throughput = v_scale(light->record->radiance.factor, 1 / (out->pdf_ray * light->chance));
    return true;
}

static bool distant_illuminate(const light_t *light, float choice, vec3_t point, vec2_t place,
                               light_view_t *out)
{
    (void)choice, (void)place;
    look_at(light, point, state_of(light)->towards, (vec2_t){0, 0}, out);
    out->radiance = light->record->radiance.factor;
    out->pdf_place = light->chance;
    out->delta = true;
    return !v_is_zero(out->radiance);
}

static double distant_power(const light_t *light)
{
    return disc_area(light) * (double)rgb_luminance(light->record->radiance.factor);
}

const light_ops_t light_distant = {.prepare = prepare,
                                   .release = release,
                                   .power = distant_power,
                                   .emit = distant_emit,
                                   .illuminate = distant_illuminate,
                                   .guide = GUIDE_PARALLEL};

/* ---- infinite ------------------------------------------------------------------------------------------ */

/* The light's colour times what its image has in a direction. */
static rgb_t tinted(const light_t *light, rgb_t image)
{
    return v_mul(light->record->radiance.factor,
                 vec3(float_max(image.x, 0), float_max(image.y, 0), float_max(image.z, 0)));
}

static vec3_t to_light_space(const light_t *light, vec3_t w)
{
    return v_normalize(xform_vector(&state_of(light)->light_from_world, w));
}

static rgb_t infinite_radiance(const light_t *light, vec3_t w)
{
    if (light->record->image == 0) return light->record->radiance.factor;
    return tinted(light, light_map_value(&state_of(light)->map, to_light_space(light, w)));
}

static void *infinite_prepare(const light_t *light)
{
    light_t itself = *light; /* with the state that its radiance is looked up by */
    sky_state_t *state = itself.state = prepare(light);
    if (has_portal(light)) light_portal_init(&state->portal, &itself, infinite_radiance);
    return state;
}

static vec3_t infinite_draw(const light_t *light, vec2_t u, float *pdf, rgb_t *radiance)
{
    if (light->record->image == 0) {
        *pdf = light->chance * (0.25f * INV_PI_F);
        *radiance = light->record->radiance.factor;
        return warp_sphere(u);
    }
    rgb_t image;
    vec3_t d = light_map_draw(&state_of(light)->map, u, pdf, &image);
    *pdf *= light->chance * warp_density_factor(&light->record->world_from_light, d);
    *radiance = tinted(light, image);
    return v_normalize(xform_vector(&light->record->world_from_light, d));
}

/* A ray through the portal, at a uniform point of it, from any direction beyond. */
static bool portal_emit(const light_t *light, vec2_t place, vec2_t ray, light_ray_t *out)
{
    const light_portal_t *portal = &state_of(light)->portal;
    vec3_t w = light_portal_sample(portal, &portal->all, place, &out->pdf_place);
    float cosine = v_dot(w, portal->z);
    out->pdf_place *= light->chance;
    if (!(out->pdf_place > 0) || !(cosine > 1e-6f)) return false;
    vec3_t point = v_mad(v_mad(portal->corner, ray.x, portal->side_x), ray.y, portal->side_y);
    out->gate = v_length(v_sub(point, light->centre)) + light->radius;
    out->origin = v_mad(point, out->gate, w);
    out->direction = v_neg(w);
    out->pdf_ray = 1 / (portal->area * cosine);
    out->at_infinity = true;
    out->throughput = v_scale(infinite_radiance(light, w), 1 / (out->pdf_place * out->pdf_ray));
    return !v_is_zero(out->throughput);
}

static bool infinite_emit(const light_t *light, float choice, vec2_t place, vec2_t ray, light_ray_t *out)
{
    (void)choice;
    if (has_portal(light)) return portal_emit(light, place, ray, out);
    float density;
    place = light_guide_place(light->guide, place, &density);
    rgb_t radiance;
    vec3_t w = infinite_draw(light, place, &out->pdf_place, &radiance);
    out->pdf_place *= density;
    out->view_ratio /= density;
    if (!(out->pdf_place > 0)) return false;
    start_ray(light, w, place, density, ray, out);
    out->throughput = v_scale(radiance, 1 / (out->pdf_place * out->pdf_ray));
    return !v_is_zero(out->throughput);
}

/* What lights_enter says, for a view from a point. */
static float portal_enter(const light_portal_t *portal, const portal_view_t *view)
{
    return (float)(view->integral / portal->all.integral);
}

/* Density, per area across it, of the rays that portal_emit sends along w, where it is given that place. */
static float portal_arrival(const light_portal_t *portal, const portal_view_t *view, vec3_t w)
{
    return portal_enter(portal, view) / (portal->area * float_max(v_dot(w, portal->z), 1e-6f));
}

static bool portal_illuminate(const light_t *light, vec3_t point, vec2_t place, light_view_t *out)
{
    const light_portal_t *portal = &state_of(light)->portal;
    portal_view_t view;
    if (!light_portal_look(portal, point, &view)) return false;
    vec3_t w = light_portal_sample(portal, &view, place, &out->pdf_place);
    out->pdf_place *= light->chance;
    if (!(out->pdf_place > 0)) return false;
    look_at(light, point, w, place, out);
    out->arrival = out->plain_arrival = portal_arrival(portal, &view, w);
    out->radiance = infinite_radiance(light, w);
    return !v_is_zero(out->radiance);
}

static bool infinite_illuminate(const light_t *light, float choice, vec3_t point, vec2_t place,
                                light_view_t *out)
{
    (void)choice;
    if (has_portal(light)) return portal_illuminate(light, point, place, out);
    float density = light_guide_place_pdf(light->guide, place);
    vec3_t w = infinite_draw(light, place, &out->pdf_place, &out->radiance);
    out->pdf_place *= density;
    out->view_ratio /= density;
    if (!(out->pdf_place > 0)) return false;
    look_at(light, point, w, place, out);
    return !v_is_zero(out->radiance);
}

static bool portal_escape(const light_t *light, vec3_t point, vec3_t w, light_hit_t *out)
{
    const light_portal_t *portal = &state_of(light)->portal;
    portal_view_t view;
    if (!light_portal_look(portal, point, &view)) return false;
    out->pdf_place = light->chance * light_portal_pdf(portal, &view, w);
    if (!(out->pdf_place > 0)) return false; /* past the portal */
    out->pdf_ray = portal_arrival(portal, &view, w);
    out->radiance = infinite_radiance(light, w);
    return !v_is_zero(out->radiance);
}

static bool infinite_escape(const light_t *light, vec3_t point, vec3_t w, light_hit_t *out)
{
    if (has_portal(light)) return portal_escape(light, point, w, out);
    vec2_t place; /* the numbers that would have drawn it */
    if (light->record->image == 0) {
        out->radiance = light->record->radiance.factor;
        out->pdf_place = light->chance * (0.25f * INV_PI_F);
        place = warp_sphere_numbers(w);
    } else {
        float pdf;
        vec3_t d = to_light_space(light, w);
        out->radiance = tinted(light, light_map_look(&state_of(light)->map, d, &pdf, &place));
        out->pdf_place = light->chance * pdf * warp_density_factor(&light->record->world_from_light, d);
    }
    float density = light_guide_place_pdf(light->guide, place);
    out->pdf_place *= density;
    out->view_ratio /= density;
    vec2_t at = square_at(light, w, point);
    out->pdf_ray = ray_pdf(light, w, place, at);
    out->start = start_of(light, place, density, at, out->pdf_ray);
    return !v_is_zero(out->radiance);
}

/* What falls on the scene's disc, counted with the mean radiance alone (as pbrt does): the flux over all
 * directions would leave next to nothing to small lights near things. What comes through a portal is counted
 * as if the portal shone itself. */
static double infinite_power(const light_t *light)
{
    const light_portal_t *portal = &state_of(light)->portal;
    if (has_portal(light)) return fmin((double)portal->area, disc_area(light)) * portal->flux;
    double mean = light->record->image != 0 ? state_of(light)->map.mean : 1;
    return disc_area(light) * mean * (double)rgb_luminance(light->record->radiance.factor);
}

static float infinite_enter(const light_t *light, vec3_t point)
{
    const light_portal_t *portal = &state_of(light)->portal;
    portal_view_t view;
    return light_portal_look(portal, point, &view) ? portal_enter(portal, &view) : 0;
}

const light_ops_t light_infinite = {.prepare = infinite_prepare,
                                    .release = release,
                                    .power = infinite_power,
                                    .emit = infinite_emit,
                                    .illuminate = infinite_illuminate,
                                    .escape = infinite_escape,
                                    .enter = infinite_enter,
                                    .guide = GUIDE_SKY};
