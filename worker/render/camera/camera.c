/* camera: see camera.h.
 *
 * A kind of camera maps film positions to rays in camera space and points back to film positions. The thin
 * lens is at z = 0 and focuses the plane z = focal_distance; its density is that of a pinhole, since the
 * point of the lens is drawn uniformly (Pharr, Jakob and Humphreys, PBR 3rd edition, 16.1.1). So is that of
 * an orthographic camera's (telecentric) lens: a point of it stands for one direction of parallel rays.
 */
#include "worker/render/camera/camera.h"

#include "common/base.h"
#include "common/scene/lens_trace.h"
#include "worker/render/sampling/octahedral.h"
#include "worker/render/sampling/warp.h"
#include "worker/render/scene/motion.h"

#include <stdlib.h>

/* A film position and what belongs to it, in camera space. */
typedef struct {
    vec3_t origin, direction; /* not of unit length yet */
    float pdf;
    float weight; /* 1 unless set */
} film_ray_t;

/* Film coordinates that show the same as (x, y): (sx x + tx, sy y + ty). */
typedef struct {
    float sx, tx, sy, ty;
} film_wrap_t;

typedef struct {
    bool parallel, joinable;
    /* Of a film whose edges meet one another, where it shows the same again beyond them. */
    const film_wrap_t *wraps;
    int wrap_count;
    void (*ray)(const camera_t *camera, vec2_t film, vec3_t lens, film_ray_t *ray);
    /* *film and the density at q per area across the ray from the lens (camera space), distance2 away in the
     * world; false where the camera cannot see. */
    bool (*project)(const camera_t *camera, vec3_t q, vec3_t *lens, vec2_t *film, float *pdf);
} camera_ops_t;

/* Where the camera is at a time. */
typedef struct {
    xform_t world_from_camera, camera_from_world;
    float stretch; /* |determinant| of world_from_camera */
} camera_place_t;

struct camera {
    const camera_ops_t *ops;
    motion_t motion;
    camera_place_t still; /* at time 0 */
    float lens_radius, focal_distance;
    lens_t lens; /* of elements; count 0: none */
    const blob_pupil_t *pupils;
    float exposure;      /* blob_scene_t.lens_exposure */
    float film_radius;   /* half the diagonal of the whole film */
    float window[4];     /* what the film shows: x min, x max, y min, y max; y upwards */
    float width, height; /* pixels */
    float area;          /* of the window, in the units of the kind */
};

/* ---- perspective --------------------------------------------------------------------------------------- */

/* Window: on the plane z = 1. Density per steradian, uniform over the window: 1 / (area cos^3). */
static float perspective_pdf(const camera_t *camera, vec3_t direction)
{
    float cos = direction.z / v_length(direction);
    return 1 / (camera->area * cos * cos * cos);
}

static void perspective_ray(const camera_t *camera, vec2_t film, vec3_t lens, film_ray_t *ray)
{
    vec3_t through = vec3(film.x, film.y, 1);
    ray->origin = lens;
    ray->direction =
        camera->lens_radius > 0 ? v_sub(v_scale(through, camera->focal_distance), lens) : through;
    ray->pdf = perspective_pdf(camera, ray->direction);
}

static bool perspective_project(const camera_t *camera, vec3_t q, vec3_t *lens, vec2_t *film, float *pdf)
{
    vec3_t d = v_sub(q, *lens);
    if (!(d.z > 0)) return false;
    vec3_t focus = camera->lens_radius > 0
                       ? v_scale(v_mad(*lens, camera->focal_distance / d.z, d), 1 / camera->focal_distance)
                       : v_scale(d, 1 / d.z);
    *film = (vec2_t){focus.x, focus.y};
    *pdf = perspective_pdf(camera, d);
    return true;
}

/* ---- orthographic -------------------------------------------------------------------------------------- */

/* Of the rays through one point of the lens, which is as far from the ray's own axis everywhere. */
static vec3_t orthographic_direction(const camera_t *camera, vec3_t lens)
{
    return camera->lens_radius > 0 ? vec3(-lens.x, -lens.y, camera->focal_distance) : vec3(0, 0, 1);
}

