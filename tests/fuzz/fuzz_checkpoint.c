/* fuzz_checkpoint: any bytes as a checkpoint. Its sizes and checksums are mended, so that what lies behind
 * them is reached; what is accepted must be a film and a schedule that can be used. */
#include "master/store/checkpoint_format.h"
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>
#include <string.h>

/* Gives every block whose place lies within the file the checksum that it should have, then the front. */
static void mend(uint8_t *bytes, size_t size)
{
    preamble_t preamble;
    uint32_t version;
    if (size < PREAMBLE_BYTES) return;
    preamble_get(bytes, &preamble, &version);
    uint64_t index_at = PREAMBLE_BYTES + (uint64_t)preamble.head_bytes;
    uint64_t end = index_at + (uint64_t)ENTRY_BYTES * preamble.block_count;
    if (end > size) return;
    for (uint32_t i = 0; i < preamble.block_count; i++) {
        uint8_t *place = bytes + index_at + (uint64_t)ENTRY_BYTES * i;
        entry_t entry = entry_get(place);
        if (entry.offset > size || entry.size > size - entry.offset) continue;
        entry.hash = hash_bytes(bytes + entry.offset, entry.size);
        entry_put(&entry, place);
    }
    preamble.file_bytes = size;
    preamble_put(&preamble, bytes);
    uint8_t *front = mem_alloc((size_t)end);
    memcpy(front, bytes, PREAMBLE_HASHED);
    memcpy(front + PREAMBLE_HASHED, bytes + PREAMBLE_BYTES, (size_t)end - PREAMBLE_BYTES);
    preamble.hash = hash_bytes(front, (size_t)end - HASH_BYTES);
    preamble_put(&preamble, bytes);
    free(front);
}

/* What was accepted is used. */
static void use(const checkpoint_info_t *info, film_t *film, schedule_state_t *state)
{
    job_settings_t settings = info->record.settings;
    schedule_t *schedule;
    film_image_t image;
    if (schedule_restore(&settings, state, &schedule).code == RESULT_OK) {
        schedule_state_t again;
        fuzz_expect(schedule_done(schedule) == info->samples,
                    "a schedule with other samples than its checkpoint");
        schedule_save(schedule, &again);
        schedule_state_free(&again);
        schedule_destroy(&schedule);
    }
    film_resolve(film, &image);
    film_image_free(&image);
}

int fuzz_checkpoint(const uint8_t *data, size_t size)
{
    uint8_t *bytes = mem_alloc(size + 1);
    checkpoint_t *checkpoint;
    memcpy(bytes, data, size);
    mend(bytes, size);
    fuzz_write("film", bytes, size);
    free(bytes);
    result_t result = checkpoint_open(fuzz_path("film"), &checkpoint);
    fuzz_expect((checkpoint == NULL) == (result.code != RESULT_OK), "a failure with a checkpoint");
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    if (checkpoint == NULL) return 0;
    const checkpoint_info_t *info = checkpoint_info(checkpoint);
    film_t *film;
    schedule_state_t state;
    result = checkpoint_load(checkpoint, &info->record.settings, 1, &film, &state);
    fuzz_expect((film == NULL) == (result.code != RESULT_OK), "a failure with a film");
    if (film != NULL) {
        use(info, film, &state);
        film_destroy(&film);
        schedule_state_free(&state);
    }
    checkpoint_close(&checkpoint);
    return 0;
}
