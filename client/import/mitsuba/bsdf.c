/* bsdf: see bsdf.h. A bsdf that stands alone is a row of the table with a function that fills a material; one
 * that holds others works on what they became. */
#include "client/import/mitsuba/bsdf.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "client/import/files/number.h"
#include "client/import/mitsuba/metals.h"
#include "client/import/mitsuba/texture.h"

enum { MOST_PARTS = BLOB_MAX_MIX_DEPTH + 1 };
static const double air = 1.000277, glass = 1.5046;

/* A bsdf while it is made. */
typedef struct {
    mitsuba_t *m;
    element_t *object;
    bool flipped; /* see texture.h */
    blob_material_t record;
    material_t out;
} maker_t;

static result_t make(mitsuba_t *m, element_t *object, bool flipped, material_t *out);

static uint32_t add_record(maker_t *k)
{
    const char *id = element_attribute(k->object, "id");
    k->record.name = blob_builder_string(k->m->scene->blob, id ? id : object_type(k->object));
    return blob_builder_add(k->m->scene->blob, BLOB_SECTION_MATERIALS, &k->record, 1);
}

static blob_material_t *record_of(const mitsuba_t *m, uint32_t index)
{
    return (blob_material_t *)blob_builder_records(m->scene->blob, BLOB_SECTION_MATERIALS) + index;
}

static result_t value(maker_t *k, const char *name, double otherwise, material_value_t slot)
{
    return texture_property(k->m, k->object, name, otherwise, TEXTURE_COLOURS, k->flipped,
                            &k->record.values[slot]);
}

/* The same of a number, for which Mitsuba takes a colour's mean. */
static result_t number(maker_t *k, const char *name, double otherwise, material_value_t slot)
{
    return texture_property(k->m, k->object, name, otherwise, TEXTURE_MEAN, k->flipped,
                            &k->record.values[slot]);
}

/* Mitsuba makes reflectances weaker that add up to more than 1 where each is at its largest. `second` may be
 * NULL. */
static result_t conserve_energy(maker_t *k, blob_value_t *first, blob_value_t *second)
{
    bool wanted = true;
    TRY(property_bool(k->m, k->object, "ensureEnergyConservation", &wanted));
    rgb_t sum = texture_most(k->m, first);
    if (second) sum = v_add(sum, texture_most(k->m, second));
    float most = v_max(sum);
    if (!wanted || !(most > 1)) return result_ok();
    if (second)
        report_warning(
            k->m->report, k->object->at,
            "the reflectances of bsdf \"%.20s\" add up to %g, and are scaled to 0.99, as in Mitsuba",
            object_type(k->object), (double)most);
    else
        report_warning(k->m->report, k->object->at,
                       "a colour of bsdf \"%.20s\" goes up to %g, and is scaled to 0.99, as in Mitsuba",
                       object_type(k->object), (double)most);
    first->factor = v_scale(first->factor, 0.99f / most);
    if (second) second->factor = v_scale(second->factor, 0.99f / most);
    return result_ok();
}

/* What is reflected or let through of light: at most 1. */
static result_t share(maker_t *k, const char *name, double otherwise, material_value_t slot)
{
    TRY(value(k, name, otherwise, slot));
    return conserve_energy(k, &k->record.values[slot], NULL);
}

/* ---- indices and roughness ----------------------------------------------------------------------------- */

static const struct {
    const char *name;
    double index;
} indices[] = {
    {"vacuum", 1},        {"helium", 1.00004},         {"hydrogen", 1.00013},
    {"air", 1.00028},     {"carbon dioxide", 1.00045}, {"water", 1.333},
    {"acetone", 1.36},    {"ethanol", 1.361},          {"carbon tetrachloride", 1.461},
    {"glycerol", 1.4729}, {"benzene", 1.501},          {"silicone oil", 1.52045},
    {"bromine", 1.661},   {"water ice", 1.31},         {"fused quartz", 1.458},
    {"pyrex", 1.47},      {"acrylic glass", 1.49},     {"polypropylene", 1.49},
    {"bk7", 1.5046},      {"sodium chloride", 1.544},  {"amber", 1.55},
    {"pet", 1.575},       {"diamond", 2.419},
};

