/* blob_writer: see blob_writer.h. */
#include "master/threads/blob_writer.h"

#include "common/thread.h"

#include <stdlib.h>
#include <string.h>

struct blob_writer {
    blob_store_t *store;
    pthread_t thread;
    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t asked; /* there is a piece, or the end has come */
    bool stop;
    blob_piece_t waiting[BLOB_WRITER_MAX_WAITING];
    size_t waiting_count;
};

/* Waits for the next piece; false when there will be none. */
static bool next_piece(blob_writer_t *blob_writer, blob_piece_t *piece)
{
    pthread_mutex_lock(&blob_writer->lock);
    while (blob_writer->waiting_count == 0 && !blob_writer->stop)
        pthread_cond_wait(&blob_writer->asked, &blob_writer->lock);
    bool found = blob_writer->waiting_count > 0;
    if (found) {
        *piece = blob_writer->waiting[0];
        blob_writer->waiting_count--;
        memmove(blob_writer->waiting, blob_writer->waiting + 1, blob_writer->waiting_count * sizeof *piece);
    }
    pthread_mutex_unlock(&blob_writer->lock);
    return found;
}

static void *blob_writer_run(void *context)
{
    blob_writer_t *blob_writer = context;
    for (blob_piece_t piece; next_piece(blob_writer, &piece);) {
        uint64_t next = 0;
        result_t result = blob_store_put(blob_writer->store, &piece.hash, piece.offset, piece.size,
                                         piece.bytes, piece.length, &next);
        piece.done(piece.context, &result, next);
    }
    return NULL;
}

static void free_blob_writer(blob_writer_t *blob_writer)
{
    pthread_cond_destroy(&blob_writer->asked);
    pthread_mutex_destroy(&blob_writer->lock);
    free(blob_writer);
}

result_t blob_writer_start(blob_store_t *store, blob_writer_t **out)
{
    blob_writer_t *blob_writer = mem_zalloc(1, sizeof *blob_writer);
    blob_writer->store = store;
    pthread_mutex_init(&blob_writer->lock, NULL);
    pthread_cond_init(&blob_writer->asked, NULL);
    result_t result = thread_start(&blob_writer->thread, "lm-blob_writer", blob_writer_run, blob_writer);
    if (result.code == RESULT_OK)
        *out = blob_writer;
    else
        free_blob_writer(blob_writer);
    return result;
}

void blob_writer_stop(blob_writer_t **out)
{
    blob_writer_t *blob_writer = *out;
    if (blob_writer == NULL) return;
    pthread_mutex_lock(&blob_writer->lock);
    blob_writer->stop = true;
    pthread_cond_signal(&blob_writer->asked);
    pthread_mutex_unlock(&blob_writer->lock);
    pthread_join(blob_writer->thread, NULL);
    free_blob_writer(blob_writer);
    *out = NULL;
}

result_t blob_writer_put(blob_writer_t *blob_writer, const blob_piece_t *piece)
{
    pthread_mutex_lock(&blob_writer->lock);
    bool room = blob_writer->waiting_count < BLOB_WRITER_MAX_WAITING;
    if (room) blob_writer->waiting[blob_writer->waiting_count++] = *piece;
    pthread_cond_signal(&blob_writer->asked);
    pthread_mutex_unlock(&blob_writer->lock);
    return room ? result_ok()
                : result_fail(RESULT_LIMIT, "too many scenes are being sent already: try again");
}