/* Density per area across the rays: the window lies across the axis. */
static float orthographic_pdf(const camera_t *camera, vec3_t direction)
{
    float pdf = 1 / camera->area;
    return camera->lens_radius > 0 ? pdf * v_length(direction) / direction.z : pdf;
}

static void orthographic_ray(const camera_t *camera, vec2_t film, vec3_t lens, film_ray_t *ray)
{
    ray->origin = vec3(film.x + lens.x, film.y + lens.y, 0);
    ray->direction = orthographic_direction(camera, lens);
    ray->pdf = orthographic_pdf(camera, ray->direction);
}

static bool orthographic_project(const camera_t *camera, vec3_t q, vec3_t *lens, vec2_t *film, float *pdf)
{
    vec3_t d = orthographic_direction(camera, *lens), origin = v_mad(q, -q.z / d.z, d);
    *film = (vec2_t){origin.x - lens->x, origin.y - lens->y};
    *lens = vec3(origin.x, origin.y, 0);
    *pdf = orthographic_pdf(camera, d);
    return q.z > 0;
}

/* ---- spherical ----------------------------------------------------------------------------------------- */

/* Window: fractions of the whole sphere's film, y from the top. A wide pixel filter looks over the edges: to
 * the left of the film is its right side, above its top the half turned about. */
static const film_wrap_t spherical_wraps[] = {
    {1, -1, 1, 0},    {1, 1, 1, 0},      {1, -1.5f, -1, 0}, {1, -0.5f, -1, 0}, {1, 0.5f, -1, 0},
    {1, 1.5f, -1, 0}, {1, -1.5f, -1, 2}, {1, -0.5f, -1, 2}, {1, 0.5f, -1, 2},  {1, 1.5f, -1, 2},
};

/* Beyond the top (theta < 0) the sine is negative and the direction right. */
static void spherical_ray(const camera_t *camera, vec2_t film, vec3_t lens, film_ray_t *ray)
{
    float theta = PI_F * film.y, phi = TWO_PI_F * film.x, sin = sinf(theta);
    ray->origin = lens;
    ray->direction = vec3(sin * cosf(phi), cosf(theta), sin * sinf(phi));
    ray->pdf = 1 / (2 * PI_F * PI_F * float_max(fabsf(sin), 1e-7f) * camera->area);
}

static bool spherical_project(const camera_t *camera, vec3_t q, vec3_t *lens, vec2_t *film, float *pdf)
{
    (void)lens;
    float across = sqrtf(q.x * q.x + q.z * q.z), length = v_length(q);
    if (!(across > 0)) return false;
    float phi = atan2f(q.z, q.x);
    *film = (vec2_t){(phi < 0 ? phi + TWO_PI_F : phi) / TWO_PI_F, atan2f(across, q.y) * INV_PI_F};
    *pdf = 1 / (2 * PI_F * PI_F * float_max(across / length, 1e-7f) * camera->area);
    return true;
}

/* Each edge of the octahedral map meets itself, turned about its middle. */
static const film_wrap_t equal_area_wraps[] = {
    {-1, 0, -1, 1}, {-1, 2, -1, 1}, {-1, 1, -1, 0}, {-1, 1, -1, 2},
    {1, -1, 1, -1}, {1, 1, 1, -1},  {1, -1, 1, 1},  {1, 1, 1, 1},
};

/* The place within the unit square that x, y beyond its left or right edge show. */
static void fold(float *x, float *y)
{
    *x -= 2 * floorf(0.5f * *x);
    if (*x <= 1) return;
    *x = 2 - *x;
    *y = 1 - *y;
}

/* The octahedral map's axes are x, z, y of the camera, as pbrt-v4 has it. */
static void equal_area_ray(const camera_t *camera, vec2_t film, vec3_t lens, film_ray_t *ray)
{
    fold(&film.x, &film.y);
    fold(&film.y, &film.x);
    vec3_t d = octahedral_to_sphere((vec2_t){float_clamp(film.x, 0, 1), float_clamp(film.y, 0, 1)});
    ray->origin = lens;
    ray->direction = vec3(d.x, d.z, d.y);
    ray->pdf = 1 / (4 * PI_F * camera->area);
}

