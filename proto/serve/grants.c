/* grants: see grants.h. */
#include "proto/serve/grants.h"

#include "common/memory_limit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_OFFERS = 2 * SERVE_MAX_WORKERS,
    OFFER_LIFE = 60,  /* seconds; peers repeat an offer every 20 */
    GRANT_LIFE = 20,  /* seconds until a batch that was granted must have come, */
    GRANT_SLACK = 100 /* with so many more at most for its size */
};
enum {
    FIRST_SHARE = 4,  /* of the credit, the window at first */
    LEAST_BATCHES = 4 /* that the window has room for, so that several threads have something to merge */
};
static const double REVIEW = 1; /* seconds between changes of the window */
static const double SHORT_WAIT = 0.5,
                    LONG_WAIT = 2;           /* seconds from the arrival of a batch until it is merged */
static const double BYTES_PER_SECOND = 2e5;  /* the slowest uplink that is waited for */
static const uint64_t LEAST_BYTES = 1 << 16; /* of any batch, so that very many are not free */

typedef struct {
    batch_offer_t offer;
    double until; /* clock: it is dropped then */
} entry_t;

/* In the order of asking, or of granting. */
typedef struct {
    entry_t *entries;
    size_t count, capacity;
} list_t;

struct grants {
    uint64_t credit;
    uint64_t window;         /* bytes: what may be promised or here now, at most the credit */
    uint64_t promised, here; /* bytes */
    uint64_t most;
    double last_tick, last_review; /* clock */
    double here_seconds, released; /* since the last review: byte-seconds of `here`, and bytes merged */
    list_t waiting, granted;
};

/* ---- lists --------------------------------------------------------------------------------------------- */

static entry_t *list_add(list_t *list, const batch_offer_t *offer, double until)
{
    if (list->count == list->capacity) {
        list->capacity = 2 * list->capacity + 16;
        list->entries = mem_realloc(list->entries, list->capacity * sizeof *list->entries);
    }
    list->entries[list->count] = (entry_t){*offer, until};
    return &list->entries[list->count++];
}

static void list_remove(list_t *list, size_t index)
{
    memmove(list->entries + index, list->entries + index + 1,
            (--list->count - index) * sizeof *list->entries);
}

/* The index of a peer's entry; list->count when it has none. */
static size_t list_find(const list_t *list, const identity_t *identity)
{
    size_t i = 0;
    for (; i < list->count; i++) {
        const identity_t *other = &list->entries[i].offer.identity;
        if (other->size == identity->size && memcmp(other->bytes, identity->bytes, other->size) == 0) break;
    }
    return i;
}

/* ---- grants -------------------------------------------------------------------------------------------- */

uint64_t grants_usual_credit(void)
{
    const uint64_t least = (uint64_t)1 << 30, all = memory_limit();
    uint64_t floor = all / 4 < least ? all / 4 : least;
    return all / 8 > floor ? all / 8 : floor;
}

grants_t *grants_new(uint64_t credit)
{
    grants_t *grants = mem_zalloc(1, sizeof *grants);
    grants->credit = credit;
    grants->window = credit / FIRST_SHARE;
    return grants;
}

void grants_destroy(grants_t **grants)
{
    if (*grants == NULL) return;
    free((*grants)->waiting.entries);
    free((*grants)->granted.entries);
    free(*grants);
    *grants = NULL;
}

result_t grants_offer(grants_t *grants, double now, const batch_offer_t *offer)
{
    grants_forget(grants, &offer->identity); /* who offers has nothing under way */
    size_t i = list_find(&grants->waiting, &offer->identity);
    if (i == MAX_OFFERS)
        return result_fail(RESULT_LIMIT, "%d batches are waiting already: try again later", MAX_OFFERS);
    entry_t *entry =
        i < grants->waiting.count ? &grants->waiting.entries[i] : list_add(&grants->waiting, offer, now);
    *entry = (entry_t){*offer, now + OFFER_LIFE};
    if (entry->offer.bytes < LEAST_BYTES) entry->offer.bytes = LEAST_BYTES;
    if (entry->offer.bytes > WIRE_MAX_PAYLOAD) entry->offer.bytes = WIRE_MAX_PAYLOAD;
    return result_ok();
}

