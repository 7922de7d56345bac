/* prepared: see prepared.h. */
#include "tests/sim/prepared.h"

#include "client/import/import.h"
#include "worker/render/renderer.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum {
    LEVELS = 6,         /* each of twice the seconds of the one before */
    FIRST_SAMPLE = 256, /* beyond the samples that have features */
    UNIT_SAMPLES = 128, /* a unit of some tenths of a second; it lies within a pass */
    TILE_STEP = 7919    /* a prime: rendered tiles lie all over the image */
};

typedef struct {
    double seconds, density;
    zmq_msg_t frame;
} level_t;

/* The eye tiles of batches with so many values in all. */
typedef struct {
    size_t values;
    zmq_msg_t frame;
} eye_t;

struct prepared {
    uint8_t *bytes;
    scene_blob_t blob;
    job_settings_t settings;
    double speed;
    level_t levels[LEVELS];
    zmq_msg_t lessons[LEARNING_PASSES]; /* of a batch that has units of this pass; empty: it teaches none */
    int64_t *eye;                       /* some eye sums */
    size_t eye_count;
    pthread_mutex_t lock; /* guards what follows */
    eye_t *eyes;
    size_t eyes_count;
};

static double thread_cpu(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static double density_of(const batch_t *batch)
{
    const sum_array_t *splats = &batch->sums[SUM_SPLAT];
    size_t pixels = sum_image_values(&batch->settings, SUM_SPLAT) / 3, hit = 0;
    for (size_t v = 0; v < splats->count; v += 3)
        hit += (splats->values[v] | splats->values[v + 1] | splats->values[v + 2]) != 0;
    return (double)hit / (double)pixels;
}

/* Keeps the splat frame of a batch as it is now. */
static result_t keep_level(level_t *level, const batch_t *batch, double seconds)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    TRY(payload_encode(batch, payload));
    level->seconds = seconds;
    level->density = density_of(batch);
    zmq_msg_init(&level->frame);
    zmq_msg_move(&level->frame, &payload[1]);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    return result_ok();
}

/* The lessons of a few units, [LEARNING_PLACES], in a batch that the caller frees. */
static const int64_t *some_lessons(const prepared_t *prepared, const renderer_t *renderer, batch_t *batch)
{
    enum { TILES = 64 };
    unit_result_t unit_result = {0};
    atomic_bool cancel = false;
    batch_init(batch, &prepared->settings);
    for (uint32_t i = 0; i < TILES; i++) {
        unit_t unit = {(uint32_t)((uint64_t)i * TILE_STEP % job_tile_count(&prepared->settings)), 0, 2};
        renderer_unit(renderer, &unit, &unit_result, &cancel);
        batch_add(batch, &unit_result);
    }
    unit_result_free(&unit_result);
    return batch_frame(batch, SUM_LESSONS);
}

/* Makes lesson frames for batches of each pass, like those of a rendered batch, but such that units of any
 * size may have them. */
static result_t keep_lessons(prepared_t *prepared, const renderer_t *renderer)
{
    const job_settings_t *settings = &prepared->settings;
    batch_t rendered;
    const int64_t *from = some_lessons(prepared, renderer, &rendered);
    result_t result = result_ok();
    for (uint32_t pass = 0; pass < learning_taught(settings) && result.code == RESULT_OK; pass++) {
        batch_t batch;
        zmq_msg_t payload[BATCH_PAYLOADS];
        batch_init(&batch, settings);
        int64_t *to = batch_frame(&batch, SUM_LESSONS) + pass * LEARNING_PLACES;
        for (size_t i = 0; i < LEARNING_PLACES; i++) to[i] = from[i] & ((1 << LEARNING_BITS) - 1);
        result = payload_encode(&batch, payload);
        batch_free(&batch);
        if (result.code != RESULT_OK) break;
        zmq_msg_move(&prepared->lessons[pass], &payload[SUM_LESSONS]);
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    }
    batch_free(&rendered);
    return result;
}

static result_t render(prepared_t *prepared, double seconds)
{
    renderer_t *renderer;
    TRY(renderer_new(&prepared->blob, &prepared->settings, &renderer));
    batch_t batch;
    unit_result_t unit_result = {0};
    atomic_bool cancel = false;
    result_t result = result_ok();
    uint32_t tiles = job_tile_count(&prepared->settings);
    uint64_t samples = 0;
    double start = thread_cpu(), spent = 0;
    batch_init(&batch, &prepared->settings);
    for (uint32_t i = 0, level = 0; level < LEVELS && result.code == RESULT_OK; i++) {
        unit_t unit = {(uint32_t)((uint64_t)i * TILE_STEP % tiles), FIRST_SAMPLE + i / tiles * UNIT_SAMPLES,
                       UNIT_SAMPLES};
        renderer_unit(renderer, &unit, &unit_result, &cancel);
        batch_add(&batch, &unit_result);
        samples += (uint64_t)UNIT_SAMPLES * job_tile_pixels(&prepared->settings, unit.tile);
        spent = thread_cpu() - start;
        for (; level < LEVELS && spent >= ldexp(seconds, (int)level - LEVELS + 1); level++) {
            if (result.code == RESULT_OK) result = keep_level(&prepared->levels[level], &batch, spent);
        }
    }
    prepared->speed = (double)samples / spent;
    if (result.code == RESULT_OK && job_learns(&prepared->settings))
        result = keep_lessons(prepared, renderer);
    prepared->eye = batch.sums[SUM_EYE].values;
    prepared->eye_count = batch.sums[SUM_EYE].count;
    batch.sums[SUM_EYE].values = NULL;
    batch_free(&batch);
    unit_result_free(&unit_result);
    renderer_destroy(&renderer);
    return result;
}

