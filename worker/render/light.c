/* light: tables of emissive primitives (see light.h). */
#include "worker/render/light.h"

#include "worker/render/alias.h"
#include "worker/render/warp.h"

#include <stdlib.h>

typedef struct {
    uint32_t light;
    uint32_t primitive; /* triangle of the mesh; 0 for a sphere */
} emitter_t;

struct lights {
    const scene_blob_t *blob;
    emitter_t *emitters; /* [alias.count] */
    alias_t alias;
    float *pdf_area;             /* [lights]: luminance x sides / total power; for spheres see sphere_pdf */
    xform_t *sphere_from_object; /* [spheres] */
};

/* Luminance, counting both sides; a light of pure blue still gets its share. */
static double light_weight(const blob_light_t *light)
{
    return (double)rgb_luminance(light->radiance) * (light->flags & LIGHT_TWO_SIDED ? 2 : 1);
}

static double triangle_area(const scene_blob_t *blob, const blob_mesh_t *mesh, uint32_t index)
{
    const vec3_t *p = blob->positions + mesh->first_position;
    const uint32_t *v = blob->triangles[mesh->first_triangle + index].v;
    return 0.5 * (double)v_length(v_cross(v_sub(p[v[1]], p[v[0]]), v_sub(p[v[2]], p[v[0]])));
}

/* By how much the sphere's transform stretches area where the outward normal is n (sphere space): |det M|
 * |M^-T n|. */
static float sphere_stretch(const blob_sphere_t *sphere, const xform_t *inverse, vec3_t n)
{
    return fabsf(xform_determinant(&sphere->object_from_sphere)) * v_length(xform_normal(inverse, n));
}

/* Any positive number will do for an ellipsoid: its area is taken from the stretch along three axes. */
static double sphere_area(const blob_sphere_t *sphere, const xform_t *inverse)
{
    double mean = 0;
    for (int i = 0; i < 3; i++)
        mean += (double)sphere_stretch(sphere, inverse, vec3(i == 0, i == 1, i == 2)) / 3;
    return 4 * M_PI * (double)sphere->radius * (double)sphere->radius * mean;
}

static uint32_t count_emitters(const scene_blob_t *blob)
{
    uint64_t count = 0;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++) {
        const blob_shape_t *shape = &blob->shapes[blob->lights[i].shape];
        count += shape->kind == SHAPE_MESH ? blob->meshes[shape->geometry].triangle_count : 1;
    }
    return (uint32_t)count;
}

/* Lists the primitives of one light with their weights from `next` on; returns the next free place. */
static uint32_t list_emitters(lights_t *lights, uint32_t index, double *weights, uint32_t next)
{
    const scene_blob_t *blob = lights->blob;
    const blob_light_t *light = &blob->lights[index];
    const blob_shape_t *shape = &blob->shapes[light->shape];
    double weight = light_weight(light);
    if (shape->kind == SHAPE_SPHERE) {
        lights->emitters[next] = (emitter_t){index, 0};
        weights[next] = weight * sphere_area(&blob->spheres[shape->geometry],
                                             &lights->sphere_from_object[shape->geometry]);
        return next + 1;
    }
    const blob_mesh_t *mesh = &blob->meshes[shape->geometry];
    for (uint32_t t = 0; t < mesh->triangle_count; t++, next++) {
        lights->emitters[next] = (emitter_t){index, t};
        weights[next] = weight * triangle_area(blob, mesh, t);
    }
    return next;
}

lights_t *lights_new(const scene_blob_t *blob)
{
    lights_t *lights = mem_zalloc(1, sizeof *lights);
    lights->blob = blob;
    uint64_t count = blob->counts[BLOB_SECTION_LIGHTS], spheres = blob->counts[BLOB_SECTION_SPHERES];
    lights->sphere_from_object = mem_zalloc(spheres + 1, sizeof *lights->sphere_from_object);
    for (uint64_t i = 0; i < spheres; i++)
        xform_invert(&blob->spheres[i].object_from_sphere, &lights->sphere_from_object[i]);
    uint32_t emitters = count_emitters(blob), next = 0;
    lights->emitters = mem_zalloc((size_t)emitters + 1, sizeof *lights->emitters);
    double *weights = mem_zalloc((size_t)emitters + 1, sizeof *weights);
    for (uint32_t i = 0; i < count; i++) next = list_emitters(lights, i, weights, next);
    alias_init(&lights->alias, weights, emitters);
    free(weights);
    lights->pdf_area = mem_zalloc(count + 1, sizeof *lights->pdf_area);
    if (!lights_empty(lights))
        for (uint64_t i = 0; i < count; i++) {
            const blob_shape_t *shape = &blob->shapes[blob->lights[i].shape];
            double pdf = light_weight(&blob->lights[i]) / lights->alias.total;
            if (shape->kind == SHAPE_SPHERE)
                pdf *= sphere_area(&blob->spheres[shape->geometry],
                                   &lights->sphere_from_object[shape->geometry]);
            lights->pdf_area[i] = (float)pdf;
        }
    return lights;
}

