/* Tests of common/film/film.c: sums are the same bits in whatever order and portions they are made, nothing
 * wraps, and resolving divides each sum by what it must be divided by. */
#include "tests/films.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { WIDTH = 37, HEIGHT = 21, PIXELS = WIDTH * HEIGHT, SPP = 12 };

static job_settings_t small_job(void)
{
    job_settings_t settings = job_settings_default();
    settings.width = WIDTH;
    settings.height = HEIGHT;
    settings.tile_size = 16;
    settings.spp = SPP;
    settings.cryptomatte = true;
    return settings;
}

/* A number that depends on its arguments alone (splitmix64's mix). */
static uint64_t mix(uint64_t a, uint64_t b)
{
    uint64_t z = a * 0x9E3779B97F4A7C15u + b + 0x632BE59BD9B4E019u;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

/* A contribution over many orders of magnitude, now and then negative. */
static float contribution(uint64_t pixel, uint64_t sample, uint64_t channel)
{
    uint64_t bits = mix(mix(pixel, sample), channel);
    float value = ldexpf((float)(bits & 0xFFFF) / 65536.0f, (int)(bits >> 16 & 15) - 8);
    return (bits >> 40 & 7) == 0 ? -value : value;
}

/* The light group that a contribution belongs to. */
static uint32_t group_of(const job_settings_t *settings, uint64_t pixel, uint64_t sample)
{
    uint32_t groups = light_groups_count(settings->light_groups);
    return groups > 0 ? (uint32_t)(mix(pixel, sample + 99) % groups) : 0;
}

static void add_splat(unit_result_t *result, uint32_t pixel, int half, float r, float g, float b)
{
    if (result->splat_count == result->splat_capacity) {
        result->splat_capacity = 2 * result->splat_capacity + 64;
        result->splats = mem_realloc(result->splats, result->splat_capacity * sizeof *result->splats);
    }
    result->splats[result->splat_count++] = (splat_t){pixel | (half != 0 ? SPLAT_HALF_BIT : 0), {r, g, b}};
}

/* What the sample meets first: one in five meets nothing. */
static first_hit_t first_hit(uint64_t pixel, uint64_t sample)
{
    first_hit_t hit = {.hit = mix(pixel, sample + 7) % 5 != 0,
                       .depth = contribution(pixel, sample, 30),
                       .object = (uint32_t)pixel + 1,
                       .material = (uint32_t)sample + 1};
    for (size_t c = 0; c < 3; c++) {
        hit.albedo[c] = contribution(pixel, sample, 10 + c);
        hit.normal[c] = contribution(pixel, sample, 20 + c);
        hit.position[c] = contribution(pixel, sample, 40 + c);
    }
    return hit;
}

/* What a renderer would do: each sample adds to its pixel and splats somewhere else. */
static void render_unit(const job_settings_t *settings, const unit_t *unit, unit_result_t *result)
{
    unit_result_reset(result, settings, unit);
    rect_t rect = job_tile_rect(settings, unit->tile);
    size_t width = (size_t)(rect.x1 - rect.x0), pixels = job_tile_pixels(settings, unit->tile);
    for (uint32_t sample = unit->first; sample < unit->first + unit->count; sample++)
        for (size_t i = 0; i < pixels; i++) {
            uint64_t pixel = ((uint64_t)rect.y0 + i / width) * WIDTH + (uint64_t)rect.x0 + i % width;
            int half = sample % 2;
            float rgb[3];
            for (size_t c = 0; c < 3; c++) rgb[c] = contribution(pixel, sample, c);
            result->counts.overflows += film_add(
                result->sums[SUM_EYE].values + 3 * ((size_t)half * pixels + i), rgb, settings->film_scale);
            uint32_t group = group_of(settings, pixel, sample);
            if (settings->light_groups[0] != '\0')
                film_add(result->sums[SUM_GROUP_EYE].values + 3 * (group * pixels + i), rgb,
                         settings->film_scale);
            first_hit_t hit = first_hit(pixel, sample);
            unit_result_feature(result, i, sample, &hit);
            uint32_t target = (uint32_t)(mix(pixel, sample + 1000) % PIXELS);
            add_splat(result, target | group << SPLAT_GROUP_SHIFT, half, rgb[1], rgb[2], rgb[0]);
            result->counts.light_paths[half]++;
            result->counts.rays += 5;
        }
}

typedef struct {
    unit_t *units;
    size_t count;
} unit_list_t;

/* Every tile cut into runs of `run` samples. */
static unit_list_t cut_job(const job_settings_t *settings, uint32_t run)
{
    unit_list_t list = {mem_alloc((size_t)job_tile_count(settings) * SPP * sizeof(unit_t)), 0};
    for (uint32_t tile = 0; tile < job_tile_count(settings); tile++)
        for (uint32_t first = 0; first < SPP; first += run)
            list.units[list.count++] = (unit_t){tile, first, first + run <= SPP ? run : SPP - first};
    return list;
}

static void shuffle(unit_list_t *list, uint64_t seed)
{
    for (size_t i = list->count; i > 1; i--) {
        size_t j = mix(seed, i) % i;
        unit_t kept = list->units[i - 1];
        list->units[i - 1] = list->units[j];
        list->units[j] = kept;
    }
}

static void merge(film_t *film, const batch_t *batch)
{
    assert_int_equal(merge_as_master(film, batch, NULL, 1).code, RESULT_OK);
}

static void take_out(film_t *film, const batch_t *batch, const uint32_t *weights)
{
    assert_int_equal(merge_as_master(film, batch, weights, -1).code, RESULT_OK);
}

static const char GROUPS[] = "sky=infinite,key=3+4,rest"; /* of no scene */

/* Renders a job, with light groups or without, in units of `run` samples, in an order of its own, `per_batch`
 * units a batch. */
static film_t *render_job(const char *groups, uint32_t run, size_t per_batch, uint64_t seed)
{
    job_settings_t settings = small_job();
    strcpy(settings.light_groups, groups);
    unit_list_t list = cut_job(&settings, run);
    unit_result_t result = {0};
    batch_t batch;
    film_t *film;
    shuffle(&list, seed);
    batch_init(&batch, &settings);
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    for (size_t i = 0; i < list.count; i++) {
        assert_true(job_unit_valid(&settings, &list.units[i]));
        render_unit(&settings, &list.units[i], &result);
        batch_add(&batch, &result);
        if (batch.unit_count < per_batch && i + 1 < list.count) continue;
        merge(film, &batch);
        batch_clear(&batch);
    }
    batch_free(&batch);
    unit_result_free(&result);
    free(list.units);
    return film;
}

static void assert_same_film(const film_t *a, const film_t *b)
{
    assert_true(same_film(a, b));
    assert_memory_equal(&a->counts, &b->counts, sizeof a->counts);
}

static void check_cuts(const char *groups)
{
    const struct {
        uint32_t run;
        size_t per_batch;
    } cases[] = {{SPP, 1000}, {1, 1}, {1, 1000}, {5, 3}, {7, 2}, {2, 7}};
    film_t *expected = render_job(groups, SPP, 1, 0);
    assert_int_equal(expected->counts.overflows, 0);
    assert_int_equal(expected->counts.light_paths[0] + expected->counts.light_paths[1], PIXELS * SPP);
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        film_t *film = render_job(groups, cases[i].run, cases[i].per_batch, i + 1);
        assert_same_film(expected, film);
        film_destroy(&film);
        assert_null(film);
    }
    film_destroy(&expected);
}

