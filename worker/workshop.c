/* workshop: see workshop.h.
 *
 * DESIGN. Two locks. `lock` guards the queue, the stage of the job and the counts; it is held for moments
 * only. `fill` guards the open batch while a finished unit is added to it (a millisecond or so: thousands of
 * splats go into a frame that is larger than the caches). Order: lock before fill; a render thread never
 * holds both, so the queue stays quick while batches fill.
 *
 * A unit reaches the open batch only when it is complete, and it counts as "rendering" until it is there. So
 * a closed batch covers exactly its units, and the job in hand can be let go whenever nothing is rendering:
 * no generation counters are needed to keep an old job's splats out of a new job's frame.
 *
 * How much to hold ahead: HOLD_SECONDS of work at the speed that this worker measured itself, asked for again
 * when half of it is gone. That hides a round trip of half a second; more would only sharpen the tail of a
 * job, when some workers still have a queue and others have nothing.
 */
#include "worker/workshop.h"

#include "proto/wire.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

static const double HOLD_SECONDS = 1.0; /* of work, queued ahead of the threads */
static const double UNIT_SECONDS = 0.4; /* of one thread, in a good unit */
static const double FIRST_SPEED = 20e3; /* pixel samples per thread and second, before any is measured */
static const double SPEED_WEIGHT = 0.2; /* of the newest unit in the running mean */
static const double MIN_UNIT_SAMPLES = 256;
static const double MAX_UNIT_SAMPLES = 1 << 26;
enum {
    BATCH_MAX_UNITS = WIRE_MAX_UNITS / 4, /* a batch is closed when it has so many units */
    BATCH_MAX_EYE_VALUES = 1 << 26,       /* or eye tiles of 512 MB */
    MAX_UNITS_HELD = WIRE_MAX_UNITS / 2   /* no more is asked for, so no batch can break the wire's limit */
};

typedef enum { STAGE_EMPTY, STAGE_LOADING, STAGE_READY } stage_t;

typedef struct {
    batch_t batch;
    uint64_t job;
    double since; /* clock at its first unit */
} slot_t;

struct workshop {
    pthread_mutex_t lock, fill;
    pthread_cond_t work; /* units came, or it is time to end */
    pthread_t *threads;
    int thread_count;
    int control_wake, bulk_wake;

    stage_t stage;
    assignment_t current, next; /* `units` stay in `next` until it becomes current */
    bool has_next;
    const renderer_t *renderer;
    unit_t *queue;
    size_t queue_first, queue_end, queue_capacity;
    uint64_t queue_samples; /* pixel samples queued */
    int rendering;          /* units that threads have in hand */
    atomic_bool cancel;     /* tells the renderer to give up */
    bool over;              /* the job in hand is to be let go, */
    bool flush;             /* but its open batch is still wanted */
    bool no_more, draining, hurry, quit;
    result_t failure;
    uint64_t failed; /* job */

    slot_t slots[2];
    int open;       /* the slot being filled (under `fill`) */
    bool under_way; /* the other slot is closed and being sent: only the bulk thread touches it */
    size_t units_under_way;
    uint64_t sequence;

    double speed; /* pixel samples per thread and second */
    bool measured;
};

static void wake(int event)
{
    uint64_t one = 1;
    if (write(event, &one, sizeof one) != sizeof one) log_debug("an eventfd is full");
}

static size_t queue_length(const workshop_t *shop)
{
    return shop->queue_end - shop->queue_first;
}

static void queue_drop(workshop_t *shop)
{
    shop->queue_first = shop->queue_end = 0;
    shop->queue_samples = 0;
}

static uint64_t unit_samples(const workshop_t *shop, const unit_t *unit)
{
    return (uint64_t)unit->count * job_tile_pixels(&shop->current.settings, unit->tile);
}

static void queue_push(workshop_t *shop, const unit_t *units, size_t count)
{
    if (shop->queue_first > 0) {
        memmove(shop->queue, shop->queue + shop->queue_first, queue_length(shop) * sizeof *shop->queue);
        shop->queue_end -= shop->queue_first;
        shop->queue_first = 0;
    }
    if (shop->queue_end + count > shop->queue_capacity) {
        shop->queue_capacity = 2 * (shop->queue_end + count);
        shop->queue = mem_realloc(shop->queue, shop->queue_capacity * sizeof *shop->queue);
    }
    for (size_t i = 0; i < count; i++) {
        shop->queue[shop->queue_end++] = units[i];
        shop->queue_samples += unit_samples(shop, &units[i]);
    }
}

static unit_t queue_pop(workshop_t *shop)
{
    unit_t unit = shop->queue[shop->queue_first++];
    shop->queue_samples -= unit_samples(shop, &unit);
    return unit;
}

