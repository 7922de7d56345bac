/* Tests of master/merge/shared film*.c: however many merge at once, the film has the bits of one merge after
 * the other; a batch that cannot be merged leaves no trace; a snapshot is the film of its moment, whatever
 * happens next.
 */
#include "master/film/shared_film.h"
#include "tests/films.h"
#include "tests/peer.h"

#include <pthread.h>
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

/* With all sums that there are, large enough for several pages of each, and for tiles cut by the rim. */
static job_settings_t job_of_pages(void)
{
    job_settings_t settings = job_settings_default();
    settings.width = 333;
    settings.height = 301;
    settings.tile_size = 32;
    settings.spp = 1000;
    settings.cryptomatte = true;
    strcpy(settings.light_groups, "key=1,rest");
    return settings;
}

static shared_film_t *shared_film_of(const job_settings_t *settings)
{
    film_t *film;
    assert_int_equal(film_new(settings, &film).code, RESULT_OK);
    return shared_film_new(film);
}

/* A frame with something at some of the pixels. */
static void fill_frame(batch_t *batch, sum_kind_t kind, uint64_t *seed)
{
    int64_t *frame = batch_frame(batch, kind);
    for (size_t i = 0; i < sum_image_values(&batch->settings, kind) / 3; i++)
        if (draw(seed) % 8 < *seed % 9)
            for (size_t c = 0; c < 3; c++) frame[3 * i + c] = (int64_t)draw(seed) >> 8;
}

/* Lessons of a pass, at most places. */
static void fill_lessons(batch_t *batch, uint32_t pass, uint64_t *seed)
{
    if (sum_planes(&batch->settings, SUM_LESSONS) <= pass) return;
    int64_t *plane = batch_frame(batch, SUM_LESSONS) + (size_t)pass * LEARNING_PLACES;
    for (size_t i = 0; i < LEARNING_PLACES; i++)
        if (draw(seed) % 8 > 0) plane[i] = (int64_t)(draw(seed) % (UINT32_C(1) << 31));
}

/* Units of every third tile from `start` on, with splats at some of the pixels. */
static batch_t batch_of(const job_settings_t *settings, uint32_t start, uint32_t first, uint64_t seed)
{
    unit_t *units = mem_alloc(job_tile_count(settings) * sizeof *units);
    size_t count = 0;
    for (uint32_t t = start; t < job_tile_count(settings); t += 3) units[count++] = (unit_t){t, first, 3};
    batch_t batch = peer_render(settings, units, count);
    free(units);
    for (size_t i = 0; i < batch.sums[SUM_EYE].count; i++)
        batch.sums[SUM_EYE].values[i] -= (int64_t)(draw(&seed) % 1000000) << 10;
    for (size_t i = 0; i < batch.sums[SUM_GROUP_EYE].count; i++)
        batch.sums[SUM_GROUP_EYE].values[i] = (int64_t)(draw(&seed) % 1000000) << 10;
    fill_frame(&batch, SUM_SPLAT, &seed);
    fill_frame(&batch, SUM_GROUP_SPLAT, &seed);
    fill_lessons(&batch, learning_pass(settings, first), &seed);
    return batch;
}

static void assert_same_film(const film_t *a, const film_t *b)
{
    for (size_t i = 0; i < shared_film_page_count(&a->settings); i++) {
        size_t size;
        const void *page = shared_film_page(a, i, &size);
        assert_memory_equal(page, shared_film_page(b, i, &size), size);
    }
    assert_memory_equal(&a->counts, &b->counts, sizeof a->counts);
}

/* The film that merging these batches must make. */
static film_t *film_of(const batch_t *batches, size_t count)
{
    film_t *film;
    assert_int_equal(film_new(&batches[0].settings, &film).code, RESULT_OK);
    for (size_t i = 0; i < count; i++) merge_plainly(film, &batches[i]);
    return film;
}

