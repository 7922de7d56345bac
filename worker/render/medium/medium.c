/* medium: see medium.h. */
#include "worker/render/medium/medium.h"

#include "common/base.h"
#include "common/colour/albedo.h"

#include <stdlib.h>

typedef struct {
    rgb_t absorption, scattering, extinction, emission;
    float most; /* of the extinction, by channel, over the density's bound */
    float mean; /* of the scattering */
    float g;
    rgb_t shown; /* is_of_colour: about what it shows of white */
    bool emits, is_body, is_of_colour;
    density_t *density; /* NULL: 1 everywhere */
    bool tinted;        /* the density has bounds alone; a place has the tints: */
    field_t absorption_tint, scattering_tint, emission_tint, temperature;
    float coldest, hottest;
    const float *glow; /* [BLOB_GLOW_STEPS][3] */
    /* Of the channels of a ray (matter_of). Its emission, and where it is tinted its coefficients, stay
     * colours until it is known where. NULL: red, green and blue. */
    const waves_t *waves;
} matter_t;

struct media {
    uint32_t count;
    bool has_bodies;
    matter_t matter[]; /* [count] */
};

/* What a tint's cell makes of a coefficient. */
static rgb_t tint_cell(rgb_t coefficient, const field_t *tint, size_t cell)
{
    if (tint->record == NULL) return coefficient;
    const float *c = tint->numbers + 3 * cell;
    return v_mul(coefficient, vec3(c[0], c[1], c[2]));
}

/* The density of a medium that has tints: bounds on the extinction, by the largest channel of each cell. */
static density_t *bound_tints(const scene_blob_t *blob, const blob_medium_t *record, const matter_t *m)
{
    blob_ref_t box = record->absorption_tint != 0 ? record->absorption_tint : record->scattering_tint;
    const uint32_t *n = blob->fields[box - 1].cells;
    size_t count = (size_t)n[0] * n[1] * n[2];
    float *cells = mem_alloc(count * sizeof *cells);
    for (size_t i = 0; i < count; i++)
        cells[i] = v_max(tint_cell(m->absorption, &m->absorption_tint, i)) +
                   v_max(tint_cell(m->scattering, &m->scattering_tint, i)); /* also of their spectra's sum */
    density_t *density = density_of_cells(blob, box, cells);
    free(cells);
    return density;
}

/* Each channel's colour_of_albedo. */
static rgb_t colour_of_albedos(rgb_t scattering, rgb_t extinction, double g)
{
    return vec3((float)colour_of_albedo((double)(scattering.x / extinction.x), g),
                (float)colour_of_albedo((double)(scattering.y / extinction.y), g),
                (float)colour_of_albedo((double)(scattering.z / extinction.z), g));
}

static void prepare(const scene_blob_t *blob, const blob_medium_t *record, matter_t *m)
{
    m->absorption = record->absorption;
    m->scattering = record->scattering;
    m->extinction = v_add(record->absorption, record->scattering);
    m->emission = record->emission;
    m->most = v_max(m->extinction);
    m->mean = v_dot(m->scattering, vec3(1, 1, 1)) / 3;
    m->g = record->g;
    m->is_of_colour =
        record->is_of_colour != 0 && m->extinction.x > 0 && m->extinction.y > 0 && m->extinction.z > 0;
    if (m->is_of_colour) m->shown = colour_of_albedos(m->scattering, m->extinction, (double)m->g);
    m->emits = !v_is_zero(record->emission);
    m->absorption_tint = field_open(blob, record->absorption_tint);
    m->scattering_tint = field_open(blob, record->scattering_tint);
    m->emission_tint = field_open(blob, record->emission_tint);
    m->temperature = field_open(blob, record->temperature);
    m->coldest = record->coldest;
    m->hottest = record->hottest;
    if (record->temperature != 0) m->glow = blob->numbers + record->first_glow;
    if (record->density != 0) m->density = density_new(blob, record->density);
    m->tinted = m->absorption_tint.record != NULL || m->scattering_tint.record != NULL;
    if (!m->tinted) return;
    m->density = bound_tints(blob, record, m);
    m->most = 1;
}

