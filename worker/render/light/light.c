/* light: the table of kinds, the choice among emitters (see light.h). */
#include "worker/render/light/light.h"

#include "worker/render/sampling/alias.h"

#include <stdlib.h>

#define TABLE_ENTRY(kind, ops) [kind] = &(ops),
static const light_ops_t *const kinds[] = {LIGHT_KINDS(TABLE_ENTRY)};
#undef TABLE_ENTRY

/* Where each light is not asked: a single one is asked so often, of more than can be asked so many are
 * chosen. */
enum { CHOSEN = 2 };

struct lights {
    light_t *lights; /* [count] */
    uint32_t count;
    alias_t alias; /* of all lights, by power */
    uint32_t *sky; /* [sky_count] those that are everywhere */
    uint32_t sky_count;
    uint32_t asked[LIGHTS_FIRST_MOST]; /* [asked_count] the lights with power; none where they are more, or one */
    uint32_t asked_count;
};

/* Prepares the lights. */
static void place_lights(lights_t *lights, const scene_t *scene)
{
    const scene_blob_t *blob = scene_blob(scene);
    vec3_t centre;
    float radius;
    scene_bounds(scene, &centre, &radius);
    /* A scene without extent still has room for a ray. */
    radius = float_max(radius, 1e-3f);
    float margin = 1e-3f * radius;
    vec3_t half_sides = v_add(scene_half_sides(scene), vec3(margin, margin, margin));
    for (uint32_t i = 0; i < lights->count; i++) {
        light_t *light = &lights->lights[i];
        *light = (light_t){.scene = scene,
                           .record = &blob->lights[i],
                           .centre = centre,
                           .radius = radius,
                           .half_sides = half_sides};
        const light_ops_t *kind = kinds[light->record->kind];
        if (kind->prepare != NULL) light->state = kind->prepare(light);
        if (kind->escape != NULL) lights->sky[lights->sky_count++] = i;
    }
}

/* Notes the chance of each light, and which are asked one by one. */
static void choose_lights(lights_t *lights)
{
    double *powers = mem_zalloc((size_t)lights->count + 1, sizeof *powers);
    uint32_t shining = 0;
    for (uint32_t i = 0; i < lights->count; i++)
        powers[i] = kinds[lights->lights[i].record->kind]->power(&lights->lights[i]);
    alias_init(&lights->alias, powers, lights->count);
    for (uint32_t i = 0; i < lights->count && !lights_empty(lights); i++) {
        lights->lights[i].chance = (float)(powers[i] / lights->alias.total);
        if (!(lights->lights[i].chance > 0)) continue;
        if (shining < LIGHTS_FIRST_MOST) lights->asked[shining] = i;
        shining++;
    }
    lights->asked_count = shining > 1 && shining <= LIGHTS_FIRST_MOST ? shining : 0;
    free(powers);
}

lights_t *lights_new(const scene_t *scene)
{
    const scene_blob_t *blob = scene_blob(scene);
    lights_t *lights = mem_zalloc(1, sizeof *lights);
    lights->count = (uint32_t)blob->counts[BLOB_SECTION_LIGHTS];
    lights->lights = mem_zalloc((size_t)lights->count + 1, sizeof *lights->lights);
    lights->sky = mem_zalloc((size_t)lights->count + 1, sizeof *lights->sky);
    place_lights(lights, scene);
    choose_lights(lights);
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
    uint32_t number = alias_sample(&lights->alias, &choice);
    const light_t *light = &lights->lights[number];
    *out = (light_ray_t){.light = number, .cosine = 1};
    return kinds[light->record->kind]->emit(light, choice, place, ray, out);
}

/* `ratio` as lights_first_ratio. */
static bool ask(const lights_t *lights, uint32_t number, float ratio, vec3_t point, float choice,
                vec2_t place, light_view_t *out)
{
    const light_t *light = &lights->lights[number];
    *out = (light_view_t){.light = number};
    if (!kinds[light->record->kind]->illuminate(light, choice, point, place, out)) return false;
    out->density = out->pdf_place * ratio;
    return true;
}

bool lights_illuminate(const lights_t *lights, vec3_t point, float choice, vec2_t place, light_view_t *out)
{
    uint32_t number = alias_sample(&lights->alias, &choice);
    return ask(lights, number, 1, point, choice, place, out);
}

bool lights_are_all_asked(const lights_t *lights)
{
    return lights->asked_count > 0;
}

uint32_t lights_first_count(const lights_t *lights)
{
    return lights_are_all_asked(lights) ? lights->asked_count : CHOSEN;
}

float lights_first_ratio(const lights_t *lights, uint32_t light)
{
    return lights_are_all_asked(lights) ? 1 / lights->lights[light].chance : CHOSEN;
}

/* Moves a number within [0, 1), round its end. */
static float shift(float u, float by)
{
    return u + by < 1 ? u + by : u + by - 1;
}

bool lights_illuminate_first(const lights_t *lights, uint32_t k, vec3_t point, float choice, vec2_t place,
                             light_view_t *out)
{
    uint32_t number;
    if (lights_are_all_asked(lights)) {
        number = lights->asked[k];
    } else {
        float by = (float)k / CHOSEN;
        choice = shift(choice, by);
        place = (vec2_t){shift(place.x, by), shift(place.y, by)};
        number = alias_sample(&lights->alias, &choice);
    }
    return ask(lights, number, lights_first_ratio(lights, number), point, choice, place, out);
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
