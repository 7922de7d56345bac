/* render_pool: see render_pool.h.
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
 *
 * Where the link does not carry what the threads make, what is asked for is bounded by the link instead, from
 * the queue to the batch that is under way (proto/uplink/pace.h).
 *
 * A master that was restarted, or that gave this worker up, does not know what is in hand here and may assign
 * it once more. It is finished or will be soon, and must not be in a batch twice: samples that are in hand
 * are left out of an assignment. If the batch with them is refused, the master gives them out again.
 */
#include "worker/render_pool_state.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double HOLD_SECONDS = 1.0; /* of work, queued ahead of the threads */
static const double UNIT_SECONDS = 0.4; /* of one thread, in a good unit */
static const double FIRST_SPEED = 20e3; /* pixel samples per thread and second, before any is measured */
static const double SPEED_WEIGHT = 0.2; /* of the newest unit in the running mean */
static const double MIN_UNIT_SAMPLES = 256;
static const double MAX_UNIT_SAMPLES = 1 << 26;

static double hold_samples(const render_pool_t *pool)
{
    return pool->speed * pool->thread_count * HOLD_SECONDS;
}

/* ---- render threads ----------------------------------------------------------------------------------- */

/* What a thread has in hand. */
typedef struct {
    unit_t unit;
    unit_check_t *check; /* NULL: the unit is of the queue */
    size_t index;        /* in the check */
} piece_t;

/* Takes the next unit to render; false when there is none now. Lock held. */
static bool take_piece(render_pool_t *pool, piece_t *piece)
{
    if (pool->stage != STAGE_READY || pool->over) return false;
    unit_t unit;
    unit_check_t *check = checks_next(&pool->checks);
    bool ready = check != NULL &&
                 learning_ready(&pool->current.settings, check->units[check->begun].first, pool->plans);
    if (ready && !pool->draining) {
        *piece = (piece_t){check->units[check->begun], check, check->begun};
        check->begun++;
        check->rendering++;
    } else if (!atomic_load(&pool->full) &&
               unit_queue_pop(&pool->queue, &pool->current.settings, pool->plans, &unit)) {
        *piece = (piece_t){.unit = unit};
        pool->begun[pool->begun_count++] = piece->unit;
    } else {
        return false;
    }
    pool->rendering++;
    return true;
}

/* Values that the tiles of the open batch may have. */
static size_t most_values(const render_pool_t *pool)
{
    uint64_t share = pool->options.memory / BATCH_MEMORY_SHARE / sizeof(int64_t);
    return share < BATCH_MAX_VALUES ? (size_t)share : BATCH_MAX_VALUES;
}

static void add_to_batch(render_pool_t *pool, const unit_result_t *result)
{
    pthread_mutex_lock(&pool->fill);
    slot_t *slot = &pool->slots[pool->open];
    batch_t *batch = &slot->batch;
    if (batch->unit_count == 0) slot->since = clock_now();
    batch_add(batch, result);
    /* Each of the other threads may have one more unit in hand, which is added in any case. */
    bool full = batch->unit_count + (size_t)pool->options.threads >= WIRE_MAX_UNITS ||
                batch_tile_values(batch) >= most_values(pool);
    if (full) atomic_store(&pool->full, true);
    pthread_mutex_unlock(&pool->fill);
}

static void measure(render_pool_t *pool, const unit_t *unit, double seconds)
{
    if (seconds <= 0) return;
    double speed = (double)unit_samples(&pool->current.settings, unit) / seconds;
    pool->speed = pool->measured ? pool->speed + SPEED_WEIGHT * (speed - pool->speed) : speed;
    pool->measured = true;
}

/* Puts a piece away that was finished or given up. Lock held. */
static void end_piece(render_pool_t *pool, const piece_t *piece, unit_result_t *result)
{
    pool->rendering--;
    if (piece->check != NULL) {
        checks_finish(&pool->checks, piece->check, piece->index, result);
        return;
    }
    size_t i = 0;
    while (pool->begun[i].tile != piece->unit.tile || pool->begun[i].first != piece->unit.first) i++;
    pool->begun[i] = pool->begun[--pool->begun_count];
}

