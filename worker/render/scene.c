/* scene: Embree set-up and ray queries (see scene.h).
 *
 * Meshes share the blob's vertex and index arrays with Embree. Spheres are user geometry, solved in double
 * precision in their own space, so that light refracted through one meets it exactly. Every object of the
 * blob is an Embree scene; the world's holds its own shapes (geometry id = shape index within the world) and
 * then the instances.
 *
 * The device is pinned to one instruction set and builds on the calling thread alone: which of two triangles
 * at exactly the same distance is hit depends on the tree, so the tree must not depend on the machine.
 */
#include "worker/render/scene.h"

#include <stdlib.h>
#include <string.h>

#define EMBREE_CONFIG "isa=avx2,threads=1,start_threads=0,set_affinity=0"

/* What the sphere callbacks need. */
typedef struct {
    xform_t sphere_from_object, object_from_sphere;
    float radius;
} sphere_t;

struct scene {
    const scene_blob_t *blob;
    RTCDevice device;
    RTCScene world;
    RTCScene *objects;          /* [objects]; objects[0] is the world */
    sphere_t *spheres;          /* [spheres] */
    xform_t *object_from_world; /* [instances] */
    uint32_t first_instance;    /* geometry id of instance 0 in the world */
};

/* ---- spheres ------------------------------------------------------------------------------------------- */

static void sphere_bounds(const struct RTCBoundsFunctionArguments *arguments)
{
    const sphere_t *sphere = arguments->geometryUserPtr;
    float low[3], high[3];
    for (int i = 0; i < 3; i++) {
        const float *row = sphere->object_from_sphere.m[i];
        /* The extent of an ellipsoid along an axis is the length of that row; rounded outward. */
        float extent = sphere->radius * sqrtf(row[0] * row[0] + row[1] * row[1] + row[2] * row[2]) * 1.00001f;
        low[i] = row[3] - extent - fabsf(row[3]) * 1e-6f;
        high[i] = row[3] + extent + fabsf(row[3]) * 1e-6f;
    }
    *arguments->bounds_o = (struct RTCBounds){.lower_x = low[0],
                                              .lower_y = low[1],
                                              .lower_z = low[2],
                                              .upper_x = high[0],
                                              .upper_y = high[1],
                                              .upper_z = high[2]};
}

/* Distance along the ray to the first crossing within (near, far), or a negative number. */
static float sphere_distance(const sphere_t *sphere, vec3_t origin, vec3_t direction, float near, float far)
{
    vec3_t o = xform_point(&sphere->sphere_from_object, origin);
    vec3_t d = xform_vector(&sphere->sphere_from_object, direction);
    double a = (double)d.x * d.x + (double)d.y * d.y + (double)d.z * d.z;
    double b = (double)d.x * o.x + (double)d.y * o.y + (double)d.z * o.z;
    /* The discriminant from the ray's closest point to the centre: no cancellation (Haines et al. 2019,
     * "Precision Improvements for Ray/Sphere Intersection"). */
    double t = -b / a, r = sphere->radius;
    double cx = o.x + t * d.x, cy = o.y + t * d.y, cz = o.z + t * d.z;
    double left = r * r - (cx * cx + cy * cy + cz * cz);
    if (!(left >= 0)) return -1;
    double half = sqrt(left / a);
    float first = (float)(t - half), second = (float)(t + half);
    if (first > near && first < far) return first;
    return second > near && second < far ? second : -1;
}

/* Rows of Embree's packet layout, N lanes each (RTCRayN and RTCHitN; their accessors are C++ only). */
enum { RAY_ORIGIN = 0, RAY_NEAR = 3, RAY_DIRECTION = 4, RAY_FAR = 8, RAY_ROWS = 12 };
enum { HIT_U = 3, HIT_V = 4, HIT_PRIMITIVE = 5, HIT_GEOMETRY = 6, HIT_INSTANCE = 7 };

static float lane_distance(const sphere_t *sphere, const float *rays, unsigned n, unsigned i)
{
    const float *o = rays + RAY_ORIGIN * n + i, *d = rays + RAY_DIRECTION * n + i;
    return sphere_distance(sphere, vec3(o[0], o[n], o[2 * n]), vec3(d[0], d[n], d[2 * n]),
                           rays[RAY_NEAR * n + i], rays[RAY_FAR * n + i]);
}

