/* noise: see noise.h. */
#include "worker/render/texture/noise.h"

#include <math.h>
#include <stdint.h>

/* Perlin's permutation of 0 to 255 (Perlin 2002, reference implementation). */
static const uint8_t permutation[256] = {
    151, 160, 137, 91,  90,  15,  131, 13,  201, 95,  96,  53,  194, 233, 7,   225, 140, 36,  103, 30,
    69,  142, 8,   99,  37,  240, 21,  10,  23,  190, 6,   148, 247, 120, 234, 75,  0,   26,  197, 62,
    94,  252, 219, 203, 117, 35,  11,  32,  57,  177, 33,  88,  237, 149, 56,  87,  174, 20,  125, 136,
    171, 168, 68,  175, 74,  165, 71,  134, 139, 48,  27,  166, 77,  146, 158, 231, 83,  111, 229, 122,
    60,  211, 133, 230, 220, 105, 92,  41,  55,  46,  245, 40,  244, 102, 143, 54,  65,  25,  63,  161,
    1,   216, 80,  73,  209, 76,  132, 187, 208, 89,  18,  169, 200, 196, 135, 130, 116, 188, 159, 86,
    164, 100, 109, 198, 173, 186, 3,   64,  52,  217, 226, 250, 124, 123, 5,   202, 38,  147, 118, 126,
    255, 82,  85,  212, 207, 206, 59,  227, 47,  16,  58,  17,  182, 189, 28,  42,  223, 183, 170, 213,
    119, 248, 152, 2,   44,  154, 163, 70,  221, 153, 101, 155, 167, 43,  172, 9,   129, 22,  39,  253,
    19,  98,  108, 110, 79,  113, 224, 232, 178, 185, 112, 104, 218, 246, 97,  228, 251, 34,  242, 193,
    238, 210, 144, 12,  191, 179, 162, 241, 81,  51,  145, 235, 249, 14,  239, 107, 49,  192, 214, 31,
    181, 199, 106, 157, 184, 84,  204, 176, 115, 121, 50,  45,  127, 4,   150, 254, 138, 236, 205, 93,
    222, 114, 67,  29,  24,  72,  243, 141, 128, 195, 78,  66,  215, 61,  156, 180};

/* The twelve edges of a cube; the last four are repetitions, chosen as pbrt-v3 does. */
static const int8_t gradients[16][3] = {
    {1, 1, 0}, {-1, 1, 0}, {1, -1, 0}, {-1, -1, 0}, {1, 0, 1}, {-1, 0, 1}, {1, 0, -1}, {-1, 0, -1},
    {0, 1, 1}, {0, -1, 1}, {0, 1, -1}, {0, -1, -1}, {1, 1, 0}, {-1, 1, 0}, {0, 1, -1}, {0, -1, -1}};

/* One axis: the two lattice planes about a coordinate, the offset from the first and the second's weight. */
typedef struct {
    uint32_t plane[2];
    float offset[2];
    float weight;
} lattice_t;

static lattice_t lattice(float x)
{
    float below = floorf(x), t = x - below;
    /* From 2^31 on floats are multiples of 256, the period; NaN takes this way too. */
    uint32_t first = fabsf(below) < 0x1p31f ? (uint32_t)(int32_t)below & 255 : 0;
    return (lattice_t){{first, (first + 1) & 255}, {t, t - 1}, t * t * t * (t * (6 * t - 15) + 10)};
}

static float mix(float a, float b, float weight)
{
    return (1 - weight) * a + weight * b;
}

float noise(vec3_t p)
{
    lattice_t x = lattice(p.x), y = lattice(p.y), z = lattice(p.z);
    float planes[2], rows[2], corners[2];
    for (int k = 0; k < 2; k++) {
        for (int j = 0; j < 2; j++) {
            for (int i = 0; i < 2; i++) {
                uint32_t row = permutation[(permutation[x.plane[i]] + y.plane[j]) & 255];
                const int8_t *g = gradients[permutation[(row + z.plane[k]) & 255] & 15];
                corners[i] =
                    (float)g[0] * x.offset[i] + (float)g[1] * y.offset[j] + (float)g[2] * z.offset[k];
            }
            rows[j] = mix(corners[0], corners[1], x.weight);
        }
        planes[k] = mix(rows[0], rows[1], y.weight);
    }
    return mix(planes[0], planes[1], z.weight);
}

static const float lacunarity = 1.99f; /* not 2, so that the lattices of the octaves do not coincide */

float noise_fbm(vec3_t p, int octaves, float roughness)
{
    float sum = 0, frequency = 1, amplitude = 1;
    for (int i = 0; i < octaves; i++, frequency *= lacunarity, amplitude *= roughness)
        sum += amplitude * noise(v_scale(p, frequency));
    return sum;
}

float noise_turbulence(vec3_t p, int octaves, float roughness)
{
    float sum = 0, frequency = 1, amplitude = 1;
    for (int i = 0; i < octaves; i++, frequency *= lacunarity, amplitude *= roughness)
        sum += amplitude * fabsf(noise(v_scale(p, frequency)));
    return sum + 0.2f * amplitude;
}
