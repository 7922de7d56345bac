/* crowd: very many workers in one process: real sockets, the real protocol, and no rendering. What they are
 * assigned is "rendered" at a given speed, and sent in the prepared batches. */
#ifndef LIGHTMILL_CROWD_H
#define LIGHTMILL_CROWD_H

#include "tests/sim/prepared.h"

typedef struct crowd crowd_t;

typedef struct {
    prepared_t *prepared; /* kept by the caller */
    const char *host;
    const int *ports; /* of the control sockets of a master, or of relays: workers are dealt out to them */
    int port_count;
    int workers, threads;
    double power;  /* CPU seconds of the prepared rendering that a worker renders in a second */
    double spread; /* seconds over which they join */
} crowd_options_t;

enum { CROWD_BEATS = 104 }; /* classes of waiting times: a quarter of a power of two each, from 1 us on */

/* What happened since the last time it was asked. */
typedef struct {
    uint64_t batches, refused, units, bytes; /* batches that were answered; bytes of their messages */
    uint64_t samples;                        /* pixel samples in those that were counted */
    uint64_t beats[CROWD_BEATS];             /* heartbeats by the time that their answers took */
    double beat_most;                        /* seconds */
    uint64_t intervals;                      /* between batches that were sent, and */
    double interval_sum, answer_sum;         /* seconds in them; and until their answers */
    uint64_t lost, failed; /* workers that the master did not know any more; messages that were not ours */
    /* now */
    int joined, idle, waiting, sent; /* workers: welcome, without units, with offers or batches unanswered */
} crowd_report_t;

result_t crowd_start(const crowd_options_t *options, crowd_t **crowd);
crowd_report_t crowd_report(crowd_t *crowd);
/* Adds what happened; what is now stays. */
void crowd_report_add(crowd_report_t *sum, const crowd_report_t *more);
/* Ends: no more offers are made; waits until what was sent is answered, at most `seconds`. */
void crowd_stop(crowd_t **crowd, double seconds, crowd_report_t *last);
/* Seconds below which a share of the heartbeats were answered. */
double crowd_beat(const crowd_report_t *report, double share);

#endif
