/* subsurface: see subsurface.h. A medium is the same everywhere. What textures say of coefficients becomes
 * its mean; a colour that varies keeps its pattern: the medium has the brightest colour, and the surface lets
 * the root of what is left pass, on the way in and on the way out. */
#include "client/import/pbrt/materials/subsurface.h"

#include "client/import/pbrt/materials/named_media.h"
#include "client/import/scene/half_space.h"
#include "client/import/scene/texture_range.h"

static rgb_t times(rgb_t colour, double factor)
{
    return v_scale(colour, (float)factor);
}

/* The mean of a value of the given name, which should not vary. */
static result_t even_value(pbrt_t *p, params_t *params, const char *name, position_t at,
                           const blob_value_t *value, rgb_t *mean)
{
    TRY(scene_check_textures(p->builder, at));
    *mean = v_high(scene_value_mean(p->builder, value), vec3(0, 0, 0)); /* as in pbrt */
    if (value->texture != 0)
        report_warning(
            p->report, params_where(params, name, at),
            "\"%s\" varies, but what is below a surface is the same everywhere: its mean is taken, "
            "%g %g %g",
            name, (double)mean->x, (double)mean->y, (double)mean->z);
    return result_ok();
}

static result_t even_colour(pbrt_t *p, params_t *params, const char *name, position_t at, rgb_t *colour)
{
    blob_value_t value = blob_colour_value(*colour);
    TRY(pbrt_colour_value(p, params, name, COLOUR_UNBOUNDED, &value));
    return even_value(p, params, name, at, &value, colour);
}

static result_t read_g(pbrt_t *p, params_t *params, position_t at)
{
    double g = 0;
    TRY(params_float(params, "g", &g));
    p->body.g = (float)g;
    if (p->body.g > -1 && p->body.g < 1) return result_ok();
    return error_at(params_where(params, "g", at), "g is %g, but must be over -1 and below 1", g);
}

/* Notes the medium. */
static result_t set_body(pbrt_t *p, position_t at, rgb_t absorption, rgb_t scattering)
{
    bool valid = v_is_finite(absorption) && v_is_finite(scattering) &&
                 fmaxf(v_max(absorption), v_max(scattering)) <= (float)BLOB_MAX_NUMBER;
    if (!valid)
        return error_at(at,
                        "below this surface light would be absorbed or scattered more than %g times "
                        "per unit; is the scale right?",
                        BLOB_MAX_NUMBER);
    p->body.absorption = absorption;
    p->body.scattering = scattering;
    p->has_body = true;
    return result_ok();
}

static float part(float a, float b)
{
    return a / fmaxf(b, 1e-6f);
}

/* What of a colour the brightest one leaves to the surface. */
static void tint_surface(blob_material_t *record, const blob_value_t *colour, rgb_t most)
{
    rgb_t c = colour->factor;
    record->values[VALUE_ALBEDO] = (blob_value_t){
        .factor = vec3(part(c.x, most.x), part(c.y, most.y), part(c.z, most.z)), .texture = colour->texture};
    record->flags |= MATERIAL_TINTED_BODY;
}

/* The medium of a colour and a mean free path of each channel; the colour may vary. */
static result_t set_colour(pbrt_t *p, params_t *params, position_t at, const blob_value_t *colour, rgb_t path,
                           blob_material_t *record)
{
    rgb_t index, most = scene_value_most(p->builder, colour);
    float least = 1e-4f * v_max(path);
    TRY(even_value(p, params, "eta", at, &record->values[VALUE_ETA], &index));
    double eta = fmin(fmax((double)index.x, 0.1), 10), g = (double)p->body.g;
    if (!(least > 0)) return error_at(at, "the mean free path below this surface must be over 0");
    most = v_low(most, vec3(1, 1, 1));
    if (colour->texture != 0) tint_surface(record, colour, most);
    rgb_t loss = vec3(1 / fmaxf(path.x, least), 1 / fmaxf(path.y, least), 1 / fmaxf(path.z, least));
    rgb_t albedo = vec3((float)half_space_albedo((double)most.x, g, eta),
                        (float)half_space_albedo((double)most.y, g, eta),
                        (float)half_space_albedo((double)most.z, g, eta));
    rgb_t scattering = v_mul(albedo, loss);
    p->body.is_of_colour = 1;
    return set_body(p, at, v_sub(loss, scattering), scattering);
}