static void any_cut_and_order_make_the_same_bits(void **state)
{
    (void)state;
    check_cuts("");
    check_cuts(GROUPS);
}

/* And the picture has the same sums with groups as without. */
static void groups_add_up_to_the_sums(void **state)
{
    (void)state;
    film_t *plain = render_job("", 5, 4, 1), *film = render_job(GROUPS, 5, 4, 2);
    const sum_kind_t pairs[][2] = {{SUM_EYE, SUM_GROUP_EYE}, {SUM_SPLAT, SUM_GROUP_SPLAT}};
    assert_null(plain->sums[SUM_GROUP_EYE]);
    for (size_t k = 0; k < ARRAY_LENGTH(pairs); k++) {
        const int64_t *sums = film->sums[pairs[k][0]], *groups = film->sums[pairs[k][1]];
        size_t values = (size_t)3 * PIXELS;
        assert_memory_equal(plain->sums[pairs[k][0]], sums, 2 * values * sizeof *sums);
        for (size_t v = 0; v < values; v++) {
            assert_true(sums[v] + sums[values + v] ==
                        groups[v] + groups[values + v] + groups[2 * values + v]);
            assert_true(groups[v] != sums[v] + sums[values + v]);
        }
    }
    film_image_t image;
    film_resolve(film, &image);
    assert_null(image.group_eye[0]);
    film_resolve_extras(film, &(film_extras_t){.groups = true}, &image);
    for (size_t v = 0; v < (size_t)3 * PIXELS; v++) {
        double eye = 0, light = 0;
        for (size_t g = 0; g < 3; g++) {
            eye += (double)image.group_eye[g][v];
            light += (double)image.group_light[g][v];
        }
        assert_true(fabs(eye - (double)image.eye[v]) < 1e-3 && fabs(light - (double)image.light[v]) < 1e-3);
    }
    assert_null(image.group_eye[3]);
    film_image_free(&image);
    film_destroy(&plain);
    film_destroy(&film);
}

static void sums_are_those_of_the_samples(void **state)
{
    (void)state;
    film_t *film = render_job("", 5, 4, 9);
    for (uint64_t p = 0; p < PIXELS; p++)
        for (size_t half = 0; half < 2; half++) {
            assert_int_equal(film->samples[half * PIXELS + p], SPP / 2);
            for (size_t c = 0; c < 3; c++) {
                int64_t sum = 0;
                for (uint64_t sample = half; sample < SPP; sample += 2)
                    sum += llrint(ldexp((double)contribution(p, sample, c), FILM_DEFAULT_SCALE));
                assert_true(film->sums[SUM_EYE][3 * (half * PIXELS + p) + c] == sum);
            }
        }
    film_destroy(&film);
}

static void quantising_rounds_to_nearest_even(void **state)
{
    (void)state;
    const int64_t one = INT64_C(1) << 32;
    assert_true(film_quantise(1.0f, 32) == one);
    assert_true(film_quantise(-2.5f, 32) == -one * 5 / 2);
    assert_true(film_quantise(0.0f, 32) == 0);
    assert_true(film_quantise(0.5f, 0) == 0);
    assert_true(film_quantise(1.5f, 0) == 2);
    assert_true(film_quantise(2.5f, 0) == 2);
    assert_true(film_quantise(-0.5f, 0) == 0);
    assert_true(film_quantise(-1.5f, 0) == -2);
    assert_true(film_quantise(0x1p-33f, 32) == 0);
    assert_true(film_quantise(0x1.8p-33f, 32) == 1);
    assert_true(film_quantise(1.0f, FILM_MAX_SCALE) == INT64_C(1) << FILM_MAX_SCALE);
    assert_true(film_quantise(3e38f, 32) == INT64_C(1) << 62);
    assert_true(film_quantise(-3e38f, 0) == -(INT64_C(1) << 62));
    assert_true(film_quantise(0x1p30f, 32) == INT64_C(1) << 62);
    assert_true(film_quantise(0x1.fffffep29f, 32) < INT64_C(1) << 62);
}

static void overflows_are_counted_and_left_out(void **state)
{
    (void)state;
    const float huge[3] = {3e38f, 1.0f, -3e38f}, half_way[3] = {0x1p29f, -0x1p29f, 0.0f};
    int64_t sum[3] = {7, 7, 7};
    assert_int_equal(film_add(sum, huge, 32), 2);
    assert_true(sum[0] == 7 && sum[1] == 7 + (INT64_C(1) << 32) && sum[2] == 7);
    sum[0] = sum[1] = 0;
    assert_int_equal(film_add(sum, half_way, 32), 0);
    assert_int_equal(film_add(sum, half_way, 32), 2);
    assert_true(sum[0] == INT64_C(1) << 61 && sum[1] == -(INT64_C(1) << 61));
}

