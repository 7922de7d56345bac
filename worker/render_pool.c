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
 * A master that was restarted, or that gave this worker up, does not know what is in hand here and may assign
 * it once more. It is finished or will be soon, and must not be in a batch twice: samples that are in hand
 * are left out of an assignment. If the batch with them is refused, the master gives them out again.
 */
#include "worker/render_pool_state.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const double HOLD_SECONDS = 1.0; /* of work, queued ahead of the threads */
static const double UNIT_SECONDS = 0.4; /* of one thread, in a good unit */
static const double FIRST_SPEED = 20e3; /* pixel samples per thread and second, before any is measured */
static const double SPEED_WEIGHT = 0.2; /* of the newest unit in the running mean */
static const double MIN_UNIT_SAMPLES = 256;
static const double MAX_UNIT_SAMPLES = 1 << 26;

void render_pool_wake(int event)
{
    uint64_t one = 1;
    if (write(event, &one, sizeof one) != sizeof one) log_debug("an eventfd is full");
}

static double hold_samples(const render_pool_t *shop)
{
    return shop->speed * shop->thread_count * HOLD_SECONDS;
}

/* ---- render threads ----------------------------------------------------------------------------------- */

/* What a thread has in hand. */
typedef struct {
    unit_t unit;
    check_t *check; /* NULL: the unit is of the queue */
    size_t index;   /* in the check */
} piece_t;

/* Takes the next unit to render; false when there is none now. Lock held. */
static bool take_piece(render_pool_t *shop, piece_t *piece)
{
    if (shop->stage != STAGE_READY || shop->over) return false;
    check_t *check = checks_next(&shop->checks);
    if (check != NULL && !shop->draining) {
        *piece = (piece_t){check->units[check->begun], check, check->begun};
        check->begun++;
        check->rendering++;
    } else if (unit_queue_length(&shop->queue) > 0 && !atomic_load(&shop->full)) {
        *piece = (piece_t){.unit = unit_queue_pop(&shop->queue, &shop->current.settings)};
        shop->begun[shop->begun_count++] = piece->unit;
    } else {
        return false;
    }
    shop->rendering++;
    return true;
}

/* Values that the tiles of the open batch may have. */
static size_t most_values(const render_pool_t *shop)
{
    uint64_t share = shop->options.memory / BATCH_MEMORY_SHARE / sizeof(int64_t);
    return share < BATCH_MAX_VALUES ? (size_t)share : BATCH_MAX_VALUES;
}

static void add_to_batch(render_pool_t *shop, const unit_result_t *result)
{
    pthread_mutex_lock(&shop->fill);
    slot_t *slot = &shop->slots[shop->open];
    batch_t *batch = &slot->batch;
    if (batch->unit_count == 0) slot->since = clock_now();
    batch_add(batch, result);
    /* Each of the other threads may have one more unit in hand, which is added in any case. */
    bool full = batch->unit_count + (size_t)shop->options.threads >= WIRE_MAX_UNITS ||
                batch->eye_count + batch->feature_count >= most_values(shop);
    if (full) atomic_store(&shop->full, true);
    pthread_mutex_unlock(&shop->fill);
}

static void measure(render_pool_t *shop, const unit_t *unit, double seconds)
{
    if (seconds <= 0) return;
    double speed = (double)unit_samples(&shop->current.settings, unit) / seconds;
    shop->speed = shop->measured ? shop->speed + SPEED_WEIGHT * (speed - shop->speed) : speed;
    shop->measured = true;
}

/* Puts a piece away that was finished or given up. Lock held. */
static void end_piece(render_pool_t *shop, const piece_t *piece, unit_result_t *result)
{
    shop->rendering--;
    if (piece->check != NULL) {
        checks_finish(&shop->checks, piece->check, piece->index, result);
        return;
    }
    size_t i = 0;
    while (shop->begun[i].tile != piece->unit.tile || shop->begun[i].first != piece->unit.first) i++;
    shop->begun[i] = shop->begun[--shop->begun_count];
}

