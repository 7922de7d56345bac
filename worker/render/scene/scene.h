/* scene: the blob as geometry to trace: Embree trees, ray queries, and what a ray hit. */
#ifndef LIGHTMILL_SCENE_H
#define LIGHTMILL_SCENE_H

#include "common/scene/scene_blob.h"
#include "worker/render/scene/quadric.h"
#include "worker/render/texture/texture.h"

#include <embree3/rtcore.h>

/* A point on a surface. All vectors are in world space, directions of unit length. */
typedef struct {
    vec3_t p;
    vec3_t ng;    /* geometric normal, on the side to which the shape emits */
    vec3_t ns;    /* shading normal, in the hemisphere of ng */
    float offset; /* distance by which a ray must start off the surface so as not to hit it again */
    const blob_shape_t *shape;
    const blob_material_t *material;
    uint32_t light; /* index of the light that the shape is, or BLOB_NONE */
    /* Where on the shape; for scene_details. */
    uint32_t instance; /* BLOB_NONE: the world itself */
    uint32_t primitive;
    vec2_t place; /* Embree's u and v */
    float time;   /* 0 to 1 */
    bool fibre;   /* a hair, on the band that it shows to the ray (CURVES_FIBRE) ... */
    vec3_t along; /* ... with this direction, of unit length, ... */
    float radius; /* ... and as thick, in world space */
} surface_t;

/* What only textures and turned frames ask for. Derivatives are in world space. */
typedef struct {
    vec2_t uv, uv2;
    vec3_t dpdu, dpdv;     /* or what a mesh has in their place: only their directions count */
    vec3_t dndu, dndv;     /* of the shading normal */
    vec3_t bump_u, bump_v; /* what a bump map takes for dp/du and dp/dv */
    blob_colour_t colour;
} surface_details_t;

typedef struct scene scene_t;

/* Builds the trees on one thread. The blob must outlive the scene. RESULT_LIMIT when Embree runs out of
 * memory. */
result_t scene_new(const scene_blob_t *blob, scene_t **scene);
/* Frees the scene and sets *scene to NULL. */
void scene_destroy(scene_t **scene);
const scene_blob_t *scene_blob(const scene_t *scene);
const textures_t *scene_textures(const scene_t *scene);
/* True when the material looks at scene_details: textures, bumps, anisotropy. */
bool scene_material_varies(const scene_t *scene, const blob_material_t *material);
/* True when it has textures: all that hair looks at on a fibre. */
bool scene_material_is_textured(const scene_t *scene, const blob_material_t *material);
/* The quadric that a shape of that kind is, ready to use. */
const quadric_t *scene_quadric(const scene_t *scene, const blob_shape_t *shape);
/* A sphere about everything; radius 0 for an empty scene. */
void scene_bounds(const scene_t *scene, vec3_t *centre, float *radius);
/* Half the sides of the upright box about that centre that holds the scene; 0 when it is empty. */
vec3_t scene_half_sides(const scene_t *scene);
/* True when something moves, so that a path's time matters. */
bool scene_moves(const scene_t *scene);

/* Finds the first surface along a ray from `origin` in the unit direction, at a time from 0 to 1. False when
 * there is none. */
bool scene_intersect(const scene_t *scene, vec3_t origin, vec3_t direction, float time, surface_t *surface);
/* The same for a ray that the camera looks along, at most mirrored or let through since: it meets pictures
 * (LIGHT_PICTURE), too. */
bool scene_look(const scene_t *scene, vec3_t origin, vec3_t direction, float time, surface_t *surface);
/* True when there are borders of media, which stop no light (MATERIAL_INTERFACE). */
bool scene_has_borders(const scene_t *scene);
/* Finds the first of them along a ray, up to a distance; there must be some. Where one of them lies in an
 * instance, any surface may be found. */
bool scene_find_border(const scene_t *scene, vec3_t origin, vec3_t direction, float distance, float time,
                       surface_t *surface);
void scene_details(const scene_t *scene, const surface_t *surface, surface_details_t *details);

/* True when the ray hits anything; finds the nearest hit and forgets it: for measuring Embree alone. */
bool scene_probe(const scene_t *scene, vec3_t origin, vec3_t direction);