/* Called and left with the lock held. */
static void render_piece(render_pool_t *pool, const piece_t *piece, unit_result_t *result)
{
    const renderer_t *renderer = pool->renderer;
    bool low = (double)pool->queue.samples < 0.5 * hold_samples(pool);
    pthread_mutex_unlock(&pool->lock);

    if (low) wake_up(pool->options.control_wake);
    double start = clock_now();
    bool complete = renderer_unit(renderer, &piece->unit, result, &pool->cancel);
    double seconds = clock_now() - start;
    if (complete && piece->check == NULL) add_to_batch(pool, result);

    pthread_mutex_lock(&pool->lock);
    if (complete) measure(pool, &piece->unit, seconds);
    end_piece(pool, piece, complete ? result : NULL);
    wake_up(pool->options.bulk_wake);
}

static void *render_thread(void *argument)
{
    render_pool_t *pool = argument;
    unit_result_t result = {0};
    pthread_mutex_lock(&pool->lock);
    while (!pool->quit) {
        piece_t piece;
        if (take_piece(pool, &piece))
            render_piece(pool, &piece, &result);
        else
            pthread_cond_wait(&pool->work, &pool->lock);
    }
    pthread_mutex_unlock(&pool->lock);
    unit_result_free(&result);
    return NULL;
}

/* ---- life --------------------------------------------------------------------------------------------- */

static void start_threads(render_pool_t *pool, int count)
{
    pool->threads = mem_zalloc((size_t)count, sizeof *pool->threads);
    pool->begun = mem_zalloc((size_t)count, sizeof *pool->begun);
    for (int i = 0; i < count; i++) {
        if (pthread_create(&pool->threads[i], NULL, render_thread, pool) != 0) {
            log_warning("only %d of %d render threads could be started", i, count);
            break;
        }
        pthread_setname_np(pool->threads[i], "render");
        pool->thread_count = i + 1;
    }
}

render_pool_t *render_pool_new(const render_pool_options_t *options)
{
    render_pool_t *pool = mem_zalloc(1, sizeof *pool);
    pool->options = *options;
    pthread_mutex_init(&pool->lock, NULL);
    pthread_mutex_init(&pool->fill, NULL);
    pthread_cond_init(&pool->work, NULL);
    pool->speed = FIRST_SPEED;
    pace_rest(&pool->pace, clock_now());
    pthread_mutex_lock(&pool->lock);
    start_threads(pool, options->threads);
    pthread_mutex_unlock(&pool->lock);
    return pool;
}

static void stop_threads(render_pool_t *pool)
{
    atomic_store(&pool->cancel, true);
    pthread_mutex_lock(&pool->lock);
    pool->quit = true;
    int count = pool->thread_count;
    pool->thread_count = 0;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    for (int i = 0; i < count; i++) pthread_join(pool->threads[i], NULL);
}

void render_pool_destroy(render_pool_t **pool_pointer)
{
    render_pool_t *pool = *pool_pointer;
    if (pool == NULL) return;
    stop_threads(pool);
    renderer_destroy(&pool->renderer);
    blob_close(&pool->blob);
    if (pool->has_next) free(pool->next.units);
    for (size_t i = 0; i < pool->checks.count; i++) pool->checks.list[i]->under_way = false;
    checks_drop(&pool->checks, true);
    for (int i = 0; i < 2; i++) batch_free(&pool->slots[i].batch);
    pthread_cond_destroy(&pool->work);
    pthread_mutex_destroy(&pool->fill);
    pthread_mutex_destroy(&pool->lock);
    unit_queue_free(&pool->queue);
    issued_free(&pool->issued);
    free(pool->begun);
    free(pool->threads);
    free(pool);
    *pool_pointer = NULL;
}

/* ---- what is in hand; all under the lock -------------------------------------------------------------- */

/* Units in the open batch and in the one under way. */
static size_t batched_units(render_pool_t *pool)
{
    pthread_mutex_lock(&pool->fill);
    size_t count = pool->slots[pool->open].batch.unit_count;
    if (pool->under_way) count += pool->slots[!pool->open].batch.unit_count;
    pthread_mutex_unlock(&pool->fill);
    return count;
}