/* A number, or the name of a material. */
static result_t read_index(maker_t *k, const char *name, double *index)
{
    const element_t *found = property_find(k->object, name);
    const char *text = NULL;
    if (!found || strcmp(found->tag, "string") != 0)
        return property_number(k->m, k->object, name, 1e-3, 1e3, index);
    TRY(property_string(k->m, k->object, name, &text));
    for (size_t i = 0; i < ARRAY_LENGTH(indices); ++i) {
        if (strcasecmp(text, indices[i].name) != 0) continue;
        *index = indices[i].index;
        return result_ok();
    }
    return error_at(found->at, "no index of refraction is known for \"%.40s\"; give a number", text);
}

/* The inner index relative to the outer one. */
static result_t read_relative_index(maker_t *k, double inner)
{
    double outer = air;
    TRY(read_index(k, "intIOR", &inner));
    TRY(read_index(k, "extIOR", &outer));
    k->record.values[VALUE_ETA] = blob_constant((float)(inner / outer));
    return result_ok();
}

/* alpha is for the one of alphaU and alphaV that is not given. */
static result_t read_widths(maker_t *k, material_value_t u, material_value_t v)
{
    TRY(number(k, "alpha", 0.1, u));
    k->record.values[v] = k->record.values[u];
    if (property_find(k->object, "alphaU")) TRY(number(k, "alphaU", 0.1, u));
    return property_find(k->object, "alphaV") ? number(k, "alphaV", 0.1, v) : result_ok();
}

static result_t read_alphas(maker_t *k, material_value_t u, material_value_t v)
{
    const char *distribution = "beckmann";
    TRY(property_string(k->m, k->object, "distribution", &distribution));
    property_ignore(k->object, "sampleVisible");
    if (strcasecmp(distribution, "ggx") != 0 && !k->m->said_beckmann) {
        report_warning(k->m->report, k->object->at,
                       "the distribution \"%.20s\" is taken for ggx of the same alpha, whose highlights have "
                       "longer tails",
                       distribution);
        k->m->said_beckmann = true;
    }
    return read_widths(k, u, v);
}

static result_t read_surface_alphas(maker_t *k)
{
    return read_alphas(k, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V);
}

/* ---- bsdfs of one layer -------------------------------------------------------------------------------- */

static result_t fill_diffuse(maker_t *k)
{
    const char *name = property_find(k->object, "diffuseReflectance") ? "diffuseReflectance" : "reflectance";
    k->record.kind = MATERIAL_DIFFUSE;
    return share(k, name, 0.5, VALUE_REFLECTANCE);
}

/* alpha is the root mean square of slopes, sigma of Oren and Nayar the deviation of angles along one axis. */
static result_t fill_rough_diffuse(maker_t *k)
{
    const double degrees = 180 / 3.14159265358979323846;
    double alpha = 0.2;
    TRY(fill_diffuse(k));
    TRY(property_number(k->m, k->object, "alpha", 0, 10, &alpha));
    property_ignore(k->object, "useFastApprox");
    k->record.values[VALUE_SIGMA] = blob_constant((float)fmin(alpha / sqrt(2) * degrees, 90));
    return result_ok();
}

static result_t fill_dielectric(maker_t *k)
{
    k->record.kind = MATERIAL_DIELECTRIC;
    TRY(read_relative_index(k, glass));
    TRY(share(k, "specularReflectance", 1, VALUE_REFLECTANCE));
    return share(k, "specularTransmittance", 1, VALUE_TRANSMITTANCE);
}

static result_t fill_thin_dielectric(maker_t *k)
{
    k->record.flags = MATERIAL_THIN;
    return fill_dielectric(k);
}

static result_t fill_rough_dielectric(maker_t *k)
{
    TRY(fill_dielectric(k));
    return read_surface_alphas(k);
}

static result_t read_metal(maker_t *k, const char *name, rgb_t *eta, rgb_t *absorption)
{
    if (metal_index(name, eta, absorption)) return result_ok();
    metal_index("Cu", eta, absorption);
    return report_refuse(k->m->report, k->object->at,
                         "no index is known for the metal \"%.20s\"; give eta and k. The nearest is copper",
                         name);
}

