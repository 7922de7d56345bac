/* bodies: what scatters light below the surfaces of shapes (blob_material_t.body), once all is known. */
#ifndef LIGHTMILL_BODIES_H
#define LIGHTMILL_BODIES_H

#include "client/import/scene/scene_builder.h"

/* Gives every shape its media: inside those whose material has a body is that. Warns of bodies whose surface
 * is open, or turned inside out: there what scatters fills all space that lies behind it. `at` is for
 * messages. */
void scene_settle_media(scene_builder_t *scene, position_t at);

#endif
