/* scene_build: the blob's shapes and instances as Embree's trees.
 *
 * Meshes and curves share the blob's arrays with Embree, those of a mesh that changes one for each time;
 * quadrics are user geometry. Every object of the blob is an Embree scene; the world's holds its own shapes
 * (geometry id = shape index within the world) and then the instances. Shapes with an alpha, and pictures,
 * have filters that let rays through.
 */
#include "worker/render/scene/scene_internal.h"

static RTCGeometry new_mesh(const scene_t *scene, const blob_mesh_t *mesh)
{
    const scene_blob_t *blob = scene->blob;
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    uint32_t steps = mesh->steps ? mesh->steps : 1;
    if (steps > 1) rtcSetGeometryTimeStepCount(geometry, steps);
    for (uint32_t k = 0; k < steps; k++)
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, k, RTC_FORMAT_FLOAT3,
                                   blob->positions + mesh->first_position + (size_t)k * mesh->vertex_count, 0,
                                   sizeof(vec3_t), mesh->vertex_count);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               blob->triangles + mesh->first_triangle, 0, sizeof(blob_triangle_t),
                               mesh->triangle_count);
    return geometry;
}

static RTCGeometry new_curves(const scene_t *scene, const blob_curves_t *curves)
{
    const scene_blob_t *blob = scene->blob;
    static const enum RTCGeometryType types[] = {[CURVES_ROUND] = RTC_GEOMETRY_TYPE_ROUND_BEZIER_CURVE,
                                                 [CURVES_RIBBON] =
                                                     RTC_GEOMETRY_TYPE_NORMAL_ORIENTED_BEZIER_CURVE,
                                                 [CURVES_FIBRE] = RTC_GEOMETRY_TYPE_FLAT_BEZIER_CURVE,
                                                 [CURVES_FLAT_FIBRE] = RTC_GEOMETRY_TYPE_FLAT_BEZIER_CURVE};
    bool ribbon = curves->kind == CURVES_RIBBON;
    RTCGeometry geometry = rtcNewGeometry(scene->device, types[curves->kind]);
    /* As many straight pieces of a segment as are looked at together. */
    if (curves_are_fibres(curves->kind)) rtcSetGeometryTessellationRate(geometry, 8);
    size_t points = 4 * (size_t)curves->segment_count;
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4,
                               blob->curve_points + curves->first_point, 0, sizeof(blob_curve_point_t),
                               points);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT, scene->curve_indices, 0,
                               sizeof(uint32_t), curves->segment_count);
    if (ribbon)
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_NORMAL, 0, RTC_FORMAT_FLOAT3,
                                   blob->normals + curves->first_normal, 0, sizeof(vec3_t), points);
    return geometry;
}

static void attach(RTCScene scene, RTCGeometry geometry, uint32_t id)
{
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene, geometry, id);
    rtcReleaseGeometry(geometry);
}

static bool is_picture(const scene_blob_t *blob, const blob_shape_t *shape)
{
    return shape->light != BLOB_NONE && (blob->lights[shape->light].flags & LIGHT_PICTURE) != 0;
}

/* Notes a border of media, which goes to one of the objects. */
static void add_border(scene_t *scene, RTCScene to, RTCGeometry made, uint32_t id)
{
    if (to != scene->objects[0]) {
        scene->has_placed_borders = true;
        return;
    }
    if (scene->borders == NULL) scene->borders = rtcNewScene(scene->device);
    rtcCommitGeometry(made);
    rtcAttachGeometryByID(scene->borders, made, id);
}

