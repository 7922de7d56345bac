/* transmittance: see transmittance.h. */
#include "worker/render/integrator/transmittance.h"

#include <string.h>

/* Numbers that are a function of the two points and the sample. */
static media_numbers_t numbers_between(const sample_t *sample, vec3_t from, vec3_t to)
{
    uint32_t words[6];
    memcpy(words, &from, sizeof from);
    memcpy(words + 3, &to, sizeof to);
    uint64_t key = sampler_mix_words(sample->numbers.sample_key, words, ARRAY_LENGTH(words));
    return (media_numbers_t){.first = -1, .key = key, .waves = sample->waves};
}

/* The same through the borders of media. Whatever else lies there lets this light through, as shadow rays
 * said (scene_alpha.c). */
static rgb_t pass_borders(sample_t *sample, vec3_t from, vec3_t w, blob_ref_t number, float length,
                          media_numbers_t *numbers)
{
    enum { MOST_BORDERS = 1000 }; /* as for walks */
    const setup_t *setup = sample->setup;
    rgb_t left = {1, 1, 1};
    float gone = 0;
    for (int i = 0; i < MOST_BORDERS; i++) {
        surface_t surface;
        sample->result->counts.rays++;
        float rest = length - gone;
        bool hit = scene_find_border(setup->scene, from, w, rest, sample->time, &surface);
        float distance = hit ? v_length(v_sub(surface.p, from)) : INFINITY;
        bool last = !(distance < rest);
        if (number != 0)
            left = v_mul(left,
                         media_transmittance(setup->media, number, from, w, last ? rest : distance, numbers));
        if (last || v_is_zero(left)) return left;
        if (surface_is_interface(&surface)) number = medium_behind(&surface, w);
        from = scene_offset(&surface, w);
        gone += distance;
    }
    return vec3(0, 0, 0);
}

rgb_t media_between(sample_t *sample, vec3_t from, vec3_t to, const medium_t *medium, float length,
                    float faint)
{
    const setup_t *setup = sample->setup;
    rgb_t left = {1, 1, 1};
    if (!v_is_zero(medium->attenuation)) left = medium_transmittance(medium, length);
    if (setup->media == NULL) return left;
    media_numbers_t numbers = numbers_between(sample, from, to);
    numbers.faint = faint;
    vec3_t w = v_normalize(v_sub(to, from));
    if (scene_has_borders(setup->scene))
        return v_mul(left, pass_borders(sample, from, w, medium->number, length, &numbers));
    if (medium->number == 0) return left;
    return v_mul(left, media_transmittance(setup->media, medium->number, from, w, length, &numbers));
}