static void sphere_intersect(const struct RTCIntersectFunctionNArguments *arguments)
{
    const sphere_t *sphere = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    float *rays = (float *)arguments->rayhit, *hit_floats = rays + RAY_ROWS * n;
    unsigned *hit_ids = (unsigned *)hit_floats;
    for (unsigned i = 0; i < n; i++) {
        float t = arguments->valid[i] == -1 ? lane_distance(sphere, rays, n, i) : -1;
        if (t < 0) continue;
        rays[RAY_FAR * n + i] = t;
        hit_floats[HIT_U * n + i] = hit_floats[HIT_V * n + i] = 0;
        hit_ids[HIT_PRIMITIVE * n + i] = arguments->primID;
        hit_ids[HIT_GEOMETRY * n + i] = arguments->geomID;
        hit_ids[HIT_INSTANCE * n + i] = arguments->context->instID[0];
    }
}

static void sphere_occluded(const struct RTCOccludedFunctionNArguments *arguments)
{
    const sphere_t *sphere = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    float *rays = (float *)arguments->ray;
    for (unsigned i = 0; i < n; i++)
        if (arguments->valid[i] == -1 && lane_distance(sphere, rays, n, i) >= 0)
            rays[RAY_FAR * n + i] = -INFINITY;
}

/* ---- building ------------------------------------------------------------------------------------------ */

static void attach(RTCScene scene, RTCGeometry geometry, uint32_t id)
{
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene, geometry, id);
    rtcReleaseGeometry(geometry);
}

static void add_mesh(scene_t *scene, RTCScene to, const blob_mesh_t *mesh, uint32_t id)
{
    const scene_blob_t *blob = scene->blob;
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               blob->positions + mesh->first_position, 0, sizeof(vec3_t), mesh->vertex_count);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               blob->triangles + mesh->first_triangle, 0, sizeof(blob_triangle_t),
                               mesh->triangle_count);
    attach(to, geometry, id);
}

static void add_sphere(scene_t *scene, RTCScene to, uint32_t index, uint32_t id)
{
    const blob_sphere_t *from = &scene->blob->spheres[index];
    sphere_t *sphere = &scene->spheres[index];
    *sphere = (sphere_t){.object_from_sphere = from->object_from_sphere, .radius = from->radius};
    xform_invert(&from->object_from_sphere, &sphere->sphere_from_object);
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry, 1);
    rtcSetGeometryUserData(geometry, sphere);
    rtcSetGeometryBoundsFunction(geometry, sphere_bounds, NULL);
    rtcSetGeometryIntersectFunction(geometry, sphere_intersect);
    rtcSetGeometryOccludedFunction(geometry, sphere_occluded);
    attach(to, geometry, id);
}

static void add_shapes(scene_t *scene, uint32_t object_index)
{
    const scene_blob_t *blob = scene->blob;
    const blob_object_t *object = &blob->objects[object_index];
    for (uint32_t i = 0; i < object->shape_count; i++) {
        const blob_shape_t *shape = &blob->shapes[object->first_shape + i];
        if (shape->kind == SHAPE_MESH)
            add_mesh(scene, scene->objects[object_index], &blob->meshes[shape->geometry], i);
        else
            add_sphere(scene, scene->objects[object_index], shape->geometry, i);
    }
}

static void add_instances(scene_t *scene)
{
    const scene_blob_t *blob = scene->blob;
    scene->first_instance = blob->objects[0].shape_count;
    for (uint32_t i = 0; i < blob->counts[BLOB_SECTION_INSTANCES]; i++) {
        const blob_instance_t *instance = &blob->instances[i];
        xform_invert(&instance->world_from_object, &scene->object_from_world[i]);
        RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(geometry, scene->objects[instance->object]);
        rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, instance->world_from_object.m);
        attach(scene->world, geometry, scene->first_instance + i);
    }
}

result_t scene_new(const scene_blob_t *blob, scene_t **result)
{
    *result = NULL;
    scene_t *scene = mem_zalloc(1, sizeof *scene);
    scene->blob = blob;
    scene->device = rtcNewDevice(EMBREE_CONFIG);
    if (scene->device == NULL) {
        free(scene);
        return result_fail(RESULT_LIMIT, "Embree cannot start (error %d); this needs an x86-64-v3 processor",
                           (int)rtcGetDeviceError(NULL));
    }
    uint64_t objects = blob->counts[BLOB_SECTION_OBJECTS];
    scene->objects = mem_zalloc(objects, sizeof *scene->objects);
    scene->spheres = mem_zalloc(blob->counts[BLOB_SECTION_SPHERES] + 1, sizeof *scene->spheres);
    scene->object_from_world =
        mem_zalloc(blob->counts[BLOB_SECTION_INSTANCES] + 1, sizeof *scene->object_from_world);
    /* The world comes last: its instances need their scenes committed. */
    for (uint64_t k = objects; k-- > 0;) {
        scene->objects[k] = rtcNewScene(scene->device);
        rtcSetSceneBuildQuality(scene->objects[k], RTC_BUILD_QUALITY_MEDIUM);
        add_shapes(scene, (uint32_t)k);
        if (k == 0) {
            scene->world = scene->objects[0];
            add_instances(scene);
        }
        rtcCommitScene(scene->objects[k]);
    }
    enum RTCError error = rtcGetDeviceError(scene->device);
    if (error != RTC_ERROR_NONE) {
        scene_destroy(&scene);
        return result_fail(RESULT_LIMIT, "Embree could not build the scene (error %d)%s", (int)error,
                           error == RTC_ERROR_OUT_OF_MEMORY ? ": out of memory" : "");
    }
    *result = scene;
    return result_ok();
}

