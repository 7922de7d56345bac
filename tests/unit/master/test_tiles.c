/* Tests of tile_pyramid.c and tiles.c: what the page sees of an image is the image. Answers are decoded here
 * by the words of tile_pyramid.h, with halves of its own. */
#include "common/film/picture.h"
#include "master/http/watch/tiles.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

/* ---- a decoder ----------------------------------------------------------------------------------------- */

typedef struct {
    uint32_t version, width, height, level, side, count;
    bool got[16][16];          /* tiles by row and column */
    float texels[512][512][4]; /* of the level */
} seen_t;

static uint32_t word(const uint8_t *bytes, int count)
{
    uint32_t value = 0;
    for (int i = 0; i < count; i++) value |= (uint32_t)bytes[i] << (8 * i);
    return value;
}

static float half_value(uint32_t half)
{
    int exponent = (int)(half >> 10 & 31), fraction = (int)(half & 1023);
    assert_int_not_equal(exponent, 31); /* neither infinite nor NaN */
    double value = exponent == 0 ? ldexp(fraction, -24) : ldexp(1024 + fraction, exponent - 25);
    return (float)(half >> 15 ? -value : value);
}

static const uint8_t *read_tile(const uint8_t *at, seen_t *seen)
{
    uint32_t tx = word(at, 2), ty = word(at + 2, 2), w = word(at + 4, 2), h = word(at + 6, 2);
    assert_true(tx < 8 && ty < 8 && w <= 64 && h <= 64 && w > 0 && h > 0 && !seen->got[ty][tx]);
    seen->got[ty][tx] = true;
    at += 8;
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++)
            for (int c = 0; c < 4; c++, at += 2)
                seen->texels[64 * ty + y][64 * tx + x][c] = half_value(word(at, 2));
    return at;
}

static seen_t *decode(uint8_t *bytes, size_t size)
{
    seen_t *seen = mem_zalloc(1, sizeof *seen);
    assert_true(size >= 28);
    assert_memory_equal(bytes, "LMT1", 4);
    uint32_t *head[] = {&seen->version, &seen->width, &seen->height, &seen->level, &seen->side, &seen->count};
    for (size_t i = 0; i < ARRAY_LENGTH(head); i++) *head[i] = word(bytes + 4 + 4 * i, 4);
    const uint8_t *at = bytes + 28;
    for (uint32_t i = 0; i < seen->count; i++) at = read_tile(at, seen);
    assert_ptr_equal(at, bytes + size);
    free(bytes);
    return seen;
}

/* ---- pyramids of an image made up here ------------------------------------------------------------------
 */

enum { WIDTH = 201, HEIGHT = 130 };

static float value_at(int x, int y, int c)
{
    return 0.01f * (float)(x + 3 * y) + (float)c;
}

static void fill(float *rgb, float *noise)
{
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            for (int c = 0; c < 3; c++) {
                rgb[3 * (y * WIDTH + x) + c] = value_at(x, y, c);
                noise[3 * (y * WIDTH + x) + c] = 0.5f;
            }
}

typedef struct {
    float rgb[3 * WIDTH * HEIGHT], noise[3 * WIDTH * HEIGHT];
    film_image_t film;
    layer_view_t view;
} made_t;

static made_t *make(void)
{
    made_t *made = mem_zalloc(1, sizeof *made);
    fill(made->rgb, made->noise);
    made->film = (film_image_t){.width = WIDTH, .height = HEIGHT, .sum = made->rgb, .noise = made->noise};
    assert_true(layer_of_film(&made->film, LAYER_PICTURE, &made->view));
    return made;
}

/* Puts the image into a pyramid in two parts, so that the rows of a texel of the next level come apart. */
static void put(pyramid_t *pyramid, const made_t *made, uint32_t version)
{
    layer_view_t view = made->view;
    view.height = 71;
    pyramid_put(pyramid, &view, 0, version);
    view.height = HEIGHT - 71;
    for (int c = 0; c < 3; c++) {
        view.values[c] += 71 * WIDTH * view.stride;
        view.errors[c] += 71 * WIDTH * view.error_stride;
    }
    pyramid_put(pyramid, &view, 71, version);
}

