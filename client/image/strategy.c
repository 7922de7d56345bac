/* strategy: see strategy.h. */
#include "client/image/strategy.h"

#include "common/job.h"

size_t strategies_list(int segments, strategy_t list[STRATEGIES_MAX])
{
    size_t count = 0;
    for (int k = 1; k <= int_min(segments, STRATEGIES_MAX_SEGMENTS); k++)
        for (int s = 0; s <= k; s++)
            if (job_strategy_exists(s, k + 1 - s)) list[count++] = (strategy_t){s, k + 1 - s};
    return count;
}

char *strategy_layer(strategy_t strategy, bool weighted)
{
    return mem_printf("%s.s%d_t%d", weighted ? "weighted" : "unweighted", strategy.s, strategy.t);
}
