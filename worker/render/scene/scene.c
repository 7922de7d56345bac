/* scene: Embree set-up and ray queries (see scene.h).
 *
 * Meshes and curves share the blob's arrays with Embree; quadrics are user geometry. Every object of the blob
 * is an Embree scene; the world's holds its own shapes (geometry id = shape index within the world) and then
 * the instances. Shapes with an alpha have filters that let rays through.
 *
 * The device is pinned to one instruction set and builds on the calling thread alone: which of two triangles
 * at exactly the same distance is hit depends on the tree, so the tree must not depend on the machine.
 */
#include "worker/render/scene/scene.h"

#include "common/sampler.h"
#include "worker/render/scene/motion.h"
#include "worker/render/scene/quadric.h"

#include <stdlib.h>
#include <string.h>

#define EMBREE_CONFIG "isa=avx2,threads=1,start_threads=0,set_affinity=0"

/* What Embree's callbacks need to know of a shape. */
typedef struct {
    const scene_t *scene;
    const blob_shape_t *shape;
    const quadric_t *quadric; /* or NULL */
} geometry_t;

/* The transforms of an instance at a time. */
typedef struct {
    xform_t world_from_object, object_from_world;
} placement_t;

typedef struct {
    motion_t motion;
    placement_t still; /* at time 0 */
} instance_t;

struct scene {
    const scene_blob_t *blob;
    textures_t *textures;
    bool *varies; /* [materials] */
    RTCDevice device;
    RTCScene world;
    RTCScene *objects;       /* [objects]; objects[0] is the world */
    geometry_t *geometries;  /* [shapes] */
    quadric_t *quadrics;     /* [quadrics] */
    instance_t *instances;   /* [instances] */
    uint32_t *curve_indices; /* 0, 4, 8, ... for the longest set of curves */
    uint32_t first_instance; /* geometry id of instance 0 in the world */
    bool moves;
    float reach; /* coordinates of rays must stay below it: see reach_of */
};

/* ---- alpha --------------------------------------------------------------------------------------------- */

static bool is_opaque(const blob_value_t *alpha)
{
    return alpha->texture == 0 && alpha->factor.x >= 1;
}

/* What of a hit decides whether it counts. */
typedef struct {
    vec3_t origin, direction;
    float time;
    uint32_t instance_id, primitive;
    vec2_t place;
    float distance;
} hit_t;

/* A uniform number that is a function of the ray and of what it hits alone. */
static float hit_number(const hit_t *hit, uint32_t shape)
{
    uint32_t words[9];
    memcpy(words, &hit->origin, sizeof hit->origin);
    memcpy(words + 3, &hit->direction, sizeof hit->direction);
    words[6] = hit->primitive;
    words[7] = hit->instance_id;
    words[8] = shape;
    uint64_t key = 0;
    for (int i = 0; i < 9; i++) key = sampler_mix(key + words[i] + 0x9E3779B97F4A7C15u);
    return sampler_float((uint32_t)key);
}

static bool fill_surface(const scene_t *scene, const blob_shape_t *shape, const hit_t *hit, bool local,
                         vec3_t ng, surface_t *surface);

/* True when the shape stops the ray at the hit. */
static bool stops(const geometry_t *geometry, const hit_t *hit, bool shadow)
{
    const blob_shape_t *shape = geometry->shape;
    surface_t surface;
    surface_details_t details;
    if (!fill_surface(geometry->scene, shape, hit, true, vec3(0, 0, 1), &surface)) return true;
    scene_details(geometry->scene, &surface, &details);
    texture_point_t at = {details.uv, details.uv2, surface.p, surface.ns, details.colour};
    float alpha = textures_value(geometry->scene->textures, &shape->alpha, &at).x;
    if (shape->flags & SHAPE_CUTOUT && alpha != 0) alpha = 1;
    if (shadow && !is_opaque(&shape->shadow_alpha)) {
        float more = textures_value(geometry->scene->textures, &shape->shadow_alpha, &at).x;
        alpha *= shape->flags & SHAPE_CUTOUT && more != 0 ? 1 : more;
    }
    uint32_t index = (uint32_t)(shape - geometry->scene->blob->shapes);
    return alpha >= 1 || (alpha > 0 && hit_number(hit, index) < alpha);
}

/* Rows of Embree's packet layout, N lanes each (RTCRayN and RTCHitN; their accessors are C++ only). */
enum { RAY_ORIGIN = 0, RAY_NEAR = 3, RAY_DIRECTION = 4, RAY_TIME = 7, RAY_FAR = 8, RAY_ROWS = 12 };
enum { HIT_U = 3, HIT_V = 4, HIT_PRIMITIVE = 5, HIT_GEOMETRY = 6, HIT_INSTANCE = 7 };