static pyramid_t *pyramid_of(const made_t *made, uint32_t version)
{
    pyramid_t *pyramid = pyramid_new(WIDTH, HEIGHT, version);
    assert_non_null(pyramid);
    put(pyramid, made, version);
    return pyramid;
}

static seen_t *ask(const pyramid_t *pyramid, uint32_t version, tile_query_t query)
{
    uint8_t *bytes;
    size_t size;
    assert_int_equal(pyramid_answer(pyramid, WIDTH, HEIGHT, version, &query, &bytes, &size).code, RESULT_OK);
    return decode(bytes, size);
}

static const rect_t everything = {0, 0, 1 << 20, 1 << 20};

static void assert_near(double value, double expected)
{
    if (fabs(value - expected) > 0.001 * fabs(expected) + 1e-6) fail_msg("%g instead of %g", value, expected);
}

static void test_level_0_is_the_image_and_its_error(void **state)
{
    (void)state;
    made_t *made = make();
    pyramid_t *pyramid = pyramid_of(made, 7);
    seen_t *seen = ask(pyramid, 7, (tile_query_t){.rect = everything});
    assert_int_equal(seen->version, 7);
    assert_int_equal(seen->width, WIDTH);
    assert_int_equal(seen->height, HEIGHT);
    assert_int_equal(seen->side, 64);
    assert_int_equal(seen->count, 4 * 3);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            for (int c = 0; c < 3; c++) assert_near(seen->texels[y][x][c], value_at(x, y, c));
            assert_near(seen->texels[y][x][3], 0.5);
        }
    free(seen);
    pyramid_destroy(&pyramid);
    free(made);
}

/* The mean of the pixels under a texel, and how many these are. */
static double mean_under(int x, int y, int side, int c, int *count)
{
    double sum = 0;
    *count = 0;
    for (int v = y * side; v < (y + 1) * side && v < HEIGHT; v++)
        for (int u = x * side; u < (x + 1) * side && u < WIDTH; u++, ++*count) sum += value_at(u, v, c);
    return sum / *count;
}

static void test_a_level_holds_means_and_their_errors(void **state)
{
    (void)state;
    made_t *made = make();
    pyramid_t *pyramid = pyramid_of(made, 7);
    seen_t *seen = ask(pyramid, 7, (tile_query_t){.level = 1, .rect = everything});
    assert_int_equal(seen->count, 2 * 2);
    for (int y = 0; y < (HEIGHT + 1) / 2; y++)
        for (int x = 0; x < (WIDTH + 1) / 2; x++) {
            int count;
            assert_near(seen->texels[y][x][1], mean_under(x, y, 2, 1, &count));
            assert_near(seen->texels[y][x][3], 0.5 / sqrt(count));
        }
    free(seen);
    seen = ask(pyramid, 7, (tile_query_t){.level = 2, .rect = everything});
    int count;
    assert_int_equal(seen->count, 1);
    assert_near(seen->texels[10][20][0], mean_under(20, 10, 4, 0, &count));
    assert_near(seen->texels[10][20][3], 0.5 / 4);
    free(seen);
    pyramid_destroy(&pyramid);
    free(made);
}

static void test_only_tiles_that_changed_are_sent(void **state)
{
    (void)state;
    made_t *made = make();
    pyramid_t *pyramid = pyramid_of(made, 7);
    made->rgb[3 * (70 * WIDTH + 150)] += 1; /* in the tile of column 2, row 1 */
    put(pyramid, made, 9);
    seen_t *seen = ask(pyramid, 9, (tile_query_t){.since = 7, .rect = everything});
    assert_int_equal(seen->count, 1);
    assert_true(seen->got[1][2]);
    free(seen);
    seen = ask(pyramid, 9, (tile_query_t){.level = 1, .since = 8, .rect = everything});
    assert_int_equal(seen->count, 1);
    assert_true(seen->got[0][1]);
    free(seen);
    seen = ask(pyramid, 9, (tile_query_t){.since = 9, .rect = everything});
    assert_int_equal(seen->count, 0);
    free(seen);
    seen = ask(pyramid, 9, (tile_query_t){.since = 12, .rect = everything}); /* of a master that was ahead */
    assert_int_equal(seen->count, 12);
    free(seen);
    pyramid_destroy(&pyramid);
    free(made);
}