media_t *media_new(const scene_blob_t *blob, bool empty)
{
    uint32_t count = (uint32_t)blob->counts[BLOB_SECTION_MEDIA];
    if (count == 0) return NULL;
    media_t *media = mem_zalloc(1, sizeof *media + count * sizeof(matter_t));
    media->count = count;
    for (uint32_t i = 0; i < count && !empty; i++) prepare(blob, &blob->media[i], &media->matter[i]);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MATERIALS] && !empty; i++)
        if (blob->materials[i].body != 0)
            media->has_bodies = media->matter[blob->materials[i].body - 1].is_body = true;
    return media;
}

void media_destroy(media_t **media)
{
    media_t *self = *media;
    if (self == NULL) return;
    for (uint32_t i = 0; i < self->count; i++) density_destroy(&self->matter[i].density);
    free(self);
    *media = NULL;
}

bool media_emits(const media_t *media, blob_ref_t medium)
{
    return medium != 0 && media->matter[medium - 1].emits;
}

bool media_is_body(const media_t *media, blob_ref_t medium)
{
    return medium != 0 && media->matter[medium - 1].is_body;
}

bool media_is_grid(const media_t *media, blob_ref_t medium)
{
    return media != NULL && medium != 0 && media->matter[medium - 1].density != NULL;
}

bool media_has_bodies(const media_t *media)
{
    return media != NULL && media->has_bodies;
}

/* ---- numbers ------------------------------------------------------------------------------------------- */

static float next_number(media_numbers_t *numbers)
{
    float first = numbers->first;
    if (first >= 0) {
        numbers->first = -1;
        return first;
    }
    numbers->key += 0x9E3779B97F4A7C15u;
    return sampler_float((uint32_t)(sampler_mix(numbers->key) >> 32));
}

/* The shares of the channels in what is carried; even where nothing is. */
static rgb_t shares_of(rgb_t throughput)
{
    float sum = throughput.x + throughput.y + throughput.z;
    if (!(sum > 0) || !(sum < INFINITY)) return vec3(1.0f / 3, 1.0f / 3, 1.0f / 3);
    return v_scale(throughput, 1 / sum);
}

/* Decides by a number, which it stretches, between parts of it that add up to 1. */
static float choose(rgb_t shares, rgb_t values, float *u)
{
    const float share[3] = {shares.x, shares.y, shares.z}, value[3] = {values.x, values.y, values.z};
    int last = 0;
    for (int i = 0; i < 3; i++) {
        if (!(share[i] > 0)) continue;
        last = i;
        if (*u < share[i]) {
            *u = float_min(*u / share[i], 0x1.fffffep-1f);
            return value[i];
        }
        *u -= share[i];
    }
    *u = 0x1.fffffep-1f; /* where rounding led past them all */
    return value[last];
}

/* exp(-a x), where x may be infinite and a 0. */
static float fade(float a, float x)
{
    return a > 0 ? expf(-a * x) : 1;
}

static rgb_t fade_rgb(rgb_t a, float x)
{
    return vec3(fade(a.x, x), fade(a.y, x), fade(a.z, x));
}

/* ---- even media ---------------------------------------------------------------------------------------- */

/* What is left when light has gone through so much of a medium of density 1, and was scattered then, or not,
 * over the chance of it; `shares` are those of the channels that may have been chosen. */
static rgb_t weigh(const matter_t *m, rgb_t shares, float gone, bool met, rgb_t throughput)
{
    rgb_t density = fade_rgb(m->scattering, gone), left = fade_rgb(m->extinction, gone);
    if (met) {
        density = v_mul(density, m->scattering);
        left = v_mul(left, m->scattering);
    }
    float pdf = v_dot(shares, density);
    return pdf > 0 ? v_mul(throughput, v_scale(left, 1 / pdf)) : vec3(0, 0, 0);
}

/* Follows light where the density is 1, or where integrals over it tell how much of the medium it goes
 * through. */
