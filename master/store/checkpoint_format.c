/* checkpoint_format: see checkpoint_format.h. */
#include "master/store/checkpoint_format.h"

#include "common/thread.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

static void put_u32(uint8_t *bytes, uint32_t value)
{
    for (int i = 0; i < 4; i++) bytes[i] = (uint8_t)(value >> (8 * i));
}

static void put_u64(uint8_t *bytes, uint64_t value)
{
    put_u32(bytes, (uint32_t)value);
    put_u32(bytes + 4, (uint32_t)(value >> 32));
}

static uint32_t get_u32(const uint8_t *bytes)
{
    uint32_t value = 0;
    for (int i = 0; i < 4; i++) value |= (uint32_t)bytes[i] << (8 * i);
    return value;
}

static uint64_t get_u64(const uint8_t *bytes)
{
    return get_u32(bytes) | (uint64_t)get_u32(bytes + 4) << 32;
}

void preamble_put(const preamble_t *preamble, uint8_t bytes[PREAMBLE_BYTES])
{
    memcpy(bytes, CHECKPOINT_MAGIC, sizeof CHECKPOINT_MAGIC);
    put_u32(bytes + 8, CHECKPOINT_VERSION);
    put_u32(bytes + 12, preamble->head_bytes);
    put_u32(bytes + 16, preamble->block_count);
    put_u32(bytes + 20, 0);
    put_u64(bytes + 24, preamble->file_bytes);
    memcpy(bytes + PREAMBLE_HASHED, preamble->hash.bytes, HASH_BYTES);
}

bool preamble_get(const uint8_t bytes[PREAMBLE_BYTES], preamble_t *preamble, uint32_t *version)
{
    *version = get_u32(bytes + 8);
    preamble->head_bytes = get_u32(bytes + 12);
    preamble->block_count = get_u32(bytes + 16);
    preamble->file_bytes = get_u64(bytes + 24);
    memcpy(preamble->hash.bytes, bytes + PREAMBLE_HASHED, HASH_BYTES);
    return memcmp(bytes, CHECKPOINT_MAGIC, sizeof CHECKPOINT_MAGIC) == 0;
}

void entry_put(const entry_t *entry, uint8_t bytes[ENTRY_BYTES])
{
    put_u64(bytes, entry->offset);
    put_u32(bytes + 8, entry->size);
    put_u32(bytes + 12, 0);
    memcpy(bytes + 16, entry->hash.bytes, HASH_BYTES);
}

entry_t entry_get(const uint8_t bytes[ENTRY_BYTES])
{
    entry_t entry = {.offset = get_u64(bytes), .size = get_u32(bytes + 8)};
    memcpy(entry.hash.bytes, bytes + 16, HASH_BYTES);
    return entry;
}

enum { STATE_ARRAYS = 4 };

typedef struct {
    void *bytes;
    uint64_t size;
} array_t;

static void list_arrays(const schedule_state_t *state, array_t arrays[STATE_ARRAYS])
{
    uint64_t cells = (uint64_t)state->round_count * state->tile_count;
    arrays[0] = (array_t){state->ends, cells * sizeof *state->ends};
    arrays[1] = (array_t){state->weights, cells * sizeof *state->weights};
    arrays[2] = (array_t){state->counted, state->counted_count * sizeof *state->counted};
    arrays[3] = (array_t){state->skipped, state->skipped_count * sizeof *state->skipped};
}

uint64_t state_bytes(const schedule_state_t *state)
{
    array_t arrays[STATE_ARRAYS];
    uint64_t bytes = 0;
    list_arrays(state, arrays);
    for (int a = 0; a < STATE_ARRAYS; a++) bytes += arrays[a].size;
    return bytes;
}

void state_copy(const schedule_state_t *state, size_t from, size_t size, void *bytes, bool store)
{
    array_t arrays[STATE_ARRAYS];
    uint8_t *place = bytes;
    list_arrays(state, arrays);
    for (int a = 0; a < STATE_ARRAYS && size > 0; a++) {
        if (from >= arrays[a].size) {
            from -= arrays[a].size;
            continue;
        }
        size_t part = arrays[a].size - from < size ? arrays[a].size - from : size;
        uint8_t *there = (uint8_t *)arrays[a].bytes + from;
        memcpy(store ? there : place, store ? place : there, part);
        place += part;
        size -= part;
        from = 0;
    }
}

/* Lets the upper parts of `a` change places with the lower ones of `b`. */
static inline void swap_parts(uint64_t *a, uint64_t *b, int shift, uint64_t mask)
{
    uint64_t change = (*a >> shift ^ *b) & mask;
    *b ^= change;
    *a ^= change << shift;
}

/* Makes byte b of word i byte i of word b. */
static inline void transpose(uint64_t words[8])
{
    for (int i = 0; i < 4; i++) swap_parts(&words[i], &words[i + 4], 32, 0x00000000FFFFFFFF);
    for (int i = 0; i < 6; i++)
        if (!(i & 2)) swap_parts(&words[i], &words[i + 2], 16, 0x0000FFFF0000FFFF);
    for (int i = 0; i < 8; i += 2) swap_parts(&words[i], &words[i + 1], 8, 0x00FF00FF00FF00FF);
}

void bytes_split(const uint8_t *in, size_t size, uint8_t *out)
{
    size_t words = size / 8, whole = words / 8 * 8;
    for (size_t i = 0; i < whole; i += 8) {
        uint64_t eight[8];
        memcpy(eight, in + 8 * i, sizeof eight);
        transpose(eight);
        for (size_t b = 0; b < 8; b++) memcpy(out + b * words + i, &eight[b], sizeof eight[b]);
    }
    for (size_t b = 0; b < 8; b++)
        for (size_t i = whole; i < words; i++) out[b * words + i] = in[8 * i + b];
    memcpy(out + 8 * words, in + 8 * words, size % 8);
}

void bytes_join(const uint8_t *in, size_t size, uint8_t *out)
{
    size_t words = size / 8;
    for (size_t i = 0; i < words; i++) {
        uint64_t word = 0;
        for (size_t b = 0; b < 8; b++) word |= (uint64_t)in[b * words + i] << (8 * b);
        memcpy(out + 8 * i, &word, sizeof word);
    }
    memcpy(out + 8 * words, in + 8 * words, size % 8);
}

/* One thread's share of the work. */
typedef struct {
    void (*work)(void *data);
    void *data;
    double cpu; /* seconds that it took */
} share_t;

static double thread_cpu(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void *share_run(void *argument)
{
    share_t *share = argument;
    double start = thread_cpu();
    share->work(share->data);
    share->cpu = thread_cpu() - start;
    return NULL;
}

double threads_run(int threads, void (*work)(void *data), void *data)
{
    pthread_t started[CHECKPOINT_MAX_THREADS];
    share_t shares[CHECKPOINT_MAX_THREADS];
    int count = 0, wanted = int_min(threads, CHECKPOINT_MAX_THREADS);
    for (; count + 1 < wanted; count++) {
        shares[count] = (share_t){work, data, 0};
        if (thread_start(&started[count], "lm-film", share_run, &shares[count]).code != RESULT_OK) break;
    }
    share_t own = {work, data, 0};
    share_run(&own);
    double cpu = own.cpu;
    for (int i = 0; i < count; i++) {
        pthread_join(started[i], NULL);
        cpu += shares[i].cpu;
    }
    return cpu;
}
