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
    sum_array_zeroes(&batch->sums[SUM_FEATURES], batch_expected_values(batch, SUM_FEATURES));
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

/* Half of the pixels that are hit have one of a few colours, but for rounding; some of them are wild. */
static void fill_frame(batch_t *batch, sum_kind_t kind, int occupancy, uint64_t *seed)
{
    int64_t *frame = batch_frame(batch, kind);
    for (size_t i = 0; i < batch->sums[kind].count; i += 3) {
        if ((int)(draw(seed) % 256) >= occupancy) continue;
        int64_t shade = (int64_t)(draw(seed) % 5);
        bool known = draw(seed) % 2 == 0;
        for (size_t c = 0; c < 3; c++) frame[i + c] = (int64_t)(draw(seed) % (1 << 30)) - 1000;
        for (size_t c = 1; c < 3 && known; c++)
            frame[i + c] = frame[i] / 7 * (shade + (int64_t)c) + (int64_t)(draw(seed) % 8);
        if (draw(seed) % 500 == 0) frame[i + draw(seed) % 3] = draw(seed) % 2 ? INT64_MIN : INT64_MAX;
    }
}

/* Lessons of some passes, at about `occupancy` of 256 places. */
static void fill_lessons(batch_t *batch, int occupancy, uint64_t *seed)
{
    int64_t *frame = batch_frame(batch, SUM_LESSONS);
    for (size_t i = 0; i < batch->sums[SUM_LESSONS].count; i++)
        if (i / LEARNING_PLACES % 3 == 0 && (int)(draw(seed) % 256) < occupancy)
            frame[i] = (int64_t)draw(seed) >> 40;
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
    }
    sum_array_zeroes(&batch.sums[SUM_EYE], batch_expected_values(&batch, SUM_EYE));
    for (size_t i = 0; i < batch.sums[SUM_EYE].count; i++)
        batch.sums[SUM_EYE].values[i] = (int64_t)draw(&seed) >> (draw(&seed) % 44);
    batch.sums[SUM_EYE].values[0] = INT64_MIN;
    batch.sums[SUM_EYE].values[1] = INT64_MAX;
    batch.sums[SUM_EYE].values[2] = -1;
    if (job_has_features(settings)) fill_features(&batch, &seed);
    fill_mattes(&batch, &seed);
    if (settings->light_groups[0] != '\0') fill_groups(&batch, &seed);
    if (occupancy < 0) return batch;
    if (settings->learn) fill_lessons(&batch, occupancy, &seed);
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
                assert_int_equal(encode_either(&sent, compress, payload).code, RESULT_OK);
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

/* Messages within a process outlive the batch, which has no sums any more and takes new ones. */
static void what_is_wrapped_is_taken_over(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(100, 37);
    batch_t sent = batch_of(&settings, 60, 1), same = batch_of(&settings, 60, 1), got = receiver_of(&sent);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_wrap(&sent, payload).code, RESULT_OK);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) assert_int_equal(sent.sums[k].count, 0);
    batch_clear(&sent);
    memset(batch_frame(&sent, SUM_SPLAT), 1, sent.sums[SUM_SPLAT].count * sizeof(int64_t));
    batch_free(&sent);
    assert_int_equal(payload_decode(payload, &got).code, RESULT_OK);
    assert_same(&same, &got);
    close_all(payload);
    batch_free(&same);
    batch_free(&got);
}

/* What a message of this job takes. */
static int count_of(const job_settings_t *settings)
{
    batch_t batch = batch_of(settings, 60, 1);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
    int count = payload_count(payload);
    close_all(payload);
    batch_free(&batch);
    return count;
}

static void messages_have_the_payloads_that_their_job_needs(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(64, 64);
    settings.learn = false;
    assert_int_equal(count_of(&settings), 3);
    settings.features = false;
    assert_int_equal(count_of(&settings), 3); /* the last one is empty */
    settings.cryptomatte = true;
    assert_int_equal(count_of(&settings), SUM_MATTES + 1);
    strcpy(settings.light_groups, "a=1,rest");
    assert_int_equal(count_of(&settings), SUM_GROUP_SPLAT + 1);
    settings.learn = true;
    assert_int_equal(count_of(&settings), BATCH_PAYLOADS);
}

static void sparse_frames_are_small(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(640, 360);
    batch_t batch = batch_of(&settings, 2, 1); /* 0.8% of the pixels */
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
    assert_true(zmq_msg_size(&payload[1]) < sum_image_values(&settings, SUM_SPLAT) * sizeof(int64_t) / 100);
    close_all(payload);
    batch_free(&batch);
}

