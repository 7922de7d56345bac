/* light_map: see light_map.h. */
#include "worker/render/light/light_map.h"

#include "worker/render/sampling/octahedral.h"

#include <stdlib.h>

/* A texel of the octahedral map, at most one beyond its edges, each of which is folded about its middle. */
static rgb_t octahedral_texel(const light_map_t *map, int x, int y, int width, int height)
{
    if (x < 0 || x >= width) {
        x = x < 0 ? 0 : width - 1;
        y = height - 1 - y;
    }
    if (y < 0 || y >= height) {
        y = y < 0 ? 0 : height - 1;
        x = width - 1 - x;
    }
    return textures_texel(map->textures, map->image, (uint32_t)x, (uint32_t)y);
}

static rgb_t octahedral_smooth(const light_map_t *map, vec2_t st, int width, int height)
{
    float x = float_clamp(st.x, 0, 1) * (float)width - 0.5f, left = floorf(x), right_part = x - left;
    float y = float_clamp(st.y, 0, 1) * (float)height - 0.5f, above = floorf(y), lower_part = y - above;
    rgb_t sum = vec3(0, 0, 0);
    for (int k = 0; k < 4; k++) {
        float weight = (k & 1 ? right_part : 1 - right_part) * (k & 2 ? lower_part : 1 - lower_part);
        sum = v_mad(sum, weight,
                    octahedral_texel(map, (int)left + (k & 1), (int)above + (k >> 1), width, height));
    }
    return sum;
}

/* pbrt-v3 looks its maps up bilinearly and lets both sides wrap around, so that its poles meet; pbrt-v4 takes
 * the nearest texel of its octahedral ones, but where it lays them out anew for a portal. */
static rgb_t value_at(const light_map_t *map, vec2_t st)
{
    if (map->mapping != LIGHT_OCTAHEDRAL)
        return textures_image(map->textures, map->image, WRAP_REPEAT, map->rows, st);
    uint32_t width, height;
    textures_size(map->textures, map->image, &width, &height);
    if (map->smooth) return octahedral_smooth(map, st, (int)width, (int)height);
    uint32_t x = (uint32_t)(float_clamp(st.x, 0, 0x1.fffffep-1f) * (float)width);
    uint32_t y = (uint32_t)(float_clamp(st.y, 0, 0x1.fffffep-1f) * (float)height);
    return textures_texel(map->textures, map->image, x < width ? x : width - 1, y < height ? y : height - 1);
}

/* Steradians per unit area of the image over 4 pi, where the angle from a pole has this sine; of all mappings
 * but the octahedral. */
static float stretch_of(float sine)
{
    return 0.5f * PI_F * sine;
}

/* The same at height t of any. */
static float stretch_at(light_mapping_t mapping, float t)
{
    return mapping == LIGHT_OCTAHEDRAL ? 1 : stretch_of(sinf(PI_F * t));
}

/* The direction of a place of the image, and what stretch_at says of it. */
static vec3_t direction_at(light_mapping_t mapping, vec2_t st, float *stretch)
{
    *stretch = 1;
    if (mapping == LIGHT_OCTAHEDRAL) return octahedral_to_sphere(st);
    float theta = PI_F * st.y, phi = TWO_PI_F * st.x, s = sinf(theta), c = cosf(theta);
    *stretch = stretch_of(s);
    return mapping == LIGHT_LATLONG ? vec3(s * cosf(phi), s * sinf(phi), c)
                                    : vec3(s * cosf(phi), c, s * sinf(phi));
}

static vec2_t place_of(light_mapping_t mapping, vec3_t d)
{
    if (mapping == LIGHT_OCTAHEDRAL) return octahedral_to_square(d);
    float up = mapping == LIGHT_LATLONG ? d.z : d.y, across = mapping == LIGHT_LATLONG ? d.y : d.z;
    float phi = atan2f(across, d.x);
    return (vec2_t){(phi < 0 ? phi + TWO_PI_F : phi) * (0.5f * INV_PI_F),
                    atan2f(sqrtf(d.x * d.x + across * across), up) * INV_PI_F};
}