/* eta and k, or what is missing of them by the name of a metal, in the medium outside. */
static result_t read_complex_index(maker_t *k, const char *name)
{
    double outer = air;
    rgb_t eta = {0, 0, 0}, absorption = {0, 0, 0};
    TRY(read_index(k, "extEta", &outer));
    if (!property_find(k->object, "eta") || !property_find(k->object, "k"))
        TRY(read_metal(k, name, &eta, &absorption));
    TRY(property_colour(k->m, k->object, "eta", &eta));
    TRY(property_colour(k->m, k->object, "k", &absorption));
    k->record.values[VALUE_ETA] = blob_colour_value(v_scale(eta, (float)(1 / outer)));
    k->record.values[VALUE_K] = blob_colour_value(v_scale(absorption, (float)(1 / outer)));
    return result_ok();
}

static result_t fill_conductor(maker_t *k)
{
    const char *name = "Cu";
    TRY(share(k, "specularReflectance", 1, VALUE_REFLECTANCE));
    TRY(property_string(k->m, k->object, "material", &name));
    bool own = property_find(k->object, "eta") || property_find(k->object, "k");
    k->record.kind = !own && strcasecmp(name, "none") == 0 ? MATERIAL_MIRROR : MATERIAL_CONDUCTOR;
    if (k->record.kind == MATERIAL_CONDUCTOR) return read_complex_index(k, name);
    property_ignore(k->object, "extEta");
    return result_ok();
}

static result_t fill_rough_conductor(maker_t *k)
{
    TRY(fill_conductor(k));
    if (k->record.kind == MATERIAL_MIRROR) { /* a metal that reflects all at every angle, nearly */
        k->record.kind = MATERIAL_CONDUCTOR;
        k->record.values[VALUE_ETA] = blob_constant(1);
        k->record.values[VALUE_K] = blob_constant(1e4f);
    }
    return read_surface_alphas(k);
}

static result_t fill_diffuse_transmitter(maker_t *k)
{
    k->record.kind = MATERIAL_DIFFUSE_TRANSMISSION;
    return share(k, "transmittance", 0.5, VALUE_TRANSMITTANCE);
}

static result_t read_reflectances(maker_t *k)
{
    TRY(value(k, "diffuseReflectance", 0.5, VALUE_REFLECTANCE));
    TRY(value(k, "specularReflectance", 0.2, VALUE_SPECULAR));
    return conserve_energy(k, &k->record.values[VALUE_REFLECTANCE], &k->record.values[VALUE_SPECULAR]);
}

static result_t fill_phong(maker_t *k)
{
    k->record.kind = MATERIAL_PHONG;
    TRY(read_reflectances(k));
    return number(k, "exponent", 30, VALUE_EXPONENT);
}

static result_t fill_ward(maker_t *k)
{
    static const struct {
        const char *name;
        material_kind_t kind;
    } variants[] = {
        {"ward", MATERIAL_WARD}, {"ward-duer", MATERIAL_WARD_DUER}, {"balanced", MATERIAL_WARD_BALANCED}};
    const char *variant = "balanced";
    TRY(read_reflectances(k));
    TRY(read_widths(k, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V));
    TRY(property_string(k->m, k->object, "variant", &variant));
    for (size_t i = 0; i < ARRAY_LENGTH(variants); ++i) {
        if (strcasecmp(variant, variants[i].name) != 0) continue;
        k->record.kind = variants[i].kind;
        return result_ok();
    }
    return error_at(k->object->at,
                    "the variant of a ward must be ward, ward-duer or balanced, found \"%.20s\"", variant);
}

/* ---- plastic ------------------------------------------------------------------------------------------- */

/* The share that the inside of a smooth interface of that relative index sends back of what comes from a
 * diffuse base: 1 - (1 - F) / eta^2, F the mean reflectance from outside. */
static double inner_reflectance(double eta)
{
    enum { STEPS = 1000 };
    double sum = 0;
    for (int i = 0; i < STEPS; ++i) {
        double c = (i + 0.5) / STEPS, sine2 = (1 - c * c) / (eta * eta);
        double t = sqrt(fmax(1 - sine2, 0));
        double parallel = (eta * c - t) / (eta * c + t), across = (c - eta * t) / (c + eta * t);
        sum += sine2 >= 1 ? 2 * c : (parallel * parallel + across * across) * c;
    }
    return 1 - (1 - sum / STEPS) / (eta * eta);
}

