/* strategies: bdpt taken apart: an image of each of its strategies, as it is weighted in the picture and
 * without its weight (Veach 1997, figures 10.2 and 10.3).
 *
 * The strategy (s, t) joins s light and t eye vertices to paths of s + t - 1 segments. Each image is an
 * ordinary job that is restricted to one strategy (job_settings_t), so whatever holds of renders holds here:
 * the same samples, the same bits. The weighted images add up to the picture; unweighted ones of as many
 * segments are estimates of the same light, wherever the strategies can find it at all.
 */
#ifndef LIGHTMILL_STRATEGIES_H
#define LIGHTMILL_STRATEGIES_H

#include "client/farm/remote.h"
#include "client/image/output.h"
#include "client/image/strategy.h"
#include "client/scene/loaded_scene.h"
#include "client/scene/settings.h"

/* What all the jobs have in common: the scene's settings with the overrides applied, for bdpt. RESULT_USAGE
 * when another integrator or a time limit is asked for (images with different samples do not add up), or when
 * paths are so long that there would be too many strategies; RESULT_LIMIT when the images are too large. */
result_t strategies_settings(const overrides_t *overrides, const scene_blob_t *blob,
                             job_settings_t *settings);

typedef struct {
    remote_t *remote;            /* of the farm that renders */
    const loaded_scene_t *scene; /* its blob is uploaded */
    job_settings_t settings;     /* of strategies_settings */
    job_terms_t terms;           /* of every job, but for its name */
    const output_t *output;      /* `path` an EXR, `png` the contact sheet beside it; or `path` a PNG alone */
    bool quiet;
    bool patient; /* waits on when the master does not answer */
    /* Asked a few times a second: fails when the render is to end, with the reason. NULL: only Ctrl-C ends
     * it.
     */
    result_t (*check)(void *context);
    void *check_context;
} strategies_t;

/* Renders all strategies and writes the EXR (layers of strategy_layer; R, G, B the sum of the weighted ones;
 * attributes as in picture.h, with the counts of all jobs together) and the contact sheet. When anything
 * fails, or `check` does, the jobs are cancelled and nothing is written. */
result_t strategies_render(const strategies_t *strategies);

#endif
