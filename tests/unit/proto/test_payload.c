/* Tests of proto/wire/payload.c: what is encoded comes back bit by bit; no bytes make the decoder do anything
 * but fail. Run under the address sanitizer (make asan) these are the memory tests of the codec. */
#include "proto/wire/wire.h"
#include "tests/films.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static uint64_t draw(uint64_t *random)
{
    *random = *random * 6364136223846793005u + 1442695040888963407u;
    return *random >> 20;
}

static job_settings_t settings_of(int width, int height)
{
    job_settings_t settings = job_settings_default();
    settings.width = width;
    settings.height = height;
    settings.tile_size = 32;
    settings.spp = 1000;
    return settings;
}

/* Features as they are (flat surfaces with edges, noise in the low bits), with some that no renderer makes.
 */
static void fill_features(batch_t *batch, uint64_t *seed)
{
    batch->sums[SUM_FEATURES].values =
        mem_alloc(batch->sums[SUM_FEATURES].count * sizeof *batch->sums[SUM_FEATURES].values);
    batch->sums[SUM_FEATURES].capacity = batch->sums[SUM_FEATURES].count;
    for (size_t i = 0; i < batch->sums[SUM_FEATURES].count; i++) {
        size_t pixel = i / FEATURE_VALUES, value = i % FEATURE_VALUES;
        bool flat = value < FEATURE_POSITION || value >= FEATURE_COUNT;
        batch->sums[SUM_FEATURES].values[i] = (int64_t)(pixel / 50 % 4 * (value + 1)) << (flat ? 3 : 32);
        if (!flat) batch->sums[SUM_FEATURES].values[i] += (int64_t)(draw(seed) % (1 << 20));
        if (draw(seed) % 1000 == 0)
            batch->sums[SUM_FEATURES].values[i] = draw(seed) % 2 ? INT64_MIN : INT64_MAX;
    }
}

static void fill_mattes(batch_t *batch, uint64_t *seed)
{
    sum_array_t *sums = &batch->sums[SUM_MATTES];
    sum_array_reserve(sums, batch_expected_values(batch, SUM_MATTES));
    sums->count = batch_expected_values(batch, SUM_MATTES);
    for (size_t i = 0; i < sums->count; i++)
        sums->values[i] = draw(seed) % 50 == 0 ? (int64_t)draw(seed) : (int64_t)(i / 5000);
}

/* Tiles of light groups. */
static void fill_groups(batch_t *batch, uint64_t *seed)
{
    sum_array_t *sums = &batch->sums[SUM_GROUP_EYE];
    sum_array_reserve(sums, batch_expected_values(batch, SUM_GROUP_EYE));
    sums->count = batch_expected_values(batch, SUM_GROUP_EYE);
    for (size_t i = 0; i < sums->count; i++) sums->values[i] = (int64_t)draw(seed) >> (draw(seed) % 60);
}

static void fill_frame(batch_t *batch, sum_kind_t kind, int occupancy, uint64_t *seed)
{
    int64_t *frame = batch_frame(batch, kind);
    for (size_t i = 0; i < batch->sums[kind].count; i += 3)
        if ((int)(draw(seed) % 256) < occupancy)
            for (size_t c = 0; c < 3; c++) frame[i + c] = (int64_t)(draw(seed) % (1 << 30)) - 1000;
}

/* A batch of every second tile, with values of all kinds (every fourth without features), and splats at about
 * `occupancy` of 256 pixels, or no splat frame when it is negative. */
static batch_t batch_of(const job_settings_t *settings, int occupancy, uint64_t seed)
{
    batch_t batch;
    batch_init(&batch, settings);
    uint32_t tiles = job_tile_count(settings);
    batch.units = mem_alloc(tiles * sizeof *batch.units);
    batch.unit_capacity = tiles;
    for (uint32_t t = 0; t < tiles; t += 2) {
        unit_t unit = {t, t % 8 == 6 ? FEATURE_SAMPLES : t % FEATURE_SAMPLES, 1};
        batch.units[batch.unit_count++] = unit;
        batch.sums[SUM_EYE].count += sum_unit_values(settings, SUM_EYE, &unit);
        batch.sums[SUM_FEATURES].count += sum_unit_values(settings, SUM_FEATURES, &unit);
    }
    batch.sums[SUM_EYE].values = mem_alloc(batch.sums[SUM_EYE].count * sizeof *batch.sums[SUM_EYE].values);
    batch.sums[SUM_EYE].capacity = batch.sums[SUM_EYE].count;
    for (size_t i = 0; i < batch.sums[SUM_EYE].count; i++)
        batch.sums[SUM_EYE].values[i] = (int64_t)draw(&seed) >> (draw(&seed) % 44);
    batch.sums[SUM_EYE].values[0] = INT64_MIN;
    batch.sums[SUM_EYE].values[1] = INT64_MAX;
    batch.sums[SUM_EYE].values[2] = -1;
    if (job_has_features(settings)) fill_features(&batch, &seed);
    fill_mattes(&batch, &seed);
    if (settings->light_groups[0] != '\0') fill_groups(&batch, &seed);
    if (occupancy < 0) return batch;
    fill_frame(&batch, SUM_SPLAT, occupancy, &seed);
    if (settings->light_groups[0] != '\0') fill_frame(&batch, SUM_GROUP_SPLAT, occupancy, &seed);
    return batch;
}