/* The ray of a lane, in the space of the scene that is traced. */
static hit_t lane_hit(const float *rays, unsigned n, unsigned i)
{
    const float *o = rays + RAY_ORIGIN * n + i, *d = rays + RAY_DIRECTION * n + i;
    return (hit_t){.origin = vec3(o[0], o[n], o[2 * n]),
                   .direction = vec3(d[0], d[n], d[2 * n]),
                   .time = rays[RAY_TIME * n + i],
                   .distance = rays[RAY_FAR * n + i]};
}

static void filter(const struct RTCFilterFunctionNArguments *arguments, bool shadow)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    const float *floats = (const float *)arguments->hit;
    const uint32_t *ids = (const uint32_t *)arguments->hit;
    for (unsigned i = 0; i < n; i++) {
        if (arguments->valid[i] != -1) continue;
        hit_t hit = lane_hit((const float *)arguments->ray, n, i);
        hit.place = (vec2_t){floats[HIT_U * n + i], floats[HIT_V * n + i]};
        hit.primitive = ids[HIT_PRIMITIVE * n + i];
        hit.instance_id = ids[HIT_INSTANCE * n + i];
        if (!stops(geometry, &hit, shadow)) arguments->valid[i] = 0;
    }
}

static void filter_nearest(const struct RTCFilterFunctionNArguments *arguments)
{
    filter(arguments, false);
}

static void filter_shadow(const struct RTCFilterFunctionNArguments *arguments)
{
    filter(arguments, true);
}

/* ---- quadrics ------------------------------------------------------------------------------------------ */

static void bounds_of_quadric(const struct RTCBoundsFunctionArguments *arguments)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    float low[3], high[3];
    quadric_bounds(geometry->quadric, low, high);
    *arguments->bounds_o = (struct RTCBounds){.lower_x = low[0],
                                              .lower_y = low[1],
                                              .lower_z = low[2],
                                              .upper_x = high[0],
                                              .upper_y = high[1],
                                              .upper_z = high[2]};
}

/* Distance along the lane's ray to the first crossing that counts, or a negative number. */
static float lane_distance(const geometry_t *geometry, const float *rays, unsigned n, unsigned i,
                           uint32_t instance_id, bool shadow)
{
    hit_t hit = lane_hit(rays, n, i);
    float near = rays[RAY_NEAR * n + i], far = hit.distance, distances[2];
    int count = quadric_crossings(geometry->quadric, hit.origin, hit.direction, distances);
    bool opaque =
        is_opaque(&geometry->shape->alpha) && (!shadow || is_opaque(&geometry->shape->shadow_alpha));
    hit.instance_id = instance_id;
    for (int k = 0; k < count; k++) {
        if (!(distances[k] > near && distances[k] < far)) continue;
        hit.distance = distances[k];
        hit.primitive = (uint32_t)k; /* draws another number at the far side */
        if (opaque || stops(geometry, &hit, shadow)) return distances[k];
    }
    return -1;
}

static void intersect_quadric(const struct RTCIntersectFunctionNArguments *arguments)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    float *rays = (float *)arguments->rayhit, *hit_floats = rays + RAY_ROWS * n;
    unsigned *hit_ids = (unsigned *)hit_floats;
    for (unsigned i = 0; i < n; i++) {
        if (arguments->valid[i] != -1) continue;
        float t = lane_distance(geometry, rays, n, i, arguments->context->instID[0], false);
        if (t < 0) continue;
        rays[RAY_FAR * n + i] = t;
        hit_floats[HIT_U * n + i] = hit_floats[HIT_V * n + i] = 0;
        hit_ids[HIT_PRIMITIVE * n + i] = arguments->primID;
        hit_ids[HIT_GEOMETRY * n + i] = arguments->geomID;
        hit_ids[HIT_INSTANCE * n + i] = arguments->context->instID[0];
    }
}

static void occlude_quadric(const struct RTCOccludedFunctionNArguments *arguments)
{
    const geometry_t *geometry = arguments->geometryUserPtr;
    unsigned n = arguments->N;
    float *rays = (float *)arguments->ray;
    for (unsigned i = 0; i < n; i++)
        if (arguments->valid[i] == -1 &&
            lane_distance(geometry, rays, n, i, arguments->context->instID[0], true) >= 0)
            rays[RAY_FAR * n + i] = -INFINITY;
}

/* ---- building ------------------------------------------------------------------------------------------ */