static void no_medium(blob_material_t *record)
{
    record->kind = MATERIAL_COATED_DIFFUSE;
    record->values[VALUE_THICKNESS] = record->values[VALUE_ALBEDO] = record->values[VALUE_G] =
        blob_constant(0);
}

/* The reflectance of a base that reflects in the end what a linear plastic of reflectance r does. */
static float inner_colour(float r, double inner)
{
    return (float)((double)r / (1 - inner + (double)r * inner));
}

/* Mitsuba's plastic takes what the base reflects in the end as linear in its reflectance, unless it is asked
 * for nonlinear colours. Then a constant r is that of a base r / (1 - F + r F), and what varies is the
 * mixture of a black base and a white one. */
static result_t linear_plastic(maker_t *k, blob_value_t base)
{
    blob_value_t *reflectance = &k->record.values[VALUE_REFLECTANCE];
    double f = inner_reflectance((double)k->record.values[VALUE_ETA].factor.x);
    if (base.texture == 0) {
        rgb_t r = base.factor;
        base.factor = vec3(inner_colour(r.x, f), inner_colour(r.y, f), inner_colour(r.z, f));
        *reflectance = base;
        return result_ok();
    }
    uint32_t parts[2];
    for (int i = 0; i < 2; ++i) {
        *reflectance = blob_constant((float)i);
        parts[i] = add_record(k);
    }
    k->record =
        (blob_material_t){.kind = MATERIAL_MIX, .parts = {parts[0], parts[1]}, .flags = MATERIAL_UNIT};
    k->record.values[VALUE_AMOUNT] = base;
    return result_ok();
}

/* The factor on what a coat reflects. */
static result_t read_tint(maker_t *k)
{
    blob_value_t *tint = &k->record.values[VALUE_SPECULAR];
    TRY(share(k, "specularReflectance", 1, VALUE_SPECULAR));
    if (tint->texture != 0 || tint->factor.x != 1 || tint->factor.y != 1 || tint->factor.z != 1)
        k->record.flags |= MATERIAL_TINTED;
    return result_ok();
}

static result_t fill_plastic(maker_t *k)
{
    bool nonlinear = false;
    no_medium(&k->record);
    TRY(read_relative_index(k, 1.49));
    if (strcmp(object_type(k->object), "roughplastic") == 0) TRY(read_surface_alphas(k));
    TRY(share(k, "diffuseReflectance", 0.5, VALUE_REFLECTANCE));
    TRY(property_bool(k->m, k->object, "nonlinear", &nonlinear));
    TRY(read_tint(k));
    return nonlinear ? result_ok() : linear_plastic(k, k->record.values[VALUE_REFLECTANCE]);
}

/* ---- bsdfs that hold others ---------------------------------------------------------------------------- */

/* The only bsdf within. */
static result_t nested(maker_t *k, material_t *inner)
{
    element_t *found;
    TRY(object_only(k->m, k->object, "bsdf", &found));
    if (!found) return error_at(k->object->at, "bsdf \"%.20s\" needs a bsdf within", object_type(k->object));
    TRY(make(k->m, found, k->flipped, inner));
    if (inner->index == BLOB_NONE)
        return error_at(k->object->at, "bsdf \"%.20s\" may not hold \"null\"", object_type(k->object));
    return result_ok();
}

static result_t hold_two_sided(maker_t *k)
{
    element_t *at = NULL, *found;
    const char *name;
    bool said = k->m->said_one_sided;
    k->m->said_one_sided = true; /* it is not, below this */
    result_t result = nested(k, &k->out);
    k->m->said_one_sided = said;
    TRY(result);
    TRY(object_child(k->m, k->object, "bsdf", &at, &found, &name));
    if (found) TRY(object_child(k->m, k->object, "bsdf", &at, &found, &name));
    if (!found) return result_ok();
    return report_refuse(
        k->m->report, k->object->at,
        "a second bsdf for the back is not supported; the nearest is the front's on both sides");
}

