/* render_pool_duties: what the render pool has the bulk thread do: load scenes, send batches (see
 * uplink_handler.h and the note in render_pool.c). */
#include "worker/render_pool_state.h"

#include "common/memory_limit.h"

#include <stdlib.h>

static const double MEASURE_INTERVAL = 60; /* seconds between looks at a link that is too slow */

/* The job in hand is to be let go now: it is over, or finished and another one waits. A paused one may go on
 * later, so its scene stays until it is in the way. Lock held. */
static bool time_to_release(render_pool_t *pool)
{
    if (pool->stage == STAGE_EMPTY || pool->rendering > 0) return false;
    if (pool->over && !pool->flush) return true;
    return pool->has_next && render_pool_all_sent(pool);
}

/* Lets the job in hand go and takes up the next. Called and left with the lock held, which is free while the
 * scene is torn down. */
static void release_job(render_pool_t *pool)
{
    if (pool->has_next && render_pool_is_current(pool, &pool->next) && pool->stage == STAGE_READY) {
        render_pool_resume_job(pool);
        return;
    }
    renderer_t *renderer = pool->renderer;
    unit_queue_clear(&pool->queue);
    checks_drop(&pool->checks, true);
    for (int i = 0; i < 2; i++) {
        batch_free(&pool->slots[i].batch);
        pool->slots[i].batch = (batch_t){0};
    }
    pool->renderer = NULL;
    pool->stage = STAGE_EMPTY;
    pace_rest(&pool->pace, clock_now());
    pool->over = pool->flush = pool->hurry = false;
    atomic_store(&pool->full, false);
    if (pool->has_next) {
        pool->has_next = false;
        render_pool_begin_job(pool, &pool->next);
    }
    pthread_mutex_unlock(&pool->lock);
    renderer_destroy(&renderer);
    blob_close(&pool->blob);
    wake_up(pool->options.control_wake);
    pthread_mutex_lock(&pool->lock);
}

/* Bytes that rendering takes beside the scene: two batches with their frames, the coded form of one, and what
 * the threads have in hand. */
static double rendering_bytes(const render_pool_t *pool)
{
    const double thread = 16e6;
    return 2.5 * (double)sum_frame_bytes(&pool->current.settings) + thread * pool->options.threads;
}

/* Two frames of sums must fit into memory with something to spare for the scene, and `more` bytes beside all
 * that is needed to render must be there: nothing that follows survives if they are not. */
static result_t check_memory(const render_pool_t *pool, double more)
{
    const job_settings_t *settings = &pool->current.settings;
    double frames = 2.0 * (double)sum_frame_bytes(settings), need = rendering_bytes(pool) + more;
    double have = (double)pool->options.memory;
    if (frames >= 0.75 * have)
        return result_fail(RESULT_LIMIT,
                           "an image of %d x %d takes %.1f GB of sums; this machine has %.1f GB",
                           settings->width, settings->height, 1e-9 * frames, 1e-9 * have);
    if (memory_is_there((uint64_t)need)) return result_ok();
    return result_fail(
        RESULT_LIMIT,
        "an image of %d x %d with its scene takes %.1f GB more, which this process, limited to "
        "%.1f GB, cannot get",
        settings->width, settings->height, 1e-9 * need, 1e-9 * have);
}

/* Lets the job go that cannot be rendered here. Lock held. */
static void refuse_job(render_pool_t *pool, result_t why)
{
    render_pool_end_job(pool, false);
    pool->failure = why;
    pool->failed = pool->current.job;
    wake_up(pool->options.control_wake);
}

/* Nothing will be added to the open batch for now. Lock held. */
static bool nothing_coming(const render_pool_t *pool)
{
    bool last = pool->no_more || pool->has_next || pool->draining || pool->over;
    return last && unit_queue_length(&pool->queue) == 0 && pool->begun_count == 0;
}

static void set_offer(const render_pool_t *pool, uint64_t check, uint64_t bytes, duty_t *duty)
{
    duty->kind = DUTY_OFFER;
    duty->offer =
        (offer_t){.job = pool->current.job, .check = check, .content = pool->current.content, .bytes = bytes};
}

/* A slow link has enough to do with what is in the open batch. Both locks held. */
static bool enough_for_link(const render_pool_t *pool, const batch_t *batch)
{
    if (!render_pool_slow(pool)) return false;
    load_t load = render_pool_load(pool, batch->units, batch->unit_count);
    return pace_bytes(&pool->pace, &load) >= pace_batch_bytes(&pool->pace, clock_now());
}