static void test_only_tiles_of_the_rectangle_are_sent(void **state)
{
    (void)state;
    made_t *made = make();
    pyramid_t *pyramid = pyramid_of(made, 7);
    seen_t *seen = ask(pyramid, 7, (tile_query_t){.rect = {64, 63, 129, 65}});
    assert_int_equal(seen->count, 4);
    assert_true(seen->got[0][1] && seen->got[0][2] && seen->got[1][1] && seen->got[1][2]);
    free(seen);
    const rect_t none[] = {{500, 500, 900, 900}, {0, 0, 0, 0}, {-9, -9, -1, -1}, {70, 70, 10, 10}};
    for (size_t i = 0; i < ARRAY_LENGTH(none); i++) {
        seen = ask(pyramid, 7, (tile_query_t){.rect = none[i]});
        assert_int_equal(seen->count, 0);
        free(seen);
    }
    pyramid_destroy(&pyramid);
    free(made);
}

/* A made-up image of one layer. */
static seen_t *show(const film_image_t *film, layer_t layer, uint32_t level)
{
    layer_view_t view;
    assert_true(layer_of_film(film, layer, &view));
    pyramid_t *pyramid = pyramid_new(WIDTH, HEIGHT, 1);
    pyramid_put(pyramid, &view, 0, 1);
    seen_t *seen = ask(pyramid, 1, (tile_query_t){.level = level, .rect = everything});
    pyramid_destroy(&pyramid);
    return seen;
}

static uint32_t id_of(const float texel[4])
{
    return (uint32_t)texel[0] + 2048 * (uint32_t)texel[1] + 2048 * 2048 * (uint32_t)texel[2];
}

static float id_at(int x, int y)
{
    return x == 8 && y == 4 ? 0 : (float)(16777215 - 3000 * x - y);
}

static void test_ids_stay_ids_at_every_level(void **state)
{
    (void)state;
    float *ids = mem_alloc(sizeof *ids * WIDTH * HEIGHT);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) ids[y * WIDTH + x] = id_at(x, y);
    film_image_t film = {.width = WIDTH, .height = HEIGHT, .object = ids, .material = ids};
    for (uint32_t level = 0; level < 3; level++) {
        seen_t *seen = show(&film, level == 1 ? LAYER_MATERIAL : LAYER_OBJECT, level);
        for (int y = 0; y < level_side(HEIGHT, level); y++)
            for (int x = 0; x < level_side(WIDTH, level); x++)
                assert_int_equal(id_of(seen->texels[y][x]), (uint32_t)id_at(x << level, y << level));
        assert_true(seen->texels[1][1][3] == 0);
        free(seen);
    }
    free(ids);
}

static void test_strategies_are_shares_of_the_light(void **state)
{
    (void)state;
    float *eye = mem_zalloc(3 * WIDTH * HEIGHT, sizeof *eye),
          *light = mem_zalloc(3 * WIDTH * HEIGHT, sizeof *light);
    for (int c = 0; c < 3; c++) {
        eye[3 + c] = 3; /* pixel 1: three quarters by eye paths */
        light[3 + c] = 1;
        light[6 + c] = 5; /* pixel 2: light paths alone; pixel 0: none */
    }
    film_image_t film = {.width = WIDTH, .height = HEIGHT, .eye = eye, .light = light};
    seen_t *seen = show(&film, LAYER_STRATEGIES, 0);
    const float expected[3][4] = {{0, 0, 0, 0}, {0.75f, 0, 0.25f, 0}, {0, 0, 1, 0}};
    for (int x = 0; x < 3; x++)
        for (int c = 0; c < 4; c++) assert_near(seen->texels[0][x][c], expected[x][c]);
    free(seen);
    free(eye);
    free(light);
}