static bool scatter_by_number(const matter_t *m, way_t *way, float distance, float u, rgb_t *throughput,
                              float *at)
{
    rgb_t shares = shares_of(*throughput);
    float chosen = choose(shares, m->scattering, &u), through = distance;
    float free = chosen > 0 ? -logf(1 - u) / chosen : INFINITY;
    *at = free;
    bool met = way != NULL ? way_find(way, free, &through, at) : free < distance;
    *throughput = weigh(m, shares, met ? free : through, met, *throughput);
    return met;
}

/* The integral of exp(-a t) over a distance that may be infinite. */
static float faded_length(float a, float distance)
{
    if (!(a * distance > 1e-4f)) return distance < INFINITY ? distance : 0;
    return -expm1f(-a * distance) / a;
}

/* ---- grids --------------------------------------------------------------------------------------------- */

/* Tentative collisions along a ray, by bounds on the extinction: how much of them is left to go through
 * before the next one. */
static float next_collision(media_numbers_t *numbers)
{
    return -logf(1 - next_number(numbers));
}

/* Moves *at on to the next one, before `end`; false when there is none, and what is *left then. */
static bool collides(float bound, float end, float *at, float *left)
{
    float there = *at + *left / bound;
    if (there < end) {
        *at = there;
        return true;
    }
    *left -= (end - *at) * bound;
    return false;
}

/* So many on one way that nothing is left of light, unless a medium is denser than 1e9 somewhere and empty
 * beside that, where tentative collisions might never end: a ray does not move by so little. */
enum { MOST_COLLISIONS = 1 << 17 };

/* The coefficients at a place of a ray, over the bound on the extinction. */
typedef struct {
    rgb_t scattering, extinction;
} rates_t;

static rgb_t tint(rgb_t coefficient, const field_t *by, const float place[3])
{
    return by->record != NULL ? v_mul(coefficient, field_colour(by, place)) : coefficient;
}

static rgb_t in_channels(const matter_t *m, rgb_t coefficient)
{
    return m->waves == NULL ? coefficient : waves_coefficient(m->waves, coefficient);
}

static rgb_t glow_in_channels(const matter_t *m, rgb_t emission)
{
    return m->waves == NULL ? emission : waves_light(m->waves, emission);
}

static rates_t rates_at(const matter_t *m, const march_t *march, float t, float bound)
{
    if (!m->tinted) {
        float scale = density_along(march, t) / bound;
        return (rates_t){v_scale(m->scattering, scale), v_scale(m->extinction, scale)};
    }
    float place[3];
    density_place(march, t, place);
    rgb_t scattering = v_scale(in_channels(m, tint(m->scattering, &m->scattering_tint, place)), 1 / bound),
          absorption = v_scale(in_channels(m, tint(m->absorption, &m->absorption_tint, place)), 1 / bound);
    return (rates_t){scattering, v_add(absorption, scattering)};
}

/* What is left of light that a tentative collision may have scattered or absorbed. */
static rgb_t rest_of(rgb_t lost)
{
    return vec3(float_max(1 - lost.x, 0), float_max(1 - lost.y, 0), float_max(1 - lost.z, 0));
}

/* A tentative collision; true when light is scattered. */
static bool collide(const rates_t *rates, media_numbers_t *numbers, rgb_t *throughput)
{
    float chance = float_min(v_dot(shares_of(*throughput), rates->scattering), 1);
    if (next_number(numbers) < chance) {
        *throughput = v_mul(*throughput, v_scale(rates->scattering, 1 / chance));
        return true;
    }
    *throughput = v_mul(*throughput, v_scale(rest_of(rates->extinction), 1 / (1 - chance)));
    return false;
}

static bool scatter_in_grid(const matter_t *m, vec3_t from, vec3_t direction, float distance,
                            media_numbers_t *numbers, rgb_t *throughput, float *at)
{
    march_t march;
    int met = 0;
    float begin, end, most, free = next_collision(numbers);
    march_begin(&march, m->density, from, direction, distance);
    while (march_next(&march, &begin, &end, &most)) {
        float bound = most * m->most;
        if (!(bound > 0)) continue;
        for (float t = begin; collides(bound, end, &t, &free); free = next_collision(numbers)) {
            rates_t rates = rates_at(m, &march, t, bound);
            if (collide(&rates, numbers, throughput)) {
                *at = t;
                return true;
            }
            if (++met > MOST_COLLISIONS) *throughput = vec3(0, 0, 0);
            if (v_is_zero(*throughput)) return false;
        }
    }
    return false;
}

