/* interval: where a number lies among ascending ones. */
#ifndef LIGHTMILL_INTERVAL_H
#define LIGHTMILL_INTERVAL_H

#include <stdint.h>

/* Which of `count` >= 1 intervals x lies in, between count + 1 ascending edges; beyond them, the first or the
 * last. */
static inline uint32_t interval_find(const float *edges, uint32_t count, float x)
{
    uint32_t low = 0, high = count;
    while (high - low > 1) {
        uint32_t middle = (low + high) / 2;
        if (edges[middle] <= x)
            low = middle;
        else
            high = middle;
    }
    return low;
}

#endif
