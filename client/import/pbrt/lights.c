/* lights: AreaLightSource, LightSource, and the tables of either.
 *
 * v3 gives a colour times a "scale" that is a colour, too; v4 a colour, a number "scale", and for most lights
 * the "power" or "illuminance" that the whole is to have, in which the colour counts as if its luminance
 * were 1. Both place their lights with the current transform. */
#include <stdlib.h>
#include <string.h>

#include "client/import/pbrt/lights.h"
#include "client/import/pbrt/materials/media.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/colour_spaces.h"
#include "client/import/pbrt/state/images.h"
#include "client/import/pbrt/state/values.h"

static const double pi = 3.14159265358979323846;
static const unsigned point_types = PARAM_BIT(PARAM_POINT3) | PARAM_BIT(PARAM_VECTOR3);

/* ---- values ------------------------------------------------------------------------------------------- */

/* "scale": of v3 a colour, of v4 a number. */
static result_t read_scale(pbrt_t *p, params_t *params, blob_value_t *value)
{
    rgb_t scale = vec3(1, 1, 1);
    double factor = 1;
    if (p->dialect.dialect == DIALECT_V3) {
        TRY(pbrt_colour(p, params, "scale", COLOUR_LIGHT, &scale));
    } else {
        TRY(params_float_in(params, "scale", 0, 1e30, &factor));
        scale = vec3((float)factor, (float)factor, (float)factor);
    }
    value->factor = v_mul(value->factor, scale);
    if (scale.x != scale.y || scale.y != scale.z) value->spectrum = 0; /* it is another one */
    return result_ok();
}

/* A colour of that name times the scale. It is white by default; in v4 the white of the colour space, but not
 * where an image has colours of its own. */
static result_t read_emission(pbrt_t *p, params_t *params, const char *name, bool coloured,
                              blob_value_t *value)
{
    bool white = coloured || p->dialect.dialect == DIALECT_V3;
    *value = blob_constant(1);
    if (!white) value->factor = pbrt_srgb(p, value->factor, true);
    TRY(pbrt_constant_colour(p, params, name, COLOUR_LIGHT, value));
    return read_scale(p, params, value);
}

/* v4's "power" or "illuminance": the light is scaled from what it has, `total` at luminance 1, to that. */
static result_t scale_to(pbrt_t *p, params_t *params, const char *name, double total, rgb_t *colour)
{
    double wanted = -1;
    if (p->dialect.dialect == DIALECT_V3) return result_ok();
    TRY(params_float_in(params, name, -1e30, 1e30, &wanted));
    if (!(wanted > 0)) return result_ok();
    position_t at = params_where(params, name, (position_t){0});
    if (!(total > 0)) return error_at(at, "parameter \"%s\": this light is black", name);
    *colour = v_scale(*colour, (float)(wanted / total));
    return result_ok();
}

/* ---- transforms --------------------------------------------------------------------------------------- */

/* The current transform, once a light that moves has been warned about. */
static affine_t light_transform(pbrt_t *p, position_t at)
{
    affine_t open, close;
    if (pbrt_motion(p, at, &open, &close))
        report_warning(p->report, at,
                       "lights do not move: this one stands where it is when the shutter opens");
    return open;
}

/* Without its scale, which means nothing to directions. */
static affine_t without_scale(pbrt_t *p, affine_t t, position_t at)
{
    bool uniform;
    double scale = affine_scale(&t, &uniform);
    if (!uniform)
        report_warning(p->report, at, "the transform stretches this light, and so its pattern of directions");
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) t.m[i][j] /= scale;
    return t;
}