/* Called and left with the lock held. */
static void render_piece(render_pool_t *shop, const piece_t *piece, unit_result_t *result)
{
    const renderer_t *renderer = shop->renderer;
    bool low = (double)shop->queue.samples < 0.5 * hold_samples(shop);
    pthread_mutex_unlock(&shop->lock);

    if (low) render_pool_wake(shop->options.control_wake);
    double start = clock_now();
    bool complete = renderer_unit(renderer, &piece->unit, result, &shop->cancel);
    double seconds = clock_now() - start;
    if (complete && piece->check == NULL) add_to_batch(shop, result);

    pthread_mutex_lock(&shop->lock);
    if (complete) measure(shop, &piece->unit, seconds);
    end_piece(shop, piece, complete ? result : NULL);
    render_pool_wake(shop->options.bulk_wake);
}

static void *render_thread(void *argument)
{
    render_pool_t *shop = argument;
    unit_result_t result = {0};
    pthread_mutex_lock(&shop->lock);
    while (!shop->quit) {
        piece_t piece;
        if (take_piece(shop, &piece))
            render_piece(shop, &piece, &result);
        else
            pthread_cond_wait(&shop->work, &shop->lock);
    }
    pthread_mutex_unlock(&shop->lock);
    unit_result_free(&result);
    return NULL;
}

/* ---- life --------------------------------------------------------------------------------------------- */

static void start_threads(render_pool_t *shop, int count)
{
    shop->threads = mem_zalloc((size_t)count, sizeof *shop->threads);
    shop->begun = mem_zalloc((size_t)count, sizeof *shop->begun);
    for (int i = 0; i < count; i++) {
        if (pthread_create(&shop->threads[i], NULL, render_thread, shop) != 0) {
            log_warning("only %d of %d render threads could be started", i, count);
            break;
        }
        pthread_setname_np(shop->threads[i], "render");
        shop->thread_count = i + 1;
    }
}

render_pool_t *render_pool_new(const render_pool_options_t *options)
{
    render_pool_t *shop = mem_zalloc(1, sizeof *shop);
    shop->options = *options;
    pthread_mutex_init(&shop->lock, NULL);
    pthread_mutex_init(&shop->fill, NULL);
    pthread_cond_init(&shop->work, NULL);
    shop->speed = FIRST_SPEED;
    pthread_mutex_lock(&shop->lock);
    start_threads(shop, options->threads);
    pthread_mutex_unlock(&shop->lock);
    return shop;
}

void render_pool_stop(render_pool_t *shop)
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

void render_pool_destroy(render_pool_t **shop_pointer)
{
    render_pool_t *shop = *shop_pointer;
    if (shop == NULL) return;
    render_pool_stop(shop);
    renderer_destroy(&shop->renderer);
    blob_close(&shop->blob);
    if (shop->has_next) free(shop->next.units);
    for (size_t i = 0; i < shop->checks.count; i++) shop->checks.list[i]->under_way = false;
    checks_drop(&shop->checks, true);
    for (int i = 0; i < 2; i++) batch_free(&shop->slots[i].batch);
    pthread_cond_destroy(&shop->work);
    pthread_mutex_destroy(&shop->fill);
    pthread_mutex_destroy(&shop->lock);
    unit_queue_free(&shop->queue);
    free(shop->begun);
    free(shop->threads);
    free(shop);
    *shop_pointer = NULL;
}

/* ---- what is in hand; all under the lock -------------------------------------------------------------- */

/* Units in the open batch and in the one under way. */
static size_t batched_units(render_pool_t *shop)
{
    pthread_mutex_lock(&shop->fill);
    size_t count = shop->slots[shop->open].batch.unit_count;
    if (shop->under_way) count += shop->slots[!shop->open].batch.unit_count;
    pthread_mutex_unlock(&shop->fill);
    return count;
}

/* Copies units that were begun or finished and not acknowledged; returns how many. */
static size_t list_kept(render_pool_t *shop, unit_t *units, size_t capacity)
{
    size_t count = 0;
    for (size_t i = 0; i < shop->begun_count && count < capacity; i++) units[count++] = shop->begun[i];
    pthread_mutex_lock(&shop->fill);
    for (int s = 0; s < 2; s++) {
        const batch_t *batch = &shop->slots[s].batch;
        if (s != shop->open && !shop->under_way) continue;
        for (size_t i = 0; i < batch->unit_count && count < capacity; i++) units[count++] = batch->units[i];
    }
    pthread_mutex_unlock(&shop->fill);
    return count;
}

