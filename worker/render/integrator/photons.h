/* photons: what vcm merges eye vertices with: the vertices of light subpaths that belong to no pixel.
 *
 * A set of photons belongs to a sample index: all pixels merge their sample i with set i. It is a pure
 * function of the scene, the settings and i, so every worker makes the same, and it does not matter which one
 * renders which tile. The price is that each worker makes every set that it needs. Threads make a set
 * together; a few sets are kept, for units take them in turn (job_run_end).
 *
 * The distance within which photons are merged shrinks from set to set, so that what merging blurs vanishes
 * as the image converges: r_i = r_1 (i + 1)^((alpha - 1) / 2) with alpha = 3/4 (Knaus and Zwicker 2011,
 * "Progressive Photon Mapping: A Probabilistic Approach", equation 20, and section 4.1 of the paper on VCM).
 */
#ifndef LIGHTMILL_PHOTONS_H
#define LIGHTMILL_PHOTONS_H

#include "worker/render/integrator/photon_grid.h"
#include "worker/render/integrator/subpath.h"

#include <stdatomic.h>

/* A vertex of a light subpath, as the surface there receives its light. */
typedef struct {
    vec3_t wo;        /* unit direction to the vertex before it */
    rgb_t throughput; /* as that of a vertex_t */
    float direct, inner;
    uint32_t light;                /* where it comes from */
    int32_t depth, length, within; /* as of a vertex_t */
} photon_t;

typedef struct photon_set {
    uint32_t index;     /* of the samples that merge with it */
    float radius;       /* r_i */
    float area;         /* M pi r_i^2: what one photon near a vertex stands for is over this */
    float eta;          /* as weights count it (subpath.h) */
    float time;         /* at which all of it happens, and the paths that it is merged with */
    photon_grid_t grid; /* of the points, */
    vec3_t *points;     /* which are in its order, */
    photon_t *photons;  /* and so are these */
} photon_set_t;

/* The sets of a job. */
typedef struct photons photons_t;

/* Nothing is traced yet. `setup` must outlive it. */
photons_t *photons_new(const setup_t *setup);
/* Frees all and sets *photons to NULL; nobody holds a set. */
void photons_destroy(photons_t **photons);
/* Bytes that the sets of a job may take at most, if its threads are at the same samples. */
uint64_t photons_memory(const job_settings_t *settings);

/* The set of a sample index, which it makes, or helps to make, if need be. NULL when *cancel became true
 * before it was complete. Thread-safe. */
const photon_set_t *photons_hold(photons_t *photons, uint32_t index, const atomic_bool *cancel);
/* Gives it back. */
void photons_release(photons_t *photons, const photon_set_t *set);

#endif
