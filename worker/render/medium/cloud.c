/* cloud: see cloud.h. */
#include "worker/render/medium/cloud.h"

#include "worker/render/texture/noise.h"

enum { DENSITY, WISPINESS, FREQUENCY };
enum { OCTAVES = 5, WISPS = 2 };
static const float steepness = 4.5f;

/* About the gradient of noise, by differences, as pbrt-v4's. */
static vec3_t slope(vec3_t p)
{
    const float step = 0.01f;
    float here = noise(p);
    vec3_t there = vec3(noise(vec3(p.x + step, p.y, p.z)), noise(vec3(p.x, p.y + step, p.z)),
                        noise(vec3(p.x, p.y, p.z + step)));
    return v_scale(v_sub(there, vec3(here, here, here)), 1 / step);
}

/* What the height, y, makes of a sum of noise. */
static float by_height(float density, float noise_sum, float y)
{
    float d = float_clamp((1 - y) * steepness * density * noise_sum, 0, 1);
    return float_clamp(d + 2 * float_max(0, 0.5f - y), 0, 1);
}

float cloud_density(const float parameters[3], const float point[3])
{
    vec3_t p = v_scale(vec3(point[0], point[1], point[2]), parameters[FREQUENCY]);
    if (parameters[WISPINESS] > 0) {
        float amplitude = 0.05f * parameters[WISPINESS], frequency = 10;
        for (int i = 0; i < WISPS; i++, amplitude *= 0.5f, frequency *= 1.99f)
            p = v_add(p, v_scale(slope(v_scale(p, frequency)), amplitude));
    }
    return by_height(parameters[DENSITY], 0.5f * noise_fbm(p, OCTAVES, 0.5f), point[1]);
}

float cloud_most(const float parameters[3], float low, float high)
{
    const float largest = 1.1f; /* no value of noise, nor a sum of it with these amplitudes, is larger */
    float reach = float_max(fabsf(1 - low), fabsf(1 - high));
    float d = float_min(reach * steepness * parameters[DENSITY] * largest, 1);
    return float_min(d + 2 * float_max(0, 0.5f - low), 1);
}