static bool equal_area_project(const camera_t *camera, vec3_t q, vec3_t *lens, vec2_t *film, float *pdf)
{
    (void)lens;
    vec3_t d = v_normalize(q);
    *film = octahedral_to_square(vec3(d.x, d.z, d.y));
    *pdf = 1 / (4 * PI_F * camera->area);
    return true;
}

/* ---- a lens of elements -------------------------------------------------------------------------------- */

/* The box of the pupil for a place so far from the film's middle. */
static const blob_pupil_t *pupil_at(const camera_t *camera, float radius)
{
    int i = (int)float_min(radius / camera->film_radius * LENS_PUPILS, LENS_PUPILS - 1);
    return &camera->pupils[i];
}

/* A place in a pupil's box, turned about the axis as the place on the film is. */
static vec3_t pupil_place(const blob_pupil_t *pupil, vec3_t film, float radius, vec3_t u)
{
    float x = pupil->x_min + (pupil->x_max - pupil->x_min) * u.x,
          y = pupil->y_min + (pupil->y_max - pupil->y_min) * u.y;
    float cos = radius > 0 ? film.x / radius : 1, sin = radius > 0 ? film.y / radius : 0;
    return vec3(cos * x - sin * y, sin * x + cos * y, 0);
}

static vec3_t float_vector(lens_vec_t v)
{
    return vec3((float)v.x, (float)v.y, (float)v.z);
}

/* `u`: two uniform numbers. The image on the film is upside down. The weight is the estimate of Kolb et al.'s
 * equation for what arrives, relative to the exposure; the density that of rays from a small pupil, which
 * only stands in for the true one where somebody wants to compare. */
static void realistic_ray(const camera_t *camera, vec2_t film, vec3_t u, film_ray_t *ray)
{
    vec3_t from = vec3(-film.x, -film.y, 0);
    float radius = v_length(from), rear = (float)lens_rear(&camera->lens);
    const blob_pupil_t *pupil = pupil_at(camera, radius);
    vec3_t way = v_sub(pupil_place(pupil, from, radius, u), from);
    lens_ray_t traced = {{(double)from.x, (double)from.y, 0}, {(double)way.x, (double)way.y, (double)rear}};
    float cos = rear / v_length(vec3(way.x, way.y, rear)), cos2 = cos * cos;
    float area = (pupil->x_max - pupil->x_min) * (pupil->y_max - pupil->y_min);
    float share = area > 0 ? lens_trace_from_film(&camera->lens, &traced) : 0;
    bool open = share > 0;
    ray->origin = open ? float_vector(traced.origin) : from;
    ray->direction = open ? float_vector(traced.direction) : vec3(0, 0, 1);
    ray->pdf = rear * rear / (camera->area * cos2 * cos);
    ray->weight = open ? camera->exposure * cos2 * cos2 * area * share : 0;
}

static bool realistic_project(const camera_t *camera, vec3_t q, vec3_t *lens, vec2_t *film, float *pdf)
{
    (void)camera, (void)q, (void)lens, (void)film, (void)pdf;
    return false;
}

/* ---- all of them --------------------------------------------------------------------------------------- */

static const camera_ops_t kinds[] = {
    [CAMERA_PERSPECTIVE] = {false, true, NULL, 0, perspective_ray, perspective_project},
    [CAMERA_ORTHOGRAPHIC] = {true, true, NULL, 0, orthographic_ray, orthographic_project},
    [CAMERA_SPHERICAL] = {false, true, spherical_wraps, ARRAY_LENGTH(spherical_wraps), spherical_ray,
                          spherical_project},
    [CAMERA_EQUAL_AREA] = {false, true, equal_area_wraps, ARRAY_LENGTH(equal_area_wraps), equal_area_ray,
                           equal_area_project},
    [CAMERA_REALISTIC] = {false, false, NULL, 0, realistic_ray, realistic_project},
};

