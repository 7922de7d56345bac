/* property: see property.h. */
#include "client/import/mitsuba/property.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "client/import/files/number.h"
#include "client/import/files/spectrum.h"
#include "client/import/scene/scene_images.h"

static const double largest = 1e30;

/* ---- ids and children ---------------------------------------------------------------------------------- */

static result_t add_id(mitsuba_t *m, element_t *element, const char *id)
{
    size_t before = m->ids.count;
    uint32_t number = intern_add(&m->ids, id, strlen(id));
    if (number != before) return error_at(element->at, "the id \"%.60s\" is given twice", id);
    m->by_id = grow(m->by_id, &m->id_capacity, m->ids.count, sizeof(element_t *));
    m->by_id[number] = element;
    return result_ok();
}

static element_t *find_id(const mitsuba_t *m, const char *id)
{
    uint32_t number;
    return id && intern_find(&m->ids, id, strlen(id), &number) ? m->by_id[number] : NULL;
}

/* <alias id="old" as="new"/>: another name. */
static result_t add_alias(mitsuba_t *m, element_t *element)
{
    element_t *target = find_id(m, element_attribute(element, "id"));
    const char *name = element_attribute(element, "as");
    if (!target || !name) return error_at(element->at, "<alias> needs the id of an object above, and \"as\"");
    uint32_t known = (uint32_t)m->ids.count;
    TRY(add_id(m, element, name));
    m->by_id[known] = target;
    return result_ok();
}

static result_t collect(mitsuba_t *m, element_t *element)
{
    const char *id = element_attribute(element, "id");
    if (strcmp(element->tag, "alias") == 0) return add_alias(m, element);
    return id && strcmp(element->tag, "ref") != 0 ? add_id(m, element, id) : result_ok();
}

/* In the order of the file: a walk without recursion. */
result_t property_collect_ids(mitsuba_t *m)
{
    element_t *at = m->xml.root;
    while (at) {
        TRY(collect(m, at));
        if (at->first) {
            at = at->first;
            continue;
        }
        while (at && !at->next) at = at->parent;
        if (at) at = at->next;
    }
    return result_ok();
}

const char *object_type(const element_t *object)
{
    const char *type = element_attribute(object, "type");
    return type ? type : "";
}

/* The child itself, or what it refers to. */
static result_t follow(const mitsuba_t *m, element_t *child, element_t **target)
{
    *target = child;
    if (strcmp(child->tag, "ref") != 0) return result_ok();
    const char *id = element_attribute(child, "id");
    *target = find_id(m, id);
    if (*target) return result_ok();
    return error_at(child->at, "there is no object with the id \"%.60s\"", id ? id : "");
}

result_t object_child(mitsuba_t *m, const element_t *object, const char *tag, element_t **at,
                      element_t **found, const char **name)
{
    for (element_t *child = *at ? (*at)->next : object->first; child; child = child->next) {
        element_t *target;
        TRY(follow(m, child, &target));
        if (strcmp(target->tag, tag) != 0) continue;
        child->used = target->used = true;
        const char *given = element_attribute(child, "name");
        *name = given ? given : "";
        *at = child;
        *found = target;
        return result_ok();
    }
    *found = NULL;
    return result_ok();
}

result_t object_named(mitsuba_t *m, const element_t *object, const char *tag, const char *name,
                      element_t **found)
{
    for (element_t *child = object->first; child; child = child->next) {
        const char *given = element_attribute(child, "name");
        if (!given || strcmp(given, name) != 0) continue;
        TRY(follow(m, child, found));
        if (strcmp((*found)->tag, tag) != 0) continue;
        child->used = (*found)->used = true;
        return result_ok();
    }
    *found = NULL;
    return result_ok();
}

result_t object_only(mitsuba_t *m, const element_t *object, const char *tag, element_t **found)
{
    element_t *at = NULL;
    const char *name;
    return object_child(m, object, tag, &at, found, &name);
}

static bool is_property(const element_t *element)
{
    static const char *const tags[] = {"integer",   "float",     "boolean", "string",   "point", "vector",
                                       "transform", "animation", "rgb",     "spectrum", "srgb",  "blackbody"};
    for (size_t i = 0; i < ARRAY_LENGTH(tags); ++i)
        if (strcmp(element->tag, tags[i]) == 0) return true;
    return false;
}

