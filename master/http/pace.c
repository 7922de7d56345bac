/* pace: see pace.h. */
#include "master/http/pace.h"

#include "common/thread.h"
#include "master/http/totals.h"

#include <math.h>
#include <pthread.h>
#include <sodium.h>
#include <stdlib.h>

enum { TURNS = 4 };              /* that are given at a time */
static const double TICK = 0.05; /* seconds between two times */
static const double COUNT = 5;   /* seconds after which the farm's threads are counted again */
static const double LONG = 5;    /* seconds of waiting after which newcomers do not matter */

typedef struct {
    http_request_t *request;
    double since;
} waiting_t;

struct pace {
    farm_t *farm;
    pthread_t thread;
    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t waits;
    bool ending;
    double paid;          /* when all that was sent is paid for by the rate */
    double turns_paid;    /* the same of what turns took alone, by half the rate */
    double rate, counted; /* bytes a second, and when that was found */
    waiting_t waiting[PACE_MAX_WAITING];
    size_t count;
};

/* ---- all under the lock -------------------------------------------------------------------------------- */

static void release(pace_t *pace, size_t index, bool turn)
{
    http_request_t *request = pace->waiting[index].request;
    pace->waiting[index] = pace->waiting[--pace->count];
    request->value = turn;
    http_go(request);
}

static void release_impatient(pace_t *pace, double now)
{
    for (size_t i = pace->count; i-- > 0;)
        if (pace->ending || now - pace->waiting[i].since >= PACE_PATIENCE) release(pace, i, false);
}

static double longest_since(const pace_t *pace)
{
    double since = INFINITY;
    for (size_t i = 0; i < pace->count; i++) since = fmin(since, pace->waiting[i].since);
    return since;
}

/* When the next turn can be given. Newcomers take what they want at once, and one that asks again and again
 * as if it had nothing would take everything: so half of the rate is for those who have waited for long. */
static double next_turn(const pace_t *pace)
{
    return fmin(pace->paid, fmax(pace->turns_paid, longest_since(pace) + LONG));
}

static void give_turns(pace_t *pace, double now)
{
    for (int i = 0; i < TURNS && pace->count > 0 && next_turn(pace) <= now; i++)
        release(pace, randombytes_uniform((uint32_t)pace->count), true);
}

static double next_look(const pace_t *pace, double now)
{
    return fmax(fmin(next_turn(pace), longest_since(pace) + PACE_PATIENCE), now + TICK);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void *pace_run(void *context)
{
    pace_t *pace = context;
    pthread_mutex_lock(&pace->lock);
    while (!pace->ending) {
        if (pace->count == 0)
            pthread_cond_wait(&pace->waits, &pace->lock);
        else
            cond_wait_until(&pace->waits, &pace->lock, next_look(pace, clock_now()));
        double now = clock_now();
        release_impatient(pace, now);
        give_turns(pace, now);
    }
    release_impatient(pace, 0);
    pthread_mutex_unlock(&pace->lock);
    return NULL;
}

result_t pace_start(farm_t *farm, pace_t **out)
{
    pace_t *pace = mem_zalloc(1, sizeof *pace);
    pace->farm = farm;
    pace->rate = PACE_LEAST;
    pthread_mutex_init(&pace->lock, NULL);
    cond_init_monotonic(&pace->waits);
    *out = pace;
    result_t result = thread_start(&pace->thread, "lm-pace", pace_run, pace);
    if (result.code != RESULT_OK) pace_free(out);
    return result;
}

void pace_end(pace_t *pace)
{
    if (pace == NULL) return;
    pthread_mutex_lock(&pace->lock);
    bool ended = pace->ending;
    pace->ending = true;
    pthread_cond_signal(&pace->waits);
    pthread_mutex_unlock(&pace->lock);
    if (!ended) pthread_join(pace->thread, NULL);
}

void pace_free(pace_t **out)
{
    if (*out == NULL) return;
    pthread_cond_destroy(&(*out)->waits);
    pthread_mutex_destroy(&(*out)->lock);
    free(*out);
    *out = NULL;
}

/* ---- the server's thread ------------------------------------------------------------------------------- */

bool pace_may_send(pace_t *pace, bool first)
{
    pthread_mutex_lock(&pace->lock);
    bool may = pace->ending || pace->paid <= clock_now() + (first ? PACE_ADVANCE : 0);
    pthread_mutex_unlock(&pace->lock);
    return may;
}

void pace_wait(pace_t *pace, http_request_t *request, void (*then)(http_request_t *request))
{
    pthread_mutex_lock(&pace->lock);
    bool room = pace->count < PACE_MAX_WAITING && !pace->ending;
    if (!room)
        http_reply_problem(request, MHD_HTTP_SERVICE_UNAVAILABLE, "too many watch already: try again");
    else if (http_wait(request, then)) {
        pace->waiting[pace->count++] = (waiting_t){request, clock_now()};
        pthread_cond_signal(&pace->waits);
    }
    pthread_mutex_unlock(&pace->lock);
}

/* The rate by the threads that are connected. */
static double farm_rate(farm_t *farm)
{
    return fmax(PACE_LEAST, PACE_A_THREAD * (double)totals_take(farm).threads);
}

void pace_sent(pace_t *pace, size_t bytes, bool turn)
{
    double now = clock_now();
    pthread_mutex_lock(&pace->lock);
    if (now - pace->counted > COUNT) {
        pace->rate = farm_rate(pace->farm);
        pace->counted = now;
    }
    pace->paid = fmax(pace->paid, now) + (double)bytes / pace->rate;
    if (turn) pace->turns_paid = fmax(pace->turns_paid, now) + 2 * (double)bytes / pace->rate;
    pthread_mutex_unlock(&pace->lock);
}
