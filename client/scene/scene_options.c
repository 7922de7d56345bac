/* scene_options: see scene_options.h. */
#include "client/scene/scene_options.h"

static const char *const axes[] = {"y", "z", NULL};

static const option_t rows[] = {
    OPTION(import_wishes_t, lenient, "lenient", NULL,
           "take the nearest substitute for what a scene has and Lightmill has not, and warn"),
    OPTION(import_wishes_t, strict, "strict", NULL,
           "fail at slips in a scene that its own program forgives, instead of warning"),
    OPTION(import_wishes_t, environment, "environment", "WHAT",
           "light from all around: the FILE of a latitude-longitude image (.hdr, .exr), a radiance R,G,B, or "
           "sky[:SUN_ELEVATION], a clear sky with the sun so many degrees high (default: 40); it takes the "
           "place of the scene's own"),
    OPTION(import_wishes_t, environment_turn, "environment-rotation", "DEGREES",
           "turn it about the axis that points up, counter-clockwise seen from above; at 0 the centre of the "
           "image, and a sky's sun, lie in +x",
           OPTION_RANGE(-1e6, 1e6)),
    OPTION(import_wishes_t, environment_factor, "environment-strength", "FACTOR",
           "multiply its radiance (default: 1)", OPTION_RANGE(0, 1e20)),
    OPTION(import_wishes_t, environment_up, "environment-up", "AXIS",
           "the axis of the world that points up: y (the default, glTF's) or z", .choices = axes),
};
const option_group_t scene_options = OPTION_GROUP("What to make of the scene", rows);
