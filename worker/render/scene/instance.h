/* instance: an object of the blob placed in the world, where it stands still or moves (motion.h). */
#ifndef LIGHTMILL_INSTANCE_H
#define LIGHTMILL_INSTANCE_H

#include "common/scene/scene_blob.h"
#include "worker/render/scene/motion.h"

/* Embree ends the process at a ray with a coordinate of 1.844e18 or more, or NaN, where it was built with its
 * assertions, as Debian's is; also at one that only becomes so in the space of an instance. */
#define EMBREE_LARGEST 1.8e18f

/* The transforms of an instance at a time. */
typedef struct {
    xform_t world_from_object, object_from_world;
} placement_t;

typedef struct {
    motion_t motion;
    placement_t still; /* at time 0 */
} instance_t;

void instance_init(instance_t *instance, const blob_instance_t *record);
/* How far from the origin rays may go so that the instance does not take them where Embree does not go. */
float instance_reach(const instance_t *instance);

/* The transforms at a time: those of one that stands still where they are, else in *moved. */
static inline const placement_t *instance_at(const instance_t *instance, float time, placement_t *moved)
{
    if (!instance->motion.moves) return &instance->still;
    moved->world_from_object = motion_at(&instance->motion, time);
    if (!xform_invert(&moved->world_from_object, &moved->object_from_world))
        moved->object_from_world = instance->still.object_from_world;
    return moved;
}

#endif
