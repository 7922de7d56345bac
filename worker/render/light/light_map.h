/* light_map: an image laid over all directions of a light: look-up, and importance sampling in proportion to
 * luminance and solid angle. */
#ifndef LIGHTMILL_LIGHT_MAP_H
#define LIGHTMILL_LIGHT_MAP_H

#include "worker/render/light/light.h"
#include "worker/render/sampling/distribution.h"

typedef struct {
    const textures_t *textures;
    uint32_t image;
    light_mapping_t mapping;
    wrap_t rows;                  /* what is looked up beyond the first and the last */
    bool smooth;                  /* an octahedral one is interpolated */
    distribution_t *distribution; /* over (s, t) */
    double mean;                  /* luminance over all directions */
} light_map_t;

/* Of the light's image; a projection's is not laid over directions, only its mean is of use. */
void light_map_init(light_map_t *map, const light_t *light);
/* The same for looking up alone: light_map_value. */
void light_map_init_values(light_map_t *map, const light_t *light);
void light_map_free(light_map_t *map);

/* The image in the unit direction d of light space. */
rgb_t light_map_value(const light_map_t *map, vec3_t d);
/* Draws a direction; *pdf per steradian, 0 when the image is black. */
vec3_t light_map_sample(const light_map_t *map, vec2_t u, float *pdf);
/* The same, and the image in that direction. */
vec3_t light_map_draw(const light_map_t *map, vec2_t u, float *pdf, rgb_t *value);
/* The density of light_map_sample at d. */
float light_map_pdf(const light_map_t *map, vec3_t d);
/* Value and density at once, and the numbers that light_map_sample takes there. */
rgb_t light_map_look(const light_map_t *map, vec3_t d, float *pdf, vec2_t *numbers);

#endif
