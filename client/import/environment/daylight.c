/* daylight: see daylight.h. */
#include "client/import/environment/daylight.h"

#include <stdlib.h>

#include "client/import/scene/scene_images.h"

static const double pi = 3.14159265358979323846;

static double smooth_step(double t)
{
    t = fmin(fmax(t, 0), 1);
    return t * t * (3 - 2 * t);
}

/* What is shown at angles theta from the zenith and phi from the sun's side. */
static rgb_t radiance_at(const daylight_t *light, double theta, double phi)
{
    double from = theta / light->stretch, share = 1;
    if (from >= pi / 2 && light->below == DAYLIGHT_BLACK) return vec3(0, 0, 0);
    if (light->below == DAYLIGHT_FADING) {
        from = fmin(from, pi / 2 - 1e-6);
        share = smooth_step(2 - 2 * theta / pi);
    }
    double s = sin(from);
    rgb_t seen = sky_radiance(light->sky, (double[3]){s * cos(phi), cos(from), s * sin(phi)});
    return share < 1 ? v_scale(seen, (float)share) : seen;
}

result_t daylight_add_sky(scene_builder_t *scene, const daylight_t *light)
{
    enum { HEIGHT = 256, WIDTH = 2 * HEIGHT };
    vec3_t *pixels = mem_alloc(sizeof *pixels * WIDTH * HEIGHT);
    for (int y = 0; y < HEIGHT; ++y)
        for (int x = 0; x < WIDTH; ++x)
            pixels[y * WIDTH + x] = radiance_at(light, (y + 0.5) * pi / HEIGHT, (x + 0.5) * 2 * pi / WIDTH);
    const blob_light_t record = {.kind = LIGHT_INFINITE,
                                 .radiance = blob_constant((float)light->factor),
                                 .image = scene_float_image(scene, &pixels[0].x, WIDTH, HEIGHT, 3),
                                 .mapping = LIGHT_LATLONG_Y};
    free(pixels);
    return scene_add_light(scene, record, &light->world_from_sky, light->at);
}

enum { SUN_ROWS = 4096 };

/* The solid angle of a disc of radiance 1 at the pole of an image of one column, of which no row from `lit`
 * on is lit, looked up linearly between its rows. */
static double solid_angle(const float *rows, int lit)
{
    enum { STEPS = 256 };
    double sum = 0, width = pi / SUN_ROWS;
    for (int i = 0; i < lit * STEPS; ++i) {
        double at = (i + 0.5) / STEPS, below = floor(at - 0.5), t = at - 0.5 - below;
        double low = (double)rows[below < 0 ? 0 : (int)below], high = (double)rows[(int)below + 1];
        sum += ((1 - t) * low + t * high) * 2 * pi * sin(at * width) * width / STEPS;
    }
    return sum;
}

/* A disc is the pole of an image of one column, so that it takes 16 KiB and is sampled alone. */
static blob_ref_t disc_image(scene_builder_t *scene, double radius, double *angle)
{
    double size = radius / 180 * SUN_ROWS;
    int lit = (int)ceil(size) + 1;
    float *rows = mem_zalloc(SUN_ROWS, sizeof *rows);
    for (int i = 0; i < lit; ++i) rows[i] = (float)fmin(fmax(size - i, 0), 1);
    *angle = solid_angle(rows, lit);
    blob_ref_t image = scene_float_image(scene, rows, 1, SUN_ROWS, 1);
    free(rows);
    return image;
}

result_t daylight_add_sun(scene_builder_t *scene, const daylight_t *light)
{
    double angle = light->sky->sun_angle * light->stretch, x = sin(angle), y = cos(angle), size = 1;
    /* Along the sun lies the image's pole, y; or z, where a distant light stands. */
    const affine_t pole = {{{y, x, 0, 0}, {-x, y, 0, 0}, {0, 0, 1, 0}}};
    const affine_t distant = {{{0, y, x, 0}, {0, -x, y, 0}, {1, 0, 0, 0}}};
    const bool disc = light->sun_radius > 0;
    blob_light_t record = {.kind = disc ? LIGHT_INFINITE : LIGHT_DISTANT};
    if (disc) {
        record.image = disc_image(scene, light->sun_radius, &size);
        record.mapping = LIGHT_LATLONG_Y;
    }
    double scale = light->factor / size;
    record.radiance = blob_colour_value(v_scale(light->sky->sun_irradiance, (float)scale));
    affine_t frame = affine_multiply(&light->world_from_sky, disc ? &pole : &distant);
    return scene_add_light(scene, record, &frame, light->at);
}
