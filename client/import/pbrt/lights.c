/* lights: AreaLightSource, LightSource, and the tables of either. */
#include "client/import/pbrt/directives.h"

typedef struct {
    entry_t entry;
    /* Fills radiance and flags; NULL: not supported yet. */
    result_t (*make)(pbrt_t *p, params_t *params, blob_light_t *light);
} area_light_entry_t;

static const param_rule_t diffuse_rules_v3[] = {
    {"samples", PARAM_IGNORE, "every light is sampled as its power asks for"},
    {"nsamples", PARAM_IGNORE, "every light is sampled as its power asks for"},
};
static const param_rule_t diffuse_rules_v4[] = {
    {"power", PARAM_REFUSE, "lights by their power are not supported yet; give the radiance \"L\""},
    {"filename", PARAM_REFUSE, "lights with an image are not supported yet"},
};

static result_t make_diffuse(pbrt_t *p, params_t *params, blob_light_t *light)
{
    bool v3 = p->dialect.dialect == DIALECT_V3, two_sided = false;
    rgb_t radiance = vec3(1, 1, 1), scale = vec3(1, 1, 1);
    TRY(pbrt_colour(p, params, "L", COLOUR_LIGHT, &radiance));
    if (v3) {
        TRY(pbrt_colour(p, params, "scale", COLOUR_LIGHT, &scale));
        TRY(params_apply(params, diffuse_rules_v3, ARRAY_LENGTH(diffuse_rules_v3), p->report));
    } else {
        double factor = 1;
        TRY(params_float_in(params, "scale", 0, 1e30, &factor));
        scale = vec3((float)factor, (float)factor, (float)factor);
        TRY(params_apply(params, diffuse_rules_v4, ARRAY_LENGTH(diffuse_rules_v4), p->report));
    }
    TRY(params_bool(params, "twosided", &two_sided));
    light->radiance = v_mul(radiance, scale);
    light->flags = two_sided ? LIGHT_TWO_SIDED : 0;
    return result_ok();
}

static const area_light_entry_t area_lights[] = {
    {{"diffuse", DIALECT_BOTH}, make_diffuse},
    {{"area", DIALECT_V3}, make_diffuse},
};

result_t pbrt_area_light(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(pbrt_read_string(p, 0, "the light's type"));
    TRY(pbrt_read_params_for(p, TARGET_LIGHT));
    TRY(entry_find(area_lights, ARRAY_LENGTH(area_lights), sizeof *area_lights, "area light", p->arguments[0],
                   &p->dialect, at, &index));
    p->now.light = (blob_light_t){0};
    TRY(area_lights[index].make(p, p->params, &p->now.light));
    if (!v_is_finite(p->now.light.radiance)) return error_at(at, "this light's radiance is not finite");
    p->now.emits = true;
    return pbrt_finish_params(p, "AreaLightSource", p->arguments[0]);
}

/* Lights without a surface. */
typedef struct {
    entry_t entry;
    result_t (*make)(pbrt_t *p, params_t *params, position_t at); /* NULL: not supported yet */
} light_entry_t;

static const light_entry_t lights[] = {
    {{"point", DIALECT_BOTH}, NULL},      {{"spot", DIALECT_BOTH}, NULL},
    {{"distant", DIALECT_BOTH}, NULL},    {{"infinite", DIALECT_BOTH}, NULL},
    {{"exinfinite", DIALECT_V3}, NULL},   {{"goniometric", DIALECT_BOTH}, NULL},
    {{"projection", DIALECT_BOTH}, NULL},
};

result_t pbrt_light(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(pbrt_read_string(p, 0, "the light's type"));
    TRY(pbrt_read_params_for(p, TARGET_LIGHT));
    TRY(entry_find(lights, ARRAY_LENGTH(lights), sizeof *lights, "light", p->arguments[0], &p->dialect, at,
                   &index));
    if (!lights[index].make) return error_at(at, "light \"%s\" is not supported yet", p->arguments[0]);
    TRY(lights[index].make(p, p->params, at));
    return pbrt_finish_params(p, "LightSource", p->arguments[0]);
}