/* Everything that was asked of the job in hand has been done, sent and answered. */
bool render_pool_all_sent(render_pool_t *shop)
{
    return unit_queue_length(&shop->queue) == 0 && shop->rendering == 0 && batched_units(shop) == 0 &&
           checks_units(&shop->checks) == 0;
}

/* ---- news from the master ----------------------------------------------------------------------------- */

/* Queues the units of an assignment of the job in hand, without what is in hand already. */
static void queue_units(render_pool_t *shop, const assignment_t *assignment)
{
    if (assignment->check != 0) {
        checks_push(&shop->checks, assignment->check, assignment->units, assignment->unit_count);
        return;
    }
    size_t queued = unit_queue_length(&shop->queue);
    size_t most = queued + shop->begun_count + batched_units(shop);
    unit_t *held = mem_alloc((most + 1) * sizeof *held);
    size_t count = list_kept(shop, held, most);
    if (queued > most - count) queued = most - count;
    if (queued > 0) memcpy(held + count, shop->queue.units + shop->queue.first, queued * sizeof *held);
    for (size_t i = 0; i < assignment->unit_count; i++)
        unit_queue_push(&shop->queue, &assignment->settings, assignment->units[i], held, count + queued);
    free(held);
    free(assignment->units);
}

/* Takes an assignment as the job in hand, to be loaded. The stage is empty. */
void render_pool_begin_job(render_pool_t *shop, const assignment_t *assignment)
{
    shop->current = *assignment;
    shop->current.units = NULL;
    shop->stage = STAGE_LOADING;
    shop->over = shop->flush = false;
    shop->measured = false;
    atomic_store(&shop->cancel, false);
    for (int i = 0; i < 2; i++) batch_init(&shop->slots[i].batch, &assignment->settings);
    queue_units(shop, assignment);
}

/* Goes on with a job that was over (it had been paused): its scene is here. */
void render_pool_resume_job(render_pool_t *shop)
{
    for (int i = 0; i < 2; i++) batch_clear(&shop->slots[i].batch);
    checks_drop(&shop->checks, true);
    atomic_store(&shop->full, false);
    atomic_store(&shop->cancel, false);
    shop->over = shop->flush = shop->has_next = false;
    queue_units(shop, &shop->next);
    pthread_cond_broadcast(&shop->work);
}

static void drop_next(render_pool_t *shop)
{
    if (shop->has_next) free(shop->next.units);
    shop->has_next = false;
}

/* Lets the job in hand go. */
void render_pool_end_job(render_pool_t *shop, bool flush)
{
    shop->over = true;
    shop->flush = flush;
    atomic_store(&shop->cancel, true);
    unit_queue_clear(&shop->queue);
    checks_drop(&shop->checks, true);
}

/* True when the assignment is of the job in hand. A number alone says nothing: a master that lost its data
 * gives the old ones to new jobs. */
bool render_pool_is_current(const render_pool_t *shop, const assignment_t *assignment)
{
    return shop->stage != STAGE_EMPTY && shop->current.job == assignment->job &&
           hash_equal(&shop->current.content, &assignment->content);
}

static void assign(void *self, const assignment_t *assignment)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    shop->no_more = false;
    if (shop->draining) {
        free(assignment->units);
    } else if (shop->stage == STAGE_EMPTY) {
        render_pool_begin_job(shop, assignment);
    } else if (render_pool_is_current(shop, assignment) && !shop->over) {
        queue_units(shop, assignment);
    } else {
        if (shop->current.job == assignment->job && !render_pool_is_current(shop, assignment))
            render_pool_end_job(shop, false);
        drop_next(shop);
        shop->next = *assignment;
        shop->has_next = true;
    }
    pthread_cond_broadcast(&shop->work);
    pthread_mutex_unlock(&shop->lock);
    render_pool_wake(shop->options.bulk_wake);
}

