/* Tests of what goes to an image viewer: against a decoder in another language, over real sockets. */
#include "client/image/viewer.h"
#include "tests/scratch.h"
#include "tests/tev.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { WIDTH = 150, HEIGHT = 100, TILES = 6 }; /* tiles at the right and below are cut */
static const double PATIENCE = 30;             /* seconds */

/* Channels in the order of a file, with all kinds of floats. `seed` changes every value. */
static image_t make_image(int width, int height, unsigned seed)
{
    static const char *const names[] = {"B", "G", "R", "albedo.B", "albedo.G", "albedo.R", "depth.Z"};
    static const float odd[] = {-0.0f, INFINITY, NAN, 1e-42f, 65504.5f};
    image_t image;
    image_init(&image, width, height);
    for (size_t c = 0; c < ARRAY_LENGTH(names); c++) {
        float *plane = image_add_channel(&image, names[c], PIXEL_FLOAT);
        for (int i = 0; i < width * height; i++) plane[i] = (float)(i + (int)(1000 * c + 7 * seed)) / 3;
        for (size_t i = 0; i < ARRAY_LENGTH(odd); i++) plane[100 * i + c] = odd[i];
    }
    return image;
}

/* Steps until there is a connection other than `before`. Returns its number. */
static uint64_t connect_to(viewer_t *viewer, uint64_t before)
{
    for (double end = clock_now() + PATIENCE; clock_now() < end; viewer_step(viewer, 0.05)) {
        uint64_t connection = viewer_connection(viewer);
        if (connection != 0 && connection != before) return connection;
    }
    fail_msg("no connection");
    return 0;
}

static void send_all(viewer_t *viewer)
{
    for (double end = clock_now() + PATIENCE; !viewer_idle(viewer); viewer_step(viewer, 0.05))
        if (clock_now() > end) fail_msg("the image does not get away");
}

static void show(viewer_t *viewer, image_t image)
{
    viewer_show(viewer, &image);
    send_all(viewer);
}

static viewer_t *open_viewer(const char *address)
{
    viewer_t *viewer;
    result_t result = viewer_open(address, &viewer);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    viewer_name(viewer, "a picture");
    return viewer;
}

static void assert_shown(tev_t *tev, const hash_t *hash, unsigned updates, unsigned values)
{
    tev_shown_t shown;
    char expected[2 * HASH_BYTES + 1];
    hash_to_hex(hash, expected);
    assert_true(tev_wait_shown(tev, PATIENCE, &shown));
    assert_string_equal(shown.hash, expected);
    assert_int_equal(shown.updates, updates);
    assert_int_equal(shown.values, values);
}

static void a_viewer_gets_every_bit_and_then_what_changed(void **state)
{
    tev_t *tev = tev_start(*state, 0, false);
    viewer_t *viewer = open_viewer(tev->address);
    connect_to(viewer, 0);
    image_t image = make_image(WIDTH, HEIGHT, 0);
    hash_t hash = image_hash(&image);
    show(viewer, image);
    char *line = tev_wait(tev, "create ", PATIENCE);
    assert_string_equal(line, "150x100 R,G,B,albedo.B,albedo.G,albedo.R,depth.Z a picture");
    free(line);
    assert_shown(tev, &hash, TILES, 7 * WIDTH * HEIGHT);

    uint64_t before = viewer_sent(viewer);
    show(viewer, make_image(WIDTH, HEIGHT, 0));
    assert_int_equal(viewer_sent(viewer), before);

    image = make_image(WIDTH, HEIGHT, 0);
    image.channels[6].plane[70 * WIDTH + 149] += 1; /* depth.Z in the last tile: 22 x 36 */
    image.channels[3].plane[0] += 1;                /* albedo.B in the first */
    image.channels[4].plane[0] += 1;
    hash = image_hash(&image);
    show(viewer, image);
    assert_shown(tev, &hash, 2, 22 * 36 + 2 * VIEWER_TILE * VIEWER_TILE);
    viewer_close(&viewer);
    tev_kill(&tev);
}

static void another_layout_makes_another_image(void **state)
{
    tev_t *tev = tev_start(*state, 0, false);
    viewer_t *viewer = open_viewer(tev->address);
    connect_to(viewer, 0);
    show(viewer, make_image(WIDTH, HEIGHT, 0));
    image_t image = make_image(WIDTH + 50, HEIGHT, 0);
    hash_t hash = image_hash(&image);
    show(viewer, image);
    tev_expect_hash(tev, &hash);
    viewer_close(&viewer);
    tev_kill(&tev);
}

