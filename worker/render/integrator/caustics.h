/* caustics: where eye subpaths should look for lights that lie behind glass, water and mirrors.
 *
 * What is seen through glass and lit through glass, as the bottom of a pool, no connection finds: an eye
 * vertex that was met by way of a specular one has to run into the light by way of specular ones. A light
 * subpath that nothing but these has turned shows where to: it comes the other way. So such light subpaths
 * teach, by what they carry and where from, and eye vertices of that sort send rays of their own there, which
 * go on through specular vertices until they meet a light, or end (bdpt.c). Both the ray that the BSDF draws
 * and these find the same light, and are combined by the balance heuristic (Veach 1997, equation 9.8): with p
 * the density of a direction by the BSDF, g that by the guide and n the number of rays that are expected,
 * each way brings f cos L / (p + n g).
 *
 * Space is cut into regions, by a tree over places that a few first looks have met (caustics_scout_t). Each
 * has a sphere about its centre, as large as lights are far from there, on average. A direction from any
 * point of the region counts as the place where it leaves the sphere, so that all points of a region agree
 * about where a light is, as long as it is about as far as the sphere (Ruppert, Herholz and Lensch 2020,
 * "Robust Fitting of Parallax-Aware Mixtures for Path Guiding", do this for each lobe).
 *
 * How many rays a vertex sends follows from what it is worth (light_guide.h: q = reach g / sqrt(c)).
 */
#ifndef LIGHTMILL_CAUSTICS_H
#define LIGHTMILL_CAUSTICS_H

#include "common/vec.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct caustics caustics_t;

/* Light that came to a place by way of specular vertices. */
typedef struct {
    vec3_t point, w; /* w: where from */
    float nearness;  /* 1 / how far away it started; 0 from the sky */
    float power;     /* over that of all lights */
} caustics_meeting_t;

/* What first looks met. */
typedef struct caustics_scout {
    size_t sights, meetings;
    vec3_t *seen;            /* [sights] eye vertices, met by way of a specular one */
    caustics_meeting_t *met; /* [meetings] */
} caustics_scout_t;

/* Notes such a vertex, or such light; frees what was noted. */
void caustics_scout_sight(caustics_scout_t *scout, vec3_t point);
void caustics_scout_meeting(caustics_scout_t *scout, const caustics_meeting_t *meeting);
void caustics_scout_free(caustics_scout_t *scout);

/* Regions about what was seen, with guides by the light that came; NULL where nothing was, or none came. */
caustics_t *caustics_new(const caustics_scout_t *scout);
/* Frees them and sets *caustics to NULL. */
void caustics_destroy(caustics_t **caustics);
/* The same regions with guides by the lessons of a plan, [LEARNING_PLACES]; `reach` is how many rays a sample
 * is to send that are worth 1. NULL where there are no regions. */
caustics_t *caustics_guided(const caustics_t *base, const double *lessons, double reach);

/* Lessons: those of a region's cells, and two of its own, in units of 2^-bits. They have the last places. */
enum { CAUSTICS_LIGHT_BITS = 10, CAUSTICS_VISIT_BITS = 10, CAUSTICS_HIT_BITS = 8 };
/* How many there are. */
uint32_t caustics_places(const caustics_t *caustics);
enum { CAUSTICS_NOWHERE = UINT32_MAX };
/* The region of a point, or CAUSTICS_NOWHERE. */
uint32_t caustics_region(const caustics_t *caustics, vec3_t point);
/* The place of what light teaches that comes from direction w to the point of the region. */
uint32_t caustics_light_place(const caustics_t *caustics, uint32_t region, vec3_t point, vec3_t w);
/* Those of throughputs of eye subpaths there, and of what rays into lights brought. */
uint32_t caustics_visit_place(const caustics_t *caustics, uint32_t region);
uint32_t caustics_hit_place(const caustics_t *caustics, uint32_t region);

/* How many rays an eye vertex of this throughput is to send; 0 where nothing is known. */
float caustics_rays(const caustics_t *caustics, uint32_t region, float throughput);
/* Draws the direction of one; *pdf per steradian. False when there is none. */
bool caustics_sample(const caustics_t *caustics, uint32_t region, vec3_t point, vec2_t u, vec3_t *w,
                     float *pdf);
/* The density of a direction, per steradian; 0 where nothing is known. */
float caustics_pdf(const caustics_t *caustics, uint32_t region, vec3_t point, vec3_t w);

#endif