static void assert_snapshot_is(shared_film_snapshot_t *snapshot, const film_t *film, size_t first,
                               size_t step)
{
    uint8_t *bytes = mem_alloc(SHARED_FILM_PAGE_BYTES);
    for (size_t i = first; i < shared_film_page_count(&film->settings); i += step) {
        size_t size, got = shared_film_snapshot_read(snapshot, i, bytes);
        const void *page = shared_film_page(film, i, &size);
        assert_int_equal(got, size);
        assert_memory_equal(bytes, page, size);
    }
    free(bytes);
}

static shared_film_snapshot_t *snapshot_of(shared_film_t *shared_film)
{
    shared_film_lock(shared_film);
    shared_film_snapshot_t *snapshot = shared_film_snapshot(shared_film);
    shared_film_unlock(shared_film);
    return snapshot;
}

static void assert_shared_film_is(shared_film_t *shared_film, const film_t *film)
{
    assert_same_film(shared_film_lock(shared_film), film);
    shared_film_unlock(shared_film);
}

static void assert_empty(shared_film_t *shared_film)
{
    film_t *film;
    const film_t *now = shared_film_lock(shared_film);
    assert_int_equal(film_new(&now->settings, &film).code, RESULT_OK);
    assert_same_film(now, film);
    film_destroy(&film);
    shared_film_unlock(shared_film);
}

static void close_all(zmq_msg_t payload[BATCH_PAYLOADS])
{
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
}

static void merge_one(shared_film_t *shared_film, const batch_t *batch, int sign)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    assert_int_equal(payload_encode(batch, payload).code, RESULT_OK);
    shared_film_enter(shared_film);
    assert_int_equal(shared_film_merge_payload(shared_film, payload, batch, NULL, sign).code, RESULT_OK);
    shared_film_leave(shared_film);
    close_all(payload);
}

/* True when the page ends with one of the sums. */
static bool ends_a_sum(const film_t *film, const uint8_t *page, size_t size)
{
    bool ends = false;
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) {
        size_t values = sum_image_values(&film->settings, k);
        ends |= values > 0 && page + size == (uint8_t *)film_values(film, k) + values * film_sums[k].bytes;
    }
    return ends;
}

static void pages_cover_the_film(void **state)
{
    (void)state;
    for (int all = 0; all < 2; all++) {
        job_settings_t settings = job_of_pages();
        settings.features = settings.cryptomatte = settings.learn = all;
        if (!all) settings.light_groups[0] = '\0';
        film_t *film;
        assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
        size_t sum = 0, size, pixels = (size_t)settings.width * (size_t)settings.height;
        int ends = 0;
        for (size_t i = 0; i < shared_film_page_count(&settings); i++) {
            const uint8_t *page = shared_film_page(film, i, &size);
            assert_true(size > 0 && size <= SHARED_FILM_PAGE_BYTES);
            ends += ends_a_sum(film, page, size);
            sum += size;
        }
        assert_int_equal(ends, all ? FILM_SUMS : 3);
        size_t groups = 2 * (3 + 3) * 8, lessons = (LEARNING_PASSES - 2) * LEARNING_PLACES * 8;
        assert_int_equal(
            sum, pixels * (6 * 8 + 6 * 8 + 2 * 4 + (all ? 8 * (FEATURE_VALUES + MATTE_VALUES) + groups : 0)) +
                     (all ? lessons : 0));
        film_destroy(&film);
    }
}

static void merging_makes_the_film(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batches[6];
    for (uint32_t i = 0; i < 6; i++) batches[i] = batch_of(&settings, i % 3, 3 * (i / 3), i + 1);
    film_t *film = film_of(batches, 6);
    for (int compress = 0; compress < 2; compress++) {
        shared_film_t *shared_film = shared_film_of(&settings);
        for (size_t i = 0; i < 6; i++) {
            zmq_msg_t payload[BATCH_PAYLOADS];
            assert_int_equal(encode_either(&batches[i], compress, payload).code, RESULT_OK);
            shared_film_enter(shared_film);
            assert_int_equal(shared_film_merge_payload(shared_film, payload, &batches[i], NULL, 1).code,
                             RESULT_OK);
            shared_film_leave(shared_film);
            close_all(payload);
        }
        film_counts_t counts = shared_film_counts(shared_film);
        assert_memory_equal(&counts, &film->counts, sizeof counts);
        assert_shared_film_is(shared_film, film);
        shared_film_destroy(&shared_film);
        assert_null(shared_film);
    }
    film_destroy(&film);
    for (size_t i = 0; i < 6; i++) batch_free(&batches[i]);
}

