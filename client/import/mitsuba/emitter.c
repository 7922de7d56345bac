/* emitter: see emitter.h. */
#include "client/import/mitsuba/emitter.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "client/import/mitsuba/daylight_emitter.h"
#include "client/import/scene/scene_images.h"

static const double radians = 3.14159265358979323846 / 180;

/* An emitter while it is made. */
typedef struct {
    mitsuba_t *m;
    element_t *element;
    affine_t world_from_light;
    blob_light_t light;
} work_t;

static result_t read_colour(work_t *w, const char *name)
{
    rgb_t colour = {1, 1, 1};
    TRY(property_colour(w->m, w->element, name, &colour));
    w->light.radiance = blob_colour_value(colour);
    return result_ok();
}

static result_t add(work_t *w, const affine_t *frame)
{
    return scene_add_light(w->m->scene, w->light, frame, w->element->at);
}

/* The light's transform without scale, its z axis kept, and whether it mirrors. */
static result_t take_frame(work_t *w, affine_t *frame)
{
    if (affine_mirrored_frame(&w->world_from_light, frame)) return result_ok();
    return error_at(w->element->at, "the light's transform has no direction, or lies beyond 1e18");
}

static result_t add_point(work_t *w)
{
    double at[3] = {0, 0, 0};
    w->light.kind = LIGHT_POINT;
    TRY(read_colour(w, "intensity"));
    for (int i = 0; i < 3; ++i) at[i] = w->world_from_light.m[i][3];
    TRY(property_point(w->m, w->element, "position", at));
    affine_t frame = affine_translation(at);
    return add(w, &frame);
}

/* Mitsuba's rim falls linearly with the angle; a smooth step of the cosine passes through its middle. */
static result_t add_spot(work_t *w)
{
    double cutoff = 20;
    affine_t frame;
    w->light.kind = LIGHT_SPOT;
    w->light.flags = LIGHT_SMOOTHSTEP;
    TRY(read_colour(w, "intensity"));
    TRY(property_number(w->m, w->element, "cutoffAngle", 0.01, 180, &cutoff));
    double beam = cutoff * 3 / 4;
    TRY(property_number(w->m, w->element, "beamWidth", 0, cutoff, &beam));
    if (beam < cutoff)
        report_warning(w->m->report, w->element->at,
                       "a spot's rim falls as a smooth step here, linearly with the angle in Mitsuba");
    w->light.parameters[0] = fminf((float)cos(cutoff * radians), nextafterf(1, 0));
    w->light.parameters[1] = fmaxf((float)cos(beam * radians), w->light.parameters[0]);
    TRY(take_frame(w, &frame));
    return add(w, &frame);
}

/* The blob's light stands at +z; Mitsuba's shines along it. */
static result_t add_directional(work_t *w)
{
    static const double nowhere[3] = {0, 0, 0};
    double direction[3] = {0, 0, 1}, toward[3] = {0, 0, 0};
    affine_t frame;
    w->light.kind = LIGHT_DISTANT;
    TRY(read_colour(w, "irradiance"));
    TRY(property_point(w->m, w->element, "direction", direction));
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) toward[i] -= w->world_from_light.m[i][k] * direction[k];
    if (!frame_towards(nowhere, toward, NULL, &frame))
        return error_at(w->element->at, "this light has no direction");
    return add(w, &frame);
}

static result_t add_constant(work_t *w)
{
    affine_t frame = affine_identity();
    w->light.kind = LIGHT_INFINITE;
    TRY(read_colour(w, "radiance"));
    return add(w, &frame);
}

static result_t read_image(work_t *w)
{
    const char *file = NULL;
    double gamma = 0;
    const scene_image_t *image = NULL;
    TRY(property_string(w->m, w->element, "filename", &file));
    TRY(property_number(w->m, w->element, "gamma", -1, 100, &gamma));
    property_ignore(w->element, "cache");
    if (!file) return error_at(w->element->at, "an envmap needs a filename");
    char *path = element_path(w->element, file);
    result_t result = scene_image_of_file(w->m->scene, path,
                                          gamma == 0  ? SCENE_GAMMA_OF_FILE
                                          : gamma < 0 ? 0
                                                      : (float)gamma,
                                          SCENE_ALPHA_DROPPED, w->element->at, &image);
    free(path);
    TRY(report_excuse(w->m->report, result, "the light has no image"));
    if (image) w->light.image = image->image;
    return result_ok();
}

/* Mitsuba's columns run from -z towards +x about y, the blob's from +x towards +y about z. */
static result_t add_environment(work_t *w)
{
    static const affine_t turn = {{{0, 1, 0, 0}, {0, 0, 1, 0}, {-1, 0, 0, 0}}};
    double scale = 1;
    affine_t frame;
    w->light.kind = LIGHT_INFINITE;
    w->light.mapping = LIGHT_LATLONG;
    TRY(property_number(w->m, w->element, "scale", 0, 1e30, &scale));
    TRY(read_image(w));
    w->light.radiance = blob_constant((float)scale);
    TRY(take_frame(w, &frame));
    for (int i = 0; i < 3; ++i) frame.m[i][3] = 0;
    frame = affine_multiply(&frame, &turn);
    return add(w, &frame);
}

static result_t add_daylight(work_t *w)
{
    affine_t frame;
    TRY(take_frame(w, &frame));
    for (int i = 0; i < 3; ++i) frame.m[i][3] = 0;
    return daylight_emitter_add(w->m, w->element, &frame);
}

/* A ray becomes a cone of half a degree with the ray's power. Its solid angle is that of the cosine that the
 * renderer has. */
static result_t add_collimated(work_t *w)
{
    affine_t frame;
    rgb_t power = {1, 1, 1};
    w->light.kind = LIGHT_SPOT;
    TRY(property_colour(w->m, w->element, "power", &power));
    float cosine = (float)cos(0.25 * radians);
    w->light.parameters[0] = w->light.parameters[1] = cosine;
    w->light.radiance = blob_colour_value(v_scale(power, 1 / (TWO_PI_F * (1 - cosine))));
    report_warning(w->m->report, w->element->at,
                   "a collimated beam is a ray without width in Mitsuba; here it is a cone of half a degree");
    TRY(take_frame(w, &frame));
    return add(w, &frame);
}

static const struct {
    const char *type;
    result_t (*add)(work_t *w);
} emitters[] = {
    {"point", add_point},       {"spot", add_spot},          {"directional", add_directional},
    {"constant", add_constant}, {"envmap", add_environment}, {"collimated", add_collimated},
    {"sky", add_daylight},      {"sun", add_daylight},       {"sunsky", add_daylight},
};

result_t emitter_add(mitsuba_t *m, element_t *emitter)
{
    work_t w = {.m = m, .element = emitter};
    for (size_t i = 0; i < ARRAY_LENGTH(emitters); ++i) {
        if (strcmp(object_type(emitter), emitters[i].type) != 0) continue;
        TRY(property_transform(m, emitter, "toWorld", &w.world_from_light));
        property_ignore(emitter, "samplingWeight");
        TRY(emitters[i].add(&w));
        return object_finish(m, emitter);
    }
    TRY(report_refuse(m->report, emitter->at,
                      "emitter \"%.40s\" is not supported; the nearest is a white sky",
                      object_type(emitter)));
    return add_constant(&w);
}
