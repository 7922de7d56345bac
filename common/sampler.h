/* sampler: random numbers as a pure function of (job seed, pixel, sample index, dimension).
 *
 * There is no stream whose state could depend on the order of work. A sampler_t is a cursor: it holds the key
 * of one sample and the next dimension, and is made anew wherever it is needed.
 *
 * `independent` numbers are a 64-bit mix of key and dimension. `sobol` takes, for each call, the first two
 * dimensions of the Sobol' sequence (a (0,2)-sequence in base 2), with the index shuffled and both
 * coordinates scrambled by hash-based nested uniform (Owen) scrambling under keys of that dimension alone
 * (Burley 2020, "Practical Hash-based Owen Scrambling", JCGT 9(4), sections 3 and 4.1; scrambling hash after
 * Laine and Karras 2011). Calls are thus well stratified each, and independent of one another. Past
 * SAMPLER_SOBOL_DIMENSIONS, where stratification no longer helps, numbers are independent.
 *
 * Even and odd sample indices are two sequences with keys of their own, so that the two halves of a film are
 * independent estimates (film.h).
 */
#ifndef LIGHTMILL_SAMPLER_H
#define LIGHTMILL_SAMPLER_H

#include "common/job.h"
#include "common/vec.h"

enum { SAMPLER_SOBOL_DIMENSIONS = 192 };

typedef struct {
    uint64_t sample_key;   /* of (seed, pixel, sample) */
    uint32_t sequence_key; /* of (seed, pixel, half) */
    uint32_t index;        /* of the sample in its half */
    uint32_t dimension;    /* of the next call */
    bool sobol;
} sampler_t;

/* A bijection of 64-bit words that mixes well (finaliser constants of Stafford 2011, variant 13). */
static inline uint64_t sampler_mix(uint64_t x)
{
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

/* Mixes words into a key, one by one. */
static inline uint64_t sampler_mix_words(uint64_t key, const uint32_t *words, int count)
{
    for (int i = 0; i < count; i++) key = sampler_mix(key + words[i] + 0x9E3779B97F4A7C15u);
    return key;
}

static inline sampler_t sampler_new(sampler_kind_t kind, uint64_t seed, uint32_t pixel, uint32_t sample)
{
    uint64_t sequence =
        sampler_mix(sampler_mix(seed + 0x9E3779B97F4A7C15u) + 2 * (uint64_t)pixel + (sample & 1));
    return (sampler_t){.sample_key = sampler_mix(sequence + sample),
                       .sequence_key = (uint32_t)(sequence >> 32),
                       .index = sample >> 1,
                       .sobol = kind == SAMPLER_SOBOL};
}

/* The numbers of one of up to 2^SAMPLER_SET_BITS members of a set, whose first ones are stratified among
 * themselves in each sample, and from sample to sample if `kind` is. A set has a number, as a pixel has. */
enum { SAMPLER_SET_BITS = 6 };
static inline sampler_t sampler_new_member(sampler_kind_t kind, uint64_t seed, uint32_t set, uint32_t sample,
                                           uint32_t member)
{
    /* What no pixel's seed is made from. Of a Sobol' sequence the index would run over after so many samples.
     */
    const int run = 32 - SAMPLER_SET_BITS;
    uint64_t sequence =
        sampler_mix(sampler_mix(seed + 0xD1B54A32D192ED03u) + 2 * (uint64_t)set + (sample & 1));
    bool runs_on = kind == SAMPLER_SOBOL;
    uint64_t part = sampler_mix(sequence + (runs_on ? sample >> 1 >> run : sample));
    uint32_t before = runs_on ? sample >> 1 << SAMPLER_SET_BITS : 0;
    return (sampler_t){.sample_key = sampler_mix(sampler_mix(sequence + sample) + member),
                       .sequence_key = (uint32_t)(part >> 32),
                       .index = before + member,
                       .sobol = true};
}

/* Uniform in [0, 1) from the 24 high bits. */
static inline float sampler_float(uint32_t bits)
{
    return (float)(bits >> 8) * 0x1p-24f;
}

static inline uint32_t sampler_reverse_bits(uint32_t x)
{
    x = __builtin_bswap32(x);
    x = (x & 0x0F0F0F0Fu) << 4 | (x & 0xF0F0F0F0u) >> 4;
    x = (x & 0x33333333u) << 2 | (x & 0xCCCCCCCCu) >> 2;
    return (x & 0x55555555u) << 1 | (x & 0xAAAAAAAAu) >> 1;
}

/* Owen scrambling of a bit-reversed word: each bit is flipped by a hash of the bits below it. */
static inline uint32_t sampler_scramble_reversed(uint32_t x, uint32_t seed)
{
    x ^= x * 0x3D20ADEAu;
    x += seed;
    x *= (seed >> 16) | 1;
    x ^= x * 0x05526C56u;
    return x ^ x * 0x53A22864u;
}

/* The second Sobol' coordinate of an index, bit-reversed: the Pascal matrix modulo 2 applied to the index
 * bits (its Kronecker structure makes it five shifted additions). */
static inline uint32_t sampler_sobol1_reversed(uint32_t index)
{
    index ^= index >> 1 & 0x55555555u;
    index ^= index >> 2 & 0x33333333u;
    index ^= index >> 4 & 0x0F0F0F0Fu;
    index ^= index >> 8 & 0x00FF00FFu;
    return index ^ index >> 16;
}

/* The next two numbers, uniform in [0, 1)^2. */
static inline vec2_t sampler_2d(sampler_t *sampler)
{
    uint32_t dimension = sampler->dimension++;
    if (!sampler->sobol || dimension >= SAMPLER_SOBOL_DIMENSIONS) {
        uint64_t bits = sampler_mix(sampler->sample_key + 0x9E3779B97F4A7C15u * (dimension + 1));
        return (vec2_t){sampler_float((uint32_t)bits), sampler_float((uint32_t)(bits >> 32))};
    }
    uint64_t keys = sampler_mix((uint64_t)sampler->sequence_key << 32 | dimension);
    uint32_t shuffle_key = (uint32_t)keys, x_key = (uint32_t)(keys >> 32);
    uint32_t y_key = (shuffle_key ^ 0x6C8E9CF5u) * 0x9E3779B1u ^ x_key >> 11;
    uint32_t index =
        sampler_reverse_bits(sampler_scramble_reversed(sampler_reverse_bits(sampler->index), shuffle_key));
    uint32_t x = sampler_reverse_bits(sampler_scramble_reversed(index, x_key));
    uint32_t y = sampler_reverse_bits(sampler_scramble_reversed(sampler_sobol1_reversed(index), y_key));
    return (vec2_t){sampler_float(x), sampler_float(y)};
}

/* The next number, uniform in [0, 1). */
static inline float sampler_1d(sampler_t *sampler)
{
    return sampler_2d(sampler).x;
}

#endif
