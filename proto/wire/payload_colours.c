/* payload_colours: see payload_colours.h.
 *
 * DESIGN. Some thousand of the pixels are counted by their colour, rounded, in a table of slots that have
 * room for one colour each. Of several the most frequent one stays (Boyer and Moore's vote), so the pixels
 * without a colour in common with others, often half of them, do not crowd out those with one. Then every
 * pixel gets the colour of its slot where that fits. What is done for each pixel has no branches: which way
 * they go would be noise too. */
#include "proto/wire/payload_colours.h"

#include <stdlib.h>
#include <string.h>

enum {
    SLOT_BITS = 12,
    SLOTS = 1 << SLOT_BITS,
    NO_SLOT = SLOTS,   /* of pixels whose colour cannot be written */
    ROUNDED_BITS = 10, /* of a float that are not told apart: 13 of its mantissa are */
    VOTERS = 1 << 13,  /* pixels that are counted, about */
    MIN_VOTES = 4      /* that pay for a colour */
};

typedef struct {
    uint64_t key; /* the rounded colour */
    colour_t colour;
    uint32_t votes;
    uint8_t number; /* from 1, once it is chosen */
} slot_t;

struct colour_finder {
    slot_t slots[SLOTS + 1]; /* the last is empty */
};

colour_finder_t *colour_finder_new(void)
{
    return mem_alloc(sizeof(colour_finder_t));
}

void colour_finder_free(colour_finder_t *finder)
{
    free(finder);
}

static uint32_t rounded(float share)
{
    uint32_t bits;
    memcpy(&bits, &share, sizeof bits);
    return (bits + (1 << (ROUNDED_BITS - 1))) >> ROUNDED_BITS;
}

/* A pixel's colour, its rounding, and the slot of that. */
typedef struct {
    double of_red[2];
    uint64_t key;
    uint16_t slot;
} look_t;

static look_t look_at(const uint64_t *const rgb[3], size_t pixel)
{
    int64_t red = (int64_t)rgb[0][pixel], green = (int64_t)rgb[1][pixel], blue = (int64_t)rgb[2][pixel];
    const double limit = (double)UINT32_MAX / COLOUR_ONE;
    double scale = 1 / (double)red;
    look_t look = {.of_red = {(double)green * scale, (double)blue * scale}};
    bool good = (red > 0) & (green >= 0) & (blue >= 0) & (look.of_red[0] < limit) & (look.of_red[1] < limit);
    look.key = (uint64_t)rounded((float)look.of_red[0]) << 32 | rounded((float)look.of_red[1]);
    uint64_t place = look.key * UINT64_C(0x9e3779b97f4a7c15) >> (64 - SLOT_BITS);
    look.slot = good ? (uint16_t)place : NO_SLOT;
    return look;
}

/* One pixel more of a colour. */
static void vote(colour_finder_t *finder, const look_t *look)
{
    slot_t *slot = &finder->slots[look->slot];
    if (slot->votes == 0) {
        slot->key = look->key;
        for (int c = 0; c < 2; c++) slot->colour.of_red[c] = (uint32_t)(look->of_red[c] * COLOUR_ONE);
    }
    slot->votes += slot->key == look->key ? 1 : UINT32_MAX;
}

static int by_votes(const void *a, const void *b)
{
    const slot_t *x = *(slot_t *const *)a, *y = *(slot_t *const *)b;
    return x->votes != y->votes ? (x->votes < y->votes ? 1 : -1) : (x > y) - (x < y);
}

/* Numbers the colours with the most votes; none where they have less than a sixteenth of all. */
static int choose(colour_finder_t *finder, size_t voters, colour_t colours[MAX_COLOURS])
{
    slot_t *found[SLOTS] = {NULL};
    size_t count = 0, votes = 0;
    for (size_t i = 0; i < SLOTS; i++)
        if (finder->slots[i].votes >= MIN_VOTES) found[count++] = &finder->slots[i];
    qsort(found, count, sizeof *found, by_votes);
    if (count > MAX_COLOURS) count = MAX_COLOURS;
    for (size_t i = 0; i < count; i++) votes += found[i]->votes;
    if (16 * votes < voters) return 0;
    for (size_t i = 0; i < count; i++) {
        found[i]->number = (uint8_t)(i + 1);
        colours[i] = found[i]->colour;
    }
    return (int)count;
}

/* What is left of green and blue is below 2^-16 of red, or nearly nothing: the rounding of floats. */
static bool fits(const colour_t *colour, uint64_t red, uint64_t green, uint64_t blue)
{
    uint64_t most = (red >> 16) + 64;
    uint64_t g = green - colour_share(red, colour->of_red[0]),
             b = blue - colour_share(red, colour->of_red[1]);
    return (g + most <= 2 * most) & (b + most <= 2 * most);
}

void colour_finder_run(colour_finder_t *finder, const uint64_t *const rgb[3], size_t pixels,
                       colour_t colours[MAX_COLOURS], int *count, uint8_t *index)
{
    size_t step = pixels / VOTERS + 1;
    memset(finder->slots, 0, sizeof finder->slots);
    for (size_t i = 0; i < pixels; i += step) {
        look_t look = look_at(rgb, i);
        if (look.slot != NO_SLOT) vote(finder, &look);
    }
    *count = choose(finder, pixels / step, colours);
    if (*count == 0) {
        memset(index, 0, pixels);
        return;
    }
    for (size_t i = 0; i < pixels; i++) {
        look_t look = look_at(rgb, i);
        const slot_t *slot = &finder->slots[look.slot];
        bool good = (slot->number > 0) & fits(&slot->colour, rgb[0][i], rgb[1][i], rgb[2][i]);
        index[i] = good ? slot->number : 0;
    }
}
