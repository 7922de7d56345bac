/* strategy: the strategies of bdpt by name. The strategy (s, t) joins s light and t eye vertices to paths of
 * s + t - 1 segments (Veach 1997). */
#ifndef LIGHTMILL_STRATEGY_H
#define LIGHTMILL_STRATEGY_H

#include <stdbool.h>
#include <stddef.h>

enum {
    STRATEGIES_MAX_SEGMENTS = 12,
    STRATEGIES_MAX = 89 /* of bdpt with so many segments */
};

typedef struct {
    int s, t;
} strategy_t;

/* All strategies of paths of 1 to `segments` segments, at most STRATEGIES_MAX_SEGMENTS, by segments and then
 * by s; returns how many. */
size_t strategies_list(int segments, strategy_t list[STRATEGIES_MAX]);
/* "weighted.s1_t2" or "unweighted.s1_t2" in fresh memory: the layer of the EXR. */
char *strategy_layer(strategy_t strategy, bool weighted);

#endif