/* A frame whose +z is the direction of v, at the given place; false when v has no direction. */
static bool frame_along(const double v[3], const double place[3], affine_t *frame)
{
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), z[3], x[3], y[3];
    if (!(length > 0) || !isfinite(length)) return false;
    for (int i = 0; i < 3; ++i) z[i] = v[i] / length;
    int least = fabs(z[1]) < fabs(z[0]) ? 1 : 0;
    if (fabs(z[2]) < fabs(z[least])) least = 2;
    double across = 1 / sqrt(1 - z[least] * z[least]);
    for (int i = 0; i < 3; ++i) x[i] = ((i == least ? 1 : 0) - z[least] * z[i]) * across;
    for (int i = 0; i < 3; ++i) y[i] = z[(i + 1) % 3] * x[(i + 2) % 3] - z[(i + 2) % 3] * x[(i + 1) % 3];
    for (int i = 0; i < 3; ++i) {
        frame->m[i][0] = x[i];
        frame->m[i][1] = y[i];
        frame->m[i][2] = z[i];
        frame->m[i][3] = place[i];
    }
    return true;
}

static void transform_point(const affine_t *t, const double p[3], double out[3])
{
    for (int i = 0; i < 3; ++i)
        out[i] = t->m[i][0] * p[0] + t->m[i][1] * p[1] + t->m[i][2] * p[2] + t->m[i][3];
}

/* ---- images ------------------------------------------------------------------------------------------- */

/* v3 takes the numbers of a file as they are; v4 decodes those of 8-bit files. *image is 0 when none is
 * named. */
static result_t read_image(pbrt_t *p, params_t *params, position_t at, image_use_t use, blob_ref_t *image)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    const char *name = v3 ? "mapname" : "filename", *filename = "";
    *image = 0;
    TRY(params_string(params, name, &filename));
    if (filename[0] == '\0') return result_ok();
    at = params_where(params, name, at);
    char *path = pbrt_resolve(p, filename);
    bool missing = pbrt_is_missing(path);
    result_t slip = missing ? pbrt_missing(p, at, path, "the light has no image") : result_ok();
    free(path);
    if (missing) return slip;
    const scene_image_t *read;
    TRY(pbrt_image(p, filename, v3 ? 1.0f : SCENE_GAMMA_OF_FILE, use, at, &read));
    *image = read->image;
    return result_ok();
}

/* An image of pbrt-v4 over all directions must be square; another is taken for v3's kind when lenient. */
static result_t choose_mapping(pbrt_t *p, blob_light_t *light, light_mapping_t v3_mapping, position_t at)
{
    light->mapping = v3_mapping;
    if (p->dialect.dialect == DIALECT_V3) return result_ok();
    blob_image_t image = scene_image_record(p->builder, light->image);
    if (image.width == image.height) {
        light->mapping = LIGHT_OCTAHEDRAL;
        return result_ok();
    }
    return report_refuse(
        p->report, at,
        "the light's image has %u x %u pixels, but pbrt-v4 wants a square one, of the octahedral "
        "equal-area map; it is taken for a latitude-longitude map",
        image.width, image.height);
}

/* ---- area lights -------------------------------------------------------------------------------------- */

typedef struct {
    dialect_entry_t entry;
    result_t (*make)(pbrt_t *p, params_t *params, position_t at, area_light_t *light);
} area_light_entry_t;

static const param_rule_t sample_rules[] = {
    {{"samples", "nsamples"}, PARAM_IGNORE, "every light is sampled as its power asks for"},
};

/* v4's image on the surface, whose rows run down from v = 1: its texture, 0 where there is none. */
static result_t read_surface_image(pbrt_t *p, params_t *params, position_t at, area_light_t *light,
                                   blob_ref_t *made)
{
    blob_ref_t image;
    *made = 0;
    if (p->dialect.dialect == DIALECT_V3) return result_ok();
    TRY(read_image(p, params, at, IMAGE_EMITTED, &image));
    if (!image) return result_ok();
    if (params_has(params, "L"))
        return error_at(params_where(params, "L", at), "a light has either \"L\" or \"filename\", not both");
    blob_texture_t texture = {.kind = TEXTURE_IMAGE,
                              .mapping = MAPPING_UV,
                              .matrix = {{1, 0, 0}, {0, -1, 1}},
                              .texture_from_world = xform_identity(),
                              .image = image,
                              .channel = CHANNEL_RGB,
                              .wrap_s = WRAP_CLAMP,
                              .wrap_t = WRAP_CLAMP,
                              .inputs = {blob_constant(1)}};
    *made = scene_add_texture(p->builder, &texture).texture;
    light->mean = scene_image_mean(p->builder, image, NULL, NULL);
    return result_ok();
}