static uint64_t larger(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

/* True when there is memory for so many bytes more. */
static bool has_room(const grants_t *grants, uint64_t bytes)
{
    return grants->promised + grants->here + bytes <= larger(grants->credit, 2 * bytes);
}

/* True when they would only wait to be merged. */
static bool is_behind(const grants_t *grants, uint64_t bytes)
{
    return grants->promised + grants->here + bytes > larger(grants->window, LEAST_BATCHES * bytes);
}

static void note_most(grants_t *grants)
{
    uint64_t used = grants->promised + grants->here;
    if (used > grants->most) grants->most = used;
}

bool grants_next(grants_t *grants, double now, result_t (*wanted)(void *context, const batch_offer_t *offer),
                 void *context, batch_offer_t *offer, result_t *verdict)
{
    list_t *waiting = &grants->waiting;
    for (size_t i = 0; i < waiting->count; i++) {
        *offer = waiting->entries[i].offer;
        *verdict = wanted(context, offer);
        if (verdict->code == RESULT_LIMIT) continue; /* those behind it need not wait for it */
        if (verdict->code == RESULT_OK) {
            if (!has_room(grants, offer->bytes) || is_behind(grants, offer->bytes))
                return false; /* nor may they overtake it */
            double seconds = fmin((double)offer->bytes / BYTES_PER_SECOND, GRANT_SLACK);
            list_add(&grants->granted, offer, now + GRANT_LIFE + seconds);
            grants->promised += offer->bytes;
            note_most(grants);
        }
        list_remove(waiting, i);
        return true;
    }
    return false;
}

/* Takes a peer's promise back; returns how large it was. */
static uint64_t take_promise(grants_t *grants, size_t index)
{
    if (index == grants->granted.count) return 0;
    uint64_t bytes = grants->granted.entries[index].offer.bytes;
    grants->promised -= bytes;
    list_remove(&grants->granted, index);
    return bytes;
}

bool grants_admit(grants_t *grants, const identity_t *identity, uint64_t bytes)
{
    uint64_t promised = take_promise(grants, list_find(&grants->granted, identity));
    bool as_promised = promised > 0 && bytes <= 2 * promised;
    if (!as_promised && !has_room(grants, bytes)) return false;
    grants->here += bytes;
    note_most(grants);
    return true;
}

void grants_release(grants_t *grants, uint64_t bytes)
{
    grants->here -= bytes;
    grants->released += (double)bytes;
}

void grants_forget(grants_t *grants, const identity_t *identity)
{
    take_promise(grants, list_find(&grants->granted, identity));
}

/* Looks at how long batches were here, on average, since the last time: by Little's law the bytes that were
 * here over those that went a second. */
static void review_window(grants_t *grants, double now)
{
    bool stuck = grants->here_seconds > 0 && grants->released <= 0;
    double wait = grants->released > 0 ? grants->here_seconds / grants->released : 0;
    if (stuck || wait > LONG_WAIT)
        grants->window /= 2;
    else if (wait < SHORT_WAIT && grants->waiting.count > 0)
        grants->window += grants->window / 4;
    grants->window = larger(grants->window, LEAST_BYTES);
    if (grants->window > grants->credit) grants->window = grants->credit;
    grants->last_review = now;
    grants->here_seconds = grants->released = 0;
}

void grants_tick(grants_t *grants, double now)
{
    grants->here_seconds += (double)grants->here * (now - grants->last_tick);
    grants->last_tick = now;
    if (now - grants->last_review >= REVIEW) review_window(grants, now);
    for (size_t i = grants->granted.count; i-- > 0;)
        if (now >= grants->granted.entries[i].until) take_promise(grants, i);
    for (size_t i = grants->waiting.count; i-- > 0;)
        if (now >= grants->waiting.entries[i].until) list_remove(&grants->waiting, i);
}

grants_state_t grants_state(const grants_t *grants)
{
    return (grants_state_t){.waiting = grants->waiting.count,
                            .granted = grants->granted.count,
                            .used = grants->promised + grants->here,
                            .most = grants->most,
                            .window = grants->window};
}