static double hold_samples(const workshop_t *shop)
{
    return shop->speed * shop->thread_count * HOLD_SECONDS;
}

/* ---- render threads ----------------------------------------------------------------------------------- */

static bool can_render(const workshop_t *shop)
{
    return shop->stage == STAGE_READY && queue_length(shop) > 0 && !shop->over;
}

static void add_to_batch(workshop_t *shop, const unit_result_t *result)
{
    pthread_mutex_lock(&shop->fill);
    slot_t *slot = &shop->slots[shop->open];
    if (slot->batch.unit_count == 0) slot->since = clock_now();
    batch_add(&slot->batch, result);
    pthread_mutex_unlock(&shop->fill);
}

static void measure(workshop_t *shop, const unit_t *unit, double seconds)
{
    if (seconds <= 0) return;
    double speed = (double)unit_samples(shop, unit) / seconds;
    shop->speed = shop->measured ? shop->speed + SPEED_WEIGHT * (speed - shop->speed) : speed;
    shop->measured = true;
}

/* Renders the next unit of the queue. Called and left with the lock held. */
static void render_one(workshop_t *shop, unit_result_t *result)
{
    unit_t unit = queue_pop(shop);
    const renderer_t *renderer = shop->renderer;
    shop->rendering++;
    bool low = (double)shop->queue_samples < 0.5 * hold_samples(shop);
    pthread_mutex_unlock(&shop->lock);

    if (low) wake(shop->control_wake);
    double start = clock_now();
    bool complete = renderer_unit(renderer, &unit, result, &shop->cancel);
    double seconds = clock_now() - start;
    if (complete) add_to_batch(shop, result);

    pthread_mutex_lock(&shop->lock);
    if (complete) measure(shop, &unit, seconds);
    shop->rendering--;
    wake(shop->bulk_wake);
}

static void *render_thread(void *argument)
{
    workshop_t *shop = argument;
    unit_result_t result = {0};
    pthread_mutex_lock(&shop->lock);
    while (!shop->quit) {
        if (can_render(shop))
            render_one(shop, &result);
        else
            pthread_cond_wait(&shop->work, &shop->lock);
    }
    pthread_mutex_unlock(&shop->lock);
    unit_result_free(&result);
    return NULL;
}

/* ---- life --------------------------------------------------------------------------------------------- */

static void start_threads(workshop_t *shop, int count)
{
    shop->threads = mem_zalloc((size_t)count, sizeof *shop->threads);
    for (int i = 0; i < count; i++) {
        if (pthread_create(&shop->threads[i], NULL, render_thread, shop) != 0) {
            log_warning("only %d of %d render threads could be started", i, count);
            break;
        }
        pthread_setname_np(shop->threads[i], "render");
        shop->thread_count = i + 1;
    }
}

workshop_t *workshop_new(int threads, int control_wake, int bulk_wake)
{
    workshop_t *shop = mem_zalloc(1, sizeof *shop);
    pthread_mutex_init(&shop->lock, NULL);
    pthread_mutex_init(&shop->fill, NULL);
    pthread_cond_init(&shop->work, NULL);
    shop->control_wake = control_wake;
    shop->bulk_wake = bulk_wake;
    shop->speed = FIRST_SPEED;
    pthread_mutex_lock(&shop->lock);
    start_threads(shop, threads);
    pthread_mutex_unlock(&shop->lock);
    return shop;
}

void workshop_stop(workshop_t *shop)
{
    atomic_store(&shop->cancel, true);
    pthread_mutex_lock(&shop->lock);
    shop->quit = true;
    int count = shop->thread_count;
    shop->thread_count = 0;
    pthread_cond_broadcast(&shop->work);
    pthread_mutex_unlock(&shop->lock);
    for (int i = 0; i < count; i++) pthread_join(shop->threads[i], NULL);
}

void workshop_destroy(workshop_t **shop_pointer)
{
    workshop_t *shop = *shop_pointer;
    if (shop == NULL) return;
    workshop_stop(shop);
    if (shop->has_next) free(shop->next.units);
    for (int i = 0; i < 2; i++) batch_free(&shop->slots[i].batch);
    pthread_cond_destroy(&shop->work);
    pthread_mutex_destroy(&shop->fill);
    pthread_mutex_destroy(&shop->lock);
    free(shop->queue);
    free(shop->threads);
    free(shop);
    *shop_pointer = NULL;
}

/* ---- news from the master ----------------------------------------------------------------------------- */