static void add_shape(scene_t *scene, RTCScene to, uint32_t shape_index, uint32_t id)
{
    const blob_shape_t *shape = &scene->blob->shapes[shape_index];
    geometry_t *geometry = &scene->geometries[shape_index];
    *geometry = (geometry_t){.scene = scene,
                             .shape = shape,
                             .picture = is_picture(scene->blob, shape),
                             .border = scene->blob->materials[shape->material].kind == MATERIAL_INTERFACE};
    RTCGeometry made = NULL;
    switch ((shape_kind_t)shape->kind) {
    case SHAPE_MESH:
        made = new_mesh(scene, &scene->blob->meshes[shape->geometry]);
        scene->moves = scene->moves || scene->blob->meshes[shape->geometry].steps > 0;
        break;
    case SHAPE_QUADRIC:
        geometry->quadric = &scene->quadrics[shape->geometry];
        made = scene_new_quadric(scene);
        break;
    case SHAPE_CURVES:
        made = new_curves(scene, &scene->blob->curves[shape->geometry]);
        break;
    }
    rtcSetGeometryUserData(made, geometry);
    bool stops_all = alpha_is_opaque(&shape->alpha) && !geometry->picture;
    if (shape->kind == SHAPE_MESH && !stops_all)
        rtcSetGeometryIntersectFilterFunction(made, alpha_filter_nearest);
    if (shape->kind == SHAPE_MESH &&
        (!stops_all || geometry->border || !alpha_is_opaque(&shape->shadow_alpha)))
        rtcSetGeometryOccludedFilterFunction(made, alpha_filter_shadow);
    if (geometry->border) add_border(scene, to, made, id);
    attach(to, made, id);
}

static void set_key(RTCGeometry geometry, unsigned step, const motion_key_t *key)
{
    const float *s = key->stretch, *q = key->rotation;
    struct RTCQuaternionDecomposition split = {.scale_x = s[0],
                                               .skew_xy = s[1],
                                               .skew_xz = s[2],
                                               .scale_y = s[3],
                                               .skew_yz = s[4],
                                               .scale_z = s[5],
                                               .quaternion_r = q[0],
                                               .quaternion_i = q[1],
                                               .quaternion_j = q[2],
                                               .quaternion_k = q[3],
                                               .translation_x = key->translation.x,
                                               .translation_y = key->translation.y,
                                               .translation_z = key->translation.z};
    rtcSetGeometryTransformQuaternion(geometry, step, &split);
}

static void add_instances(scene_t *scene)
{
    const scene_blob_t *blob = scene->blob;
    scene->first_instance = blob->objects[0].shape_count;
    for (uint32_t i = 0; i < blob->counts[BLOB_SECTION_INSTANCES]; i++) {
        const blob_instance_t *record = &blob->instances[i];
        instance_t *instance = &scene->instances[i];
        instance_init(instance, record);
        RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(geometry, scene->objects[record->object]);
        if (instance->motion.moves) {
            scene->moves = true;
            rtcSetGeometryTimeStepCount(geometry, 2);
            for (unsigned k = 0; k < 2; k++) set_key(geometry, k, &instance->motion.keys[k]);
        } else {
            rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, record->world_from_object.m);
        }
        attach(scene->world, geometry, scene->first_instance + i);
        scene->reach = float_min(scene->reach, instance_reach(instance));
    }
}

void scene_build(scene_t *scene)
{
    const scene_blob_t *blob = scene->blob;
    /* The world comes last: its instances need their scenes committed. */
    for (uint64_t k = blob->counts[BLOB_SECTION_OBJECTS]; k-- > 0;) {
        const blob_object_t *object = &blob->objects[k];
        scene->objects[k] = rtcNewScene(scene->device);
        rtcSetSceneBuildQuality(scene->objects[k], RTC_BUILD_QUALITY_MEDIUM);
        for (uint32_t i = 0; i < object->shape_count; i++)
            add_shape(scene, scene->objects[k], object->first_shape + i, i);
        if (k == 0) {
            scene->world = scene->objects[0];
            add_instances(scene);
        }
        rtcCommitScene(scene->objects[k]);
    }
    if (scene->borders != NULL) rtcCommitScene(scene->borders);
    if (!scene->has_placed_borders) return;
    if (scene->borders != NULL) rtcReleaseScene(scene->borders);
    scene->borders = scene->world;
    rtcRetainScene(scene->borders);
}