static void feature_sums_are_those_of_the_samples(void **state)
{
    (void)state;
    film_t *film = render_job("", 5, 4, 9);
    for (uint64_t p = 0; p < PIXELS; p++) {
        const int64_t *sum = film->sums[SUM_FEATURES] + FEATURE_VALUES * p;
        int64_t hits = 0, albedo = 0, normal = 0, position = 0, depth = 0;
        for (uint64_t sample = 0; sample < SPP; sample++) {
            first_hit_t hit = first_hit(p, sample);
            if (!hit.hit) continue;
            hits++;
            albedo += film_quantise(hit.albedo[2], FEATURE_SCALE);
            normal += film_quantise(hit.normal[1], FEATURE_SCALE);
            position += film_quantise(hit.position[0], FEATURE_SCALE);
            depth += film_quantise(hit.depth, FEATURE_SCALE);
        }
        bool first = first_hit(p, 0).hit;
        assert_int_equal(sum[FEATURE_COUNT], SPP);
        assert_int_equal(sum[FEATURE_HITS], hits);
        assert_int_equal(sum[FEATURE_OBJECT], first ? p + 1 : 0);
        assert_int_equal(sum[FEATURE_MATERIAL], first ? 1 : 0);
        assert_true(sum[FEATURE_ALBEDO + 2] == albedo && sum[FEATURE_NORMAL + 1] == normal);
        assert_true(sum[FEATURE_POSITION] == position && sum[FEATURE_DEPTH] == depth);
    }
    film_destroy(&film);
}

/* The slot of a sample in the mattes of a pixel. */
static uint64_t slot(const film_t *film, uint64_t pixel, uint64_t sample)
{
    uint64_t slots = (uint64_t)film->sums[SUM_MATTES][MATTE_VALUES * pixel + sample / 2];
    return slots >> (28 * (sample % 2)) & 0xFFFFFFF;
}

static void mattes_have_a_slot_for_each_sample(void **state)
{
    (void)state;
    film_t *film = render_job("", 5, 4, 9);
    for (uint64_t p = 0; p < PIXELS; p++)
        for (uint64_t sample = 0; sample < MATTE_SAMPLES; sample++)
            assert_int_equal(slot(film, p, sample), sample >= SPP              ? 0
                                                    : first_hit(p, sample).hit ? p + MATTE_FIRST_SHAPE
                                                                               : 1);
    film_destroy(&film);
}

static void put_slot(film_t *film, size_t pixel, size_t sample, uint64_t code)
{
    film->sums[SUM_MATTES][MATTE_VALUES * pixel + sample / 2] += (int64_t)(code << (28 * (sample % 2)));
}

static void assert_rank(const film_image_t *image, matte_kind_t kind, size_t pixel, size_t rank, uint32_t id,
                        float share)
{
    const float *pair = image->mattes[kind][rank / 2] + 4 * pixel + 2 * (rank % 2);
    uint32_t bits;
    memcpy(&bits, pair, sizeof bits);
    if (bits != id || pair[1] != share)
        fail_msg("pixel %zu, rank %zu: id %08x with %g, not %08x with %g", pixel, rank, bits, (double)pair[1],
                 id, (double)share);
}

static void mattes_are_ranked_by_their_shares(void **state)
{
    (void)state;
    /* Shapes 0 and 2 are of one material, 1 and 3 have one name. */
    uint32_t objects[] = {0x50000000, 0x40000000, 0xC0000000, 0x40000000, 1 << 23, 2 << 23, 3 << 23, 4 << 23};
    uint32_t materials[] = {7 << 23, 8 << 23, 7 << 23, 9 << 23, 7 << 23, 7 << 23, 7 << 23, 7 << 23};
    const mattes_t mattes = {.shape_count = 8, .ids = {objects, materials}};
    job_settings_t settings = small_job();
    film_t *film;
    film_image_t image;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    const uint64_t mixed[] = {2, 1, 3, 5,
                              4, 2, 1, 0}; /* in pixel 3, from sample 20 on: shapes 0 - 1 3 2 0 - */
    for (size_t i = 0; i < ARRAY_LENGTH(mixed); i++) put_slot(film, 3, 20 + i, mixed[i]);
    for (size_t i = 0; i < MATTE_SAMPLES; i++) put_slot(film, 4, i, i == 0 ? 2 : 2 + i % 8); /* all eight */
    for (size_t v = 0; v < MATTE_VALUES; v++)
        film->sums[SUM_MATTES][MATTE_VALUES * 5 + v] = -1; /* nonsense */
    film_resolve(film, &image);
    assert_null(image.mattes[MATTE_OBJECT][0]);
    film_resolve_extras(film, &(film_extras_t){.mattes = &mattes}, &image);
    assert_rank(&image, MATTE_OBJECT, 3, 0, 0, 2 / 7.0f); /* three ids have two samples: the lowest first */
    assert_rank(&image, MATTE_OBJECT, 3, 1, 0x40000000, 2 / 7.0f);
    assert_rank(&image, MATTE_OBJECT, 3, 2, 0x50000000, 2 / 7.0f);
    assert_rank(&image, MATTE_OBJECT, 3, 3, 0xC0000000, 1 / 7.0f);
    assert_rank(&image, MATTE_OBJECT, 3, 4, 0, 0);
    assert_rank(&image, MATTE_MATERIAL, 3, 0, 7 << 23, 3 / 7.0f);
    assert_rank(&image, MATTE_OBJECT, 4, 0, 0x40000000, 8 / 32.0f);
    for (uint32_t r = 1; r < 5; r++) assert_rank(&image, MATTE_OBJECT, 4, r, r << 23, 4 / 32.0f);
    assert_rank(&image, MATTE_OBJECT, 4, 5, 0x50000000, 4 / 32.0f); /* the seventh, 0xC0000000, is left out */
    assert_rank(&image, MATTE_OBJECT, 5, 0, 0, 1);                  /* no shape has such a code */
    assert_rank(&image, MATTE_OBJECT, 0, 0, 0, 0);                  /* no samples */
    film_image_free(&image);
    film_destroy(&film);
}