/* The link is too slow for the job in hand, and it is time to see whether it is still. */
static bool time_to_measure(render_pool_t *pool)
{
    if (!render_pool_slow(pool) || pace_hopeless(&pool->pace) <= 0) return false;
    double now = clock_now();
    bool first = pool->next_measure <= 0, due = !first && now >= pool->next_measure;
    if (first || due) pool->next_measure = now + MEASURE_INTERVAL;
    return due;
}

/* Finds a batch that is to be sent; else tells in duty->wait when one will be. Lock held. */
static void find_batch(render_pool_t *pool, double batch_interval, duty_t *duty)
{
    const unit_check_t *check = checks_complete(&pool->checks);
    if (check != NULL) {
        set_offer(pool, check->number, checks_bytes(check, &pool->current.settings), duty);
        return;
    }
    pthread_mutex_lock(&pool->fill);
    const slot_t *slot = &pool->slots[pool->open];
    size_t units = slot->batch.unit_count;
    if (units > 0 && !pool->under_way) {
        duty->wait = slot->since + batch_interval - clock_now();
        bool full =
            units >= BATCH_MAX_UNITS || atomic_load(&pool->full) || enough_for_link(pool, &slot->batch);
        if (duty->wait <= 0 || full || pool->hurry || nothing_coming(pool))
            set_offer(pool, 0, batch_bytes(&slot->batch), duty);
    }
    pthread_mutex_unlock(&pool->fill);
}

/* The pass of a unit in hand that waits for its plan; LEARNING_PASSES: none does. Lock held. */
static uint32_t lacking_pass(const render_pool_t *pool)
{
    const job_settings_t *settings = &pool->current.settings;
    const unit_check_t *check = checks_next(&pool->checks);
    for (size_t i = check != NULL ? check->begun : 0; check != NULL && i < check->count; i++)
        if (!learning_ready(settings, check->units[i].first, pool->plans))
            return learning_pass(settings, check->units[i].first);
    return unit_queue_lacks(&pool->queue, settings, pool->plans);
}

/* Finds a plan that is to be fetched. Lock held. */
static void find_plan(const render_pool_t *pool, duty_t *duty)
{
    duty->pass = lacking_pass(pool);
    if (duty->pass == LEARNING_PASSES || pool->over) return;
    duty->kind = DUTY_PLAN;
    duty->assignment = pool->current;
}

duty_t render_pool_duty(void *self, double batch_interval, double rate)
{
    render_pool_t *pool = self;
    duty_t duty = {.kind = DUTY_NONE, .wait = 1};
    pthread_mutex_lock(&pool->lock);
    pool->pace.interval = batch_interval;
    pool->pace.rate = rate;
    if (time_to_release(pool)) release_job(pool);
    if (pool->stage == STAGE_LOADING && !pool->over) {
        result_t memory = check_memory(pool, (double)pool->current.blob_size);
        if (memory.code == RESULT_OK) {
            duty.kind = DUTY_LOAD;
            duty.assignment = pool->current;
        } else {
            refuse_job(pool, memory);
            duty.wait = 0;
        }
    } else if (pool->stage == STAGE_READY && !(pool->over && !pool->flush)) {
        /* Threads may wait for a plan. But one that does not come keeps no batch. */
        if (!pool->fetched) find_plan(pool, &duty);
        if (duty.kind == DUTY_NONE) find_batch(pool, batch_interval, &duty);
        if (duty.kind == DUTY_NONE) find_plan(pool, &duty);
        pool->fetched = duty.kind == DUTY_PLAN;
        if (duty.kind == DUTY_NONE && time_to_measure(pool)) duty.kind = DUTY_MEASURE;
    }
    pthread_mutex_unlock(&pool->lock);
    return duty;
}

bool render_pool_unwanted(void *self, uint64_t job)
{
    render_pool_t *pool = self;
    pthread_mutex_lock(&pool->lock);
    bool over = pool->over && (!pool->flush || pool->stage == STAGE_LOADING);
    bool wanted = pool->stage != STAGE_EMPTY && pool->current.job == job && !over;
    pthread_mutex_unlock(&pool->lock);
    return !wanted;
}

result_t render_pool_loaded(void *self, uint64_t job, scene_blob_t *blob)
{
    render_pool_t *pool = self;
    (void)job; /* the one in hand: only the bulk thread, which calls this, lets it go */
    double start = clock_now();
    renderer_t *renderer;
    pool->blob = *blob;
    result_t result = check_memory(pool, (double)renderer_memory(&pool->blob, &pool->current.settings));
    if (result.code == RESULT_OK) result = renderer_new(&pool->blob, &pool->current.settings, &renderer);
    if (result.code == RESULT_OK) { /* the estimate may have been too low */
        result = check_memory(pool, 0);
        if (result.code != RESULT_OK) renderer_destroy(&renderer);
    }
    if (result.code != RESULT_OK) {
        blob_close(&pool->blob);
        return result;
    }
    log_debug("the scene was made ready to trace in %.2f s", clock_now() - start);
    pthread_mutex_lock(&pool->lock);
    pool->renderer = renderer;
    pool->stage = STAGE_READY;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    wake_up(pool->options.control_wake);
    return result_ok();
}