static void eye_sums_and_samples_are_weighted(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batch = batch_of(&settings, 0, 8, 1), weighted = batch_of(&settings, 0, 8, 1);
    uint32_t *weights = mem_alloc(batch.unit_count * sizeof *weights);
    int64_t *value = weighted.sums[SUM_EYE].values, *group = weighted.sums[SUM_GROUP_EYE].values;
    for (size_t i = 0; i < batch.unit_count; i++) {
        weights[i] = 1 + (uint32_t)i % JOB_MAX_BOOST;
        for (size_t v = sum_unit_values(&settings, SUM_EYE, &batch.units[i]); v > 0; v--)
            *value++ *= weights[i];
        for (size_t v = sum_unit_values(&settings, SUM_GROUP_EYE, &batch.units[i]); v > 0; v--)
            *group++ *= weights[i];
    }
    film_t *film = film_of(&weighted, 1);
    for (size_t i = 0; i < batch.unit_count; i++) { /* merge_plainly knows no weights */
        rect_t rect = job_tile_rect(&settings, batch.units[i].tile);
        for (int half = 0; half < 2; half++)
            for (int y = rect.y0; y < rect.y1; y++)
                for (int x = rect.x0; x < rect.x1; x++)
                    film->samples[(half * settings.height + y) * settings.width + x] *= weights[i];
    }
    for (int compress = 0; compress < 2; compress++) {
        shared_film_t *shared_film = shared_film_of(&settings);
        zmq_msg_t payload[BATCH_PAYLOADS];
        assert_int_equal(encode_either(&batch, compress, payload).code, RESULT_OK);
        shared_film_enter(shared_film);
        assert_int_equal(shared_film_merge_payload(shared_film, payload, &batch, weights, 1).code, RESULT_OK);
        shared_film_leave(shared_film);
        assert_shared_film_is(shared_film, film);
        shared_film_enter(shared_film);
        assert_int_equal(shared_film_merge_payload(shared_film, payload, &batch, weights, -1).code,
                         RESULT_OK);
        shared_film_leave(shared_film);
        assert_empty(shared_film);
        close_all(payload);
        shared_film_destroy(&shared_film);
    }
    film_destroy(&film);
    free(weights);
    batch_free(&batch);
    batch_free(&weighted);
}

/* ---- what is no good leaves no trace ------------------------------------------------------------------- */

/* A copy of a payload frame that a test may damage. */
static void copy_frame(zmq_msg_t *copy, const zmq_msg_t *frame, size_t size)
{
    assert_int_equal(zmq_msg_init_size(copy, size), 0);
    memcpy(zmq_msg_data(copy), zmq_msg_data((zmq_msg_t *)frame), size);
}

static result_t merge_payload(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                              const batch_t *batch, int sign)
{
    shared_film_enter(shared_film);
    result_t result = shared_film_merge_payload(shared_film, payload, batch, NULL, sign);
    shared_film_leave(shared_film);
    return result;
}