static result_t tell_unused(const mitsuba_t *m, const element_t *object, const element_t *child)
{
    const char *name = element_attribute(child, "name"), *type = element_attribute(child, "type");
    const char *what = name ? name : type ? type : "", *of = object_type(object);
    if (is_property(child))
        return report_tolerate(m->report, child->at,
                               "%s \"%.60s\" means nothing in %s \"%.60s\": Mitsuba ignores it", child->tag,
                               what, object->tag, of);
    return report_refuse(m->report, child->at,
                         "%s \"%.60s\" is not supported in %s \"%.60s\"; the nearest is to leave it out",
                         child->tag, what, object->tag, of);
}

result_t object_finish(mitsuba_t *m, const element_t *object)
{
    static const char *const silent[] = {"default", "include", "alias"};
    for (const element_t *child = object->first; child; child = child->next) {
        bool told = child->used;
        for (size_t i = 0; i < ARRAY_LENGTH(silent); ++i) told = told || strcmp(child->tag, silent[i]) == 0;
        if (!told) TRY(tell_unused(m, object, child));
        if (child->replaced)
            TRY(report_tolerate(m->report, child->at,
                                "\"%.60s\" is given again below: Mitsuba takes the last",
                                element_attribute(child, "name")));
    }
    return result_ok();
}

element_t *property_find(const element_t *object, const char *name)
{
    element_t *found = NULL;
    for (element_t *child = object->first; child; child = child->next) {
        const char *given = element_attribute(child, "name");
        if (!given || strcmp(given, name) != 0) continue;
        if (found) found->replaced = true;
        child->used = true;
        found = child;
    }
    return found;
}

void property_ignore(const element_t *object, const char *name)
{
    property_find(object, name);
}

/* ---- numbers and words --------------------------------------------------------------------------------- */

static bool is_separator(char c)
{
    return c == ' ' || c == ',' || c == '\t' || c == '\n' || c == '\r';
}

/* Reads up to `most` numbers between blanks and commas; false when there is anything else, or more. */
static bool parse_numbers(const char *text, double *numbers, size_t most, size_t *count)
{
    const char *end = text + strlen(text);
    for (*count = 0;; ++*count) {
        while (is_separator(*text)) ++text;
        if (*text == '\0') return true;
        if (*count == most) return false;
        text = number_parse(text, end, &numbers[*count]);
        if (!text || (*text != '\0' && !is_separator(*text)) || fabs(numbers[*count]) > largest) return false;
    }
}

static result_t expect_tag(const element_t *element, const char *a, const char *b)
{
    if (strcmp(element->tag, a) == 0 || strcmp(element->tag, b) == 0) return result_ok();
    return error_at(element->at, "\"%.60s\" must be a %s, found %.60s", element_attribute(element, "name"), a,
                    element->tag);
}

static result_t number_attribute(const element_t *element, const char *name, double *value)
{
    size_t count;
    const char *text = element_attribute(element, name);
    if (text && parse_numbers(text, value, 1, &count) && count == 1) return result_ok();
    return error_at(element->at, "%s needs \"%s\", a number, found \"%.40s\"", element->tag, name,
                    text ? text : "");
}

result_t property_number(mitsuba_t *m, const element_t *object, const char *name, double low, double high,
                         double *value)
{
    (void)m;
    const element_t *found = property_find(object, name);
    double number;
    if (!found) return result_ok();
    TRY(expect_tag(found, "float", "integer"));
    TRY(number_attribute(found, "value", &number));
    if (!(number >= low && number <= high))
        return error_at(found->at, "%s is %g, but must lie between %g and %g", name, number, low, high);
    *value = number;
    return result_ok();
}

result_t property_bool(mitsuba_t *m, const element_t *object, const char *name, bool *value)
{
    (void)m;
    const element_t *found = property_find(object, name);
    if (!found) return result_ok();
    TRY(expect_tag(found, "boolean", "boolean"));
    const char *text = element_attribute(found, "value");
    *value = text && strcmp(text, "true") == 0;
    if (*value || (text && strcmp(text, "false") == 0)) return result_ok();
    return error_at(found->at, "%s must be true or false", name);
}

result_t property_string(mitsuba_t *m, const element_t *object, const char *name, const char **value)
{
    (void)m;
    const element_t *found = property_find(object, name);
    if (!found) return result_ok();
    TRY(expect_tag(found, "string", "string"));
    const char *text = element_attribute(found, "value");
    if (!text) return error_at(found->at, "%s needs a value", name);
    *value = text;
    return result_ok();
}

/* x, y and z as attributes; those that are missing stay. */
static result_t read_axes(const element_t *element, double value[3])
{
    static const char *const axes[] = {"x", "y", "z"};
    for (int i = 0; i < 3; ++i)
        if (element_attribute(element, axes[i])) TRY(number_attribute(element, axes[i], &value[i]));
    return result_ok();
}