void scene_destroy(scene_t **scene)
{
    scene_t *self = *scene;
    if (self == NULL) return;
    for (uint64_t k = 0; k < self->blob->counts[BLOB_SECTION_OBJECTS]; k++) rtcReleaseScene(self->objects[k]);
    rtcReleaseDevice(self->device);
    free(self->objects);
    free(self->spheres);
    free(self->object_from_world);
    free(self);
    *scene = NULL;
}

const scene_blob_t *scene_blob(const scene_t *scene)
{
    return scene->blob;
}

/* ---- hits ---------------------------------------------------------------------------------------------- */

/* The tangent along which u grows, from the triangle's uvs; zero where there are none or they are degenerate.
 */
static vec3_t mesh_tangent(const scene_blob_t *blob, const blob_mesh_t *mesh, const uint32_t v[3], vec3_t e1,
                           vec3_t e2)
{
    if (mesh->first_uv == BLOB_NONE) return vec3(0, 0, 0);
    const vec2_t *uv = blob->uvs + mesh->first_uv;
    float u1 = uv[v[1]].x - uv[v[0]].x, v1 = uv[v[1]].y - uv[v[0]].y;
    float u2 = uv[v[2]].x - uv[v[0]].x, v2 = uv[v[2]].y - uv[v[0]].y;
    float determinant = u1 * v2 - u2 * v1;
    if (determinant == 0) return vec3(0, 0, 0);
    return v_scale(v_sub(v_scale(e1, v2), v_scale(e2, v1)), 1 / determinant);
}

/* Fills p, ng, ns and tangent in the object's space; normals need not have unit length yet. */
static void mesh_surface(const scene_blob_t *blob, const blob_shape_t *shape, uint32_t primitive, float b1,
                         float b2, surface_t *surface)
{
    const blob_mesh_t *mesh = &blob->meshes[shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + primitive].v;
    const vec3_t *p = blob->positions + mesh->first_position;
    vec3_t e1 = v_sub(p[v[1]], p[v[0]]), e2 = v_sub(p[v[2]], p[v[0]]);
    float b0 = 1 - b1 - b2;
    surface->p = v_add(v_add(v_scale(p[v[0]], b0), v_scale(p[v[1]], b1)), v_scale(p[v[2]], b2));
    surface->ng = v_cross(e1, e2);
    if (mesh->first_normal != BLOB_NONE) {
        const vec3_t *n = blob->normals + mesh->first_normal;
        surface->ns = v_add(v_add(v_scale(n[v[0]], b0), v_scale(n[v[1]], b1)), v_scale(n[v[2]], b2));
        if (v_is_zero(surface->ns)) surface->ns = surface->ng;
        if (v_dot(surface->ns, surface->ng) < 0) surface->ng = v_neg(surface->ng);
    } else {
        if (shape->flags & SHAPE_FLIP) surface->ng = v_neg(surface->ng);
        surface->ns = surface->ng;
    }
    surface->tangent = vec3(0, 0, 0);
    if (surface->material->alpha_u != surface->material->alpha_v)
        surface->tangent = mesh_tangent(blob, mesh, v, e1, e2);
}

/* As mesh_surface, for the point of a sphere nearest to `hit` (object space). */
static void sphere_surface(const sphere_t *sphere, const blob_shape_t *shape, vec3_t hit, surface_t *surface)
{
    vec3_t local = v_normalize(xform_point(&sphere->sphere_from_object, hit));
    surface->p = xform_point(&sphere->object_from_sphere, v_scale(local, sphere->radius));
    surface->ng = xform_normal(&sphere->sphere_from_object, local);
    if (shape->flags & SHAPE_FLIP) surface->ng = v_neg(surface->ng);
    surface->ns = surface->ng;
    surface->tangent = xform_vector(&sphere->object_from_sphere, vec3(-local.y, local.x, 0));
}

