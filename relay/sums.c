/* sums: see sums.h.
 *
 * DESIGN. Tiles and features of a batch are put behind those of the others; they are decoded before, and
 * copied under a lock. Splat frames are added piece by piece from the cache, as in the master
 * (shared_film_merge.c): they are never unfolded in memory. Each stretch of the frame has a lock, so that
 * threads add at once.
 *
 * A frame that turns out to be damaged half-way would leave its first half in the sum. So it is read twice:
 * once to see that it is good, once to add it. That is half as much work again, and cannot go wrong. */
#include "relay/sums.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>

enum {
    STRETCH_BITS = 16, /* pixels of a stretch, as a power of two: those of a band of the payload */
    STRETCHES = 64     /* that have a lock of their own */
};

struct sum {
    batch_t batch;
    pthread_mutex_t appending;            /* guards all of it but the values of the splat frame, */
    pthread_mutex_t stretches[STRETCHES]; /* which these guard, by pixel */
};

sum_t *sum_new(const job_settings_t *settings)
{
    sum_t *sum = mem_zalloc(1, sizeof *sum);
    batch_init(&sum->batch, settings);
    pthread_mutex_init(&sum->appending, NULL);
    for (int i = 0; i < STRETCHES; i++) pthread_mutex_init(&sum->stretches[i], NULL);
    return sum;
}

void sum_free(sum_t **pointer)
{
    sum_t *sum = *pointer;
    if (sum == NULL) return;
    batch_free(&sum->batch);
    pthread_mutex_destroy(&sum->appending);
    for (int i = 0; i < STRETCHES; i++) pthread_mutex_destroy(&sum->stretches[i]);
    free(sum);
    *pointer = NULL;
}

const batch_t *sum_batch(const sum_t *sum)
{
    return &sum->batch;
}

/* ---- reading ------------------------------------------------------------------------------------------- */

static result_t check_splats(payload_reader_t *reader, const zmq_msg_t *frame, const job_settings_t *settings)
{
    payload_piece_t piece;
    if (zmq_msg_size(frame) == 0) return result_ok();
    TRY(payload_open(reader, frame, 1, batch_splat_values(settings)));
    while (payload_read(reader, &piece)) {
    }
    return payload_end(reader);
}

/* The master refuses a sum whole for what it would refuse of one worker. */
static result_t check_features(const batch_t *batch)
{
    const int64_t *values = batch->features;
    for (size_t i = 0; i < batch->unit_count && batch->feature_count > 0; i++) {
        size_t count = batch_feature_values(&batch->settings, &batch->units[i]);
        if (count > 0 && !unit_features_possible(&batch->units[i], values, count))
            return result_fail(RESULT_PROTOCOL, "features that no sample can have");
        values += count;
    }
    return result_ok();
}

/* Decodes tiles and features, and checks them; looks at the splats. */
static result_t read_payloads(const zmq_msg_t payload[BATCH_PAYLOADS], addend_t *addend)
{
    zmq_msg_t others[BATCH_PAYLOADS];
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        zmq_msg_init(&others[i]);
        if (i != 1) zmq_msg_copy(&others[i], (zmq_msg_t *)&payload[i]);
    }
    result_t result = payload_decode(others, &addend->batch);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&others[i]);
    TRY(result);
    TRY(check_features(&addend->batch));
    payload_reader_t *reader = payload_reader_new();
    if (reader == NULL) return result_fail(RESULT_LIMIT, "no memory for a decoder");
    addend->splat = &payload[1];
    result = check_splats(reader, addend->splat, &addend->batch.settings);
    payload_reader_free(&reader);
    return result;
}

result_t sum_read(batch_t *batch, const zmq_msg_t payload[BATCH_PAYLOADS], const job_settings_t *settings,
                  uint64_t limit, addend_t *addend)
{
    *addend = (addend_t){.batch = *batch};
    *batch = (batch_t){0};
    addend->batch.settings = *settings;
    result_t result = job_check_units(settings, addend->batch.units, addend->batch.unit_count);
    if (result.code != RESULT_OK) addend->batch.unit_count = 0; /* nobody holds what is not of the job */
    TRY(result);
    TRY(batch_check_counts(&addend->batch));
    TRY(batch_check_size(&addend->batch, limit)); /* they are unfolded in memory */
    return read_payloads(payload, addend);
}

/* ---- adding -------------------------------------------------------------------------------------------- */

/* Adds the values of the pixels that are marked; returns how many overflowed. */
static uint64_t add_piece(int64_t *frame, const payload_piece_t *piece)
{
    const int64_t *values = piece->values;
    uint64_t overflows = 0;
    for (size_t word = 0; 64 * word < piece->pixels; word++) {
        size_t left = piece->pixels - 64 * word;
        uint64_t mask = piece->mask[word] & (left < 64 ? (UINT64_C(1) << left) - 1 : UINT64_MAX);
        while (mask != 0) {
            size_t start = (size_t)__builtin_ctzll(mask);
            uint64_t gap = ~(mask >> start);
            size_t run = gap != 0 ? (size_t)__builtin_ctzll(gap) : 64;
            overflows += film_add_sums(frame + 3 * (piece->first + 64 * word + start), values, 3 * run, 1);
            values += 3 * run;
            mask = start + run < 64 ? mask & UINT64_MAX << (start + run) : 0;
        }
    }
    return overflows;
}

/* The frame was read before and is good. */
static uint64_t add_splats(sum_t *sum, const zmq_msg_t *frame)
{
    uint64_t overflows = 0;
    payload_reader_t *reader = payload_reader_new();
    payload_piece_t piece;
    if (reader == NULL) return 1; /* what is missing must not be taken for complete: the job fails */
    if (payload_open(reader, frame, 1, batch_splat_values(&sum->batch.settings)).code == RESULT_OK)
        while (payload_read(reader, &piece)) {
            pthread_mutex_t *lock = &sum->stretches[(piece.first >> STRETCH_BITS) % STRETCHES];
            pthread_mutex_lock(lock);
            overflows += add_piece(sum->batch.splat, &piece);
            pthread_mutex_unlock(lock);
        }
    payload_reader_free(&reader);
    return overflows;
}

size_t sum_add(sum_t *sum, const addend_t *addend)
{
    bool splats = zmq_msg_size((zmq_msg_t *)addend->splat) > 0;
    pthread_mutex_lock(&sum->appending);
    batch_merge(&sum->batch, &addend->batch);
    if (splats && sum->batch.splat == NULL)
        sum->batch.splat = mem_zalloc(batch_splat_values(&sum->batch.settings), sizeof *sum->batch.splat);
    size_t bytes = batch_bytes(&sum->batch);
    pthread_mutex_unlock(&sum->appending);
    uint64_t overflows = splats ? add_splats(sum, addend->splat) : 0;
    if (overflows == 0) return bytes;
    pthread_mutex_lock(&sum->appending);
    sum->batch.counts.overflows += overflows;
    pthread_mutex_unlock(&sum->appending);
    return bytes;
}
