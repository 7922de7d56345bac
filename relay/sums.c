/* sums: see sums.h.
 *
 * DESIGN. The tiles of a batch are put behind those of the others; they are decoded before, and copied under
 * a lock. Frames are added piece by piece from the cache: they are never unfolded in memory. Each stretch of
 * the frame has a lock, so that threads add at once.
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
    pthread_mutex_t appending;            /* guards all of it but the values of frames, */
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

batch_t *sum_batch(sum_t *sum)
{
    return &sum->batch;
}

/* ---- reading ------------------------------------------------------------------------------------------- */

/* Reads the frames to their ends, and checks lessons. */
static result_t check_frames(payload_reader_t *reader, const addend_t *addend)
{
    lesson_limits_t limits = batch_lesson_limits(&addend->batch);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        if (!film_sums[k].frame) continue;
        TRY(payload_open(reader, &addend->payload[k], k, batch_expected_values(&addend->batch, k)));
        for (payload_piece_t piece; payload_read(reader, &piece);)
            if (k == SUM_LESSONS && !payload_lessons_possible(&piece, &limits))
                return result_fail(RESULT_PROTOCOL, "%s sums that no sample can have", film_sums[k].name);
        TRY(payload_end(reader));
    }
    return result_ok();
}

/* Decodes the tiles, and checks them; looks at the frames. The master refuses a sum whole for what it would
 * refuse of one worker. */
static result_t read_payloads(addend_t *addend)
{
    TRY(payload_decode_tiles(addend->payload, &addend->batch));
    TRY(batch_check_sums(&addend->batch));
    payload_reader_t *reader = payload_reader_new();
    if (reader == NULL) return result_fail(RESULT_LIMIT, "no memory for a decoder");
    result_t result = check_frames(reader, addend);
    payload_reader_free(&reader);
    return result;
}

result_t sum_read(batch_t *batch, const zmq_msg_t payload[BATCH_PAYLOADS], const job_settings_t *settings,
                  uint64_t limit, addend_t *addend)
{
    *addend = (addend_t){.batch = *batch, .payload = payload};
    *batch = (batch_t){0};
    addend->batch.settings = *settings;
    result_t result = job_check_units(settings, addend->batch.units, addend->batch.unit_count);
    if (result.code != RESULT_OK) addend->batch.unit_count = 0; /* nobody holds what is not of the job */
    TRY(result);
    TRY(batch_check_counts(&addend->batch));
    TRY(batch_check_size(&addend->batch, limit)); /* they are unfolded in memory */
    return read_payloads(addend);
}

/* ---- adding -------------------------------------------------------------------------------------------- */

/* Adds the values of the pixels that are marked; returns how many overflowed. */
static uint64_t add_piece(int64_t *frame, const payload_piece_t *piece)
{
    const int64_t *values = piece->values;
    uint64_t overflows = 0;
    for (size_t first = 0; first < piece->pixels; first += 64) {
        uint64_t mask = payload_marked(piece, first);
        while (mask != 0) {
            size_t start = (size_t)__builtin_ctzll(mask);
            uint64_t gap = ~(mask >> start);
            size_t run = gap != 0 ? (size_t)__builtin_ctzll(gap) : 64;
            size_t count = piece->lanes * run;
            overflows += film_add_sums(frame + piece->lanes * (piece->first + first + start), values, count);
            values += count;
            mask = start + run < 64 ? mask & UINT64_MAX << (start + run) : 0;
        }
    }
    return overflows;
}

/* The payload was read before and is good. */
static uint64_t add_frame(sum_t *sum, payload_reader_t *reader, const zmq_msg_t *payload, sum_kind_t kind)
{
    uint64_t overflows = 0;
    const sum_array_t *frame = &sum->batch.sums[kind];
    if (payload_open(reader, payload, kind, frame->count).code == RESULT_OK)
        for (payload_piece_t piece; payload_read(reader, &piece);) {
            pthread_mutex_t *lock = &sum->stretches[(piece.first >> STRETCH_BITS) % STRETCHES];
            pthread_mutex_lock(lock);
            overflows += add_piece(frame->values, &piece);
            pthread_mutex_unlock(lock);
        }
    return overflows;
}

/* Whether the addend brings a frame of this sum. */
static bool brings(const addend_t *addend, sum_kind_t kind)
{
    return film_sums[kind].frame && zmq_msg_size(&addend->payload[kind]) > 0;
}

static uint64_t add_frames(sum_t *sum, const addend_t *addend)
{
    uint64_t overflows = 0;
    payload_reader_t *reader = payload_reader_new();
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        if (!brings(addend, k)) continue;
        /* What is missing must not be taken for complete: the job fails. */
        overflows += reader != NULL ? add_frame(sum, reader, &addend->payload[k], k) : 1;
    }
    payload_reader_free(&reader);
    return overflows;
}

size_t sum_add(sum_t *sum, const addend_t *addend)
{
    pthread_mutex_lock(&sum->appending);
    batch_merge(&sum->batch, &addend->batch);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (brings(addend, k)) batch_frame(&sum->batch, k);
    size_t bytes = batch_bytes(&sum->batch);
    pthread_mutex_unlock(&sum->appending);
    uint64_t overflows = add_frames(sum, addend);
    if (overflows == 0) return bytes;
    pthread_mutex_lock(&sum->appending);
    sum->batch.counts.overflows += overflows;
    pthread_mutex_unlock(&sum->appending);
    return bytes;
}
