/* render_pool_duties: what the render pool has the bulk thread do: load scenes, send batches (see
 * uplink_handler.h and the note in render_pool.c). */
#include "worker/render_pool_state.h"

/* The job in hand is to be let go now: it is over, or finished and another one waits. A paused one may go on
 * later, so its scene stays until it is in the way. Lock held. */
static bool time_to_release(render_pool_t *shop)
{
    if (shop->stage == STAGE_EMPTY || shop->rendering > 0) return false;
    if (shop->over && !shop->flush) return true;
    return shop->has_next && render_pool_all_sent(shop);
}

/* Lets the job in hand go and takes up the next. Called and left with the lock held, which is free while the
 * scene is torn down. */
static void release_job(render_pool_t *shop)
{
    if (shop->has_next && render_pool_is_current(shop, &shop->next) && shop->stage == STAGE_READY) {
        render_pool_resume_job(shop);
        return;
    }
    renderer_t *renderer = shop->renderer;
    unit_queue_clear(&shop->queue);
    checks_drop(&shop->checks, true);
    for (int i = 0; i < 2; i++) {
        batch_free(&shop->slots[i].batch);
        shop->slots[i].batch = (batch_t){0};
    }
    shop->renderer = NULL;
    shop->stage = STAGE_EMPTY;
    shop->over = shop->flush = shop->hurry = false;
    atomic_store(&shop->full, false);
    if (shop->has_next) {
        shop->has_next = false;
        render_pool_begin_job(shop, &shop->next);
    }
    pthread_mutex_unlock(&shop->lock);
    renderer_destroy(&renderer);
    blob_close(&shop->blob);
    render_pool_wake(shop->options.control_wake);
    pthread_mutex_lock(&shop->lock);
}

/* Two splat frames must fit into memory with something to spare for the scene. */
static result_t check_memory(const render_pool_t *shop)
{
    const job_settings_t *settings = &shop->current.settings;
    double need = 2.0 * (double)sizeof(int64_t) * (double)batch_splat_values(settings);
    double have = (double)shop->options.memory;
    if (need < 0.75 * have) return result_ok();
    return result_fail(RESULT_LIMIT, "an image of %d x %d takes %.1f GB of sums; this machine has %.1f GB",
                       settings->width, settings->height, 1e-9 * need, 1e-9 * have);
}

/* Lets the job go that cannot be rendered here. Lock held. */
static void refuse_job(render_pool_t *shop, result_t why)
{
    render_pool_end_job(shop, false);
    shop->failure = why;
    shop->failed = shop->current.job;
    render_pool_wake(shop->options.control_wake);
}

/* Nothing will be added to the open batch for now. Lock held. */
static bool nothing_coming(const render_pool_t *shop)
{
    bool last = shop->no_more || shop->has_next || shop->draining || shop->over;
    return last && unit_queue_length(&shop->queue) == 0 && shop->begun_count == 0;
}

static void set_offer(const render_pool_t *shop, uint64_t check, uint64_t bytes, duty_t *duty)
{
    duty->kind = DUTY_OFFER;
    duty->offer =
        (offer_t){.job = shop->current.job, .check = check, .content = shop->current.content, .bytes = bytes};
}

/* Finds a batch that is to be sent; else tells in duty->wait when one will be. Lock held. */
static void find_batch(render_pool_t *shop, double batch_interval, duty_t *duty)
{
    const check_t *check = checks_complete(&shop->checks);
    if (check != NULL) {
        set_offer(shop, check->number, checks_bytes(check, &shop->current.settings), duty);
        return;
    }
    pthread_mutex_lock(&shop->fill);
    const slot_t *slot = &shop->slots[shop->open];
    size_t units = slot->batch.unit_count;
    if (units > 0 && !shop->under_way) {
        duty->wait = slot->since + batch_interval - clock_now();
        bool full = units >= BATCH_MAX_UNITS || atomic_load(&shop->full);
        if (duty->wait <= 0 || full || shop->hurry || nothing_coming(shop))
            set_offer(shop, 0, batch_bytes(&slot->batch), duty);
    }
    pthread_mutex_unlock(&shop->fill);
}

