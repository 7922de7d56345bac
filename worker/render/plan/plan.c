/* plan: see plan.h.
 *
 * DESIGN. Of what the lessons say of each start (light_guide.h) follows how many light subpaths a sample is
 * to have: from 1 down to LEAST_SHARE. Never less: what only light subpaths find would not be missed by any
 * number that is known here.
 *
 * After the first passes what is learned is known well enough, and only some of the pixels go on to teach.
 */
#include "worker/render/plan/plan.h"

#include "worker/render/integrator/lessons.h"
#include "worker/render/integrator/light_pool.h"

#include <math.h>
#include <stdlib.h>

struct plan {
    setup_t setup;
    lights_t *lights;
    caustics_t *caustics;
};

static const double LEAST_SHARE = 1.0 / 8;
/* What a sample costs beside its rays, in rays. */
static const double SAMPLE_COST = 2;
/* Of samples that no plan tells about. */
static const float FIRST_NOISE = 0.32f;
/* Samples of a pass that teach: about so many a pixel, in the mean. */
enum { TAUGHT_SAMPLES = 8 };

/* ---- how bright the picture is ------------------------------------------------------------------------- */

enum { PARTS = BRIGHTNESS_SIDE * BRIGHTNESS_SIDE };

/* A part of the film. */
static uint32_t part_of(const job_settings_t *settings, uint32_t x, uint32_t y)
{
    return y * BRIGHTNESS_SIDE / (uint32_t)settings->height * BRIGHTNESS_SIDE +
           x * BRIGHTNESS_SIDE / (uint32_t)settings->width;
}

/* Something bright that was seen in a part. */
typedef struct {
    uint32_t part;
    float value;
} sight_t;

/* A few looks at the picture, by samples that are not of it. */
typedef struct {
    const setup_t *setup;
    light_pool_t *pool;
    uint32_t count;
    sight_t *eye; /* [count] */
    size_t splat_count;
    caustics_scout_t scout;
    sight_t *splats; /* brightness of a part if all its pixels shared what these looks brought */
} looks_t;

static float usable(rgb_t value)
{
    float most = v_max(value);
    return most > 0 && most < INFINITY ? most : 0;
}

/* A sample that is not of the picture. */
static sample_t first_look(looks_t *looks, uint32_t i, unit_result_t *result)
{
    const job_settings_t *settings = &looks->setup->settings;
    uint32_t width = (uint32_t)settings->width, height = (uint32_t)settings->height;
    uint32_t pixel = (uint32_t)(sampler_mix(settings->seed + i) % ((uint64_t)width * height));
    sample_t sample = {.setup = looks->setup,
                       .pixel_x = pixel % width,
                       .pixel_y = pixel / width,
                       .sample = UINT32_MAX,
                       .numbers = sampler_new(SAMPLER_INDEPENDENT, settings->seed, i, UINT32_MAX),
                       .pool = looks->pool,
                       .scout = &looks->scout,
                       .result = result};
    sample.time = sample_time(&sample);
    return sample;
}

static void look(looks_t *looks, const integrator_ops_t *integrator, uint32_t i, unit_result_t *result)
{
    const job_settings_t *settings = &looks->setup->settings;
    uint32_t width = (uint32_t)settings->width;
    sample_t sample = first_look(looks, i, result);
    waves_t waves;
    sample_waves(&sample, &waves);
    light_pool_reset(looks->pool, 1);
    if (integrator->light != NULL) integrator->light(&sample, true);
    float value = usable(integrator->sample(&sample));
    looks->eye[i] = (sight_t){part_of(settings, sample.pixel_x, sample.pixel_y), value};
    looks->splats =
        mem_realloc(looks->splats, (looks->splat_count + result->splat_count + 1) * sizeof(sight_t));
    for (size_t k = 0; k < result->splat_count; k++) {
        const splat_t *splat = &result->splats[k];
        uint32_t at = splat->pixel & SPLAT_PIXEL_MASK;
        looks->splats[looks->splat_count++] = (sight_t){
            part_of(settings, at % width, at / width),
            usable(vec3(splat->rgb[0], splat->rgb[1], splat->rgb[2])) * PARTS / (float)looks->count};
    }
    result->splat_count = 0;
}

