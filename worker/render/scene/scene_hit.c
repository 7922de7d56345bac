/* scene_hit: the nearest hit of a ray, and the surface there. */
#include "worker/render/scene/scene_internal.h"

/* A place on a surface and its normals, of any length. */
typedef struct {
    vec3_t p, ng, ns;
} place_t;

/* In the object's space, as the two after it. */
static inline place_t mesh_place(const scene_blob_t *blob, const blob_shape_t *shape, const hit_t *hit)
{
    const blob_mesh_t *mesh = &blob->meshes[shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + hit->primitive].v;
    vec3_t p[3], n[3];
    mesh_corners(blob->positions + mesh->first_position, mesh, v, hit->time, p);
    vec3_t e1 = v_sub(p[1], p[0]), e2 = v_sub(p[2], p[0]);
    float b1 = hit->place.x, b2 = hit->place.y, b0 = 1 - b1 - b2;
    place_t at;
    at.p = v_add(v_add(v_scale(p[0], b0), v_scale(p[1], b1)), v_scale(p[2], b2));
    at.ng = v_cross(e1, e2);
    if (mesh->first_normal != BLOB_NONE) {
        mesh_corners(blob->normals + mesh->first_normal, mesh, v, hit->time, n);
        at.ns = v_add(v_add(v_scale(n[0], b0), v_scale(n[1], b1)), v_scale(n[2], b2));
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

/* ---- fibres -------------------------------------------------------------------------------------------- */

/* A point of a cubic Bezier segment, in the object's space. */
typedef struct {
    vec3_t along; /* tangent, of any length */
    float radius;
} strand_t;

static strand_t strand_at(const blob_curve_point_t c[4], float t)
{
    float s = 1 - t;
    const float slopes[4] = {-s * s, s * s - 2 * s * t, 2 * s * t - t * t, t * t},
                shares[4] = {s * s * s, 3 * s * s * t, 3 * s * t * t, t * t * t};
    strand_t at = {{0, 0, 0}, 0};
    for (int i = 0; i < 4; i++) {
        at.along = v_mad(at.along, slopes[i], vec3(c[i].x, c[i].y, c[i].z));
        at.radius += shares[i] * c[i].radius;
    }
    if (!(v_length2(at.along) > 0))
        at.along = v_sub(vec3(c[3].x, c[3].y, c[3].z), vec3(c[0].x, c[0].y, c[0].z));
    return at;
}

/* Sets the surface on the band that a hair shows to the ray. All of it is as in pbrt-v3: the normal turns
 * evenly from edge to edge, the other way than a tube's, unless the hair is flat; the offset at which the
 * lobe takes the hair to be seen fits that. What goes on from there starts beyond the hair, since its bands
 * face each ray anew: 2 widths off for each component of the normal. So hairs that are closer do not shade
 * each other. */
static bool fill_fibre(const scene_t *scene, const hit_t *hit, const placement_t *placement,
                       surface_t *surface)
{
    const blob_curves_t *curves = &scene->blob->curves[surface->shape->geometry];
    const blob_curve_point_t *points = scene->blob->curve_points + curves->first_point;
    strand_t strand = strand_at(points + 4 * (size_t)hit->primitive, hit->place.x);
    vec3_t along = strand.along, s, t;
    if (placement != NULL) along = xform_vector(&placement->world_from_object, along);
    along = v_normalize(along);
    vec3_t facing = v_normalize(v_mad(hit->direction, -v_dot(hit->direction, along), along));
    if (!v_is_finite(facing)) { /* the ray runs along the hair */
        v_frame(along, &s, &t);
        facing = s;
    }
    bool flat = curves->kind == CURVES_FLAT_FIBRE;
    float turn = flat ? 0 : 0.5f * PI_F * float_clamp(hit->place.y, -1, 1), reach = 0;
    vec3_t across = v_cross(along, facing); /* to where Embree's v falls */
    surface->p = v_mad(hit->origin, hit->distance, hit->direction);
    surface->ng = surface->ns = v_sub(v_scale(across, sinf(turn)), v_scale(facing, cosf(turn)));
    surface->fibre = true;
    surface->along = along;
    surface->radius = strand.radius;
    if (placement != NULL) {
        const blob_curve_point_t *end = points + 4 * (size_t)hit->primitive;
        surface->radius /= v_length(xform_vector(&placement->object_from_world, across));
        reach = xform_reach(&placement->world_from_object, vec3(end->x, end->y, end->z), 0);
    }
    vec3_t n = surface->ng;
    surface->offset =
        4 * surface->radius * (fabsf(n.x) + fabsf(n.y) + fabsf(n.z)) + scene_offset_at(surface->p, reach);
    return v_is_finite(along) && v_is_finite(surface->ng) && isfinite(surface->offset);
}

/* ---- all ----------------------------------------------------------------------------------------------- */

bool scene_fill_surface(const scene_t *scene, const blob_shape_t *shape, const hit_t *hit, bool local,
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
    surface->fibre = false;
    placement_t moved;
    const placement_t *placement =
        instanced ? instance_at(&scene->instances[surface->instance], hit->time, &moved) : NULL;
    if (shape->kind == SHAPE_CURVES && curves_are_fibres(blob->curves[shape->geometry].kind))
        return fill_fibre(scene, hit, placement, surface);
    place_t at;
    if (shape->kind == SHAPE_MESH) {
        at = mesh_place(blob, shape, hit);
    } else {
        vec3_t p = v_mad(hit->origin, hit->distance, hit->direction);
        if (instanced && !local) p = xform_point(&placement->object_from_world, p);
        at = shape->kind == SHAPE_QUADRIC ? quadric_place(scene, shape, p) : (place_t){p, ng, ng};
    }
    float reach = shape->kind == SHAPE_QUADRIC ? scene->quadrics[shape->geometry].reach : 0;
    if (instanced) {
        reach = xform_reach(&placement->world_from_object, at.p, reach);
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
    surface->offset = scene_offset_at(at.p, reach);
    return v_is_finite(at.ng) && v_is_finite(at.ns);
}

/* Embree's nearest hit along a ray, up to a distance, among all there is or the borders alone; false when
 * there is none. */
static bool nearest_hit(const scene_t *scene, RTCScene among, vec3_t origin, vec3_t direction, float distance,
                        float time, uint32_t id, struct RTCRayHit *query)
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
                                   .tfar = distance,
                                   .mask = 0xFFFFFFFFu,
                                   .id = id},
                           .hit = {.geomID = RTC_INVALID_GEOMETRY_ID, .instID = {RTC_INVALID_GEOMETRY_ID}}};
    if (!scene_can_trace(scene, origin) || !scene_can_trace(scene, direction)) return false;
    rtcIntersect1(among, &context, query);
    return query->hit.geomID != RTC_INVALID_GEOMETRY_ID;
}