static result_t make_diffuse(pbrt_t *p, params_t *params, position_t at, area_light_t *light)
{
    bool two_sided = false;
    blob_ref_t texture;
    light->light.kind = LIGHT_AREA;
    light->light.world_from_light = xform_identity();
    TRY(read_surface_image(p, params, at, light, &texture));
    TRY(read_emission(p, params, "L", texture != 0, &light->light.radiance));
    light->light.radiance.texture = texture;
    TRY(params_bool(params, "twosided", &two_sided));
    light->light.flags = two_sided ? LIGHT_TWO_SIDED : 0;
    if (p->dialect.dialect == DIALECT_V3)
        return params_apply(params, sample_rules, ARRAY_LENGTH(sample_rules), p->report);
    TRY(params_float_in(params, "power", -1e30, 1e30, &light->power));
    if (light->power > 0 && !(light->mean > 0))
        return error_at(params_where(params, "power", at), "parameter \"power\": this light is black");
    return result_ok();
}

static const area_light_entry_t area_lights[] = {
    {{"diffuse", DIALECT_BOTH}, make_diffuse},
    {{"area", DIALECT_V3}, make_diffuse},
};

result_t pbrt_area_light(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(PBRT_READ_KIND(p, TARGET_LIGHT, area_lights, "the light's type", "area light", at, &index));
    p->now.emits = index != LEFT_OUT;
    if (index == LEFT_OUT) return result_ok();
    p->now.light = (area_light_t){.mean = 1, .at = at};
    TRY(area_lights[index].make(p, p->params, at, &p->now.light));
    if (!v_is_finite(p->now.light.light.radiance.factor))
        return error_at(at, "this light's radiance is not finite");
    return pbrt_finish_params(p, "AreaLightSource", p->arguments[0]);
}

/* ---- lights at a point -------------------------------------------------------------------------------- */

/* Adds a light that shines into the medium about it. */
static result_t add_in_medium(pbrt_t *p, blob_light_t light, const affine_t *world_from_light, position_t at)
{
    if (light.image != 0) light.radiance.spectrum = 0; /* the image has colours of its own */
    TRY(pbrt_medium_outside(p, &light.medium));
    return scene_add_light(p->builder, light, world_from_light, at);
}

static result_t make_point(pbrt_t *p, params_t *params, position_t at)
{
    double from[3] = {0}, place[3];
    blob_light_t light = {.kind = LIGHT_POINT};
    TRY(read_emission(p, params, "I", false, &light.radiance));
    TRY(params_point(params, "from", point_types, from));
    TRY(scale_to(p, params, "power", 4 * pi, &light.radiance.factor));
    affine_t ctm = light_transform(p, at);
    if (p->dialect.dialect == DIALECT_V3) /* pbrt-v3 moves the light by "from" in the world */
        for (int i = 0; i < 3; ++i) place[i] = ctm.m[i][3] + from[i];
    else
        transform_point(&ctm, from, place);
    affine_t frame = affine_translation(place);
    return add_in_medium(p, light, &frame, at);
}

