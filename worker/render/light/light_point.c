/* light_point: lights of a single point, which no path runs into: the same everywhere, in a cone, by an image
 * over all directions (goniometric), or through a window (projection). */
#include "worker/render/light/light.h"
#include "worker/render/light/light_map.h"
#include "worker/render/sampling/warp.h"

#include <stdlib.h>

/* How much goes where; directions in light space, of unit length, densities per steradian there. */
typedef struct {
    rgb_t (*intensity)(const light_t *light, vec3_t d);
    /* Draws a direction for a ray; *pdf is 0 when there is none. */
    vec3_t (*draw)(const light_t *light, vec2_t u, float *pdf);
    float (*pdf)(const light_t *light, vec3_t d);
} beam_t;

typedef struct {
    vec3_t position;
    xform_t light_from_world;
    light_map_t map; /* of those with an image */
} point_state_t;

static const point_state_t *state_of(const light_t *light)
{
    return light->state;
}

static vec3_t to_light(const light_t *light, vec3_t w)
{
    return v_normalize(xform_vector(&state_of(light)->light_from_world, w));
}

static vec3_t to_world(const light_t *light, vec3_t d)
{
    return v_normalize(xform_vector(&light->record->world_from_light, d));
}

static void *prepare(const light_t *light)
{
    const xform_t *t = &light->record->world_from_light;
    point_state_t *state = mem_zalloc(1, sizeof *state);
    state->position = vec3(t->m[0][3], t->m[1][3], t->m[2][3]);
    xform_invert(t, &state->light_from_world);
    if (light->record->image != 0) light_map_init(&state->map, light);
    return state;
}

static void release(void *state)
{
    light_map_free(&((point_state_t *)state)->map);
    free(state);
}

static void box(const light_t *light, vec3_t *low, vec3_t *high)
{
    *low = *high = state_of(light)->position;
}

/* Density, per steradian, of a ray in direction w, d in light space. */
static float ray_pdf(const light_t *light, const beam_t *beam, vec3_t w, vec3_t d)
{
    float plain = beam->pdf(light, d) * warp_density_factor(&light->record->world_from_light, d);
    return light_guide_direction_pdf(light->guide, plain, w);
}

static bool emit(const light_t *light, const beam_t *beam, vec2_t u, light_ray_t *out)
{
    vec3_t d;
    float pdf;
    if (light_guide_direction(light->guide, &u, &out->direction)) {
        d = to_light(light, out->direction);
    } else {
        d = beam->draw(light, u, &pdf);
        if (!(pdf > 0)) return false;
        out->direction = to_world(light, d);
    }
    out->pdf_ray = ray_pdf(light, beam, out->direction, d);
    if (!(out->pdf_ray > 0)) return false;
    out->start = light_guide_direction_start(light->guide_side, out->direction, out->pdf_ray);
    out->origin = out->point = state_of(light)->position;
    out->pdf_place = light->chance;
    out->delta = true;
    out->throughput = v_scale(beam->intensity(light, d), 1 / (out->pdf_ray * light->chance));
    return !v_is_zero(out->throughput);
}

static bool illuminate(const light_t *light, const beam_t *beam, vec3_t point, light_view_t *out)
{
    out->target = state_of(light)->position;
    vec3_t to = v_sub(out->target, point);
    float distance2 = v_length2(to);
    if (!(distance2 > 0)) return false;
    out->w = v_scale(to, 1 / sqrtf(distance2));
    vec3_t from = v_neg(out->w), d = to_light(light, from);
    out->radiance = beam->intensity(light, d);
    out->pdf_place = light->chance;
    out->geometry = 1 / distance2;
    out->arrival = ray_pdf(light, beam, from, d) / distance2;
    out->delta = true;
    return !v_is_zero(out->radiance);
}

static double flux(const light_t *light, double steradians)
{
    return steradians * (double)rgb_luminance(light->record->radiance.factor);
}