duty_t render_pool_duty(void *self, double batch_interval)
{
    render_pool_t *shop = self;
    duty_t duty = {.kind = DUTY_NONE, .wait = 1};
    pthread_mutex_lock(&shop->lock);
    if (time_to_release(shop)) release_job(shop);
    if (shop->stage == STAGE_LOADING && !shop->over) {
        result_t memory = check_memory(shop);
        if (memory.code == RESULT_OK) {
            duty.kind = DUTY_LOAD;
            duty.assignment = shop->current;
        } else {
            refuse_job(shop, memory);
            duty.wait = 0;
        }
    } else if (shop->stage == STAGE_READY && !(shop->over && !shop->flush)) {
        find_batch(shop, batch_interval, &duty);
    }
    pthread_mutex_unlock(&shop->lock);
    return duty;
}

bool render_pool_unwanted(void *self, uint64_t job)
{
    render_pool_t *shop = self;
    pthread_mutex_lock(&shop->lock);
    bool over = shop->over && (!shop->flush || shop->stage == STAGE_LOADING);
    bool wanted = shop->stage != STAGE_EMPTY && shop->current.job == job && !over;
    pthread_mutex_unlock(&shop->lock);
    return !wanted;
}

result_t render_pool_loaded(void *self, uint64_t job, scene_blob_t *blob)
{
    render_pool_t *shop = self;
    (void)job; /* the one in hand: only the bulk thread, which calls this, lets it go */
    double start = clock_now();
    renderer_t *renderer;
    shop->blob = *blob;
    result_t result = renderer_new(&shop->blob, &shop->current.settings, &renderer);
    if (result.code != RESULT_OK) {
        blob_close(&shop->blob);
        return result;
    }
    log_debug("the scene was made ready to trace in %.2f s", clock_now() - start);
    pthread_mutex_lock(&shop->lock);
    shop->renderer = renderer;
    shop->stage = STAGE_READY;
    pthread_cond_broadcast(&shop->work);
    pthread_mutex_unlock(&shop->lock);
    render_pool_wake(shop->options.control_wake);
    return result_ok();
}

void render_pool_refuse(void *self, uint64_t job, result_t why)
{
    render_pool_t *shop = self;
    (void)job;
    pthread_mutex_lock(&shop->lock);
    refuse_job(shop, why);
    pthread_mutex_unlock(&shop->lock);
}

/* Closes the open batch; NULL when it is empty. Lock held. */
static const batch_t *close_open(render_pool_t *shop)
{
    const batch_t *batch = NULL;
    pthread_mutex_lock(&shop->fill);
    if (shop->slots[shop->open].batch.unit_count > 0) {
        batch = &shop->slots[shop->open].batch;
        shop->open = !shop->open;
        shop->under_way = true;
        shop->hurry = false;
        atomic_store(&shop->full, false);
        pthread_cond_broadcast(&shop->work);
    }
    pthread_mutex_unlock(&shop->fill);
    return batch;
}

closed_batch_t render_pool_close(void *self, const offer_t *offer)
{
    render_pool_t *shop = self;
    closed_batch_t closed = {.offer = *offer};
    pthread_mutex_lock(&shop->lock);
    bool wanted = shop->stage == STAGE_READY && shop->current.job == offer->job &&
                  (!shop->over || (shop->flush && offer->check == 0));
    check_t *check = wanted && offer->check != 0 ? checks_find(&shop->checks, offer->check) : NULL;
    if (check != NULL) {
        checks_close(check, &shop->current.settings);
        closed.batch = &check->batch;
    } else if (wanted && offer->check == 0) {
        closed.batch = close_open(shop);
    }
    if (closed.batch != NULL) closed.sequence = ++shop->sequence;
    pthread_mutex_unlock(&shop->lock);
    return closed;
}

void render_pool_sent(void *self, const closed_batch_t *closed, bool counted)
{
    render_pool_t *shop = self;
    (void)counted; /* what was refused, the master gives out again */
    pthread_mutex_lock(&shop->lock);
    for (size_t i = 0; i < shop->checks.count; i++) {
        check_t *check = shop->checks.list[i];
        if (&check->batch != closed->batch) continue;
        check->under_way = false;
        check->dropped = true;
    }
    checks_sweep(&shop->checks);
    pthread_cond_broadcast(&shop->work); /* the next check may begin */
    if (closed->offer.check == 0) shop->under_way = false;
    slot_t *slot = &shop->slots[!shop->open];
    pthread_mutex_unlock(&shop->lock);
    /* Only the bulk thread, which calls this, touches the closed slot: the long clearing needs no lock. */
    if (closed->offer.check == 0) batch_clear(&slot->batch);
    render_pool_wake(shop->options.control_wake);
}
