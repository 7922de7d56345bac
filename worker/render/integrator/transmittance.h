/* transmittance: how much light arrives from one point of space at another. All that joins two points asks
 * here, and nothing else knows what may lie between them: surfaces, which stop light, and what fills the
 * space, which absorbs it.
 */
#ifndef LIGHTMILL_TRANSMITTANCE_H
#define LIGHTMILL_TRANSMITTANCE_H

#include "worker/render/integrator/integrator.h"
#include "worker/render/scene/scene.h"

/* What is left of light where Russian roulette begins in any case. */
static const float FAINT_LEFT = 0.1f;

static inline bool medium_absorbs(const medium_t *medium)
{
    return medium->number != 0 || !v_is_zero(medium->attenuation);
}

/* What is left of light after a distance through absorbing glass alone. */
static inline rgb_t medium_transmittance(const medium_t *medium, float distance)
{
    rgb_t a = medium->attenuation;
    return vec3(expf(-a.x * distance), expf(-a.y * distance), expf(-a.z * distance)); /* Beer's law */
}

/* The medium on the side of an interface (SHAPE_INTERFACE) to which w points. */
static inline blob_ref_t medium_behind(const surface_t *surface, vec3_t w)
{
    return surface->shape->media[v_dot(w, surface->ng) > 0];
}

/* What of light arrives between two points, from the first of which it starts in such a medium, if they see
 * each other; `length` apart, with these borders of media in between. Where less than `faint` is left in a
 * grid, of 1, Russian roulette decides. */
rgb_t media_between(sample_t *sample, vec3_t from, vec3_t to, const medium_t *medium, float length,
                    float faint, const borders_t *borders);

/* media_fade, in any scene. */
static inline float medium_fade(const setup_t *setup, blob_ref_t medium, float distance)
{
    return medium == 0 ? 1 : media_fade(setup->media, medium, distance);
}

/* True when media_between must be asked. */
static inline bool media_matter(const setup_t *setup, const medium_t *medium)
{
    return medium_absorbs(medium) || (setup->media != NULL && scene_has_borders(setup->scene));
}

/* What of light (or of importance) arrives that sets out from one point to another. `from` and `to` are off
 * the surfaces of the points, which are `length` apart. `look`: one of them is the camera (segments_t). */
static inline rgb_t transmit(sample_t *sample, vec3_t from, vec3_t to, medium_t medium, float length,
                             bool look, rgb_t value)
{
    borders_t borders;
    sample->result->counts.rays++;
    if (scene_crosses(sample->setup->scene, from, to, sample->time, look, &borders)) return vec3(0, 0, 0);
    if (!media_matter(sample->setup, &medium)) return value;
    return v_mul(value, media_between(sample, from, to, &medium, length, FAINT_LEFT, &borders));
}

/* Up to SCENE_PACKET such ways, quickest when all start close together. */
typedef struct {
    segments_t segments;
    rgb_t values[SCENE_PACKET];   /* that set out */
    uint32_t absorbing;           /* bit i is set where something absorbs, and only then */
    medium_t media[SCENE_PACKET]; /* are these */
    float lengths[SCENE_PACKET];
    float faint[SCENE_PACKET]; /* as for media_between */
} connections_t;

/* Adds one, for which there must be room, and returns its place. `faint` as for media_between. */
static inline int connections_add(connections_t *connections, const setup_t *setup, vec3_t from, vec3_t to,
                                  medium_t medium, float length, float faint, rgb_t value)
{
    int n = connections->segments.count++;
    segments_set(&connections->segments, n, from, to);
    connections->values[n] = value;
    if (media_matter(setup, &medium)) {
        connections->absorbing |= 1u << n;
        connections->media[n] = medium;
        connections->lengths[n] = length;
        connections->faint[n] = float_clamp(faint, FAINT_LEFT, 1);
    }
    return n;
}

/* Leaves of the values what arrives, and empties the packet. Bit i of the answer is set where nothing does.
 * `look` as in transmit. */
static inline uint32_t connections_transmit(sample_t *sample, connections_t *connections, bool look)
{
    connections->segments.time = sample->time;
    connections->segments.look = look;
    sample->result->counts.rays += (uint64_t)connections->segments.count;
    borders_t borders[SCENE_PACKET];
    uint32_t lost = scene_crosses_packet(sample->setup->scene, &connections->segments, borders);
    uint32_t absorbing = connections->absorbing & ~lost;
    for (int i = 0; absorbing >> i != 0; i++)
        if (absorbing >> i & 1)
            connections->values[i] =
                v_mul(connections->values[i],
                      media_between(sample, segments_from(&connections->segments, i),
                                    segments_to(&connections->segments, i), &connections->media[i],
                                    connections->lengths[i], connections->faint[i], &borders[i]));
    connections->absorbing = 0;
    connections->segments.count = 0;
    return lost;
}

#endif
