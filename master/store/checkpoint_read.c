/* checkpoint_read: reads checkpoints back (see checkpoint.h and the note in checkpoint_format.h). The bytes
 * are not trusted: a disk loses some, a user copies the wrong file. */
#include "common/file_io.h"
#include "master/store/checkpoint_format.h"
#include "master/store/record.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

struct checkpoint {
    char *path;
    int descriptor;
    checkpoint_info_t info;
    schedule_state_t state; /* the numbers of it; no arrays */
    size_t state_bytes, state_blocks, block_count;
    uint8_t *front; /* preamble without its hash, head and index */
    const uint8_t *index;
    uint64_t data_start, file_bytes;
};

static result_t damaged(const checkpoint_t *c, const char *what)
{
    return result_fail(RESULT_INPUT, "%.300s is damaged: %s", c->path, what);
}

/* Reads exactly so many bytes. */
static result_t read_at(const checkpoint_t *c, void *bytes, size_t size, uint64_t offset)
{
    if (file_read_all(c->descriptor, bytes, size, offset)) return result_ok();
    if (errno == 0) return damaged(c, "it ends early");
    return result_fail(RESULT_IO, "cannot read %.300s: %s", c->path, strerror(errno));
}

/* ---- the front ----------------------------------------------------------------------------------------- */

/* The bytes that a block holds when it is unpacked. */
static size_t block_bytes(const checkpoint_t *c, size_t index)
{
    if (index >= c->state_blocks) return SHARED_FILM_PAGE_BYTES; /* the last page of an array is shorter */
    size_t left = c->state_bytes - index * SHARED_FILM_PAGE_BYTES;
    return left < SHARED_FILM_PAGE_BYTES ? left : SHARED_FILM_PAGE_BYTES;
}

/* Takes over the numbers of the head and derives the layout from them. */
static result_t use_head(checkpoint_t *c, const Lm__FilmHead *head)
{
    const uint64_t most = CHECKPOINT_MAX_STATE / sizeof(unit_t);
    result_t record = record_get(head->record, &c->info.record);
    if (record.code != RESULT_OK) return damaged(c, record.message);
    const job_settings_t *settings = &c->info.record.settings;
    if (head->tiles != job_tile_count(settings))
        return damaged(c, "its schedule has another number of tiles than its job");
    if (head->counted > most || head->skipped > most || !(head->written >= 0))
        return damaged(c, "its head has numbers that cannot be");
    if (head->settled > sum_planes(settings, SUM_LESSONS))
        return damaged(c, "it has settled more lessons than its job notes");
    c->info.generation = head->generation;
    c->info.written = head->written;
    c->info.samples = head->samples;
    wire_counts_get(head->counts, &c->info.counts);
    c->state = (schedule_state_t){.round_count = head->rounds,
                                  .tile_count = head->tiles,
                                  .counted_count = (size_t)head->counted,
                                  .skipped_count = (size_t)head->skipped,
                                  .issued = head->issued,
                                  .returned = head->returned,
                                  .settled = head->settled};
    if (state_bytes(&c->state) > CHECKPOINT_MAX_STATE)
        return damaged(c, "its schedule is larger than any can be");
    c->state_bytes = (size_t)state_bytes(&c->state);
    c->state_blocks = (c->state_bytes + SHARED_FILM_PAGE_BYTES - 1) / SHARED_FILM_PAGE_BYTES;
    if (c->block_count != c->state_blocks + shared_film_page_count(settings))
        return damaged(c, "it has another number of pages than its film");
    return result_ok();
}

static result_t decode_head(checkpoint_t *c, const uint8_t *bytes, size_t size)
{
    size_t left = RECORD_MAX_DECODED;
    ProtobufCAllocator allocator = wire_allocator(&left);
    Lm__FilmHead *head = lm__film_head__unpack(&allocator, size, bytes);
    if (head == NULL) return damaged(c, "its head does not decode");
    result_t result = use_head(c, head);
    lm__film_head__free_unpacked(head, NULL);
    return result;
}

/* Every block lies within the file and is no larger than what it holds can make it. */
static result_t check_index(const checkpoint_t *c)
{
    for (size_t i = 0; i < c->block_count; i++) {
        entry_t entry = entry_get(c->index + ENTRY_BYTES * i);
        if (entry.size == 0 || entry.size > ZSTD_compressBound(block_bytes(c, i)) ||
            entry.offset < c->data_start || entry.offset > c->file_bytes ||
            entry.size > c->file_bytes - entry.offset)
            return damaged(c, "its index points outside");
    }
    return result_ok();
}