static result_t make_spot(pbrt_t *p, params_t *params, position_t at)
{
    double from[3] = {0}, to[3] = {0, 0, 1}, angle = 30, rim = 5, place[3], target[3];
    bool uniform;
    blob_light_t light = {.kind = LIGHT_SPOT};
    TRY(read_emission(p, params, "I", false, &light.radiance));
    TRY(params_point(params, "from", point_types, from));
    TRY(params_point(params, "to", point_types, to));
    TRY(params_float_in(params, "coneangle", 1e-3, 180, &angle));
    TRY(params_float_in(params, "conedeltaangle", 0, 1e30, &rim));
    /* A rim wider than the cone comes out on the other side of the axis, as in both pbrts. */
    double outer = cos(angle * (pi / 180)), inner = cos(fabs(angle - rim) * (pi / 180));
    TRY(scale_to(p, params, "power", 2 * pi * ((1 - inner) + (inner - outer) / 2), &light.radiance.factor));
    if (p->dialect.dialect == DIALECT_V4) light.flags = LIGHT_SMOOTHSTEP;
    light.parameters[0] = fmaxf((float)outer, -1);
    light.parameters[1] = fmaxf(fminf((float)inner, 1), light.parameters[0]);
    if (!(light.parameters[0] < 1)) light.parameters[0] = nextafterf(1, 0);
    affine_t ctm = light_transform(p, at), frame;
    affine_scale(&ctm, &uniform);
    if (!uniform) report_warning(p->report, at, "the transform stretches this light; its cone stays round");
    transform_point(&ctm, from, place);
    transform_point(&ctm, to, target);
    for (int i = 0; i < 3; ++i) target[i] -= place[i];
    if (!frame_along(target, place, &frame))
        return error_at(at, "this spot light has no direction: \"from\" and \"to\" are the same");
    return add_in_medium(p, light, &frame, at);
}

/* pbrt-v4 takes the mean of an image's colours, v3 its colours; v4's poles are on y. */
static result_t make_goniometric(pbrt_t *p, params_t *params, position_t at)
{
    static const affine_t swap_yz = {{{1, 0, 0, 0}, {0, 0, 1, 0}, {0, 1, 0, 0}}};
    bool v4 = p->dialect.dialect == DIALECT_V4;
    blob_light_t light = {.kind = LIGHT_GONIOMETRIC};
    double mean = 1;
    TRY(read_emission(p, params, "I", false, &light.radiance));
    TRY(read_image(p, params, at, IMAGE_NUMBERS, &light.image));
    if (light.image) {
        if (v4) light.image = scene_grey_image(p->builder, light.image);
        TRY(choose_mapping(p, &light, LIGHT_LATLONG_Y, at));
        mean = scene_image_mean(p->builder, light.image, NULL, NULL);
    } else {
        light.kind = LIGHT_POINT;
        report_warning(p->report, at, "a goniometric light without an image is a point light");
    }
    TRY(scale_to(p, params, "power", 4 * pi * mean, &light.radiance.factor));
    affine_t t = without_scale(p, light_transform(p, at), at);
    if (light.image && light.mapping == LIGHT_OCTAHEDRAL) t = affine_multiply(&t, &swap_yz);
    return add_in_medium(p, light, &t, at);
}

/* The cube of the cosine between z and the direction to the window's point (s, t). */
static double cosine_cubed(const void *context, double s, double t)
{
    const float *window = context;
    double x = (double)window[0] + s * (double)(window[1] - window[0]);
    double y = (double)window[2] + t * (double)(window[3] - window[2]);
    return pow(1 / sqrt(1 + x * x + y * y), 3);
}

static result_t make_projection(pbrt_t *p, params_t *params, position_t at)
{
    static const double upside_down[3] = {1, -1, 1};
    bool v3 = p->dialect.dialect == DIALECT_V3;
    blob_light_t light = {.kind = LIGHT_PROJECTION,
                          .radiance = blob_constant(1),
                          .mapping = LIGHT_LATLONG}; /* mapping: unused */
    double fov = v3 ? 45 : 90;
    TRY(v3 ? read_emission(p, params, "I", false, &light.radiance) : read_scale(p, params, &light.radiance));
    TRY(params_float_in(params, "fov", 1e-3, 179.9, &fov));
    TRY(read_image(p, params, at, IMAGE_EMITTED, &light.image));
    if (!light.image && !v3) return error_at(at, "a projection light needs its image: \"string filename\"");
    if (!light.image) light.image = scene_white_image(p->builder);
    blob_image_t image = scene_image_record(p->builder, light.image);
    double half = tan(fov * (pi / 360)), aspect = (double)image.width / image.height;
    double x = half * fmax(aspect, 1), y = half * fmax(1 / aspect, 1);
    const float window[4] = {-(float)x, (float)x, -(float)y, (float)y};
    memcpy(light.parameters, window, sizeof window);
    double power = 4 * x * y * scene_image_mean(p->builder, light.image, cosine_cubed, window);
    TRY(scale_to(p, params, "power", power, &light.radiance.factor));
    affine_t t = without_scale(p, light_transform(p, at), at);
    if (v3) { /* whose images hang from the window's lower edge */
        affine_t flip = affine_scaling(upside_down);
        t = affine_multiply(&t, &flip);
    }
    return add_in_medium(p, light, &t, at);
}