static RTCGeometry new_mesh(const scene_t *scene, const blob_mesh_t *mesh)
{
    const scene_blob_t *blob = scene->blob;
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               blob->positions + mesh->first_position, 0, sizeof(vec3_t), mesh->vertex_count);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               blob->triangles + mesh->first_triangle, 0, sizeof(blob_triangle_t),
                               mesh->triangle_count);
    return geometry;
}

static RTCGeometry new_quadric(const scene_t *scene)
{
    RTCGeometry geometry = rtcNewGeometry(scene->device, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry, 1);
    rtcSetGeometryBoundsFunction(geometry, bounds_of_quadric, NULL);
    rtcSetGeometryIntersectFunction(geometry, intersect_quadric);
    rtcSetGeometryOccludedFunction(geometry, occlude_quadric);
    return geometry;
}

static RTCGeometry new_curves(const scene_t *scene, const blob_curves_t *curves)
{
    const scene_blob_t *blob = scene->blob;
    bool ribbon = curves->kind == CURVES_RIBBON;
    RTCGeometry geometry =
        rtcNewGeometry(scene->device, ribbon ? RTC_GEOMETRY_TYPE_NORMAL_ORIENTED_BEZIER_CURVE
                                             : RTC_GEOMETRY_TYPE_ROUND_BEZIER_CURVE);
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

static void add_shape(scene_t *scene, RTCScene to, uint32_t shape_index, uint32_t id)
{
    const blob_shape_t *shape = &scene->blob->shapes[shape_index];
    geometry_t *geometry = &scene->geometries[shape_index];
    *geometry = (geometry_t){.scene = scene, .shape = shape};
    RTCGeometry made = NULL;
    switch ((shape_kind_t)shape->kind) {
    case SHAPE_MESH:
        made = new_mesh(scene, &scene->blob->meshes[shape->geometry]);
        break;
    case SHAPE_QUADRIC:
        geometry->quadric = &scene->quadrics[shape->geometry];
        made = new_quadric(scene);
        break;
    case SHAPE_CURVES:
        made = new_curves(scene, &scene->blob->curves[shape->geometry]);
        break;
    }
    rtcSetGeometryUserData(made, geometry);
    if (shape->kind == SHAPE_MESH && !is_opaque(&shape->alpha))
        rtcSetGeometryIntersectFilterFunction(made, filter_nearest);
    if (shape->kind == SHAPE_MESH && (!is_opaque(&shape->alpha) || !is_opaque(&shape->shadow_alpha)))
        rtcSetGeometryOccludedFilterFunction(made, filter_shadow);
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

/* Embree ends the process at a ray with a coordinate of 1.844e18 or more, or NaN, where it was built with its
 * assertions, as Debian's is; also at one that only becomes so in the space of an instance. */
static const float largest_of_embree = 1.8e18f;

/* A bound on the sum of any row of object_from_world, at any time: the stretch is triangular, so its inverse
 * is bounded by its least diagonal element and its largest other one. */
static double most_magnification(const instance_t *instance)
{
    static const int diagonal[] = {0, 3, 5}, others[] = {1, 2, 4};
    const xform_t *inverse = &instance->still.object_from_world;
    double least = INFINITY, skew = 0, sum = 0;
    for (int i = 0; i < 3; i++)
        sum = fmax(sum, (double)v_length(vec3(inverse->m[i][0], inverse->m[i][1], inverse->m[i][2])));
    if (!instance->motion.moves) return 2 * sum;
    const motion_key_t *keys = instance->motion.keys;
    for (int i = 0; i < 3; i++) {
        double a = (double)keys[0].stretch[diagonal[i]], b = (double)keys[1].stretch[diagonal[i]];
        least = fmin(least, (a > 0) == (b > 0) ? fmin(fabs(a), fabs(b)) : 0); /* else singular in between */
        skew = fmax(skew,
                    fmax(fabs((double)keys[0].stretch[others[i]]), fabs((double)keys[1].stretch[others[i]])));
    }
    return fmax(2 * sum, 6 / least * (1 + skew / least) * (1 + skew / least));
}

/* How far from the origin rays may go so that an instance does not take them where Embree does not go. */
static float reach_of(const instance_t *instance)
{
    const xform_t *still = &instance->motion.still;
    double farthest =
        fmax(fabs((double)still->m[0][3]), fmax(fabs((double)still->m[1][3]), fabs((double)still->m[2][3])));
    for (int i = 0; i < 2 && instance->motion.moves; i++) {
        vec3_t t = instance->motion.keys[i].translation;
        farthest = fmax(farthest, fmax(fabs((double)t.x), fmax(fabs((double)t.y), fabs((double)t.z))));
    }
    double reach = (double)largest_of_embree / (4 * fmax(most_magnification(instance), 1)) - farthest;
    return reach > 0 ? (float)reach : 0; /* also of a NaN */
}

/* True when Embree can be asked about rays with such an origin or direction. */
static bool is_traceable(const scene_t *scene, vec3_t v)
{
    return fabsf(v.x) < scene->reach && fabsf(v.y) < scene->reach && fabsf(v.z) < scene->reach;
}

static void add_instances(scene_t *scene)
{
    const scene_blob_t *blob = scene->blob;
    scene->first_instance = blob->objects[0].shape_count;
    for (uint32_t i = 0; i < blob->counts[BLOB_SECTION_INSTANCES]; i++) {
        const blob_instance_t *record = &blob->instances[i];
        instance_t *instance = &scene->instances[i];
        instance->motion = motion_between(&record->world_from_object, &record->world_from_object_end);
        instance->still.world_from_object = record->world_from_object;
        xform_invert(&record->world_from_object, &instance->still.object_from_world);
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
        scene->reach = float_min(scene->reach, reach_of(instance));
    }
}

static void build_objects(scene_t *scene)
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
}

/* Materials that look at more than the frame. */
static bool material_varies(const bool *before, const blob_material_t *m)
{
    if (m->kind == MATERIAL_MIX && (before[m->parts[0]] || before[m->parts[1]])) return true;
    bool varies = m->normal_map != 0 || m->bump != 0 || m->kind == MATERIAL_DISNEY;
    for (int i = 0; i < MATERIAL_VALUES; i++) varies = varies || m->values[i].texture != 0;
    return varies || m->values[VALUE_ROUGHNESS_U].factor.x != m->values[VALUE_ROUGHNESS_V].factor.x ||
           m->values[VALUE_BASE_ROUGHNESS_U].factor.x != m->values[VALUE_BASE_ROUGHNESS_V].factor.x;
}

static void prepare_tables(scene_t *scene)
{
    const scene_blob_t *blob = scene->blob;
    const uint64_t *counts = blob->counts;
    scene->textures = textures_new(blob);
    scene->varies = mem_zalloc(counts[BLOB_SECTION_MATERIALS] + 1, sizeof *scene->varies);
    for (uint64_t i = 0; i < counts[BLOB_SECTION_MATERIALS]; i++)
        scene->varies[i] = material_varies(scene->varies, &blob->materials[i]);
    scene->objects = mem_zalloc(counts[BLOB_SECTION_OBJECTS], sizeof *scene->objects);
    scene->geometries = mem_zalloc(counts[BLOB_SECTION_SHAPES] + 1, sizeof *scene->geometries);
    scene->quadrics = mem_zalloc(counts[BLOB_SECTION_QUADRICS] + 1, sizeof *scene->quadrics);
    for (uint64_t i = 0; i < counts[BLOB_SECTION_QUADRICS]; i++)
        quadric_init(&scene->quadrics[i], &blob->quadrics[i]);
    scene->instances = mem_zalloc(counts[BLOB_SECTION_INSTANCES] + 1, sizeof *scene->instances);
    uint32_t segments = 0;
    for (uint64_t i = 0; i < counts[BLOB_SECTION_CURVES]; i++)
        if (blob->curves[i].segment_count > segments) segments = blob->curves[i].segment_count;
    /* One more: Embree may read 16 bytes from the last index on. */
    scene->curve_indices = mem_zalloc((size_t)segments + 4, sizeof *scene->curve_indices);
    for (uint32_t i = 0; i < segments; i++) scene->curve_indices[i] = 4 * i;
}

result_t scene_new(const scene_blob_t *blob, scene_t **result)
{
    *result = NULL;
    RTCDevice device = rtcNewDevice(EMBREE_CONFIG);
    if (device == NULL)
        return result_fail(RESULT_LIMIT, "Embree cannot start (error %d); this needs an x86-64-v3 processor",
                           (int)rtcGetDeviceError(NULL));
    scene_t *scene = mem_zalloc(1, sizeof *scene);
    scene->blob = blob;
    scene->device = device;
    scene->reach = largest_of_embree;
    prepare_tables(scene);
    build_objects(scene);
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
    textures_destroy(&self->textures);
    free(self->varies);
    free(self->objects);
    free(self->geometries);
    free(self->quadrics);
    free(self->instances);
    free(self->curve_indices);
    free(self);
    *scene = NULL;
}

const scene_blob_t *scene_blob(const scene_t *scene)
{
    return scene->blob;
}

const textures_t *scene_textures(const scene_t *scene)
{
    return scene->textures;
}

const quadric_t *scene_quadric(const scene_t *scene, const blob_shape_t *shape)
{
    return &scene->quadrics[shape->geometry];
}

bool scene_material_varies(const scene_t *scene, const blob_material_t *material)
{
    return scene->varies[material - scene->blob->materials];
}

bool scene_moves(const scene_t *scene)
{
    return scene->moves;
}

void scene_bounds(const scene_t *scene, vec3_t *centre, float *radius)
{
    struct RTCBounds b;
    rtcGetSceneBounds(scene->world, &b);
    *centre = vec3(0, 0, 0);
    *radius = 0;
    if (!(b.lower_x <= b.upper_x)) return;
    vec3_t low = vec3(b.lower_x, b.lower_y, b.lower_z), high = vec3(b.upper_x, b.upper_y, b.upper_z);
    *centre = v_scale(v_add(low, high), 0.5f);
    *radius = 0.5f * v_length(v_sub(high, low)) * 1.0001f;
}

/* ---- hits ---------------------------------------------------------------------------------------------- */

/* A place on a surface and its normals, of any length. */
typedef struct {
    vec3_t p, ng, ns;
} place_t;

/* In the object's space, as the two after it. */
static inline place_t mesh_place(const scene_blob_t *blob, const blob_shape_t *shape, const hit_t *hit)
{
    const blob_mesh_t *mesh = &blob->meshes[shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + hit->primitive].v;
    const vec3_t *p = blob->positions + mesh->first_position;
    vec3_t e1 = v_sub(p[v[1]], p[v[0]]), e2 = v_sub(p[v[2]], p[v[0]]);
    float b1 = hit->place.x, b2 = hit->place.y, b0 = 1 - b1 - b2;
    place_t at;
    at.p = v_add(v_add(v_scale(p[v[0]], b0), v_scale(p[v[1]], b1)), v_scale(p[v[2]], b2));
    at.ng = v_cross(e1, e2);
    if (mesh->first_normal != BLOB_NONE) {
        const vec3_t *n = blob->normals + mesh->first_normal;
        at.ns = v_add(v_add(v_scale(n[v[0]], b0), v_scale(n[v[1]], b1)), v_scale(n[v[2]], b2));
        if (v_is_zero(at.ns)) at.ns = at.ng;
        if (v_dot(at.ns, at.ng) < 0) at.ng = v_neg(at.ng);
    } else {
        if (shape->flags & SHAPE_FLIP) at.ng = v_neg(at.ng);
        at.ns = at.ng;
    }
    return at;
}

static inline place_t quadric_place(const scene_t *scene, const blob_shape_t *shape, vec3_t hit)
{
    quadric_point_t point;
    quadric_at(&scene->quadrics[shape->geometry], hit, &point);
    vec3_t n = shape->flags & SHAPE_FLIP ? v_neg(point.n) : point.n;
    return (place_t){point.p, n, n};
}

/* The transforms of an instance at a time: those of one that stands still where they are, else in *moved. */
static const placement_t *instance_at(const scene_t *scene, uint32_t index, float time, placement_t *moved)
{
    const instance_t *instance = &scene->instances[index];
    if (!instance->motion.moves) return &instance->still;
    moved->world_from_object = motion_at(&instance->motion, time);
    if (!xform_invert(&moved->world_from_object, &moved->object_from_world))
        moved->object_from_world = instance->still.object_from_world;
    return moved;
}

/* Everything about a hit. The ray of `hit` is in the object's space for alpha's sake, in the world for all
 * else: only `local` tells, and only quadrics and curves look. `ng` is Embree's normal, for curves. False
 * when the surface is degenerate there. */
static bool fill_surface(const scene_t *scene, const blob_shape_t *shape, const hit_t *hit, bool local,
                         vec3_t ng, surface_t *surface)
{
    const scene_blob_t *blob = scene->blob;
    bool instanced = hit->instance_id != RTC_INVALID_GEOMETRY_ID;
    surface->shape = shape;
    surface->material = &blob->materials[shape->material];
    surface->light = shape->light;
    surface->instance = instanced ? hit->instance_id - scene->first_instance : BLOB_NONE;
    surface->primitive = hit->primitive;
    surface->place = hit->place;
    surface->time = hit->time;
    placement_t moved;
    const placement_t *placement =
        instanced ? instance_at(scene, surface->instance, hit->time, &moved) : NULL;
    place_t at;
    if (shape->kind == SHAPE_MESH) {
        at = mesh_place(blob, shape, hit);
    } else {
        vec3_t p = v_mad(hit->origin, hit->distance, hit->direction);
        if (instanced && !local) p = xform_point(&placement->object_from_world, p);
        at = shape->kind == SHAPE_QUADRIC ? quadric_place(scene, shape, p) : (place_t){p, ng, ng};
    }
    if (instanced) {
        at.p = xform_point(&placement->world_from_object, at.p);
        at.ng = xform_normal(&placement->object_from_world, at.ng);
        at.ns = xform_normal(&placement->object_from_world, at.ns);
    }
    bool smooth = at.ns.x != at.ng.x || at.ns.y != at.ng.y || at.ns.z != at.ng.z;
    at.ng = v_normalize(at.ng);
    at.ns = smooth ? v_normalize(at.ns) : at.ng;
    surface->p = at.p;
    surface->ng = at.ng;
    surface->ns = at.ns;
    surface->offset = scene_offset_at(at.p);
    return v_is_finite(at.ng) && v_is_finite(at.ns);
}

/* Embree's nearest hit along a ray; false when there is none. */
static bool nearest_hit(const scene_t *scene, vec3_t origin, vec3_t direction, float time,
                        struct RTCRayHit *query)
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
                                   .time = time,
                                   .tfar = INFINITY,
                                   .mask = 0xFFFFFFFFu},
                           .hit = {.geomID = RTC_INVALID_GEOMETRY_ID, .instID = {RTC_INVALID_GEOMETRY_ID}}};
    if (!is_traceable(scene, origin) || !is_traceable(scene, direction)) return false;
    rtcIntersect1(scene->world, &context, query);
    return query->hit.geomID != RTC_INVALID_GEOMETRY_ID;
}