/* Only the first samples of a pixel contribute, and units beyond them carry nothing. */
static void features_end_after_the_first_samples(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    settings.spp = 100;
    unit_result_t result = {0};
    batch_t batch;
    film_t *film;
    batch_init(&batch, &settings);
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    const unit_t units[] = {{0, 60, 40}, {1, 31, 29}, {0, 0, 30}, {0, 30, 30}, {2, 32, 1}};
    for (size_t i = 0; i < ARRAY_LENGTH(units); i++) {
        render_unit(&settings, &units[i], &result);
        assert_int_equal(result.sums[SUM_FEATURES].count > 0, units[i].first < FEATURE_SAMPLES);
        assert_int_equal(sum_unit_values(&settings, SUM_FEATURES, &units[i]),
                         result.sums[SUM_FEATURES].count > 0 ? FEATURE_VALUES * 256 : 0);
        batch_add(&batch, &result);
    }
    assert_int_equal(batch.sums[SUM_FEATURES].count, 3 * FEATURE_VALUES * 256);
    merge(film, &batch);
    rect_t second = job_tile_rect(&settings, 1), third = job_tile_rect(&settings, 2);
    assert_int_equal(film->sums[SUM_FEATURES][FEATURE_COUNT], FEATURE_SAMPLES);
    assert_int_equal(film->sums[SUM_FEATURES][FEATURE_VALUES * second.x0 + FEATURE_COUNT], 1);
    assert_int_equal(film->sums[SUM_FEATURES][FEATURE_VALUES * second.x0 + FEATURE_OBJECT],
                     0); /* no sample 0 yet */
    assert_int_equal(film->sums[SUM_FEATURES][FEATURE_VALUES * third.x0 + FEATURE_COUNT], 0);
    batch_free(&batch);
    film_destroy(&film);

    settings.features = false;
    unit_result_reset(&result, &settings, &units[2]);
    assert_int_equal(result.sums[SUM_FEATURES].count, 0);
    unit_result_feature(&result, 0, 0, &(first_hit_t){.hit = true}); /* does nothing */
    settings.features = true;
    settings.integrator = INTEGRATOR_LIGHT;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    assert_null(film->sums[SUM_FEATURES]);
    assert_int_equal(sum_unit_values(&settings, SUM_FEATURES, &units[2]), 0);
    film_destroy(&film);
    unit_result_free(&result);
}

static void features_are_clamped_and_never_overflow(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    settings.spp = FEATURE_SAMPLES;
    unit_result_t result = {0};
    batch_t batch;
    film_t *film;
    film_image_t image;
    batch_init(&batch, &settings);
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    unit_result_reset(&result, &settings, &(unit_t){0, 0, FEATURE_SAMPLES});
    const first_hit_t far = {true, {1e30f, 0, 0}, {0, -1e30f, 0}, {3e38f, -3e38f, 1}, 3e38f, 5, UINT32_MAX};
    first_hit_t broken[] = {far, far, far};
    broken[0].depth = INFINITY;
    broken[1].normal[2] = NAN;
    broken[2].position[1] = -INFINITY;
    for (uint32_t i = 0; i < FEATURE_SAMPLES; i++) unit_result_feature(&result, 3, i, &far);
    for (uint32_t i = 0; i < 3; i++) unit_result_feature(&result, 4, i, &broken[i]);
    assert_int_equal(result.counts.dropped, 3);
    assert_int_equal(result.sums[SUM_FEATURES].values[4 * FEATURE_VALUES + FEATURE_COUNT], 0);
    batch_add(&batch, &result);
    merge(film, &batch);
    assert_int_equal(film->counts.overflows, 0);
    film_resolve(film, &image);
    assert_true(image.depth[3] == 0x1.fffffep24f && image.position[9] == 0x1.fffffep24f);
    assert_true(image.position[10] == -0x1.fffffep24f && image.position[11] == 1.0f);
    assert_true(image.object[3] == 5.0f && image.material[3] == 0x1p32f && image.coverage[3] == 1.0f);
    assert_true(image.coverage[4] == 0.0f && image.depth[4] == 0.0f);
    film_image_free(&image);
    /* Sums that no renderer makes leave no trace. */
    for (size_t v = 0; v < batch.sums[SUM_FEATURES].count; v++)
        batch.sums[SUM_FEATURES].values[v] = v % 2 ? INT64_MAX : INT64_MIN;
    assert_int_equal(merge_as_master(film, &batch, NULL, 1).code, RESULT_PROTOCOL);
    assert_int_equal(film->counts.overflows, 0);
    assert_int_equal(film->sums[SUM_FEATURES][3 * FEATURE_VALUES + FEATURE_COUNT], FEATURE_SAMPLES);
    batch_free(&batch);
    unit_result_free(&result);
    film_destroy(&film);
}

/* A batch of one unit of one sample, in tile 0. */
static void make_batch(const job_settings_t *settings, unit_result_t *result, batch_t *batch)
{
    unit_result_reset(result, settings, &(unit_t){0, 0, 1});
    batch_init(batch, settings);
}

static void merging_cannot_wrap(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    unit_result_t result = {0};
    batch_t batch;
    film_t *film;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    make_batch(&settings, &result, &batch);
    result.sums[SUM_EYE].values[0] = INT64_C(1) << 61;
    result.sums[SUM_EYE].values[1] = INT64_MIN; /* no renderer makes these, but a peer may send them */
    result.sums[SUM_EYE].values[2] = INT64_MAX;
    add_splat(&result, 5, 1, 0x1p29f, 3e38f, 1.0f);
    batch_add(&batch, &result);
    assert_int_equal(batch.counts.overflows, 1);
    merge(film, &batch);
    assert_int_equal(film->counts.overflows, 3);
    assert_true(film->sums[SUM_EYE][0] == INT64_C(1) << 61 && film->sums[SUM_EYE][1] == 0 &&
                film->sums[SUM_EYE][2] == 0);
    merge(film, &batch);
    assert_int_equal(film->counts.overflows, 8); /* 1 from the batch, 3 eye values and a splat value here */
    assert_true(film->sums[SUM_EYE][0] == INT64_C(1) << 61);
    assert_true(film->sums[SUM_SPLAT][3 * (PIXELS + 5)] == INT64_C(1) << 61);
    assert_true(film->sums[SUM_SPLAT][3 * (PIXELS + 5) + 2] == INT64_C(2) << 32);
    batch_free(&batch);
    unit_result_free(&result);
    film_destroy(&film);
}

static void weighted_sums_cannot_wrap(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    unit_result_t result = {0};
    batch_t batch;
    film_t *film;
    const int64_t most = ((INT64_C(1) << 62) - 1) / 16;
    const int64_t values[] = {most, most + 1, -most, -most - 1, INT64_MAX, INT64_MIN, INT64_C(1) << 60};
    const uint32_t weight = 16;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    make_batch(&settings, &result, &batch);
    memcpy(result.sums[SUM_EYE].values, values, sizeof values);
    batch_add(&batch, &result);
    assert_int_equal(merge_as_master(film, &batch, &weight, 1).code, RESULT_OK);
    assert_int_equal(film->counts.overflows, 5);
    for (size_t i = 0; i < ARRAY_LENGTH(values); i++)
        assert_true(film->sums[SUM_EYE][i] == (i == 0 || i == 2 ? 16 * values[i] : 0));
    batch_free(&batch);
    unit_result_free(&result);
    film_destroy(&film);
}