static rgb_t transmit_grid(const matter_t *m, vec3_t from, vec3_t direction, float distance,
                           media_numbers_t *numbers)
{
    const float faint = numbers->faint;
    march_t march;
    int met = 0;
    float begin, end, most, free = next_collision(numbers);
    rgb_t left = {1, 1, 1};
    march_begin(&march, m->density, from, direction, distance);
    while (march_next(&march, &begin, &end, &most)) {
        float bound = most * m->most;
        if (!(bound > 0)) continue;
        for (float t = begin; collides(bound, end, &t, &free); free = next_collision(numbers)) {
            left = v_mul(left, rest_of(rates_at(m, &march, t, bound).extinction));
            float chance = v_max(left);
            if (++met > MOST_COLLISIONS) return vec3(0, 0, 0);
            if (!(chance > 0)) return left;
            if (chance < faint) { /* Russian roulette */
                if (!(next_number(numbers) < chance / faint)) return vec3(0, 0, 0);
                left = v_scale(left, faint / chance);
            }
        }
    }
    return left;
}

/* The colour of what has a temperature. */
static rgb_t glow_of(const matter_t *m, float temperature)
{
    if (!(temperature > m->coldest)) return vec3(0, 0, 0);
    float at = float_min((temperature - m->coldest) / (m->hottest - m->coldest), 1) * (BLOB_GLOW_STEPS - 1);
    int i = int_min((int)at, BLOB_GLOW_STEPS - 2);
    const float *a = m->glow + 3 * i, *b = a + 3;
    float part = at - (float)i;
    return vec3(a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]));
}

/* The emission at a place of a ray, over the bound. */
static rgb_t emission_at(const matter_t *m, const march_t *march, vec3_t point, float t, float bound)
{
    float place[3];
    rgb_t emission;
    density_place(march, t, place);
    if (m->tinted)
        emission = v_scale(tint(m->emission, &m->absorption_tint, place), 1 / bound);
    else
        emission = v_scale(m->emission, density_along(march, t) / bound);
    if (m->emission_tint.record != NULL) {
        if (!field_place(&m->emission_tint, point, place)) return vec3(0, 0, 0);
        emission = v_mul(emission, field_colour(&m->emission_tint, place));
    }
    if (m->temperature.record != NULL) {
        if (!field_place(&m->temperature, point, place)) return vec3(0, 0, 0);
        emission = v_mul(emission, glow_of(m, field_number(&m->temperature, place)));
    }
    return glow_in_channels(m, emission);
}

/* Emission by the tentative collisions: each stands for 1 / bound of the way. Thin media get more of them
 * than their extinction asks for. */
static rgb_t emit_in_grid(const matter_t *m, vec3_t from, vec3_t direction, float distance,
                          media_numbers_t *numbers)
{
    const float looks = 8; /* on all of the way through the box */
    march_t march;
    int met = 0;
    float first = numbers->first; /* is for the distance, which matters more */
    numbers->first = -1;
    float begin, end, most, free = next_collision(numbers);
    rgb_t left = {1, 1, 1}, sum = {0, 0, 0};
    march_begin(&march, m->density, from, direction, distance);
    float least = march.at < march.end ? looks / (march.end - march.at) : 1;
    while (march_next(&march, &begin, &end, &most)) {
        float bound = float_max(most * m->most, least);
        if (!(most > 0)) continue;
        for (float t = begin; collides(bound, end, &t, &free); free = next_collision(numbers)) {
            vec3_t point = v_add(from, v_scale(direction, t));
            if (++met > MOST_COLLISIONS) break;
            sum = v_add(sum, v_mul(left, emission_at(m, &march, point, t, bound)));
            left = v_mul(left, rest_of(rates_at(m, &march, t, bound).extinction));
        }
    }
    numbers->first = first;
    return sum;
}

