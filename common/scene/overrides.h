/* overrides: what somebody who submits a job says about its settings, on a command line or by the HTTP API;
 * the rest comes from the scene. */
#ifndef LIGHTMILL_OVERRIDES_H
#define LIGHTMILL_OVERRIDES_H

#include "common/scene/scene_blob.h"

typedef struct {
    integrator_t integrator; /* 0: from the scene, and so on */
    sampler_kind_t sampler;
    bool has_seed;
    uint64_t seed;
    int32_t width, height;
    int32_t max_depth; /* -1: from the scene */
    uint32_t spp;
    double time_limit, error;
    bool adaptive;
    save_at_t save_at;
    int32_t tile_size;
    int32_t film_scale; /* -1: as the scene needs it */
    bool no_layers;
    bool cryptomatte;
    bool no_learn;
    double merge_radius; /* 0: as the scene's size says */
    bool spectral;
    const char *light_groups; /* as light_groups_resolve takes them; NULL: none */
} overrides_t;

/* Nothing is said. */
overrides_t overrides_none(void);
/* The scene's own settings with the overrides applied, checked. Time or error without spp: these alone
 * end the job. */
result_t overrides_apply(const overrides_t *overrides, const scene_blob_t *blob, job_settings_t *settings);

#endif
