/* settings: what a command line says about how a scene is rendered (common/scene/overrides.h). */
#ifndef LIGHTMILL_SETTINGS_H
#define LIGHTMILL_SETTINGS_H

#include "common/options/options.h"
#include "common/scene/overrides.h"

/* The relative error that --error asks for: between 0 and 1, "0.01" or "1%". */
result_t option_error(const option_t *option, const char *text, void *field);
/* A job's number. */
result_t job_number_parse(const char *text, uint64_t *job);

extern const option_group_t settings_options;

/* Tells on the log what another aspect of --resolution does to the picture: which part of what the scene's
 * camera frames is cut off or added, or how far it is stretched. */
void settings_tell_cut(const overrides_t *overrides, const scene_blob_t *blob);

#endif
