/* vertex: see vertex.h. */
#include "worker/render/integrator/vertex.h"

bool vertex_eval_split(const vertex_t *vertex, vec3_t w, bool delta, float pdf_place, float ratio,
                       bsdf_value_t *value, float *share)
{
    if (vertex->kind != VERTEX_SURFACE || !(vertex->surface.shape->flags & SHAPE_NORMALS_V3) ||
        !bsdf_eval_split(&vertex->bsdf, vertex->wo, w, vertex->mode, value))
        return false;
    *share = delta ? 1 : (1 + ratio) / (1 + ratio + 1 / pdf_place);
    return true;
}

bool vertex_light_hit(const vertex_t *vertex, const sample_t *sample, uint32_t k, vec3_t from,
                      light_hit_t *hit)
{
    const lights_t *lights = sample->setup->lights;
    bool shines = vertex->kind == VERTEX_SKY ? lights_escape(lights, k, from, v_neg(vertex->wo), hit)
                                             : lights_hit(lights, from, &vertex->surface, vertex->wo, hit);
    if (shines) hit->radiance = sample_light(sample, hit->light, hit->radiance);
    return shines;
}

void vertex_first_hit(const vertex_t *vertex, sample_t *sample, vec3_t origin)
{
    if (sample->sample >= FEATURE_SAMPLES || vertex->kind != VERTEX_SURFACE) return;
    const scene_blob_t *blob = scene_blob(sample->setup->scene);
    const bsdf_t *bsdf = &vertex->bsdf;
    const surface_t *surface = &vertex->surface;
    rgb_t albedo = bsdf_albedo(bsdf);
    if (sample->waves != NULL) { /* the layer has colours */
        bsdf_t colours;
        material_bsdf(sample->setup->scene, surface, &colours);
        albedo = bsdf_albedo(&colours);
    }
    bool behind = v_dot(bsdf->ng, v_sub(vertex_point(vertex), origin)) > 0; /* seen from its back */
    vec3_t normal = behind ? v_neg(bsdf->ns) : bsdf->ns;
    sample->first_hit =
        (first_hit_t){.hit = true,
                      .albedo = {albedo.x, albedo.y, albedo.z},
                      .normal = {normal.x, normal.y, normal.z},
                      .position = {vertex_point(vertex).x, vertex_point(vertex).y, vertex_point(vertex).z},
                      .depth = v_length(v_sub(vertex_point(vertex), origin)),
                      .object = (uint32_t)(surface->shape - blob->shapes) + 1,
                      .material = (uint32_t)(surface->material - blob->materials) + 1};
}