result_t property_point(mitsuba_t *m, const element_t *object, const char *name, double value[3])
{
    (void)m;
    const element_t *found = property_find(object, name);
    if (!found) return result_ok();
    TRY(expect_tag(found, "point", "vector"));
    value[0] = value[1] = value[2] = 0;
    return read_axes(found, value);
}

/* ---- colours ------------------------------------------------------------------------------------------- */

/* One number, three, or #rrggbb. */
static result_t read_triple(const element_t *element, double c[3])
{
    const char *text = element_attribute(element, "value");
    size_t count = 0;
    if (text && text[0] == '#' && strlen(text) == 7 && strspn(text + 1, "0123456789abcdefABCDEF") == 6) {
        unsigned long bits = strtoul(text + 1, NULL, 16);
        for (int i = 0; i < 3; ++i) c[i] = (double)(bits >> (16 - 8 * i) & 255) / 255;
        return result_ok();
    }
    if (!text || !parse_numbers(text, c, 3, &count) || count == 0 || count == 2)
        return error_at(element->at, "%s needs a value of one number, three, or #rrggbb, found \"%.40s\"",
                        element->tag, text ? text : "");
    if (count == 1) c[1] = c[2] = c[0];
    return result_ok();
}

static rgb_t to_rgb(const double c[3])
{
    return vec3((float)fmin(fmax(c[0], 0), largest), (float)fmin(fmax(c[1], 0), largest),
                (float)fmin(fmax(c[2], 0), largest));
}

static result_t finish_spectrum(spectrum_t *spectrum, double scale, rgb_t *value)
{
    *value = v_scale(spectrum_colour(spectrum, SPECTRUM_EMISSION, SPECTRUM_PBRT_V3), (float)scale);
    spectrum_free(spectrum);
    return result_ok();
}

/* wavelength:value pairs. */
static result_t read_pairs(const element_t *element, const char *text, rgb_t *value)
{
    spectrum_t spectrum;
    char *copy = mem_strdup(text);
    for (char *c = copy; *c; ++c)
        if (*c == ':') *c = ' ';
    size_t most = strlen(copy) / 2 + 1, count;
    double *numbers = mem_alloc(most * sizeof *numbers);
    bool good = parse_numbers(copy, numbers, most, &count);
    free(copy);
    result_t result = good ? spectrum_from_pairs(numbers, count, element->at, &spectrum)
                           : error_at(element->at, "expected wavelength:value pairs");
    free(numbers);
    TRY(result);
    return finish_spectrum(&spectrum, 1, value);
}

static result_t read_spectrum(const element_t *element, rgb_t *value)
{
    const char *text = element_attribute(element, "value");
    const char *file = element_attribute(element, "filename");
    double c[3];
    spectrum_t spectrum;
    if (file) {
        char *path = element_path(element, file);
        result_t result = spectrum_read(path, &spectrum);
        free(path);
        if (result.code != RESULT_OK) return error_at(element->at, "%s", result.message);
        return finish_spectrum(&spectrum, 1, value);
    }
    if (text && strchr(text, ':')) return read_pairs(element, text, value);
    TRY(read_triple(element, c));
    *value = to_rgb(c);
    return result_ok();
}

/* Planck's law, in watts per square metre, steradian and nanometre. */
static result_t read_blackbody(const element_t *element, rgb_t *value)
{
    enum { SAMPLES = 95 };
    double kelvin = 0, scale = 1, pairs[2 * SAMPLES];
    spectrum_t spectrum;
    char text[32] = "";
    const char *given = element_attribute(element, "temperature");
    size_t length = given ? strspn(given, "0123456789.eE+-") : 0, count;
    if (length > 0 && length < sizeof text) memcpy(text, given, length);
    if (!parse_numbers(text, &kelvin, 1, &count) || !(kelvin >= 1 && kelvin <= 1e7))
        return error_at(element->at, "blackbody needs a temperature from 1 to 1e7 K");
    if (element_attribute(element, "scale")) TRY(number_attribute(element, "scale", &scale));
    for (int i = 0; i < SAMPLES; ++i) {
        double lambda = 360 + 5 * i, metres = lambda * 1e-9;
        pairs[2 * i] = lambda;
        pairs[2 * i + 1] =
            1.191042972e-16 / (pow(metres, 5) * expm1(0.01438776877 / (metres * kelvin))) * 1e-9;
    }
    TRY(spectrum_from_pairs(pairs, ARRAY_LENGTH(pairs), element->at, &spectrum));
    return finish_spectrum(&spectrum, fmax(scale, 0), value);
}