/* ---- lights at infinity ------------------------------------------------------------------------------- */

static result_t make_distant(pbrt_t *p, params_t *params, position_t at)
{
    double from[3] = {0}, to[3] = {0, 0, 1}, toward[3];
    const double nowhere[3] = {0};
    blob_light_t light = {.kind = LIGHT_DISTANT};
    TRY(read_emission(p, params, "L", false, &light.radiance));
    TRY(params_point(params, "from", point_types, from));
    TRY(params_point(params, "to", point_types, to));
    TRY(scale_to(p, params, "illuminance", 1, &light.radiance.factor));
    affine_t ctm = light_transform(p, at), frame;
    for (int i = 0; i < 3; ++i)
        toward[i] = ctm.m[i][0] * (from[0] - to[0]) + ctm.m[i][1] * (from[1] - to[1]) +
                    ctm.m[i][2] * (from[2] - to[2]);
    if (!frame_along(toward, nowhere, &frame))
        return error_at(at, "this distant light has no direction: \"from\" and \"to\" are the same");
    return scene_add_light(p->builder, light, &frame, at);
}

/* The cosine above the horizon z = 0 at a point of the octahedral map. pbrt-v4 makes 2 pi of the whole sphere
 * where it is 4 pi, and so an image with an "illuminance" twice as bright; pictures are to agree. */
static double upper_cosine(const void *context, double s, double t)
{
    (void)context;
    double inside = 1 - fabs(2 * s - 1) - fabs(2 * t - 1), r = 1 - inside;
    return inside > 0 ? 1 - r * r : 0;
}

/* The cosine of the angle between the ways from a to b and from c to d. */
static double cosine_between(const double *a, const double *b, const double *c, const double *d)
{
    double product = 0, first = 0, second = 0;
    for (int i = 0; i < 3; ++i) {
        product += (b[i] - a[i]) * (d[i] - c[i]);
        first += (b[i] - a[i]) * (b[i] - a[i]);
        second += (d[i] - c[i]) * (d[i] - c[i]);
    }
    return product / sqrt(first * second);
}

/* As exact as pbrt-v4 wants it. A side without length makes cosines that are no numbers. */
static bool is_rectangle(const double *p)
{
    const double tolerance = 1e-3;
    const double *a = p, *b = p + 3, *c = p + 6, *d = p + 9;
    return fabs(cosine_between(a, b, d, c) - 1) <= tolerance &&
           fabs(cosine_between(b, c, a, d) - 1) <= tolerance &&
           fabs(cosine_between(a, b, b, c)) <= tolerance && fabs(cosine_between(b, c, d, c)) <= tolerance &&
           fabs(cosine_between(d, c, a, d)) <= tolerance && fabs(cosine_between(a, d, a, b)) <= tolerance;
}

/* The sides of a rectangle whose diagonal runs between its first and its third corner, the first side along
 * that to the fourth. */
static void set_portal(const double *p, blob_light_t *light)
{
    double length2 = 0, along = 0, sides[2][3];
    for (int i = 0; i < 3; ++i) {
        length2 += (p[9 + i] - p[i]) * (p[9 + i] - p[i]);
        along += (p[9 + i] - p[i]) * (p[6 + i] - p[i]);
    }
    for (int i = 0; i < 3; ++i) {
        sides[0][i] = (p[9 + i] - p[i]) * (along / length2);
        sides[1][i] = p[6 + i] - p[i] - sides[0][i];
    }
    light->portal[0] = vec3((float)p[0], (float)p[1], (float)p[2]);
    for (int k = 0; k < 2; ++k)
        light->portal[1 + k] = vec3((float)sides[k][0], (float)sides[k][1], (float)sides[k][2]);
    light->flags |= LIGHT_PORTAL;
}

