/* texture_image: texels, their decoding, and looking images up. See texture_internal.h.
 *
 * A look-up is two independent axes: each gives two texel indices and their weights, in whatever way it
 * wraps, so that the rest is the same for all: four texels, decoded first and weighted then.
 */
#include "worker/render/texture/texture_internal.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- decoding ------------------------------------------------------------------------------------------ */

static bool is_encoded(uint32_t format)
{
    return format == TEXELS_R8 || format == TEXELS_RGBA8;
}

/* The sRGB transfer function (IEC 61966-2-1), or a power. */
static float decode(int code, double gamma)
{
    double x = code / 255.0;
    if (gamma == 0) return (float)(x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4));
    return (float)(gamma == 1 ? x : pow(x, gamma));
}

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static int compare_tables(const void *gamma, const void *table)
{
    return compare_floats(gamma, &((const decode_table_t *)table)->gamma);
}

/* One table for each gamma that occurs. Returns how many. */
static size_t make_tables(textures_t *textures)
{
    const scene_blob_t *blob = textures->blob;
    uint64_t images = blob->counts[BLOB_SECTION_IMAGES];
    float *gammas = mem_zalloc(images + 1, sizeof *gammas);
    size_t used = 0, tables = 0;
    for (uint64_t i = 0; i < images; i++)
        if (is_encoded(blob->images[i].format)) gammas[used++] = blob->images[i].gamma;
    qsort(gammas, used, sizeof *gammas, compare_floats);
    for (size_t i = 0; i < used; i++)
        if (tables == 0 || gammas[i] != gammas[tables - 1]) gammas[tables++] = gammas[i];
    textures->tables = mem_zalloc(tables + 1, sizeof *textures->tables);
    for (size_t i = 0; i < tables; i++) {
        textures->tables[i].gamma = gammas[i];
        for (int code = 0; code < 256; code++)
            textures->tables[i].linear[code] = decode(code, (double)gammas[i]);
    }
    free(gammas);
    return tables;
}

void images_init(textures_t *textures)
{
    const scene_blob_t *blob = textures->blob;
    uint64_t count = blob->counts[BLOB_SECTION_IMAGES];
    size_t tables = make_tables(textures);
    textures->blocks = texture_blocks_new(blob);
    textures->images = mem_zalloc(count + 1, sizeof *textures->images);
    for (uint64_t i = 0; i < count; i++) {
        const blob_image_t *from = &blob->images[i];
        image_view_t *image = &textures->images[i];
        *image = (image_view_t){.words = blob->texels + from->first_word,
                                .blocks = textures->blocks,
                                .format = from->format,
                                .width = from->width,
                                .height = from->height};
        if (is_encoded(from->format))
            image->table =
                bsearch(&from->gamma, textures->tables, tables, sizeof *textures->tables, compare_tables);
    }
}

void textures_size(const textures_t *textures, uint32_t image, uint32_t *width, uint32_t *height)
{
    *width = textures->images[image].width;
    *height = textures->images[image].height;
}

/* ---- texels -------------------------------------------------------------------------------------------- */

static float word_float(const uint32_t *word)
{
    float value;
    memcpy(&value, word, sizeof value);
    return value;
}

static inline rgb_t texel_r8(const image_view_t *image, size_t index)
{
    float grey = image->table->linear[((const uint8_t *)image->words)[index]];
    return vec3(grey, grey, grey);
}

static inline rgb_t texel_rgba8(const image_view_t *image, size_t index)
{
    const float *linear = image->table->linear;
    uint32_t word = image->words[index];
    return vec3(linear[word & 255], linear[word >> 8 & 255], linear[word >> 16 & 255]);
}

static inline rgb_t texel_r32f(const image_view_t *image, size_t index)
{
    float grey = word_float(image->words + index);
    return vec3(grey, grey, grey);
}

static inline rgb_t texel_rgb32f(const image_view_t *image, size_t index)
{
    const uint32_t *words = image->words + 3 * index;
    return vec3(word_float(words), word_float(words + 1), word_float(words + 2));
}

static inline rgb_t texel_alpha(const image_view_t *image, size_t index)
{
    float alpha = (float)(image->words[index] >> 24) / 255.0f;
    return vec3(alpha, alpha, alpha);
}

/* ---- looking up ---------------------------------------------------------------------------------------- */

/* Has a texel read that may not be in memory. */
static void fetch(const image_view_t *image, size_t index)
{
    texture_blocks_touch(image->blocks,
                         (const uint8_t *)image->words + index * blob_texel_bytes(image->format));
}

/* The two texels about a coordinate along one axis, and their weights. */
typedef struct {
    uint32_t index[2];
    float weight[2];
} taps_t;

/* A coordinate brought into [0, 1], whatever lies outside being a copy of what lies there. */
static inline float wrap_fold(float s, wrap_t wrap)
{
    if (wrap == WRAP_CLAMP) return float_min(float_max(s, 0), 1);
    if (wrap == WRAP_MIRROR) {
        float folded = s - 2 * floorf(0.5f * s);
        return folded > 1 ? 2 - folded : folded;
    }
    return s - floorf(s);
}

static taps_t nearest_taps(float s, uint32_t size, wrap_t wrap)
{
    bool outside = wrap == WRAP_BLACK && !(s >= 0 && s < 1);
    uint32_t index = (uint32_t)(wrap_fold(s, wrap) * (float)size);
    if (index >= size) index = size - 1;
    return (taps_t){{index, index}, {outside ? 0 : 1, 0}};
}