/* More light subpaths alone, where they show the way to caustics. */
static void look_for_caustics(looks_t *looks, const integrator_ops_t *integrator, unit_result_t *result)
{
    enum { TIMES = 16 };
    if (looks->scout.sights == 0 || looks->scout.meetings == 0) return;
    for (uint32_t i = looks->count; i < TIMES * looks->count; i++) {
        sample_t sample = first_look(looks, i, result);
        waves_t waves;
        sample_waves(&sample, &waves);
        light_pool_reset(looks->pool, 1);
        integrator->light(&sample, true);
        result->splat_count = 0;
    }
}

/* The mean of what was seen in the parts; each sight counts up to a bound, since one that is far brighter
 * than the rest would say it of its whole part. Where no eye subpath sees a thing (a spot behind glass, with
 * nothing else lit) the splats say what is typical. */
static void sum_up(const looks_t *looks, float *inverse)
{
    float roots = 0, sums[PARTS] = {0}, counts[PARTS] = {0};
    for (uint32_t i = 0; i < looks->count; i++) roots += sqrtf(looks->eye[i].value);
    float typical = (roots / (float)looks->count) * (roots / (float)looks->count);
    if (roots == 0)
        for (size_t i = 0; i < looks->splat_count; i++) typical += looks->splats[i].value / PARTS;
    for (uint32_t i = 0; i < looks->count; i++) {
        sums[looks->eye[i].part] += float_min(looks->eye[i].value, 32 * typical);
        counts[looks->eye[i].part]++;
    }
    for (int i = 0; i < PARTS; i++) sums[i] = (sums[i] + typical) / (counts[i] + 1) + 0.1f * typical;
    for (size_t i = 0; i < looks->splat_count; i++)
        sums[looks->splats[i].part] += float_min(looks->splats[i].value, typical);
    for (int i = 0; i < PARTS; i++) inverse[i] = sums[i] > 0 ? 1 / sums[i] : 0;
}

static caustics_t *look_at_picture(const setup_t *setup, const integrator_ops_t *integrator, float *inverse)
{
    enum { LEAST = 64, MOST = 4096, PIXELS = 16 /* for each look */ };
    uint32_t count = (uint32_t)(setup->settings.width * setup->settings.height / PIXELS);
    looks_t looks = {.setup = setup, .count = count < LEAST ? LEAST : count < MOST ? count : MOST};
    looks.eye = mem_alloc(looks.count * sizeof *looks.eye);
    looks.pool = light_pool_new();
    unit_result_t result = {0};
    for (uint32_t i = 0; i < looks.count; i++) look(&looks, integrator, i, &result);
    sum_up(&looks, inverse);
    look_for_caustics(&looks, integrator, &result);
    unit_result_free(&result);
    light_pool_destroy(&looks.pool);
    free(looks.eye);
    free(looks.splats);
    caustics_t *caustics = caustics_new(&looks.scout);
    caustics_scout_free(&looks.scout);
    return caustics;
}

caustics_t *plan_prepare(setup_t *setup, lights_t *lights, const integrator_ops_t *integrator,
                         float inverse_brightness[BRIGHTNESS_SIDE * BRIGHTNESS_SIDE])
{
    caustics_t *caustics = look_at_picture(setup, integrator, inverse_brightness);
    lights_learn(lights, LEARNING_PLACES - LESSON_LIGHTS - caustics_places(caustics));
    setup->caustics = caustics;
    setup->inverse_brightness = inverse_brightness;
    setup->teaching_mask = 0;
    setup->noise = FIRST_NOISE;
    return caustics;
}

/* ---- what samples have without light subpaths ---------------------------------------------------------- */

static uint32_t pass_samples(const job_settings_t *settings, uint32_t pass)
{
    return learning_pass_begin(settings, pass + 1) - learning_pass_begin(settings, pass);
}

static uint32_t teaching_mask(const job_settings_t *settings, uint32_t pass)
{
    if (pass >= learning_taught(settings)) return LESSON_NOBODY;
    uint32_t mask = 0;
    while (pass_samples(settings, pass) / (mask + 1) > TAUGHT_SAMPLES && mask < LESSON_MOST_MASK)
        mask = 2 * mask + 1;
    return mask;
}

/* Samples in the lessons. */
typedef struct {
    double all;
    double blocks[LESSON_BLOCKS_SIDE * LESSON_BLOCKS_SIDE];
} taught_t;

