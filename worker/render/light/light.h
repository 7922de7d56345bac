/* light: the emitters of a scene, chosen in proportion to their power. Where an eye subpath first
 * scatters, each of a few lights is asked.
 *
 * Three questions are asked of the lights, one for each way in which a path can end on one:
 *   s >= 2, lights_emit: draw the start of a light subpath;
 *   s = 1,  lights_illuminate: draw a place on a light and join it to a given point;
 *   s = 0,  lights_hit, lights_escape: what about this place that an eye subpath ran into?
 * A place is a point of a surface (measured by area), a direction of the sky (by solid angle), or the one
 * place of a light that has no extent (counted, not measured: `delta`). A surface may be `delta`, too, when
 * it lets all rays through: then places on it are measured by area, but no eye subpath runs into one.
 *
 * An alias table makes the choice O(1), by power. Where there are many lights, s = 1 chooses by what is near,
 * too (light_tree.h). The light then draws a place: an emissive mesh uniformly by area, so that the density
 * per area at a point depends on its light alone.
 *
 * Most of what one sees is lit directly, and the first vertex of an eye subpath that scatters by more than
 * mirrors and clear glass is where that shows. For it lights_illuminate_first draws several places, on each
 * light where they are few. So they are denser there (`density`), and weights must know it.
 *
 * A new kind of light is one file light_*.c and one entry in LIGHT_KINDS below.
 */
#ifndef LIGHTMILL_LIGHT_H
#define LIGHTMILL_LIGHT_H

#include "worker/render/light/light_guide.h"
#include "worker/render/light/light_tree.h"
#include "worker/render/scene/scene.h"

typedef struct lights lights_t;

/* Tables for the lights of a scene, which must outlive them. A scene without (bright) lights gives empty
 * tables. */
lights_t *lights_new(const scene_t *scene);
/* Frees the tables and sets *lights to NULL. */
void lights_destroy(lights_t **lights);
/* Gives the lights places for lessons (light_guide.h), at most `room`; those that have no room have no guide.
 */
void lights_learn(lights_t *lights, uint32_t room);
/* The same lights with guides by the lessons of so many samples; `left` as for light_guide_new. Light
 * subpaths start on a light, and from there, as it is worth; *share: how many a sample is to have, from
 * `least` to 1, which densities of starts take account of. It stands on `lights`, which must outlive it. */
lights_t *lights_guided(const lights_t *lights, const double *lessons, double samples, double reach,
                        double left, double least, float *share);
/* True when there is nothing to sample. */
bool lights_empty(const lights_t *lights);
/* About what a light subpath carries at its start without guides. */
float lights_flux(const lights_t *lights);

/* The start of a light subpath. */
typedef struct {
    uint32_t light;           /* its number; here and below */
    vec3_t origin, direction; /* the ray, off the light already */
    vec3_t point;             /* the place; at infinity meaningless */
    rgb_t throughput;         /* emitted radiance times cosine, over all densities */
    float pdf_place;          /* of the place, the choice of the emitter included */
    float pdf_ray;       /* of the direction, per steradian; at infinity of the ray, per area across it */
    float cosine;        /* at the place between normal and direction; 1 where there is no normal */
    blob_ref_t medium;   /* that the ray starts in */
    float view_ratio;    /* density with which lights_illuminate draws the place, over pdf_place; but for what
                            lights_nearness says */
    light_start_t start; /* of the light's cells */
    uint32_t lessons[2]; /* the places of its lessons; not where its density is 0 */
    float gate;          /* how far along the ray the light's portal is; 0 without one. See lights_enter */
    bool at_infinity;
    bool delta; /* eye subpaths cannot run into the place */
} light_ray_t;

/* A place on a light as a given point sees it. */
typedef struct {
    uint32_t light;
    vec3_t w;                    /* unit direction from the point to the place */
    blob_ref_t medium;           /* that it shines into there */
    vec3_t target;               /* where the segment to it ends, off the light already */
    rgb_t radiance;              /* towards the point; of a point light the intensity */
    float pdf_place, view_ratio; /* as in light_ray_t, for the point; */
    float nearness;              /* lights_nearness is in view_ratio */
    float density;  /* of all places that are drawn for the point: how many of them to expect, per measure */
    float geometry; /* from solid angle at the point to the measure of places: cos / d^2 on a surface, 1 / d^2
                       of a point, 1 at infinity */
    float arrival;  /* density, per area across it, of the rays that lights_emit sends this way to the point,
                       given the place */
    float plain_arrival; /* what `arrival` would be without a guide */
    bool at_infinity, delta;
} light_view_t;

/* A place that an eye subpath ran into. */
typedef struct {
    uint32_t light;
    rgb_t radiance;            /* towards where the subpath came from */
    float pdf_place;           /* with which the other two would have drawn it */
    float pdf_ray, view_ratio; /* as in light_ray_t */
    light_start_t start;       /* of the light subpath that would have come this way; density 0: not known */
    uint32_t lesson;           /* the place of what the hit teaches; not where that density is 0 */
} light_hit_t;