/* Where green and blue follow from red they cost next to nothing; with many colours, a few bits each. */
static void splats_of_few_colours_are_small(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(640, 360);
    size_t sizes[3];
    const int64_t colours[] = {1, 30, 1 << 30};
    for (int i = 0; i < 3; i++) {
        batch_t batch = batch_of(&settings, -1, 1);
        int64_t *frame = batch_frame(&batch, SUM_SPLAT);
        uint64_t seed = 1;
        for (size_t p = 0; p < batch.sums[SUM_SPLAT].count; p += 3) {
            double shade = 0.1 + 1e-9 * (double)(draw(&seed) % (uint64_t)colours[i]) * (1 << 25);
            frame[p] = 1000 + (int64_t)(draw(&seed) % (1 << 24)) * 64;
            frame[p + 1] = (int64_t)(shade * (double)frame[p]) + (int64_t)(draw(&seed) % 4);
            frame[p + 2] = (int64_t)(0.7 * shade * (double)frame[p]) + (int64_t)(draw(&seed) % 4);
        }
        zmq_msg_t payload[BATCH_PAYLOADS];
        assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
        sizes[i] = zmq_msg_size(&payload[SUM_SPLAT]);
        close_all(payload);
        batch_free(&batch);
    }
    assert_true(2 * sizes[0] < sizes[2]);
    assert_true(5 * sizes[1] < 3 * sizes[2]);
}

static void no_splats_after_some(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(64, 64);
    batch_t with = batch_of(&settings, 100, 1), without = batch_of(&settings, -1, 1),
            got = receiver_of(&with);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&with, payload).code, RESULT_OK);
    assert_int_equal(payload_decode(payload, &got).code, RESULT_OK);
    close_all(payload);
    assert_int_equal(payload_encode(&without, payload).code, RESULT_OK);
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

/* The example of PROTOCOL.md: a frame of two pixels, of which the first has the only colour. */
static const uint8_t EXAMPLE[] = {
    2,  0, 0, 0,    1,    0,   0,  0,    /* streams, 1 band */
    41, 0, 0, 0,                         /* its size */
    1,  0, 0, 0x80, 3,                   /* the mask, stored: both pixels */
    1,  0, 0, 0,    8,    0,   0,  0, 4, /* 1 colour: green is half of red, blue a quarter */
    2,  0, 0, 0x80, 1,    0,             /* the index, stored */
    1,  2, 0, 0,    0x80, 200, 5,        /* red, 1 plane: 100, -3 */
    1,  2, 0, 0,    0x80, 14,  16,       /* green and blue of the second pixel: 7, 8 */
    1,  2, 0, 0,    0x80, 1,   4,        /* what is left of the first's: -1, 2 */
};
enum { EXAMPLE_COLOURS = 17, EXAMPLE_INDEX = 30, EXAMPLE_RED = 32 };

/* Decodes bytes as the splats of an image of one pixel. */
static result_t decode_splats(const uint8_t *bytes, size_t size, batch_t *batch)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    job_settings_t settings = settings_of(1, 1);
    batch_init(batch, &settings);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_init(&payload[i]);
    result_t result = decode_as(payload, SUM_SPLAT, bytes, size, batch);
    close_all(payload);
    return result;
}

/* Decodes the example with one byte changed. */
static result_t decode_example(size_t place, uint8_t byte, batch_t *batch)
{
    uint8_t bytes[sizeof EXAMPLE];
    memcpy(bytes, EXAMPLE, sizeof bytes);
    bytes[place] = byte;
    return decode_splats(bytes, sizeof bytes, batch);
}

/* The same with so many colours more, which no pixel has. */
static result_code_t decode_more_colours(size_t more)
{
    uint8_t bytes[sizeof EXAMPLE + 8 * 255] = {0};
    size_t head = EXAMPLE_COLOURS + 9, band = 41 + 8 * more;
    batch_t batch;
    memcpy(bytes, EXAMPLE, head);
    memcpy(bytes + head + 8 * more, EXAMPLE + head, sizeof EXAMPLE - head);
    bytes[8] = (uint8_t)band;
    bytes[9] = (uint8_t)(band >> 8);
    bytes[EXAMPLE_COLOURS] = (uint8_t)(1 + more);
    result_code_t code = decode_splats(bytes, sizeof EXAMPLE + 8 * more, &batch).code;
    batch_free(&batch);
    return code;
}

