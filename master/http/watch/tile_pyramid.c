/* tile_pyramid: see tile_pyramid.h. */
#include "master/http/watch/tile_pyramid.h"

#include <immintrin.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TEXEL = 4, ERROR = 3 }; /* halves of a texel; the place of its standard error */
#define LARGEST_HALF 65504.0f

typedef struct {
    int width, height, columns, rows;
    int filled;         /* rows that pyramid_put has written since it began anew */
    uint16_t *texels;   /* [height][width][TEXEL] */
    uint32_t *versions; /* [rows][columns] */
} level_t;

struct pyramid {
    uint32_t count;
    level_t levels[PYRAMID_MAX_LEVELS];
    uint16_t *row; /* of texels, that is being made */
};

/* ---- layers -------------------------------------------------------------------------------------------- */

/* The plane of a layer in a film and in a file. */
typedef struct {
    const char *name;
    size_t plane;            /* offset of its pointer in film_image_t */
    size_t values;           /* of a pixel: 3 or 1 */
    const char *channels[3]; /* in a file */
    bool error, feature;
    float scale;
    texel_kind_t kind;
} layer_row_t;

#define PLANE(field) offsetof(film_image_t, field)
#define RGB(layer)                                                                                           \
    {                                                                                                        \
        layer "R", layer "G", layer "B"                                                                      \
    }
#define ALL(channel)                                                                                         \
    {                                                                                                        \
        channel, channel, channel                                                                            \
    }