/* Embree's nearest hit along a ray; false when there is none. */
static bool nearest_hit(const scene_t *scene, vec3_t origin, vec3_t direction, struct RTCRayHit *query)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    *query =
        (struct RTCRayHit){.ray = {.org_x = origin.x,
                                   .org_y = origin.y,
                                   .org_z = origin.z,
                                   .tnear = 0,
                                   .dir_x = direction.x,
                                   .dir_y = direction.y,
                                   .dir_z = direction.z,
                                   .tfar = INFINITY,
                                   .mask = 0xFFFFFFFFu},
                           .hit = {.geomID = RTC_INVALID_GEOMETRY_ID, .instID = {RTC_INVALID_GEOMETRY_ID}}};
    rtcIntersect1(scene->world, &context, query);
    return query->hit.geomID != RTC_INVALID_GEOMETRY_ID;
}

bool scene_probe(const scene_t *scene, vec3_t origin, vec3_t direction)
{
    struct RTCRayHit query;
    return nearest_hit(scene, origin, direction, &query);
}

bool scene_intersect(const scene_t *scene, vec3_t origin, vec3_t direction, surface_t *surface)
{
    struct RTCRayHit query;
    if (!nearest_hit(scene, origin, direction, &query)) return false;
    const scene_blob_t *blob = scene->blob;
    bool instanced = query.hit.instID[0] != RTC_INVALID_GEOMETRY_ID;
    uint32_t instance = instanced ? query.hit.instID[0] - scene->first_instance : 0;
    const blob_object_t *object = &blob->objects[instanced ? blob->instances[instance].object : 0];
    const blob_shape_t *shape = &blob->shapes[object->first_shape + query.hit.geomID];
    surface->material = &blob->materials[shape->material];
    surface->light = shape->light;
    if (shape->kind == SHAPE_MESH) {
        mesh_surface(blob, shape, query.hit.primID, query.hit.u, query.hit.v, surface);
    } else {
        vec3_t hit = v_mad(origin, query.ray.tfar, direction);
        if (instanced) hit = xform_point(&scene->object_from_world[instance], hit);
        sphere_surface(&scene->spheres[shape->geometry], shape, hit, surface);
    }
    if (instanced) {
        const xform_t *world = &blob->instances[instance].world_from_object;
        surface->p = xform_point(world, surface->p);
        surface->ng = xform_normal(&scene->object_from_world[instance], surface->ng);
        surface->ns = xform_normal(&scene->object_from_world[instance], surface->ns);
        surface->tangent = xform_vector(world, surface->tangent);
    }
    bool smooth =
        surface->ns.x != surface->ng.x || surface->ns.y != surface->ng.y || surface->ns.z != surface->ng.z;
    surface->ng = v_normalize(surface->ng);
    surface->ns = smooth ? v_normalize(surface->ns) : surface->ng;
    surface->offset = scene_offset_at(surface->p);
    return true;
}

/* Segments end just short of their target, which lies off its surface by more than that. */
static const float segment_end = 1.0f - 0x1p-20f;

bool scene_occluded(const scene_t *scene, vec3_t from, vec3_t to)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    vec3_t d = v_sub(to, from);
    struct RTCRay ray = {.org_x = from.x,
                         .org_y = from.y,
                         .org_z = from.z,
                         .tnear = 0,
                         .dir_x = d.x,
                         .dir_y = d.y,
                         .dir_z = d.z,
                         .tfar = segment_end,
                         .mask = 0xFFFFFFFFu};
    rtcOccluded1(scene->world, &context, &ray);
    return ray.tfar < 0;
}

uint32_t scene_occluded_packet(const scene_t *scene, const segments_t *segments)
{
    if (segments->count == 1) return scene_occluded(scene, segments->from[0], segments->to[0]);
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRay8 rays;
    _Alignas(32) int valid[SCENE_PACKET];
    for (int i = 0; i < SCENE_PACKET; i++) {
        int k = i < segments->count ? i : 0;
        vec3_t o = segments->from[k], d = v_sub(segments->to[k], o);
        valid[i] = i < segments->count ? -1 : 0;
        rays.org_x[i] = o.x, rays.org_y[i] = o.y, rays.org_z[i] = o.z;
        rays.dir_x[i] = d.x, rays.dir_y[i] = d.y, rays.dir_z[i] = d.z;
        rays.tnear[i] = 0, rays.tfar[i] = segment_end, rays.time[i] = 0;
        rays.mask[i] = 0xFFFFFFFFu, rays.id[i] = 0, rays.flags[i] = 0;
    }
    rtcOccluded8(valid, scene->world, &context, &rays);
    uint32_t occluded = 0;
    for (int i = 0; i < segments->count; i++) occluded |= (uint32_t)(rays.tfar[i] < 0) << i;
    return occluded;
}