/* ---- any ---------------------------------------------------------------------------------------------- */

/* The coefficients that show a colour in the channels. Those of red, green and blue would not do: where
 * nearly nothing is absorbed in one of them, their spectra have what others absorb there, and show far less.
 */
static void set_colour(matter_t *there, const matter_t *m, const waves_t *waves)
{
    rgb_t colour = waves_reflectance(waves, m->shown);
    double g = (double)m->g;
    rgb_t albedo =
        vec3((float)albedo_of_colour((double)colour.x, g), (float)albedo_of_colour((double)colour.y, g),
             (float)albedo_of_colour((double)colour.z, g));
    there->extinction = waves_coefficient(waves, m->extinction);
    there->scattering = v_mul(there->extinction, albedo);
    there->absorption = v_sub(there->extinction, there->scattering);
}

/* The medium, with what its colours are in the channels; `there` is room for it. */
static const matter_t *matter_of(const media_t *media, blob_ref_t medium, const media_numbers_t *numbers,
                                 matter_t *there)
{
    const matter_t *m = &media->matter[medium - 1];
    if (numbers->waves == NULL) return m;
    *there = *m;
    there->waves = numbers->waves;
    if (m->tinted) {
        there->most *= 2; /* which no wavelength of a colour exceeds */
        return there;
    }
    if (m->is_of_colour) {
        set_colour(there, m, numbers->waves);
    } else {
        there->scattering = waves_coefficient(numbers->waves, m->scattering);
        there->absorption = waves_coefficient(numbers->waves, m->absorption);
        there->extinction = v_add(there->absorption, there->scattering);
    }
    there->most = v_max(there->extinction);
    return there;
}

bool media_scatter(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction, float distance,
                   media_numbers_t *numbers, rgb_t *throughput, float *at)
{
    matter_t there;
    const matter_t *m = matter_of(media, medium, numbers, &there);
    if (m->density == NULL) return scatter_by_number(m, NULL, distance, next_number(numbers), throughput, at);
    if (!numbers->exact || !density_is_small(m->density))
        return scatter_in_grid(m, from, direction, distance, numbers, throughput, at);
    way_t own, *way = numbers->way;
    if (way == NULL) way_forget(way = &own);
    if (!way_is(way, m->density, from, direction, distance))
        way_begin(way, m->density, from, direction, distance);
    return scatter_by_number(m, way, distance, next_number(numbers), throughput, at);
}

rgb_t media_transmittance(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction,
                          float distance, media_numbers_t *numbers)
{
    matter_t there;
    const matter_t *m = matter_of(media, medium, numbers, &there);
    if (m->density != NULL) return transmit_grid(m, from, direction, distance, numbers);
    return fade_rgb(m->extinction, distance);
}

float media_fade(const media_t *media, blob_ref_t medium, float distance)
{
    const float least = 1e-6f; /* so that squares of densities stay numbers */
    if (medium == 0 || media->matter[medium - 1].density != NULL) return 1;
    return float_max(fade(media->matter[medium - 1].mean, distance), least);
}

rgb_t media_emission(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction, float distance,
                     media_numbers_t *numbers)
{
    matter_t there;
    const matter_t *m = matter_of(media, medium, numbers, &there);
    if (m->density != NULL) return emit_in_grid(m, from, direction, distance, numbers);
    rgb_t a = m->extinction;
    return v_mul(glow_in_channels(m, m->emission),
                 vec3(faded_length(a.x, distance), faded_length(a.y, distance), faded_length(a.z, distance)));
}

void media_bsdf(const media_t *media, blob_ref_t medium, vec3_t wo, bsdf_t *bsdf)
{
    bsdf->ng = bsdf->ns = wo;
    v_frame(wo, &bsdf->s, &bsdf->t);
    bsdf->attenuation = vec3(0, 0, 0);
    bsdf->absorbs = bsdf->specular = false;
    bsdf->count = 1;
    bsdf->lobes[0] = (lobe_t){
        .kind = &lobe_phase, .scale = {1, 1, 1}, .chance = 1, .phase = {media->matter[medium - 1].g}};
}