static void test_what_is_no_half_is_clamped(void **state)
{
    (void)state;
    made_t *made = make();
    made->rgb[0] = 1e9f;
    made->rgb[1] = -INFINITY;
    made->rgb[2] = NAN;
    pyramid_t *pyramid = pyramid_of(made, 7);
    seen_t *seen = ask(pyramid, 7, (tile_query_t){.rect = {0, 0, 1, 1}});
    assert_true(seen->texels[0][0][0] == 65504 && seen->texels[0][0][1] == -65504);
    assert_true(seen->texels[0][0][2] == 0);
    free(seen);
    pyramid_destroy(&pyramid);
    free(made);
}

static void test_questions_beyond_the_limits_are_refused(void **state)
{
    (void)state;
    uint8_t *bytes;
    size_t size;
    tile_query_t query = {.level = 3, .rect = everything};
    assert_int_equal(pyramid_answer(NULL, WIDTH, HEIGHT, 0, &query, &bytes, &size).code, RESULT_USAGE);
    query.level = UINT32_MAX;
    assert_int_equal(pyramid_answer(NULL, WIDTH, HEIGHT, 0, &query, &bytes, &size).code, RESULT_USAGE);
    query.level = 0; /* 64 x 17 tiles */
    assert_int_equal(pyramid_answer(NULL, 64 * 64, 17 * 64, 0, &query, &bytes, &size).code, RESULT_USAGE);
    query.rect.y1 = 16 * 64;
    assert_int_equal(pyramid_answer(NULL, 64 * 64, 17 * 64, 0, &query, &bytes, &size).code, RESULT_OK);
    free(bytes);
}

/* ---- watching a job -------------------------------------------------------------------------------------
 */

static char *scratch_image(const char *folder, uint64_t job)
{
    return mem_printf("%s/%llu.exr", folder, (unsigned long long)job);
}

typedef struct {
    char *folder;
    farm_t *farm;
    tiles_t *tiles;
    uint64_t job, worker;
} trial_t;

static int begin(void **state)
{
    trial_t *trial = mem_zalloc(1, sizeof *trial);
    trial->folder = scratch_new();
    trial->farm = toy_farm(false);
    tiles_options_t options = {.farm = trial->farm, .image_path = scratch_image, .data_dir = trial->folder};
    assert_int_equal(tiles_start(&options, &trial->tiles).code, RESULT_OK);
    job_settings_t settings = toy_settings();
    trial->job = toy_submit(trial->farm, 0, &settings, 0);
    trial->worker = toy_hello(trial->farm, 0, 1);
    *state = trial;
    return 0;
}

static int end(void **state)
{
    trial_t *trial = *state;
    tiles_stop(&trial->tiles);
    assert_null(trial->tiles);
    farm_destroy(&trial->farm);
    scratch_destroy(&trial->folder);
    free(trial);
    return 0;
}

static seen_t *look(trial_t *trial, layer_t layer, uint32_t since)
{
    uint8_t *bytes;
    size_t size;
    tile_query_t query = {.since = since, .rect = everything};
    result_t result = tiles_get(trial->tiles, trial->job, layer, &query, &bytes, &size);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    uint8_t *copy = mem_alloc(size);
    memcpy(copy, bytes, size);
    tiles_release(trial->tiles, bytes, size);
    return decode(copy, size);
}

/* Looks until there is something newer than `since`. */
static seen_t *look_until_newer(trial_t *trial, layer_t layer, uint32_t since)
{
    for (int i = 0; i < 1000; i++) {
        seen_t *seen = look(trial, layer, since);
        if (seen->version > since) return seen;
        free(seen);
        usleep(10000);
    }
    fail_msg("nothing came for ten seconds");
    return NULL;
}