static result_t hold_mask(maker_t *k)
{
    blob_value_t opacity;
    TRY(nested(k, &k->out));
    TRY(texture_property(k->m, k->object, "opacity", 0.5, TEXTURE_LUMINANCE, k->flipped, &opacity));
    if (opacity.texture != 0 || k->out.alpha.texture != 0) {
        blob_texture_t texture = {.kind = TEXTURE_SCALE, .channel = CHANNEL_RGB};
        texture.texture_from_world = xform_identity();
        texture.inputs[0] = opacity;
        texture.inputs[1] = k->out.alpha;
        k->out.alpha = scene_add_texture(k->m->scene, &texture);
    } else {
        k->out.alpha.factor = v_mul(k->out.alpha.factor, opacity.factor);
    }
    return result_ok();
}

/* A copy of the inner material, so that a map of its own can be put on it. */
static result_t copy_nested(maker_t *k)
{
    TRY(nested(k, &k->out));
    k->record = *record_of(k->m, k->out.index);
    return result_ok();
}

/* A material has one map of a kind, and a mixture whose parts have their own has none. `second`: the material
 * within has such a map. */
static void warn_of_relief(const maker_t *k, bool second)
{
    if (k->record.kind == MATERIAL_MIX && (k->record.flags & MATERIAL_CHOSEN) != 0)
        report_warning(k->m->report, k->object->at,
                       "this %s is left out: parts of the mixture within have relief of their own; put it on "
                       "those that have none",
                       object_type(k->object));
    else if (second)
        report_warning(k->m->report, k->object->at,
                       "this %s takes the place of the one within it; combine the two in one texture",
                       object_type(k->object));
}

static result_t only_texture(maker_t *k, texture_use_t use, blob_value_t *map)
{
    element_t *found;
    TRY(object_only(k->m, k->object, "texture", &found));
    if (!found) return error_at(k->object->at, "bsdf \"%.20s\" needs a texture", object_type(k->object));
    return texture_element(k->m, found, use, k->flipped, map);
}

static result_t hold_bump(maker_t *k)
{
    blob_value_t map, one = blob_constant(1);
    double scale = 1;
    TRY(copy_nested(k));
    TRY(only_texture(k, TEXTURE_LUMINANCE, &map));
    warn_of_relief(k, k->record.bump != 0);
    TRY(property_number(k->m, k->object, "scale", -1e12, 1e12, &scale));
    map.factor = v_scale(map.factor, (float)scale);
    blob_texture_t texture = {.kind = TEXTURE_SCALE, .channel = CHANNEL_RGB, .inputs = {map, one}};
    texture.texture_from_world = xform_identity();
    k->record.bump = scene_add_texture(k->m->scene, &texture).texture;
    k->out.index = add_record(k);
    return result_ok();
}

static result_t hold_normal_map(maker_t *k)
{
    blob_value_t map;
    TRY(copy_nested(k));
    TRY(only_texture(k, TEXTURE_NORMALS, &map));
    if (map.texture == 0) return result_ok();
    warn_of_relief(k, k->record.normal_map != 0);
    k->record.normal_map = map.texture;
    k->record.normal_scale = 1;
    k->out.index = add_record(k);
    return result_ok();
}

/* The bsdfs within, at most MOST_PARTS. */
static result_t read_parts(maker_t *k, uint32_t parts[MOST_PARTS], size_t *count)
{
    element_t *at = NULL, *found;
    const char *name;
    for (*count = 0;; ++*count) {
        material_t part;
        TRY(object_child(k->m, k->object, "bsdf", &at, &found, &name));
        if (!found) return result_ok();
        if (*count == MOST_PARTS)
            return error_at(found->at, "more than %d bsdfs in a mixture are not supported", MOST_PARTS);
        TRY(make(k->m, found, k->flipped, &part));
        if (part.index == BLOB_NONE) return error_at(found->at, "a mixture may not hold \"null\"");
        if (part.alpha.texture != 0 || part.alpha.factor.x != 1)
            TRY(report_refuse(k->m->report, found->at,
                              "a mask in a mixture is not supported; the nearest is without it"));
        parts[*count] = part.index;
    }
}