result_t render_pool_planned(void *self, const assignment_t *assignment, uint32_t pass, const uint8_t *bytes,
                             size_t size)
{
    render_pool_t *pool = self;
    learning_plan_t plan;
    TRY(learning_plan_read(bytes, size, &assignment->content, &plan));
    if (plan.pass != pass)
        return result_fail(RESULT_MISMATCH, "a plan of pass %u where that of pass %u is due", plan.pass,
                           pass);
    renderer_plan(pool->renderer, &plan); /* no thread has a unit of this pass before */
    pthread_mutex_lock(&pool->lock);
    pool->plans |= UINT32_C(1) << pass;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    return result_ok();
}

void render_pool_refuse(void *self, uint64_t job, result_t why)
{
    render_pool_t *pool = self;
    (void)job;
    pthread_mutex_lock(&pool->lock);
    refuse_job(pool, why);
    pthread_mutex_unlock(&pool->lock);
}

/* How the units of a batch were issued, in fresh memory. Lock held. */
static issue_t *issues_of(render_pool_t *pool, const batch_t *batch, const unit_check_t *check)
{
    issue_t *issues = mem_zalloc(batch->unit_count + 1, sizeof *issues);
    if (check == NULL) issued_find(&pool->issued, batch->units, batch->unit_count, issues);
    for (size_t i = 0; check != NULL && check->macs != NULL && i < check->count; i++)
        issues[i].mac = check->macs[i]; /* in the order of its units */
    return issues;
}

/* What is not in hand any more need not be known. Lock held. */
static void forget_issued(render_pool_t *pool)
{
    size_t count;
    unit_t *units = render_pool_units(pool, &count);
    issued_keep(&pool->issued, units, count);
    free(units);
}

/* Closes the open batch; NULL when it is empty. Lock held. */
static batch_t *close_open(render_pool_t *pool)
{
    batch_t *batch = NULL;
    pthread_mutex_lock(&pool->fill);
    if (pool->slots[pool->open].batch.unit_count > 0) {
        batch = &pool->slots[pool->open].batch;
        pool->open = !pool->open;
        pool->under_way = true;
        pool->hurry = false;
        atomic_store(&pool->full, false);
        pthread_cond_broadcast(&pool->work);
    }
    pthread_mutex_unlock(&pool->fill);
    return batch;
}

closed_batch_t render_pool_close(void *self, const offer_t *offer)
{
    render_pool_t *pool = self;
    closed_batch_t closed = {.offer = *offer};
    pthread_mutex_lock(&pool->lock);
    bool wanted = pool->stage == STAGE_READY && pool->current.job == offer->job &&
                  (!pool->over || (pool->flush && offer->check == 0));
    unit_check_t *check = wanted && offer->check != 0 ? checks_find(&pool->checks, offer->check) : NULL;
    if (check != NULL) {
        checks_close(check);
        closed.batch = &check->batch;
    } else if (wanted && offer->check == 0) {
        closed.batch = close_open(pool);
    }
    if (closed.batch != NULL) {
        closed.sequence = ++pool->sequence;
        closed.issues = issues_of(pool, closed.batch, check);
    }
    pthread_mutex_unlock(&pool->lock);
    return closed;
}

void render_pool_sent(void *self, const closed_batch_t *closed, bool counted)
{
    render_pool_t *pool = self;
    (void)counted; /* what was refused, the master gives out again */
    pthread_mutex_lock(&pool->lock);
    for (size_t i = 0; i < pool->checks.count; i++) {
        unit_check_t *check = pool->checks.list[i];
        if (&check->batch != closed->batch) continue;
        check->under_way = false;
        check->dropped = true;
    }
    checks_sweep(&pool->checks);
    pthread_cond_broadcast(&pool->work); /* the next check may begin */
    if (closed->offer.check == 0) {
        pool->under_way = false;
        forget_issued(pool);
    }
    slot_t *slot = &pool->slots[!pool->open];
    if (closed->offer.check == 0 && closed->coded[SUM_EYE] > 0) {
        load_t load = render_pool_load(pool, slot->batch.units, slot->batch.unit_count);
        pace_learn(&pool->pace, &load, closed->coded);
    }
    pthread_mutex_unlock(&pool->lock);
    /* Only the bulk thread, which calls this, touches the closed slot: the long clearing needs no lock. */
    if (closed->offer.check == 0) batch_clear(&slot->batch);
    wake_up(pool->options.control_wake);
}
