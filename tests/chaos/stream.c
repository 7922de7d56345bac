/* stream: see stream.h.
 *
 * Bytes come in, are cut into ZeroMQ's messages (the greeting and what we do not understand pass as they
 * come), and mischief is done to whole messages; the result is cut into pieces, mischief is done to their
 * bytes, and each waits in a queue for its time. So a damaged byte never confuses us about where messages
 * begin: only the receiver sees it. */
#include "tests/chaos/stream.h"

#include "tests/chaos/zmtp.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

enum { PIECE_BYTES = 16 << 10 };
static const double HOLD = 0.3; /* seconds that a message waits for another to overtake it */

struct stream_piece {
    stream_piece_t *next;
    double due;
    size_t size, sent;
    uint8_t bytes[];
};

void stream_init(stream_t *stream, proxy_link_t *link)
{
    *stream = (stream_t){.link = link};
}

void stream_free(stream_t *stream)
{
    while (stream->first) {
        stream_piece_t *piece = stream->first;
        stream->first = piece->next;
        free(piece);
    }
    free(stream->in);
    free(stream->held);
    *stream = (stream_t){0};
}

/* True when this mischief is wanted and the dice say that it is done here. */
static bool wanted(stream_t *stream, dice_t *dice, proxy_mischief_t mischief)
{
    unsigned todo = atomic_load(&stream->link->todo[mischief]);
    if (todo == 0 || dice_below(dice, 3) > 0) return false;
    if (!atomic_compare_exchange_strong(&stream->link->todo[mischief], &todo, todo - 1)) return false;
    atomic_fetch_add(&stream->link->done[mischief], 1);
    return true;
}

/* ---- bytes -------------------------------------------------------------------------------------------- */

static void queue_piece(stream_t *stream, dice_t *dice, double now, const uint8_t *bytes, size_t size)
{
    if (size == 0) return;
    proxy_link_t *link = stream->link;
    stream_piece_t *piece = mem_alloc(sizeof *piece + size);
    unsigned jitter = atomic_load(&link->jitter_ms), rate = atomic_load(&link->bytes_per_second);
    double delay = 1e-3 * (atomic_load(&link->delay_ms) + (jitter ? (double)dice_below(dice, jitter) : 0));
    double start = fmax(now + delay, stream->free_at);
    *piece = (stream_piece_t){.due = start, .size = size};
    memcpy(piece->bytes, bytes, size);
    stream->free_at = start + (rate ? (double)size / rate : 0);
    if (stream->last)
        stream->last->next = piece;
    else
        stream->first = piece;
    stream->last = piece;
    stream->queued += size;
}

static void flip(uint8_t *byte, dice_t *dice)
{
    *byte ^= (uint8_t)(1 + dice_below(dice, 255));
}

/* A piece goes out, after what is to happen to its bytes. */
static void pass_piece(stream_t *stream, dice_t *dice, double now, uint8_t *bytes, size_t size)
{
    size_t at = dice_below(dice, size), length = 1 + dice_below(dice, size - at);
    if (wanted(stream, dice, PROXY_FLIP_BYTES))
        for (uint64_t i = 1 + dice_below(dice, 4); i > 0; i--) flip(&bytes[dice_below(dice, size)], dice);
    if (wanted(stream, dice, PROXY_LOSE_BYTES)) {
        queue_piece(stream, dice, now, bytes, at);
        queue_piece(stream, dice, now, bytes + at + length, size - at - length);
    } else if (wanted(stream, dice, PROXY_REPEAT_BYTES)) {
        queue_piece(stream, dice, now, bytes, at + length);
        queue_piece(stream, dice, now, bytes + at, size - at);
    } else if (wanted(stream, dice, PROXY_SWAP_BYTES)) {
        queue_piece(stream, dice, now, bytes + at, size - at);
        queue_piece(stream, dice, now, bytes, at);
    } else {
        queue_piece(stream, dice, now, bytes, size);
    }
}

static void pass(stream_t *stream, dice_t *dice, double now, uint8_t *bytes, size_t size)
{
    for (size_t at = 0; at < size; at += PIECE_BYTES)
        pass_piece(stream, dice, now, bytes + at, size - at < PIECE_BYTES ? size - at : PIECE_BYTES);
}

