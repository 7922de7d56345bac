/* light_portal: a rectangle through which all light of an infinite light comes, and the sampling of what is
 * seen of the sky through it.
 *
 * Directions are laid out on a square by their angles to the two sides of the portal. There a portal is an
 * upright rectangle from wherever it is seen: a window of a table of the sky's brightness, which is drawn
 * from (Bitterli, Novak and Jarosz 2015, "Portal-Masked Environment Map Sampling"). Only the half of the sky
 * beyond the portal has a place there: the portal is open to one side.
 */
#ifndef LIGHTMILL_LIGHT_PORTAL_H
#define LIGHTMILL_LIGHT_PORTAL_H

#include "worker/render/light/light.h"
#include "worker/render/sampling/window.h"

/* What is seen of the sky through the portal. `integral`: its brightness. */
typedef struct {
    window_t window;
    double integral;
} portal_view_t;

typedef struct {
    vec3_t corner, side_x, side_y;
    vec3_t x, y, z; /* unit: along the sides, and away from the scene */
    float area;
    window_table_t *table; /* brightness times solid angle of the sky beyond */
    portal_view_t all;     /* of that sky, which light is emitted from */
    double flux;           /* through a unit of area, in luminance */
} light_portal_t;

/* Of a light with LIGHT_PORTAL, whose radiance in unit directions of the world `radiance` tells. */
void light_portal_init(light_portal_t *portal, const light_t *light,
                       rgb_t (*radiance)(const light_t *light, vec3_t w));
void light_portal_free(light_portal_t *portal);

/* What a point sees. False when it is nothing. */
bool light_portal_look(const light_portal_t *portal, vec3_t point, portal_view_t *view);

/* Draws a unit direction of the view; *pdf per steradian, 0 when there is none. */
vec3_t light_portal_sample(const light_portal_t *portal, const portal_view_t *view, vec2_t u, float *pdf);
/* The density of light_portal_sample at the unit direction w; 0 outside the view. */
float light_portal_pdf(const light_portal_t *portal, const portal_view_t *view, vec3_t w);

#endif