static void damaged_batches_leave_no_trace(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t before = batch_of(&settings, 1, 0, 2), batch = batch_of(&settings, 0, 0, 3);
    film_t *film = film_of(&before, 1);
    shared_film_t *shared_film = shared_film_of(&settings);
    merge_one(shared_film, &before, 1);
    uint64_t random = 1;
    int refused = 0, rounds = 60;
    for (int i = 0; i < rounds; i++) {
        zmq_msg_t good[BATCH_PAYLOADS], bad[BATCH_PAYLOADS];
        int which = i / 4 % BATCH_PAYLOADS;
        assert_int_equal(encode_either(&batch, i % 4 > 0, good).code, RESULT_OK);
        memcpy(bad, good, sizeof bad);
        size_t size = zmq_msg_size(&good[which]);
        copy_frame(&bad[which], &good[which], i % 7 == 0 ? size - 1 : size);
        uint8_t *bytes = zmq_msg_data(&bad[which]);
        for (int changes = 0; changes < 20; changes++) { /* behind the sizes, so that reading begins */
            size_t at = size / 2 + draw(&random) % (size / 2 - 1);
            if (i % 4 > 0 || at % 8 < 4) bytes[at] ^= (uint8_t)draw(&random); /* no overflows here */
        }
        result_t result = merge_payload(shared_film, bad, &batch, 1);
        refused += result.code != RESULT_OK;
        if (result.code == RESULT_OK) /* it may well be read as something else, which counts then */
            assert_int_equal(merge_payload(shared_film, bad, &batch, -1).code, RESULT_OK);
        else
            assert_int_equal(result.code, RESULT_PROTOCOL);
        shared_film_snapshot_t *snapshot = snapshot_of(shared_film);
        assert_snapshot_is(snapshot, film, 0, 1);
        film_counts_t counts = shared_film_snapshot_counts(snapshot);
        assert_memory_equal(&counts, &film->counts, sizeof counts);
        shared_film_snapshot_free(&snapshot);
        zmq_msg_close(&bad[which]);
        close_all(good);
    }
    assert_true(refused > rounds / 4);
    shared_film_destroy(&shared_film);
    film_destroy(&film);
    batch_free(&before);
    batch_free(&batch);
}

/* Lessons that no sample can add, or of a pass that the batch has no units of. */
static void wild_lessons_leave_no_trace(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batch = batch_of(&settings, 0, 4, 3); /* of pass 2 */
    shared_film_t *shared_film = shared_film_of(&settings);
    const struct {
        size_t pass;
        int64_t value;
    } wild[] = {{2, -1}, {2, INT64_C(1) << 60}, {2, INT64_MAX}, {0, 1}, {3, 1}, {LEARNING_PASSES - 3, 1}};
    for (size_t i = 0; i < 2 * ARRAY_LENGTH(wild); i++) {
        zmq_msg_t payload[BATCH_PAYLOADS];
        size_t at =
            (wild[i / 2].pass + 1) * LEARNING_PLACES - 1 - i; /* near the end: much was added before */
        int64_t value = batch.sums[SUM_LESSONS].values[at];
        batch.sums[SUM_LESSONS].values[at] = wild[i / 2].value;
        assert_int_equal(encode_either(&batch, i % 2, payload).code, RESULT_OK);
        result_t result = merge_payload(shared_film, payload, &batch, 1);
        assert_int_equal(result.code, RESULT_PROTOCOL);
        assert_non_null(strstr(result.message, "lesson"));
        assert_empty(shared_film);
        batch.sums[SUM_LESSONS].values[at] = value;
        close_all(payload);
    }
    merge_one(shared_film, &batch, 1);
    shared_film_destroy(&shared_film);
    batch_free(&batch);
}

