/* contact_sheet: see contact_sheet.h. */
#include "client/image/contact_sheet.h"

#include "client/image/strategy.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    GLYPH_WIDTH = 5,
    GLYPH_HEIGHT = 7,
    ADVANCE = GLYPH_WIDTH + 1,
    GAP = 4,     /* between cells, and around labels */
    MARGIN = 12, /* around a pyramid */
    LABEL_HEIGHT = GLYPH_HEIGHT + GAP,
    TITLE_SCALE = 2,
    TITLE_HEIGHT = TITLE_SCALE * GLYPH_HEIGHT + MARGIN
};

static const float PAPER = 0.03f, INK = 0.6f; /* linear */

/* The letters of the labels and titles, row by row from the top; a dot is a bit, the left one the highest. */
static const struct {
    char letter;
    uint8_t rows[GLYPH_HEIGHT];
} font[] = {
    {'0', {0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110}},
    {'1', {0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110}},
    {'2', {0b01110, 0b10001, 0b00001, 0b00010, 0b00100, 0b01000, 0b11111}},
    {'3', {0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110}},
    {'4', {0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010}},
    {'5', {0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110}},
    {'6', {0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110}},
    {'7', {0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000}},
    {'8', {0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110}},
    {'9', {0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100}},
    {'=', {0b00000, 0b00000, 0b11111, 0b00000, 0b11111, 0b00000, 0b00000}},
    {'d', {0b00001, 0b00001, 0b01111, 0b10001, 0b10001, 0b10001, 0b01111}},
    {'e', {0b00000, 0b00000, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110}},
    {'g', {0b00000, 0b00000, 0b01111, 0b10001, 0b01111, 0b00001, 0b01110}},
    {'h', {0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001}},
    {'i', {0b00100, 0b00000, 0b01100, 0b00100, 0b00100, 0b00100, 0b01110}},
    {'n', {0b00000, 0b00000, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001}},
    {'s', {0b00000, 0b00000, 0b01111, 0b10000, 0b01110, 0b00001, 0b11110}},
    {'t', {0b01000, 0b01000, 0b11110, 0b01000, 0b01000, 0b01001, 0b00110}},
    {'u', {0b00000, 0b00000, 0b10001, 0b10001, 0b10001, 0b10001, 0b01111}},
    {'w', {0b00000, 0b00000, 0b10001, 0b10001, 0b10101, 0b10101, 0b01010}},
};

/* Where things are, in pixels of the sheet. */
typedef struct {
    int segments;
    int factor; /* image pixels a sheet pixel, each way */
    int cell_width, cell_height;
    int pitch_x, pitch_y; /* from cell to cell */
    int pyramid_width, pyramid_height;
    bool stacked; /* one pyramid below the other */
    int width, height;
} layout_t;

static int ceil_div(int a, int b)
{
    return (a + b - 1) / b;
}

static int text_width(const char *text)
{
    return (int)strlen(text) * ADVANCE - 1;
}

static layout_t layout_of(const image_t *image, int segments, int factor, bool stacked)
{
    layout_t layout = {.segments = segments, .factor = factor, .stacked = stacked};
    layout.cell_width = ceil_div(image->width, factor);
    layout.cell_height = ceil_div(image->height, factor);
    layout.pitch_x = int_max(layout.cell_width, text_width("s=10 t=10")) + GAP;
    layout.pitch_y = layout.cell_height + LABEL_HEIGHT + 2 * GAP;
    layout.pyramid_width = (segments + 1) * layout.pitch_x - GAP;
    layout.pyramid_height = TITLE_HEIGHT + segments * layout.pitch_y;
    layout.width = (stacked ? 1 : 2) * (layout.pyramid_width + MARGIN) + MARGIN;
    layout.height = (stacked ? 2 : 1) * (layout.pyramid_height + MARGIN) + MARGIN;
    return layout;
}

/* The largest cells that the sheet has room for with this arrangement. */
static layout_t fit(const image_t *image, int segments, bool stacked)
{
    for (int factor = 1;; factor++) {
        layout_t layout = layout_of(image, segments, factor, stacked);
        bool fits = layout.width <= CONTACT_SHEET_SIDE && layout.height <= CONTACT_SHEET_SIDE;
        if (fits || factor >= int_max(image->width, image->height)) return layout;
    }
}

static layout_t choose_layout(const image_t *image, int segments)
{
    layout_t beside = fit(image, segments, false), below = fit(image, segments, true);
    return below.factor < beside.factor ? below : beside;
}

typedef struct {
    int width, height;
    float *rgb[3];
} page_t;

static void fill_square(const page_t *page, int x, int y, int side)
{
    for (int v = int_max(y, 0); v < int_min(y + side, page->height); v++)
        for (int u = int_max(x, 0); u < int_min(x + side, page->width); u++)
            for (int c = 0; c < 3; c++) page->rgb[c][(size_t)v * (size_t)page->width + (size_t)u] = INK;
}

