/* canvas: see canvas.h. */
#include "master/canvas.h"

#include <pthread.h>
#include <stdlib.h>

struct canvas {
    film_t *film;
    pthread_rwlock_t lock;
    pthread_mutex_t adding;
};

canvas_t *canvas_new(film_t *film)
{
    canvas_t *canvas = mem_zalloc(1, sizeof *canvas);
    canvas->film = film;
    pthread_rwlock_init(&canvas->lock, NULL);
    pthread_mutex_init(&canvas->adding, NULL);
    return canvas;
}

void canvas_destroy(canvas_t **canvas)
{
    if (*canvas == NULL) return;
    film_destroy(&(*canvas)->film);
    pthread_rwlock_destroy(&(*canvas)->lock);
    pthread_mutex_destroy(&(*canvas)->adding);
    free(*canvas);
    *canvas = NULL;
}

void canvas_enter(canvas_t *canvas)
{
    pthread_rwlock_rdlock(&canvas->lock);
}

void canvas_leave(canvas_t *canvas)
{
    pthread_rwlock_unlock(&canvas->lock);
}

result_t canvas_merge_payload(canvas_t *canvas, const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch,
                              const uint32_t *weights, int sign)
{
    (void)weights, (void)sign;
    batch_t decoded = *batch;
    decoded.eye = decoded.splat = decoded.features = NULL;
    decoded.eye_capacity = decoded.feature_capacity = decoded.eye_count = decoded.feature_count = 0;
    result_t result = payload_decode(payload, &decoded);
    if (result.code == RESULT_OK) {
        pthread_mutex_lock(&canvas->adding);
        film_merge(canvas->film, &decoded);
        pthread_mutex_unlock(&canvas->adding);
    }
    free(decoded.eye);
    free(decoded.splat);
    free(decoded.features);
    return result;
}

film_counts_t canvas_counts(canvas_t *canvas)
{
    pthread_mutex_lock(&canvas->adding);
    film_counts_t counts = canvas->film->counts;
    pthread_mutex_unlock(&canvas->adding);
    return counts;
}

const film_t *canvas_lock(canvas_t *canvas)
{
    pthread_rwlock_wrlock(&canvas->lock);
    return canvas->film;
}

void canvas_unlock(canvas_t *canvas)
{
    pthread_rwlock_unlock(&canvas->lock);
}
