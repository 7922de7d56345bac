/* tile_pyramid: one layer of an image as half floats, at its full size and halved again and again, cut into
 * tiles that know when they changed last. It is what the page shows.
 *
 * A texel is four halves: red, green, blue, and the standard error of the luminance. Level 0 is the image.
 * A texel of the next level is the mean of up to four of the one below (box filter); its standard error is
 * that of the mean, as if the four were independent. Values beyond the largest half are clamped to it.
 */
#ifndef LIGHTMILL_TILE_PYRAMID_H
#define LIGHTMILL_TILE_PYRAMID_H

#include "common/film/film.h"
#include "common/image/image.h"

enum {
    TILE_SIDE = 64,          /* texels a side; tiles at the right and bottom rim may be smaller */
    PYRAMID_MAX_LEVELS = 10, /* the last is one tile; of an image of the largest side, 2^15, it is this one */
    TILE_HEAD_BYTES = 28,    /* of an answer */
    PYRAMID_MAX_TILES = 1024 /* that one answer may hold: 32 MiB */
};

/* What can be seen of a job. */
typedef enum {
    LAYER_PICTURE,
    LAYER_EYE,     /* strategies with t >= 2 eye vertices */
    LAYER_LIGHT,   /* t = 1; the error of both is that of the picture */
    LAYER_NOISE,   /* standard error of R, G and B */
    LAYER_SAMPLES, /* thousands (1024) of samples, so that a half can hold them: exact up to 2048 samples */
    LAYER_ALBEDO,
    LAYER_NORMAL,
    LAYER_DEPTH,
    LAYERS
} layer_t;

/* The layer's name, as in "?layer=picture". */
const char *layer_name(layer_t layer);
/* False when there is none of that name. */
bool layer_parse(const char *name, layer_t *layer);
/* True when only jobs with features (job_has_features) have it. */
bool layer_is_feature(layer_t layer);

/* Where the values of a layer are: three channels, and the standard errors of the picture's channels or NULLs
 * where the layer has no error. Views; an absent channel counts as 0. */
typedef struct {
    int width, height;
    const float *values[3], *errors[3];
    size_t stride, error_stride; /* floats from pixel to pixel */
    float scale;                 /* of the values */
} layer_view_t;

/* The view of a resolved film; false when it has no such layer. */
bool layer_of_film(const film_image_t *image, layer_t layer, layer_view_t *view);
/* The same of an image file. */
bool layer_of_file(const image_t *image, layer_t layer, layer_view_t *view);

typedef struct pyramid pyramid_t;

/* Bytes of the pyramid of such an image. */
uint64_t pyramid_bytes(int width, int height);
/* Makes the pyramid of a view. Tiles that `last` (NULL: none) has with the same bits keep its version, all
 * others get this one. NULL when memory lacks. Takes as long as a few passes over the image. */
pyramid_t *pyramid_new(const layer_view_t *view, uint32_t version, const pyramid_t *last);
/* Frees the pyramid and sets *pyramid to NULL. */
void pyramid_destroy(pyramid_t **pyramid);

/* What a watcher wants to see. */
typedef struct {
    uint32_t level;
    uint32_t since; /* the version that it has; tiles that have not changed since are left out; 0: none */
    rect_t rect;    /* of interest, in texels of the level; clipped */
} tile_query_t;

/* Width and height of a level of an image of this size; level 0 is the image, sides never fall below 1. */
int level_side(int side, uint32_t level);
/* The number of levels of such an image. */
uint32_t level_count(int width, int height);

/* The answer for a watcher, in fresh memory that the caller frees: "LMT1", u32 version, width and height of
 * the image, level, TILE_SIDE, number of tiles; then of each tile u16 column, row, width, height and its
 * texels row by row. All little-endian. `pyramid` NULL: an answer without tiles. RESULT_USAGE when the level
 * does not exist, or the rectangle holds more than PYRAMID_MAX_TILES tiles. */
result_t pyramid_answer(const pyramid_t *pyramid, int width, int height, uint32_t version,
                        const tile_query_t *query, uint8_t **bytes, size_t *size);

#endif