static void resolve(trial_t *trial, film_image_t *image)
{
    const film_extras_t extras = {.halves = true, .groups = true};
    job_t *job = farm_pin(trial->farm, trial->job);
    job_report_t report;
    assert_int_equal(farm_resolve(trial->farm, 0, job, &extras, image, &report).code, RESULT_OK);
    farm_unpin(trial->farm, job);
}

/* Compares what was seen with an image of `values` floats a pixel, times `scale`. */
static void assert_shows(const seen_t *seen, const float *pixels, int values, double scale)
{
    assert_int_equal(seen->width, 32);
    for (int y = 0; y < 32; y++)
        for (int x = 0; x < 32; x++)
            for (int c = 0; c < values; c++)
                assert_near(seen->texels[y][x][c], scale * (double)pixels[values * (32 * y + x) + c]);
}

static void deliver_one(trial_t *trial, double now)
{
    toy_work_t work = toy_take(trial->farm, now, trial->worker, 256, 256);
    assert_true(work.count > 0);
    assert_int_equal(toy_deliver(trial->farm, now, trial->worker, trial->job, work.units, work.count).code,
                     RESULT_OK);
}

static void test_a_watched_job_shows_its_film(void **state)
{
    trial_t *trial = *state;
    seen_t *seen = look(trial, LAYER_PICTURE, 0);
    assert_int_equal(seen->version, 0); /* nothing is there yet */
    assert_int_equal(seen->width, 32);
    assert_int_equal(seen->count, 0);
    free(seen);
    const struct {
        layer_t layer;
        size_t plane;
        int values;
        double scale;
    } layers[] = {{LAYER_PICTURE, offsetof(film_image_t, sum), 3, 1},
                  {LAYER_EYE, offsetof(film_image_t, eye), 3, 1},
                  {LAYER_LIGHT, offsetof(film_image_t, light), 3, 1},
                  {LAYER_NOISE, offsetof(film_image_t, noise), 3, 1},
                  {LAYER_SAMPLES, offsetof(film_image_t, samples), 1, 1.0 / 1024},
                  {LAYER_HALF0, offsetof(film_image_t, half[0]), 3, 1},
                  {LAYER_HALF1, offsetof(film_image_t, half[1]), 3, 1}};
    for (size_t i = 0; i < ARRAY_LENGTH(layers); i++) free(look(trial, layers[i].layer, 0));
    deliver_one(trial, 1);
    film_image_t image = {0};
    resolve(trial, &image);
    for (size_t i = 0; i < ARRAY_LENGTH(layers); i++) {
        seen = look_until_newer(trial, layers[i].layer, 0);
        assert_int_equal(seen->version, 1);
        float *plane;
        memcpy(&plane, (char *)&image + layers[i].plane, sizeof plane);
        assert_shows(seen, plane, layers[i].values, layers[i].scale);
        free(seen);
    }
    film_image_free(&image);
}

static void test_a_watched_job_is_seen_to_go_on(void **state)
{
    trial_t *trial = *state;
    deliver_one(trial, 1);
    free(look_until_newer(trial, LAYER_PICTURE, 0));
    deliver_one(trial, 2);
    seen_t *seen = look_until_newer(trial, LAYER_PICTURE, 1);
    film_image_t image = {0};
    resolve(trial, &image);
    assert_int_equal(seen->version, 2);
    assert_int_equal(seen->count, 1);
    assert_shows(seen, image.sum, 3, 1);
    film_image_free(&image);
    free(seen);
    seen = look(trial, LAYER_PICTURE, 2);
    assert_int_equal(seen->count, 0);
    free(seen);
}