/* Takes an assignment as the job in hand, to be loaded. Lock held; the stage is empty. */
static void begin_job(workshop_t *shop, const assignment_t *assignment)
{
    shop->current = *assignment;
    shop->current.units = NULL;
    shop->stage = STAGE_LOADING;
    shop->over = shop->flush = false;
    shop->measured = false;
    atomic_store(&shop->cancel, false);
    for (int i = 0; i < 2; i++) batch_init(&shop->slots[i].batch, &assignment->settings);
    queue_push(shop, assignment->units, assignment->unit_count);
    free(assignment->units);
}

static void keep_for_later(workshop_t *shop, const assignment_t *assignment)
{
    if (shop->has_next) free(shop->next.units);
    shop->next = *assignment;
    shop->has_next = true;
}

static void drop_next(workshop_t *shop)
{
    if (shop->has_next) free(shop->next.units);
    shop->has_next = false;
}

void workshop_assign(workshop_t *shop, const assignment_t *assignment)
{
    pthread_mutex_lock(&shop->lock);
    shop->no_more = false;
    if (shop->draining) {
        free(assignment->units);
    } else if (shop->stage == STAGE_EMPTY) {
        begin_job(shop, assignment);
    } else if (shop->current.job == assignment->job && !shop->over) {
        queue_push(shop, assignment->units, assignment->unit_count);
        free(assignment->units);
    } else {
        keep_for_later(shop, assignment);
    }
    pthread_cond_broadcast(&shop->work);
    pthread_mutex_unlock(&shop->lock);
    wake(shop->bulk_wake);
}

void workshop_no_more(workshop_t *shop)
{
    pthread_mutex_lock(&shop->lock);
    shop->no_more = true;
    pthread_mutex_unlock(&shop->lock);
    wake(shop->bulk_wake);
}

/* Lets the job in hand go. Lock held. */
static void end_job(workshop_t *shop, bool flush)
{
    shop->over = true;
    shop->flush = flush;
    atomic_store(&shop->cancel, true);
    queue_drop(shop);
}

void workshop_job_over(workshop_t *shop, uint64_t job, bool flush)
{
    pthread_mutex_lock(&shop->lock);
    if (shop->stage != STAGE_EMPTY && shop->current.job == job) end_job(shop, flush);
    if (shop->has_next && shop->next.job == job) drop_next(shop);
    pthread_mutex_unlock(&shop->lock);
    wake(shop->bulk_wake);
}

void workshop_forget(workshop_t *shop)
{
    pthread_mutex_lock(&shop->lock);
    queue_drop(shop);
    drop_next(shop);
    shop->hurry = true;
    pthread_mutex_unlock(&shop->lock);
    wake(shop->bulk_wake);
}

void workshop_drain(workshop_t *shop)
{
    pthread_mutex_lock(&shop->lock);
    shop->draining = true;
    queue_drop(shop);
    drop_next(shop);
    if (shop->stage == STAGE_LOADING) end_job(shop, false);
    pthread_mutex_unlock(&shop->lock);
    wake(shop->bulk_wake);
}

void workshop_clear_failure(workshop_t *shop)
{
    pthread_mutex_lock(&shop->lock);
    shop->failure = result_ok();
    pthread_mutex_unlock(&shop->lock);
}

/* ---- state -------------------------------------------------------------------------------------------- */

/* Units in the open batch and in the one under way. Lock held. */
static size_t batched_units(workshop_t *shop)
{
    pthread_mutex_lock(&shop->fill);
    size_t count = shop->slots[shop->open].batch.unit_count;
    pthread_mutex_unlock(&shop->fill);
    return count + shop->units_under_way;
}

static double good_unit(const workshop_t *shop)
{
    double samples = shop->speed * UNIT_SECONDS;
    if (samples < MIN_UNIT_SAMPLES) return MIN_UNIT_SAMPLES;
    return samples > MAX_UNIT_SAMPLES ? MAX_UNIT_SAMPLES : samples;
}

/* Pixel samples to ask for, given the units held. Lock held. */
static uint64_t samples_wanted(const workshop_t *shop, size_t units_held)
{
    if (shop->draining || shop->has_next || shop->over || shop->failure.code != RESULT_OK) return 0;
    if (units_held > MAX_UNITS_HELD) return 0;
    double hold = hold_samples(shop), held = (double)shop->queue_samples;
    if (hold < good_unit(shop)) hold = good_unit(shop);
    return held < 0.5 * hold ? (uint64_t)(hold - held) : 0;
}

