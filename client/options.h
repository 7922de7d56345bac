/* options: what several commands take on their command line: numbers with ranges, render settings, outputs.
 */
#ifndef LIGHTMILL_OPTIONS_H
#define LIGHTMILL_OPTIONS_H

#include "common/scene/scene_blob.h"

#include <getopt.h>

/* Numbers of an option; RESULT_USAGE names the option, the range and the text. */
result_t option_integer(const char *option, const char *text, long long least, long long most,
                        long long *value);
result_t option_real(const char *option, const char *text, double least, double most, double *value);
/* A share from 0 to 1: "0.01" or "1%". */
result_t option_share(const char *option, const char *text, double *value);
/* The relative error that --error asks for: between 0 and 1, "0.01" or "1%". */
result_t option_error(const char *text, double *value);
/* A job's number. */
result_t option_job(const char *text, uint64_t *job);

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
    int32_t tile_size;
    bool no_layers;
    bool lenient; /* for scene_load */
} overrides_t;

/* Entries for a getopt_long table; values are told apart by name, so all have flag NULL and val 0. */
#define SETTINGS_OPTIONS                                                                                     \
    {"spp", required_argument, NULL, 0}, {"time", required_argument, NULL, 0},                               \
        {"integrator", required_argument, NULL, 0}, {"max-depth", required_argument, NULL, 0},               \
        {"seed", required_argument, NULL, 0}, {"resolution", required_argument, NULL, 0},                    \
        {"sampler", required_argument, NULL, 0}, {"lenient", no_argument, NULL, 0},                          \
        {"no-layers", no_argument, NULL, 0}, {"error", required_argument, NULL, 0},                          \
        {"adaptive", no_argument, NULL, 0},                                                                  \
    {                                                                                                        \
        "tile-size", required_argument, NULL, 0                                                              \
    }
extern const char settings_usage[];

overrides_t overrides_none(void);
/* Takes an option of SETTINGS_OPTIONS; *taken is false when it is another one. */
result_t overrides_option(overrides_t *overrides, const char *option, const char *value, bool *taken);
/* The scene's own settings with the overrides applied, checked. Time or error without spp: these alone
 * end the job. */
result_t overrides_apply(const overrides_t *overrides, const scene_blob_t *blob, job_settings_t *settings);

#endif