static void test_a_job_that_is_over_shows_its_file(void **state)
{
    trial_t *trial = *state;
    toy_work_off(trial->farm, 1, trial->worker, trial->job);
    film_image_t image = {0};
    resolve(trial, &image);
    char *path = scratch_image(trial->folder, trial->job);
    picture_meta_t meta = {.settings = toy_settings()};
    assert_int_equal(picture_write_exr(path, &image, &meta, false).code, RESULT_OK);
    free(path);
    assert_int_equal(toy_write_images(trial->farm, 2, result_ok()), 1);
    assert_int_equal(toy_state(trial->farm, 2, trial->job), JOB_DONE);
    seen_t *seen = look_until_newer(trial, LAYER_LIGHT, 0);
    assert_shows(seen, image.light, 3, 1);
    free(seen);
    seen = look_until_newer(trial, LAYER_SAMPLES, 0);
    assert_shows(seen, image.samples, 1, 1.0 / 1024);
    free(seen);
    film_image_free(&image);
}

/* The layer of a group is its eye and its light image together. */
static void assert_shows_groups(trial_t *trial, const film_image_t *image)
{
    float *sum = mem_alloc(3 * 32 * 32 * sizeof *sum);
    for (int g = 0; g < 2; g++) {
        for (size_t i = 0; i < 3 * 32 * 32; i++) sum[i] = image->group_eye[g][i] + image->group_light[g][i];
        seen_t *seen = look_until_newer(trial, LAYER_GROUP0 + (layer_t)g, 0);
        assert_shows(seen, sum, 3, 1);
        free(seen);
    }
    free(sum);
}

static void test_light_groups_are_layers(void **state)
{
    trial_t *trial = *state;
    job_settings_t settings = toy_settings();
    toy_work_off(trial->farm, 1, trial->worker, trial->job); /* it is in the way */
    assert_int_equal(toy_write_images(trial->farm, 1, result_ok()), 1);
    strcpy(settings.light_groups, "key=0,rest");
    trial->job = toy_submit(trial->farm, 1, &settings, 0);
    deliver_one(trial, 1);
    film_image_t image = {0};
    resolve(trial, &image);
    assert_shows_groups(trial, &image);
    film_image_free(&image);
    toy_work_off(trial->farm, 2, trial->worker, trial->job);
    resolve(trial, &image);
    char *path = scratch_image(trial->folder, trial->job);
    picture_meta_t meta = {.settings = settings};
    assert_int_equal(picture_write_exr(path, &image, &meta, false).code, RESULT_OK);
    free(path);
    assert_int_equal(toy_write_images(trial->farm, 3, result_ok()), 1);
    tiles_stop(&trial->tiles); /* it knows nothing of the film any more */
    tiles_options_t options = {.farm = trial->farm, .image_path = scratch_image, .data_dir = trial->folder};
    assert_int_equal(tiles_start(&options, &trial->tiles).code, RESULT_OK);
    assert_shows_groups(trial, &image);
    film_image_free(&image);
    uint8_t *bytes;
    size_t size;
    tile_query_t query = {.rect = everything};
    assert_int_equal(tiles_get(trial->tiles, trial->job, LAYER_GROUP0 + 2, &query, &bytes, &size).code,
                     RESULT_INPUT);
}

static void test_what_is_not_there_is_refused(void **state)
{
    trial_t *trial = *state;
    uint8_t *bytes;
    size_t size;
    tile_query_t query = {.rect = everything};
    result_t result = tiles_get(trial->tiles, 4711, LAYER_PICTURE, &query, &bytes, &size);
    assert_int_equal(result.code, RESULT_UNREACHABLE);
    assert_non_null(strstr(result.message, "4711"));
    result = tiles_get(trial->tiles, trial->job, LAYER_ALBEDO, &query, &bytes, &size);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "albedo"));
}

static void test_so_many_jobs_are_watched_and_no_more(void **state)
{
    trial_t *trial = *state;
    job_settings_t settings = toy_settings();
    for (int i = 0; i <= TILES_MAX_JOBS; i++) {
        trial->job = i == 0 ? trial->job : toy_submit(trial->farm, 0, &settings, 0);
        uint8_t *bytes;
        size_t size;
        tile_query_t query = {.rect = everything};
        result_t result = tiles_get(trial->tiles, trial->job, LAYER_PICTURE, &query, &bytes, &size);
        assert_int_equal(result.code, i < TILES_MAX_JOBS ? RESULT_OK : RESULT_LIMIT);
        if (result.code == RESULT_OK) tiles_release(trial->tiles, bytes, size);
    }
}

