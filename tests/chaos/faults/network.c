/* network: faults of lines: cables that are cut or thin, and connections through the proxy. */
#include "tests/chaos/faults/faults_state.h"

#include <stdlib.h>

/* ---- cables ----------------------------------------------------------------------------------------- */

static bool pick_free(const bool *busy, size_t count, fault_t *fault)
{
    for (size_t i = 0; i < count; i++) {
        fault->index = (fault->pick + i) % count;
        if (!busy[fault->index]) return true;
    }
    return false;
}

static bool pick_site(faults_t *faults, fault_t *fault)
{
    if (!pick_free(faults->site_busy, faults->setup.sites, fault)) return false;
    faults->site_busy[fault->index] = true;
    return true;
}

static void note_network(faults_t *faults, result_t result)
{
    if (result.code != RESULT_OK) report_violation(faults->setup.report, "the network: %s", result.message);
}

static bool cut_site(faults_t *faults, fault_t *fault)
{
    static const char *const ways[] = {"to", "from", "to and from"};
    if (!pick_site(faults, fault)) return false;
    int way = fault->chance[0] < 0.5    ? NETWORK_BOTH
              : fault->chance[0] < 0.75 ? NETWORK_INWARD
                                        : NETWORK_OUTWARD;
    fault_victim(fault, "%s site %zu", ways[way - 1], fault->index);
    note_network(faults, network_cut(faults->setup.network, fault->index, (network_way_t)way));
    return true;
}

static bool thin_site(faults_t *faults, fault_t *fault)
{
    if (!pick_site(faults, fault)) return false;
    unsigned rate = (unsigned)fault_scales(fault->chance[0], 10e3, 300e3);
    fault_victim(fault, "site %zu, %u bytes/s", fault->index, rate);
    note_network(faults, network_thin(faults->setup.network, fault->index, rate));
    return true;
}

static void heal_site(faults_t *faults, fault_t *fault)
{
    faults->site_busy[fault->index] = false;
    note_network(faults, network_heal(faults->setup.network, fault->index));
}

static bool has_sites(const faults_t *faults)
{
    return faults->setup.network != NULL;
}

/* ---- the proxy ---------------------------------------------------------------------------------------- */

static proxy_link_t *link_of(faults_t *faults, const fault_t *fault)
{
    return proxy_link(faults->setup.proxy, fault->index);
}

static bool pick_link(faults_t *faults, fault_t *fault)
{
    if (!pick_free(faults->link_busy, faults->setup.links, fault)) return false;
    faults->link_busy[fault->index] = true;
    fault_victim(fault, "link %zu", fault->index);
    return true;
}

static void heal_link(faults_t *faults, fault_t *fault)
{
    faults->link_busy[fault->index] = false;
    proxy_heal(link_of(faults, fault));
}

static bool delay_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    unsigned delay = (unsigned)fault_scales(fault->chance[0], 10, 700);
    unsigned jitter = (unsigned)fault_scales(fault->chance[1], 10, 300);
    fault_victim(fault, "link %zu, %u to %u ms", fault->index, delay, delay + jitter);
    atomic_store(&link_of(faults, fault)->delay_ms, delay);
    atomic_store(&link_of(faults, fault)->jitter_ms, jitter);
    return true;
}

static bool thin_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    unsigned rate = (unsigned)fault_scales(fault->chance[0], 10e3, 300e3);
    fault_victim(fault, "link %zu, %u bytes/s", fault->index, rate);
    atomic_store(&link_of(faults, fault)->bytes_per_second, rate);
    return true;
}

static bool stall_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    atomic_store(&link_of(faults, fault)->stalled, true);
    return true;
}

static bool reset_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    atomic_fetch_add(&link_of(faults, fault)->cuts, 1);
    return true;
}

static bool refuse_link(faults_t *faults, fault_t *fault)
{
    if (!reset_link(faults, fault)) return false;
    atomic_store(&link_of(faults, fault)->refusing, true);
    return true;
}

static bool mistreat_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    proxy_link_t *link = link_of(faults, fault);
    unsigned times = 1 + (unsigned)(5.99 * fault->chance[0]);
    fault->done = atomic_load(&link->done[fault->kind->mischief]);
    fault_victim(fault, "link %zu, up to %u times", fault->index, times);
    atomic_store(&link->todo[fault->kind->mischief], times);
    return true;
}

static void end_mischief(faults_t *faults, fault_t *fault)
{
    fault->hits = atomic_load(&link_of(faults, fault)->done[fault->kind->mischief]) - fault->done;
    fault->spoilt = fault->hits == 0;
    heal_link(faults, fault);
}

/* ---- the kinds ---------------------------------------------------------------------------------------- */

#define MISCHIEF(name, what)                                                                                 \
    {                                                                                                        \
        name, 1, 2, 4, mistreat_link, end_mischief, NULL, what                                               \
    }

/* Cuts and stalls are shorter or longer than the lease of a worker, 1.5 s. */
static const fault_kind_t KINDS[] = {
    {"partition, short", 2, 0.2, 1.2, cut_site, heal_site, has_sites, 0},
    {"partition, long", 2, 2, 6, cut_site, heal_site, has_sites, 0},
    {"thin cable", 2, 2, 6, thin_site, heal_site, has_sites, 0},
    {"delay", 1, 2, 6, delay_link, heal_link, NULL, 0},
    {"thin link", 1, 2, 6, thin_link, heal_link, NULL, 0},
    {"stall, short", 1, 0.2, 1.2, stall_link, heal_link, NULL, 0},
    {"stall, long", 1, 2, 6, stall_link, heal_link, NULL, 0},
    {"reset connections", 3, 0.1, 0.1, reset_link, heal_link, NULL, 0},
    {"refuse connections", 1, 1, 3, refuse_link, heal_link, NULL, 0},
    MISCHIEF("corrupt bytes", PROXY_FLIP_BYTES),
    MISCHIEF("repeat bytes", PROXY_REPEAT_BYTES),
    MISCHIEF("reorder bytes", PROXY_SWAP_BYTES),
    MISCHIEF("lose bytes", PROXY_LOSE_BYTES),
    MISCHIEF("corrupt message", PROXY_FLIP_MESSAGE),
    MISCHIEF("repeat message", PROXY_REPEAT_MESSAGE),
    MISCHIEF("reorder messages", PROXY_SWAP_MESSAGES),
    MISCHIEF("lose message", PROXY_LOSE_MESSAGE),
};

const fault_family_t NETWORK_FAULTS = {KINDS, ARRAY_LENGTH(KINDS)};