/* What plans were made of is not changed by what comes or goes later; all else is. */
static void settled_lessons_stay(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t first = batch_of(&settings, 0, 0, 3), late = batch_of(&settings, 1, 0, 4),
            next = batch_of(&settings, 0, 4, 5);
    size_t plane = LEARNING_PLACES * sizeof(int64_t);
    shared_film_t *shared_film = shared_film_of(&settings);
    merge_one(shared_film, &first, 1);
    merge_one(shared_film, &next, 1);
    shared_film_lock(shared_film);
    shared_film_settle(shared_film, 1);
    shared_film_unlock(shared_film);
    const int64_t *lessons = shared_film_lessons(shared_film);
    merge_one(shared_film, &late, 1);
    assert_memory_equal(lessons, first.sums[SUM_LESSONS].values, plane);
    merge_one(shared_film, &first, -1);
    assert_memory_equal(lessons, first.sums[SUM_LESSONS].values, plane);
    assert_memory_equal(lessons + 2 * LEARNING_PLACES, next.sums[SUM_LESSONS].values + 2 * LEARNING_PLACES,
                        plane);
    merge_one(shared_film, &next, -1);
    for (size_t i = 0; i < LEARNING_PLACES; i++) assert_int_equal(lessons[2 * LEARNING_PLACES + i], 0);
    film_t *expected = film_of(&late, 1); /* else it is as if what was taken out had never been */
    memcpy(expected->sums[SUM_LESSONS], first.sums[SUM_LESSONS].values, plane);
    assert_shared_film_is(shared_film, expected);
    film_destroy(&expected);
    shared_film_destroy(&shared_film);
    batch_free(&first);
    batch_free(&late);
    batch_free(&next);
}

/* Limits that the batch is just within, at one value; its bound is the next power of two. */
static sum_limits_t limits_of(int bits)
{
    sum_limits_t limits = {.measured = true};
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (k != SUM_FEATURES && k != SUM_MATTES) limits.once[k] = (UINT64_C(1) << bits) - 1;
    return limits;
}

static result_t merge_within(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                             const batch_t *batch, sum_limits_t *limits)
{
    shared_film_enter(shared_film);
    result_t result = shared_film_merge_within(shared_film, payload, batch, NULL, limits);
    shared_film_leave(shared_film);
    return result;
}

/* One value of each of the sums of radiance, in turn, is as large as it may be, and one larger; each is found
 * wherever it is, with either sign, and nothing of its batch stays in the film. */
static void values_beyond_limits_leave_no_trace(void **state)
{
    (void)state;
    static const sum_kind_t kinds[] = {SUM_EYE, SUM_SPLAT, SUM_GROUP_EYE, SUM_GROUP_SPLAT};
    enum { BITS = 50 };
    job_settings_t settings = job_of_pages();
    batch_t before = batch_of(&settings, 1, 0, 2), batch = batch_of(&settings, 0, 0, 3);
    film_t *film = film_of(&before, 1);
    shared_film_t *shared_film = shared_film_of(&settings);
    merge_one(shared_film, &before, 1);
    uint64_t random = 1;
    for (int i = 0; i < 32; i++) {
        sum_kind_t kind = kinds[i % 4];
        sum_array_t *sums = &batch.sums[kind];
        size_t at = i < 4 ? 0 : i < 8 ? sums->count - 1 : draw(&random) % sums->count;
        int64_t value = sums->values[at], most = (INT64_C(1) << BITS) - 1;
        for (int beyond = 0; beyond < 2; beyond++) {
            zmq_msg_t payload[BATCH_PAYLOADS];
            sum_limits_t limits = limits_of(BITS);
            limits.measured = i / 8 % 2 > 0;
            sums->values[at] = i % 8 < 4 ? most + beyond : -most - 1 - beyond;
            assert_int_equal(encode_either(&batch, i % 3 > 0, payload).code, RESULT_OK);
            assert_int_equal(merge_within(shared_film, payload, &batch, &limits).code,
                             beyond ? RESULT_CANCELLED : RESULT_OK);
            if (!beyond) {
                if (limits.measured) assert_int_equal(limits.top[kind] >> (BITS - 1), 1);
                assert_int_equal(merge_payload(shared_film, payload, &batch, -1).code, RESULT_OK);
            }
            assert_shared_film_is(shared_film, film);
            close_all(payload);
        }
        sums->values[at] = value;
    }
    shared_film_destroy(&shared_film);
    film_destroy(&film);
    batch_free(&before);
    batch_free(&batch);
}