enum { SCENE_PACKET = 8 };
/* Segments between points; the ends are already off their surfaces (scene_offset). Coordinates lie side by
 * side as Embree takes them; those behind `count` may be anything that is set. */
typedef struct {
    int count;
    bool look; /* to or from the camera: pictures are in the way */
    float time;
    float from[3][SCENE_PACKET], to[3][SCENE_PACKET];
} segments_t;

/* Sets one segment. */
static inline void segments_set(segments_t *segments, int i, vec3_t from, vec3_t to)
{
    segments->from[0][i] = from.x, segments->from[1][i] = from.y, segments->from[2][i] = from.z;
    segments->to[0][i] = to.x, segments->to[1][i] = to.y, segments->to[2][i] = to.z;
}

static inline vec3_t segments_from(const segments_t *segments, int i)
{
    return vec3(segments->from[0][i], segments->from[1][i], segments->from[2][i]);
}
static inline vec3_t segments_to(const segments_t *segments, int i)
{
    return vec3(segments->to[0][i], segments->to[1][i], segments->to[2][i]);
}

enum { BORDERS_KEPT = 8 };
/* The borders on the way of a segment that is not occluded. */
typedef struct {
    vec3_t direction; /* of the segment */
    int count;        /* if more than are kept, those are the first */
    struct {
        float at;          /* which part of the segment lies before it, */
        float offset;      /* where a ray starts that goes on from there (surface_t), */
        blob_ref_t behind; /* and the medium that it goes on in */
    } kept[BORDERS_KEPT];  /* in order */
} borders_t;
/* True when something lies between the points, borders excepted; else *borders, which may be NULL, has these.
 * `look`: see segments_t. */
bool scene_crosses(const scene_t *scene, vec3_t from, vec3_t to, float time, bool look, borders_t *borders);
static inline bool scene_occluded(const scene_t *scene, vec3_t from, vec3_t to, float time, bool look)
{
    return scene_crosses(scene, from, to, time, look, NULL);
}
/* The same of up to SCENE_PACKET segments: bit i of the answer is set where segment i is occluded. Quickest
 * when all start close together. */
uint32_t scene_crosses_packet(const scene_t *scene, const segments_t *segments,
                              borders_t borders[SCENE_PACKET]);

/* True for a surface that does nothing but part media (MATERIAL_INTERFACE). */
static inline bool surface_is_interface(const surface_t *surface)
{
    return surface->material->kind == MATERIAL_INTERFACE;
}

/* False where an alpha lets a part of all rays through by chance. */
static inline bool surface_is_whole(const surface_t *surface)
{
    const blob_value_t *alpha = &surface->shape->alpha;
    return surface->shape->flags & SHAPE_CUTOUT || (alpha->texture == 0 && alpha->factor.x >= 1);
}

/* The surface's point moved off the surface, to the side to which `direction`, of any length, points. */
static inline vec3_t scene_beside(const surface_t *surface, vec3_t direction)
{
    float side = v_dot(surface->ng, direction) < 0 ? -surface->offset : surface->offset;
    return v_mad(surface->p, side, surface->ng);
}

/* The same, for a ray of unit direction to start at. */
static inline vec3_t scene_offset(const surface_t *surface, vec3_t direction)
{
    vec3_t p = scene_beside(surface, direction);
    /* Embree leaves out bands that are nearer to the start of a ray than 2 of their radii. */
    return surface->fibre ? v_mad(p, -2 * surface->radius, direction) : p;
}

/* How far off a surface rays must start at p (a few hundred units in the last place of its largest
 * coordinate: the rounding of a hit point and of Embree's distances stays below it). `reach`: where p was
 * worked out with numbers as large as that (xform_reach), of a huge sphere, or of an instance that was
 * brought from afar. */
static inline float scene_offset_at(vec3_t p, float reach)
{
    float largest = float_max(fabsf(p.x), float_max(fabsf(p.y), fabsf(p.z)));
    return float_max(float_max(largest, 0x1p-10f) * 0x1p-18f, reach * 0x1p-20f);
}

#endif