static uint32_t mix(maker_t *k, uint32_t first, uint32_t second, blob_value_t amount)
{
    k->record = (blob_material_t){.kind = MATERIAL_MIX, .parts = {first, second}, .flags = MATERIAL_UNIT};
    k->record.values[VALUE_AMOUNT] = amount;
    scene_choose_parts(k->m->scene, &k->record);
    return add_record(k);
}

static result_t hold_blend(maker_t *k)
{
    uint32_t parts[MOST_PARTS];
    size_t count;
    blob_value_t weight;
    TRY(read_parts(k, parts, &count));
    if (count != 2) return error_at(k->object->at, "blendbsdf needs two bsdfs, found %zu", count);
    TRY(texture_property(k->m, k->object, "weight", 0.5, TEXTURE_MEAN, k->flipped, &weight));
    k->out.index = mix(k, parts[0], parts[1], weight);
    return result_ok();
}

static result_t read_weights(maker_t *k, double weights[MOST_PARTS], size_t expected)
{
    const char *text = "";
    TRY(property_string(k->m, k->object, "weights", &text));
    const char *end = text + strlen(text);
    for (size_t i = 0; i <= expected; ++i) {
        text += strspn(text, ", \t\n");
        if (i == expected && *text == '\0') return result_ok();
        const char *next = i < expected ? number_parse(text, end, &weights[i]) : NULL;
        if (!next || !(weights[i] >= 0 && weights[i] <= 1e6)) break;
        text = next;
    }
    return error_at(k->object->at,
                    "mixturebsdf needs weights, a number of 0 or more for each of its %zu bsdfs", expected);
}

/* Weights of less than 1 together leave the rest black. */
static result_t fill_up(maker_t *k, size_t count, double sum)
{
    if (sum > 1 + 1e-6)
        report_warning(k->m->report, k->object->at, "the weights sum to %g, and are scaled to 1", sum);
    if (!(sum < 1 - 1e-6)) return result_ok();
    if (count == MOST_PARTS)
        return error_at(k->object->at, "more than %d bsdfs whose weights sum to less than 1", MOST_PARTS - 1);
    k->record = (blob_material_t){.kind = MATERIAL_DIFFUSE};
    uint32_t black = add_record(k);
    k->out.index = mix(k, black, k->out.index, blob_constant((float)sum));
    return result_ok();
}

static result_t hold_mixture(maker_t *k)
{
    uint32_t parts[MOST_PARTS];
    double weights[MOST_PARTS + 1], sum;
    size_t count;
    TRY(read_parts(k, parts, &count));
    if (count == 0) return error_at(k->object->at, "mixturebsdf needs bsdfs");
    TRY(read_weights(k, weights, count));
    k->out.index = parts[0];
    sum = weights[0];
    for (size_t i = 1; i < count; ++i) {
        sum += weights[i];
        if (weights[i] > 0)
            k->out.index = mix(k, k->out.index, parts[i], blob_constant((float)(weights[i] / sum)));
    }
    return fill_up(k, count, sum);
}

/* Its optical depth, seen straight on: absorption, which is grey, times thickness. */
static result_t read_depth(maker_t *k, double *depth)
{
    rgb_t sigma = {0, 0, 0};
    double thickness = 1;
    TRY(property_number(k->m, k->object, "thickness", 0, 1e6, &thickness));
    TRY(property_colour(k->m, k->object, "sigmaA", &sigma));
    if (sigma.x != sigma.y || sigma.y != sigma.z)
        TRY(report_refuse(k->m->report, k->object->at,
                          "a coat's coloured sigmaA is not supported; the nearest is its mean"));
    *depth = fmin((double)(sigma.x + sigma.y + sigma.z) / 3 * thickness, 1e4);
    return result_ok();
}

/* The renderer divides a metal's index by the coat's; Mitsuba's metal is one in air. */
static void coat_conductor(const blob_material_t *base, blob_material_t *coat)
{
    blob_value_t *values = coat->values;
    coat->kind = MATERIAL_COATED_CONDUCTOR;
    values[VALUE_BASE_ETA] = base->values[VALUE_ETA];
    values[VALUE_K] = base->values[VALUE_K];
    values[VALUE_BASE_ETA].factor = v_scale(values[VALUE_BASE_ETA].factor, values[VALUE_ETA].factor.x);
    values[VALUE_K].factor = v_scale(values[VALUE_K].factor, values[VALUE_ETA].factor.x);
    values[VALUE_BASE_ROUGHNESS_U] = base->values[VALUE_ROUGHNESS_U];
    values[VALUE_BASE_ROUGHNESS_V] = base->values[VALUE_ROUGHNESS_V];
}