/* Copies units that were begun or finished and not acknowledged; returns how many. */
static size_t list_kept(render_pool_t *pool, unit_t *units, size_t capacity)
{
    size_t count = 0;
    for (size_t i = 0; i < pool->begun_count && count < capacity; i++) units[count++] = pool->begun[i];
    pthread_mutex_lock(&pool->fill);
    for (int s = 0; s < 2; s++) {
        const batch_t *batch = &pool->slots[s].batch;
        if (s != pool->open && !pool->under_way) continue;
        for (size_t i = 0; i < batch->unit_count && count < capacity; i++) units[count++] = batch->units[i];
    }
    pthread_mutex_unlock(&pool->fill);
    return count;
}

/* Everything that was asked of the job in hand has been done, sent and answered. */
bool render_pool_all_sent(render_pool_t *pool)
{
    return unit_queue_length(&pool->queue) == 0 && pool->rendering == 0 && batched_units(pool) == 0 &&
           checks_units(&pool->checks) == 0;
}

/* ---- news from the master ----------------------------------------------------------------------------- */

unit_t *render_pool_units(render_pool_t *pool, size_t *count)
{
    size_t queued = unit_queue_length(&pool->queue), begun = pool->begun_count;
    size_t most = begun + batched_units(pool) + begun; /* units that are begun may be batched meanwhile */
    unit_t *held = mem_alloc((most + queued + 1) * sizeof *held);
    *count = list_kept(pool, held, most);
    if (queued > 0) memcpy(held + *count, pool->queue.units + pool->queue.first, queued * sizeof *held);
    *count += queued;
    return held;
}

/* Queues the units of an assignment of the job in hand, without what is in hand already. */
static void queue_units(render_pool_t *pool, const assignment_t *assignment)
{
    for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++)
        if (!hash_is_zero(&assignment->plans[pass])) pool->current.plans[pass] = assignment->plans[pass];
    if (assignment->check != 0) {
        checks_push(&pool->checks, &assignment->settings, assignment->check, assignment->units,
                    assignment->macs, assignment->unit_count);
        return;
    }
    size_t count;
    unit_t *held = render_pool_units(pool, &count);
    for (size_t i = 0; i < assignment->unit_count; i++)
        unit_queue_push(&pool->queue, &assignment->settings, assignment->units[i], held, count);
    issued_add(&pool->issued, assignment->units, assignment->macs, assignment->unit_count);
    free(held);
    free(assignment->units);
}

/* Takes an assignment as the job in hand, to be loaded. The stage is empty. */
void render_pool_begin_job(render_pool_t *pool, const assignment_t *assignment)
{
    pool->current = *assignment;
    pool->current.units = NULL;
    pool->stage = STAGE_LOADING;
    pool->plans = 0;
    pool->over = pool->flush = false;
    pool->measured = false;
    pace_begin(&pool->pace, &assignment->settings, clock_now());
    atomic_store(&pool->cancel, false);
    for (int i = 0; i < 2; i++) batch_init(&pool->slots[i].batch, &assignment->settings);
    issued_clear(&pool->issued);
    queue_units(pool, assignment);
}

/* Goes on with a job that was over (it had been paused): its scene is here. */
void render_pool_resume_job(render_pool_t *pool)
{
    for (int i = 0; i < 2; i++) batch_clear(&pool->slots[i].batch);
    checks_drop(&pool->checks, true);
    atomic_store(&pool->full, false);
    atomic_store(&pool->cancel, false);
    pool->over = pool->flush = pool->has_next = false;
    queue_units(pool, &pool->next);
    pthread_cond_broadcast(&pool->work);
}

static void drop_next(render_pool_t *pool)
{
    if (pool->has_next) free(pool->next.units);
    pool->has_next = false;
}

/* Lets the job in hand go. */
void render_pool_end_job(render_pool_t *pool, bool flush)
{
    pool->over = true;
    pool->flush = flush;
    atomic_store(&pool->cancel, true);
    unit_queue_clear(&pool->queue);
    checks_drop(&pool->checks, true);
}

