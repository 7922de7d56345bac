/* checkpoint_write: makes checkpoints (see checkpoint.h and the note in checkpoint_format.h). */
#include "common/atomic_file.h"
#include "master/store/checkpoint_format.h"
#include "master/store/record.h"

#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <zstd.h>

enum {
    ZSTD_LEVEL = -1, /* it looks for nothing in literals, most of which are noise */
    FLUSH_BYTES =
        16 << 20 /* after so many the system is asked to begin writing, so that fsync has less to do */
};

/* What the threads share. */
typedef struct {
    const schedule_state_t *state;
    shared_film_snapshot_t *snapshot;
    size_t state_bytes, state_blocks, block_count;
    atomic_size_t next; /* block to be made */
    entry_t *entries;
    pthread_mutex_t lock; /* guards what follows */
    atomic_file_t file;
    uint64_t end, flushed; /* bytes of the file */
    bool no_memory;
} writer_t;

/* ---- blocks -------------------------------------------------------------------------------------------- */

/* The bytes of a block as they are in memory; returns how many. */
static size_t fetch_block(writer_t *writer, size_t index, uint8_t *bytes)
{
    if (index >= writer->state_blocks)
        return shared_film_snapshot_read(writer->snapshot, index - writer->state_blocks, bytes);
    size_t from = index * SHARED_FILM_PAGE_BYTES, left = writer->state_bytes - from;
    size_t size = left < SHARED_FILM_PAGE_BYTES ? left : SHARED_FILM_PAGE_BYTES;
    state_copy(writer->state, from, size, bytes, false);
    return size;
}

/* Appends a coded block to the file; false when it is in vain. */
static bool append_block(writer_t *writer, size_t index, const uint8_t *bytes, size_t size)
{
    entry_t entry = {.size = (uint32_t)size, .hash = hash_bytes(bytes, size)};
    pthread_mutex_lock(&writer->lock);
    entry.offset = writer->end;
    writer->end += size;
    bool good = atomic_file_write_at(&writer->file, bytes, size, entry.offset);
    if (good && writer->end - writer->flushed >= FLUSH_BYTES) {
        sync_file_range(writer->file.descriptor, (off64_t)writer->flushed,
                        (off64_t)(writer->end - writer->flushed), SYNC_FILE_RANGE_WRITE);
        writer->flushed = writer->end;
    }
    pthread_mutex_unlock(&writer->lock);
    writer->entries[index] = entry;
    return good;
}

static void note_no_memory(writer_t *writer)
{
    pthread_mutex_lock(&writer->lock);
    writer->no_memory = true;
    pthread_mutex_unlock(&writer->lock);
}

/* One thread's work: blocks, until there are no more. */
static void make_blocks(void *data)
{
    writer_t *writer = data;
    size_t bound = ZSTD_compressBound(SHARED_FILM_PAGE_BYTES);
    uint8_t *plain = mem_alloc(SHARED_FILM_PAGE_BYTES), *split = mem_alloc(SHARED_FILM_PAGE_BYTES);
    uint8_t *coded = mem_alloc(bound);
    ZSTD_CCtx *compressor = ZSTD_createCCtx();
    bool good = compressor != NULL;
    while (good) {
        size_t index = atomic_fetch_add(&writer->next, 1);
        if (index >= writer->block_count) break;
        size_t size = fetch_block(writer, index, plain);
        bytes_split(plain, size, split);
        size_t coded_size = ZSTD_compressCCtx(compressor, coded, bound, split, size, ZSTD_LEVEL);
        if (ZSTD_isError(coded_size)) note_no_memory(writer); /* it takes its memory when it begins */
        good = !ZSTD_isError(coded_size) && append_block(writer, index, coded, coded_size);
        if (!good) atomic_store(&writer->next, writer->block_count); /* the others need not go on */
    }
    if (compressor == NULL) note_no_memory(writer);
    ZSTD_freeCCtx(compressor);
    free(coded);
    free(split);
    free(plain);
}

/* ---- the front ----------------------------------------------------------------------------------------- */