/* ---- room ---------------------------------------------------------------------------------------------- */

enum { SMALL_ANSWERS = 40000 };

/* As `begin`, with room for two layers of a job, and for few answers. */
static int begin_small(void **state)
{
    begin(state);
    trial_t *trial = *state;
    tiles_stop(&trial->tiles);
    tiles_options_t options = {.farm = trial->farm,
                               .image_path = scratch_image,
                               .data_dir = trial->folder,
                               .max_bytes = 2 * pyramid_bytes(32, 32) + 1,
                               .max_answers = SMALL_ANSWERS};
    assert_int_equal(tiles_start(&options, &trial->tiles).code, RESULT_OK);
    return 0;
}

/* The version that is seen of a layer, -1 for none because there is no room. */
static int version_of(trial_t *trial, layer_t layer)
{
    uint8_t *bytes;
    size_t size;
    tile_query_t query = {.rect = everything};
    result_t result = tiles_get(trial->tiles, trial->job, layer, &query, &bytes, &size);
    if (result.code == RESULT_LIMIT) assert_non_null(strstr(result.message, "no memory to show"));
    if (result.code != RESULT_OK) return -1;
    int version = (int)word(bytes + 4, 4);
    tiles_release(trial->tiles, bytes, size);
    return version;
}

/* Three are looked at, and there is room for two: these two stay, and are refreshed. When nobody looks at one
 * of them any more, the third takes its place. */
static void test_layers_do_not_push_one_another_out(void **state)
{
    trial_t *trial = *state;
    deliver_one(trial, 1);
    free(look_until_newer(trial, LAYER_PICTURE, 0));
    free(look_until_newer(trial, LAYER_EYE, 0));
    deliver_one(trial, 2);
    bool refused = false;
    for (int i = 0; i < 150; i++, usleep(20000)) {
        assert_true(version_of(trial, LAYER_PICTURE) >= 1);
        assert_true(version_of(trial, LAYER_EYE) >= 1);
        refused |= version_of(trial, LAYER_LIGHT) == -1;
        assert_true(version_of(trial, LAYER_LIGHT) < 1);
    }
    assert_true(refused);
    assert_int_equal(version_of(trial, LAYER_PICTURE), 2);
    assert_int_equal(version_of(trial, LAYER_EYE), 2);
    int version = -1;
    for (int i = 0; i < 1000 && version < 1; i++, usleep(20000)) {
        assert_int_equal(version_of(trial, LAYER_PICTURE), 2);
        version = version_of(trial, LAYER_LIGHT);
    }
    assert_int_equal(version, 2);
}

/* A layer that is to be refreshed goes to make room for another one of the same snapshot. */
static void test_a_layer_makes_room_while_it_is_due(void **state)
{
    trial_t *trial = *state;
    deliver_one(trial, 1);
    free(look_until_newer(trial, LAYER_PICTURE, 0));
    free(look_until_newer(trial, LAYER_EYE, 0));
    usleep(5500000); /* longer than TILES_HOLD: both may go, and are still looked at */
    deliver_one(trial, 2);
    int version = 0;
    for (int i = 0; i < 1000 && version < 2; i++, usleep(10000)) version = version_of(trial, LAYER_LIGHT);
    assert_int_equal(version, 2);
}