bool element_is_colour(const element_t *element)
{
    static const char *const tags[] = {"rgb", "srgb", "spectrum", "blackbody", "float"};
    for (size_t i = 0; i < ARRAY_LENGTH(tags); ++i)
        if (strcmp(element->tag, tags[i]) == 0) return true;
    return false;
}

result_t element_colour(mitsuba_t *m, const element_t *element, rgb_t *value)
{
    (void)m;
    double c[3];
    if (strcmp(element->tag, "spectrum") == 0) return read_spectrum(element, value);
    if (strcmp(element->tag, "blackbody") == 0) return read_blackbody(element, value);
    TRY(read_triple(element, c));
    for (int i = 0; i < 3 && strcmp(element->tag, "srgb") == 0; ++i) c[i] = scene_decode_srgb(c[i]);
    *value = to_rgb(c);
    return result_ok();
}

result_t property_colour(mitsuba_t *m, const element_t *object, const char *name, rgb_t *value)
{
    const element_t *found = property_find(object, name);
    if (!found) return result_ok();
    if (!element_is_colour(found))
        return error_at(found->at, "\"%s\" must be a colour (rgb, srgb, spectrum, blackbody), found %.60s",
                        name, found->tag);
    return element_colour(m, found, value);
}

/* ---- transforms ---------------------------------------------------------------------------------------- */

static result_t read_vector(const element_t *element, const char *name, double value[3])
{
    size_t count;
    const char *text = element_attribute(element, name);
    if (text && parse_numbers(text, value, 3, &count) && count == 3) return result_ok();
    return error_at(element->at, "%s needs \"%s\", three numbers", element->tag, name);
}

bool frame_towards(const double origin[3], const double target[3], const double *up, affine_t *frame)
{
    double across[3] = {0, 0, 0};
    int least = 0;
    affine_t view;
    for (int i = 1; i < 3; ++i)
        if (fabs(target[i] - origin[i]) < fabs(target[least] - origin[least])) least = i;
    across[least] = 1;
    return affine_look_at(origin, target, up ? up : across, &view) && affine_invert(&view, frame);
}

/* A frame at the origin that looks along +z, y up and x = y x z. */
static result_t read_look_at(const element_t *element, affine_t *out)
{
    double origin[3], target[3], up[3] = {0, 0, 0};
    TRY(read_vector(element, "origin", origin));
    TRY(read_vector(element, "target", target));
    if (element_attribute(element, "up")) TRY(read_vector(element, "up", up));
    bool given = up[0] != 0 || up[1] != 0 || up[2] != 0;
    if (frame_towards(origin, target, given ? up : NULL, out)) return result_ok();
    return error_at(element->at, "lookat has no direction, or \"up\" lies along it");
}

/* 16 numbers, row by row, or 9. */
static result_t read_matrix(const element_t *element, affine_t *out)
{
    double n[16], columns[16] = {0};
    size_t count;
    const char *text = element_attribute(element, "value");
    if (!text || !parse_numbers(text, n, 16, &count) || (count != 16 && count != 9))
        return error_at(element->at, "matrix needs a value of 16 numbers, or 9");
    size_t side = count == 16 ? 4 : 3;
    columns[15] = 1;
    for (size_t i = 0; i < side; ++i)
        for (size_t j = 0; j < side; ++j) columns[4 * j + i] = n[side * i + j];
    if (!affine_from_columns(columns, out))
        return error_at(element->at, "a projective matrix is not supported; its last row must be 0 0 0 1");
    return result_ok();
}

static result_t read_translation(const element_t *element, affine_t *out)
{
    double v[3] = {0, 0, 0};
    TRY(read_axes(element, v));
    *out = affine_translation(v);
    return result_ok();
}

static result_t read_rotation(const element_t *element, affine_t *out)
{
    double v[3] = {0, 0, 0}, angle = 0;
    TRY(read_axes(element, v));
    TRY(number_attribute(element, "angle", &angle));
    return affine_rotation(angle, v, out) ? result_ok() : error_at(element->at, "rotate needs an axis");
}

static result_t read_scaling(const element_t *element, affine_t *out)
{
    double v[3] = {1, 1, 1};
    if (element_attribute(element, "value")) TRY(number_attribute(element, "value", &v[0]));
    v[1] = v[2] = v[0];
    TRY(read_axes(element, v));
    *out = affine_scaling(v);
    return result_ok();
}

