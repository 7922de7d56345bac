/* probe: does the master's bulk socket answer, and how fast does the link carry what goes up?
 *
 * Each conversation on the link (link.h) begins with two probes: an empty one, which shows both sides that
 * the socket can be reached, and one of PROBE_BYTES, which measures. From then on batches measure. This is
 * the bookkeeping; bulk.c sends and receives. Not thread-safe. Times are seconds of clock_now(). */
#ifndef LIGHTMILL_PROBE_H
#define LIGHTMILL_PROBE_H

#include <stdbool.h>
#include <stdint.h>

enum { PROBE_BYTES = 1 << 16 };

typedef enum { PROBE_REACHING, PROBE_MEASURING, PROBE_DONE } probe_stage_t;

/* Zeroed to begin with. */
typedef struct {
    probe_stage_t stage;
    uint64_t conversation, worker; /* that the stage is of */
    uint64_t request;              /* the probe that is not answered; 0: none */
    double sent;                   /* when it was sent */
    double silent;                 /* when the first was sent since the socket last answered; 0: it answers */
    double rate;                   /* bytes a second that go up; 0: not measured */
} probe_t;

/* True when the conversation has been probed under this number. */
bool probe_done(const probe_t *probe, uint64_t conversation, uint64_t worker);
/* Begins with the first stage, unless the conversation and the number are those that it is at. */
void probe_follow(probe_t *probe, uint64_t conversation, uint64_t worker);
/* A probe was sent as `request`. */
void probe_sent(probe_t *probe, double now, uint64_t request);
/* It was answered: the next stage. `measures` false: there is no need to. */
void probe_answered(probe_t *probe, double now, bool measures);
/* No answer to the second one so far: the link is known to be no faster than that, which has to do. */
void probe_give_up_measuring(probe_t *probe, double now);
/* True when the socket has not answered for so long. */
bool probe_is_silent(const probe_t *probe, double now, double seconds);
/* So many bytes were seen to arrive after so many seconds, the way back included. */
void probe_learn(probe_t *probe, double bytes, double seconds);

#endif