/* Every kind has the same pair of functions about its beam. */
#define DEFINE_WAYS(name)                                                                                    \
    static bool name##_emit(const light_t *light, float choice, vec2_t place, vec2_t ray, light_ray_t *out)  \
    {                                                                                                        \
        (void)choice, (void)place;                                                                           \
        return emit(light, &name##_beam, ray, out);                                                          \
    }                                                                                                        \
    static bool name##_illuminate(const light_t *light, float choice, vec3_t point, vec2_t place,            \
                                  light_view_t *out)                                                         \
    {                                                                                                        \
        (void)choice, (void)place;                                                                           \
        return illuminate(light, &name##_beam, point, out);                                                  \
    }

/* ---- point --------------------------------------------------------------------------------------------- */

static rgb_t point_intensity(const light_t *light, vec3_t d)
{
    (void)d;
    return light->record->radiance.factor;
}

static vec3_t point_draw(const light_t *light, vec2_t u, float *pdf)
{
    (void)light;
    *pdf = 0.25f * INV_PI_F;
    return warp_sphere(u);
}

static float point_pdf(const light_t *light, vec3_t d)
{
    (void)light, (void)d;
    return 0.25f * INV_PI_F;
}

static double point_power(const light_t *light)
{
    return flux(light, 4 * M_PI);
}

static const beam_t point_beam = {point_intensity, point_draw, point_pdf};
DEFINE_WAYS(point)
const light_ops_t light_point = {.prepare = prepare,
                                 .release = release,
                                 .power = point_power,
                                 .box = box,
                                 .emit = point_emit,
                                 .illuminate = point_illuminate,
                                 .guide = GUIDE_DIRECTIONS};

/* ---- spot ---------------------------------------------------------------------------------------------- */

/* Full inside the inner angle, nothing outside the outer. */
static rgb_t spot_intensity(const light_t *light, vec3_t d)
{
    float outer = light->record->parameters[0], inner = light->record->parameters[1];
    if (d.z <= outer) return vec3(0, 0, 0);
    float full = light->record->flags & LIGHT_COSINE ? d.z : 1;
    if (d.z >= inner) return v_scale(light->record->radiance.factor, full);
    float x = (d.z - outer) / (inner - outer), fall = x * x * x * x;
    if (light->record->flags & LIGHT_SMOOTHSTEP) fall = x * x * (3 - 2 * x);
    if (light->record->flags & LIGHT_SQUARE) fall = x * x;
    return v_scale(light->record->radiance.factor, fall * full);
}

/* Steradians of the cone. */
static float spot_cone(const light_t *light)
{
    return TWO_PI_F * (1 - light->record->parameters[0]);
}

static vec3_t spot_draw(const light_t *light, vec2_t u, float *pdf)
{
    float z = 1 - u.x * (1 - light->record->parameters[0]), r = sqrtf(float_max(0, 1 - z * z));
    *pdf = 1 / spot_cone(light);
    return vec3(r * cosf(TWO_PI_F * u.y), r * sinf(TWO_PI_F * u.y), z);
}

static float spot_pdf(const light_t *light, vec3_t d)
{
    return d.z >= light->record->parameters[0] ? 1 / spot_cone(light) : 0;
}

static double spot_power(const light_t *light)
{
    float middle = 0.5f * (light->record->parameters[0] + light->record->parameters[1]);
    return flux(light, 2 * M_PI * (1 - (double)middle));
}

static const beam_t spot_beam = {spot_intensity, spot_draw, spot_pdf};
DEFINE_WAYS(spot)
const light_ops_t light_spot = {.prepare = prepare,
                                .release = release,
                                .power = spot_power,
                                .box = box,
                                .emit = spot_emit,
                                .illuminate = spot_illuminate,
                                .guide = GUIDE_DIRECTIONS};

/* ---- goniometric --------------------------------------------------------------------------------------- */

static rgb_t goniometric_intensity(const light_t *light, vec3_t d)
{
    return v_mul(light->record->radiance.factor, light_map_value(&state_of(light)->map, d));
}

static vec3_t goniometric_draw(const light_t *light, vec2_t u, float *pdf)
{
    return light_map_sample(&state_of(light)->map, u, pdf);
}

static float goniometric_pdf(const light_t *light, vec3_t d)
{
    return light_map_pdf(&state_of(light)->map, d);
}

static double goniometric_power(const light_t *light)
{
    return flux(light, 4 * M_PI * state_of(light)->map.mean);
}

static const beam_t goniometric_beam = {goniometric_intensity, goniometric_draw, goniometric_pdf};
DEFINE_WAYS(goniometric)
const light_ops_t light_goniometric = {.prepare = prepare,
                                       .release = release,
                                       .power = goniometric_power,
                                       .box = box,
                                       .emit = goniometric_emit,
                                       .illuminate = goniometric_illuminate,
                                       .guide = GUIDE_DIRECTIONS};

/* ---- projection ---------------------------------------------------------------------------------------- */

/* Where a direction meets the window, as fractions of it from the top left; false outside. */
static bool in_window(const light_t *light, vec3_t d, vec2_t *st)
{
    const float *w = light->record->parameters;
    if (!(d.z > 0)) return false;
    *st = (vec2_t){(d.x / d.z - w[0]) / (w[1] - w[0]), (w[3] - d.y / d.z) / (w[3] - w[2])};
    return st->x >= 0 && st->x <= 1 && st->y >= 0 && st->y <= 1;
}

static float window_area(const light_t *light)
{
    const float *w = light->record->parameters;
    return (w[1] - w[0]) * (w[3] - w[2]);
}

static rgb_t projection_intensity(const light_t *light, vec3_t d)
{
    vec2_t st;
    if (!in_window(light, d, &st)) return vec3(0, 0, 0);
    return v_mul(
        light->record->radiance.factor,
        textures_image(scene_textures(light->scene), light->record->image - 1, WRAP_CLAMP, WRAP_CLAMP, st));
}

static vec3_t projection_draw(const light_t *light, vec2_t u, float *pdf)
{
    const float *w = light->record->parameters;
    vec3_t d = v_normalize(vec3(w[0] + u.x * (w[1] - w[0]), w[3] - u.y * (w[3] - w[2]), 1));
    *pdf = 1 / (window_area(light) * d.z * d.z * d.z);
    return d;
}

static float projection_pdf(const light_t *light, vec3_t d)
{
    vec2_t st;
    return in_window(light, d, &st) ? 1 / (window_area(light) * d.z * d.z * d.z) : 0;
}

static double projection_power(const light_t *light)
{
    double steradians = fmin((double)window_area(light), 2 * M_PI);
    return flux(light, steradians * state_of(light)->map.mean);
}

static const beam_t projection_beam = {projection_intensity, projection_draw, projection_pdf};
DEFINE_WAYS(projection)
const light_ops_t light_projection = {.prepare = prepare,
                                      .release = release,
                                      .power = projection_power,
                                      .box = box,
                                      .emit = projection_emit,
                                      .illuminate = projection_illuminate,
                                      .guide = GUIDE_DIRECTIONS};