/* A bound grows with the samples of the unit, and holds before values are weighted. */
static void limits_grow_with_samples(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batch = batch_of(&settings, 0, 0, 3); /* units of 3 samples */
    shared_film_t *shared_film = shared_film_of(&settings);
    zmq_msg_t payload[BATCH_PAYLOADS];
    uint32_t *weights = mem_alloc(batch.unit_count * sizeof *weights);
    for (size_t i = 0; i < batch.unit_count; i++) weights[i] = JOB_MAX_BOOST;
    batch.sums[SUM_EYE].values[7] = (INT64_C(1) << 52) - 1;
    assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
    for (int more = 0; more < 2; more++) {
        sum_limits_t limits = limits_of(50);
        shared_film_enter(shared_film);
        limits.once[SUM_EYE] = more ? (UINT64_C(1) << 50) - 1 : 1;
        limits.each[SUM_EYE] = more ? UINT64_C(1) << 50 : UINT64_C(1) << 48;
        result_t result = shared_film_merge_within(shared_film, payload, &batch, weights, &limits);
        shared_film_leave(shared_film);
        assert_int_equal(result.code, more ? RESULT_OK : RESULT_CANCELLED);
    }
    free(weights);
    close_all(payload);
    shared_film_destroy(&shared_film);
    batch_free(&batch);
}

/* A batch with this value comes so often that one more time is too much. */
static void overflow(sum_kind_t kind, size_t at, int64_t value, int times)
{
    job_settings_t settings = job_of_pages();
    batch_t batch = batch_of(&settings, 0, 0, 3);
    shared_film_t *shared_film = shared_film_of(&settings);
    zmq_msg_t payload[BATCH_PAYLOADS], damaged[BATCH_PAYLOADS];
    sum_limits_t limits = limits_of(62);
    batch.sums[kind].values[at] = value;
    film_t *film = film_of(&batch, 1);
    assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
    for (int i = 0; i < times; i++) {
        if (i > 0) merge_plainly(film, &batch);
        assert_int_equal(merge_within(shared_film, payload, &batch, &limits).code, RESULT_OK);
    }
    assert_int_equal(merge_within(shared_film, payload, &batch, &limits).code, RESULT_CANCELLED);
    assert_shared_film_is(shared_film, film);
    memcpy(damaged, payload, sizeof damaged);
    copy_frame(&damaged[2], &payload[2], zmq_msg_size(&payload[2]) - 1);
    assert_int_equal(merge_within(shared_film, damaged, &batch, &limits).code, RESULT_PROTOCOL);
    assert_shared_film_is(shared_film, film);
    zmq_msg_close(&damaged[2]);
    close_all(payload);
    film_destroy(&film);
    shared_film_destroy(&shared_film);
    batch_free(&batch);
}

/* Values of a splat image lie side by side, those of layers apart. */
static void overflows_within_limits_leave_no_trace(void **state)
{
    (void)state;
    overflow(SUM_SPLAT, 100000, INT64_C(1) << 61, 1);
    overflow(SUM_FEATURES, 100 * FEATURE_VALUES + 4, (INT64_C(3) << 57) - 1, 10);
}

