/* rate_limit: see rate_limit.h.
 *
 * DESIGN. Peers choose their names, so the table must neither grow with them nor be steered by them. It is a
 * table of sets of WAYS buckets; a keyed hash chooses the set and stands for the name. A bucket that has
 * filled up again says nothing that a new one would not say, so it is free for another peer, and nothing is
 * lost. A peer that finds its set taken by others who are all busy shares one more bucket with everybody of
 * whom this is true: a flood of names is felt only while it keeps more buckets busy than there are. */
#include "proto/serve/rate_limit.h"

#include <sodium.h>
#include <stdlib.h>
#include <string.h>

enum { WAYS = 8 };

typedef struct {
    uint64_t peer; /* hash of its name */
    double tokens; /* at `time` */
    double time;   /* seconds; 0: never used */
    bool told;
} bucket_t;

typedef struct {
    bucket_t buckets[WAYS];
    bucket_t shared;
} set_t;

struct rate_limit {
    double rate, burst;
    uint8_t key[crypto_shorthash_KEYBYTES];
    size_t mask; /* sets - 1 */
    set_t sets[];
};

rate_limit_t *rate_limit_new(double rate, double burst, size_t peers)
{
    size_t sets = 1;
    while (sets * WAYS < peers) sets *= 2;
    rate_limit_t *limit = mem_zalloc(1, sizeof *limit + sets * sizeof limit->sets[0]);
    limit->rate = rate;
    limit->burst = burst;
    limit->mask = sets - 1;
    randombytes_buf(limit->key, sizeof limit->key);
    return limit;
}

void rate_limit_destroy(rate_limit_t **limit)
{
    free(*limit);
    *limit = NULL;
}

static void refill(const rate_limit_t *limit, double now, bucket_t *bucket)
{
    double tokens = bucket->tokens + (now - bucket->time) * limit->rate;
    bucket->tokens = bucket->time == 0 || tokens > limit->burst ? limit->burst : tokens;
    bucket->time = now;
    if (bucket->tokens >= 0.5 * limit->burst) bucket->told = false;
}

/* True when the bucket is full again: it is then as good as a new one. */
static bool is_free(const rate_limit_t *limit, double now, const bucket_t *bucket)
{
    return bucket->time == 0 || bucket->tokens + (now - bucket->time) * limit->rate >= limit->burst;
}

static bucket_t *find(rate_limit_t *limit, double now, uint64_t peer)
{
    set_t *set = &limit->sets[peer & limit->mask];
    bucket_t *vacant = NULL;
    for (int i = 0; i < WAYS; i++) {
        bucket_t *bucket = &set->buckets[i];
        if (bucket->time != 0 && bucket->peer == peer) return bucket;
        if (vacant == NULL && is_free(limit, now, bucket)) vacant = bucket;
    }
    if (vacant == NULL) return &set->shared;
    *vacant = (bucket_t){.peer = peer};
    return vacant;
}

rate_verdict_t rate_limit_take(rate_limit_t *limit, double now, const void *peer, size_t size, double tokens)
{
    uint64_t hash;
    _Static_assert(sizeof hash == crypto_shorthash_BYTES, "the hash is a 64-bit number");
    crypto_shorthash((uint8_t *)&hash, peer, size, limit->key);
    bucket_t *bucket = find(limit, now, hash);
    refill(limit, now, bucket);
    if (bucket->tokens >= tokens) {
        bucket->tokens -= tokens;
        return RATE_PASS;
    }
    if (bucket->told) return RATE_DROP;
    bucket->told = true;
    return RATE_TELL;
}
