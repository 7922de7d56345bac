/* scene_internal: what the files of the scene share and nobody else needs. */
#ifndef LIGHTMILL_SCENE_INTERNAL_H
#define LIGHTMILL_SCENE_INTERNAL_H

#include "worker/render/scene/instance.h"
#include "worker/render/scene/scene.h"

/* What Embree's callbacks need to know of a shape. */
typedef struct {
    const scene_t *scene;
    const blob_shape_t *shape;
    const quadric_t *quadric; /* or NULL */
    bool picture;             /* LIGHT_PICTURE */
    bool border;              /* MATERIAL_INTERFACE: shadow rays go through */
} geometry_t;

struct scene {
    const scene_blob_t *blob;
    textures_t *textures;
    bool *varies, *textured; /* [materials] */
    RTCDevice device;
    RTCScene world;
    RTCScene *objects;       /* [objects]; objects[0] is the world */
    RTCScene borders;        /* the borders of media alone; NULL: there are none. The world, if some are in
                                instances */
    geometry_t *geometries;  /* [shapes] */
    quadric_t *quadrics;     /* [quadrics] */
    instance_t *instances;   /* [instances] */
    uint32_t *curve_indices; /* 0, 4, 8, ... for the longest set of curves */
    uint32_t first_instance; /* geometry id of instance 0 in the world */
    bool moves;
    bool has_placed_borders; /* borders of media in instances */
    float reach;             /* coordinates of rays must stay below it: see instance_reach */
};

/* True when Embree can be asked about rays with such an origin or direction. */
static inline bool scene_can_trace(const scene_t *scene, vec3_t v)
{
    return fabsf(v.x) < scene->reach && fabsf(v.y) < scene->reach && fabsf(v.z) < scene->reach;
}

static inline bool alpha_is_opaque(const blob_value_t *alpha)
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

/* Rows of Embree's packet layout, N lanes each (RTCRayN and RTCHitN; their accessors are C++ only). */
enum {
    RAY_ORIGIN = 0,
    RAY_NEAR = 3,
    RAY_DIRECTION = 4,
    RAY_TIME = 7,
    RAY_FAR = 8,
    RAY_ID = 10,
    RAY_ROWS = 12
};
enum { HIT_U = 3, HIT_V = 4, HIT_PRIMITIVE = 5, HIT_GEOMETRY = 6, HIT_INSTANCE = 7 };

/* Of the ids of rays: those that the camera looks along meet pictures, others do not. Shadow rays have their
 * place in a packet, too. */
enum { RAY_PLAIN = 0, RAY_LOOK = 1, RAY_PLACE_SHIFT = 1 };

/* The ray of a lane, in the space of the scene that is traced. */
static inline hit_t lane_hit(const float *rays, unsigned n, unsigned i)
{
    const float *o = rays + RAY_ORIGIN * n + i, *d = rays + RAY_DIRECTION * n + i;
    return (hit_t){.origin = vec3(o[0], o[n], o[2 * n]),
                   .direction = vec3(d[0], d[n], d[2 * n]),
                   .time = rays[RAY_TIME * n + i],
                   .distance = rays[RAY_FAR * n + i]};
}

/* What a triangle with the vertices v has of `values`, positions or normals of its mesh, at a time from 0 to
 * 1. */
static inline void mesh_corners(const vec3_t *values, const blob_mesh_t *mesh, const uint32_t v[3],
                                float time, vec3_t corners[3])
{
    if (mesh->steps == 0) {
        for (int i = 0; i < 3; i++) corners[i] = values[v[i]];
        return;
    }
    float at = time * (float)(mesh->steps - 1);
    uint32_t step = (uint32_t)float_max(at, 0);
    if (step > mesh->steps - 2) step = mesh->steps - 2;
    const vec3_t *a = values + (size_t)step * mesh->vertex_count, *b = a + mesh->vertex_count;
    float share = at - (float)step;
    for (int i = 0; i < 3; i++) corners[i] = v_add(v_scale(a[v[i]], 1 - share), v_scale(b[v[i]], share));
}

/* Makes the trees (scene_build.c). */
void scene_build(scene_t *scene);
/* A quadric as Embree's user geometry (scene_quadric.c). */
RTCGeometry scene_new_quadric(const scene_t *scene);
/* Embree's filters of a shape with an alpha: they let rays through (scene_alpha.c). */
void alpha_filter_nearest(const struct RTCFilterFunctionNArguments *arguments);
void alpha_filter_shadow(const struct RTCFilterFunctionNArguments *arguments);
/* Notes that a shadow ray with this id crosses a border of media at the hit, if it is to
 * (scene_shadow.c). */
void shadow_crosses(const struct RTCIntersectContext *context, uint32_t id, const geometry_t *geometry,
                    const hit_t *hit);
/* True when the shape stops the ray at the hit. */
bool alpha_stops(const geometry_t *geometry, const hit_t *hit, bool shadow);
/* Everything about a hit. The ray of `hit` is in the object's space for alpha's sake, in the world for all
 * else: only `local` tells, and only quadrics and curves look. `ng` is Embree's normal, for curves. False
 * when the surface is degenerate there. */
bool scene_fill_surface(const scene_t *scene, const blob_shape_t *shape, const hit_t *hit, bool local,
                        vec3_t ng, surface_t *surface);

#endif