static void overflows_count_only_when_all_is_well(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batch = batch_of(&settings, 0, 0, 3);
    zmq_msg_t payload[BATCH_PAYLOADS], cut;
    shared_film_t *shared_film = shared_film_of(&settings);
    batch.sums[SUM_EYE].values[5] = INT64_C(3) << 60;
    batch.sums[SUM_SPLAT].values[1000] = INT64_MAX;
    batch.sums[SUM_SPLAT].values[2001] = INT64_MIN;
    batch.sums[SUM_SPLAT].values[3002] = -(INT64_C(1) << 62);
    batch.sums[SUM_SPLAT].values[100000] = INT64_C(1) << 61;
    assert_int_equal(payload_encode(&batch, payload).code, RESULT_OK);
    copy_frame(&cut, &payload[2], zmq_msg_size(&payload[2]) - 1);
    zmq_msg_t damaged[BATCH_PAYLOADS];
    memcpy(damaged, payload, sizeof damaged);
    damaged[2] = cut;
    assert_int_equal(merge_payload(shared_film, damaged, &batch, 1).code, RESULT_PROTOCOL);
    assert_empty(shared_film);
    assert_int_equal(merge_payload(shared_film, payload, &batch, 1).code, RESULT_OK);
    assert_int_equal(shared_film_counts(shared_film).overflows, 3);
    film_t *film = film_of(&batch, 1);
    assert_shared_film_is(shared_film, film);
    /* Now sums overflow that did not the first time. */
    assert_int_equal(merge_payload(shared_film, damaged, &batch, 1).code, RESULT_PROTOCOL);
    assert_shared_film_is(shared_film, film);
    assert_int_equal(merge_payload(shared_film, payload, &batch, 1).code, RESULT_OK);
    merge_plainly(film, &batch);
    assert_shared_film_is(shared_film, film);
    assert_int_equal(film->counts.overflows, 3 + 5);
    zmq_msg_close(&cut);
    close_all(payload);
    film_destroy(&film);
    shared_film_destroy(&shared_film);
    batch_free(&batch);
}

static void impossible_features_are_refused(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batch = batch_of(&settings, 0, 30, 3); /* two samples of each pixel have features */
    zmq_msg_t payload[BATCH_PAYLOADS];
    shared_film_t *shared_film = shared_film_of(&settings);
    const int64_t values[] = {INT64_MAX,
                              INT64_MIN,
                              INT64_C(1) << 58,
                              -(INT64_C(1) << 58),
                              (INT64_C(1) << 58) - 1,
                              1 - (INT64_C(1) << 58)};
    for (size_t i = 0; i < 2 * ARRAY_LENGTH(values); i++) {
        batch.sums[SUM_FEATURES].values[batch.sums[SUM_FEATURES].count - 20] = values[i / 2];
        assert_int_equal(encode_either(&batch, i % 2, payload).code, RESULT_OK);
        result_code_t code = merge_payload(shared_film, payload, &batch, 1).code;
        assert_int_equal(code, i / 2 < 4 ? RESULT_PROTOCOL : RESULT_OK);
        if (code == RESULT_OK)
            assert_int_equal(merge_payload(shared_film, payload, &batch, -1).code, RESULT_OK);
        assert_empty(shared_film);
        close_all(payload);
    }
    shared_film_destroy(&shared_film);
    batch_free(&batch);
}

/* ---- snapshots ----------------------------------------------------------------------------------------- */

static void a_snapshot_stays_as_it_was(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batches[] = {batch_of(&settings, 0, 0, 1), batch_of(&settings, 1, 0, 2),
                         batch_of(&settings, 2, 0, 3)};
    film_t *one = film_of(batches, 1), *two = film_of(batches, 2);
    shared_film_t *shared_film = shared_film_of(&settings);
    merge_one(shared_film, &batches[0], 1);
    shared_film_snapshot_t *snapshot = snapshot_of(shared_film);
    assert_snapshot_is(snapshot, one, 0, 2); /* some pages before they change, */
    merge_one(shared_film, &batches[1], 1);
    assert_snapshot_is(snapshot, one, 1, 2); /* the others after */
    film_counts_t counts = shared_film_snapshot_counts(snapshot);
    assert_memory_equal(&counts, &one->counts, sizeof counts);
    shared_film_snapshot_free(&snapshot);
    assert_null(snapshot);
    assert_shared_film_is(shared_film, two);
    snapshot = snapshot_of(shared_film);
    merge_one(shared_film, &batches[2], 1);
    shared_film_snapshot_free(&snapshot); /* unread */
    snapshot = snapshot_of(shared_film);
    merge_one(shared_film, &batches[2], -1);
    shared_film_snapshot_free(&snapshot);
    snapshot = snapshot_of(shared_film);
    assert_snapshot_is(snapshot, two, 0, 1);
    shared_film_snapshot_free(&snapshot);
    shared_film_destroy(&shared_film);
    film_destroy(&one);
    film_destroy(&two);
    for (size_t i = 0; i < 3; i++) batch_free(&batches[i]);
}