/* Tiles of the first image are on their way, or there already. */
static void a_newer_image_takes_the_place_of_one_on_its_way(void **state)
{
    enum { SIDE = 1024 };
    tev_t *tev = tev_start(*state, 0, false);
    viewer_t *viewer = open_viewer(tev->address);
    connect_to(viewer, 0);
    image_t first = make_image(SIDE, SIDE, 0), second = make_image(SIDE, SIDE, 1);
    hash_t hash = image_hash(&second);
    viewer_show(viewer, &first);
    viewer_step(viewer, 0.05);
    assert_false(viewer_idle(viewer));
    show(viewer, second);
    tev_expect_hash(tev, &hash);
    viewer_close(&viewer);
    tev_kill(&tev);
}

static void a_viewer_that_comes_again_gets_everything(void **state)
{
    char news[500];
    tev_t *tev = tev_start(*state, 0, false);
    viewer_t *viewer = open_viewer(tev->address);
    uint64_t first = connect_to(viewer, 0);
    image_t image = make_image(WIDTH, HEIGHT, 0);
    hash_t hash = image_hash(&image);
    show(viewer, image);
    assert_shown(tev, &hash, TILES, 7 * WIDTH * HEIGHT);
    int port = tev->port;
    tev_kill(&tev);
    for (double end = clock_now() + PATIENCE; !viewer_away(viewer) && clock_now() < end;)
        viewer_step(viewer, 0.05);
    assert_true(viewer_news(viewer, news));
    assert_non_null(strstr(news, "is gone"));
    assert_true(viewer_idle(viewer));
    tev = tev_start(*state, port, false);
    assert_true(connect_to(viewer, first) > first);
    show(viewer, make_image(WIDTH, HEIGHT, 0));
    assert_shown(tev, &hash, TILES, 7 * WIDTH * HEIGHT);
    assert_true(viewer_news(viewer, news));
    assert_non_null(strstr(news, "is there"));
    viewer_close(&viewer);
    tev_kill(&tev);
}

static void a_viewer_that_never_reads_costs_no_time(void **state)
{
    tev_t *tev = tev_start(*state, 0, true);
    viewer_t *viewer = open_viewer(tev->address);
    connect_to(viewer, 0);
    image_t image = make_image(1024, 1024, 0);
    viewer_show(viewer, &image);
    double longest = 0;
    for (double end = clock_now() + 1; clock_now() < end;) {
        double begin = clock_now();
        viewer_step(viewer, 0.02);
        longest = fmax(longest, clock_now() - begin);
    }
    assert_true(longest < 5);
    assert_false(viewer_idle(viewer));
    double begin = clock_now();
    viewer_close(&viewer);
    assert_true(clock_now() - begin < 5);
    tev_kill(&tev);
}

static void no_viewer_is_told_once_with_the_cure(void **state)
{
    char news[500] = "";
    unsigned told = 0;
    tev_t *tev = tev_start(*state, 0, true);
    viewer_t *viewer = open_viewer(tev->address);
    tev_kill(&tev);
    for (double end = clock_now() + 1; clock_now() < end; viewer_step(viewer, 0.05))
        if (viewer_news(viewer, news)) told++;
    assert_int_equal(told, 1);
    assert_true(viewer_away(viewer));
    assert_non_null(strstr(news, "Connection refused"));
    assert_non_null(strstr(news, "start tev"));
    image_t image = make_image(WIDTH, HEIGHT, 0);
    viewer_show(viewer, &image); /* lost, and nothing leaks */
    assert_true(viewer_idle(viewer));
    viewer_close(&viewer);
}

static void wrong_addresses_are_told_at_once(void **state)
{
    (void)state;
    viewer_t *viewer;
    assert_int_equal(viewer_open("host:port", &viewer).code, RESULT_USAGE);
    assert_int_equal(viewer_open("", &viewer).code, RESULT_USAGE);
    assert_int_equal(viewer_open("no-such-host.invalid", &viewer).code, RESULT_INPUT);
    viewer_t *well = open_viewer("localhost");
    assert_string_equal(viewer_label(well), "localhost:14158");
    viewer_close(&well);
    well = open_viewer("[::1]:99");
    assert_string_equal(viewer_label(well), "[::1]:99");
    viewer_close(&well);
}

static int begin(void **state)
{
    *state = scratch_new();
    return 0;
}

static int end(void **state)
{
    scratch_destroy((char **)state);
    return 0;
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, begin, end)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(a_viewer_gets_every_bit_and_then_what_changed),
                                       TEST(another_layout_makes_another_image),
                                       TEST(a_newer_image_takes_the_place_of_one_on_its_way),
                                       TEST(a_viewer_that_comes_again_gets_everything),
                                       TEST(a_viewer_that_never_reads_costs_no_time),
                                       TEST(no_viewer_is_told_once_with_the_cure),
                                       TEST(wrong_addresses_are_told_at_once)};
    return cmocka_run_group_tests_name("viewer", tests, NULL, NULL);
}
