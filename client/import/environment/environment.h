/* environment: light from all around for a scene whose file has none: an image, a colour, or a clear sky.
 *
 * It becomes lights of kind LIGHT_INFINITE, which the renderer samples by their brightness. It takes the
 * place of those that the scene has itself; lamps and surfaces that emit stay.
 */
#ifndef LIGHTMILL_ENVIRONMENT_H
#define LIGHTMILL_ENVIRONMENT_H

#include "client/import/scene/scene_builder.h"

typedef enum { ENVIRONMENT_NONE, ENVIRONMENT_IMAGE, ENVIRONMENT_COLOUR, ENVIRONMENT_SKY } environment_kind_t;

/* What import_wishes_t.environment says. */
typedef struct {
    environment_kind_t kind;
    const char *path; /* of an image: latitude-longitude, of any format of texture_image.h */
    double colour[3]; /* radiance */
    double elevation; /* of a sky's sun, degrees */
} environment_t;

/* Reads "R,G,B", "sky", "sky:DEGREES" or the path of an image; NULL is ENVIRONMENT_NONE. RESULT_USAGE when a
 * number is out of range; RESULT_INPUT when there is no such file. The path stays the caller's. */
result_t environment_parse(const char *text, environment_t *environment);

/* Adds it to a scene that its reader has finished, with the turn, factor and axis of the wishes. The centre
 * of an image lies in +x, and its right half towards +z where y is up (-y where z is up), as in Cycles and
 * three.js; a sky's sun stands over +x. RESULT_INPUT when the image cannot be read. */
result_t environment_add(scene_builder_t *scene, const environment_t *environment,
                         const import_wishes_t *wishes);

#endif