bool scene_probe(const scene_t *scene, vec3_t origin, vec3_t direction)
{
    struct RTCRayHit query;
    return nearest_hit(scene, origin, direction, 0, &query);
}

bool scene_intersect(const scene_t *scene, vec3_t origin, vec3_t direction, float time, surface_t *surface)
{
    struct RTCRayHit query;
    if (!nearest_hit(scene, origin, direction, time, &query)) return false;
    const scene_blob_t *blob = scene->blob;
    hit_t hit = {.origin = origin,
                 .direction = direction,
                 .time = time,
                 .distance = query.ray.tfar,
                 .instance_id = query.hit.instID[0],
                 .primitive = query.hit.primID,
                 .place = {query.hit.u, query.hit.v}};
    bool instanced = hit.instance_id != RTC_INVALID_GEOMETRY_ID;
    uint32_t object = instanced ? blob->instances[hit.instance_id - scene->first_instance].object : 0;
    const blob_shape_t *shape = &blob->shapes[blob->objects[object].first_shape + query.hit.geomID];
    vec3_t ng = vec3(query.hit.Ng_x, query.hit.Ng_y, query.hit.Ng_z);
    return fill_surface(scene, shape, &hit, false, ng, surface);
}

/* ---- details ------------------------------------------------------------------------------------------- */