static void a_batch_is_reusable(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    unit_result_t result = {0};
    batch_t batch;
    make_batch(&settings, &result, &batch);
    batch_add(&batch, &result);
    assert_int_equal(batch.sums[SUM_SPLAT].count, 0); /* no frame without splats */
    add_splat(&result, PIXELS - 1, 0, 1, 2, 3);
    batch_add(&batch, &result);
    assert_int_equal(batch.unit_count, 2);
    assert_int_equal(batch.sums[SUM_EYE].count, 2 * sum_unit_values(&settings, SUM_EYE, &(unit_t){0, 0, 1}));
    assert_true(batch.sums[SUM_SPLAT].values[3 * (PIXELS - 1) + 2] == INT64_C(3) << 32);
    batch_clear(&batch);
    assert_int_equal(batch.unit_count, 0);
    assert_int_equal(batch.sums[SUM_EYE].count, 0);
    for (size_t v = 0; v < sum_image_values(&settings, SUM_SPLAT); v++)
        assert_true(batch.sums[SUM_SPLAT].values[v] == 0);
    /* A unit that is reset forgets the one before. */
    result.sums[SUM_EYE].values[3] = 9;
    unit_result_reset(&result, &settings, &(unit_t){5, 3, 2});
    assert_int_equal(result.splat_count, 0);
    for (size_t v = 0; v < result.sums[SUM_EYE].count; v++) assert_true(result.sums[SUM_EYE].values[v] == 0);
    batch_free(&batch);
    unit_result_free(&result);
}

/* ---- resolving ---- */

static int64_t fixed(double value)
{
    return llrint(ldexp(value, FILM_DEFAULT_SCALE));
}

static void each_sum_has_its_own_divisor(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    film_t *film;
    film_image_t image;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    /* Pixel 3: 4 even and 2 odd samples; pixel 9: one even sample; pixel 0: none. */
    film->samples[3] = 4;
    film->samples[PIXELS + 3] = 2;
    film->samples[9] = 1;
    film->counts.light_paths[0] = 1000;
    film->counts.light_paths[1] = 500;
    film->sums[SUM_EYE][3 * 3 + 1] = fixed(8.0);
    film->sums[SUM_EYE][3 * (PIXELS + 3) + 1] = fixed(1.0);
    film->sums[SUM_SPLAT][3 * 3 + 1] = fixed(3.0);
    film->sums[SUM_SPLAT][3 * (PIXELS + 3) + 1] = fixed(1.5);
    film->sums[SUM_EYE][3 * 9] = fixed(0.25);
    film->sums[SUM_SPLAT][0] = fixed(5.0);
    film_resolve(film, &image);
    assert_null(image.half[0]); /* nobody wanted them */
    film_resolve_extras(film, &(film_extras_t){.halves = true}, &image);

    double eye = 9.0 / 6, light = 4.5 * PIXELS / 1500;
    assert_true(fabs((double)image.eye[3 * 3 + 1] - eye) < 1e-6);
    assert_true(fabs((double)image.light[3 * 3 + 1] - light) < 1e-6);
    assert_true(fabs((double)image.sum[3 * 3 + 1] - eye - light) < 1e-6);
    /* The halves are 8 / 4 + 3 PIXELS / 1000 and 1 / 2 + 1.5 PIXELS / 500: the splats are the same. */
    assert_true(fabs((double)image.noise[3 * 3 + 1] - sqrt(4.0 * 2.0) / 6 * 1.5) < 1e-6);
    double halves[2] = {8.0 / 4 + 3.0 * PIXELS / 1000, 1.0 / 2 + 1.5 * PIXELS / 500};
    for (int h = 0; h < 2; h++) {
        assert_true(fabs((double)image.half[h][3 * 3 + 1] - halves[h]) < 1e-6);
        assert_true(image.half[h][3 * 3] == 0.0f && image.half[h][0] == 0.0f); /* nothing; no samples */
    }
    assert_true(image.half[0][3 * 9] == 0.25f && image.half[1][3 * 9] == 0.0f);
    assert_true(image.samples[3] == 6.0f && image.samples[9] == 1.0f && image.samples[0] == 0.0f);
    assert_true(image.sum[3 * 3] == 0.0f && image.noise[3 * 3] == 0.0f);
    /* With one half only, all of the value may be noise. */
    assert_true(image.sum[3 * 9] == 0.25f && image.noise[3 * 9] == 0.25f);
    assert_true(image.sum[0] == 0.0f && image.light[0] == 0.0f); /* no samples: black */
    film_image_free(&image);
    film_destroy(&film);
}

static void features_resolve_to_means(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    film_t *film;
    film_image_t image;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    film_resolve(film, &image);
    assert_null(image.albedo); /* not a sample: no planes */
    film_image_free(&image);
    /* Pixel 3: three of four samples hit; pixel 9: a peer's nonsense. */
    int64_t *sum = film->sums[SUM_FEATURES] + 3 * FEATURE_VALUES,
            *odd = film->sums[SUM_FEATURES] + 9 * FEATURE_VALUES;
    sum[FEATURE_COUNT] = 4;
    sum[FEATURE_HITS] = 3;
    sum[FEATURE_OBJECT] = 17;
    sum[FEATURE_MATERIAL] = 2;
    sum[FEATURE_ALBEDO + 1] = fixed(3.0);
    sum[FEATURE_NORMAL] = fixed(-1.0);
    sum[FEATURE_POSITION + 2] = fixed(12.0);
    sum[FEATURE_DEPTH] = fixed(6.0);
    odd[FEATURE_COUNT] = -1;
    odd[FEATURE_DEPTH] = fixed(1.0);
    film_resolve(film, &image);
    assert_true(image.albedo[10] == 0.75f && image.normal[9] == -0.25f);
    assert_true(image.position[11] == 4.0f && image.depth[3] == 2.0f);
    assert_true(image.object[3] == 17.0f && image.material[3] == 2.0f && image.coverage[3] == 0.75f);
    assert_true(image.depth[9] == 0.0f && image.coverage[9] == 0.0f);
    assert_true(image.coverage[0] == 0.0f && image.position[0] == 0.0f);
    film_image_free(&image);
    film_destroy(&film);
}

/* ---- weights ------------------------------------------------------------------------------------------- */