/* Draws a light subpath; false when nothing comes of it. */
bool lights_emit(const lights_t *lights, float choice, vec2_t place, vec2_t ray, light_ray_t *out);
/* Draws a place that may light the point; false when it does not. */
bool lights_illuminate(const lights_t *lights, vec3_t point, float choice, vec2_t place, light_view_t *out);
/* How many places the first such vertex is joined to, at most LIGHTS_FIRST_MOST. */
enum { LIGHTS_FIRST_MOST = 8 };
uint32_t lights_first_count(const lights_t *lights);
/* Which pair of random numbers is to draw the k-th of them, from 0 to LIGHTS_FIRST_MOST - 1. Those that share
 * one are kept apart: their numbers are shifted. */
uint32_t lights_first_pair(const lights_t *lights, uint32_t k);
/* Draws the k-th of them, as lights_illuminate. `choice` is to be the same for each k. */
bool lights_illuminate_first(const lights_t *lights, uint32_t k, vec3_t point, float choice, vec2_t place,
                             light_view_t *out);
/* How often they draw a place on this light for once of lights_illuminate. */
float lights_first_times(const lights_t *lights, uint32_t light);
/* How much more often than elsewhere lights_illuminate draws places on this light for this point, since it is
 * near or far: a factor on view_ratio of its places. */
float lights_nearness(const lights_t *lights, uint32_t light, vec3_t point);
/* The light surface->light seen from a point, to which wo is the unit direction; false when it is dark. */
bool lights_hit(const lights_t *lights, vec3_t point, const surface_t *surface, vec3_t wo, light_hit_t *out);
/* How many lights fill the sky. */
uint32_t lights_sky_count(const lights_t *lights);
/* The k-th of them as seen from a point in the unit direction w; false when it is dark there. */
bool lights_escape(const lights_t *lights, uint32_t k, vec3_t point, vec3_t w, light_hit_t *out);
/* What became of a ray that lights_emit sent through a portal, at a point on its way. From behind the portal
 * the same direction would have been drawn with another density, since of the sky only what is seen through
 * the portal is: the product of pdf_place and pdf_ray stays, but pdf_ray is to be multiplied by what is
 * returned, and pdf_place divided by it. 0 when the portal shows nothing to the point; so it is before it. */
float lights_enter(const lights_t *lights, uint32_t light, vec3_t point);

/* ---- for kinds of light -------------------------------------------------------------------------------- */

/* A light in place. `state` is what its kind prepared. */
typedef struct {
    const scene_t *scene;
    const blob_light_t *record;
    blob_ref_t medium; /* that it shines into, where no interface says so: the record's, or what was found */
    void *state;
    vec3_t centre; /* of a sphere and of an upright box about the scene */
    float radius;
    vec3_t half_sides; /* of the box, a little larger than the scene */
    float chance;      /* of being chosen by lights_emit */
    float view_ratio;  /* that by lights_illuminate over it */
    float first_times; /* lights_first_times */
    guide_kind_t guide_kind;
    uint32_t guide_side; /* cells a side */
    uint32_t first_lesson;
    light_guide_t *guide; /* NULL: none */
} light_t;

typedef struct {
    /* Prepares what the light needs; NULL when it needs nothing. */
    void *(*prepare)(const light_t *light);
    void (*release)(void *state);
    /* Its flux, in any unit that all kinds share (luminance x area x steradians). */
    double (*power)(const light_t *light);
    /* A box about it; NULL for lights that are everywhere. */
    void (*box)(const light_t *light, vec3_t *low, vec3_t *high);
    /* As lights_emit and lights_illuminate, with chance taken account of; `choice` is a number that is free
     * again. */
    bool (*emit)(const light_t *light, float choice, vec2_t place, vec2_t ray, light_ray_t *out);
    bool (*illuminate)(const light_t *light, float choice, vec3_t point, vec2_t place, light_view_t *out);
    /* As lights_escape; NULL for lights that are not of the sky. */
    bool (*escape)(const light_t *light, vec3_t point, vec3_t w, light_hit_t *out);
    /* As lights_enter; NULL for lights that have no portals. */
    float (*enter)(const light_t *light, vec3_t point);
    guide_kind_t guide; /* what its guide cuts, but of skies behind portals, which have none */
} light_ops_t;

/* Every kind of light, by its name in the blob: the one place that a new one is entered. */
#define LIGHT_KINDS(ENTRY)                                                                                   \
    ENTRY(LIGHT_AREA, light_area)                                                                            \
    ENTRY(LIGHT_POINT, light_point)                                                                          \
    ENTRY(LIGHT_SPOT, light_spot)                                                                            \
    ENTRY(LIGHT_GONIOMETRIC, light_goniometric)                                                              \
    ENTRY(LIGHT_PROJECTION, light_projection)                                                                \
    ENTRY(LIGHT_DISTANT, light_distant)                                                                      \
    ENTRY(LIGHT_INFINITE, light_infinite)
#define LIGHT_DECLARE(kind, ops) extern const light_ops_t ops;
LIGHT_KINDS(LIGHT_DECLARE)
#undef LIGHT_DECLARE

/* An area light that a path ran into: as lights_hit. */
bool light_area_hit(const light_t *light, const surface_t *surface, vec3_t wo, light_hit_t *out);

#endif