/* ---- the materials ------------------------------------------------------------------------------------- */

static result_t read_scale(params_t *params, double *scale)
{
    *scale = 1;
    return params_float_in(params, "scale", 0, 1e30, scale);
}

/* "reflectance" or "Kd", with a mean free path "mfp". */
static result_t read_colour(pbrt_t *p, params_t *params, const char *name, position_t at,
                            blob_material_t *record)
{
    double scale;
    rgb_t path = {1, 1, 1};
    blob_value_t colour = blob_constant(0.5f);
    TRY(pbrt_colour_value(p, params, name, COLOUR_REFLECTANCE, &colour));
    TRY(even_colour(p, params, "mfp", at, &path));
    TRY(read_scale(params, &scale));
    TRY(scene_check_textures(p->builder, at));
    return set_colour(p, params, at, &colour, times(path, scale), record);
}

/* The coefficients of a medium with a name, whose scattering is the reduced one, as if it were even. */
static result_t read_name(pbrt_t *p, params_t *params, position_t at, rgb_t *absorption, rgb_t *scattering,
                          bool *known)
{
    const char *name = "";
    bool v3 = p->dialect.dialect == DIALECT_V3;
    position_t where = params_where(params, "name", at);
    TRY(params_string(params, "name", &name));
    *known = named_medium_coefficients(name, absorption, scattering);
    if (*name == '\0') return result_ok();
    if (!*known)
        return v3 ? pbrt_slip(p, where, "that is the default", "no medium is called \"%.60s\"", name)
                  : error_at(where, "no medium is called \"%.60s\"", name);
    if (p->body.g != 0)
        report_warning(
            p->report, params_where(params, "g", at),
            "\"g\" is ignored beside \"name\", as by pbrt: what is known of \"%.60s\" is how much it "
            "scatters evenly",
            name);
    p->body.g = 0;
    return result_ok();
}

result_t pbrt_read_subsurface(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    bool v3 = p->dialect.dialect == DIALECT_V3, known;
    bool absorbs = params_has(params, "sigma_a"), scatters = params_has(params, "sigma_s");
    rgb_t absorption = {0.0011f, 0.0024f, 0.014f}, scattering = {2.55f, 3.21f, 3.77f};
    double scale;
    TRY(read_g(p, params, at));
    TRY(read_name(p, params, at, &absorption, &scattering, &known));
    if (!v3 && !known && absorbs != scatters)
        return error_at(at, "\"sigma_a\" and \"sigma_s\" go together; give both");
    if (!v3 && !known && !absorbs && params_has(params, "reflectance"))
        return read_colour(p, params, "reflectance", at, record);
    if (v3 || !known) {
        TRY(even_colour(p, params, "sigma_a", at, &absorption));
        TRY(even_colour(p, params, "sigma_s", at, &scattering));
    }
    TRY(read_scale(params, &scale));
    return set_body(p, at, times(absorption, scale), times(scattering, scale));
}

result_t pbrt_read_kdsubsurface(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    TRY(read_g(p, params, at));
    return read_colour(p, params, "Kd", at, record);
}

/* The distance d of Burley's profile is a fifth of "scatterdistance" in pbrt, and a mean free path is s d,
 * where s depends on the colour (Christensen and Burley 2015, "Approximate Reflectance Profiles for Efficient
 * Subsurface Scattering", equation 6). */
static float free_path(float distance, float colour)
{
    float a = fminf(colour, 1);
    return 0.2f * distance * (1.9f - a + 3.5f * (a - 0.8f) * (a - 0.8f));
}

result_t pbrt_read_scatter_distance(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    rgb_t d = {0, 0, 0};
    const blob_value_t colour = record->values[VALUE_REFLECTANCE];
    TRY(even_colour(p, params, "scatterdistance", at, &d));
    if (v_is_zero(d) || record->flags & MATERIAL_THIN) return result_ok();
    TRY(scene_check_textures(p->builder, at));
    rgb_t most = scene_value_most(p->builder, &colour);
    rgb_t path = vec3(free_path(d.x, most.x), free_path(d.y, most.y), free_path(d.z, most.z));
    record->flags |= MATERIAL_TINTED_BODY;
    record->values[VALUE_ALBEDO] = blob_constant(1);
    return set_colour(p, params, at, &colour, path, record);
}