/* True when the assignment is of the job in hand. A number alone says nothing: a master that lost its data
 * gives the old ones to new jobs. One that lost some of it may go by another plan. */
bool render_pool_is_current(const render_pool_t *pool, const assignment_t *assignment)
{
    return pool->stage != STAGE_EMPTY && pool->current.job == assignment->job &&
           hash_equal(&pool->current.content, &assignment->content) &&
           assignment_plans_agree(pool->current.plans, assignment->plans);
}

static void assign(void *self, const assignment_t *assignment)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    pool->no_more = false;
    if (pool->draining) {
        free(assignment->units);
    } else if (pool->stage == STAGE_EMPTY) {
        render_pool_begin_job(pool, assignment);
    } else if (render_pool_is_current(pool, assignment) && !pool->over) {
        queue_units(pool, assignment);
    } else {
        if (pool->current.job == assignment->job && !render_pool_is_current(pool, assignment))
            render_pool_end_job(pool, false);
        drop_next(pool);
        pool->next = *assignment;
        pool->has_next = true;
    }
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    wake_up(pool->options.bulk_wake);
}

static void no_more(void *self)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    pool->no_more = true;
    pthread_mutex_unlock(&pool->lock);
    wake_up(pool->options.bulk_wake);
}

static void job_over(void *self, uint64_t job, bool flush)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    if (pool->stage != STAGE_EMPTY && pool->current.job == job) render_pool_end_job(pool, flush);
    if (pool->has_next && pool->next.job == job) drop_next(pool);
    pthread_mutex_unlock(&pool->lock);
    wake_up(pool->options.bulk_wake);
}

static void forget(void *self)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    unit_queue_clear(&pool->queue);
    checks_drop(&pool->checks, true);
    drop_next(pool);
    pool->hurry = true;
    pthread_mutex_unlock(&pool->lock);
    wake_up(pool->options.bulk_wake);
}

static size_t kept(void *self, uint64_t job, unit_t *units, issue_t *issues, size_t capacity)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    bool in_hand = pool->stage != STAGE_EMPTY && pool->current.job == job;
    size_t count = in_hand ? list_kept(pool, units, capacity) : 0;
    issued_find(&pool->issued, units, count, issues);
    pthread_mutex_unlock(&pool->lock);
    return count;
}

static void drain(void *self)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    pool->draining = true;
    unit_queue_clear(&pool->queue);
    checks_drop(&pool->checks, false);
    drop_next(pool);
    if (pool->stage == STAGE_LOADING) render_pool_end_job(pool, false);
    pthread_mutex_unlock(&pool->lock);
    wake_up(pool->options.bulk_wake);
}

static void give_up(void *self)
{
    render_pool_t *pool = self;
    atomic_store(&pool->cancel, true);
}

static void clear_failure(void *self)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    pool->failure = result_ok();
    pthread_mutex_unlock(&pool->lock);
}

/* ---- state -------------------------------------------------------------------------------------------- */

static double good_unit(const render_pool_t *pool)
{
    double samples = pool->speed * UNIT_SECONDS;
    if (samples < MIN_UNIT_SAMPLES) return MIN_UNIT_SAMPLES;
    return samples > MAX_UNIT_SAMPLES ? MAX_UNIT_SAMPLES : samples;
}

bool render_pool_slow(const render_pool_t *pool)
{
    return pace_is_slow(&pool->pace, pool->speed * pool->thread_count, good_unit(pool));
}

load_t render_pool_load(const render_pool_t *pool, const unit_t *units, size_t count)
{
    load_t load = {0};
    for (size_t i = 0; i < count; i++) load_add(&load, &pool->current.settings, &units[i]);
    return load;
}

/* Samples of a good unit, which a slow link may want to be of another size. */
static double wanted_unit(const render_pool_t *pool)
{
    return render_pool_slow(pool) ? pace_unit_samples(&pool->pace, clock_now(), pool->speed)
                                  : good_unit(pool);
}

