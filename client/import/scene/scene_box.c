/* scene_box: see scene_box.h. */
#include "client/import/scene/scene_box.h"

#include <float.h>
#include <stdlib.h>

box_t box_empty(void)
{
    return (box_t){vec3(FLT_MAX, FLT_MAX, FLT_MAX), vec3(-FLT_MAX, -FLT_MAX, -FLT_MAX)};
}

static void extend(box_t *box, const xform_t *world_from_object, vec3_t p)
{
    p = xform_point(world_from_object, p);
    if (!v_is_finite(p)) return;
    box->low = vec3(float_min(box->low.x, p.x), float_min(box->low.y, p.y), float_min(box->low.z, p.z));
    box->high = vec3(float_max(box->high.x, p.x), float_max(box->high.y, p.y), float_max(box->high.z, p.z));
}

static vec3_t corner(const box_t *box, int i)
{
    return vec3(i & 1 ? box->high.x : box->low.x, i & 2 ? box->high.y : box->low.y,
                i & 4 ? box->high.z : box->low.z);
}

static void extend_by_quadric(box_t *box, const blob_quadric_t *quadric, const xform_t *world_from_object)
{
    float r = quadric->radius, top = quadric->kind == QUADRIC_DISK ? quadric->z_min : quadric->z_max;
    const box_t own = {vec3(-r, -r, quadric->z_min), vec3(r, r, top)};
    for (int i = 0; i < 8; ++i)
        extend(box, world_from_object, xform_point(&quadric->object_from_quadric, corner(&own, i)));
}

static const void *records(const scene_builder_t *scene, blob_section_t section)
{
    return blob_builder_records(scene->blob, section);
}

void box_extend(box_t *box, const scene_builder_t *scene, const blob_shape_t *shape,
                const xform_t *world_from_object)
{
    const vec3_t *positions = records(scene, BLOB_SECTION_POSITIONS);
    const blob_curve_point_t *points = records(scene, BLOB_SECTION_CURVE_POINTS);
    if (shape->kind == SHAPE_MESH) {
        const blob_mesh_t *mesh = (const blob_mesh_t *)records(scene, BLOB_SECTION_MESHES) + shape->geometry;
        for (size_t i = 0; i < blob_mesh_places(mesh); ++i)
            extend(box, world_from_object, positions[mesh->first_position + i]);
    } else if (shape->kind == SHAPE_QUADRIC) {
        const blob_quadric_t *quadrics = records(scene, BLOB_SECTION_QUADRICS);
        extend_by_quadric(box, &quadrics[shape->geometry], world_from_object);
    } else {
        const blob_curves_t *curves =
            (const blob_curves_t *)records(scene, BLOB_SECTION_CURVES) + shape->geometry;
        for (uint32_t i = 0; i < 4 * curves->segment_count; ++i) {
            const blob_curve_point_t *p = &points[curves->first_point + i];
            extend(box, world_from_object, vec3(p->x, p->y, p->z));
        }
    }
}

/* In the object's own space. */
static box_t object_box(const scene_builder_t *scene, uint32_t object)
{
    const xform_t identity = xform_identity();
    size_t count;
    const blob_shape_t *shapes = scene_shapes(scene, object, &count);
    box_t box = box_empty();
    for (size_t i = 0; i < count; ++i) box_extend(&box, scene, &shapes[i], &identity);
    return box;
}

box_t scene_box(const scene_builder_t *scene)
{
    const blob_instance_t *instances = records(scene, BLOB_SECTION_INSTANCES);
    uint32_t count = blob_builder_count(scene->blob, BLOB_SECTION_INSTANCES);
    box_t *boxes = mem_alloc(scene->object_count * sizeof *boxes);
    for (uint32_t i = 0; i < scene->object_count; ++i) boxes[i] = object_box(scene, i);
    for (uint32_t i = 0; i < count; ++i) {
        const box_t *box = &boxes[instances[i].object];
        for (int k = 0; k < 8 && box->low.x <= box->high.x; ++k)
            extend(&boxes[0], &instances[i].world_from_object, corner(box, k));
    }
    box_t world = boxes[0];
    free(boxes);
    if (world.low.x > world.high.x) world = (box_t){vec3(-1, -1, -1), vec3(1, 1, 1)};
    return world;
}