#define GROUP(number)                                                                                        \
    [LAYER_GROUP0 + number] = {"group" #number, PLANE(group_eye[number]), 3, .scale = 1, .kind = TEXELS_SUMS}
static const layer_row_t layers[LAYERS] = {
    [LAYER_PICTURE] = {"picture", PLANE(sum), 3, RGB(""), .error = true, .scale = 1},
    [LAYER_EYE] = {"eye", PLANE(eye), 3, RGB("eye."), .error = true, .scale = 1},
    [LAYER_LIGHT] = {"light", PLANE(light), 3, RGB("light."), .error = true, .scale = 1},
    [LAYER_NOISE] = {"noise", PLANE(noise), 3, RGB("noise."), .scale = 1},
    [LAYER_SAMPLES] = {"samples", PLANE(samples), 1, ALL("samples"), .scale = 0x1p-10f},
    [LAYER_ALBEDO] = {"albedo", PLANE(albedo), 3, RGB("albedo."), .feature = true, .scale = 1},
    [LAYER_NORMAL] =
        {"normal", PLANE(normal), 3, {"normal.X", "normal.Y", "normal.Z"}, .feature = true, .scale = 1},
    [LAYER_DEPTH] = {"depth", PLANE(depth), 1, ALL("depth.Z"), .feature = true, .scale = 1},
    [LAYER_OBJECT] = {"object", PLANE(object), 1, ALL("object.id"), .feature = true, .kind = TEXELS_IDS},
    [LAYER_MATERIAL] = {"material", PLANE(material), 1, ALL("material.id"), .feature = true,
                        .kind = TEXELS_IDS},
    [LAYER_STRATEGIES] = {"strategies", PLANE(eye), 3, RGB("eye."), .kind = TEXELS_SHARES},
    [LAYER_HALF0] = {"half0", PLANE(half[0]), 3, RGB("half0."), .scale = 1},
    [LAYER_HALF1] = {"half1", PLANE(half[1]), 3, RGB("half1."), .scale = 1},
    GROUP(0),
    GROUP(1),
    GROUP(2),
    GROUP(3),
    GROUP(4),
    GROUP(5),
    GROUP(6),
    GROUP(7)};
_Static_assert(LIGHT_GROUPS_MAX == 8, "the layers of light groups are others");

const char *layer_name(layer_t layer)
{
    return layers[layer].name;
}

bool layer_parse(const char *name, layer_t *layer)
{
    for (int i = 0; i < LAYERS; i++) {
        if (strcmp(name, layers[i].name) != 0) continue;
        *layer = (layer_t)i;
        return true;
    }
    return false;
}

bool layer_is_feature(layer_t layer)
{
    return layers[layer].feature;
}

bool layer_is_half(layer_t layer)
{
    return layer == LAYER_HALF0 || layer == LAYER_HALF1;
}

bool layer_is_group(layer_t layer)
{
    return layer >= LAYER_GROUP0;
}

bool layer_of_job(const job_settings_t *settings, layer_t layer)
{
    if (layer_is_feature(layer)) return job_has_features(settings);
    return !layer_is_group(layer) || layer - LAYER_GROUP0 < light_groups_count(settings->light_groups);
}

char *layer_names(void)
{
    char *names = mem_strdup(layers[0].name);
    for (int i = 1; i < LAYERS; i++) {
        char *more = mem_printf("%s%s%s", names, i < LAYERS - 1 ? ", " : " or ", layers[i].name);
        free(names);
        names = more;
    }
    return names;
}

static bool view_plane(const film_image_t *image, layer_t layer, const float *values[3])
{
    const float *plane;
    memcpy(&plane, (const char *)image + layers[layer].plane, sizeof plane);
    for (size_t c = 0; plane != NULL && c < 3; c++) values[c] = plane + (layers[layer].values == 3 ? c : 0);
    return plane != NULL;
}

/* What is added to a group's eye image; without it the values are all. */
static void view_rest(const float *plane, layer_view_t *view)
{
    if (plane == NULL) view->kind = TEXELS_MEANS;
    for (size_t c = 0; plane != NULL && c < 3; c++) view->rest[c] = plane + c;
}

bool layer_of_film(const film_image_t *image, layer_t layer, layer_view_t *view)
{
    const layer_row_t *row = &layers[layer];
    *view = (layer_view_t){.width = image->width,
                           .height = image->height,
                           .kind = row->kind,
                           .stride = row->values,
                           .error_stride = 3,
                           .scale = row->scale};
    if (row->kind == TEXELS_SHARES && !view_plane(image, LAYER_LIGHT, view->rest)) return false;
    if (row->kind == TEXELS_SUMS) view_rest(image->group_light[layer - LAYER_GROUP0], view);
    for (size_t c = 0; c < 3; c++) view->errors[c] = row->error ? image->noise + c : NULL;
    return view_plane(image, layer, view->values);
}

/* Channels of a file; their strides are the same, since the reader made them. */
static bool view_channels(const image_t *image, const char *const names[3], const float *values[3],
                          size_t *stride)
{
    for (size_t c = 0; c < 3; c++) {
        const image_channel_t *channel = image_find(image, names[c]);
        if (channel == NULL) return false;
        values[c] = channel->data;
        *stride = channel->stride;
    }
    return true;
}

/* A group's channels are called by its name, which the file's attributes tell. */
static bool group_of_file(const image_t *image, uint32_t group, layer_view_t *view)
{
    const image_attribute_t *groups = image_attribute(image, "lightmill.lightGroups");
    if (groups == NULL || light_groups_check(groups->text).code != RESULT_OK) return false;
    char name[LIGHT_GROUP_NAME + 1], channels[2][3][2 * LIGHT_GROUP_NAME];
    const char *names[2][3];
    light_groups_name(groups->text, group, name);
    for (int i = 0; i < 6; i++) {
        snprintf(channels[i / 3][i % 3], sizeof channels[0][0], "group.%s.%s.%c", name,
                 i < 3 ? "eye" : "light", "RGB"[i % 3]);
        names[i / 3][i % 3] = channels[i / 3][i % 3];
    }
    if (!view_channels(image, names[1], view->rest, &view->stride)) view->kind = TEXELS_MEANS;
    return view_channels(image, names[0], view->values, &view->stride);
}

bool layer_of_file(const image_t *image, layer_t layer, layer_view_t *view)
{
    const layer_row_t *row = &layers[layer];
    *view = (layer_view_t){
        .width = image->width, .height = image->height, .kind = row->kind, .scale = row->scale};
    if (row->kind == TEXELS_SUMS) return group_of_file(image, (uint32_t)(layer - LAYER_GROUP0), view);
    if (row->error && !view_channels(image, layers[LAYER_NOISE].channels, view->errors, &view->error_stride))
        memset(view->errors, 0, sizeof view->errors);
    if (row->kind == TEXELS_SHARES &&
        !view_channels(image, layers[LAYER_LIGHT].channels, view->rest, &view->stride))
        return false;
    return view_channels(image, row->channels, view->values, &view->stride);
}

/* ---- levels -------------------------------------------------------------------------------------------- */

int level_side(int side, uint32_t level)
{
    return level < 31 ? int_max(1, (int)(((int64_t)side + (INT64_C(1) << level) - 1) >> level)) : 1;
}

uint32_t level_count(int width, int height)
{
    uint32_t count = 1;
    while (level_side(int_max(width, height), count - 1) > TILE_SIDE) count++;
    return count;
}

static int tiles_of(int side)
{
    return (side + TILE_SIDE - 1) / TILE_SIDE;
}

static uint64_t texel_bytes(int width, int height)
{
    return (uint64_t)width * (uint64_t)height * TEXEL * sizeof(uint16_t);
}

uint64_t pyramid_bytes(int width, int height)
{
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < level_count(width, height); i++)
        bytes += texel_bytes(level_side(width, i), level_side(height, i));
    return bytes;
}

