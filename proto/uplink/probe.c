/* probe: see probe.h.
 *
 * DESIGN. A measurement is bytes by seconds. Of the seconds SLACK are left out: a busy machine may answer so
 * much later, and a link that carries a probe in that time is fast enough for anything. The way back is
 * not left out, for it is not known; on a long line that makes the link look slower than it is, at first:
 * larger batches make up for it.
 *
 * Measurements are averaged geometrically, since they may be off by factors of a thousand: a link that looked
 * fast by chance (what the system buffers seems to have arrived) is seen through after three or four. */
#include "proto/uplink/probe.h"

#include <math.h>

static const double SLACK = 0.05;         /* seconds */
static const double FASTEST = 1e10;       /* bytes a second */
enum { LEAST_TELLING = PROBE_BYTES / 4 }; /* bytes; fewer say only that a link is slow */

bool probe_done(const probe_t *probe, uint64_t conversation, uint64_t worker)
{
    return probe->stage == PROBE_DONE && probe->conversation == conversation && probe->worker == worker;
}

void probe_follow(probe_t *probe, uint64_t conversation, uint64_t worker)
{
    if (probe->conversation == conversation && probe->worker == worker) return;
    probe->stage = PROBE_REACHING;
    probe->conversation = conversation;
    probe->worker = worker;
    probe->request = 0;
}

void probe_sent(probe_t *probe, double now, uint64_t request)
{
    probe->request = request;
    probe->sent = now;
    if (probe->silent <= 0) probe->silent = now;
}

void probe_answered(probe_t *probe, double now, bool measures)
{
    probe->request = 0;
    probe->silent = 0;
    if (probe->stage == PROBE_MEASURING) probe_learn(probe, PROBE_BYTES, now - probe->sent);
    probe->stage = probe->stage == PROBE_REACHING && measures ? PROBE_MEASURING : PROBE_DONE;
}

void probe_give_up_measuring(probe_t *probe, double now)
{
    probe_answered(probe, now, false);
}

bool probe_is_silent(const probe_t *probe, double now, double seconds)
{
    return probe->silent > 0 && now - probe->silent >= seconds;
}

void probe_learn(probe_t *probe, double bytes, double seconds)
{
    double rate = seconds > SLACK + bytes / FASTEST ? bytes / (seconds - SLACK) : FASTEST;
    if (bytes < LEAST_TELLING && rate >= probe->rate) return;
    probe->rate = probe->rate > 0 ? sqrt(probe->rate * rate) : rate;
}