/* The head as bytes in fresh memory. */
static uint8_t *pack_head(const checkpoint_info_t *info, const schedule_state_t *state, size_t *size)
{
    record_message_t record;
    Lm__Counts counts = LM__COUNTS__INIT;
    Lm__FilmHead head = LM__FILM_HEAD__INIT;
    record_put(&info->record, &record);
    wire_counts_put(&info->counts, &counts);
    head.record = &record.message;
    head.generation = info->generation;
    head.written = info->written;
    head.counts = &counts;
    head.samples = info->samples;
    head.issued = state->issued;
    head.returned = state->returned;
    head.rounds = state->round_count;
    head.tiles = state->tile_count;
    head.counted = state->counted_count;
    head.skipped = state->skipped_count;
    head.settled = state->settled;
    uint8_t *bytes = mem_alloc(lm__film_head__get_packed_size(&head));
    *size = lm__film_head__pack(&head, bytes);
    return bytes;
}

/* Writes preamble, head and index: the file is whole then. */
static void write_front(writer_t *writer, const uint8_t *head, size_t head_bytes)
{
    preamble_t preamble = {.head_bytes = (uint32_t)head_bytes,
                           .block_count = (uint32_t)writer->block_count,
                           .file_bytes = writer->end};
    size_t size = PREAMBLE_HASHED + head_bytes + ENTRY_BYTES * writer->block_count;
    /* What is hashed, in one piece: the preamble as far as its hash, the head, the index. */
    uint8_t *bytes = mem_alloc(size + HASH_BYTES), front[PREAMBLE_BYTES];
    preamble_put(&preamble, front);
    memcpy(bytes, front, PREAMBLE_HASHED);
    memcpy(bytes + PREAMBLE_HASHED, head, head_bytes);
    uint8_t *index = bytes + PREAMBLE_HASHED + head_bytes;
    for (size_t i = 0; i < writer->block_count; i++) entry_put(&writer->entries[i], index + ENTRY_BYTES * i);
    preamble.hash = hash_bytes(bytes, size);
    preamble_put(&preamble, front);
    atomic_file_write_at(&writer->file, front, PREAMBLE_BYTES, 0);
    atomic_file_write_at(&writer->file, bytes + PREAMBLE_HASHED, size - PREAMBLE_HASHED, PREAMBLE_BYTES);
    free(bytes);
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

static result_t write_file(writer_t *writer, const checkpoint_info_t *info, int threads,
                           checkpoint_cost_t *cost)
{
    size_t head_bytes;
    uint8_t *head = pack_head(info, writer->state, &head_bytes);
    writer->end = writer->flushed = PREAMBLE_BYTES + head_bytes + ENTRY_BYTES * writer->block_count;
    cost->cpu = threads_run(threads, make_blocks, writer);
    result_t result = result_ok();
    if (writer->no_memory)
        result = result_fail(RESULT_LIMIT, "%s: no memory for the compressor", writer->file.path);
    else
        write_front(writer, head, head_bytes);
    free(head);
    if (result.code == RESULT_OK) return atomic_file_commit(&writer->file);
    atomic_file_abort(&writer->file);
    return result;
}

result_t checkpoint_write(const char *path, checkpoint_info_t *info, const schedule_state_t *state,
                          shared_film_snapshot_t *snapshot, int threads, checkpoint_cost_t *cost)
{
    const job_settings_t *settings = &info->record.settings;
    double start = clock_now();
    *cost = (checkpoint_cost_t){0};
    info->counts = shared_film_snapshot_counts(snapshot);
    info->samples = schedule_state_samples(settings, state);
    writer_t writer = {.state = state, .snapshot = snapshot, .state_bytes = (size_t)state_bytes(state)};
    if (writer.state_bytes > CHECKPOINT_MAX_STATE)
        return result_fail(RESULT_LIMIT, "%s: the schedule takes %zu bytes", path, writer.state_bytes);
    TRY(atomic_file_open(&writer.file, path));
    writer.state_blocks = (writer.state_bytes + SHARED_FILM_PAGE_BYTES - 1) / SHARED_FILM_PAGE_BYTES;
    writer.block_count = writer.state_blocks + shared_film_page_count(settings);
    writer.entries = mem_zalloc(writer.block_count, sizeof *writer.entries);
    pthread_mutex_init(&writer.lock, NULL);
    result_t result = write_file(&writer, info, threads, cost);
    pthread_mutex_destroy(&writer.lock);
    free(writer.entries);
    cost->bytes = writer.end;
    cost->wall = clock_now() - start;
    return result;
}