static result_t read_front(checkpoint_t *c)
{
    struct stat status;
    if (fstat(c->descriptor, &status) != 0)
        return result_fail(RESULT_IO, "cannot read %.300s: %s", c->path, strerror(errno));
    c->file_bytes = (uint64_t)status.st_size;
    uint8_t bytes[PREAMBLE_BYTES];
    preamble_t preamble;
    uint32_t version;
    TRY(read_at(c, bytes, sizeof bytes, 0));
    if (!preamble_get(bytes, &preamble, &version)) return damaged(c, "it does not begin like a checkpoint");
    if (version != CHECKPOINT_VERSION)
        return result_fail(RESULT_MISMATCH,
                           "%.300s is a checkpoint of version %u, this master reads version %d", c->path,
                           version, CHECKPOINT_VERSION);
    uint64_t size =
        PREAMBLE_HASHED + (uint64_t)preamble.head_bytes + (uint64_t)ENTRY_BYTES * preamble.block_count;
    c->data_start = size + HASH_BYTES;
    if (preamble.head_bytes > CHECKPOINT_MAX_HEAD || c->data_start > c->file_bytes)
        return damaged(c, "it ends early, or its first bytes are wrong");
    c->block_count = preamble.block_count;
    c->front = malloc((size_t)size);
    if (c->front == NULL) return result_fail(RESULT_LIMIT, "no memory to read %.300s", c->path);
    memcpy(c->front, bytes, PREAMBLE_HASHED);
    TRY(read_at(c, c->front + PREAMBLE_HASHED, (size_t)size - PREAMBLE_HASHED, PREAMBLE_BYTES));
    hash_t hash = hash_bytes(c->front, (size_t)size);
    if (!hash_equal(&hash, &preamble.hash)) return damaged(c, "the checksum of its head is wrong");
    if (preamble.file_bytes != c->file_bytes) return damaged(c, "it is not as long as it was");
    c->index = c->front + PREAMBLE_HASHED + preamble.head_bytes;
    TRY(decode_head(c, c->front + PREAMBLE_HASHED, preamble.head_bytes));
    return check_index(c);
}

result_t checkpoint_open(const char *path, checkpoint_t **out)
{
    checkpoint_t *c = mem_zalloc(1, sizeof *c);
    c->path = mem_strdup(path);
    c->descriptor = open(path, O_RDONLY | O_CLOEXEC);
    result_t result = result_ok();
    if (c->descriptor < 0) result = result_fail(RESULT_IO, "cannot open %.300s: %s", path, strerror(errno));
    if (result.code == RESULT_OK) result = read_front(c);
    if (result.code != RESULT_OK) checkpoint_close(&c);
    *out = c;
    return result;
}

const checkpoint_info_t *checkpoint_info(const checkpoint_t *checkpoint)
{
    return &checkpoint->info;
}

void checkpoint_close(checkpoint_t **checkpoint)
{
    checkpoint_t *c = *checkpoint;
    if (c == NULL) return;
    if (c->descriptor >= 0) close(c->descriptor);
    free(c->front);
    free(c->path);
    free(c);
    *checkpoint = NULL;
}

/* ---- blocks -------------------------------------------------------------------------------------------- */

/* What the threads share. */
typedef struct {
    const checkpoint_t *checkpoint;
    const schedule_state_t *state;
    film_t *film;
    atomic_size_t next;
    pthread_mutex_t lock; /* guards what follows */
    result_t result;      /* the first failure */
} reader_t;

/* One thread's memory. */
typedef struct {
    uint8_t *coded, *split, *plain;
    ZSTD_DCtx *decompressor;
} scratch_t;

static result_t load_block(const reader_t *reader, size_t index, const scratch_t *scratch)
{
    const checkpoint_t *c = reader->checkpoint;
    entry_t entry = entry_get(c->index + ENTRY_BYTES * index);
    TRY(read_at(c, scratch->coded, entry.size, entry.offset));
    hash_t hash = hash_bytes(scratch->coded, entry.size);
    if (!hash_equal(&hash, &entry.hash)) return damaged(c, "the checksum of a page is wrong");
    bool of_state = index < c->state_blocks;
    size_t size = block_bytes(c, index);
    uint8_t *target =
        of_state ? scratch->plain : shared_film_page(reader->film, index - c->state_blocks, &size);
    if (ZSTD_decompressDCtx(scratch->decompressor, scratch->split, SHARED_FILM_PAGE_BYTES, scratch->coded,
                            entry.size) != size)
        return damaged(c, "a page does not unpack");
    bytes_join(scratch->split, size, target);
    if (of_state) state_copy(reader->state, index * SHARED_FILM_PAGE_BYTES, size, target, true);
    return result_ok();
}

