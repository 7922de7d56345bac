/* fuzz_payload: any bytes as the payloads of a batch. The decoder that unfolds them in memory and the
 * one that adds them to a film piece by piece must agree: on whether they are sound, and on the film; what is
 * not sound leaves the film as it was. What was decoded comes back from the encoder.
 *
 * The first bytes choose the job and the units, and where one payload ends and the next begins. */
#include "tests/fuzz/fuzz.h"

#include "master/film/shared_film.h"
#include "proto/wire/wire.h"
#include "tests/films.h"

#include <stdlib.h>
#include <string.h>

enum { HEADER = 6, MAX_UNITS = 3 };

static job_settings_t settings_of(uint8_t choice)
{
    static const struct {
        int32_t width, height, tile;
    } sizes[] = {{1, 1, 8}, {9, 3, 8}, {33, 40, 16}, {64, 64, 64}};
    job_settings_t settings = job_settings_default();
    settings.width = sizes[choice % 4].width;
    settings.height = sizes[choice % 4].height;
    settings.tile_size = sizes[choice % 4].tile;
    settings.features = (choice & 4) != 0;
    settings.spp = 100;
    settings.cryptomatte = (choice & 16) != 0;
    settings.learn = (choice & 32) != 0;
    if ((choice & 8) != 0) strcpy(settings.light_groups, "a=0,b=area,rest");
    return settings;
}

static void choose_units(const job_settings_t *settings, uint8_t choice, batch_t *batch)
{
    batch_init(batch, settings);
    batch->unit_count = batch->unit_capacity = 1 + choice % MAX_UNITS;
    batch->units = mem_alloc(batch->unit_count * sizeof *batch->units);
    for (uint32_t i = 0; i < batch->unit_count; i++)
        batch->units[i] = (unit_t){(i + choice) % job_tile_count(settings), i == 2 ? FEATURE_SAMPLES : i, 1};
}

static void put_payload(zmq_msg_t *message, const uint8_t *bytes, size_t size)
{
    zmq_msg_init_size(message, size);
    if (size > 0) memcpy(zmq_msg_data(message), bytes, size);
}

static film_t *film_of(const job_settings_t *settings)
{
    film_t *film;
    fuzz_expect(film_new(settings, &film).code == RESULT_OK, "no film");
    return film;
}

static void check_encoder(const batch_t *batch)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    batch_t again;
    batch_init(&again, &batch->settings);
    again.units = mem_alloc(batch->unit_count * sizeof *again.units);
    memcpy(again.units, batch->units, batch->unit_count * sizeof *again.units);
    again.unit_count = again.unit_capacity = batch->unit_count;
    fuzz_expect(payload_encode(batch, payload).code == RESULT_OK, "sums that cannot be encoded");
    fuzz_expect(payload_decode(payload, &again).code == RESULT_OK, "our own payloads are refused");
    fuzz_expect(same_sums(&again, batch), "other sums");
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&again);
}

static void compare_decoders(const job_settings_t *settings, zmq_msg_t payload[BATCH_PAYLOADS],
                             batch_t *batch)
{
    film_t *expected = film_of(settings);
    shared_film_t *shared_film = shared_film_new(film_of(settings));
    shared_film_enter(shared_film);
    result_t merged = shared_film_merge_payload(shared_film, payload, batch, NULL, 1);
    shared_film_leave(shared_film);
    result_t decoded = payload_decode(payload, batch);
    bool sound = decoded.code == RESULT_OK && batch_check_sums(batch).code == RESULT_OK;
    fuzz_expect((merged.code == RESULT_OK) == sound, "the decoders do not agree");
    fuzz_expect(decoded.code == RESULT_OK || decoded.message[0] != '\0', "an error without text");
    const film_t *result = shared_film_lock(shared_film);
    if (decoded.code == RESULT_OK) check_encoder(batch);
    if (sound) merge_plainly(expected, batch);
    fuzz_expect(same_film(expected, result), sound ? "the films differ" : "a damaged payload left something");
    fuzz_expect(expected->counts.overflows == result->counts.overflows, "other overflows");
    shared_film_unlock(shared_film);
    shared_film_destroy(&shared_film);
    film_destroy(&expected);
}

int fuzz_payload(const uint8_t *data, size_t size)
{
    if (size < HEADER) return 0;
    job_settings_t settings = settings_of(data[0]);
    int count = settings.learn                     ? BATCH_PAYLOADS
                : settings.light_groups[0] != '\0' ? SUM_GROUP_SPLAT + 1
                : settings.cryptomatte             ? SUM_MATTES + 1
                                                   : SUM_FEATURES + 1;
    size_t header = 2 * (size_t)count, left = size - header;
    if (size < header) return 0;
    batch_t batch;
    choose_units(&settings, data[1], &batch);
    const uint8_t *bytes = data + header;
    zmq_msg_t payload[BATCH_PAYLOADS];
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        size_t length = i + 1 < count ? data[2 + 2 * i] + 256u * data[3 + 2 * i] : left;
        if (length > left) length = left;
        if (i >= count) length = 0;
        put_payload(&payload[i], bytes, length);
        bytes += length;
        left -= length;
    }
    compare_decoders(&settings, payload, &batch);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&batch);
    return 0;
}