result_t prepared_new(const char *scene, int width, int height, double seconds, bool learn, prepared_t **out)
{
    prepared_t *prepared = mem_zalloc(1, sizeof *prepared);
    uint64_t size;
    pthread_mutex_init(&prepared->lock, NULL);
    for (int i = 0; i < LEVELS; i++) zmq_msg_init(&prepared->levels[i].frame);
    for (int i = 0; i < LEARNING_PASSES; i++) zmq_msg_init(&prepared->lessons[i]);
    result_t result = import_scene_blob(scene, NULL, &prepared->bytes, &size);
    if (result.code == RESULT_OK) result = blob_open(prepared->bytes, size, &prepared->blob);
    if (result.code == RESULT_OK) {
        prepared->settings = blob_default_settings(&prepared->blob);
        prepared->settings.width = width;
        prepared->settings.height = height;
        prepared->settings.features = false;
        prepared->settings.learn = learn;
        prepared->settings.spp = 1 << 24;
        result = render(prepared, seconds);
    }
    *out = prepared;
    if (result.code != RESULT_OK) prepared_destroy(out);
    return result;
}

void prepared_destroy(prepared_t **pointer)
{
    prepared_t *prepared = *pointer;
    if (prepared == NULL) return;
    for (int i = 0; i < LEVELS; i++) zmq_msg_close(&prepared->levels[i].frame);
    for (int i = 0; i < LEARNING_PASSES; i++) zmq_msg_close(&prepared->lessons[i]);
    for (size_t i = 0; i < prepared->eyes_count; i++) zmq_msg_close(&prepared->eyes[i].frame);
    pthread_mutex_destroy(&prepared->lock);
    free(prepared->eyes);
    sum_values_free(prepared->eye);
    free(prepared->bytes);
    free(prepared);
    *pointer = NULL;
}

const scene_blob_t *prepared_blob(const prepared_t *prepared)
{
    return &prepared->blob;
}

const job_settings_t *prepared_settings(const prepared_t *prepared)
{
    return &prepared->settings;
}

double prepared_speed(const prepared_t *prepared)
{
    return prepared->speed;
}

/* The level that is nearest to so many seconds. */
static const level_t *level_of(const prepared_t *prepared, double seconds)
{
    int best = 0;
    for (int i = 1; i < LEVELS; i++)
        if (prepared->levels[i].seconds * prepared->levels[i - 1].seconds <= seconds * seconds) best = i;
    return &prepared->levels[best];
}

double prepared_density(const prepared_t *prepared, double seconds)
{
    return level_of(prepared, seconds)->density;
}

size_t prepared_bytes(const prepared_t *prepared, double seconds)
{
    return zmq_msg_size(&level_of(prepared, seconds)->frame);
}

static void keep(void *bytes, void *hint)
{
    (void)bytes, (void)hint;
}

/* A message of the same bytes, which are not copied. */
static void share(const zmq_msg_t *frame, zmq_msg_t *message)
{
    zmq_msg_init_data(message, zmq_msg_data((zmq_msg_t *)frame), zmq_msg_size(frame), keep, NULL);
}

/* Eye tiles of so many values: pieces of what was rendered, encoded when they are first asked for. */
static const zmq_msg_t *eye_frame(prepared_t *prepared, size_t values)
{
    for (size_t i = 0; i < prepared->eyes_count; i++)
        if (prepared->eyes[i].values == values) return &prepared->eyes[i].frame;
    batch_t batch = {.settings = prepared->settings};
    sum_array_reserve(&batch.sums[SUM_EYE], values);
    batch.sums[SUM_EYE].count = values;
    for (size_t at = 0; at < values; at += prepared->eye_count) {
        size_t part = values - at < prepared->eye_count ? values - at : prepared->eye_count;
        memcpy(batch.sums[SUM_EYE].values + at, prepared->eye, part * sizeof *batch.sums[SUM_EYE].values);
    }
    zmq_msg_t payload[BATCH_PAYLOADS];
    result_t result = payload_encode(&batch, payload);
    sum_array_free(&batch.sums[SUM_EYE]);
    if (result.code != RESULT_OK) {
        log_error("%s", result.message);
        abort();
    }
    prepared->eyes = mem_realloc(prepared->eyes, (prepared->eyes_count + 1) * sizeof *prepared->eyes);
    eye_t *eye = &prepared->eyes[prepared->eyes_count++];
    eye->values = values;
    zmq_msg_init(&eye->frame);
    zmq_msg_move(&eye->frame, &payload[0]);
    return &eye->frame;
}

void prepared_payloads(prepared_t *prepared, const unit_t *units, size_t count, double seconds,
                       zmq_msg_t payload[BATCH_PAYLOADS])
{
    size_t values = 0;
    for (size_t i = 0; i < count; i++) values += sum_unit_values(&prepared->settings, SUM_EYE, &units[i]);
    pthread_mutex_lock(&prepared->lock);
    share(eye_frame(prepared, values), &payload[0]);
    pthread_mutex_unlock(&prepared->lock);
    share(&level_of(prepared, seconds)->frame, &payload[1]);
    for (int i = 2; i < BATCH_PAYLOADS; i++) zmq_msg_init(&payload[i]);
    uint32_t pass = learning_pass(&prepared->settings, units[0].first);
    if (zmq_msg_size(&prepared->lessons[pass]) > 0) share(&prepared->lessons[pass], &payload[SUM_LESSONS]);
}