void lights_destroy(lights_t **lights)
{
    lights_t *self = *lights;
    if (self == NULL) return;
    alias_free(&self->alias);
    free(self->emitters);
    free(self->pdf_area);
    free(self->sphere_from_object);
    free(self);
    *lights = NULL;
}

bool lights_empty(const lights_t *lights)
{
    return lights->alias.count == 0;
}

/* Density per area at the point of a sphere light whose outward normal is `local` in the sphere's space. */
static float sphere_pdf(const lights_t *lights, uint32_t light, uint32_t geometry, vec3_t local)
{
    const blob_sphere_t *sphere = &lights->blob->spheres[geometry];
    float stretch = sphere_stretch(sphere, &lights->sphere_from_object[geometry], local);
    return lights->pdf_area[light] / (4 * PI_F * sphere->radius * sphere->radius * stretch);
}

static void sample_triangle(const scene_blob_t *blob, const blob_shape_t *shape, uint32_t index, vec2_t u,
                            light_point_t *point)
{
    const blob_mesh_t *mesh = &blob->meshes[shape->geometry];
    const vec3_t *p = blob->positions + mesh->first_position;
    const uint32_t *v = blob->triangles[mesh->first_triangle + index].v;
    vec2_t b = warp_triangle(u);
    vec3_t e1 = v_sub(p[v[1]], p[v[0]]), e2 = v_sub(p[v[2]], p[v[0]]);
    point->p = v_add(p[v[0]], v_add(v_scale(e1, b.x), v_scale(e2, b.y)));
    point->n = v_normalize(v_cross(e1, e2));
    bool flip = shape->flags & SHAPE_FLIP;
    if (mesh->first_normal != BLOB_NONE) {
        const vec3_t *n = blob->normals + mesh->first_normal;
        vec3_t ns =
            v_add(v_scale(n[v[0]], 1 - b.x - b.y), v_add(v_scale(n[v[1]], b.x), v_scale(n[v[2]], b.y)));
        flip = v_dot(ns, point->n) < 0;
    }
    if (flip) point->n = v_neg(point->n);
}

void lights_sample(const lights_t *lights, float choice, vec2_t u, light_point_t *point)
{
    const scene_blob_t *blob = lights->blob;
    emitter_t emitter = lights->emitters[alias_sample(&lights->alias, &choice)];
    const blob_light_t *light = &blob->lights[emitter.light];
    const blob_shape_t *shape = &blob->shapes[light->shape];
    point->radiance = light->radiance;
    point->two_sided = light->flags & LIGHT_TWO_SIDED;
    if (shape->kind == SHAPE_MESH) {
        sample_triangle(blob, shape, emitter.primitive, u, point);
        point->pdf_area = lights->pdf_area[emitter.light];
    } else {
        const blob_sphere_t *sphere = &blob->spheres[shape->geometry];
        vec3_t local = warp_sphere(u);
        point->p = xform_point(&sphere->object_from_sphere, v_scale(local, sphere->radius));
        point->n = v_normalize(xform_normal(&lights->sphere_from_object[shape->geometry], local));
        if (shape->flags & SHAPE_FLIP) point->n = v_neg(point->n);
        point->pdf_area = sphere_pdf(lights, emitter.light, shape->geometry, local);
    }
    point->offset = scene_offset_at(point->p);
}

void lights_at(const lights_t *lights, const surface_t *surface, light_point_t *point)
{
    const blob_light_t *light = &lights->blob->lights[surface->light];
    const blob_shape_t *shape = &lights->blob->shapes[light->shape];
    *point = (light_point_t){.p = surface->p,
                             .n = surface->ng,
                             .offset = surface->offset,
                             .radiance = light->radiance,
                             .pdf_area = lights->pdf_area[surface->light],
                             .two_sided = light->flags & LIGHT_TWO_SIDED};
    if (shape->kind == SHAPE_SPHERE) {
        vec3_t local = v_normalize(xform_point(&lights->sphere_from_object[shape->geometry], surface->p));
        point->pdf_area = sphere_pdf(lights, surface->light, shape->geometry, local);
    }
}

vec3_t light_sample_direction(const light_point_t *point, vec2_t u)
{
    float side = 1;
    if (point->two_sided) {
        side = u.x < 0.5f ? 1 : -1;
        u.x = u.x < 0.5f ? 2 * u.x : 2 * u.x - 1;
    }
    vec3_t s, t, local = warp_cosine_hemisphere(u), n = v_scale(point->n, side);
    v_frame(n, &s, &t);
    return v_add(v_add(v_scale(s, local.x), v_scale(t, local.y)), v_scale(n, local.z));
}
