/* payload: the sums of a batch as frames of a message (PROTOCOL.md gives the byte layout): one for each of
 * the sums of film_sums.h, in their order. It is empty when the batch has none of it.
 *
 * The decoder knows from the units how many values must come out, so a hostile payload can neither make it
 * allocate nor write more than that.
 */
#ifndef LIGHTMILL_PAYLOAD_H
#define LIGHTMILL_PAYLOAD_H

#include "common/film/batch.h"

#include <zmq.h>

enum {
    BATCH_PAYLOADS = BATCH_SUMS,
    BATCH_BASE_PAYLOADS = SUM_FEATURES + 1,                 /* that the message of any batch has */
    PAYLOAD_PIECE = 1024,                                   /* pixels of a piece, at most */
    PAYLOAD_PIECE_VALUES = SUM_GROUP_VALUES * PAYLOAD_PIECE /* values of a piece, at most */
};

/* Makes the payload messages for wire_send. On failure none is open. */
result_t payload_encode(const batch_t *batch, zmq_msg_t payload[BATCH_PAYLOADS]);
/* The same without compression and without a copy, for inproc: the messages take the batch's sums over. It
 * has none any more then; what is left of them after a failure is of no use. */
result_t payload_wrap(batch_t *batch, zmq_msg_t payload[BATCH_PAYLOADS]);
/* How many of them a message takes: those that only some jobs have are left out at the end when they are
 * empty, so that the messages of other jobs are as they were before there were such. */
int payload_count(const zmq_msg_t payload[BATCH_PAYLOADS]);
/* The reverse. `batch` has been initialised with the job's settings and holds the message's units, checked;
 * its sums are filled. RESULT_PROTOCOL when the bytes do not decode to exactly the right size. */
result_t payload_decode(const zmq_msg_t payload[BATCH_PAYLOADS], batch_t *batch);
/* The same for the tiles alone: frames are left as they are. */
result_t payload_decode_tiles(const zmq_msg_t payload[BATCH_PAYLOADS], batch_t *batch);
/* The digest (batch_digest) of a batch that has its units and counts, and its sums in payloads. */
result_t payload_digest(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch, hash_t *digest);
/* The same of the tiles of some of its units alone, without splats and light paths; `units` are of the
 * batch's.
 */
result_t payload_digest_units(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch,
                              const unit_t *units, size_t count, hash_t *digest);

/* Reading a frame piece by piece, for who adds the values up and need not have them all in memory. */

typedef struct payload_reader payload_reader_t;

/* Some values of some pixels. */
typedef struct {
    size_t first, pixels;  /* numbered through the frame */
    size_t offset, lanes;  /* which of the values of each pixel */
    const uint64_t *mask;  /* a bit a pixel, from the lowest on; those not marked are zero. What is marked
                              beyond the last pixel means nothing */
    const int64_t *values; /* `lanes` for each pixel that is marked */
    int bits;              /* they are from -2^bits to before 2^bits */
    bool large;            /* that is more than 2^55 */
} payload_piece_t;

/* NULL when memory lacks. */
payload_reader_t *payload_reader_new(void);
/* Sets *reader to NULL. */
void payload_reader_free(payload_reader_t **reader);
/* Begins the payload of one of the sums, of which `values` must come out; or none of a frame, which a batch
 * may do without. RESULT_PROTOCOL when it cannot be so. `payload` stays the caller's, open until the last
 * piece is read. */
result_t payload_open(payload_reader_t *reader, const zmq_msg_t *payload, sum_kind_t kind, size_t values);
/* The next piece, valid until the one after is read. False when there is none: payload_end tells why. */
bool payload_read(payload_reader_t *reader, payload_piece_t *piece);
/* False when a piece of lessons has some that the batch cannot have. */
bool payload_lessons_possible(const payload_piece_t *piece, const lesson_limits_t *limits);
/* RESULT_PROTOCOL when the payload was damaged. */
result_t payload_end(const payload_reader_t *reader);
/* The pixels of a piece from `first` (a multiple of 64) on that are marked: up to 64, from the lowest bit. */
static inline uint64_t payload_marked(const payload_piece_t *piece, size_t first)
{
    size_t left = piece->pixels - first;
    return piece->mask[first / 64] & (left < 64 ? (UINT64_C(1) << left) - 1 : UINT64_MAX);
}

#endif
