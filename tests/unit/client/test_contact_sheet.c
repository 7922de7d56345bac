/* Tests of client/image/contact_sheet.c and the list of strategies: every strategy has its cell, scaled by
 * means, in either arrangement, and the sheet keeps within its bounds. */
#include "client/farm/strategies.h"
#include "client/image/contact_sheet.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void strategies_are_listed_once(void **state)
{
    (void)state;
    strategy_t list[STRATEGIES_MAX];
    const size_t counts[] = {0, 1, 4, 8, 13, 19};
    for (int k = 0; k < (int)ARRAY_LENGTH(counts); k++) assert_int_equal(strategies_list(k, list), counts[k]);
    assert_int_equal(strategies_list(STRATEGIES_MAX_SEGMENTS, list), STRATEGIES_MAX);
    assert_int_equal(strategies_list(1000, list), STRATEGIES_MAX);
    for (size_t i = 0; i < STRATEGIES_MAX; i++) {
        job_settings_t settings = job_settings_default();
        settings.max_depth = STRATEGIES_MAX_SEGMENTS - 1;
        settings.strategy_s = list[i].s;
        settings.strategy_t = list[i].t;
        assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
        for (size_t j = 0; j < i; j++) assert_false(list[i].s == list[j].s && list[i].t == list[j].t);
    }
}

/* An image of so many segments. The top left quarter of a strategy's pixels is in stripes of 0 and 2 times
 * `value_of` it, the rest is black. */
static float value_of(strategy_t strategy, bool weighted)
{
    return 1 + (float)(strategy.s * 20 + strategy.t) + (weighted ? 0.5f : 0);
}

static bool is_bright(size_t pixel, size_t width, size_t height)
{
    size_t x = pixel % width, y = pixel / width;
    return x < width / 2 && y < height / 2 && x % 2 == 1;
}

static image_t make_image(int width, int height, int segments)
{
    image_t image;
    strategy_t list[STRATEGIES_MAX];
    size_t count = strategies_list(segments, list);
    image_init(&image, width, height);
    for (size_t i = 0; i < 6 * count; i++) {
        char *layer = strategy_layer(list[i / 6], i % 2);
        char *name = mem_printf("%s.%c", layer, "RGB"[i % 6 / 2]);
        float *plane = image_add_channel(&image, name, PIXEL_FLOAT);
        assert_non_null(plane);
        for (size_t p = 0; p < (size_t)width * (size_t)height; p++)
            plane[p] = is_bright(p, (size_t)width, (size_t)height) ? 2 * value_of(list[i / 6], i % 2) : 0;
        free(layer);
        free(name);
    }
    return image;
}

/* How many of the sheet's pixels have this value in all channels. */
static size_t count_value(const image_t *sheet, float value)
{
    size_t count = 0, pixels = (size_t)sheet->width * (size_t)sheet->height;
    const image_channel_t *rgb[3];
    assert_true(image_find_rgb(sheet, NULL, rgb));
    for (size_t p = 0; p < pixels; p++)
        count += rgb[0]->data[p] == value && rgb[1]->data[p] == value && rgb[2]->data[p] == value;
    return count;
}

/* Cells of an image scaled down by `factor` (even, so that stripes become their mean). */
static void check_sheet(int width, int height, int segments, int factor, bool stacked)
{
    image_t image = make_image(width, height, segments), sheet;
    strategy_t list[STRATEGIES_MAX];
    size_t count = strategies_list(segments, list);
    assert_int_equal(contact_sheet_make(&image, segments, -1, &sheet).code, RESULT_OK);
    assert_true(sheet.width <= CONTACT_SHEET_SIDE && sheet.height <= CONTACT_SHEET_SIDE);
    int across = (stacked ? 1 : 2) * (segments + 1) * (width / factor);
    int down = (stacked ? 2 : 1) * segments * (height / factor);
    assert_true(sheet.width >= across && sheet.height >= down);
    for (size_t i = 0; i < 2 * count; i++) {
        size_t cell = (size_t)(width / factor / 2) * (size_t)(height / factor / 2);
        assert_int_equal(count_value(&sheet, 0.5f * value_of(list[i / 2], i % 2)), cell);
    }
    /* Two titles and the labels: at least 10 dots a letter. */
    assert_true(count_value(&sheet, 0.6f) > 4 * 10 * 18 + 2 * count * 7 * 10);
    image_free(&sheet);
    image_free(&image);
}

static void cells_are_means_and_all_there(void **state)
{
    (void)state;
    check_sheet(512, 512, 4, 2, false); /* 2 x 5 x 512 pixels do not fit beside each other in 4096 */
    check_sheet(1200, 300, 3, 2, true); /* wide: one below the other wins */
    check_sheet(640, 640, 5, 2, false);
    check_sheet(1600, 64, 8, 4, true);
}

static void small_and_odd_images_are_laid_out(void **state)
{
    (void)state;
    const int sizes[][3] = {{1, 1, 1},    {1, 1, STRATEGIES_MAX_SEGMENTS},   {7, 3, 2}, {4097, 3, 1},
                            {3, 4999, 2}, {333, 77, STRATEGIES_MAX_SEGMENTS}};
    for (size_t i = 0; i < ARRAY_LENGTH(sizes); i++) {
        image_t image = make_image(sizes[i][0], sizes[i][1], sizes[i][2]), sheet;
        assert_int_equal(contact_sheet_make(&image, sizes[i][2], 0, &sheet).code, RESULT_OK);
        assert_true(sheet.width <= CONTACT_SHEET_SIDE && sheet.height <= CONTACT_SHEET_SIDE);
        image_free(&sheet);
        image_free(&image);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(strategies_are_listed_once),
                                       cmocka_unit_test(cells_are_means_and_all_there),
                                       cmocka_unit_test(small_and_odd_images_are_laid_out)};
    return cmocka_run_group_tests_name("contact_sheet", tests, NULL, NULL);
}