/* An empty batch with the units of another. */
static batch_t receiver_of(const batch_t *sent)
{
    batch_t batch;
    batch_init(&batch, &sent->settings);
    batch.units = mem_alloc(sent->unit_count * sizeof *batch.units);
    memcpy(batch.units, sent->units, sent->unit_count * sizeof *batch.units);
    batch.unit_count = batch.unit_capacity = sent->unit_count;
    return batch;
}

static void assert_same(const batch_t *a, const batch_t *b)
{
    assert_true(same_sums(a, b));
}

static void close_all(zmq_msg_t payload[BATCH_PAYLOADS])
{
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
}

static void round_trips(void **state)
{
    (void)state;
    const int sizes[][2] = {{1, 1}, {3, 2}, {64, 64}, {100, 37}, {257, 300}, {400, 400}};
    const int occupancies[] = {-1, 0, 2, 60, 256};
    for (size_t s = 0; s < ARRAY_LENGTH(sizes); s++)
        for (size_t o = 0; o < ARRAY_LENGTH(occupancies); o++)
            for (int compress = 0; compress < 2; compress++) {
                job_settings_t settings = settings_of(sizes[s][0], sizes[s][1]);
                settings.features = o != 1;
                settings.cryptomatte = o % 2 == 0;
                if (o % 2 == 0) strcpy(settings.light_groups, "a=1,b=2+3,sky=infinite,rest");
                batch_t sent = batch_of(&settings, occupancies[o], s + 1), got = receiver_of(&sent);
                zmq_msg_t payload[BATCH_PAYLOADS];
                assert_int_equal(payload_encode(&sent, compress, payload).code, RESULT_OK);
                assert_int_equal(payload_decode(payload, &got).code, RESULT_OK);
                assert_same(&sent, &got);
                /* once more into the memory that is there */
                assert_int_equal(payload_decode(payload, &got).code, RESULT_OK);
                assert_same(&sent, &got);
                close_all(payload);
                batch_free(&sent);
                batch_free(&got);
            }
}

/* What a message of this job takes. */
static int count_of(const job_settings_t *settings)
{
    batch_t batch = batch_of(settings, 60, 1);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&batch, true, payload).code, RESULT_OK);
    int count = payload_count(payload);
    close_all(payload);
    batch_free(&batch);
    return count;
}

static void messages_have_the_payloads_that_their_job_needs(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(64, 64);
    assert_int_equal(count_of(&settings), 3);
    settings.features = false;
    assert_int_equal(count_of(&settings), 3); /* the last one is empty */
    settings.cryptomatte = true;
    assert_int_equal(count_of(&settings), SUM_MATTES + 1);
    strcpy(settings.light_groups, "a=1,rest");
    assert_int_equal(count_of(&settings), BATCH_PAYLOADS);
}

static void sparse_frames_are_small(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(640, 360);
    batch_t batch = batch_of(&settings, 2, 1); /* 0.8% of the pixels */
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&batch, true, payload).code, RESULT_OK);
    assert_true(zmq_msg_size(&payload[1]) < sum_image_values(&settings, SUM_SPLAT) * sizeof(int64_t) / 100);
    close_all(payload);
    batch_free(&batch);
}

static void no_splats_after_some(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(64, 64);
    batch_t with = batch_of(&settings, 100, 1), without = batch_of(&settings, -1, 1),
            got = receiver_of(&with);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&with, true, payload).code, RESULT_OK);
    assert_int_equal(payload_decode(payload, &got).code, RESULT_OK);
    close_all(payload);
    assert_int_equal(payload_encode(&without, true, payload).code, RESULT_OK);
    assert_int_equal(payload_decode(payload, &got).code, RESULT_OK);
    assert_same(&without, &got);
    close_all(payload);
    batch_free(&with);
    batch_free(&without);
    batch_free(&got);
}

static void message_of(zmq_msg_t *message, const uint8_t *bytes, size_t size)
{
    assert_int_equal(zmq_msg_init_size(message, size), 0);
    if (size > 0) memcpy(zmq_msg_data(message), bytes, size);
}