static bool level_init(level_t *level, int width, int height, uint32_t version)
{
    *level =
        (level_t){.width = width, .height = height, .columns = tiles_of(width), .rows = tiles_of(height)};
    size_t tiles = (size_t)level->columns * (size_t)level->rows;
    level->texels = calloc(1, texel_bytes(width, height));
    level->versions = calloc(tiles, sizeof *level->versions);
    for (size_t i = 0; level->versions != NULL && i < tiles; i++) level->versions[i] = version;
    return level->texels != NULL && level->versions != NULL;
}

/* Four floats as halves, rounded to nearest even; NaN becomes 0. */
static void put_texel(uint16_t *texel, __m128 value)
{
    __m128 largest = _mm_set1_ps(LARGEST_HALF);
    value = _mm_and_ps(value, _mm_cmpord_ps(value, value));
    value = _mm_max_ps(_mm_min_ps(value, largest), _mm_sub_ps(_mm_setzero_ps(), largest));
    _mm_storel_epi64((__m128i *)texel, _mm_cvtps_ph(value, _MM_FROUND_TO_NEAREST_INT));
}

static __m128 get_texel(const uint16_t *texel)
{
    return _mm_cvtph_ps(_mm_loadl_epi64((const __m128i *)texel));
}

/* The weights are those of the luminance (Rec. 709). */
static float luminance(const float *const values[3], size_t at)
{
    return 0.2126f * values[0][at] + 0.7152f * values[1][at] + 0.0722f * values[2][at];
}

/* The errors of the channels of one sample have the same sign as a rule: a path is bright or dark as a whole.
 * So they add up. Where they do not, this is an upper bound. */
static __m128 value_texel(const layer_view_t *view, size_t pixel)
{
    size_t at = pixel * view->stride;
    float error = view->errors[0] != NULL ? luminance(view->errors, pixel * view->error_stride) : 0;
    return _mm_setr_ps(view->scale * view->values[0][at], view->scale * view->values[1][at],
                       view->scale * view->values[2][at], error);
}

static __m128 id_texel(const layer_view_t *view, size_t pixel)
{
    float value = view->values[0][pixel * view->stride];
    uint32_t id = value > 0 && value < 0x1p32f ? (uint32_t)value : 0;
    return _mm_setr_ps((float)(id & 2047), (float)(id >> 11 & 2047), (float)(id >> 22), 0);
}

/* Black where there is no light. */
static __m128 share_texel(const layer_view_t *view, size_t pixel)
{
    float part = luminance(view->values, pixel * view->stride),
          rest = luminance(view->rest, pixel * view->stride);
    if (!(part + rest > 0)) return _mm_setzero_ps();
    return _mm_setr_ps(part / (part + rest), 0, rest / (part + rest), 0);
}

static __m128 sum_texel(const layer_view_t *view, size_t pixel)
{
    size_t at = pixel * view->stride;
    return _mm_setr_ps(view->values[0][at] + view->rest[0][at], view->values[1][at] + view->rest[1][at],
                       view->values[2][at] + view->rest[2][at], 0);
}

/* Writes the row that has been made; tiles in which it changes something get the version. */
static void store_row(level_t *level, int y, const uint16_t *row, uint32_t version)
{
    uint16_t *texels = level->texels + TEXEL * (size_t)y * (size_t)level->width;
    uint32_t *versions = level->versions + (size_t)(y / TILE_SIDE) * (size_t)level->columns;
    for (int column = 0; column < level->columns; column++) {
        size_t first = TEXEL * (size_t)column * TILE_SIDE,
               size = TEXEL * (size_t)int_min(TILE_SIDE, level->width - column * TILE_SIDE);
        if (memcmp(texels + first, row + first, size * sizeof *row) == 0) continue;
        memcpy(texels + first, row + first, size * sizeof *row);
        versions[column] = version;
    }
    level->filled = y + 1;
}

