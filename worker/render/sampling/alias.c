/* alias: see alias.h. */
#include "worker/render/sampling/alias.h"

#include "common/base.h"
#include "common/vec.h"

#include <math.h>
#include <stdlib.h>

void alias_init(alias_t *alias, const double *weights, uint32_t count)
{
    *alias = (alias_t){0};
    uint32_t heaviest = 0;
    for (uint32_t i = 0; i < count; i++) {
        alias->total += weights[i];
        if (weights[i] > weights[heaviest]) heaviest = i;
    }
    if (!(alias->total > 0)) return;
    alias->count = count;
    alias->bins = mem_alloc(count * sizeof *alias->bins);
    double *share = mem_alloc(count * sizeof *share);
    uint32_t *small = mem_alloc(count * sizeof *small), *large = mem_alloc(count * sizeof *large);
    uint32_t smalls = 0, larges = 0;
    for (uint32_t i = 0; i < count; i++) {
        share[i] = weights[i] / alias->total * count;
        if (share[i] < 1)
            small[smalls++] = i;
        else
            large[larges++] = i;
    }
    while (smalls > 0 && larges > 0) {
        uint32_t s = small[--smalls], l = large[larges - 1];
        alias->bins[s] = (alias_bin_t){(float)share[s], l};
        share[l] -= 1 - share[s];
        if (share[l] < 1) {
            larges--;
            small[smalls++] = l;
        }
    }
    while (larges > 0) larges--, alias->bins[large[larges]] = (alias_bin_t){1, large[larges]};
    /* Left over by rounding alone: their share is 1 but for that, or 0, and what has no weight must never be
     * chosen. */
    while (smalls > 0) {
        uint32_t s = small[--smalls];
        alias->bins[s] = (alias_bin_t){share[s] > 0 ? 1 : 0, heaviest};
    }
    free(share);
    free(small);
    free(large);
}

void alias_free(alias_t *alias)
{
    free(alias->bins);
    *alias = (alias_t){0};
}

uint32_t alias_sample(const alias_t *alias, float *u)
{
    float scaled = *u * (float)alias->count;
    uint32_t bin = (uint32_t)scaled;
    if (bin >= alias->count) bin = alias->count - 1;
    float rest = float_min(scaled - (float)bin, 0x1.fffffep-1f);
    float keep = alias->bins[bin].keep;
    if (rest < keep) {
        *u = float_min(rest / keep, 0x1.fffffep-1f);
        return bin;
    }
    *u = float_min((rest - keep) / (1 - keep), 0x1.fffffep-1f);
    return alias->bins[bin].other;
}