/* Texels outside have no weight. */
static taps_t black_taps(float s, uint32_t size)
{
    int n = (int)size;
    float x = float_clamp(s * (float)n - 0.5f, -2, (float)n + 1), below = floorf(x);
    int first = (int)below;
    taps_t taps = {{0, 0}, {0, 0}};
    for (int k = 0; k < 2; k++)
        if (first + k >= 0 && first + k < n) {
            taps.index[k] = (uint32_t)(first + k);
            taps.weight[k] = k == 1 ? x - below : 1 - (x - below);
        }
    return taps;
}

static inline taps_t linear_taps(float s, uint32_t size, wrap_t wrap)
{
    if (wrap == WRAP_BLACK) return black_taps(s, size);
    /* x is from -0.5 to size - 0.5, so that one texel at most lies outside, and by one. */
    float x = wrap_fold(s, wrap) * (float)size - 0.5f, below = floorf(x), part = x - below;
    int first = (int)below, last = (int)size - 1;
    bool copies = wrap == WRAP_CLAMP || wrap == WRAP_MIRROR; /* the texel over the edge: itself again */
    uint32_t before = (uint32_t)(first >= 0 ? first : copies ? 0 : last);
    uint32_t after = (uint32_t)(first < last ? first + 1 : copies ? last : 0);
    return (taps_t){{before, after}, {1 - part, part}};
}

static inline taps_t axis_taps(float s, uint32_t size, wrap_t wrap, bool nearest)
{
    s = coordinate_limit(s);
    return nearest ? nearest_taps(s, size, wrap) : linear_taps(s, size, wrap);
}

typedef rgb_t (*texel_t)(const image_view_t *image, size_t index);

/* Where a texel lies, counted in texels from the image's first. */
static inline size_t place(const image_view_t *image, uint32_t x, uint32_t y)
{
    blob_row_t row = blob_image_row(image->width, image->height, y);
    return row.first + x * row.step;
}

static inline rgb_t weighted_row(const image_view_t *image, texel_t texel, uint32_t y, const taps_t *x)
{
    blob_row_t row = blob_image_row(image->width, image->height, y);
    rgb_t left = texel(image, row.first + x->index[0] * row.step),
          right = texel(image, row.first + x->index[1] * row.step);
    return v_mad(v_scale(left, x->weight[0]), x->weight[1], right);
}

/* Inlined for each kind of texel. */
static inline __attribute__((always_inline)) rgb_t weighted(const image_view_t *image, texel_t texel,
                                                            const taps_t *x, const taps_t *y)
{
    rgb_t upper = weighted_row(image, texel, y->index[0], x);
    rgb_t lower = weighted_row(image, texel, y->index[1], x);
    return v_mad(v_scale(upper, y->weight[0]), y->weight[1], lower);
}

static void fetch_taps(const image_view_t *image, const taps_t *x, const taps_t *y)
{
    for (int k = 0; k < 4; k++) fetch(image, place(image, x->index[k & 1], y->index[k >> 1]));
}

rgb_t rgb_channel(rgb_t c, channel_t channel)
{
    float value;
    switch (channel) {
    case CHANNEL_R:
        value = c.x;
        break;
    case CHANNEL_G:
        value = c.y;
        break;
    case CHANNEL_B:
        value = c.z;
        break;
    case CHANNEL_A:
        value = 1;
        break;
    case CHANNEL_LUMINANCE:
        value = 0.212671f * c.x + 0.715160f * c.y + 0.072169f * c.z;
        break;
    case CHANNEL_MEAN:
        value = (c.x + c.y + c.z) / 3;
        break;
    default:
        return c;
    }
    return vec3(value, value, value);
}

rgb_t image_lookup(const image_view_t *image, const image_lookup_t *how, vec2_t st)
{
    taps_t x = axis_taps(st.x, image->width, how->wrap_s, how->nearest);
    taps_t y = axis_taps(st.y, image->height, how->wrap_t, how->nearest);
    if (image->blocks != NULL) fetch_taps(image, &x, &y);
    if (how->channel == CHANNEL_A && image->format == TEXELS_RGBA8)
        return weighted(image, texel_alpha, &x, &y);
    rgb_t colour;
    switch ((texels_t)image->format) {
    case TEXELS_R8:
        colour = weighted(image, texel_r8, &x, &y);
        break;
    case TEXELS_RGBA8:
        colour = weighted(image, texel_rgba8, &x, &y);
        break;
    case TEXELS_R32F:
        colour = weighted(image, texel_r32f, &x, &y);
        break;
    default:
        colour = weighted(image, texel_rgb32f, &x, &y);
        break;
    }
    return rgb_channel(colour, how->channel);
}

rgb_t textures_image(const textures_t *textures, uint32_t image, wrap_t along_s, wrap_t along_t, vec2_t st)
{
    image_lookup_t how = {along_s, along_t, false, CHANNEL_RGB};
    return image_lookup(&textures->images[image], &how, st);
}

rgb_t textures_texel(const textures_t *textures, uint32_t index, uint32_t x, uint32_t y)
{
    const image_view_t *image = &textures->images[index];
    size_t at = place(image, x, y);
    if (image->blocks != NULL) fetch(image, at);
    switch ((texels_t)image->format) {
    case TEXELS_R8:
        return texel_r8(image, at);
    case TEXELS_RGBA8:
        return texel_rgba8(image, at);
    case TEXELS_R32F:
        return texel_r32f(image, at);
    default:
        return texel_rgb32f(image, at);
    }
}