static void sums_are_added_and_never_wrap(void **state)
{
    (void)state;
    const int64_t top = (INT64_C(1) << 62) - 1;
    const struct {
        int64_t sum, more;
        bool fits;
    } cases[] = {{5, 7, true},        {top - 16, 16, true},  {top - 15, 16, false}, {-top, top, true},
                 {-top, -1, false},   {1 - top, -1, true},   {0, top, true},        {0, -top, true},
                 {0, top + 1, false}, {0, -top - 1, false},  {0, INT64_MAX, false}, {0, INT64_MIN, false},
                 {top, top, false},   {INT64_MAX, 1, false}, {INT64_MIN, -1, false}};
    /* Each at every place of a longer run: vectors and their rests. */
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        for (size_t place = 0; place < 11; place++) {
            int64_t sum[11], more[11];
            for (size_t k = 0; k < 11; k++) {
                sum[k] = k == place ? cases[i].sum : (int64_t)k;
                more[k] = k == place ? cases[i].more : -(int64_t)k;
            }
            assert_int_equal(film_add_sums(sum, more, 11), !cases[i].fits);
            for (size_t k = 0; k < 11; k++) {
                int64_t expected = 0;
                if (k == place) expected = cases[i].sum;
                if (k == place && cases[i].fits) expected += cases[i].more;
                assert_int_equal(sum[k], expected);
            }
        }
}

/* A batch of some units of the job. */
static void render_batch(const job_settings_t *settings, const unit_t *units, size_t count, batch_t *batch)
{
    unit_result_t result = {0};
    batch_init(batch, settings);
    for (size_t i = 0; i < count; i++) {
        render_unit(settings, &units[i], &result);
        batch_add(batch, &result);
    }
    unit_result_free(&result);
}

/* Samples that weigh w are as good as the same samples w times, in everything that belongs to pixels; splats
 * and features count once. And all of it can be taken out again. */
static void weights_are_repetitions(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    const unit_t units[] = {{0, 0, 3}, {4, 1, 2}, {0, 3, 4}};
    const uint32_t weights[] = {5, 1, 16};
    film_t *weighted, *repeated, *empty;
    batch_t batch, one;
    assert_int_equal(film_new(&settings, &weighted).code, RESULT_OK);
    assert_int_equal(film_new(&settings, &repeated).code, RESULT_OK);
    assert_int_equal(film_new(&settings, &empty).code, RESULT_OK);
    render_batch(&settings, units, 3, &batch);
    assert_int_equal(merge_as_master(weighted, &batch, weights, 1).code, RESULT_OK);
    for (size_t i = 0; i < 3; i++)
        for (uint32_t k = 0; k < weights[i]; k++) {
            render_batch(&settings, &units[i], 1, &one);
            merge(repeated, &one);
            batch_free(&one);
        }
    size_t sums = sum_image_values(&settings, SUM_SPLAT);
    assert_memory_equal(weighted->sums[SUM_EYE], repeated->sums[SUM_EYE], sums * sizeof(int64_t));
    assert_memory_equal(weighted->samples, repeated->samples, sums / 3 * sizeof(uint32_t));
    assert_memory_equal(weighted->sums[SUM_SPLAT], batch.sums[SUM_SPLAT].values, sums * sizeof(int64_t));
    assert_int_equal(weighted->counts.light_paths[0], batch.counts.light_paths[0]);
    merge(repeated, &batch);
    take_out(repeated, &batch, NULL);
    assert_memory_equal(weighted->sums[SUM_EYE], repeated->sums[SUM_EYE], sums * sizeof(int64_t));
    take_out(weighted, &batch, weights);
    assert_same_film(weighted, empty);
    film_destroy(&weighted);
    film_destroy(&repeated);
    film_destroy(&empty);
    batch_free(&batch);
}

static void digests_are_of_the_contents(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    strcpy(settings.light_groups, GROUPS);
    const unit_t units[] = {{0, 0, 3}, {4, 1, 2}, {0, 3, 4}, {1, 40, 1}},
                 other_order[] = {{1, 40, 1}, {0, 3, 4}, {0, 0, 3}, {4, 1, 2}};
    batch_t a, b;
    hash_t first, second;
    render_batch(&settings, units, 4, &a);
    render_batch(&settings, other_order, 4, &b);
    b.counts.cpu_us = 77;
    batch_digest(&a, &first);
    batch_digest(&b, &second);
    assert_true(hash_equal(&first, &second));
    int64_t *places[] = {&b.sums[SUM_EYE].values[5],
                         &b.sums[SUM_EYE].values[b.sums[SUM_EYE].count - 1],
                         &b.sums[SUM_FEATURES].values[FEATURE_VALUES + 2],
                         &b.sums[SUM_SPLAT].values[3],
                         &b.sums[SUM_GROUP_EYE].values[b.sums[SUM_GROUP_EYE].count - 1],
                         &b.sums[SUM_GROUP_SPLAT].values[b.sums[SUM_GROUP_SPLAT].count - 1],
                         &b.sums[SUM_FEATURES].values[b.sums[SUM_FEATURES].count - 1],
                         (int64_t *)&b.counts.light_paths[1]};
    for (size_t i = 0; i < ARRAY_LENGTH(places); i++) {
        *places[i] ^= 1;
        batch_digest(&b, &second);
        assert_false(hash_equal(&first, &second));
        *places[i] ^= 1;
    }
    b.units[2].first++;
    batch_digest(&b, &second);
    assert_false(hash_equal(&first, &second));
    b.units[2].first--;
    batch_digest(&b, &second);
    assert_true(hash_equal(&first, &second));
    /* What is not there is zero. */
    memset(a.sums[SUM_SPLAT].values, 0,
           sum_image_values(&settings, SUM_SPLAT) * sizeof *a.sums[SUM_SPLAT].values);
    memset(a.sums[SUM_FEATURES].values, 0, a.sums[SUM_FEATURES].count * sizeof *a.sums[SUM_FEATURES].values);
    b.sums[SUM_SPLAT].count = b.sums[SUM_FEATURES].count = 0;
    batch_digest(&a, &first);
    batch_digest(&b, &second);
    assert_true(hash_equal(&first, &second));
    batch_free(&a);
    batch_free(&b);
}

/* ---- noise --------------------------------------------------------------------------------------------- */

