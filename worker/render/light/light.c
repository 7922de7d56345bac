/* light: the table of kinds, the choice among emitters (see light.h). */
#include "worker/render/light/light.h"

#include "worker/render/sampling/alias.h"

#include <stdlib.h>

#define TABLE_ENTRY(kind, ops) [kind] = &(ops),
static const light_ops_t *const kinds[] = {LIGHT_KINDS(TABLE_ENTRY)};
#undef TABLE_ENTRY

typedef struct {
    uint32_t light;
    uint32_t primitive; /* triangle of the mesh; 0 for all else */
} emitter_t;

struct lights {
    light_t *lights; /* [count] */
    uint32_t count;
    emitter_t *emitters; /* [alias.count] */
    alias_t alias;
    uint32_t *sky; /* [sky_count] those that are everywhere */
    uint32_t sky_count;
};

/* Prepares the lights; returns how many emitters they have. */
static uint32_t place_lights(lights_t *lights, const scene_t *scene)
{
    const scene_blob_t *blob = scene_blob(scene);
    uint64_t emitters = 0;
    vec3_t centre;
    float radius;
    scene_bounds(scene, &centre, &radius);
    /* A scene without extent still has room for a ray. */
    radius = float_max(radius, 1e-3f);
    for (uint32_t i = 0; i < lights->count; i++) {
        light_t *light = &lights->lights[i];
        *light = (light_t){.scene = scene, .record = &blob->lights[i], .centre = centre, .radius = radius};
        const light_ops_t *kind = kinds[light->record->kind];
        if (kind->prepare != NULL) light->state = kind->prepare(light);
        if (kind->escape != NULL) lights->sky[lights->sky_count++] = i;
        emitters += light->record->kind == LIGHT_AREA ? light_area_primitives(light) : 1;
    }
    return (uint32_t)emitters;
}

/* Lists the emitters with their weights. */
static void list_emitters(lights_t *lights, double *weights)
{
    uint32_t next = 0;
    for (uint32_t i = 0; i < lights->count; i++) {
        const light_t *light = &lights->lights[i];
        double power = kinds[light->record->kind]->power(light); /* of an area light per area */
        uint32_t primitives = light->record->kind == LIGHT_AREA ? light_area_primitives(light) : 1;
        for (uint32_t k = 0; k < primitives; k++, next++) {
            lights->emitters[next] = (emitter_t){i, k};
            weights[next] = light->record->kind == LIGHT_AREA ? power * light_area_of(light, k) : power;
        }
    }
}

lights_t *lights_new(const scene_t *scene)
{
    const scene_blob_t *blob = scene_blob(scene);
    lights_t *lights = mem_zalloc(1, sizeof *lights);
    lights->count = (uint32_t)blob->counts[BLOB_SECTION_LIGHTS];
    lights->lights = mem_zalloc((size_t)lights->count + 1, sizeof *lights->lights);
    lights->sky = mem_zalloc((size_t)lights->count + 1, sizeof *lights->sky);
    uint32_t emitters = place_lights(lights, scene);
    lights->emitters = mem_zalloc((size_t)emitters + 1, sizeof *lights->emitters);
    double *weights = mem_zalloc((size_t)emitters + 1, sizeof *weights);
    list_emitters(lights, weights);
    alias_init(&lights->alias, weights, emitters);
    free(weights);
    for (uint32_t i = 0; i < lights->count && !lights_empty(lights); i++) {
        light_t *light = &lights->lights[i];
        light->chance = (float)(kinds[light->record->kind]->power(light) / lights->alias.total);
    }
    return lights;
}

void lights_destroy(lights_t **lights)
{
    lights_t *self = *lights;
    if (self == NULL) return;
    for (uint32_t i = 0; i < self->count; i++) {
        const light_ops_t *kind = kinds[self->lights[i].record->kind];
        if (kind->release != NULL) kind->release(self->lights[i].state);
    }
    alias_free(&self->alias);
    free(self->lights);
    free(self->emitters);
    free(self->sky);
    free(self);
    *lights = NULL;
}

bool lights_empty(const lights_t *lights)
{
    return lights->alias.count == 0;
}

bool lights_emit(const lights_t *lights, float choice, vec2_t place, vec2_t ray, light_ray_t *out)
{
    emitter_t emitter = lights->emitters[alias_sample(&lights->alias, &choice)];
    const light_t *light = &lights->lights[emitter.light];
    *out = (light_ray_t){.light = emitter.light, .cosine = 1};
    return kinds[light->record->kind]->emit(light, emitter.primitive, place, ray, out);
}

bool lights_illuminate(const lights_t *lights, vec3_t point, float choice, vec2_t place, light_view_t *out)
{
    emitter_t emitter = lights->emitters[alias_sample(&lights->alias, &choice)];
    const light_t *light = &lights->lights[emitter.light];
    *out = (light_view_t){.light = emitter.light};
    return kinds[light->record->kind]->illuminate(light, emitter.primitive, point, place, out);
}

bool lights_hit(const lights_t *lights, const surface_t *surface, vec3_t wo, light_hit_t *out)
{
    out->light = surface->light;
    return light_area_hit(&lights->lights[surface->light], surface, wo, out);
}

uint32_t lights_sky_count(const lights_t *lights)
{
    return lights->sky_count;
}

bool lights_escape(const lights_t *lights, uint32_t k, vec3_t point, vec3_t w, light_hit_t *out)
{
    const light_t *light = &lights->lights[lights->sky[k]];
    out->light = lights->sky[k];
    return kinds[light->record->kind]->escape(light, point, w, out);
}

float lights_enter(const lights_t *lights, uint32_t number, vec3_t point)
{
    const light_t *light = &lights->lights[number];
    return kinds[light->record->kind]->enter(light, point);
}
