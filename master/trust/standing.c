/* standing: what is held against parties, and who is put aside for it.
 *
 * DESIGN. A party is who is judged: the public key of a connection; the address of its host where there are
 * no keys; the master's own process. Never the name that a worker gives itself: a new name is no new party.
 *
 * Two things are held against a party: it dies while it holds units, it sends batches that are malformed.
 * FARM_MAX_FAILURES of them without a delivery in between, and all its workers are put aside: they are
 * disconnected, and refused when they say hello, with the reason. The first time for FARM_ASIDE_SECONDS, each
 * further time twice as long, until it has behaved for as long as it was aside last.
 *
 * Who is innocent must not be put aside, since a farm without workers does nothing:
 *   - a delivery of any of the party's workers clears it;
 *   - a death counts only if the worker joined after the last thing that is held against the party. So
 *     three generations of workers must have joined and died, and not one of them delivered. When a link
 *     breaks, all workers of a party are lost at a time, which counts once;
 *   - it does not count when the same process is connected again, and is forgiven when the process is heard
 *     of again: it was out of reach, not dead;
 *   - it does not count when the worker was alone with units that are suspects (suspects.c), or held one
 *     that a worker of another party died with;
 *   - who dies is not put aside while no other party is connected.
 * When workers are killed at random, so that one lives for L seconds on average, and deliver every t seconds,
 * a party with a single worker is put aside after about 1 in (L / t)^3 kills, one with more workers hardly
 * ever.
 *
 * Wrong sums are another matter (checks.c): who sent them is put aside at once, for ten times as long: the
 * party, or one of its processes where others of the same party were right.
 *
 * What is held against whom is forgotten when the master ends. */
#include "master/trust/trust_state.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MAX_STANDINGS = FARM_MAX_WORKERS, LIE_FACTOR = 10 };
static const double LONGEST_ASIDE = 7 * 24 * 3600.0; /* seconds */

/* ---- parties ------------------------------------------------------------------------------------------- */

static uint64_t number_of(const char *text)
{
    hash_t hash = hash_bytes(text, strlen(text));
    uint64_t number;
    memcpy(&number, hash.bytes, sizeof number);
    return number;
}

void standing_identify(worker_t *worker)
{
    char process[FARM_MAX_PARTY + FARM_MAX_NAME + 2];
    bool keyed = worker->key[0] != '\0';
    const char *who = keyed ? worker->key : worker->address;
    if (worker->party_text[0] == '\0' && who[0] == '\0')
        snprintf(worker->party_text, sizeof worker->party_text, "in the master's process");
    else if (worker->party_text[0] == '\0')
        snprintf(worker->party_text, sizeof worker->party_text, "%s %s", keyed ? "key" : "address", who);
    snprintf(process, sizeof process, "%s/%s", worker->party_text, worker->name);
    worker->party = number_of(worker->party_text);
    worker->source = number_of(process);
}

/* ---- the list ------------------------------------------------------------------------------------------ */

standing_t *standing_find(const farm_t *farm, uint64_t who)
{
    size_t at = id_table_find(&farm->trust->by_who, who);
    return at != SIZE_MAX ? &farm->trust->standings[at] : NULL;
}

/* The place of one more entry; the one that was looked at longest ago makes room. */
static size_t make_room(trust_t *trust)
{
    size_t oldest = 0;
    if (trust->standing_count < MAX_STANDINGS) {
        trust->standings =
            mem_realloc(trust->standings, (trust->standing_count + 1) * sizeof *trust->standings);
        return trust->standing_count++;
    }
    for (size_t i = 1; i < trust->standing_count; i++)
        if (trust->standings[i].touched < trust->standings[oldest].touched) oldest = i;
    id_table_remove(&trust->by_who, trust->standings[oldest].who);
    return oldest;
}

standing_t *standing_of(farm_t *farm, double now, uint64_t who)
{
    standing_t *standing = standing_find(farm, who);
    if (standing == NULL) {
        size_t at = make_room(farm->trust);
        standing = &farm->trust->standings[at];
        *standing = (standing_t){.who = who};
        id_table_put(&farm->trust->by_who, who, at);
    }
    standing->touched = now;
    return standing;
}

static const standing_t *aside(const farm_t *farm, double now, const worker_t *worker)
{
    const standing_t *party = standing_find(farm, worker->party),
                     *source = standing_find(farm, worker->source);
    if (source != NULL && now < source->until) return source;
    return party != NULL && now < party->until ? party : NULL;
}

const char *trust_reason(const farm_t *farm, double now, const worker_t *worker)
{
    const standing_t *standing = aside(farm, now, worker);
    return standing != NULL ? standing->reason : NULL;
}

result_t trust_admit(const farm_t *farm, double now, worker_t *worker)
{
    standing_identify(worker);
    const standing_t *standing = aside(farm, now, worker);
    if (standing == NULL) return result_ok();
    return result_fail(RESULT_CANCELLED, "worker %s is put aside for %.0f s more: it %s", worker->name,
                       ceil(standing->until - now), standing->reason);
}

/* ---- putting aside ------------------------------------------------------------------------------------- */

/* Nothing more is taken from workers of this party or process. */
static void cast_out(farm_t *farm, uint64_t who)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].party == who || farm->workers[i].source == who) farm->workers[i].outcast = true;
    farm->cast_out = true;
}

static void put_aside(farm_t *farm, double now, standing_t *standing, const char *name, double seconds,
                      const char *why)
{
    standing->length = fmin(fmax(2 * standing->length, seconds), LONGEST_ASIDE);
    standing->until = now + standing->length;
    standing->failures = 0;
    snprintf(standing->reason, sizeof standing->reason, "%s", why);
    log_error("worker %s is put aside for %.0f s: it %s", name, standing->length, standing->reason);
    cast_out(farm, standing->who);
}

void trust_failed(farm_t *farm, double now, worker_t *worker, const char *why)
{
    if (worker->outcast) return;
    standing_t *standing = standing_of(farm, now, worker->party);
    standing->last_failure = now;
    log_warning("worker %s %s (%u of %d before it is put aside)", worker->name, why, ++standing->failures,
                FARM_MAX_FAILURES);
    if (standing->failures >= FARM_MAX_FAILURES)
        put_aside(farm, now, standing, worker->name, FARM_ASIDE_SECONDS, why);
}

bool standing_alone(const farm_t *farm, uint64_t party)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].connected && farm->workers[i].party != party) return false;
    return true;
}

void standing_fell(farm_t *farm, double now, worker_t *worker)
{
    const standing_t *standing = standing_find(farm, worker->party);
    if (standing != NULL && worker->joined <= standing->last_failure) return;
    if (standing_alone(farm, worker->party)) return;
    trust_failed(farm, now, worker, "died with units in its hands");
    worker->charged = true;
}

void standing_lives(farm_t *farm, worker_t *worker)
{
    standing_t *standing = worker->charged ? standing_find(farm, worker->party) : NULL;
    if (standing != NULL && standing->failures > 0) standing->failures--;
    worker->charged = false;
}

void standing_delivered(farm_t *farm, double now, const worker_t *worker)
{
    standing_t *standing = standing_find(farm, worker->party);
    if (standing == NULL) return;
    standing->failures = 0;
    if (now > standing->until + standing->length) standing->length = 0;
}

void standing_lied(farm_t *farm, double now, uint64_t who, const char *name, const char *why)
{
    standing_t *standing = standing_of(farm, now, who);
    standing->passed = 0;
    put_aside(farm, now, standing, name, LIE_FACTOR * FARM_ASIDE_SECONDS, why);
}
