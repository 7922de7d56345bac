/* dice: random numbers that a seed repeats. */
#ifndef LIGHTMILL_DICE_H
#define LIGHTMILL_DICE_H

#include <stdint.h>

typedef struct {
    uint64_t state;
} dice_t;

/* An independent stream for each purpose of a run. */
static inline dice_t dice_new(uint64_t seed, uint64_t purpose)
{
    return (dice_t){seed * 0x9e3779b97f4a7c15u + (purpose + 1) * 0xd1342543de82ef95u};
}

/* SplitMix64 (Steele, Lea, Flood 2014). */
static inline uint64_t dice_next(dice_t *dice)
{
    uint64_t z = dice->state += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}

/* A number below `limit`, which is not 0. */
static inline uint64_t dice_below(dice_t *dice, uint64_t limit)
{
    return dice_next(dice) % limit;
}

/* A number in [least, most). */
static inline double dice_between(dice_t *dice, double least, double most)
{
    return least + (most - least) * 0x1p-53 * (double)(dice_next(dice) >> 11);
}

#endif