/* Solves for the derivatives along u and v of something that changes by a and b along the triangle's edges.
 */
static void differentiate(vec2_t uv1, vec2_t uv2, float inverse, vec3_t a, vec3_t b, vec3_t *du, vec3_t *dv)
{
    *du = v_scale(v_sub(v_scale(a, uv2.y), v_scale(b, uv1.y)), inverse);
    *dv = v_scale(v_sub(v_scale(b, uv1.x), v_scale(a, uv2.x)), inverse);
}

static vec2_t uv_mean(const vec2_t uv[3], vec2_t place)
{
    float b0 = 1 - place.x - place.y;
    return (vec2_t){b0 * uv[0].x + place.x * uv[1].x + place.y * uv[2].x,
                    b0 * uv[0].y + place.x * uv[1].y + place.y * uv[2].y};
}

static blob_colour_t colour_mean(const blob_colour_t *c, const uint32_t v[3], vec2_t place)
{
    float b[3] = {1 - place.x - place.y, place.x, place.y};
    blob_colour_t mean = {0, 0, 0, 0};
    for (int i = 0; i < 3; i++) {
        mean.r += b[i] * c[v[i]].r;
        mean.g += b[i] * c[v[i]].g;
        mean.b += b[i] * c[v[i]].b;
        mean.a += b[i] * c[v[i]].a;
    }
    return mean;
}