/* Decodes bytes as one payload, `which`, next to good ones; any result will do but a crash. */
static result_t decode_as(const zmq_msg_t good[BATCH_PAYLOADS], int which, const uint8_t *bytes, size_t size,
                          batch_t *batch)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    memcpy(payload, good, sizeof payload); /* decoding only looks */
    message_of(&payload[which], bytes, size);
    result_t result = payload_decode(payload, batch);
    zmq_msg_close(&payload[which]);
    return result;
}

static void refuses_truncated_and_longer_frames(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(90, 50);
    settings.cryptomatte = true;
    strcpy(settings.light_groups, "a=1,rest");
    batch_t sent = batch_of(&settings, 40, 3), got = receiver_of(&sent);
    zmq_msg_t payload[BATCH_PAYLOADS];
    for (int i = 0; i < 2 * BATCH_PAYLOADS; i++) {
        int which = i % BATCH_PAYLOADS, compress = i / BATCH_PAYLOADS;
        assert_int_equal(payload_encode(&sent, compress, payload).code, RESULT_OK);
        size_t size = zmq_msg_size(&payload[which]), step = compress ? 97 : 9973;
        uint8_t *bytes = mem_zalloc(size + 8, 1);
        memcpy(bytes, zmq_msg_data(&payload[which]), size);
        for (size_t cut = 1; cut < size; cut += step)
            assert_int_equal(decode_as(payload, which, bytes, cut, &got).code, RESULT_PROTOCOL);
        assert_int_equal(decode_as(payload, which, bytes, size + 8, &got).code, RESULT_PROTOCOL);
        assert_int_equal(decode_as(payload, which, bytes, size, &got).code, RESULT_OK);
        if (!film_sums[which].frame)
            assert_int_equal(decode_as(payload, which, bytes, 0, &got).code, RESULT_PROTOCOL);
        free(bytes);
        close_all(payload);
    }
    batch_free(&sent);
    batch_free(&got);
}

/* Features are there exactly when the units have them. */
static void refuses_features_of_units_without(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(64, 64);
    batch_t sent = batch_of(&settings, -1, 3), got = receiver_of(&sent);
    zmq_msg_t payload[BATCH_PAYLOADS];
    const uint8_t empty_frames[][8] = {{0}, {1}};
    assert_int_equal(payload_encode(&sent, true, payload).code, RESULT_OK);
    for (size_t i = 0; i < got.unit_count; i++) got.units[i].first = FEATURE_SAMPLES;
    assert_int_equal(payload_decode(payload, &got).code, RESULT_PROTOCOL);
    for (size_t i = 0; i < ARRAY_LENGTH(empty_frames); i++)
        assert_int_equal(decode_as(payload, 2, empty_frames[i], 8, &got).code, RESULT_PROTOCOL);
    assert_int_equal(got.sums[SUM_FEATURES].count, 0);
    assert_null(got.sums[SUM_FEATURES].values);
    assert_int_equal(decode_as(payload, 2, NULL, 0, &got).code, RESULT_OK);
    /* Another number of units with features. */
    got.units[0].first = 0;
    assert_int_equal(payload_decode(payload, &got).code, RESULT_PROTOCOL);
    assert_int_equal(got.sums[SUM_FEATURES].count, 0);
    close_all(payload);
    batch_free(&sent);
    batch_free(&got);
}

/* What is the same from pixel to pixel, or grows evenly, costs next to nothing. */
static void flat_features_are_small(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(640, 360);
    batch_t batch = batch_of(&settings, -1, 1);
    zmq_msg_t payload[BATCH_PAYLOADS];
    for (size_t i = 0; i < batch.sums[SUM_FEATURES].count; i++)
        batch.sums[SUM_FEATURES].values[i] =
            (int64_t)(i % FEATURE_VALUES << 34) + (int64_t)(i / FEATURE_VALUES) * 123456789;
    assert_int_equal(payload_encode(&batch, true, payload).code, RESULT_OK);
    assert_true(zmq_msg_size(&payload[2]) < 4000); /* of 9.7 MB */
    close_all(payload);
    batch_free(&batch);
}

static void refuses_frames_of_another_size(void **state)
{
    (void)state;
    job_settings_t small = settings_of(64, 64), large = settings_of(4096, 4096);
    batch_t sent = batch_of(&small, 40, 3), got;
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&sent, true, payload).code, RESULT_OK);
    batch_init(&got, &large); /* the same units in a larger image: its splats would be 800 MB */
    got.units = sent.units;
    got.unit_count = sent.unit_count;
    assert_int_equal(payload_decode(payload, &got).code, RESULT_PROTOCOL);
    assert_int_equal(got.sums[SUM_SPLAT].count, 0);
    got.unit_count--;
    assert_int_equal(payload_decode(payload, &got).code, RESULT_PROTOCOL);
    got.units = NULL;
    batch_free(&got);
    batch_free(&sent);
    close_all(payload);
}

