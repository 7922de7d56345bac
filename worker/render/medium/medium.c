/* medium: see medium.h. */
#include "worker/render/medium/medium.h"

#include "common/base.h"
#include "worker/render/medium/density.h"

#include <stdlib.h>

typedef struct {
    rgb_t scattering, extinction, emission;
    float most; /* of the extinction, by channel */
    float mean; /* of the scattering */
    float g;
    bool emits, is_body;
    density_t *density; /* NULL: 1 everywhere */
} matter_t;

struct media {
    uint32_t count;
    bool has_bodies;
    matter_t matter[]; /* [count] */
};

media_t *media_new(const scene_blob_t *blob, bool empty)
{
    uint32_t count = (uint32_t)blob->counts[BLOB_SECTION_MEDIA];
    if (count == 0) return NULL;
    media_t *media = mem_zalloc(1, sizeof *media + count * sizeof(matter_t));
    media->count = count;
    for (uint32_t i = 0; i < count && !empty; i++) {
        const blob_medium_t *record = &blob->media[i];
        matter_t *m = &media->matter[i];
        m->scattering = record->scattering;
        m->extinction = v_add(record->absorption, record->scattering);
        m->emission = record->emission;
        m->most = v_max(m->extinction);
        m->mean = v_dot(m->scattering, vec3(1, 1, 1)) / 3;
        m->g = record->g;
        m->emits = !v_is_zero(record->emission);
        if (record->cells[0] > 0) m->density = density_new(blob, record);
    }
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
static bool scatter_by_number(const matter_t *m, vec3_t from, vec3_t direction, float distance, float u,
                              rgb_t *throughput, float *at)
{
    rgb_t shares = shares_of(*throughput);
    float chosen = choose(shares, m->scattering, &u), through = distance;
    float free = chosen > 0 ? -logf(1 - u) / chosen : INFINITY;
    *at = free;
    bool met = m->density != NULL ? density_find(m->density, from, direction, distance, free, &through, at)
                                  : free < distance;
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

/* A tentative collision where the extinction is at most `bound`; true when light is scattered. */
static bool collide(const matter_t *m, float density, float bound, media_numbers_t *numbers,
                    rgb_t *throughput)
{
    rgb_t scattering = v_scale(m->scattering, density / bound),
          extinction = v_scale(m->extinction, density / bound);
    float chance = float_min(v_dot(shares_of(*throughput), scattering), 1);
    if (next_number(numbers) < chance) {
        *throughput = v_mul(*throughput, v_scale(v_scale(m->scattering, density / bound), 1 / chance));
        return true;
    }
    float scale = 1 / (1 - chance);
    *throughput = v_mul(*throughput,
                        vec3(float_max(1 - extinction.x, 0) * scale, float_max(1 - extinction.y, 0) * scale,
                             float_max(1 - extinction.z, 0) * scale));
    return false;
}

static bool scatter_in_grid(const matter_t *m, vec3_t from, vec3_t direction, float distance,
                            media_numbers_t *numbers, rgb_t *throughput, float *at)
{
    march_t march;
    float begin, end, most, free = next_collision(numbers);
    march_begin(&march, m->density, from, direction, distance);
    while (march_next(&march, &begin, &end, &most)) {
        float bound = most * m->most;
        if (!(bound > 0)) continue;
        for (float t = begin; collides(bound, end, &t, &free); free = next_collision(numbers)) {
            float density = density_along(&march, t);
            if (collide(m, density, bound, numbers, throughput)) {
                *at = t;
                return true;
            }
            if (v_is_zero(*throughput)) return false;
        }
    }
    return false;
}

static rgb_t transmit_grid(const matter_t *m, vec3_t from, vec3_t direction, float distance,
                           media_numbers_t *numbers)
{
    const float faint = 0.1f;
    march_t march;
    float begin, end, most, free = next_collision(numbers);
    rgb_t left = {1, 1, 1};
    march_begin(&march, m->density, from, direction, distance);
    while (march_next(&march, &begin, &end, &most)) {
        float bound = most * m->most;
        if (!(bound > 0)) continue;
        for (float t = begin; collides(bound, end, &t, &free); free = next_collision(numbers)) {
            rgb_t lost = v_scale(m->extinction, density_along(&march, t) / bound);
            left = v_mul(left,
                         vec3(float_max(1 - lost.x, 0), float_max(1 - lost.y, 0), float_max(1 - lost.z, 0)));
            float chance = v_max(left);
            if (!(chance > 0)) return left;
            if (chance < faint) { /* Russian roulette */
                if (!(next_number(numbers) < 0.5f)) return vec3(0, 0, 0);
                left = v_scale(left, 2);
            }
        }
    }
    return left;
}

/* Emission by the tentative collisions: each stands for 1 / bound of the way. */
static rgb_t emit_in_grid(const matter_t *m, vec3_t from, vec3_t direction, float distance,
                          media_numbers_t *numbers)
{
    march_t march;
    float begin, end, most, free = next_collision(numbers);
    rgb_t left = {1, 1, 1}, sum = {0, 0, 0};
    march_begin(&march, m->density, from, direction, distance);
    while (march_next(&march, &begin, &end, &most)) {
        float bound = most * float_max(m->most, 1e-9f);
        if (!(most > 0)) continue;
        for (float t = begin; collides(bound, end, &t, &free); free = next_collision(numbers)) {
            float density = density_along(&march, t) / bound;
            rgb_t lost = v_scale(m->extinction, density);
            sum = v_add(sum, v_mul(left, v_scale(m->emission, density)));
            left = v_mul(left,
                         vec3(float_max(1 - lost.x, 0), float_max(1 - lost.y, 0), float_max(1 - lost.z, 0)));
        }
    }
    return sum;
}

/* ---- any ----------------------------------------------------------------------------------------------- */

bool media_scatter(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction, float distance,
                   media_numbers_t *numbers, rgb_t *throughput, float *at)
{
    const matter_t *m = &media->matter[medium - 1];
    if (m->density != NULL && !density_is_small(m->density))
        return scatter_in_grid(m, from, direction, distance, numbers, throughput, at);
    return scatter_by_number(m, from, direction, distance, next_number(numbers), throughput, at);
}

rgb_t media_transmittance(const media_t *media, blob_ref_t medium, vec3_t from, vec3_t direction,
                          float distance, media_numbers_t *numbers)
{
    const matter_t *m = &media->matter[medium - 1];
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
    const matter_t *m = &media->matter[medium - 1];
    if (m->density != NULL) return emit_in_grid(m, from, direction, distance, numbers);
    rgb_t a = m->extinction;
    return v_mul(m->emission,
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