static void fill_first(pyramid_t *pyramid, const layer_view_t *rows, int y, uint32_t version)
{
    static __m128 (*const makers[])(const layer_view_t *, size_t) = {[TEXELS_MEANS] = value_texel,
                                                                     [TEXELS_IDS] = id_texel,
                                                                     [TEXELS_SHARES] = share_texel,
                                                                     [TEXELS_SUMS] = sum_texel};
    level_t *level = &pyramid->levels[0];
    size_t width = (size_t)level->width;
    for (int v = 0; v < rows->height && y + v < level->height; v++) {
        for (size_t x = 0; x < width; x++)
            put_texel(pyramid->row + TEXEL * x, makers[rows->kind](rows, (size_t)v * width + x));
        store_row(level, y + v, pyramid->row, version);
    }
}

/* The mean of two by two texels, fewer at the rim. The error of a mean of n is the root of the sum of squares
 * over n. */
static __m128 box(const level_t *below, int x, int y)
{
    __m128 sum = _mm_setzero_ps();
    int x1 = int_min(2 * x + 2, below->width), y1 = int_min(2 * y + 2, below->height);
    for (int v = 2 * y; v < y1; v++)
        for (int u = 2 * x; u < x1; u++) {
            __m128 t = get_texel(below->texels + TEXEL * ((size_t)v * (size_t)below->width + (size_t)u));
            sum = _mm_add_ps(sum, _mm_blend_ps(t, _mm_mul_ps(t, t), 1 << ERROR));
        }
    sum = _mm_blend_ps(sum, _mm_sqrt_ps(sum), 1 << ERROR);
    return _mm_div_ps(sum, _mm_set1_ps((float)((x1 - 2 * x) * (y1 - 2 * y))));
}

static __m128 nearest(const level_t *below, int x, int y)
{
    return get_texel(below->texels + TEXEL * ((size_t)(2 * y) * (size_t)below->width + (size_t)(2 * x)));
}

/* Makes the rows of a level that the one below has become complete for. */
static void fill_next(pyramid_t *pyramid, level_t *level, texel_kind_t kind, uint32_t version)
{
    const level_t *below = level - 1;
    int complete = below->filled == below->height ? level->height : below->filled / 2;
    for (int y = level->filled; y < complete; y++) {
        for (int x = 0; x < level->width; x++)
            put_texel(pyramid->row + TEXEL * (size_t)x,
                      kind == TEXELS_IDS ? nearest(below, x, y) : box(below, x, y));
        store_row(level, y, pyramid->row, version);
    }
}

void pyramid_put(pyramid_t *pyramid, const layer_view_t *rows, int y, uint32_t version)
{
    for (uint32_t i = 0; y == 0 && i < pyramid->count; i++) pyramid->levels[i].filled = 0;
    fill_first(pyramid, rows, y, version);
    for (uint32_t i = 1; i < pyramid->count; i++)
        fill_next(pyramid, &pyramid->levels[i], rows->kind, version);
}

/* The texels of a tile. */
static rect_t tile_rect(const level_t *level, int column, int row)
{
    rect_t rect = {.x0 = column * TILE_SIDE, .y0 = row * TILE_SIDE};
    rect.x1 = int_min(rect.x0 + TILE_SIDE, level->width);
    rect.y1 = int_min(rect.y0 + TILE_SIDE, level->height);
    return rect;
}

static const uint16_t *row_of(const level_t *level, const rect_t *rect, int y)
{
    return level->texels + TEXEL * ((size_t)y * (size_t)level->width + (size_t)rect->x0);
}

static size_t row_bytes(const rect_t *rect)
{
    return (size_t)(rect->x1 - rect->x0) * TEXEL * sizeof(uint16_t);
}

pyramid_t *pyramid_new(int width, int height, uint32_t version)
{
    pyramid_t *pyramid = calloc(1, sizeof *pyramid);
    if (pyramid == NULL) return NULL;
    pyramid->count = level_count(width, height);
    pyramid->row = malloc(texel_bytes(width, 1));
    bool complete = pyramid->row != NULL;
    for (uint32_t i = 0; complete && i < pyramid->count; i++)
        complete = level_init(&pyramid->levels[i], level_side(width, i), level_side(height, i), version);
    if (!complete) pyramid_destroy(&pyramid);
    return pyramid;
}

