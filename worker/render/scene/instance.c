/* instance: see instance.h. */
#include "worker/render/scene/instance.h"

void instance_init(instance_t *instance, const blob_instance_t *record)
{
    instance->motion = motion_between(&record->world_from_object, &record->world_from_object_end);
    instance->still.world_from_object = record->world_from_object;
    xform_invert(&record->world_from_object, &instance->still.object_from_world);
}

/* A bound on the sum of any row of object_from_world, at any time: the stretch is triangular, so its inverse
 * is bounded by its least diagonal element and its largest other one. */
static double most_magnification(const instance_t *instance)
{
    static const int diagonal[] = {0, 3, 5}, others[] = {1, 2, 4};
    const xform_t *inverse = &instance->still.object_from_world;
    double least = INFINITY, skew = 0, sum = 0;
    for (int i = 0; i < 3; i++)
        sum = fmax(sum, (double)v_length(vec3(inverse->m[i][0], inverse->m[i][1], inverse->m[i][2])));
    if (!instance->motion.moves) return 2 * sum;
    const motion_key_t *keys = instance->motion.keys;
    for (int i = 0; i < 3; i++) {
        double a = (double)keys[0].stretch[diagonal[i]], b = (double)keys[1].stretch[diagonal[i]];
        least = fmin(least, (a > 0) == (b > 0) ? fmin(fabs(a), fabs(b)) : 0); /* else singular in between */
        skew = fmax(skew,
                    fmax(fabs((double)keys[0].stretch[others[i]]), fabs((double)keys[1].stretch[others[i]])));
    }
    return fmax(2 * sum, 6 / least * (1 + skew / least) * (1 + skew / least));
}

float instance_reach(const instance_t *instance)
{
    const xform_t *still = &instance->motion.still;
    double farthest =
        fmax(fabs((double)still->m[0][3]), fmax(fabs((double)still->m[1][3]), fabs((double)still->m[2][3])));
    for (int i = 0; i < 2 && instance->motion.moves; i++) {
        vec3_t t = instance->motion.keys[i].translation;
        farthest = fmax(farthest, fmax(fabs((double)t.x), fmax(fabs((double)t.y), fabs((double)t.z))));
    }
    double reach = (double)EMBREE_LARGEST / (4 * fmax(most_magnification(instance), 1)) - farthest;
    return reach > 0 ? (float)reach : 0; /* also of a NaN */
}