static double normal(uint64_t seed, uint64_t index)
{
    double u = ((double)(mix(seed, 2 * index) >> 11) + 0.5) * 0x1p-53;
    double v = ((double)(mix(seed, 2 * index + 1) >> 11) + 0.5) * 0x1p-53;
    return sqrt(-2 * log(u)) * cos(6.283185307179586 * v);
}

/* The mean square of the noise layer is the variance of the image, eye and splats together, also where the
 * halves have different numbers of samples. */
static void noise_is_the_standard_error(void **state)
{
    (void)state;
    enum { EVEN = 6, ODD = 4 };
    job_settings_t settings = small_job();
    double noise2 = 0, error2 = 0;
    for (uint64_t round = 0; round < 8; round++) {
        film_t *film;
        film_image_t image;
        assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
        film->counts.light_paths[0] = EVEN * PIXELS;
        film->counts.light_paths[1] = ODD * PIXELS;
        for (size_t half = 0; half < 2; half++)
            for (uint64_t p = 0; p < PIXELS; p++) {
                uint32_t count = half == 0 ? EVEN : ODD;
                film->samples[half * PIXELS + p] = count;
                for (size_t v = 3 * (half * PIXELS + p); v < 3 * (half * PIXELS + p) + 3; v++) {
                    film->sums[SUM_EYE][v] = fixed(2.0 * count + 0.5 * sqrt(count) * normal(round, 2 * v));
                    film->sums[SUM_SPLAT][v] =
                        fixed(1.0 * count + 0.3 * sqrt(count) * normal(round, 2 * v + 1));
                }
            }
        film_resolve(film, &image);
        for (size_t v = 0; v < 3 * PIXELS; v++) {
            noise2 += (double)image.noise[v] * (double)image.noise[v];
            error2 += ((double)image.sum[v] - 3.0) * ((double)image.sum[v] - 3.0);
        }
        film_image_free(&image);
        film_destroy(&film);
    }
    double expected = (0.5 * 0.5 + 0.3 * 0.3) / (EVEN + ODD), values = 8.0 * 3 * PIXELS;
    /* The relative standard error of either mean is sqrt(2 / 18648) = 0.010. */
    assert_true(fabs(error2 / values / expected - 1) < 0.05);
    assert_true(fabs(noise2 / values / expected - 1) < 0.05);
}

/* A film whose pixels have value `level` on the left half of the image and 10 * level on the right, and in
 * the first tile an eye noise of `tile_noise` times their value, elsewhere `noise`. */
static film_t *noisy_film(const job_settings_t *settings, double level, double noise, double tile_noise)
{
    film_t *film;
    assert_int_equal(film_new(settings, &film).code, RESULT_OK);
    film->counts.light_paths[0] = film->counts.light_paths[1] = PIXELS;
    for (size_t p = 0; p < PIXELS; p++) {
        size_t x = p % WIDTH, y = p / WIDTH;
        double value = (x < WIDTH / 2 ? 1 : 10) * level, part = x < 16 && y < 16 ? tile_noise : noise;
        film->samples[p] = film->samples[PIXELS + p] = 4;
        for (size_t h = 0; h < 2; h++)
            for (size_t c = 0; c < 3; c++) {
                film->sums[SUM_EYE][3 * (h * PIXELS + p) + c] =
                    fixed(4 * value * (0.75 + (h == 0 ? part : -part)));
                film->sums[SUM_SPLAT][3 * (h * PIXELS + p) + c] = fixed(0.25 * value);
            }
    }
    return film;
}

/* The error is relative: brighter light changes nothing. It is that of the formula in film.h, and the tiles
 * have their shares of it. */
static void the_error_is_relative(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    double left = WIDTH / 2, right = WIDTH - WIDTH / 2, mean = (left + 10 * right) / WIDTH;
    double weight_left = 1 / (1 + 0.25 * mean * mean), weight_right = 100 / (100 + 0.25 * mean * mean);
    double expected = 0.1 * sqrt((left * weight_left + right * weight_right) / WIDTH);
    for (double level = 1e-3; level < 1e4; level *= 30) {
        double tiles[6], sum = 0;
        film_t *film = noisy_film(&settings, level, 0.1, 0.1);
        assert_true(fabs(film_noise(film, tiles) / expected - 1) < 1e-5);
        for (int t = 0; t < 6; t++) sum += tiles[t];
        assert_true(fabs(sqrt(sum / (3 * PIXELS)) / expected - 1) < 1e-5);
        film_destroy(&film);
    }
    double tiles[6];
    film_t *film = noisy_film(&settings, 1, 0, 0.1);
    double error = film_noise(film, tiles);
    assert_true(fabs(tiles[0] / (3 * 256 * 0.01 * weight_left) - 1) < 1e-5);
    for (int t = 1; t < 6; t++) assert_true(tiles[t] == 0);
    assert_true(fabs(error / sqrt(tiles[0] / (3 * PIXELS)) - 1) < 1e-9);
    /* Noise of splats is noise of the image, but not of the tile. */
    film->sums[SUM_SPLAT][3 * 700] += fixed(1.0);
    double more = film_noise(film, tiles);
    assert_true(more > error);
    assert_true(tiles[5] == 0);
    film_image_t image;
    film_resolve(film, &image);
    assert_true(image.error == more);
    film_image_free(&image);
    film_destroy(&film);
}

/* Some rows stand for all: each has its pixels counted as if there were no others. */
static void the_error_of_some_rows_is_that_of_all(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    film_t *film = noisy_film(&settings, 1, 0.1, 0.1);
    double all = film_noise(film, NULL);
    for (size_t pixels = PIXELS; pixels > 0; pixels /= 2)
        assert_true(fabs(film_noise_of_rows(film, pixels) / all - 1) < 1e-9);
    /* A third of the rows, of which row 1 is one and row 0 is none. */
    film->sums[SUM_EYE][0] += fixed(1.0);
    assert_true(fabs(film_noise_of_rows(film, PIXELS / 3) / all - 1) < 1e-9);
    film->sums[SUM_EYE][3 * WIDTH] += fixed(1.0);
    assert_true(film_noise_of_rows(film, PIXELS / 3) > all * (1 + 1e-6));
    assert_true(film_noise_of_rows(film, PIXELS) == film_noise(film, NULL));
    film_destroy(&film);
}

static void a_black_film_has_no_error(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    film_t *film;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    assert_true(isinf(film_noise(film, NULL))); /* nothing yet */
    film->samples[0] = 1;
    assert_true(isinf(film_noise(film, NULL)));
    film->sums[SUM_EYE][1] = fixed(1.0); /* one half only: all of it may be noise */
    assert_true(film_noise(film, NULL) > 0.5);
    film_destroy(&film);
}