/* ---- many at once -------------------------------------------------------------------------------------- */

enum { MERGERS = 4, ROUNDS = 6 };

typedef struct {
    shared_film_t *shared_film;
    const batch_t *batch;
} merger_t;

/* Adds its batch again and again, and in between takes it out. */
static void *merger_run(void *argument)
{
    merger_t *merger = argument;
    for (int i = 0; i < 2 * ROUNDS + 1; i++) merge_one(merger->shared_film, merger->batch, i % 2 ? -1 : 1);
    return NULL;
}

/* True when the film holds each batch whole or not at all, by the light paths and a splat of each. */
static void many_merge_while_others_read(void **state)
{
    (void)state;
    job_settings_t settings = job_of_pages();
    batch_t batches[MERGERS];
    merger_t mergers[MERGERS];
    pthread_t threads[MERGERS];
    shared_film_t *shared_film = shared_film_of(&settings);
    for (uint32_t i = 0; i < MERGERS; i++) {
        batches[i] = batch_of(&settings, i % 3, 3 * i, i + 1);
        for (size_t p = 0; p < sum_image_values(&settings, SUM_SPLAT); p++)
            batches[i].sums[SUM_SPLAT].values[p] = 1 << (8 * i);
        mergers[i] = (merger_t){shared_film, &batches[i]};
    }
    film_t *film = film_of(batches, MERGERS);
    for (int i = 0; i < MERGERS; i++)
        assert_int_equal(pthread_create(&threads[i], NULL, merger_run, &mergers[i]), 0);
    uint8_t *bytes = mem_alloc(SHARED_FILM_PAGE_BYTES);
    for (int i = 0; i < 20; i++) {
        const film_t *now = shared_film_lock(shared_film);
        shared_film_snapshot_t *snapshot = i % 2 ? shared_film_snapshot(shared_film) : NULL;
        int64_t value = now->sums[SUM_SPLAT][0];
        for (size_t p = 0; p < sum_image_values(&settings, SUM_SPLAT); p++)
            assert_true(now->sums[SUM_SPLAT][p] == value);
        shared_film_unlock(shared_film);
        size_t first = ((6 * 8 * (size_t)settings.width * (size_t)settings.height) >> 20) + 1; /* of splats */
        for (size_t p = 0; snapshot != NULL && p < first; p++) {
            size_t size = shared_film_snapshot_read(snapshot, first + p, bytes);
            for (size_t v = 0; v < size / 8; v++) assert_true(((int64_t *)bytes)[v] == value);
        }
        shared_film_snapshot_free(&snapshot);
    }
    free(bytes);
    for (int i = 0; i < MERGERS; i++) pthread_join(threads[i], NULL);
    assert_shared_film_is(shared_film, film);
    shared_film_destroy(&shared_film);
    film_destroy(&film);
    for (int i = 0; i < MERGERS; i++) batch_free(&batches[i]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pages_cover_the_film),
        cmocka_unit_test(merging_makes_the_film),
        cmocka_unit_test(eye_sums_and_samples_are_weighted),
        cmocka_unit_test(wild_lessons_leave_no_trace),
        cmocka_unit_test(settled_lessons_stay),
        cmocka_unit_test(damaged_batches_leave_no_trace),
        cmocka_unit_test(values_beyond_limits_leave_no_trace),
        cmocka_unit_test(limits_grow_with_samples),
        cmocka_unit_test(overflows_within_limits_leave_no_trace),
        cmocka_unit_test(overflows_count_only_when_all_is_well),
        cmocka_unit_test(impossible_features_are_refused),
        cmocka_unit_test(a_snapshot_stays_as_it_was),
        cmocka_unit_test(many_merge_while_others_read),
    };
    return cmocka_run_group_tests_name("shared_film", tests, NULL, NULL);
}