static void test_answers_that_nobody_takes_are_limited(void **state)
{
    trial_t *trial = *state;
    deliver_one(trial, 1);
    free(look_until_newer(trial, LAYER_PICTURE, 0));
    uint8_t *answers[100];
    size_t size = 0, count = 0;
    tile_query_t query = {.rect = everything};
    result_t result = result_ok();
    while (count < 100) {
        result = tiles_get(trial->tiles, trial->job, LAYER_PICTURE, &query, &answers[count], &size);
        if (result.code != RESULT_OK) break;
        count++;
    }
    assert_int_equal(result.code, RESULT_LIMIT);
    assert_non_null(strstr(result.message, "slow readers"));
    assert_true(count * size >= SMALL_ANSWERS && (count - 1) * size < SMALL_ANSWERS);
    tiles_release(trial->tiles, answers[--count], size);
    assert_int_equal(version_of(trial, LAYER_PICTURE), 1);
    while (count > 0) tiles_release(trial->tiles, answers[--count], size);
}

/* ---- what cannot be read ------------------------------------------------------------------------------- */

static void test_a_file_that_cannot_be_read_is_said_once(void **state)
{
    trial_t *trial = *state;
    toy_work_off(trial->farm, 1, trial->worker, trial->job);
    film_image_t image = {0};
    resolve(trial, &image);
    char *path = scratch_image(trial->folder, trial->job);
    scratch_write(path, "no image", 8);
    assert_int_equal(toy_write_images(trial->farm, 2, result_ok()), 1);
    log_init("test", LOG_WARNING);
    scratch_capture_t capture = scratch_capture(trial->folder, 2);
    uint8_t *bytes;
    size_t size;
    tile_query_t query = {.rect = everything};
    result_t result = result_ok();
    for (int i = 0; i < 200; i++, usleep(20000)) {
        result = tiles_get(trial->tiles, trial->job, LAYER_PICTURE, &query, &bytes, &size);
        if (result.code == RESULT_OK) tiles_release(trial->tiles, bytes, size);
    }
    char *said = scratch_uncapture(&capture);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "cannot be read"));
    const char *once = strstr(said, "cannot be shown");
    assert_non_null(once);
    assert_null(strstr(once + 1, "cannot be shown"));
    /* It is tried again, and shown when it can be. */
    picture_meta_t meta = {.settings = toy_settings()};
    assert_int_equal(picture_write_exr(path, &image, &meta, false).code, RESULT_OK);
    while (tiles_get(trial->tiles, trial->job, LAYER_PICTURE, &query, &bytes, &size).code != RESULT_OK)
        usleep(20000);
    tiles_release(trial->tiles, bytes, size);
    film_image_free(&image);
    free(said);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_level_0_is_the_image_and_its_error),
        cmocka_unit_test(test_a_level_holds_means_and_their_errors),
        cmocka_unit_test(test_only_tiles_that_changed_are_sent),
        cmocka_unit_test(test_only_tiles_of_the_rectangle_are_sent),
        cmocka_unit_test(test_ids_stay_ids_at_every_level),
        cmocka_unit_test(test_strategies_are_shares_of_the_light),
        cmocka_unit_test(test_what_is_no_half_is_clamped),
        cmocka_unit_test(test_questions_beyond_the_limits_are_refused),
        cmocka_unit_test_setup_teardown(test_a_watched_job_shows_its_film, begin, end),
        cmocka_unit_test_setup_teardown(test_a_watched_job_is_seen_to_go_on, begin, end),
        cmocka_unit_test_setup_teardown(test_a_job_that_is_over_shows_its_file, begin, end),
        cmocka_unit_test_setup_teardown(test_light_groups_are_layers, begin, end),
        cmocka_unit_test_setup_teardown(test_layers_do_not_push_one_another_out, begin_small, end),
        cmocka_unit_test_setup_teardown(test_a_layer_makes_room_while_it_is_due, begin_small, end),
        cmocka_unit_test_setup_teardown(test_answers_that_nobody_takes_are_limited, begin_small, end),
        cmocka_unit_test_setup_teardown(test_a_file_that_cannot_be_read_is_said_once, begin, end),
        cmocka_unit_test_setup_teardown(test_what_is_not_there_is_refused, begin, end),
        cmocka_unit_test_setup_teardown(test_so_many_jobs_are_watched_and_no_more, begin, end),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