static void colours_are_read_as_the_protocol_says(void **state)
{
    (void)state;
    const int64_t expected[] = {100, 49, 27, -3, 7, 8};
    batch_t batch;
    assert_int_equal(decode_example(0, EXAMPLE[0], &batch).code, RESULT_OK);
    assert_memory_equal(batch.sums[SUM_SPLAT].values, expected, sizeof expected);
    batch_free(&batch);
    const struct {
        size_t place;
        uint8_t byte;
    } wrong[] = {{EXAMPLE_COLOURS, 0},   {EXAMPLE_COLOURS, 2}, {EXAMPLE_COLOURS, 64}, {EXAMPLE_COLOURS, 255},
                 {EXAMPLE_INDEX, 2},     {EXAMPLE_INDEX, 255}, {EXAMPLE_INDEX, 0},    {EXAMPLE_INDEX + 1, 1},
                 {EXAMPLE_INDEX + 1, 2}, {EXAMPLE_RED, 0},     {EXAMPLE_RED, 9}};
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++) {
        assert_int_equal(decode_example(wrong[i].place, wrong[i].byte, &batch).code, RESULT_PROTOCOL);
        batch_free(&batch);
    }
    assert_int_equal(decode_more_colours(62), RESULT_OK);
    assert_int_equal(decode_more_colours(63), RESULT_PROTOCOL);
    assert_int_equal(decode_more_colours(254), RESULT_PROTOCOL);
}

static uint8_t *put_number(uint8_t *at, uint64_t number, int bytes)
{
    for (int i = 0; i < bytes; i++) *at++ = (uint8_t)(number >> (8 * i));
    return at;
}

/* One band of codec 1, all pixels marked and nothing compressed; returns its end. */
static uint8_t *put_old_band(uint8_t *at, const sum_layout_t *layout, size_t offset, size_t lanes,
                             const int64_t *values, size_t pixels)
{
    size_t mask = (pixels + 7) / 8, count = pixels * lanes;
    at = put_number(at, mask | 0x80000000u, 4);
    for (size_t i = 0; i < mask; i++) *at++ = i < pixels / 8 ? 0xff : (uint8_t)((1 << pixels % 8) - 1);
    *at++ = 8;
    for (int p = 0; p < 8; p++) {
        at = put_number(at, count | 0x80000000u, 4);
        for (size_t i = 0; i < count; i++) {
            const int64_t *value = values + i / lanes * layout->values + offset + i % lanes;
            bool difference = layout->differences && i >= lanes;
            uint64_t v = (uint64_t)*value - (difference ? (uint64_t)value[-(ptrdiff_t)layout->values] : 0);
            *at++ = (uint8_t)((v << 1 ^ (0 - (v >> 63))) >> (8 * p));
        }
    }
    return at;
}

/* Spools of a version that knew no streams may hold such payloads. */
static void reads_payloads_of_earlier_versions(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(90, 50);
    settings.cryptomatte = true;
    batch_t sent = batch_of(&settings, 100, 3), got = receiver_of(&sent);
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(&sent, payload).code, RESULT_OK);
    for (int k = 0; k <= SUM_MATTES; k++) {
        const sum_layout_t *layout = &film_sums[k];
        size_t count = sent.sums[k].count, offset = 0;
        uint8_t *bytes = mem_zalloc(10 * count + 1000, 1), *at = bytes + 8 + 4 * layout->group_count;
        bytes[0] = 1;
        put_number(bytes + 4, layout->group_count, 4);
        for (size_t g = 0; g < layout->group_count; offset += layout->groups[g++]) {
            const uint8_t *begin = at;
            at = put_old_band(at, layout, offset, layout->groups[g], sent.sums[k].values,
                              count / layout->values);
            put_number(bytes + 8 + 4 * g, (size_t)(at - begin), 4);
        }
        assert_int_equal(decode_as(payload, k, bytes, (size_t)(at - bytes), &got).code, RESULT_OK);
        assert_same(&sent, &got);
        free(bytes);
    }
    close_all(payload);
    batch_free(&sent);
    batch_free(&got);
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
        assert_int_equal(encode_either(&sent, compress, payload).code, RESULT_OK);
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
    assert_int_equal(payload_encode(&sent, payload).code, RESULT_OK);
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
    assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
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
    assert_int_equal(payload_encode(&sent, payload).code, RESULT_OK);
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
    assert_int_equal(encode_either(batch, compress, payload).code, RESULT_OK);
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
    assert_int_equal(payload_encode(&sent, payload).code, RESULT_OK);
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
        cmocka_unit_test(what_is_wrapped_is_taken_over),
        cmocka_unit_test(messages_have_the_payloads_that_their_job_needs),
        cmocka_unit_test(sparse_frames_are_small),
        cmocka_unit_test(splats_of_few_colours_are_small),
        cmocka_unit_test(no_splats_after_some),
        cmocka_unit_test(colours_are_read_as_the_protocol_says),
        cmocka_unit_test(reads_payloads_of_earlier_versions),
        cmocka_unit_test(refuses_truncated_and_longer_frames),
        cmocka_unit_test(refuses_frames_of_another_size),
        cmocka_unit_test(refuses_features_of_units_without),
        cmocka_unit_test(flat_features_are_small),
        cmocka_unit_test(some_units_have_a_digest),
        cmocka_unit_test(survives_mutations),
    };
    return cmocka_run_group_tests_name("payload", tests, NULL, NULL);
}
