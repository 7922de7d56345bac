/* settings: what a command line says about how a scene is rendered. */
#ifndef LIGHTMILL_SETTINGS_H
#define LIGHTMILL_SETTINGS_H

#include "common/options/options.h"
#include "common/scene/scene_blob.h"

/* The relative error that --error asks for: between 0 and 1, "0.01" or "1%". */
result_t option_error(const option_t *option, const char *text, void *field);
/* A job's number. */
result_t job_number_parse(const char *text, uint64_t *job);

/* What the command line says about the settings; the rest comes from the scene. */
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
    bool lenient; /* for scene_load */
} overrides_t;

extern const option_group_t settings_options;

overrides_t overrides_none(void);
/* The scene's own settings with the overrides applied, checked. Time or error without spp: these alone
 * end the job. */
result_t overrides_apply(const overrides_t *overrides, const scene_blob_t *blob, job_settings_t *settings);

#endif
