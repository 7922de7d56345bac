/* camera: the pinhole camera: rays for eye subpaths, importance for light subpaths.
 *
 * Importance We is normalised over the whole film: its integral over directions (times the cosine at the
 * film) is one, so a splat is an estimate for the whole image and film.h's factor pixels / light paths gives
 * the pixel's (Veach 1997, section 8.3.2; the pinhole's density as in Pharr, Jakob and Humphreys, PBR 3rd
 * edition, 16.1.1).
 */
#ifndef LIGHTMILL_RENDER_CAMERA_H
#define LIGHTMILL_RENDER_CAMERA_H

#include "common/scene_blob.h"

typedef struct {
    vec3_t position;
    vec3_t right, up, forward; /* camera axes in the world, as the transform gives them */
    xform_t camera_from_world;
    float window[4];     /* film rectangle on the plane z = 1: x min, x max, y min, y max */
    float width, height; /* pixels */
    float area;          /* of the rectangle */
} camera_t;

/* What a light subpath needs to know of a point seen by the camera. */
typedef struct {
    vec2_t raster; /* where it is on the film, in pixels, x right, y down */
    vec3_t w;      /* unit direction from the point to the camera */
    float distance;
    float pdf;    /* of the camera sending a ray that way, per steradian, over the whole film */
    float we_cos; /* importance times cosine at the camera; equals pdf for a pinhole */
} camera_view_t;

void camera_init(camera_t *camera, const blob_scene_t *scene, int width, int height);
/* The unit direction of the ray through a film position in pixels; *pdf as in camera_view_t. */
vec3_t camera_ray(const camera_t *camera, vec2_t raster, float *pdf);
/* Projects a point. False when it is behind the camera or more than `margin` pixels off the film. */
bool camera_project(const camera_t *camera, vec3_t p, float margin, camera_view_t *view);

#endif
