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

/* What is left of light on a way through borders of media, from one to the next as walks go. Whatever else
 * lies there lets this light through, as shadow rays said (scene_alpha.c). */
static rgb_t step_through(sample_t *sample, vec3_t from, vec3_t w, blob_ref_t number, float length,
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

/* Whether they are all kept, and none so close behind another that a walk would pass both as one. */
static bool are_clear(const borders_t *borders, float length)
{
    const float most = 16; /* offsets: these are along the normal */
    if (borders->count > BORDERS_KEPT) return false;
    for (int i = 1; i < borders->count; i++) {
        float at = borders->kept[i].at, gap = at - borders->kept[i - 1].at;
        if (!(gap > 0x1p-18f * at && gap * length > most * borders->kept[i].offset)) return false;
    }
    return true;
}

/* The same through borders that are clear. */
static rgb_t pass_borders(const setup_t *setup, vec3_t from, vec3_t w, blob_ref_t number, float length,
                          const borders_t *borders, media_numbers_t *numbers)
{
    rgb_t left = {1, 1, 1};
    float at = 0;
    for (int i = 0;; i++) {
        bool last = i == borders->count;
        float end = last ? 1 : borders->kept[i].at;
        if (number != 0)
            left = v_mul(left, media_transmittance(setup->media, number, v_mad(from, at * length, w), w,
                                                   (end - at) * length, numbers));
        if (last || v_is_zero(left)) return left;
        number = borders->kept[i].behind;
        at = end;
    }
}

rgb_t media_between(sample_t *sample, vec3_t from, vec3_t to, const medium_t *medium, float length,
                    float faint, const borders_t *borders)
{
    const setup_t *setup = sample->setup;
    rgb_t left = {1, 1, 1};
    if (!v_is_zero(medium->attenuation)) left = medium_transmittance(medium, length);
    if (setup->media == NULL || (medium->number == 0 && borders->count == 0)) return left;
    media_numbers_t numbers = numbers_between(sample, from, to);
    numbers.faint = faint;
    vec3_t w = v_normalize(v_sub(to, from));
    if (!are_clear(borders, length))
        return v_mul(left, step_through(sample, from, w, medium->number, length, &numbers));
    return v_mul(left, pass_borders(setup, from, w, medium->number, length, borders, &numbers));
}
