/* mitsuba: see mitsuba.h. */
#include "client/import/mitsuba/mitsuba.h"

#include <stdlib.h>
#include <string.h>

#include "client/import/mitsuba/daylight_emitter.h"
#include "client/import/mitsuba/emitter.h"
#include "client/import/mitsuba/sensor.h"
#include "client/import/mitsuba/shape.h"
#include "client/import/scene/scene_defaults.h"

/* Older and newer files have other names for the same things. */
static result_t check_version(mitsuba_t *m)
{
    const char *text = element_attribute(m->xml.root, "version");
    double version = text ? strtod(text, NULL) : 0.6;
    if (version < 0.4)
        return error_at(m->xml.root->at,
                        "is a scene of Mitsuba %.10s; open and save it with Mitsuba 0.6 first", text);
    if (version >= 1)
        return error_at(m->xml.root->at, "is a scene of Mitsuba %.10s; Lightmill reads those of 0.4 to 0.6",
                        text);
    return result_ok();
}

/* Calls `add` for all objects of a tag in the scene. */
static result_t add_all(mitsuba_t *m, const char *tag, result_t (*add)(mitsuba_t *, element_t *))
{
    element_t *at = NULL, *found;
    const char *name;
    for (;;) {
        TRY(object_child(m, m->xml.root, tag, &at, &found, &name));
        if (!found) return result_ok();
        TRY(add(m, found));
    }
}

/* bsdfs and textures stand in the scene to be referred to. */
static result_t leave(mitsuba_t *m, element_t *object)
{
    (void)m, (void)object;
    return result_ok();
}

/* So do media, which are of no use as long as no shape has one. */
static result_t ignore_medium(mitsuba_t *m, element_t *object)
{
    report_warning(m->report, object->at,
                   "%s \"%.40s\" is ignored: media are not supported, using it is an error", object->tag,
                   object_type(object));
    return result_ok();
}

/* Whether --camera asks for a sensor: by its id, or its number from 1. */
static bool is_wanted(const char *wanted, const element_t *sensor, size_t index)
{
    const char *id = element_attribute(sensor, "id");
    size_t number;
    if (id && strcmp(id, wanted) == 0) return true;
    return wishes_number(wanted, SIZE_MAX, &number) && number == index;
}

/* The sensor that --camera asks for, else the last, as in Mitsuba; NULL: there is none. */
static result_t find_sensor(mitsuba_t *m, element_t **sensor)
{
    const import_wishes_t *wishes = m->report->sink.wishes;
    const char *wanted = wishes ? wishes->camera : NULL, *name;
    element_t *at = NULL, *next;
    size_t count = 0;
    *sensor = NULL;
    for (;; ++count) {
        TRY(object_child(m, m->xml.root, "sensor", &at, &next, &name));
        if (!next) break;
        if (wanted && (*sensor || !is_wanted(wanted, next, count))) continue;
        if (*sensor)
            report_warning(m->report, (*sensor)->at,
                           "another sensor follows, which is taken instead; --camera takes this one");
        *sensor = next;
    }
    if (wanted && !*sensor)
        return result_fail(RESULT_USAGE, "--camera: the scene has no sensor '%.100s'; it has %zu", wanted,
                           count);
    return *sensor ? sensor_shutter(m, *sensor) : result_ok();
}

static result_t add_default_sensor(mitsuba_t *m)
{
    box_t box = scene_box(m->scene);
    report_warning(m->report, m->xml.root->at,
                   "the scene has no sensor: one that sees all of it is put in front of it, at -z");
    return sensor_default(m, &box);
}

static result_t read_integrator(mitsuba_t *m)
{
    element_t *integrator;
    TRY(object_only(m, m->xml.root, "integrator", &integrator));
    return sensor_integrator(m, integrator);
}

/* Mitsuba gives a scene that has no light a day of its own. */
static result_t add_default_light(mitsuba_t *m)
{
    if (scene_has_light(m->scene) || scene_gets_environment(m->scene)) return result_ok();
    report_warning(
        m->report, m->xml.root->at,
        "the scene has no light: a clear day lights it, as in Mitsuba; --environment takes another");
    return daylight_emitter_default(m, m->xml.root->at);
}

/* Other programs have files with a <scene>, too; Mitsuba asks for a version. */
static result_t expect_shapes(mitsuba_t *m)
{
    if (!element_attribute(m->xml.root, "version") && scene_is_empty(m->scene))
        return error_at(m->xml.root->at,
                        "the scene has neither a shape nor a version; is it one of Mitsuba?");
    return scene_expect_shapes(m->scene, m->xml.root->at);
}

/* How Mitsuba builds the tree over its shapes. */
static void ignore_tree(const mitsuba_t *m)
{
    for (element_t *child = m->xml.root->first; child; child = child->next) {
        const char *name = element_attribute(child, "name");
        if (name && strncmp(name, "kd", 2) == 0) child->used = true;
    }
}

static result_t add_scene(mitsuba_t *m)
{
    element_t *sensor;
    TRY(check_version(m));
    TRY(property_collect_ids(m));
    TRY(find_sensor(m, &sensor));
    TRY(add_all(m, "bsdf", leave));
    TRY(add_all(m, "texture", leave));
    TRY(add_all(m, "medium", ignore_medium));
    TRY(add_all(m, "phase", ignore_medium));
    TRY(add_all(m, "shape", shape_add));
    TRY(add_all(m, "emitter", emitter_add));
    TRY(expect_shapes(m));
    TRY(add_default_light(m));
    TRY(read_integrator(m));
    TRY(sensor ? sensor_read(m, sensor) : add_default_sensor(m));
    ignore_tree(m);
    TRY(object_finish(m, m->xml.root));
    return scene_finish(m->scene, &m->record, m->xml.root->at);
}

result_t mitsuba_import(const char *path, scene_builder_t *builder)
{
    mitsuba_t m = {.scene = builder, .report = builder->report, .record = blob_default_scene()};
    result_t result = xml_read(path, builder, &m.xml);
    if (result.code == RESULT_OK) result = add_scene(&m);
    xml_free(&m.xml);
    intern_free(&m.ids);
    free(m.by_id);
    free(m.materials);
    free(m.image_most);
    return result;
}