static void count_taught(const job_settings_t *settings, uint32_t teachers, taught_t *taught)
{
    double samples[LESSON_MOST_MASK + 1] = {0}; /* of a pixel, by what decides whether it teaches */
    *taught = (taught_t){0};
    for (uint32_t pass = 0; pass < teachers; pass++)
        for (uint32_t i = 0; i <= LESSON_MOST_MASK; i++)
            if ((i & teaching_mask(settings, pass)) == 0) samples[i] += pass_samples(settings, pass);
    for (uint32_t y = 0; y < (uint32_t)settings->height; y++)
        for (uint32_t x = 0; x < (uint32_t)settings->width; x++) {
            double n = samples[lesson_turn(x, y) & LESSON_MOST_MASK];
            taught->all += n;
            taught->blocks[lesson_block(settings, x, y)] += n;
        }
}

/* The noise of a sample without light subpaths: what its squares have more than those of the means of
 * blocks. */
static double own_noise(const double *lessons, const taught_t *taught)
{
    const double unit = 1.0 / (1 << LESSON_BITS);
    double squares = lessons[LESSON_OWN_SQUARES] * unit, free = taught->all;
    for (uint32_t i = 0; i < ARRAY_LENGTH(taught->blocks); i++) {
        double n = taught->blocks[i], sum = lessons[LESSON_OWN + i] * unit;
        if (!(n > 0)) continue;
        squares -= sum * sum / n;
        free--;
    }
    return free > 0 ? fmax(squares / free, 1e-3) : 1;
}

static double own_rays(const double *lessons, const taught_t *taught)
{
    return lessons[LESSON_OWN_RAYS] / (1 << LESSON_RAY_BITS) / taught->all;
}

/* How many light subpaths a sample is to have of starts that are worth 1 (light_guide.h). */
static double find_reach(const double *lessons, const taught_t *taught)
{
    double cost = own_rays(lessons, taught) + SAMPLE_COST;
    return sqrt(cost / own_noise(lessons, taught));
}

/* The part of all noise that is of eye subpaths which bring a lot at once, from lights where light subpaths
 * should start (light_guide.h). Where it is small they may stay as they are. */
static double left_noise(const double *lessons, const taught_t *taught)
{
    double excess = lessons[LESSON_EXCESS] / (1 << LESSON_EXCESS_BITS) / taught->all;
    return excess / (excess + own_noise(lessons, taught));
}

/* ---- the plan ------------------------------------------------------------------------------------------ */

/* The lessons of a plan, in fresh memory. */
static double *lessons_of(const learning_plan_t *plan)
{
    double *lessons = mem_alloc(LEARNING_PLACES * sizeof *lessons);
    for (size_t i = 0; i < LEARNING_PLACES; i++) lessons[i] = (double)plan->lessons[i];
    return lessons;
}

plan_t *plan_new(const setup_t *setup, const learning_plan_t *learned)
{
    taught_t *taught = mem_alloc(sizeof *taught);
    double *lessons = lessons_of(learned);
    count_taught(&setup->settings, learned->teachers, taught);
    plan_t *plan = mem_zalloc(1, sizeof *plan);
    plan->setup = *setup;
    double reach = find_reach(lessons, taught);
    plan->lights = lights_guided(setup->lights, lessons + LESSON_LIGHTS, taught->all, reach,
                                 left_noise(lessons, taught), LEAST_SHARE, &plan->setup.light_share);
    plan->setup.lights = plan->lights;
    plan->caustics = caustics_guided(setup->caustics, lessons, reach);
    plan->setup.caustics = plan->caustics;
    plan->setup.noise = (float)sqrt(own_noise(lessons, taught));
    plan->setup.teaching_mask = teaching_mask(&setup->settings, learned->pass);
    log_debug("plan of pass %u: own noise %.3f at %.2f rays; %.3f light subpaths a sample", learned->pass,
              own_noise(lessons, taught), own_rays(lessons, taught), (double)plan->setup.light_share);
    free(lessons);
    free(taught);
    return plan;
}

void plan_destroy(plan_t **plan)
{
    if (*plan == NULL) return;
    lights_destroy(&(*plan)->lights);
    caustics_destroy(&(*plan)->caustics);
    free(*plan);
    *plan = NULL;
}

const setup_t *plan_setup(const plan_t *plan)
{
    return &plan->setup;
}
