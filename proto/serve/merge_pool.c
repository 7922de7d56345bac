/* merge_pool: see merge_pool.h.
 *
 * DESIGN. Two lists under one mutex: batches to be merged and batches that are done. What they may hold is
 * bounded from outside (grants.h). */
#include "proto/serve/merge_pool.h"

#include "common/memory_limit.h"
#include "common/thread.h"
#include "common/wake.h"

#include <stdlib.h>

enum { MAX_THREADS = 64 };

typedef struct task {
    merge_verdict_t verdict;
    struct task *next;
} task_t;

typedef struct {
    task_t *first, **last;
} list_t;

struct merge_pool {
    merge_pool_options_t options;
    pthread_t threads[MAX_THREADS];
    int thread_count;
    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t work;  /* something is waiting, or the pool stops */
    bool stop;
    list_t waiting, done;
};

/* ---- lists --------------------------------------------------------------------------------------------- */

static void list_put(list_t *list, task_t *task)
{
    task->next = NULL;
    *list->last = task;
    list->last = &task->next;
}

static task_t *list_take(list_t *list)
{
    task_t *task = list->first;
    if (task == NULL) return NULL;
    list->first = task->next;
    if (list->first == NULL) list->last = &list->first;
    return task;
}

static void list_free(list_t *list)
{
    for (task_t *task; (task = list_take(list)) != NULL; free(task)) {
        wire_free(task->verdict.message);
        free(task->verdict.message);
    }
}

/* ---- one batch ----------------------------------------------------------------------------------------- */

static void merge_task(merge_pool_t *pool, task_t *task)
{
    wire_message_t *message = task->verdict.message;
    double start = clock_now();
    task->verdict.result = pool->options.merge(pool->options.context, message);
    if (task->verdict.result.code == RESULT_OK)
        log_debug("a batch of %zu units, %zu bytes, merged in %.3f s",
                  message->envelope->batch_result->n_units, message->bytes, clock_now() - start);
    for (int i = 0; i < message->payload_count; i++) zmq_msg_close(&message->payload[i]);
    message->payload_count = 0;
}

/* ---- threads ------------------------------------------------------------------------------------------- */

/* The next batch to merge, when there is one; NULL when the pool stops. */
static task_t *next_task(merge_pool_t *pool)
{
    task_t *task = NULL;
    pthread_mutex_lock(&pool->lock);
    while (!pool->stop && (task = list_take(&pool->waiting)) == NULL)
        pthread_cond_wait(&pool->work, &pool->lock);
    pthread_mutex_unlock(&pool->lock);
    return task;
}

static void *merge_pool_run(void *argument)
{
    merge_pool_t *pool = argument;
    for (task_t *task; (task = next_task(pool)) != NULL;) {
        merge_task(pool, task);
        pthread_mutex_lock(&pool->lock);
        list_put(&pool->done, task);
        pthread_mutex_unlock(&pool->lock);
        wake_up(pool->options.wake);
    }
    return NULL;
}

result_t merge_pool_start(const merge_pool_options_t *options, merge_pool_t **out)
{
    merge_pool_t *pool = mem_zalloc(1, sizeof *pool);
    int wanted = int_min(options->threads > 0 ? options->threads : core_count(), MAX_THREADS);
    result_t result = result_ok();
    pool->options = *options;
    pool->waiting.last = &pool->waiting.first;
    pool->done.last = &pool->done.first;
    pthread_mutex_init(&pool->lock, NULL);
    pthread_cond_init(&pool->work, NULL);
    *out = pool;
    while (pool->thread_count < wanted && result.code == RESULT_OK) {
        result = thread_start(&pool->threads[pool->thread_count], "lm-merge", merge_pool_run, pool);
        pool->thread_count += result.code == RESULT_OK;
    }
    if (pool->thread_count > 0) return result_ok(); /* fewer do */
    merge_pool_stop(out);
    return result;
}

void merge_pool_stop(merge_pool_t **out)
{
    merge_pool_t *pool = *out;
    if (pool == NULL) return;
    pthread_mutex_lock(&pool->lock);
    pool->stop = true;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    for (int i = 0; i < pool->thread_count; i++) pthread_join(pool->threads[i], NULL);
    list_free(&pool->waiting);
    list_free(&pool->done);
    pthread_cond_destroy(&pool->work);
    pthread_mutex_destroy(&pool->lock);
    free(pool);
    *out = NULL;
}

void merge_pool_put(merge_pool_t *pool, wire_message_t *message, uint64_t memory)
{
    task_t *task = mem_alloc(sizeof *task);
    *task = (task_t){.verdict = {.message = message, .memory = memory}};
    pthread_mutex_lock(&pool->lock);
    list_put(&pool->waiting, task);
    pthread_cond_signal(&pool->work);
    pthread_mutex_unlock(&pool->lock);
}

bool merge_pool_next(merge_pool_t *pool, merge_verdict_t *verdict)
{
    pthread_mutex_lock(&pool->lock);
    task_t *task = list_take(&pool->done);
    pthread_mutex_unlock(&pool->lock);
    if (task == NULL) return false;
    *verdict = task->verdict;
    free(task);
    return true;
}