static void mesh_details(const scene_blob_t *blob, const surface_t *surface, surface_details_t *details)
{
    const blob_mesh_t *mesh = &blob->meshes[surface->shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + surface->primitive].v;
    vec2_t uv[3] = {{0, 0}, {1, 0}, {1, 1}}, uv2[3];
    for (int i = 0; i < 3 && mesh->first_uv != BLOB_NONE; i++) uv[i] = blob->uvs[mesh->first_uv + v[i]];
    details->uv = details->uv2 = uv_mean(uv, surface->place);
    if (mesh->first_uv2 != BLOB_NONE) {
        for (int i = 0; i < 3; i++) uv2[i] = blob->uvs[mesh->first_uv2 + v[i]];
        details->uv2 = uv_mean(uv2, surface->place);
    }
    if (mesh->first_colour != BLOB_NONE)
        details->colour = colour_mean(blob->colours + mesh->first_colour, v, surface->place);
    vec2_t d1 = {uv[1].x - uv[0].x, uv[1].y - uv[0].y}, d2 = {uv[2].x - uv[0].x, uv[2].y - uv[0].y};
    float determinant = d1.x * d2.y - d1.y * d2.x;
    if (!(fabsf(determinant) > 0x1p-100f)) return;
    const vec3_t *p = blob->positions + mesh->first_position;
    differentiate(d1, d2, 1 / determinant, v_sub(p[v[1]], p[v[0]]), v_sub(p[v[2]], p[v[0]]), &details->dpdu,
                  &details->dpdv);
    if (mesh->first_normal == BLOB_NONE) return;
    const vec3_t *n = blob->normals + mesh->first_normal;
    differentiate(d1, d2, 1 / determinant, v_sub(n[v[1]], n[v[0]]), v_sub(n[v[2]], n[v[0]]), &details->dndu,
                  &details->dndv);
}

