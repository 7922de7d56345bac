/* scene_defaults: see scene_defaults.h. */
#include "client/import/scene/scene_defaults.h"

#include <float.h>

#include "client/import/scene/scene_box.h"

void scene_default_light(scene_builder_t *scene, bool lamps, position_t at)
{
    if (scene_gets_environment(scene)) return;
    if (scene_has_light(scene)) {
        if (!lamps)
            report_warning(
                scene->report, at,
                "nothing lights the scene but its own surfaces that emit, so it may come out dark; "
                "--environment sky, or 1,1,1, or an image, gives it light from all around");
        return;
    }
    report_warning(
        scene->report, at,
        "the scene has no light: a white sky of radiance 1 lights it; --environment takes another");
    blob_light_t sky = {
        .kind = LIGHT_INFINITE, .radiance = blob_constant(1), .world_from_light = xform_identity()};
    blob_builder_add(scene->blob, BLOB_SECTION_LIGHTS, &sky, 1);
}

result_t scene_see_everything(const scene_builder_t *scene, blob_scene_t *record, position_t at)
{
    static const double degrees = 180 / 3.14159265358979323846;
    static const affine_t turn = {
        {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}}}; /* cameras look along their +z */
    box_t box = scene_box(scene);
    vec3_t low = v_scale(box.low, 0.5f), high = v_scale(box.high, 0.5f);
    vec3_t centre = v_add(low, high), from = v_normalize(vec3(0.4f, 0.3f, 1));
    float radius = float_max(v_length(v_sub(high, low)), FLT_MIN);
    double distance = (double)radius / sin((double)record->fov / 2 / degrees);
    vec3_t x = v_normalize(v_cross(vec3(0, 1, 0), from)), y = v_cross(from, x);
    double eye[3] = {(double)centre.x + distance * (double)from.x,
                     (double)centre.y + distance * (double)from.y,
                     (double)centre.z + distance * (double)from.z};
    affine_t frame = {{{(double)x.x, (double)y.x, (double)from.x, eye[0]},
                       {(double)x.y, (double)y.y, (double)from.y, eye[1]},
                       {(double)x.z, (double)y.z, (double)from.z, eye[2]}}};
    frame = affine_multiply(&frame, &turn);
    return scene_place_camera(record, &frame, &frame, at);
}

bool scene_is_empty(const scene_builder_t *scene)
{
    size_t count;
    scene_shapes(scene, 0, &count);
    return count == 0 && scene->object_count == 1;
}

result_t scene_expect_shapes(const scene_builder_t *scene, position_t at)
{
    if (!scene_is_empty(scene)) return result_ok();
    return report_tolerate(
        scene->report, at,
        "the scene has no shape that could be rendered: the picture shows its lights alone");
}
