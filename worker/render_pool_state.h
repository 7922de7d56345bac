/* render_pool_state: what the render pool is made of, for render_pool*.c alone. */
#ifndef LIGHTMILL_RENDER_POOL_STATE_H
#define LIGHTMILL_RENDER_POOL_STATE_H

#include "common/wake.h"
#include "proto/uplink/issued.h"
#include "proto/uplink/pace.h"
#include "proto/uplink/unit_queue.h"
#include "proto/wire/wire.h"
#include "worker/checks.h"
#include "worker/render/renderer.h"
#include "worker/render_pool.h"

#include <pthread.h>

enum {
    BATCH_MAX_UNITS = WIRE_MAX_UNITS / 4, /* a batch is offered when it has so many units */
    BATCH_MAX_VALUES = 1 << 26,           /* or tiles of 512 MB, or */
    BATCH_MEMORY_SHARE = 8, /* this part of the memory; then rendering waits until it is closed, */
                            /* and when another unit might break the wire's limit */
    MAX_UNITS_HELD = WIRE_MAX_UNITS / 2 /* no more is asked for */
};

typedef enum { STAGE_EMPTY, STAGE_LOADING, STAGE_READY } stage_t;

typedef struct {
    batch_t batch;
    double since; /* clock at its first unit */
} slot_t;

struct render_pool {
    render_pool_options_t options;
    pthread_mutex_t lock, fill;
    pthread_cond_t work; /* units came, or it is time to end */
    pthread_t *threads;
    int thread_count;

    stage_t stage;
    assignment_t current, next; /* `units` stay in `next` until it becomes current */
    bool has_next;
    scene_blob_t blob;    /* under the renderer, which keeps a pointer to it; the bulk thread's */
    renderer_t *renderer; /* NULL until the scene is loaded */
    bool fetched;         /* the last duty was to fetch a plan */
    uint32_t plans;       /* passes whose plans are ready in it (learning_ready) */
    unit_queue_t queue;
    issued_t issued; /* how the units of the queue, begun and batched, of the job in hand were issued */
    unit_t *begun;   /* those of the queue that threads have in hand; room for one a thread */
    size_t begun_count;
    checks_t checks;
    int rendering;      /* units that threads have in hand, of the queue and of checks */
    atomic_bool cancel; /* tells the renderer to give up */
    bool over;          /* the job in hand is to be let go, */
    bool flush;         /* but its open batch is still wanted; the scene is kept in case the job goes on */
    bool no_more, draining, hurry, quit;
    result_t failure;
    uint64_t failed; /* job */

    slot_t slots[2];
    int open;         /* the slot being filled (under `fill`) */
    atomic_bool full; /* it takes no more */
    bool under_way;   /* the other slot is closed and being sent: only the bulk thread changes it */
    uint64_t sequence;

    double speed; /* pixel samples per thread and second */
    bool measured;
    pace_t pace;         /* what the link delivers of the job in hand */
    double next_measure; /* clock, when to measure a link that is too slow once more */
};

/* ---- under the lock; render_pool.c ---- */

/* The units of the job in hand that are queued, begun or finished, in fresh memory. Those of checks are not
 * among them. */
unit_t *render_pool_units(render_pool_t *pool, size_t *count);
/* Everything that was asked of the job in hand has been done, sent and answered. */
bool render_pool_all_sent(render_pool_t *pool);
/* True when the assignment is of the job in hand. A number alone says nothing: a master that lost its data
 * gives the old ones to new jobs. */
bool render_pool_is_current(const render_pool_t *pool, const assignment_t *assignment);
/* Takes an assignment as the job in hand, to be loaded. The stage is empty. */
void render_pool_begin_job(render_pool_t *pool, const assignment_t *assignment);
/* Goes on with a job that was over (it had been paused), of which `next` is an assignment: its scene is here.
 */
void render_pool_resume_job(render_pool_t *pool);
/* Lets the job in hand go. */
void render_pool_end_job(render_pool_t *pool, bool flush);
/* True when the link is too slow for what the threads make. */
bool render_pool_slow(const render_pool_t *pool);
/* What there is of units. */
load_t render_pool_load(const render_pool_t *pool, const unit_t *units, size_t count);

/* ---- the bulk thread's calls (uplink_handler.h); render_pool_duties.c ---- */

duty_t render_pool_duty(void *self, double batch_interval, double rate);
bool render_pool_unwanted(void *self, uint64_t job);
result_t render_pool_loaded(void *self, uint64_t job, scene_blob_t *blob);
result_t render_pool_planned(void *self, const assignment_t *assignment, uint32_t pass, const uint8_t *bytes,
                             size_t size);
void render_pool_refuse(void *self, uint64_t job, result_t why);
closed_batch_t render_pool_close(void *self, const offer_t *offer);
void render_pool_sent(void *self, const closed_batch_t *closed, bool counted);

#endif
