/* next_round: how many samples each tile gets, round by round, for jobs that stop at an error, follow the
 * noise, or keep images at sample counts.
 *
 * A round is counted whole before the next is decided, from the film alone. So a decision depends on nothing
 * but the samples counted at a fixed point: the same job makes the same decisions on any farm, in any order,
 * after any number of restarts.
 *
 * A round ends at the next milestone of the job (job_settings_t.save_at), if it would go beyond: when it is
 * counted, the film holds what that of a job with so many samples holds, and nothing else.
 *
 * In an adaptive job a round of base n gives a tile m * n samples, m a power of two up to JOB_MAX_BOOST, each
 * of which weighs JOB_MAX_BOOST / m: so every pixel gets the same weight from every round. The multiples are
 * chosen such that their mean over the pixels is JOB_MEAN_BOOST (less when tiles of different sizes do not
 * add up to it), and n is a quarter of the round's budget, which does not depend on where the noise is. So
 * the image is the mean of the rounds with shares that no sample has a say in, and each round's estimate is
 * right on average whatever was decided before it: the decisions make no bias. (docs/convergence.md has the
 * rest of the argument, and its limits.)
 */
#ifndef LIGHTMILL_NEXT_ROUND_H
#define LIGHTMILL_NEXT_ROUND_H

#include "common/film/film.h"

/* A round: for each tile the number of samples that it has when the round is counted, and the weight of those
 * that the round adds. Arrays of job_tile_count(settings), the caller's. */
typedef struct {
    uint32_t *ends;
    uint32_t *weights;
} round_t;

typedef enum { ROUND_NEXT, ROUND_NONE } round_verdict_t;

/* Decides what comes after `round_count` counted rounds, of which `last` (NULL when there was none) is the
 * latest: fills `next`, or says that the job is done. The settings are those of a planned job
 * (job_is_planned). `film` holds exactly what was counted; it may be NULL before the first round. *error is
 * the estimated relative error so far (film_noise), 0 when not known or of no use. */
round_verdict_t next_round(const job_settings_t *settings, uint32_t round_count, const round_t *last,
                           const film_t *film, round_t *next, double *error);

#endif