/* An adaptive film knows weights; what they stand for is the mean number of samples. */
static void weights_show_as_mean_samples(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    settings.adaptive = true;
    film_t *film = noisy_film(&settings, 1, 0.1, 0.1);
    film_image_t image;
    film_resolve(film, &image);
    assert_true(image.samples[0] == 2);
    film_image_free(&image);
    film_destroy(&film);
}

/* Tiles with different sample counts, some splats still missing: every pixel with samples has the right mean.
 */
static void partial_images_are_unbiased(void **state)
{
    (void)state;
    job_settings_t settings = small_job();
    film_t *film;
    film_image_t image;
    unit_result_t result = {0};
    batch_t batch;
    assert_int_equal(film_new(&settings, &film).code, RESULT_OK);
    batch_init(&batch, &settings);
    /* A constant picture: each sample sees 1 and splats 0.5 on every pixel of its light path's share. */
    for (uint32_t tile = 0; tile < job_tile_count(&settings) - 1; tile++) {
        unit_t unit = {tile, 0, 2 + 2 * (tile % 3)};
        unit_result_reset(&result, &settings, &unit);
        uint32_t pixels = job_tile_pixels(&settings, tile);
        for (int half = 0; half < 2; half++) {
            for (size_t v = 0; v < (size_t)3 * pixels; v++)
                result.sums[SUM_EYE].values[(size_t)half * 3 * pixels + v] =
                    fixed(1.0) * unit_half_count(&unit, half);
            result.counts.light_paths[half] = (uint64_t)pixels * unit_half_count(&unit, half);
        }
        for (uint32_t p = 0; p < PIXELS; p++)
            for (int half = 0; half < 2; half++) {
                float share = 0.5f * (float)result.counts.light_paths[half] / PIXELS;
                add_splat(&result, p, half, share, share, share);
            }
        batch_add(&batch, &result);
    }
    merge(film, &batch);
    film_resolve(film, &image);
    rect_t empty = job_tile_rect(&settings, job_tile_count(&settings) - 1);
    for (int p = 0; p < PIXELS; p++) {
        bool black = p % WIDTH >= empty.x0 && p / WIDTH >= empty.y0;
        for (int v = 3 * p; v < 3 * p + 3; v++) {
            assert_true(fabsf(image.sum[v] - (black ? 0.0f : 1.5f)) < 1e-6f);
            assert_true(image.noise[v] < 1e-6f);
        }
    }
    film_image_free(&image);
    batch_free(&batch);
    unit_result_free(&result);
    film_destroy(&film);
}

/* `count` values of each pixel. */
static void assert_rows(const float *some, const float *whole, int y0, int y1, size_t count)
{
    size_t row = count * WIDTH;
    assert_memory_equal(some, whole + (size_t)y0 * row, (size_t)(y1 - y0) * row * sizeof *some);
}

static void some_rows_are_those_of_the_whole(void **state)
{
    (void)state;
    film_t *film = render_job(GROUPS, 2, 5, 7);
    film_image_t whole, some;
    film_resolve(film, &whole);
    film_resolve_extras(film, &(film_extras_t){.halves = true}, &whole);
    const int cuts[] = {0, 1, 8, HEIGHT};
    for (size_t i = 0; i + 1 < ARRAY_LENGTH(cuts); i++) {
        film_rows_t rows = {cuts[i], cuts[i + 1], true, true, true};
        film_resolve_rows(film, &rows, &some);
        assert_int_equal(some.height, rows.y1 - rows.y0);
        const float *const vectors[][2] = {{some.sum, whole.sum},         {some.eye, whole.eye},
                                           {some.light, whole.light},     {some.noise, whole.noise},
                                           {some.half[0], whole.half[0]}, {some.half[1], whole.half[1]},
                                           {some.albedo, whole.albedo},   {some.position, whole.position}};
        for (size_t v = 0; v < ARRAY_LENGTH(vectors); v++)
            assert_rows(vectors[v][0], vectors[v][1], rows.y0, rows.y1, 3);
        assert_rows(some.samples, whole.samples, rows.y0, rows.y1, 1);
        assert_rows(some.object, whole.object, rows.y0, rows.y1, 1);
        film_image_free(&some);
    }
    film_resolve_rows(film, &(film_rows_t){.y0 = 0, .y1 = 1}, &some);
    assert_null(some.albedo);
    assert_null(some.half[0]);
    film_image_free(&some);
    film_image_free(&whole);
    film_destroy(&film);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(any_cut_and_order_make_the_same_bits),
                                       cmocka_unit_test(groups_add_up_to_the_sums),
                                       cmocka_unit_test(sums_are_those_of_the_samples),
                                       cmocka_unit_test(feature_sums_are_those_of_the_samples),
                                       cmocka_unit_test(mattes_have_a_slot_for_each_sample),
                                       cmocka_unit_test(mattes_are_ranked_by_their_shares),
                                       cmocka_unit_test(features_end_after_the_first_samples),
                                       cmocka_unit_test(features_are_clamped_and_never_overflow),
                                       cmocka_unit_test(features_resolve_to_means),
                                       cmocka_unit_test(quantising_rounds_to_nearest_even),
                                       cmocka_unit_test(overflows_are_counted_and_left_out),
                                       cmocka_unit_test(merging_cannot_wrap),
                                       cmocka_unit_test(weighted_sums_cannot_wrap),
                                       cmocka_unit_test(a_batch_is_reusable),
                                       cmocka_unit_test(each_sum_has_its_own_divisor),
                                       cmocka_unit_test(sums_are_added_and_never_wrap),
                                       cmocka_unit_test(weights_are_repetitions),
                                       cmocka_unit_test(digests_are_of_the_contents),
                                       cmocka_unit_test(noise_is_the_standard_error),
                                       cmocka_unit_test(the_error_is_relative),
                                       cmocka_unit_test(the_error_of_some_rows_is_that_of_all),
                                       cmocka_unit_test(a_black_film_has_no_error),
                                       cmocka_unit_test(weights_show_as_mean_samples),
                                       cmocka_unit_test(some_rows_are_those_of_the_whole),
                                       cmocka_unit_test(partial_images_are_unbiased)};
    return cmocka_run_group_tests_name("film", tests, NULL, NULL);
}
