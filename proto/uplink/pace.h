/* pace: how much of a job a worker may have in hand, and in one batch, so that its link delivers that in a
 * few batch intervals. Where the link carries what the threads make, there is no bound.
 *
 * Pure: no clock, no lock. Bytes are those that go over the wire. Times are seconds of clock_now(). */
#ifndef LIGHTMILL_PACE_H
#define LIGHTMILL_PACE_H

#include "common/film/film_sums.h"

typedef struct {
    /* Of the link, in the bulk thread's words. */
    double interval; /* seconds between batches that the master wants */
    double rate;     /* bytes a second that go up; 0: not known, or without limit */
    /* Of the job. */
    double begun;        /* when it was */
    double tile_pixels;  /* of a whole tile */
    double tile_bytes;   /* of the tiles of a unit, for each pixel, however many samples it has */
    double sample_bytes; /* of the frames, for each pixel sample, as long as most of their pixels are empty */
    double frame_bytes;  /* of the frames when they are full */
    bool learned;        /* from a batch; else these are guesses, rather too high */
} pace_t;

/* What units are: */
typedef struct {
    double samples; /* pixel samples, */
    double pixels;  /* and pixels of their tiles */
} load_t;

void load_add(load_t *load, const job_settings_t *settings, const unit_t *unit);

/* There is no job, or it is not known yet: guesses for one of the usual kind. What is known of the link
 * stays. */
void pace_rest(pace_t *pace, double now);
/* A job begins; what is known of the link stays. */
void pace_begin(pace_t *pace, const job_settings_t *settings, double now);
/* A batch of such a load took so many bytes, by sums. */
void pace_learn(pace_t *pace, const load_t *load, const uint64_t bytes[BATCH_SUMS]);
/* Bytes of one batch of such a load. */
double pace_bytes(const pace_t *pace, const load_t *load);
/* Whether the link is the bottleneck when threads make `speed` pixel samples a second in units of
 * `unit_samples`. */
bool pace_is_slow(const pace_t *pace, double speed, double unit_samples);

/* The following hold for a slow link. */

/* Bytes of a batch that is large enough to be sent. */
double pace_batch_bytes(const pace_t *pace, double now);
/* Pixel samples of a good unit for a thread of such a speed. */
double pace_unit_samples(const pace_t *pace, double now, double thread_speed);
/* Pixel samples to ask for when so much will be in the next batch; 0: none. */
double pace_wanted(const pace_t *pace, double now, const load_t *next, double unit_samples);
/* Seconds that the smallest unit of the job takes, if that is too long to be of use; else 0. */
double pace_hopeless(const pace_t *pace);

#endif