/* The screen window in the camera's units; for spherical cameras the unit square, y downwards. */
static void whole_window(const camera_t *camera, const blob_scene_t *scene, float window[4])
{
    bool spherical = scene->camera == CAMERA_SPHERICAL || scene->camera == CAMERA_EQUAL_AREA;
    /* The field of view spans the shorter side, which reaches from -1 to 1 in the screen window. */
    float aspect = camera->width / camera->height;
    float x = float_max(aspect, 1), y = float_max(1 / aspect, 1);
    const float square[4] = {0, 1, 1, 0}, automatic[4] = {-x, x, -y, y}, *w = scene->screen_window;
    bool given = w[0] != 0 || w[1] != 0 || w[2] != 0 || w[3] != 0;
    float scale = scene->camera == CAMERA_PERSPECTIVE ? (float)tan((double)scene->fov * M_PI / 360) : 1.0f;
    for (int i = 0; i < 4; i++) window[i] = spherical ? square[i] : scale * (given ? w[i] : automatic[i]);
}

static lens_t lens_of(const scene_blob_t *blob)
{
    lens_t lens = {.elements = blob->lens, .count = (uint32_t)blob->counts[BLOB_SECTION_LENS]};
    if (blob->scene->aperture == 0) return lens;
    const blob_image_t *image = &blob->images[blob->scene->aperture - 1];
    lens.aperture = (const float *)(const void *)(blob->texels + image->first_word);
    lens.aperture_width = image->width;
    lens.aperture_height = image->height;
    return lens;
}

camera_t *camera_new(const scene_blob_t *blob, int width, int height)
{
    const blob_scene_t *scene = blob->scene;
    camera_t *camera = mem_zalloc(1, sizeof *camera);
    camera->ops = &kinds[scene->camera];
    camera->motion = motion_between(&scene->world_from_camera, &scene->world_from_camera_end);
    camera->still.world_from_camera = scene->world_from_camera;
    xform_invert(&scene->world_from_camera, &camera->still.camera_from_world);
    camera->still.stretch = fabsf(xform_determinant(&scene->world_from_camera));
    bool lens = scene->camera == CAMERA_PERSPECTIVE || scene->camera == CAMERA_ORTHOGRAPHIC;
    camera->lens_radius = lens ? scene->lens_radius : 0;
    camera->focal_distance = scene->focal_distance;
    if (scene->camera == CAMERA_REALISTIC) camera->lens = lens_of(blob);
    camera->pupils = blob->pupils;
    camera->exposure = scene->lens_exposure;
    camera->width = (float)width;
    camera->height = (float)height;
    float w[4];
    const float *part = scene->film_window;
    whole_window(camera, scene, w);
    camera->film_radius = 0.5f * hypotf(w[1] - w[0], w[3] - w[2]);
    camera->window[0] = w[0] + (w[1] - w[0]) * part[0];
    camera->window[1] = w[0] + (w[1] - w[0]) * part[1];
    camera->window[2] = w[3] + (w[2] - w[3]) * part[3];
    camera->window[3] = w[3] + (w[2] - w[3]) * part[2];
    camera->area = fabsf((camera->window[1] - camera->window[0]) * (camera->window[3] - camera->window[2]));
    return camera;
}

bool camera_moves(const camera_t *camera)
{
    return camera->motion.moves;
}

bool camera_has_lens(const camera_t *camera)
{
    return camera->lens_radius != 0 || camera->lens.count > 0;
}

/* A camera that stands still has its placement at hand; that of another is made in *moved. */
static const camera_place_t *place_at(const camera_t *camera, float time, camera_place_t *moved)
{
    if (!camera->motion.moves) return &camera->still;
    moved->world_from_camera = motion_at(&camera->motion, time);
    moved->stretch = fabsf(xform_determinant(&moved->world_from_camera));
    if (!xform_invert(&moved->world_from_camera, &moved->camera_from_world))
        moved->camera_from_world = camera->still.camera_from_world;
    return moved;
}