/* ---- messages ----------------------------------------------------------------------------------------- */

static void let_go(stream_t *stream, dice_t *dice, double now)
{
    if (stream->held == NULL) return;
    pass(stream, dice, now, stream->held, stream->held_size);
    free(stream->held);
    stream->held = NULL;
}

static void hold(stream_t *stream, double now, const uint8_t *bytes, size_t size)
{
    stream->held = mem_alloc(size);
    memcpy(stream->held, bytes, size);
    stream->held_size = size;
    stream->held_until = now + HOLD;
}

static void pass_message(stream_t *stream, dice_t *dice, double now, uint8_t *bytes, size_t size)
{
    size_t body = zmtp_body_size(bytes, size);
    if (wanted(stream, dice, PROXY_LOSE_MESSAGE)) return;
    if (body > 0 && wanted(stream, dice, PROXY_FLIP_MESSAGE))
        flip(&bytes[zmtp_body_at(bytes, size, dice_below(dice, body))], dice);
    if (stream->held == NULL && wanted(stream, dice, PROXY_SWAP_MESSAGES)) {
        hold(stream, now, bytes, size);
        return;
    }
    bool twice = wanted(stream, dice, PROXY_REPEAT_MESSAGE);
    uint8_t *copy = twice ? mem_alloc(size) : NULL;
    if (twice) memcpy(copy, bytes, size);
    pass(stream, dice, now, bytes, size);
    let_go(stream, dice, now);
    if (twice) pass(stream, dice, now, copy, size);
    free(copy);
}

/* Passes on what stands at the start of the bytes; returns its size, 0 when it is not all there. */
static size_t pass_next(stream_t *stream, dice_t *dice, double now, uint8_t *bytes, size_t size)
{
    size_t step = size;
    bool command = true;
    if (stream->greeted < ZMTP_GREETING) {
        step = size < ZMTP_GREETING - stream->greeted ? size : ZMTP_GREETING - stream->greeted;
        stream->greeted += step;
    } else if (!stream->raw) {
        step = zmtp_message(bytes, size, &command);
        stream->raw = step == SIZE_MAX;
        if (stream->raw) step = size;
    }
    if (step == 0) return 0;
    if (command)
        pass(stream, dice, now, bytes, step);
    else
        pass_message(stream, dice, now, bytes, step);
    return step;
}

void stream_take(stream_t *stream, dice_t *dice, double now, const uint8_t *bytes, size_t size)
{
    if (stream->in_size + size > stream->in_capacity) {
        stream->in_capacity = 2 * (stream->in_size + size);
        stream->in = mem_realloc(stream->in, stream->in_capacity);
    }
    memcpy(stream->in + stream->in_size, bytes, size);
    stream->in_size += size;
    size_t at = 0;
    for (size_t step = 1; step > 0 && at < stream->in_size; at += step)
        step = pass_next(stream, dice, now, stream->in + at, stream->in_size - at);
    memmove(stream->in, stream->in + at, stream->in_size - at);
    stream->in_size -= at;
    atomic_fetch_add(&stream->link->bytes, size);
}

void stream_tick(stream_t *stream, dice_t *dice, double now)
{
    if (stream->held && now >= stream->held_until) let_go(stream, dice, now);
}

/* ---- out ---------------------------------------------------------------------------------------------- */

bool stream_send(stream_t *stream, double now, int socket)
{
    while (stream->first && stream->first->due <= now) {
        stream_piece_t *piece = stream->first;
        ssize_t n = send(socket, piece->bytes + piece->sent, piece->size - piece->sent, MSG_NOSIGNAL);
        if (n < 0) return errno == EAGAIN || errno == EINTR;
        piece->sent += (size_t)n;
        if (piece->sent < piece->size) return true;
        stream->first = piece->next;
        if (stream->first == NULL) stream->last = NULL;
        stream->queued -= piece->size;
        free(piece);
    }
    return true;
}

bool stream_idle(const stream_t *stream)
{
    return stream->first == NULL && stream->held == NULL;
}

double stream_due(const stream_t *stream)
{
    double due = stream->held ? stream->held_until : INFINITY;
    return stream->first ? fmin(due, stream->first->due) : due;
}
