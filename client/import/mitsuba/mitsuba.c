/* mitsuba: see mitsuba.h. */
#include "client/import/mitsuba/mitsuba.h"

#include <stdlib.h>
#include <string.h>

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

static result_t read_sensor(mitsuba_t *m)
{
    element_t *at = NULL, *sensor, *second;
    const char *name;
    TRY(object_child(m, m->xml.root, "sensor", &at, &sensor, &name));
    if (!sensor && blob_builder_count(m->scene->blob, BLOB_SECTION_MESHES) == 0)
        return error_at(m->xml.root->at, "the scene has no sensor");
    if (!sensor) {
        report_warning(m->report, m->xml.root->at,
                       "the scene has no sensor: one that sees all of it is put in front of it");
        m->record.fov = 40;
        m->record.width = 768;
        m->record.height = 576;
        m->record.spp = 64;
        return scene_see_everything(m->scene, &m->record, m->xml.root->at);
    }
    TRY(sensor_read(m, sensor));
    TRY(object_child(m, m->xml.root, "sensor", &at, &second, &name));
    if (second) report_warning(m->report, second->at, "the scene has several sensors; the first is taken");
    return add_all(m, "sensor", leave);
}

static result_t read_integrator(mitsuba_t *m)
{
    element_t *integrator;
    m->record.max_depth = 100;
    TRY(object_only(m, m->xml.root, "integrator", &integrator));
    return integrator ? sensor_integrator(m, integrator) : result_ok();
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
    size_t shapes;
    TRY(check_version(m));
    TRY(property_collect_ids(m));
    TRY(add_all(m, "bsdf", leave));
    TRY(add_all(m, "texture", leave));
    TRY(add_all(m, "shape", shape_add));
    TRY(add_all(m, "emitter", emitter_add));
    scene_shapes(m->scene, 0, &shapes);
    if (shapes == 0 && m->scene->object_count == 1)
        return error_at(m->xml.root->at, "the scene has no shape that could be rendered");
    scene_default_light(m->scene, true, m->xml.root->at);
    TRY(read_integrator(m));
    TRY(read_sensor(m));
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
    return result;
}
