/* next_round: see next_round.h.
 *
 * DESIGN. What matters is the mean number of samples a pixel, `total`. The first round has FIRST_ROUND,
 * enough to see where the noise is, and each further round goes on to a total that is
 *
 *   - predicted from the error e so far and the error E wanted: total * (e / E)^2, and a little more, but
 *     between least_growth and most_growth times as many. The upper limit is there since a prediction far
 *     ahead is a poor one, and since an error that is overestimated now (one firefly) would cost as much as
 *     the limit allows; the lower, since every round ends with workers that wait for each other;
 *   - twice as many in an adaptive job that is to reach a number of samples: half of all samples are then
 *     placed by what the other half has shown.
 *
 * The prediction uses one number of the whole image, so that it can hardly favour any pixel's noise.
 *
 * A job that only keeps images at its milestones goes from one to the next.
 *
 * How an adaptive round is spread: the error falls by sum_t v_t / m_t, where v_t is the squared eye noise of
 * a tile and one sample a pixel, and the round costs sum_t p_t m_t, with p_t pixels a tile. Doubling m_t
 * reduces the first by v_t / (2 m_t) and costs p_t m_t: the gain for each pixel sample falls with every
 * doubling, so taking doublings by falling gain until the budget is spent is the best spread there is. Splats
 * are left out: they come from the light paths of all tiles alike. */
#include "master/schedule/next_round.h"

#include <math.h>
#include <stdlib.h>

enum {
    FIRST_ROUND = 16,                /* samples a pixel */
    ROUND_UNIT = 2 * JOB_MEAN_BOOST, /* adaptive rounds are multiples: even, for equal halves, of any m */
    MAX_DOUBLINGS = 4                /* from 1 to JOB_MAX_BOOST */
};
static const double least_growth = 1.25, most_growth = 2, margin = 1.05;

/* ---- how many samples ---------------------------------------------------------------------------------- */

/* The largest mean number of samples. */
static uint32_t sample_cap(const job_settings_t *settings)
{
    uint32_t limit = settings->adaptive ? JOB_MAX_ADAPTIVE_SPP : JOB_MAX_SPP;
    return settings->spp < limit ? settings->spp : limit;
}

/* The mean number of samples counted in an adaptive job. The film knows: all pixels have the same weight,
 * except those of units that were skipped. */
static uint32_t mean_samples(const job_settings_t *settings, const film_t *film)
{
    uint32_t most = 0, tiles = job_tile_count(settings);
    size_t width = (size_t)settings->width, pixels = width * (size_t)settings->height;
    for (uint32_t t = 0; t < tiles; t++) {
        rect_t rect = job_tile_rect(settings, t);
        size_t pixel = (size_t)rect.y0 * width + (size_t)rect.x0;
        uint32_t weight = film->samples[pixel] + film->samples[pixels + pixel];
        if (weight > most) most = weight;
    }
    return most / JOB_MEAN_BOOST;
}

/* The samples that all tiles have; some have more when the job was first to be ended by time. */
static uint32_t least_samples(const job_settings_t *settings, const round_t *last)
{
    uint32_t least = UINT32_MAX, tiles = job_tile_count(settings);
    for (uint32_t t = 0; t < tiles; t++)
        if (last->ends[t] < least) least = last->ends[t];
    return least;
}

/* The total after the next round, at most `cap`, of a job that goes on for its noise. */
static uint32_t noise_total(const job_settings_t *settings, uint32_t total, uint32_t cap, double error)
{
    double growth = most_growth;
    if (settings->error > 0) {
        double ratio = error / settings->error;
        growth = fmax(least_growth, fmin(most_growth, margin * ratio * ratio));
    }
    uint32_t unit = settings->adaptive ? ROUND_UNIT : 2;
    double more = fmax(total * (growth - 1), total < FIRST_ROUND ? FIRST_ROUND - total : 1);
    more = ceil(more / unit) * unit;
    return more < (double)(cap - total) ? total + (uint32_t)more : cap;
}

/* A round that is to end with `total` samples ends at the milestone before, where there is one. */
static uint32_t milestone_or(const job_settings_t *settings, uint32_t counted, uint32_t total)
{
    uint32_t milestone = job_next_milestone(settings, counted);
    return milestone < total ? milestone : total;
}

/* The total after the next round, at most `cap`. */
static uint32_t next_total(const job_settings_t *settings, uint32_t total, uint32_t cap, double error)
{
    uint32_t goal = job_follows_noise(settings) ? noise_total(settings, total, cap, error) : cap;
    return milestone_or(settings, total, goal);
}

/* The first round's samples. In an adaptive job all others are multiples of ROUND_UNIT, which is the reason
 * why this one takes what the cap has over. */
static uint32_t first_total(const job_settings_t *settings, uint32_t cap)
{
    uint32_t first = settings->adaptive ? FIRST_ROUND + cap % ROUND_UNIT : FIRST_ROUND;
    return milestone_or(settings, 0, first < cap && job_follows_noise(settings) ? first : cap);
}

