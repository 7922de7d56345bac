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
    OPTION(import_wishes_t, camera, "camera", "NAME|NUMBER",
           "of a file with several cameras that one: by the name of its node, its own, or its number from 1 "
           "(default: the first, and of a Mitsuba file the last)"),
    OPTION(
        import_wishes_t, variant, "variant", "NAME|NUMBER",
        "of a glTF file with several variants of its materials that one: by its name, or its number from 1 "
        "(default: the materials as they stand)"),
    OPTION(import_wishes_t, time_point, "time-point", "SECONDS",
           "the moment of a file's animations that is rendered (default: none, everything stands as the file "
           "says without them)",
           OPTION_RANGE(-1e9, 1e9)),
    OPTION(import_wishes_t, frame, "frame", "NUMBER", "the same as the number of a frame, counted from 0",
           OPTION_RANGE(-1e9, 1e9)),
    OPTION(import_wishes_t, frames_per_second, "frames-per-second", "RATE",
           "frames that make a second, for --frame (default: 24)", OPTION_RANGE(1e-3, 1e6)),
    OPTION(import_wishes_t, animation, "animation", "NAME|NUMBER",
           "of several animations that one alone: by its name, or its number from 1 (default: all but those "
           "that move what one before them moves)"),
    OPTION(import_wishes_t, shutter, "shutter", "SECONDS|OPEN,CLOSE",
           "blur what moves while the shutter is open: so long about the moment, or from OPEN to CLOSE, in "
           "seconds after it"),
    OPTION(import_wishes_t, fov, "fov", "DEGREES",
           "field of view of a perspective camera, along the shorter side of the picture",
           OPTION_RANGE(1e-3, 179.9)),
    OPTION(import_wishes_t, lens_radius, "lens-radius", "LENGTH",
           "radius of the lens of a perspective or orthographic camera, in units of the scene (0: all is "
           "sharp); half the focal length over the f-number",
           OPTION_RANGE(0, 1e18)),
    OPTION(import_wishes_t, focus, "focus", "DISTANCE|OBJECT",
           "what that lens shows sharp: the plane so far away, or that through the middle of an object"),
    OPTION(import_wishes_t, definitions, "define", "NAME=VALUE",
           "what $NAME stands for in a Mitsuba scene, whatever its <default> says; once for each parameter",
           .letter = 'D'),
};
const option_group_t scene_options = OPTION_GROUP("What to make of the scene", rows);

void scene_options_begin(void *values)
{
    *(import_wishes_t *)values = import_wishes_none();
}