/* Cells a texel's side is cut into, so that steps follow what is interpolated; fewer for large images. */
static uint32_t refinement(const light_map_t *map, uint32_t width, uint32_t height)
{
    if (map->mapping == LIGHT_OCTAHEDRAL && !map->smooth) return 1; /* nothing is interpolated */
    uint32_t cells = 4;
    while (cells > 1 && (uint64_t)width * height * cells * cells > 1 << 22) cells--;
    return cells;
}

/* How much of the noise of drawing from the image may come of cells that are made even. */
static const float uneven = 0.02f;

void light_map_init_values(light_map_t *map, const light_t *light)
{
    *map = (light_map_t){.textures = scene_textures(light->scene),
                         .image = light->record->image - 1,
                         .mapping = (light_mapping_t)light->record->mapping,
                         .rows = WRAP_REPEAT,
                         .smooth = (light->record->flags & LIGHT_SMOOTH) != 0};
    /* No light of pbrt's is this: the zenith of an environment is to show nothing of the ground. */
    if (light->record->kind == LIGHT_INFINITE && map->mapping == LIGHT_LATLONG_Y) map->rows = WRAP_CLAMP;
}

void light_map_init(light_map_t *map, const light_t *light)
{
    light_map_init_values(map, light);
    uint32_t width, height;
    textures_size(map->textures, map->image, &width, &height);
    uint32_t cells = refinement(map, width, height);
    width *= cells;
    height *= cells;
    float *weights = mem_alloc((size_t)width * height * sizeof *weights);
    double sum = 0;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            /* Four points of the cell: interpolation brings the light of its neighbours in. */
            float weight = 0;
            for (int k = 0; k < 4; k++) {
                vec2_t st = {((float)x + (k & 1 ? 0.75f : 0.25f)) / (float)width,
                             ((float)y + (k & 2 ? 0.75f : 0.25f)) / (float)height};
                float luminance = float_max(0, rgb_luminance(value_at(map, st)));
                weight += 0.25f * luminance * stretch_at(map->mapping, st.y);
            }
            weights[(size_t)y * width + x] = weight;
            sum += (double)weight;
        }
    map->mean = sum / ((double)width * height);
    map->distribution = distribution_new(weights, width, height, uneven);
    free(weights);
}

void light_map_free(light_map_t *map)
{
    distribution_destroy(&map->distribution);
}

rgb_t light_map_value(const light_map_t *map, vec3_t d)
{
    return value_at(map, place_of(map->mapping, d));
}

/* A place of the image and its direction; *pdf as in light_map_sample. */
static vec2_t draw_place(const light_map_t *map, vec2_t u, float *pdf, vec3_t *direction)
{
    float stretch;
    vec2_t st = distribution_sample(map->distribution, u, pdf);
    *direction = direction_at(map->mapping, st, &stretch);
    stretch *= 4 * PI_F;
    *pdf = stretch > 0 ? *pdf / stretch : 0;
    return st;
}

vec3_t light_map_sample(const light_map_t *map, vec2_t u, float *pdf)
{
    vec3_t direction;
    draw_place(map, u, pdf, &direction);
    return direction;
}

vec3_t light_map_draw(const light_map_t *map, vec2_t u, float *pdf, rgb_t *value)
{
    vec3_t direction;
    *value = value_at(map, draw_place(map, u, pdf, &direction));
    return direction;
}

static float pdf_at(const light_map_t *map, vec2_t st)
{
    float stretch = 4 * PI_F * stretch_at(map->mapping, st.y);
    return stretch > 0 ? distribution_pdf(map->distribution, st) / stretch : 0;
}

float light_map_pdf(const light_map_t *map, vec3_t d)
{
    return pdf_at(map, place_of(map->mapping, d));
}

rgb_t light_map_look(const light_map_t *map, vec3_t d, float *pdf, vec2_t *numbers)
{
    vec2_t st = place_of(map->mapping, d);
    *numbers = distribution_numbers(map->distribution, st);
    *pdf = pdf_at(map, st);
    return value_at(map, st);
}