workshop_state_t workshop_state(workshop_t *shop)
{
    workshop_state_t state = {0};
    pthread_mutex_lock(&shop->lock);
    size_t batched = batched_units(shop);
    size_t held = queue_length(shop) + (size_t)shop->rendering + batched;
    bool dropped = shop->over && !shop->flush;
    state.job = shop->stage == STAGE_EMPTY || dropped ? 0 : shop->current.job;
    state.units_held = (uint32_t)held;
    state.samples = samples_wanted(shop, held);
    state.unit_samples = (uint64_t)good_unit(shop);
    state.samples_per_second = shop->measured ? shop->speed * shop->thread_count : 0;
    state.idle = held == 0 || (dropped && shop->rendering == 0 && !shop->under_way);
    state.failure = shop->failure;
    state.failed = shop->failed;
    pthread_mutex_unlock(&shop->lock);
    return state;
}

/* ---- duties of the bulk thread ------------------------------------------------------------------------ */

/* Nothing will be added to the open batch for now. Lock held. */
static bool nothing_coming(const workshop_t *shop)
{
    bool last = shop->no_more || shop->has_next || shop->draining || shop->over;
    return last && queue_length(shop) == 0 && shop->rendering == 0;
}

/* Closes the open batch if it is time; else tells in duty->wait when it will be. Both locks held. */
static bool close_batch(workshop_t *shop, double batch_interval, duty_t *duty)
{
    slot_t *slot = &shop->slots[shop->open];
    size_t units = slot->batch.unit_count;
    if (units == 0 || shop->under_way) return false;
    duty->wait = slot->since + batch_interval - clock_now();
    bool full = units >= BATCH_MAX_UNITS || slot->batch.eye_count >= BATCH_MAX_EYE_VALUES;
    if (duty->wait > 0 && !full && !shop->hurry && !nothing_coming(shop)) return false;
    duty->kind = DUTY_SEND;
    duty->closed = (closed_batch_t){shop->current.job, ++shop->sequence, &slot->batch};
    shop->open = !shop->open;
    shop->under_way = true;
    shop->units_under_way = units;
    shop->hurry = false;
    return true;
}

/* The job in hand is to be let go now: it is over, or finished and another one waits. Lock held. */
static bool time_to_release(workshop_t *shop)
{
    if (shop->stage == STAGE_EMPTY || shop->rendering > 0) return false;
    if (shop->over && !shop->flush) return true;
    return (shop->over || shop->has_next) && queue_length(shop) == 0 && batched_units(shop) == 0;
}

duty_t workshop_duty(workshop_t *shop, double batch_interval)
{
    duty_t duty = {.kind = DUTY_NONE, .wait = 1};
    pthread_mutex_lock(&shop->lock);
    if (time_to_release(shop)) {
        duty.kind = DUTY_RELEASE;
    } else if (shop->stage == STAGE_LOADING) {
        duty.kind = DUTY_LOAD;
        duty.assignment = shop->current;
    } else if (shop->stage == STAGE_READY) {
        pthread_mutex_lock(&shop->fill);
        close_batch(shop, batch_interval, &duty);
        pthread_mutex_unlock(&shop->fill);
    }
    pthread_mutex_unlock(&shop->lock);
    return duty;
}

bool workshop_unwanted(workshop_t *shop)
{
    pthread_mutex_lock(&shop->lock);
    bool unwanted = time_to_release(shop);
    pthread_mutex_unlock(&shop->lock);
    return unwanted;
}

void workshop_loaded(workshop_t *shop, const renderer_t *renderer)
{
    pthread_mutex_lock(&shop->lock);
    shop->renderer = renderer;
    shop->stage = STAGE_READY;
    pthread_cond_broadcast(&shop->work);
    pthread_mutex_unlock(&shop->lock);
    wake(shop->control_wake);
}

void workshop_refuse(workshop_t *shop, result_t why)
{
    pthread_mutex_lock(&shop->lock);
    end_job(shop, false);
    shop->failure = why;
    shop->failed = shop->current.job;
    pthread_mutex_unlock(&shop->lock);
    wake(shop->control_wake);
}

void workshop_sent(workshop_t *shop)
{
    /* Nobody else touches the closed slot, so the long clearing of its frame needs no lock. */
    batch_clear(&shop->slots[!shop->open].batch);
    pthread_mutex_lock(&shop->lock);
    shop->under_way = false;
    shop->units_under_way = 0;
    pthread_mutex_unlock(&shop->lock);
    wake(shop->control_wake);
}

void workshop_release(workshop_t *shop)
{
    pthread_mutex_lock(&shop->lock);
    queue_drop(shop);
    for (int i = 0; i < 2; i++) {
        batch_free(&shop->slots[i].batch);
        shop->slots[i].batch = (batch_t){0};
    }
    shop->renderer = NULL;
    shop->stage = STAGE_EMPTY;
    shop->over = shop->flush = false;
    shop->hurry = false;
    if (shop->has_next) {
        shop->has_next = false;
        begin_job(shop, &shop->next);
    }
    pthread_mutex_unlock(&shop->lock);
    wake(shop->control_wake);
}