void pyramid_destroy(pyramid_t **pyramid)
{
    if (*pyramid == NULL) return;
    for (uint32_t i = 0; i < (*pyramid)->count; i++) {
        free((*pyramid)->levels[i].texels);
        free((*pyramid)->levels[i].versions);
    }
    free((*pyramid)->row);
    free(*pyramid);
    *pyramid = NULL;
}

/* ---- answers ------------------------------------------------------------------------------------------- */

/* The tiles that a rectangle of texels touches: columns x0 to x1 - 1, rows y0 to y1 - 1. */
static rect_t touched(const rect_t *rect, int width, int height)
{
    rect_t tiles = {.x0 = int_max(rect->x0, 0) / TILE_SIDE,
                    .y0 = int_max(rect->y0, 0) / TILE_SIDE,
                    .x1 = tiles_of(int_min(int_max(rect->x1, 0), width)),
                    .y1 = tiles_of(int_min(int_max(rect->y1, 0), height))};
    if (tiles.x1 < tiles.x0) tiles.x1 = tiles.x0;
    if (tiles.y1 < tiles.y0) tiles.y1 = tiles.y0;
    return tiles;
}

static uint8_t *put(uint8_t *at, uint32_t value, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++) at[i] = (uint8_t)(value >> (8 * i));
    return at + bytes;
}

static uint8_t *put_tile(uint8_t *at, const level_t *level, int column, int row)
{
    rect_t rect = tile_rect(level, column, row);
    at = put(at, (uint32_t)column, 2);
    at = put(at, (uint32_t)row, 2);
    at = put(at, (uint32_t)(rect.x1 - rect.x0), 2);
    at = put(at, (uint32_t)(rect.y1 - rect.y0), 2);
    for (int y = rect.y0; y < rect.y1; y++, at += row_bytes(&rect))
        memcpy(at, row_of(level, &rect, y), row_bytes(&rect));
    return at;
}

static bool is_new(const level_t *level, int column, int row, uint32_t since)
{
    uint32_t version = level->versions[(size_t)row * (size_t)level->columns + (size_t)column];
    return since == 0 || version > since;
}

/* Counts the tiles to send and, unless `at` is NULL, writes them and moves it behind them. */
static uint32_t walk(const level_t *level, const rect_t *tiles, uint32_t since, uint8_t **at)
{
    uint32_t count = 0;
    for (int row = tiles->y0; row < tiles->y1; row++)
        for (int column = tiles->x0; column < tiles->x1; column++) {
            if (!is_new(level, column, row, since)) continue;
            if (at != NULL) *at = put_tile(*at, level, column, row);
            count++;
        }
    return count;
}

result_t pyramid_answer(const pyramid_t *pyramid, int width, int height, uint32_t version,
                        const tile_query_t *query, uint8_t **bytes, size_t *size)
{
    uint32_t levels = level_count(width, height);
    if (query->level >= levels)
        return result_fail(RESULT_USAGE, "there is no level %u: this image has 0 to %u", query->level,
                           levels - 1);
    rect_t tiles = touched(&query->rect, level_side(width, query->level), level_side(height, query->level));
    if ((int64_t)(tiles.x1 - tiles.x0) * (tiles.y1 - tiles.y0) > PYRAMID_MAX_TILES)
        return result_fail(RESULT_USAGE, "more than %d tiles: ask for a higher level or a smaller rectangle",
                           PYRAMID_MAX_TILES);
    const level_t *level = pyramid != NULL ? &pyramid->levels[query->level] : NULL;
    /* A master that lost its last checkpoint counts again from an earlier version. */
    uint32_t since = query->since > version ? 0 : query->since;
    uint32_t count = level != NULL ? walk(level, &tiles, since, NULL) : 0;
    *bytes = mem_alloc(TILE_HEAD_BYTES + (size_t)count * (8 + texel_bytes(TILE_SIDE, TILE_SIDE)));
    memcpy(*bytes, "LMT1", 4);
    const uint32_t head[] = {version, (uint32_t)width, (uint32_t)height, query->level, TILE_SIDE, count};
    uint8_t *at = *bytes + 4;
    for (size_t i = 0; i < ARRAY_LENGTH(head); i++) at = put(at, head[i], 4);
    if (level != NULL) walk(level, &tiles, since, &at);
    *size = (size_t)(at - *bytes);
    return result_ok();
}