/* What a slow link lets a worker ask for. Lock held. */
static double samples_by_link(render_pool_t *pool)
{
    load_t queued =
        render_pool_load(pool, pool->queue.units + pool->queue.first, unit_queue_length(&pool->queue));
    load_t begun = render_pool_load(pool, pool->begun, pool->begun_count);
    pthread_mutex_lock(&pool->fill);
    const batch_t *open = &pool->slots[pool->open].batch;
    load_t next = render_pool_load(pool, open->units, open->unit_count);
    pthread_mutex_unlock(&pool->fill);
    next.samples += queued.samples + begun.samples;
    next.pixels += queued.pixels + begun.pixels;
    return pace_wanted(&pool->pace, clock_now(), &next, wanted_unit(pool));
}

/* Pixel samples to ask for, given the units held. Lock held. */
static uint64_t samples_wanted(render_pool_t *pool, size_t units_held)
{
    if (pool->draining || pool->has_next || pool->failure.code != RESULT_OK) return 0;
    if (units_held > MAX_UNITS_HELD) return 0;
    if (pool->over && !(pool->flush && render_pool_all_sent(pool))) return 0;
    bool slow = render_pool_slow(pool);
    if (slow && !pool->over && pace_hopeless(&pool->pace) > 0) return 0;
    double hold = hold_samples(pool);
    double held = (double)(pool->queue.samples + checks_samples_left(&pool->checks, &pool->current.settings));
    if (hold < good_unit(pool)) hold = good_unit(pool);
    if (slow) return (uint64_t)samples_by_link(pool);
    return held < 0.5 * hold ? (uint64_t)(hold - held) : 0;
}

/* Why nothing is asked for; empty when something is. Lock held. */
static void describe_trouble(const render_pool_t *pool, char *text, size_t size)
{
    const pace_t *pace = &pool->pace;
    double seconds = render_pool_slow(pool) && !pool->over ? pace_hopeless(pace) : 0;
    text[0] = '\0';
    if (seconds > 0)
        snprintf(text, size,
                 "its link carries %.0f kB/s, so the smallest batch of job %llu, %.0f kB, takes %.0f s: more "
                 "than three batch intervals of %g s",
                 1e-3 * pace->rate, (unsigned long long)pool->current.job, 1e-3 * seconds * pace->rate,
                 seconds, pace->interval);
}

static uplink_state_t state(void *self)
{
    render_pool_t *pool = self;
    uplink_state_t s = {.ready = true, .fingerprint = pool->options.fingerprint};
    pthread_mutex_lock(&pool->lock);
    size_t held = unit_queue_length(&pool->queue) + pool->begun_count + batched_units(pool) +
                  checks_units(&pool->checks);
    if (pool->has_next) held += pool->next.unit_count;
    bool dropped = pool->over && !pool->flush;
    s.threads = (uint32_t)pool->options.threads;
    s.job = pool->stage == STAGE_EMPTY || dropped ? 0 : pool->current.job;
    s.content = pool->current.content;
    s.units_held = (uint32_t)held;
    s.rendering = (uint32_t)pool->rendering;
    s.samples = samples_wanted(pool, held);
    s.unit_samples = (uint64_t)wanted_unit(pool);
    describe_trouble(pool, s.trouble, sizeof s.trouble);
    s.samples_per_second = pool->measured ? pool->speed * pool->thread_count : 0;
    s.idle = held == 0 || (dropped && pool->rendering == 0 && !pool->under_way);
    s.failure = pool->failure;
    s.failed = pool->failed;
    pthread_mutex_unlock(&pool->lock);
    return s;
}

uplink_handler_t render_pool_handler(render_pool_t *pool)
{
    static const uplink_calls_t calls = {.assign = assign,
                                         .no_more = no_more,
                                         .job_over = job_over,
                                         .forget = forget,
                                         .kept = kept,
                                         .drain = drain,
                                         .give_up = give_up,
                                         .clear_failure = clear_failure,
                                         .state = state,
                                         .duty = render_pool_duty,
                                         .unwanted = render_pool_unwanted,
                                         .loaded = render_pool_loaded,
                                         .planned = render_pool_planned,
                                         .refuse = render_pool_refuse,
                                         .close = render_pool_close,
                                         .sent = render_pool_sent};
    return (uplink_handler_t){&calls, pool};
}