/* Glass looks nearly the same without a clear coat. */
static result_t leave_coat_out(const maker_t *k)
{
    report_warning(k->m->report, k->object->at,
                   "a clear coat over a dielectric is left out: it would reflect a little more");
    return result_ok();
}

/* A material has one map, which is that of its coat, too. */
static void keep_maps(const maker_t *k, const blob_material_t *base, blob_material_t *coat)
{
    if (base->bump == 0 && base->normal_map == 0) return;
    report_warning(k->m->report, k->object->at,
                   "the bumps of what is coated are those of the coat, too, which is smooth in Mitsuba");
    coat->bump = base->bump;
    coat->normal_map = base->normal_map;
    coat->normal_scale = base->normal_scale;
}

/* A coat over what Lightmill has a coated form of. */
static result_t hold_coating(maker_t *k)
{
    double depth;
    TRY(nested(k, &k->out));
    blob_material_t base = *record_of(k->m, k->out.index);
    TRY(read_tint(k));
    no_medium(&k->record);
    TRY(read_relative_index(k, glass));
    TRY(read_depth(k, &depth));
    if (strcmp(object_type(k->object), "roughcoating") == 0) TRY(read_surface_alphas(k));
    k->record.values[VALUE_THICKNESS] = blob_constant((float)depth);
    if (base.kind == MATERIAL_DIFFUSE && base.values[VALUE_SIGMA].factor.x == 0)
        k->record.values[VALUE_REFLECTANCE] = base.values[VALUE_REFLECTANCE];
    else if (base.kind == MATERIAL_CONDUCTOR)
        coat_conductor(&base, &k->record);
    else if (base.kind == MATERIAL_DIELECTRIC && depth == 0)
        return leave_coat_out(k);
    else
        return report_refuse(k->m->report, k->object->at,
                             "a coat over anything but diffuse and conductor is not supported; the nearest "
                             "is to do without it");
    keep_maps(k, &base, &k->record);
    k->out.index = add_record(k);
    return result_ok();
}

/* ---- the table ----------------------------------------------------------------------------------------- */

typedef struct {
    const char *type;
    result_t (*fill)(maker_t *k); /* fills the record ... */
    result_t (*hold)(maker_t *k); /* ... or says what it becomes itself */
    bool one_sided;               /* in Mitsuba: black from behind, without twosided */
} row_t;

static const row_t rows[] = {
    {"diffuse", fill_diffuse, NULL, true},
    {"roughdiffuse", fill_rough_diffuse, NULL, true},
    {"dielectric", fill_dielectric, NULL, false},
    {"thindielectric", fill_thin_dielectric, NULL, false},
    {"roughdielectric", fill_rough_dielectric, NULL, false},
    {"conductor", fill_conductor, NULL, true},
    {"roughconductor", fill_rough_conductor, NULL, true},
    {"plastic", fill_plastic, NULL, true},
    {"roughplastic", fill_plastic, NULL, true},
    {"difftrans", fill_diffuse_transmitter, NULL, false},
    {"phong", fill_phong, NULL, true},
    {"ward", fill_ward, NULL, true},
    {"twosided", NULL, hold_two_sided, false},
    {"mask", NULL, hold_mask, false},
    {"bumpmap", NULL, hold_bump, false},
    {"bump", NULL, hold_bump, false}, /* until 0.4 */
    {"normalmap", NULL, hold_normal_map, false},
    {"blendbsdf", NULL, hold_blend, false},
    {"mixturebsdf", NULL, hold_mixture, false},
    {"coating", NULL, hold_coating, false},
    {"roughcoating", NULL, hold_coating, false},
};

static const row_t *find_row(const char *type)
{
    for (size_t i = 0; i < ARRAY_LENGTH(rows); ++i)
        if (strcmp(type, rows[i].type) == 0) return &rows[i];
    return NULL;
}