/* A point of a thin lens; of a lens of elements the numbers themselves. */
static vec3_t lens_point(const camera_t *camera, vec2_t lens)
{
    if (camera->lens.count > 0) return vec3(lens.x, lens.y, 0);
    if (camera->lens_radius == 0) return vec3(0, 0, 0);
    vec2_t d = warp_disc(lens);
    return vec3(camera->lens_radius * d.x, camera->lens_radius * d.y, 0);
}

/* The factor from a density in camera space at a direction of any length to that in the world, where the
 * transform stretches. Of parallel rays the density is per area across them. */
static float density_factor(const camera_t *camera, const camera_place_t *at, vec3_t direction)
{
    const xform_t *t = &at->world_from_camera;
    if (camera->ops->parallel && camera->lens_radius == 0) direction = vec3(0, 0, 1); /* to the last bit */
    float length = v_length(xform_vector(t, v_normalize(direction)));
    return (camera->ops->parallel ? length : length * length * length) / at->stretch;
}

static vec2_t film_of_raster(const camera_t *camera, vec2_t raster)
{
    const float *w = camera->window;
    return (vec2_t){w[0] + (w[1] - w[0]) * (raster.x / camera->width),
                    w[3] + (w[2] - w[3]) * (raster.y / camera->height)};
}

static vec2_t raster_of_film(const camera_t *camera, vec2_t film)
{
    const float *w = camera->window;
    return (vec2_t){(film.x - w[0]) / (w[1] - w[0]) * camera->width,
                    (film.y - w[3]) / (w[2] - w[3]) * camera->height};
}

/* On the film or less than `margin` pixels off it. */
static bool is_near_film(const camera_t *camera, vec2_t raster, float margin)
{
    return raster.x >= -margin && raster.x < camera->width + margin && raster.y >= -margin &&
           raster.y < camera->height + margin;
}

int camera_images(const camera_t *camera, vec2_t raster, float margin, vec2_t images[CAMERA_IMAGES])
{
    int count = 0;
    if (is_near_film(camera, raster, margin)) images[count++] = raster;
    if (camera->ops->wrap_count == 0) return count;
    vec2_t film = film_of_raster(camera, raster);
    for (int i = 0; i < camera->ops->wrap_count; i++) {
        const film_wrap_t *wrap = &camera->ops->wraps[i];
        vec2_t image =
            raster_of_film(camera, (vec2_t){wrap->sx * film.x + wrap->tx, wrap->sy * film.y + wrap->ty});
        if (is_near_film(camera, image, margin)) images[count++] = image;
    }
    return count;
}

void camera_ray(const camera_t *camera, vec2_t raster, vec2_t lens, float time, camera_ray_t *ray)
{
    film_ray_t local = {.weight = 1};
    camera_place_t moved;
    const camera_place_t *at = place_at(camera, time, &moved);
    camera->ops->ray(camera, film_of_raster(camera, raster), lens_point(camera, lens), &local);
    ray->origin = xform_point(&at->world_from_camera, local.origin);
    ray->direction = v_normalize(xform_vector(&at->world_from_camera, local.direction));
    ray->pdf = local.pdf * density_factor(camera, at, local.direction);
    ray->parallel = camera->ops->parallel;
    ray->joinable = camera->ops->joinable;
    ray->weight = local.weight;
}

bool camera_project(const camera_t *camera, vec3_t p, vec2_t lens, float time, float margin,
                    camera_view_t *view)
{
    camera_place_t moved;
    const camera_place_t *at = place_at(camera, time, &moved);
    vec2_t film, images[CAMERA_IMAGES];
    vec3_t q = xform_point(&at->camera_from_world, p), from = lens_point(camera, lens);
    if (!camera->ops->project(camera, q, &from, &film, &view->density)) return false;
    view->raster = raster_of_film(camera, film);
    if (camera_images(camera, view->raster, margin, images) == 0) return false;
    view->position = xform_point(&at->world_from_camera, from);
    vec3_t d = v_sub(view->position, p);
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return false;
    view->w = v_scale(d, 1 / sqrtf(distance2));
    view->density *= density_factor(camera, at, v_sub(q, from));
    view->parallel = camera->ops->parallel;
    if (!view->parallel) view->density /= distance2;
    return true;
}
