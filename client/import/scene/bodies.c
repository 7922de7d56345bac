/* bodies: see bodies.h.
 *
 * The surface of a body may be made of several shapes of an object. It is closed when each edge of a triangle
 * is that of another one, the other way round. So edges, hashed by the places of their ends, add up to 0 if
 * those of one direction count positive and those of the other negative. */
#include "client/import/scene/bodies.h"

#include <stdlib.h>
#include <string.h>

/* The surface of a body in an object. */
typedef struct {
    const blob_shape_t *shape; /* one of it; NULL: none */
    uint64_t edges;
    double volume;
    bool unknown; /* parts of it are not triangles */
} hull_t;

static const void *records(const scene_builder_t *scene, blob_section_t section)
{
    return blob_builder_records(scene->blob, section);
}

/* The medium inside a shape; 0: none. */
static blob_ref_t body_of(const scene_builder_t *scene, const blob_shape_t *shape)
{
    return ((const blob_material_t *)records(scene, BLOB_SECTION_MATERIALS))[shape->material].body;
}

static uint64_t mix(uint64_t key)
{
    key = (key ^ key >> 33) * 0xFF51AFD7ED558CCDu;
    key = (key ^ key >> 33) * 0xC4CEB9FE1A85EC53u;
    return key ^ key >> 33;
}

static uint64_t hash_place(vec3_t p)
{
    uint32_t words[3];
    p = v_add(p, vec3(0, 0, 0)); /* -0 becomes 0 */
    memcpy(words, &p, sizeof words);
    return mix(mix(mix(words[0] + 1ull) + words[1]) + words[2]);
}

/* A triangle whose corners run counter-clockwise about its normal. */
static void add_triangle(hull_t *hull, const vec3_t p[3])
{
    uint64_t place[3];
    for (int i = 0; i < 3; ++i) place[i] = hash_place(p[i]);
    for (int i = 0; i < 3; ++i) {
        uint64_t a = place[i], b = place[(i + 1) % 3], edge = mix(a + b) ^ mix(a ^ b);
        hull->edges += a == b ? 0 : a < b ? edge : -edge;
    }
    hull->volume += (double)v_dot(p[0], v_cross(p[1], p[2])) / 6;
}

/* Where there are normals they say what is outside. */
static bool is_turned(const blob_shape_t *shape, const vec3_t p[3], const vec3_t *normals,
                      const uint32_t v[3])
{
    if (normals == NULL) return (shape->flags & SHAPE_FLIP) != 0;
    vec3_t n = v_add(v_add(normals[v[0]], normals[v[1]]), normals[v[2]]);
    return v_dot(n, v_cross(v_sub(p[1], p[0]), v_sub(p[2], p[0]))) < 0;
}

static void add_mesh(const scene_builder_t *scene, const blob_shape_t *shape, hull_t *hull)
{
    const blob_mesh_t *mesh = (const blob_mesh_t *)records(scene, BLOB_SECTION_MESHES) + shape->geometry;
    const blob_triangle_t *triangles = records(scene, BLOB_SECTION_TRIANGLES);
    const vec3_t *positions = records(scene, BLOB_SECTION_POSITIONS);
    const vec3_t *normals = records(scene, BLOB_SECTION_NORMALS);
    positions += mesh->first_position;
    normals = mesh->first_normal == BLOB_NONE ? NULL : normals + mesh->first_normal;
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        const uint32_t *v = triangles[mesh->first_triangle + i].v;
        vec3_t p[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
        vec3_t turned[3] = {p[0], p[2], p[1]};
        add_triangle(hull, is_turned(shape, p, normals, v) ? turned : p);
    }
}

static void add_shape(const scene_builder_t *scene, const blob_shape_t *shape, hull_t *hull)
{
    const blob_quadric_t *quadrics = records(scene, BLOB_SECTION_QUADRICS);
    if (body_of(scene, shape) == 0) return;
    hull->shape = shape;
    if (shape->kind == SHAPE_MESH) {
        add_mesh(scene, shape, hull);
        return;
    }
    hull->unknown = hull->unknown || shape->kind != SHAPE_QUADRIC;
    if (hull->unknown) return;
    const blob_quadric_t *q = &quadrics[shape->geometry];
    hull->unknown = q->kind != QUADRIC_SPHERE || q->z_min > -q->radius || q->z_max < q->radius ||
                    (double)q->phi_max < 6.283185;
    hull->volume += shape->flags & SHAPE_FLIP ? -(double)q->radius : (double)q->radius;
}

static void judge(const scene_builder_t *scene, const hull_t *hull, position_t at)
{
    const blob_material_t *materials = records(scene, BLOB_SECTION_MATERIALS);
    if (hull->shape == NULL || hull->unknown || (hull->edges == 0 && hull->volume >= 0)) return;
    const char *strings = records(scene, BLOB_SECTION_STRINGS);
    report_warning(scene->report, at,
                   "the surface of \"%.60s\", of the material \"%.60s\", below which light is scattered, %s: "
                   "behind it this has no end",
                   strings + hull->shape->name, strings + materials[hull->shape->material].name,
                   hull->edges != 0 ? "is not closed, or its triangles are not all turned the same way"
                                    : "is turned inside out");
}

/* Gives a shape its media, and returns the one inside. */
static blob_ref_t settle(scene_builder_t *scene, blob_shape_t *shape)
{
    blob_light_t *lights = blob_builder_records(scene->blob, BLOB_SECTION_LIGHTS);
    blob_ref_t body = body_of(scene, shape);
    int inside = (shape->flags & SCENE_INSIDE_OUT) != 0;
    shape->flags &= ~SCENE_INSIDE_OUT;
    if (body != 0) {
        shape->flags |= SHAPE_INTERFACE;
        shape->media[inside] = body;
        if (shape->light != BLOB_NONE) lights[shape->light].medium = 0;
    }
    if (!(shape->flags & SHAPE_INTERFACE)) shape->media[0] = shape->media[1] = 0;
    return body;
}

void scene_settle_media(scene_builder_t *scene, position_t at)
{
    uint32_t media = blob_builder_count(scene->blob, BLOB_SECTION_MEDIA);
    hull_t *hulls = mem_alloc((media + 1) * sizeof *hulls);
    for (uint32_t object = 0; object < scene->object_count; ++object) {
        size_t count;
        blob_shape_t *shapes = scene_shapes(scene, object, &count);
        for (size_t i = 0; i < count; ++i) hulls[settle(scene, &shapes[i])] = (hull_t){0};
        for (size_t i = 0; i < count; ++i) add_shape(scene, &shapes[i], &hulls[body_of(scene, &shapes[i])]);
        for (size_t i = 0; i < count; ++i) {
            hull_t *hull = &hulls[body_of(scene, &shapes[i])];
            judge(scene, hull, at);
            hull->shape = NULL; /* said once */
        }
    }
    free(hulls);
}