/* v4's "portal": four corners in the world, whatever the current transform is. */
static result_t read_portal(pbrt_t *p, params_t *params, blob_light_t *light)
{
    const double *corners;
    size_t count;
    TRY(params_array(params, "portal", PARAM_BIT(PARAM_POINT3), 3, &corners, &count));
    if (count == 0) return result_ok();
    position_t at = params_where(params, "portal", (position_t){0});
    if (count != 12) return error_at(at, "a portal has 4 corners, this one has %zu", count / 3);
    if (!is_rectangle(corners))
        return report_refuse(p->report, at,
                             "this portal is no rectangle; without it light comes from all directions");
    set_portal(corners, light);
    for (int k = 0; k < 3; ++k) {
        float length = v_length(light->portal[k]);
        if (!(length <= 1e9f) || (k > 0 && !(length >= 1e-9f)))
            return error_at(at, "this portal is too far away, too large or too small");
    }
    return result_ok();
}

static result_t make_infinite(pbrt_t *p, params_t *params, position_t at)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    blob_light_t light = {.kind = LIGHT_INFINITE};
    double illuminance = pi;
    TRY(read_image(p, params, at, IMAGE_EMITTED, &light.image));
    TRY(read_emission(p, params, "L", light.image != 0, &light.radiance));
    if (light.image) {
        if (!v3 && params_has(params, "L"))
            return error_at(params_where(params, "L", at),
                            "a light has either \"L\" or \"filename\", not both");
        TRY(choose_mapping(p, &light, LIGHT_LATLONG, at));
        if (params_has(params, "illuminance"))
            illuminance = 2 * pi * scene_image_mean(p->builder, light.image, upper_cosine, NULL);
    }
    if (!v3) TRY(read_portal(p, params, &light));
    /* pbrt-v4 makes an image of one pixel, at the zenith, of a colour that it wants to show through a portal;
     * and it interpolates images when it lays them out as portals are seen. */
    if (light.flags & LIGHT_PORTAL && !light.image) illuminance = 2 * pi;
    if (light.flags & LIGHT_PORTAL && light.image) light.flags |= LIGHT_SMOOTH;
    if (light.image && light.mapping != LIGHT_OCTAHEDRAL && !v3 && params_has(params, "illuminance"))
        return error_at(params_where(params, "illuminance", at),
                        "\"illuminance\" is only supported with a square image");
    TRY(scale_to(p, params, "illuminance", illuminance, &light.radiance.factor));
    if (v3) TRY(params_apply(params, sample_rules, ARRAY_LENGTH(sample_rules), p->report));
    affine_t t = light_transform(p, at);
    if (light.image) {
        t = without_scale(p, t, at);
        light.radiance.spectrum = 0;
    }
    for (int i = 0; i < 3; ++i) t.m[i][3] = 0;
    if (!light.image) t = affine_identity();
    return scene_add_light(p->builder, light, &t, at);
}

/* ---- the directive ------------------------------------------------------------------------------------ */

typedef struct {
    dialect_entry_t entry;
    result_t (*make)(pbrt_t *p, params_t *params, position_t at);
} light_entry_t;

static const light_entry_t lights[] = {
    {{"point", DIALECT_BOTH}, make_point},           {{"spot", DIALECT_BOTH}, make_spot},
    {{"distant", DIALECT_BOTH}, make_distant},       {{"infinite", DIALECT_BOTH}, make_infinite},
    {{"exinfinite", DIALECT_V3}, make_infinite},     {{"goniometric", DIALECT_BOTH}, make_goniometric},
    {{"projection", DIALECT_BOTH}, make_projection},
};

result_t pbrt_light(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(PBRT_READ_KIND(p, TARGET_LIGHT, lights, "the light's type", "light", at, &index));
    if (index == LEFT_OUT) return result_ok();
    TRY(lights[index].make(p, p->params, at));
    return pbrt_finish_params(p, "LightSource", p->arguments[0]);
}