/* The digest of a batch's units alone, coded one way or the other. */
static hash_t digest_of(const batch_t *batch, bool compress, const unit_t *units, size_t count)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    hash_t digest;
    assert_int_equal(payload_encode(batch, compress, payload).code, RESULT_OK);
    assert_int_equal(payload_digest_units(payload, batch, units, count, &digest).code, RESULT_OK);
    close_all(payload);
    return digest;
}

/* Units have the same digest in whatever batch they come; another bit in one of them makes another one. */
static void some_units_have_a_digest(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(200, 300);
    for (int compress = 0; compress < 2; compress++) {
        batch_t batch = batch_of(&settings, 100, 3), part;
        unit_t chosen[] = {batch.units[5], batch.units[1]};
        hash_t digest = digest_of(&batch, compress, chosen, 2), other;
        batch_init(&part, &settings);
        part.units = mem_alloc(2 * sizeof *part.units);
        part.unit_count = part.unit_capacity = 2;
        memcpy(part.units, chosen, sizeof chosen);
        for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
            if (film_sums[k].frame) continue;
            sum_array_reserve(&part.sums[k], batch_expected_values(&part, k) + 1);
            for (int c = 0; c < 2; c++) {
                size_t from = 0, count = sum_unit_values(&settings, k, &chosen[c]);
                for (size_t u = 0; memcmp(&batch.units[u], &chosen[c], sizeof(unit_t)) != 0; u++)
                    from += sum_unit_values(&settings, k, &batch.units[u]);
                if (count == 0) continue;
                memcpy(part.sums[k].values + part.sums[k].count, batch.sums[k].values + from,
                       count * sizeof(int64_t));
                part.sums[k].count += count;
            }
        }
        other = digest_of(&part, !compress, chosen, 2);
        assert_true(hash_equal(&digest, &other));
        other = digest_of(&part, compress, chosen, 1);
        assert_false(hash_equal(&digest, &other));
        batch.sums[SUM_EYE].values[0] = 7; /* of no unit that was chosen */
        other = digest_of(&batch, compress, chosen, 2);
        assert_true(hash_equal(&digest, &other));
        for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
            if (film_sums[k].frame || part.sums[k].count == 0) continue;
            part.sums[k].values[part.sums[k].count - 1] ^= 1;
            other = digest_of(&part, compress, chosen, 2);
            assert_false(hash_equal(&digest, &other));
            part.sums[k].values[part.sums[k].count - 1] ^= 1;
        }
        batch_free(&part);
        batch_free(&batch);
    }
}

static void survives_mutations_of(int which)
{
    job_settings_t settings = settings_of(90, 50);
    batch_t sent = batch_of(&settings, 40, 3), got = receiver_of(&sent);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&sent, true, payload).code, RESULT_OK);
    size_t size = zmq_msg_size(&payload[which]);
    uint8_t *bytes = mem_alloc(size);
    uint64_t random = 1;
    int failures = 0;
    for (int i = 0; i < 3000; i++) {
        memcpy(bytes, zmq_msg_data(&payload[which]), size);
        uint64_t changes = 1 + draw(&random) % 4;
        /* mostly where the sizes are */
        for (uint64_t c = 0; c < changes; c++)
            bytes[draw(&random) % (draw(&random) % 2 ? 40 : size)] = (uint8_t)draw(&random);
        failures += decode_as(payload, which, bytes, size, &got).code != RESULT_OK;
    }
    assert_true(failures > 700); /* a changed value byte may well decode */
    for (int i = 0; i < 300; i++) {
        for (size_t b = 0; b < size; b++) bytes[b] = (uint8_t)draw(&random);
        assert_int_equal(decode_as(payload, which, bytes, size, &got).code, RESULT_PROTOCOL);
    }
    free(bytes);
    close_all(payload);
    batch_free(&sent);
    batch_free(&got);
}

static void survives_mutations(void **state)
{
    (void)state;
    survives_mutations_of(1);
    survives_mutations_of(2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(round_trips),
        cmocka_unit_test(messages_have_the_payloads_that_their_job_needs),
        cmocka_unit_test(sparse_frames_are_small),
        cmocka_unit_test(no_splats_after_some),
        cmocka_unit_test(refuses_truncated_and_longer_frames),
        cmocka_unit_test(refuses_frames_of_another_size),
        cmocka_unit_test(refuses_features_of_units_without),
        cmocka_unit_test(flat_features_are_small),
        cmocka_unit_test(some_units_have_a_digest),
        cmocka_unit_test(survives_mutations),
    };
    return cmocka_run_group_tests_name("payload", tests, NULL, NULL);
}