static void no_more(void *self)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    shop->no_more = true;
    pthread_mutex_unlock(&shop->lock);
    render_pool_wake(shop->options.bulk_wake);
}

static void job_over(void *self, uint64_t job, bool flush)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    if (shop->stage != STAGE_EMPTY && shop->current.job == job) render_pool_end_job(shop, flush);
    if (shop->has_next && shop->next.job == job) drop_next(shop);
    pthread_mutex_unlock(&shop->lock);
    render_pool_wake(shop->options.bulk_wake);
}

static void forget(void *self)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    unit_queue_clear(&shop->queue);
    checks_drop(&shop->checks, true);
    drop_next(shop);
    shop->hurry = true;
    pthread_mutex_unlock(&shop->lock);
    render_pool_wake(shop->options.bulk_wake);
}

static size_t kept(void *self, uint64_t job, unit_t *units, size_t capacity)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    bool in_hand = shop->stage != STAGE_EMPTY && shop->current.job == job;
    size_t count = in_hand ? list_kept(shop, units, capacity) : 0;
    pthread_mutex_unlock(&shop->lock);
    return count;
}

static void drain(void *self)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    shop->draining = true;
    unit_queue_clear(&shop->queue);
    checks_drop(&shop->checks, false);
    drop_next(shop);
    if (shop->stage == STAGE_LOADING) render_pool_end_job(shop, false);
    pthread_mutex_unlock(&shop->lock);
    render_pool_wake(shop->options.bulk_wake);
}

static void give_up(void *self)
{
    render_pool_t *shop = self;
    atomic_store(&shop->cancel, true);
}

static void clear_failure(void *self)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    shop->failure = result_ok();
    pthread_mutex_unlock(&shop->lock);
}

/* ---- state -------------------------------------------------------------------------------------------- */

static double good_unit(const render_pool_t *shop)
{
    double samples = shop->speed * UNIT_SECONDS;
    if (samples < MIN_UNIT_SAMPLES) return MIN_UNIT_SAMPLES;
    return samples > MAX_UNIT_SAMPLES ? MAX_UNIT_SAMPLES : samples;
}

/* Pixel samples to ask for, given the units held. Lock held. */
static uint64_t samples_wanted(render_pool_t *shop, size_t units_held)
{
    if (shop->draining || shop->has_next || shop->failure.code != RESULT_OK) return 0;
    if (units_held > MAX_UNITS_HELD) return 0;
    if (shop->over && !(shop->flush && render_pool_all_sent(shop))) return 0;
    double hold = hold_samples(shop);
    double held = (double)(shop->queue.samples + checks_samples_left(&shop->checks, &shop->current.settings));
    if (hold < good_unit(shop)) hold = good_unit(shop);
    return held < 0.5 * hold ? (uint64_t)(hold - held) : 0;
}

static uplink_state_t state(void *self)
{
    render_pool_t *shop = self;
    uplink_state_t s = {.ready = true, .fingerprint = shop->options.fingerprint};
    pthread_mutex_lock(&shop->lock);
    size_t held = unit_queue_length(&shop->queue) + shop->begun_count + batched_units(shop) +
                  checks_units(&shop->checks);
    if (shop->has_next) held += shop->next.unit_count;
    bool dropped = shop->over && !shop->flush;
    s.threads = (uint32_t)shop->options.threads;
    s.job = shop->stage == STAGE_EMPTY || dropped ? 0 : shop->current.job;
    s.content = shop->current.content;
    s.units_held = (uint32_t)held;
    s.rendering = (uint32_t)shop->rendering;
    s.samples = samples_wanted(shop, held);
    s.unit_samples = (uint64_t)good_unit(shop);
    s.samples_per_second = shop->measured ? shop->speed * shop->thread_count : 0;
    s.idle = held == 0 || (dropped && shop->rendering == 0 && !shop->under_way);
    s.failure = shop->failure;
    s.failed = shop->failed;
    pthread_mutex_unlock(&shop->lock);
    return s;
}

uplink_handler_t render_pool_handler(render_pool_t *shop)
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
                                         .refuse = render_pool_refuse,
                                         .close = render_pool_close,
                                         .sent = render_pool_sent};
    return (uplink_handler_t){&calls, shop};
}