bool scene_probe(const scene_t *scene, vec3_t origin, vec3_t direction)
{
    struct RTCRayHit query;
    return nearest_hit(scene, scene->world, origin, direction, INFINITY, 0, RAY_PLAIN, &query);
}

static bool intersect(const scene_t *scene, RTCScene among, vec3_t origin, vec3_t direction, float distance,
                      float time, uint32_t id, surface_t *surface)
{
    struct RTCRayHit query;
    if (!nearest_hit(scene, among, origin, direction, distance, time, id, &query)) return false;
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
    return scene_fill_surface(scene, shape, &hit, false, ng, surface);
}

bool scene_intersect(const scene_t *scene, vec3_t origin, vec3_t direction, float time, surface_t *surface)
{
    return intersect(scene, scene->world, origin, direction, INFINITY, time, RAY_PLAIN, surface);
}

bool scene_look(const scene_t *scene, vec3_t origin, vec3_t direction, float time, surface_t *surface)
{
    return intersect(scene, scene->world, origin, direction, INFINITY, time, RAY_LOOK, surface);
}

bool scene_has_borders(const scene_t *scene)
{
    return scene->borders != NULL;
}

bool scene_find_border(const scene_t *scene, vec3_t origin, vec3_t direction, float distance, float time,
                       surface_t *surface)
{
    return intersect(scene, scene->borders, origin, direction, distance, time, RAY_PLAIN, surface);
}