static result_t make_unknown(maker_t *k)
{
    k->record.kind = MATERIAL_DIFFUSE;
    k->record.values[VALUE_REFLECTANCE] = blob_constant(0.5f);
    k->out.index = add_record(k);
    return report_refuse(k->m->report, k->object->at,
                         "bsdf \"%.40s\" is not supported; the nearest is diffuse", object_type(k->object));
}

static result_t make_row(maker_t *k)
{
    const row_t *row = find_row(object_type(k->object));
    if (strcmp(object_type(k->object), "null") == 0) {
        k->out.index = BLOB_NONE;
        return result_ok();
    }
    if (!row) return make_unknown(k);
    if (row->one_sided && !k->m->said_one_sided) {
        report_warning(
            k->m->report, k->object->at,
            "without twosided a \"%s\" surface is black from behind in Mitsuba; here both sides reflect",
            row->type);
        k->m->said_one_sided = true;
    }
    if (row->hold) {
        TRY(row->hold(k));
    } else {
        TRY(row->fill(k));
        k->out.index = add_record(k);
    }
    return object_finish(k->m, k->object);
}

/* Makes a bsdf once for each orientation of v. */
static result_t make(mitsuba_t *m, element_t *object, bool flipped, material_t *out)
{
    uint32_t *memory = flipped ? &object->variant : &object->object;
    if (*memory != 0) {
        *out = m->materials[*memory - 1];
        return result_ok();
    }
    if (m->material_depth == BLOB_MAX_MIX_DEPTH)
        return error_at(object->at, "more than %d bsdfs in one another, or one that holds itself",
                        BLOB_MAX_MIX_DEPTH);
    ++m->material_depth;
    maker_t k = {.m = m, .object = object, .flipped = flipped, .out = {.alpha = blob_constant(1)}};
    result_t result = make_row(&k);
    --m->material_depth;
    TRY(result);
    m->materials = grow(m->materials, &m->material_capacity, m->material_count + 1, sizeof *m->materials);
    m->materials[m->material_count++] = *out = k.out;
    *memory = (uint32_t)m->material_count;
    return result_ok();
}

/* The last bsdf of a shape that is for all of it, or for the material `wanted`; NULL: none. */
static result_t choose(mitsuba_t *m, const element_t *shape, const char *wanted, element_t **chosen)
{
    element_t *at = NULL, *found;
    const char *name;
    *chosen = NULL;
    for (;;) {
        TRY(object_child(m, shape, "bsdf", &at, &found, &name));
        if (!found) return result_ok();
        if (!wanted || !*name || strcmp(name, wanted) == 0) *chosen = found;
    }
}

result_t bsdf_of_shape(mitsuba_t *m, const element_t *shape, const char *wanted, bool flipped,
                       material_t *material, bool *given)
{
    element_t *found;
    TRY(choose(m, shape, wanted, &found));
    *given = found != NULL;
    return found ? make(m, found, flipped, material) : result_ok();
}

static bool has_child(const element_t *object, const char *tag)
{
    const element_t *child = object->first;
    while (child && strcmp(child->tag, tag) != 0) child = child->next;
    return child != NULL;
}

/* A diffuse material of that reflectance, which `memory` is for: see mitsuba_t.plain. */
static uint32_t plain(mitsuba_t *m, uint32_t *memory, const char *name, float reflectance)
{
    if (*memory == 0) {
        blob_material_t record = {.kind = MATERIAL_DIFFUSE};
        record.values[VALUE_REFLECTANCE] = blob_constant(reflectance);
        record.name = blob_builder_string(m->scene->blob, name);
        *memory = 1 + blob_builder_add(m->scene->blob, BLOB_SECTION_MATERIALS, &record, 1);
    }
    return *memory - 1;
}

material_t bsdf_default(mitsuba_t *m, const element_t *shape)
{
    uint32_t index = BLOB_NONE;
    if (has_child(shape, "emitter"))
        index = plain(m, &m->black, "black", 0);
    else if (!has_child(shape, "medium"))
        index = plain(m, &m->plain, "default", 0.5f);
    return (material_t){index, blob_constant(1)};
}
