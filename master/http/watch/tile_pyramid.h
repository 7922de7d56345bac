/* tile_pyramid: one layer of an image as half floats, at its full size and halved again and again, cut into
 * tiles that know when they changed last. It is what the page shows.
 *
 * A texel is four halves: red, green, blue, and the standard error of the luminance. Level 0 is the image.
 * A texel of the next level is the mean of up to four of the one below (box filter); its standard error is
 * that of the mean, as if the four were independent. Values beyond the largest half are clamped to it.
 *
 * A half is a whole number up to 2048 only. So an id is written as red + 2048 green + 2048^2 blue, and a
 * texel of the next level is one of those below, the nearest to its upper left corner: a mean of ids is none.
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
    LAYER_OBJECT, /* ids */
    LAYER_MATERIAL,
    LAYER_STRATEGIES, /* the share of the luminance that is in LAYER_EYE (red), and in LAYER_LIGHT (blue) */
    LAYER_HALF0,      /* the picture of the even samples alone, */
    LAYER_HALF1,      /* and of the odd ones; an image file need not have them */
    LAYER_GROUP0,     /* what of the picture comes from a light group: of the first, and so on */
    LAYERS = LAYER_GROUP0 + LIGHT_GROUPS_MAX
} layer_t;

/* The layer's name, as in "?layer=picture". */
const char *layer_name(layer_t layer);
/* False when there is none of that name. */
bool layer_parse(const char *name, layer_t *layer);
/* True when only jobs with features (job_has_features) have it. */
bool layer_is_feature(layer_t layer);
/* True when a film has to be resolved with its halves for it (film_rows_t). */
bool layer_is_half(layer_t layer);
/* True when it is of a light group (film_rows_t). */
bool layer_is_group(layer_t layer);
/* False when no job with these settings has it. */
bool layer_of_job(const job_settings_t *settings, layer_t layer);
/* All names, "picture, eye ... or group7", for people; fresh memory. */
char *layer_names(void);

typedef enum { TEXELS_MEANS, TEXELS_IDS, TEXELS_SHARES, TEXELS_SUMS } texel_kind_t;

/* Where the values of some rows of a layer are: three channels, and the standard errors of the picture's
 * channels or NULLs where the layer has no error. Views. */
typedef struct {
    int width, height;
    texel_kind_t kind;
    const float *values[3], *errors[3];
    const float *rest[3];        /* of TEXELS_SHARES: what the values are a share of, without them; of
                                    TEXELS_SUMS: what is added to them */
    size_t stride, error_stride; /* floats from pixel to pixel; that of the rest is that of the values */
    float scale;                 /* of the values */
} layer_view_t;

/* The view of a resolved film, or of rows of it; false when it has no such layer. */
bool layer_of_film(const film_image_t *image, layer_t layer, layer_view_t *view);
/* The same of an image file. */
bool layer_of_file(const image_t *image, layer_t layer, layer_view_t *view);

typedef struct pyramid pyramid_t;

/* Bytes of the pyramid of such an image. */
uint64_t pyramid_bytes(int width, int height);
/* A pyramid that is black, of this version. NULL when memory lacks. */
pyramid_t *pyramid_new(int width, int height, uint32_t version);
/* Puts rows of the image in their place, the first of them row y. They come from the top to the bottom, and
 * with row 0 it begins anew. Coarser levels follow as soon as their rows are complete. Tiles in which a bit
 * changes get this version. Between two calls a pyramid may hold rows of two versions; their tiles say so. */
void pyramid_put(pyramid_t *pyramid, const layer_view_t *rows, int y, uint32_t version);
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
