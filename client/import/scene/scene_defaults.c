/* scene_defaults: see scene_defaults.h. */
#include "client/import/scene/scene_defaults.h"

#include <float.h>
#include <stdlib.h>

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

typedef struct {
    vec3_t low, high;
} box_t;

static void extend(box_t *box, vec3_t p)
{
    box->low = vec3(float_min(box->low.x, p.x), float_min(box->low.y, p.y), float_min(box->low.z, p.z));
    box->high = vec3(float_max(box->high.x, p.x), float_max(box->high.y, p.y), float_max(box->high.z, p.z));
}

static box_t object_box(const scene_builder_t *scene, uint32_t object)
{
    size_t count;
    const blob_shape_t *shapes = scene_shapes(scene, object, &count);
    const blob_mesh_t *meshes = blob_builder_records(scene->blob, BLOB_SECTION_MESHES);
    const vec3_t *positions = blob_builder_records(scene->blob, BLOB_SECTION_POSITIONS);
    box_t box = {vec3(FLT_MAX, FLT_MAX, FLT_MAX), vec3(-FLT_MAX, -FLT_MAX, -FLT_MAX)};
    for (size_t i = 0; i < count; ++i) {
        if (shapes[i].kind != SHAPE_MESH) continue;
        const blob_mesh_t *mesh = &meshes[shapes[i].geometry];
        for (uint32_t k = 0; k < mesh->vertex_count; ++k) extend(&box, positions[mesh->first_position + k]);
    }
    return box;
}

static void extend_by_instance(box_t *world, const box_t *box, const xform_t *transform)
{
    for (int i = 0; i < 8; ++i) {
        vec3_t p = vec3(i & 1 ? box->high.x : box->low.x, i & 2 ? box->high.y : box->low.y,
                        i & 4 ? box->high.z : box->low.z);
        p = xform_point(transform, p);
        if (v_is_finite(p)) extend(world, p);
    }
}

static box_t scene_box(const scene_builder_t *scene)
{
    const blob_instance_t *instances = blob_builder_records(scene->blob, BLOB_SECTION_INSTANCES);
    uint32_t count = blob_builder_count(scene->blob, BLOB_SECTION_INSTANCES);
    box_t *boxes = mem_zalloc(scene->object_count, sizeof *boxes);
    for (uint32_t i = 0; i < scene->object_count; ++i) boxes[i] = object_box(scene, i);
    for (uint32_t i = 0; i < count; ++i)
        extend_by_instance(&boxes[0], &boxes[instances[i].object], &instances[i].world_from_object);
    box_t world = boxes[0];
    free(boxes);
    return world;
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