static void draw_letter(const page_t *page, int x, int y, int scale, char letter)
{
    for (size_t i = 0; i < ARRAY_LENGTH(font); i++) {
        if (font[i].letter != letter) continue;
        for (int d = 0; d < GLYPH_WIDTH * GLYPH_HEIGHT; d++)
            if (font[i].rows[d / GLYPH_WIDTH] >> (GLYPH_WIDTH - 1 - d % GLYPH_WIDTH) & 1)
                fill_square(page, x + scale * (d % GLYPH_WIDTH), y + scale * (d / GLYPH_WIDTH), scale);
    }
}

/* Letters that the font lacks are blank. */
static void draw_text(const page_t *page, int x, int y, int scale, const char *text)
{
    for (; *text; text++, x += scale * ADVANCE) draw_letter(page, x, y, scale, *text);
}

/* The mean of a square of the image's pixels, at its rim of those that there are. */
static float mean_of(const image_t *image, const image_channel_t *channel, int x, int y, int factor)
{
    int x0 = x * factor, x1 = int_min(x0 + factor, image->width);
    int y0 = y * factor, y1 = int_min(y0 + factor, image->height);
    double sum = 0;
    for (int v = y0; v < y1; v++)
        for (int u = x0; u < x1; u++)
            sum += channel->data[((size_t)v * (size_t)image->width + (size_t)u) * channel->stride];
    return (float)(sum / ((double)(x1 - x0) * (y1 - y0)));
}

static void draw_image(const page_t *page, const layout_t *layout, int left, int top, const image_t *image,
                       const image_channel_t *const rgb[3], float scale)
{
    for (int y = 0; y < layout->cell_height; y++)
        for (int x = 0; x < layout->cell_width; x++) {
            size_t at = (size_t)(top + y) * (size_t)page->width + (size_t)(left + x);
            for (int c = 0; c < 3; c++)
                page->rgb[c][at] = scale * mean_of(image, rgb[c], x, y, layout->factor);
        }
}

static void draw_cell(const page_t *page, const layout_t *layout, int left, int top, const image_t *image,
                      strategy_t strategy, bool weighted, float scale)
{
    const image_channel_t *rgb[3];
    char *layer = strategy_layer(strategy, weighted);
    char *label = mem_printf("s=%d t=%d", strategy.s, strategy.t);
    if (image_find_rgb(image, layer, rgb)) {
        draw_image(page, layout, left + (layout->pitch_x - GAP - layout->cell_width) / 2, top, image, rgb,
                   scale);
        draw_text(page, left + (layout->pitch_x - GAP - text_width(label)) / 2,
                  top + layout->cell_height + GAP, 1, label);
    }
    free(layer);
    free(label);
}

static void draw_pyramid(const page_t *page, const layout_t *layout, int left, int top, const image_t *image,
                         bool weighted, float scale)
{
    draw_text(page, left, top, TITLE_SCALE, weighted ? "weighted" : "unweighted");
    for (int k = 1; k <= layout->segments; k++)
        for (int s = 0; s <= k; s++) {
            int x = left + s * layout->pitch_x + (layout->segments - k) * layout->pitch_x / 2;
            int y = top + TITLE_HEIGHT + (k - 1) * layout->pitch_y;
            draw_cell(page, layout, x, y, image, (strategy_t){s, k + 1 - s}, weighted, scale);
        }
}

static result_t blank_sheet(const layout_t *layout, image_t *sheet, page_t *page)
{
    image_init(sheet, layout->width, layout->height);
    *page = (page_t){.width = layout->width, .height = layout->height};
    if (!image_add_rgb(sheet, NULL, PIXEL_FLOAT, page->rgb)) {
        image_free(sheet);
        return result_fail(RESULT_LIMIT, "no memory for a contact sheet of %d x %d pixels", layout->width,
                           layout->height);
    }
    for (int c = 0; c < 3; c++)
        for (size_t i = 0; i < (size_t)layout->width * (size_t)layout->height; i++) page->rgb[c][i] = PAPER;
    return result_ok();
}

result_t contact_sheet_make(const image_t *image, int segments, double exposure, image_t *sheet)
{
    layout_t layout = choose_layout(image, segments);
    page_t page;
    float scale = (float)exp2(exposure);
    TRY(blank_sheet(&layout, sheet, &page));
    int second_x = MARGIN + (layout.stacked ? 0 : layout.pyramid_width + MARGIN);
    int second_y = MARGIN + (layout.stacked ? layout.pyramid_height + MARGIN : 0);
    draw_pyramid(&page, &layout, MARGIN, MARGIN, image, false, scale);
    draw_pyramid(&page, &layout, second_x, second_y, image, true, scale);
    return result_ok();
}
