/* scene_view: see scene_view.h. */
#include "client/import/scene/scene_view.h"

#include <stdlib.h>
#include <string.h>

#include "client/import/scene/scene_box.h"

/* ---- where an object is -------------------------------------------------------------------------------- */

static const void *records(const scene_builder_t *scene, blob_section_t section)
{
    return blob_builder_records(scene->blob, section);
}

/* Extends the box by the shapes of an object that have the name, NULL: all; returns how many they are. */
static uint32_t extend_by_object(const scene_builder_t *scene, box_t *box, uint32_t object, const char *name,
                                 const xform_t *world_from_object)
{
    const blob_object_t *objects = records(scene, BLOB_SECTION_OBJECTS);
    const blob_shape_t *shapes = records(scene, BLOB_SECTION_SHAPES);
    const char *strings = records(scene, BLOB_SECTION_STRINGS);
    uint32_t found = 0;
    for (uint32_t i = 0; i < objects[object].shape_count; ++i) {
        const blob_shape_t *shape = &shapes[objects[object].first_shape + i];
        if (name && strcmp(strings + shape->name, name) != 0) continue;
        box_extend(box, scene, shape, world_from_object);
        ++found;
    }
    return found;
}

/* Instances that have the name themselves go before those of objects whose shapes have it. */
static uint32_t extend_by_instances(const scene_builder_t *scene, box_t *box, const char *name)
{
    const blob_instance_t *instances = records(scene, BLOB_SECTION_INSTANCES);
    uint32_t places = 0;
    for (size_t i = 0; i < scene->focused_count; ++i) {
        const blob_instance_t *at = &instances[scene->focused[i]];
        extend_by_object(scene, box, at->object, NULL, &at->world_from_object);
    }
    if (scene->focused_count > 0) return (uint32_t)scene->focused_count;
    for (uint32_t i = 0; i < blob_builder_count(scene->blob, BLOB_SECTION_INSTANCES); ++i)
        places +=
            extend_by_object(scene, box, instances[i].object, name, &instances[i].world_from_object) > 0;
    return places;
}

static result_t find_object(const scene_builder_t *scene, const char *name, vec3_t *middle)
{
    const xform_t identity = xform_identity();
    box_t box = box_empty();
    bool in_world = extend_by_object(scene, &box, 0, name, &identity) > 0;
    uint32_t places = extend_by_instances(scene, &box, name);
    if (in_world && scene->focused_count == 0) ++places; /* else what emits of an instance */
    if (places == 0)
        return result_fail(
            RESULT_USAGE,
            "--focus takes a distance above 0 or the name of an object (of a glTF file a node's or "
            "a mesh's, of a pbrt file FILE:LINE of the shape, of a Mitsuba file its id); there is no "
            "'%.100s'",
            name);
    if (places > 1)
        return result_fail(RESULT_USAGE, "--focus: '%.100s' stands in %u places; give the distance", name,
                           places);
    *middle = v_add(v_scale(box.low, 0.5f), v_scale(box.high, 0.5f));
    return result_ok();
}

/* ---- the camera ---------------------------------------------------------------------------------------- */

static result_t focus_on_object(const scene_builder_t *scene, const char *name, blob_scene_t *record)
{
    vec3_t middle = vec3(0, 0, 0);
    xform_t camera_from_world;
    TRY(find_object(scene, name, &middle));
    if (!xform_invert(&record->world_from_camera, &camera_from_world))
        return result_ok(); /* it was checked */
    record->focal_distance = xform_point(&camera_from_world, middle).z;
    if (record->focal_distance > 0 && isfinite(record->focal_distance)) return result_ok();
    return result_fail(RESULT_USAGE, "--focus: '%.100s' lies behind the camera", name);
}

static result_t focus(scene_builder_t *scene, const char *text, blob_scene_t *record)
{
    char *end;
    double distance = strtod(text, &end);
    if (end == text || *end != '\0') return focus_on_object(scene, text, record);
    if (!(distance >= 1e-30 && distance <= 1e30))
        return result_fail(RESULT_USAGE,
                           "--focus takes a distance from 1e-30 to 1e30, or an object, not '%.100s'", text);
    record->focal_distance = (float)distance;
    return result_ok();
}

result_t scene_adjust_view(scene_builder_t *scene, const import_wishes_t *wishes)
{
    static const position_t option = {.path = "--focus"};
    blob_scene_t *record = blob_builder_records(scene->blob, BLOB_SECTION_SCENE);
    if (wishes->fov == 0 && wishes->lens_radius < 0 && !wishes->focus) return result_ok();
    bool orthographic = record->camera == CAMERA_ORTHOGRAPHIC;
    if (record->camera != CAMERA_PERSPECTIVE && !orthographic)
        return result_fail(RESULT_USAGE,
                           "--fov, --lens-radius and --focus are for perspective and orthographic cameras, "
                           "and this scene's is another");
    if (orthographic && wishes->fov > 0)
        return result_fail(RESULT_USAGE,
                           "--fov is for perspective cameras, and this scene's is orthographic, "
                           "which has no angle");
    bool had_lens = record->lens_radius > 0;
    if (wishes->fov > 0) record->fov = (float)wishes->fov;
    if (wishes->lens_radius >= 0) record->lens_radius = (float)wishes->lens_radius;
    if (wishes->focus) TRY(focus(scene, wishes->focus, record));
    if (record->lens_radius > 0 && !had_lens && !wishes->focus)
        return result_fail(RESULT_USAGE,
                           "--lens-radius needs --focus DISTANCE|OBJECT: the scene's camera has no "
                           "lens, and so no distance at which things are sharp");
    if (record->lens_radius == 0 && wishes->focus)
        report_warning(scene->report, option,
                       "the camera has no lens and shows everything sharp; --lens-radius opens one");
    return result_ok();
}
