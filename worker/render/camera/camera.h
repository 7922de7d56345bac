/* camera: rays for eye subpaths, importance for light subpaths.
 *
 * Importance is normalised over the whole film, and eye rays are drawn in proportion to it (times the cosine
 * at the lens); so one number, the density of eye rays, is both the density in the weights and the value of
 * a splat, and film.h's factor pixels / light paths makes it the pixel's (Veach 1997, section 8.3.2). A lens
 * is sampled uniformly by area; a point of it is drawn anew for each connection.
 *
 * A lens of elements (CAMERA_REALISTIC) is another thing. Its eye rays have weights, and no point of the
 * scene can be joined to the film, since the way through the lens must be found: nothing projects, and the
 * rays say that they are not joinable, so that weights know of no such strategy.
 */
#ifndef LIGHTMILL_CAMERA_H
#define LIGHTMILL_CAMERA_H

#include "common/scene/scene_blob.h"

typedef struct camera camera_t;

typedef struct {
    vec3_t origin, direction;
    float pdf;     /* per steradian over the whole film; of parallel rays per area across them */
    bool parallel; /* orthographic */
    bool joinable; /* points of the scene can be joined to the camera */
    float weight;  /* factor on what the ray sees; 0: it is lost in the lens */
} camera_ray_t;

/* A point as the camera sees it. */
typedef struct {
    vec2_t raster;   /* where it is on the film, in pixels, x right, y down */
    vec3_t position; /* the point of the lens it is joined to */
    vec3_t w;        /* unit direction from the point to there */
    bool parallel;   /* as of rays */
    float density;   /* of eye rays at the point, per area across them, over the whole film */
} camera_view_t;

/* Of a film of width x height pixels. Owned by the caller, who frees it with free(); the blob outlives it. */
camera_t *camera_new(const scene_blob_t *blob, int width, int height);
bool camera_moves(const camera_t *camera);
/* False when the `lens` numbers below do not matter. */
bool camera_has_lens(const camera_t *camera);
/* The ray through a film position in pixels; `lens` are two uniform numbers, `time` is from 0 to 1. */
void camera_ray(const camera_t *camera, vec2_t raster, vec2_t lens, float time, camera_ray_t *ray);
/* The film positions that show the same as `raster`, less than `margin` pixels off the film: itself, and for
 * cameras that look everywhere those beyond an edge at which the film joins on to itself. Returns how many.
 */
enum { CAMERA_IMAGES = 11 };
int camera_images(const camera_t *camera, vec2_t raster, float margin, vec2_t images[CAMERA_IMAGES]);
/* Joins a point to the lens. False when it is behind the camera or has no camera_images. */
bool camera_project(const camera_t *camera, vec3_t p, vec2_t lens, float time, float margin,
                    camera_view_t *view);

#endif
