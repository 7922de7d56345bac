/* environment: see environment.h. */
#include "client/import/environment/environment.h"

#include <string.h>
#include <unistd.h>

#include "client/import/environment/daylight.h"
#include "client/import/files/number.h"
#include "client/import/scene/scene_images.h"

static const double pi = 3.14159265358979323846;
static const position_t option = {.path = "--environment"}; /* for messages */

/* ---- what is asked for --------------------------------------------------------------------------------- */

/* Exactly three numbers with commas between them. */
static bool parse_colour(const char *text, double colour[3])
{
    const char *end = text + strlen(text);
    for (int i = 0; i < 3; ++i) {
        if (i > 0 && *text++ != ',') return false;
        text = number_parse(text, end, &colour[i]);
        if (!text) return false;
    }
    return text == end;
}

static result_t parse_sky(const char *text, environment_t *environment)
{
    const char *end = text + strlen(text);
    environment->kind = ENVIRONMENT_SKY;
    environment->elevation = 40;
    if (*text == '\0') return result_ok();
    if (number_parse(text + 1, end, &environment->elevation) == end && environment->elevation >= 0 &&
        environment->elevation <= 90)
        return result_ok();
    return result_fail(
        RESULT_USAGE,
        "--environment sky:ELEVATION takes the sun's height above the horizon, 0 to 90 degrees, "
        "not '%.100s'",
        text + 1);
}

result_t environment_parse(const char *text, environment_t *environment)
{
    *environment = (environment_t){.kind = ENVIRONMENT_NONE};
    if (!text) return result_ok();
    if (strncmp(text, "sky", 3) == 0 && (text[3] == '\0' || text[3] == ':'))
        return parse_sky(text + 3, environment);
    if (parse_colour(text, environment->colour)) {
        environment->kind = ENVIRONMENT_COLOUR;
        for (int i = 0; i < 3; ++i)
            if (!(environment->colour[i] >= 0 && environment->colour[i] <= 1e20))
                return result_fail(RESULT_USAGE,
                                   "--environment R,G,B takes numbers from 0 to 1e20, not '%.100s'", text);
        return result_ok();
    }
    environment->kind = ENVIRONMENT_IMAGE;
    environment->path = text;
    if (access(text, R_OK) == 0) return result_ok();
    return result_fail(RESULT_INPUT,
                       "--environment: there is no image '%.300s' that can be read; it takes the file of a "
                       "latitude-longitude image, or R,G,B, or sky[:ELEVATION]",
                       text);
}

/* ---- where it stands ----------------------------------------------------------------------------------- */

/* From a space with y up, turned counter-clockwise about it, to the world. */
static affine_t world_from_turned(const import_wishes_t *wishes, double extra)
{
    static const affine_t z_up = {{{1, 0, 0, 0}, {0, 0, -1, 0}, {0, 1, 0, 0}}};
    double angle = (fmod(wishes->environment_turn, 360) + extra) * pi / 180, c = cos(angle), s = sin(angle);
    affine_t turn = {{{c, 0, s, 0}, {0, 1, 0, 0}, {-s, 0, c, 0}}};
    bool z = wishes->environment_up && strcmp(wishes->environment_up, "z") == 0;
    return z ? affine_multiply(&z_up, &turn) : turn;
}

static result_t add_image_light(scene_builder_t *scene, blob_ref_t image, const import_wishes_t *wishes,
                                double extra)
{
    blob_light_t light = {.kind = LIGHT_INFINITE,
                          .radiance = blob_constant((float)wishes->environment_factor),
                          .image = image,
                          .mapping = LIGHT_LATLONG_Y};
    affine_t frame = world_from_turned(wishes, extra);
    return scene_add_light(scene, light, &frame, option);
}

/* ---- the kinds ----------------------------------------------------------------------------------------- */

/* The first column of the image's left half would lie in +x: half a turn brings its centre there. */
static result_t add_image(scene_builder_t *scene, const char *path, const import_wishes_t *wishes)
{
    const scene_image_t *image;
    TRY(scene_image_of_file(scene, path, SCENE_GAMMA_OF_FILE, SCENE_ALPHA_DROPPED, option, &image));
    blob_image_t record = scene_image_record(scene, image->image);
    if (record.width != 2 * record.height)
        report_warning(scene->report, option,
                       "%s has %u x %u pixels; a latitude-longitude image is twice as wide as high: it is "
                       "stretched over all directions",
                       path, record.width, record.height);
    return add_image_light(scene, image->image, wishes, 180);
}

static result_t add_colour(scene_builder_t *scene, const double colour[3], double factor)
{
    affine_t frame = affine_identity();
    rgb_t radiance =
        vec3((float)(colour[0] * factor), (float)(colour[1] * factor), (float)(colour[2] * factor));
    blob_light_t light = {.kind = LIGHT_INFINITE, .radiance = blob_colour_value(radiance)};
    return scene_add_light(scene, light, &frame, option);
}

static result_t add_sky(scene_builder_t *scene, double elevation, const import_wishes_t *wishes)
{
    sky_t sky;
    sky_init(&sky, elevation, SKY_TURBIDITY);
    const daylight_t light = {.sky = &sky,
                              .world_from_sky = world_from_turned(wishes, 0),
                              .factor = wishes->environment_factor,
                              .stretch = 1,
                              .below = DAYLIGHT_GROUND,
                              .sun_radius = SKY_SUN_RADIUS,
                              .at = option};
    TRY(daylight_add_sky(scene, &light));
    return daylight_add_sun(scene, &light);
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

/* Lights keep their numbers, so those that are replaced stay, as black ones without an image. */
static void darken_others(scene_builder_t *scene)
{
    blob_light_t *lights = blob_builder_records(scene->blob, BLOB_SECTION_LIGHTS);
    uint32_t count = blob_builder_count(scene->blob, BLOB_SECTION_LIGHTS), replaced = 0;
    for (uint32_t i = 0; i < count; ++i) {
        if (lights[i].kind != LIGHT_INFINITE || v_is_zero(lights[i].radiance.factor)) continue;
        lights[i].radiance = blob_constant(0);
        lights[i].image = 0;
        ++replaced;
    }
    if (replaced > 0)
        report_warning(scene->report, option, "takes the place of the scene's own environment (%u lights)",
                       replaced);
}

result_t environment_add(scene_builder_t *scene, const environment_t *environment,
                         const import_wishes_t *wishes)
{
    if (environment->kind == ENVIRONMENT_NONE) return result_ok();
    darken_others(scene);
    if (environment->kind == ENVIRONMENT_IMAGE) return add_image(scene, environment->path, wishes);
    if (environment->kind == ENVIRONMENT_SKY) return add_sky(scene, environment->elevation, wishes);
    return add_colour(scene, environment->colour, wishes->environment_factor);
}