/* ---- where --------------------------------------------------------------------------------------------- */

/* Up to `total` for all tiles that have less. */
static void even_round(const job_settings_t *settings, const round_t *last, uint32_t total, round_t *next)
{
    uint32_t tiles = job_tile_count(settings);
    for (uint32_t t = 0; t < tiles; t++) {
        next->ends[t] = last != NULL && last->ends[t] > total ? last->ends[t] : total;
        next->weights[t] = settings->adaptive ? JOB_MAX_BOOST / JOB_MEAN_BOOST : 1;
    }
}

/* So many more for all tiles: what is too little for multiples. */
static void rest_round(const job_settings_t *settings, const round_t *last, uint32_t more, round_t *next)
{
    uint32_t tiles = job_tile_count(settings);
    for (uint32_t t = 0; t < tiles; t++) {
        next->ends[t] = last->ends[t] + more;
        next->weights[t] = JOB_MAX_BOOST / JOB_MEAN_BOOST;
    }
}

/* A tile's step from multiple 2^doubling to the next. */
typedef struct {
    double gain; /* less squared noise for each pixel sample */
    uint32_t tile, doubling;
} step_t;

/* By falling gain; what gains the same, in an order that depends on nothing else. */
static int step_order(const void *a, const void *b)
{
    const step_t *u = a, *v = b;
    if (u->gain != v->gain) return u->gain > v->gain ? -1 : 1;
    if (u->doubling != v->doubling) return u->doubling < v->doubling ? -1 : 1;
    return u->tile < v->tile ? -1 : u->tile > v->tile;
}

/* All steps of all tiles, by falling gain. `noise` is the squared eye noise of the tiles as they are. */
static step_t *sorted_steps(const job_settings_t *settings, const round_t *last, const double *noise)
{
    uint32_t tiles = job_tile_count(settings);
    step_t *steps = mem_alloc((size_t)MAX_DOUBLINGS * tiles * sizeof *steps);
    for (uint32_t t = 0; t < tiles; t++) {
        double gain = 0.5 * noise[t] * (double)last->ends[t] / job_tile_pixels(settings, t);
        for (uint32_t d = 0; d < MAX_DOUBLINGS; d++, gain /= 4)
            steps[(size_t)MAX_DOUBLINGS * t + d] = (step_t){gain, t, d};
    }
    qsort(steps, (size_t)MAX_DOUBLINGS * tiles, sizeof *steps, step_order);
    return steps;
}

/* `base` samples for each tile times a multiple by its noise. Ends hold the exponents of the multiples
 * meanwhile. */
static void noise_round(const job_settings_t *settings, const round_t *last, const double *noise,
                        uint32_t base, round_t *next)
{
    uint32_t tiles = job_tile_count(settings);
    uint64_t pixels = (uint64_t)settings->width * (uint64_t)settings->height;
    uint64_t left = pixels * (JOB_MEAN_BOOST - 1); /* all tiles begin with once the base */
    step_t *steps = sorted_steps(settings, last, noise);
    for (uint32_t t = 0; t < tiles; t++) next->ends[t] = 0;
    for (size_t i = 0; i < (size_t)MAX_DOUBLINGS * tiles; i++) {
        uint64_t cost = (uint64_t)job_tile_pixels(settings, steps[i].tile) << steps[i].doubling;
        if (cost > left || next->ends[steps[i].tile] != steps[i].doubling) continue;
        next->ends[steps[i].tile]++;
        left -= cost;
    }
    free(steps);
    for (uint32_t t = 0; t < tiles; t++) {
        next->weights[t] = JOB_MAX_BOOST >> next->ends[t];
        next->ends[t] = last->ends[t] + (base << next->ends[t]);
    }
}

round_verdict_t next_round(const job_settings_t *settings, uint32_t round_count, const round_t *last,
                           const film_t *film, round_t *next, double *error)
{
    uint32_t cap = sample_cap(settings);
    *error = 0;
    if (round_count == 0) {
        even_round(settings, NULL, first_total(settings, cap), next);
        return ROUND_NEXT;
    }
    double *noise = mem_zalloc(job_tile_count(settings), sizeof *noise);
    double estimate = job_follows_noise(settings) ? film_noise(film, noise) : INFINITY;
    uint32_t total = settings->adaptive ? mean_samples(settings, film) : least_samples(settings, last);
    if (isfinite(estimate)) *error = estimate;
    bool done = total >= cap || (settings->error > 0 && estimate <= settings->error);
    uint32_t goal = done ? total : next_total(settings, total, cap, estimate);
    if (!done && !settings->adaptive)
        even_round(settings, last, goal, next);
    else if (!done && goal - total < ROUND_UNIT)
        rest_round(settings, last, goal - total, next);
    else if (!done)
        noise_round(settings, last, noise, (goal - total) / JOB_MEAN_BOOST, next);
    free(noise);
    return done ? ROUND_NONE : ROUND_NEXT;
}