static result_t read_step(const element_t *element, affine_t *out)
{
    static const struct {
        const char *tag;
        result_t (*read)(const element_t *element, affine_t *out);
    } steps[] = {
        {"translate", read_translation}, {"rotate", read_rotation}, {"scale", read_scaling},
        {"lookat", read_look_at},        {"lookAt", read_look_at},  {"matrix", read_matrix},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(steps); ++i)
        if (strcmp(element->tag, steps[i].tag) == 0) return steps[i].read(element, out);
    return error_at(element->at,
                    "%.60s is no transform; it must be translate, rotate, scale, lookat or matrix",
                    element->tag);
}

static result_t read_transform(const element_t *element, affine_t *value)
{
    TRY(expect_tag(element, "transform", "transform"));
    *value = affine_identity();
    for (const element_t *step = element->first; step; step = step->next) {
        affine_t local;
        TRY(read_step(step, &local));
        *value = affine_multiply(&local, value);
    }
    return result_ok();
}

/* A transform of an animation. */
typedef struct {
    double time;
    affine_t transform;
} keyframe_t;

static int compare_times(const void *a, const void *b)
{
    double x = ((const keyframe_t *)a)->time, y = ((const keyframe_t *)b)->time;
    return (x > y) - (x < y);
}

static result_t read_keys(const element_t *animation, keyframe_t *keys, size_t count)
{
    const element_t *child = animation->first;
    for (size_t i = 0; i < count; ++i, child = child->next) {
        TRY(read_transform(child, &keys[i].transform));
        TRY(number_attribute(child, "time", &keys[i].time));
    }
    qsort(keys, count, sizeof *keys, compare_times);
    for (size_t i = 1; i < count; ++i)
        if (keys[i].time == keys[i - 1].time)
            return error_at(animation->at, "the animation has two transforms for the time %g", keys[i].time);
    return result_ok();
}

static affine_t transform_at(const keyframe_t *keys, size_t count, double time)
{
    affine_t between;
    size_t next = 0;
    while (next < count && keys[next].time < time) ++next;
    if (next == 0) return keys[0].transform;
    if (next == count) return keys[count - 1].transform;
    const keyframe_t *a = &keys[next - 1], *b = &keys[next];
    affine_interpolate(&a->transform, &b->transform, (time - a->time) / (b->time - a->time), &between);
    return between;
}

static result_t settle_animation(mitsuba_t *m, const element_t *animation, keyframe_t *keys, size_t count,
                                 affine_t motion[2])
{
    TRY(read_keys(animation, keys, count));
    for (int i = 0; i < 2; ++i) motion[i] = transform_at(keys, count, m->shutter[i]);
    for (size_t i = 0; i < count; ++i)
        if (m->shutter[0] < keys[i].time && keys[i].time < m->shutter[1])
            return report_refuse(m->report, animation->at,
                                 "an animation that turns while the shutter is open is not supported; the "
                                 "nearest is the straight way from where it is then to where it ends");
    return result_ok();
}

static result_t read_animation(mitsuba_t *m, const element_t *animation, affine_t motion[2])
{
    size_t count = 0;
    for (const element_t *child = animation->first; child; child = child->next) ++count;
    if (count == 0) return error_at(animation->at, "an animation needs transforms");
    keyframe_t *keys = mem_alloc(count * sizeof *keys);
    result_t result = settle_animation(m, animation, keys, count, motion);
    free(keys);
    return result;
}

result_t property_motion(mitsuba_t *m, const element_t *object, const char *name, affine_t motion[2])
{
    const element_t *found = property_find(object, name);
    motion[0] = motion[1] = affine_identity();
    if (!found) return result_ok();
    if (strcmp(found->tag, "animation") == 0) return read_animation(m, found, motion);
    TRY(read_transform(found, &motion[0]));
    motion[1] = motion[0];
    return result_ok();
}

bool motion_is_still(const affine_t motion[2])
{
    return memcmp(&motion[0], &motion[1], sizeof motion[0]) == 0;
}

result_t property_transform(mitsuba_t *m, const element_t *object, const char *name, affine_t *value)
{
    affine_t motion[2];
    TRY(property_motion(m, object, name, motion));
    *value = motion[0];
    if (motion_is_still(motion)) return result_ok();
    return report_refuse(m->report, object->at,
                         "%.20s \"%.40s\" that moves is not supported; the nearest is to stand still as "
                         "when the shutter opens",
                         object->tag, object_type(object));
}
