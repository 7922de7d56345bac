/* scene_options: what a command line asks of the scene that it names (client/import/scene/wishes.h). */
#ifndef LIGHTMILL_SCENE_OPTIONS_H
#define LIGHTMILL_SCENE_OPTIONS_H

#include "client/import/scene/wishes.h"
#include "common/options/options.h"

/* Of an import_wishes_t. */
extern const option_group_t scene_options;
/* For command_t.begin where the wishes are the first member of the values: asks for nothing. */
void scene_options_begin(void *values);

#endif