/* pbrt-v3's frame of a triangle with vertex normals: unit tangents, which both point backwards. A bump map
 * whose texture goes by u and v is turned round by it, and its height is not related to the triangle's size.
 */
static void smooth_bumps(const scene_blob_t *blob, const surface_t *surface, surface_details_t *details)
{
    const blob_mesh_t *mesh = &blob->meshes[surface->shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + surface->primitive].v;
    if (mesh->first_normal == BLOB_NONE) return;
    const vec3_t *n = blob->normals + mesh->first_normal;
    float b1 = surface->place.x, b2 = surface->place.y, b0 = 1 - b1 - b2;
    vec3_t ns = v_normalize(v_mad(v_mad(v_scale(n[v[0]], b0), b1, n[v[1]]), b2, n[v[2]]));
    vec3_t s = v_normalize(v_mad(details->dpdu, -v_dot(details->dpdu, ns), ns));
    if (!v_is_finite(ns) || !v_is_finite(s)) return;
    details->bump_u = v_neg(s);
    details->bump_v = v_cross(s, ns);
}

static void curve_details(const scene_blob_t *blob, const surface_t *surface, vec3_t ng,
                          surface_details_t *details)
{
    const blob_curves_t *curves = &blob->curves[surface->shape->geometry];
    const blob_curve_point_t *c = blob->curve_points + curves->first_point + 4 * (size_t)surface->primitive;
    float t = surface->place.x, s = 1 - t;
    const float weights[4] = {-s * s, s * s - 2 * s * t, 2 * s * t - t * t, t * t};
    vec3_t along = vec3(0, 0, 0);
    for (int i = 0; i < 4; i++) along = v_mad(along, 3 * weights[i], vec3(c[i].x, c[i].y, c[i].z));
    details->uv = details->uv2 = (vec2_t){0.5f + 0.5f * surface->place.y,
                                          ((float)surface->primitive + t) / (float)curves->segment_count};
    details->dpdv = v_scale(along, (float)curves->segment_count);
    details->dpdu = v_cross(details->dpdv, ng);
}