/* The others need not go on. */
static void fail(reader_t *reader, result_t result)
{
    pthread_mutex_lock(&reader->lock);
    if (reader->result.code == RESULT_OK) reader->result = result;
    pthread_mutex_unlock(&reader->lock);
    atomic_store(&reader->next, reader->checkpoint->block_count);
}

/* One thread's work: blocks, until there are no more. */
static void load_blocks(void *data)
{
    reader_t *reader = data;
    scratch_t scratch = {mem_alloc(ZSTD_compressBound(SHARED_FILM_PAGE_BYTES)),
                         mem_alloc(SHARED_FILM_PAGE_BYTES), mem_alloc(SHARED_FILM_PAGE_BYTES),
                         ZSTD_createDCtx()};
    if (scratch.decompressor == NULL) fail(reader, result_fail(RESULT_LIMIT, "no memory to unpack a film"));
    for (;;) {
        size_t index = atomic_fetch_add(&reader->next, 1);
        if (index >= reader->checkpoint->block_count) break;
        result_t result = load_block(reader, index, &scratch);
        if (result.code != RESULT_OK) fail(reader, result);
    }
    ZSTD_freeDCtx(scratch.decompressor);
    free(scratch.plain);
    free(scratch.split);
    free(scratch.coded);
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

/* The state's arrays, zeroed; false when memory lacks. */
static bool make_state(const schedule_state_t *numbers, schedule_state_t *state)
{
    size_t cells = (size_t)numbers->round_count * numbers->tile_count;
    *state = *numbers;
    state->ends = calloc(cells + 1, sizeof *state->ends);
    state->weights = calloc(cells + 1, sizeof *state->weights);
    state->counted = calloc(state->counted_count + 1, sizeof *state->counted);
    state->skipped = calloc(state->skipped_count + 1, sizeof *state->skipped);
    return state->ends != NULL && state->weights != NULL && state->counted != NULL && state->skipped != NULL;
}

/* The ranges are of this job, and as many samples as the head says. */
static result_t check_ranges(const checkpoint_t *c, const schedule_state_t *state)
{
    const job_settings_t *settings = &c->info.record.settings;
    for (size_t i = 0; i < state->counted_count; i++)
        if (!job_unit_valid(settings, &state->counted[i]))
            return damaged(c, "it counts what is not of its job");
    if (schedule_state_samples(settings, state) == c->info.samples) return result_ok();
    return damaged(c, "it does not hold as many samples as it says");
}

/* True when the samples of one are samples of the other: the settings differ in nothing but when to stop. */
static bool same_picture(const job_settings_t *a, const job_settings_t *b)
{
    return a->integrator == b->integrator && a->sampler == b->sampler && a->seed == b->seed &&
           a->width == b->width && a->height == b->height && a->max_depth == b->max_depth &&
           a->tile_size == b->tile_size && a->film_scale == b->film_scale && a->strategy_s == b->strategy_s &&
           a->strategy_t == b->strategy_t && a->unweighted == b->unweighted && a->features == b->features &&
           a->adaptive == b->adaptive && a->cryptomatte == b->cryptomatte && a->learn == b->learn &&
           a->merge_radius == b->merge_radius && a->spectral == b->spectral &&
           strcmp(a->light_groups, b->light_groups) == 0;
}

result_t checkpoint_load(checkpoint_t *c, const job_settings_t *settings, int threads, film_t **film,
                         schedule_state_t *state)
{
    *film = NULL;
    *state = (schedule_state_t){0};
    if (!same_picture(settings, &c->info.record.settings))
        return result_fail(RESULT_INPUT, "%.300s is of another job", c->path);
    TRY(film_new(settings, film));
    reader_t reader = {.checkpoint = c, .state = state, .film = *film, .result = result_ok()};
    if (!make_state(&c->state, state))
        reader.result = result_fail(RESULT_LIMIT, "no memory for the schedule of %.300s", c->path);
    if (reader.result.code == RESULT_OK) {
        pthread_mutex_init(&reader.lock, NULL);
        threads_run(threads, load_blocks, &reader);
        pthread_mutex_destroy(&reader.lock);
    }
    if (reader.result.code == RESULT_OK) reader.result = check_ranges(c, state);
    (*film)->counts = c->info.counts;
    (*film)->settled = c->state.settled;
    if (reader.result.code == RESULT_OK) return reader.result;
    film_destroy(film);
    schedule_state_free(state);
    return reader.result;
}