void scene_details(const scene_t *scene, const surface_t *surface, surface_details_t *details)
{
    const scene_blob_t *blob = scene->blob;
    bool instanced = surface->instance != BLOB_NONE;
    placement_t moved;
    const placement_t *placement =
        instanced ? instance_at(scene, surface->instance, surface->time, &moved) : NULL;
    *details = (surface_details_t){.colour = {1, 1, 1, 1}};
    if (surface->shape->kind == SHAPE_MESH) {
        mesh_details(blob, surface, details);
    } else if (surface->shape->kind == SHAPE_QUADRIC) {
        quadric_details_t on;
        vec3_t p = instanced ? xform_point(&placement->object_from_world, surface->p) : surface->p;
        quadric_details(&scene->quadrics[surface->shape->geometry], p, &on);
        /* As in pbrt, the derivatives of the normal do not turn with it where the shape is reversed. */
        *details = (surface_details_t){.uv = on.uv,
                                       .uv2 = on.uv,
                                       .dpdu = on.dpdu,
                                       .dpdv = on.dpdv,
                                       .dndu = on.dndu,
                                       .dndv = on.dndv,
                                       .colour = {1, 1, 1, 1}};
    } else {
        vec3_t ng = instanced ? xform_normal(&placement->world_from_object, surface->ng) : surface->ng;
        curve_details(blob, surface, ng, details);
    }
    details->bump_u = details->dpdu;
    details->bump_v = details->dpdv;
    if (surface->shape->flags & SHAPE_BUMPS_V3) smooth_bumps(blob, surface, details);
    if (instanced) {
        const xform_t *world = &placement->world_from_object, *inverse = &placement->object_from_world;
        details->dpdu = xform_vector(world, details->dpdu);
        details->dpdv = xform_vector(world, details->dpdv);
        details->bump_u = xform_vector(world, details->bump_u);
        details->bump_v = xform_vector(world, details->bump_v);
        /* Of the unit normal in the world: the transpose of the inverse changes its length by 1 / scale. */
        float scale = v_length(xform_normal(world, surface->ns));
        details->dndu = v_scale(xform_normal(inverse, details->dndu), scale);
        details->dndv = v_scale(xform_normal(inverse, details->dndv), scale);
    }
}

/* ---- shadows --------------------------------------------------------------------------------------------
 */

/* Segments end just short of their target, which lies off its surface by more than that. */
static const float segment_end = 1.0f - 0x1p-20f;

bool scene_occluded(const scene_t *scene, vec3_t from, vec3_t to, float time)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    vec3_t d = v_sub(to, from);
    if (!is_traceable(scene, from) || !is_traceable(scene, d)) return true;
    struct RTCRay ray = {.org_x = from.x,
                         .org_y = from.y,
                         .org_z = from.z,
                         .tnear = 0,
                         .dir_x = d.x,
                         .dir_y = d.y,
                         .dir_z = d.z,
                         .time = time,
                         .tfar = segment_end,
                         .mask = 0xFFFFFFFFu};
    rtcOccluded1(scene->world, &context, &ray);
    return ray.tfar < 0;
}

/* Occlusion of a segment by itself: Embree's packets cost more. */
static uint32_t only_occluded(const scene_t *scene, const segments_t *s)
{
    vec3_t from = vec3(s->from[0][0], s->from[1][0], s->from[2][0]);
    return scene_occluded(scene, from, vec3(s->to[0][0], s->to[1][0], s->to[2][0]), s->time);
}

/* One coordinate of a packet's rays; counts in *lost those beyond the reach. */
static inline void fill_axis(const float *from, const float *to, float reach, float *restrict origin,
                             float *restrict direction, int *restrict lost)
{
    for (int i = 0; i < SCENE_PACKET; i++) {
        float o = from[i], d = to[i] - o;
        origin[i] = o;
        direction[i] = d;
        lost[i] += (fabsf(o) < reach ? 0 : 1) + (fabsf(d) < reach ? 0 : 1);
    }
}

uint32_t scene_occluded_packet(const scene_t *scene, const segments_t *segments)
{
    if (segments->count == 1) return only_occluded(scene, segments);
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRay8 rays;
    _Alignas(32) int valid[SCENE_PACKET], lost[SCENE_PACKET] = {0};
    fill_axis(segments->from[0], segments->to[0], scene->reach, rays.org_x, rays.dir_x, lost);
    fill_axis(segments->from[1], segments->to[1], scene->reach, rays.org_y, rays.dir_y, lost);
    fill_axis(segments->from[2], segments->to[2], scene->reach, rays.org_z, rays.dir_z, lost);
    for (int i = 0; i < SCENE_PACKET; i++) {
        valid[i] = i < segments->count && lost[i] == 0 ? -1 : 0;
        rays.tnear[i] = 0, rays.tfar[i] = segment_end, rays.time[i] = segments->time;
        rays.mask[i] = 0xFFFFFFFFu, rays.id[i] = 0, rays.flags[i] = 0;
    }
    rtcOccluded8(valid, scene->world, &context, &rays);
    /* Where nobody can say what lies between, it is as good as occluded. */
    uint32_t occluded = 0;
    for (int i = 0; i < segments->count; i++) occluded |= (uint32_t)(lost[i] != 0 || rays.tfar[i] < 0) << i;
    return occluded;
}
