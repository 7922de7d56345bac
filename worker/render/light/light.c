/* light: the table of kinds, the choice among emitters (see light.h). */
#include "worker/render/light/light.h"

#include "common/sampler.h"
#include "worker/render/sampling/alias.h"

#include <math.h>
#include <stdlib.h>

#define TABLE_ENTRY(kind, ops) [kind] = &(ops),
static const light_ops_t *const kinds[] = {LIGHT_KINDS(TABLE_ENTRY)};
#undef TABLE_ENTRY

/* How many places the first vertex draws: on a few lights together, if each has its part; or on so many
 * lights that are chosen. */
enum { PLACES = 4 };
/* Where there is a sky: more would cost more than they bring (docs/performance.md). */
enum { PLACES_WITH_SKY = 3, FEW_WITH_SKY = 3 };
/* Of a light without lessons. */
static const uint32_t NO_LESSON = UINT32_MAX;
/* Of a place whose light is to be chosen. */
static const uint32_t ANY_LIGHT = UINT32_MAX;
/* The part of light subpaths whose light is chosen by power, whatever was learned. */
static const double BY_POWER = 0.25;

/* One of the places that the first vertex asks for. */
typedef struct {
    uint32_t light; /* or ANY_LIGHT */
    uint32_t pair;  /* of random numbers; the same for all places of a light, */
    float shift;    /* which are kept apart by this */
} asked_t;

struct lights {
    light_t *lights; /* [count] */
    uint32_t count;
    alias_t alias;        /* of all lights, by power */
    alias_t worth;        /* by what light subpaths from them are worth; empty: by power */
    light_tree_t *tree;   /* of those that are somewhere; NULL: they are few, and chosen by power */
    alias_t far;          /* of the others, where there is a tree; */
    float far_share;      /* and their part of the power */
    const lights_t *base; /* without guides: their states are its own; NULL: it is one */
    uint32_t *sky;        /* [sky_count] those that are everywhere */
    uint32_t sky_count;
    asked_t asked[LIGHTS_FIRST_MOST]; /* [asked_count] */
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
                           .medium = blob->lights[i].medium,
                           .centre = centre,
                           .radius = radius,
                           .half_sides = half_sides};
        const light_ops_t *kind = kinds[light->record->kind];
        if (!(light->record->flags & LIGHT_PORTAL)) light->guide_kind = kind->guide;
        if (kind->prepare != NULL) light->state = kind->prepare(light);
        if (kind->escape != NULL) lights->sky[lights->sky_count++] = i;
    }
}

/* Enters so many places to ask for on a light, or on any. */
static void enter_places(lights_t *lights, uint32_t light, uint32_t pair, uint32_t times)
{
    for (uint32_t k = 0; k < times; k++)
        lights->asked[lights->asked_count++] = (asked_t){light, pair, (float)k / (float)times};
}

/* How many places a light is asked for that has some of its own, when so many shine. One without extent would
 * always answer the same; places of a sky cost more than they bring sooner than those of others. */
static uint32_t places_of(const lights_t *lights, const light_t *light, uint32_t shining)
{
    if (kinds[light->record->kind]->escape != NULL) return shining == 1 ? PLACES_WITH_SKY : 2;
    if (light->record->kind != LIGHT_AREA || lights->sky_count > 0 || shining == 0 || shining >= PLACES)
        return 1;
    return PLACES / shining;
}

/* Decides where the first vertex asks for places, when so many lights shine: each has its own of few. */
static void place_first(lights_t *lights, uint32_t shining)
{
    bool has_sky = lights->sky_count > 0, any = shining > (has_sky ? FEW_WITH_SKY : LIGHTS_FIRST_MOST);
    uint32_t pair = 0, of_any = has_sky ? PLACES_WITH_SKY : PLACES;
    if (any) enter_places(lights, ANY_LIGHT, pair, of_any);
    for (uint32_t i = 0; i < lights->count; i++) {
        light_t *light = &lights->lights[i];
        light->first_times = (float)of_any;
        if (any || !(light->chance > 0)) continue;
        uint32_t times = places_of(lights, light, shining);
        light->first_times = (float)times / light->chance;
        enter_places(lights, i, pair++, times);
    }
}

/* Grows the tree of lights that are somewhere, if they are many. */
static void grow_tree(lights_t *lights, const double *powers)
{
    light_box_t *boxes = mem_alloc(((size_t)lights->count + 1) * sizeof *boxes);
    double *far = mem_zalloc((size_t)lights->count + 1, sizeof *far);
    uint32_t count = 0;
    for (uint32_t i = 0; i < lights->count; i++) {
        const light_t *light = &lights->lights[i];
        const light_ops_t *kind = kinds[light->record->kind];
        if (kind->box == NULL) far[i] = powers[i];
        if (kind->box == NULL || !(powers[i] > 0)) continue;
        light_box_t *box = &boxes[count++];
        *box = (light_box_t){.power = powers[i], .light = i};
        kind->box(light, &box->low, &box->high);
    }
    if (count > LIGHTS_FIRST_MOST) {
        lights->tree = light_tree_new(boxes, count, lights->count);
        alias_init(&lights->far, far, lights->count);
        lights->far_share = (float)(lights->far.total / lights->alias.total);
    }
    free(far);
    free(boxes);
}

/* Notes the chance of each light, and which are asked by the first vertex. */
static void choose_lights(lights_t *lights)
{
    double *powers = mem_zalloc((size_t)lights->count + 1, sizeof *powers);
    uint32_t shining = 0;
    for (uint32_t i = 0; i < lights->count; i++)
        powers[i] = kinds[lights->lights[i].record->kind]->power(&lights->lights[i]);
    alias_init(&lights->alias, powers, lights->count);
    for (uint32_t i = 0; i < lights->count && !lights_empty(lights); i++) {
        lights->lights[i].chance = (float)(powers[i] / lights->alias.total);
        lights->lights[i].view_ratio = 1;
        shining += lights->lights[i].chance > 0;
    }
    place_first(lights, shining);
    grow_tree(lights, powers);
    free(powers);
}

/* True for what light gets through into another medium: the sides of other surfaces say nothing, since
 * nobody sees whether a sheet that stops light faces the right way. */
static bool parts_media(const surface_t *surface)
{
    const blob_material_t *material = surface->material;
    bool lets_through =
        surface_is_interface(surface) || material->body != 0 || material->kind == MATERIAL_DIELECTRIC;
    return lets_through && surface->shape->flags & SHAPE_INTERFACE;
}

/* The medium that a light shines into which has a place: that on the near side of the interfaces, surfaces of
 * bodies, and glass that is full, that its light meets first, if all of them agree; otherwise what the scene
 * says. */
static blob_ref_t medium_of(const light_t *light, uint32_t number)
{
    enum { RAYS = 16 };
    sampler_t numbers = sampler_new(SAMPLER_INDEPENDENT, 0, number, 0);
    blob_ref_t found = light->medium;
    bool met = false;
    for (int i = 0; i < RAYS; i++) {
        light_ray_t ray = {.light = number};
        surface_t surface;
        float choice = sampler_1d(&numbers);
        vec2_t place = sampler_2d(&numbers), direction = sampler_2d(&numbers);
        if (!kinds[light->record->kind]->emit(light, choice, place, direction, &ray)) continue;
        if (!scene_intersect(light->scene, ray.origin, ray.direction, 0, &surface)) continue;
        if (!parts_media(&surface)) continue;
        blob_ref_t near = surface.shape->media[v_dot(ray.direction, surface.ng) < 0];
        if (met && near != found) return light->medium;
        found = near;
        met = true;
    }
    return found;
}

/* True when no shape parts media: the camera's is everywhere. */
static bool is_of_one_medium(const scene_blob_t *blob)
{
    for (size_t i = 0; i < blob->counts[BLOB_SECTION_SHAPES]; i++)
        if (blob->shapes[i].flags & SHAPE_INTERFACE) return false;
    return true;
}

/* A scene may say otherwise, or nothing; but what the camera sees of a light knows the interfaces alone, and
 * light subpaths must not know better. */
static void find_media(lights_t *lights, const scene_blob_t *blob)
{
    bool one = is_of_one_medium(blob);
    for (uint32_t i = 0; i < lights->count; i++) {
        light_t *light = &lights->lights[i];
        if (light->record->kind < LIGHT_DISTANT)
            light->medium = one ? blob->scene->medium : medium_of(light, i);
        if (light->medium != light->record->medium)
            log_debug("light %u shines into medium %u, and not into %u, as its scene says", i, light->medium,
                      light->record->medium);
    }
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
    if (blob->counts[BLOB_SECTION_MEDIA] > 0) find_media(lights, blob);
    return lights;
}

void lights_destroy(lights_t **lights)
{
    lights_t *self = *lights;
    if (self == NULL) return;
    for (uint32_t i = 0; i < self->count; i++) {
        light_t *light = &self->lights[i];
        const light_ops_t *kind = kinds[light->record->kind];
        light_guide_destroy(&light->guide);
        if (self->base == NULL && kind->release != NULL) kind->release(light->state);
    }
    alias_free(&self->worth);
    if (self->base == NULL) {
        alias_free(&self->alias);
        alias_free(&self->far);
        light_tree_destroy(&self->tree);
        free(self->sky);
    }
    free(self->lights);
    free(self);
    *lights = NULL;
}

/* ---- learning ------------------------------------------------------------------------------------------ */

/* By falling chance; the same ones by their number. */
static int chance_order(const void *a, const void *b)
{
    const light_t *const *u = a, *const *v = b;
    if ((*u)->chance != (*v)->chance) return (*u)->chance > (*v)->chance ? -1 : 1;
    return *u < *v ? -1 : *u > *v;
}

/* How finely the starts of all lights can be cut, at the most. */
static uint32_t find_fineness(const lights_t *lights, uint32_t room)
{
    for (uint32_t fineness = LIGHT_GUIDE_FINEST; fineness > 0; fineness--) {
        uint64_t lessons = 0;
        for (uint32_t i = 0; i < lights->count; i++) {
            guide_kind_t kind = lights->lights[i].guide_kind;
            if (lights->lights[i].chance > 0)
                lessons += GUIDE_LESSONS * light_guide_cells(kind, light_guide_side(kind, fineness));
        }
        if (lessons <= room) return fineness;
    }
    return 0;
}

void lights_learn(lights_t *lights, uint32_t room)
{
    const light_t **order = mem_alloc((lights->count + 1) * sizeof *order);
    uint32_t taken = 0, fineness = find_fineness(lights, room);
    for (uint32_t i = 0; i < lights->count; i++) order[i] = &lights->lights[i];
    qsort(order, lights->count, sizeof *order, chance_order);
    for (uint32_t i = 0; i < lights->count; i++) {
        light_t *light = &lights->lights[order[i] - lights->lights];
        light->guide_side = light_guide_side(light->guide_kind, fineness);
        uint32_t lessons = GUIDE_LESSONS * light_guide_cells(light->guide_kind, light->guide_side);
        light->first_lesson = NO_LESSON;
        if (!(light->chance > 0) || lessons > room - taken) continue;
        light->first_lesson = taken;
        taken += lessons;
    }
    free(order);
}

/* Chooses the lights by what they are worth, and by power where that is not known, both mixed. */
static void choose_by_worth(lights_t *lights, const double *worths, double share)
{
    double *weights = mem_zalloc((size_t)lights->count + 1, sizeof *weights), sum = 0;
    for (uint32_t i = 0; i < lights->count; i++) sum += worths[i];
    for (uint32_t i = 0; i < lights->count; i++) {
        double power = (double)lights->lights[i].chance;
        weights[i] = sum > 0 ? BY_POWER * power + (1 - BY_POWER) * worths[i] / sum : power;
    }
    alias_init(&lights->worth, weights, lights->count);
    for (uint32_t i = 0; i < lights->count && lights->worth.count > 0; i++) {
        light_t *light = &lights->lights[i];
        float power = light->chance;
        light->chance = (float)(share * weights[i] / lights->worth.total);
        light->view_ratio = light->chance > 0 ? power / light->chance : 1;
    }
    free(weights);
}

lights_t *lights_guided(const lights_t *base, const double *lessons, double samples, double reach,
                        double left, double least, float *share)
{
    lights_t *lights = mem_alloc(sizeof *lights);
    *lights = *base;
    lights->base = base;
    lights->lights = mem_alloc(((size_t)base->count + 1) * sizeof *lights->lights);
    double *worths = mem_zalloc((size_t)base->count + 1, sizeof *worths), sum = 0, known = 0;
    for (uint32_t i = 0; i < base->count; i++) {
        light_t *light = &lights->lights[i];
        *light = base->lights[i];
        if (light->first_lesson == NO_LESSON) continue;
        light->guide = light_guide_new(light->guide_kind, light->guide_side, lessons + light->first_lesson,
                                       samples, left, &worths[i]);
        sum += worths[i];
        known += (double)light->chance;
    }
    /* Of others their power says what they are worth. */
    for (uint32_t i = 0; i < base->count && known > 0; i++)
        if (lights->lights[i].first_lesson == NO_LESSON)
            worths[i] = sum * (double)lights->lights[i].chance / known;
    *share = (float)fmax(least, fmin(1, known > 0 ? reach * sum / known : 1));
    choose_by_worth(lights, worths, (double)*share);
    free(worths);
    return lights;
}

bool lights_empty(const lights_t *lights)
{
    return lights->alias.count == 0;
}

float lights_flux(const lights_t *lights)
{
    return (float)lights->alias.total;
}

/* The chance of a light by its power. */
static float power_chance(const lights_t *lights, uint32_t number)
{
    return lights->lights[number].chance * lights->lights[number].view_ratio;
}

/* The k-th lesson of a start. */
static uint32_t lesson_at(const light_t *light, const light_start_t *start, uint32_t k)
{
    return light->first_lesson + k * light_guide_cells(light->guide_kind, light->guide_side) + start->cell;
}

bool lights_emit(const lights_t *lights, float choice, vec2_t place, vec2_t ray, light_ray_t *out)
{
    uint32_t number = alias_sample(lights->worth.count > 0 ? &lights->worth : &lights->alias, &choice);
    const light_t *light = &lights->lights[number];
    *out = (light_ray_t){.light = number,
                         .cosine = 1,
                         .medium = light->medium,
                         .view_ratio = light->view_ratio,
                         .start = {0, 1}};
    if (!kinds[light->record->kind]->emit(light, choice, place, ray, out)) return false;
    out->start.density *= light->first_lesson == NO_LESSON ? 0 : light->chance;
    out->lessons[0] = lesson_at(light, &out->start, GUIDE_SQUARES);
    out->lessons[1] = lesson_at(light, &out->start, GUIDE_COSTS);
    return true;
}

/* What lights_nearness is of a light that the tree has this chance for. */
static float nearness_of(const lights_t *lights, uint32_t number, float chance)
{
    return chance * (1 - lights->far_share) / power_chance(lights, number);
}

/* The light that s = 1 asks for a point. */
static uint32_t choose_near(const lights_t *lights, vec3_t point, float *choice, float *nearness)
{
    *nearness = 1;
    if (lights->tree == NULL) return alias_sample(&lights->alias, choice);
    bool far = *choice < lights->far_share;
    *choice = far ? *choice / lights->far_share : (*choice - lights->far_share) / (1 - lights->far_share);
    *choice = float_min(*choice, 0x1.fffffep-1f);
    if (far) return alias_sample(&lights->far, choice);
    float chance;
    uint32_t number = light_tree_choose(lights->tree, point, choice, &chance);
    *nearness = nearness_of(lights, number, chance);
    return number;
}

float lights_nearness(const lights_t *lights, uint32_t number, vec3_t point)
{
    if (lights->tree == NULL || kinds[lights->lights[number].record->kind]->box == NULL) return 1;
    if (!(power_chance(lights, number) > 0)) return 1; /* a picture, which the tree does not have */
    return nearness_of(lights, number, light_tree_chance(lights->tree, number, point));
}

/* `nearness`: lights_nearness; `times`: how many such places there are. */
static bool ask(const lights_t *lights, uint32_t number, float nearness, float times, vec3_t point,
                float choice, vec2_t place, light_view_t *out)
{
    const light_t *light = &lights->lights[number];
    *out = (light_view_t){.light = number,
                          .medium = light->medium,
                          .view_ratio = light->view_ratio * nearness,
                          .nearness = nearness};
    if (!kinds[light->record->kind]->illuminate(light, choice, point, place, out)) return false;
    out->density = out->pdf_place * out->view_ratio * times;
    return true;
}

bool lights_illuminate(const lights_t *lights, vec3_t point, float choice, vec2_t place, light_view_t *out)
{
    float nearness;
    uint32_t number = choose_near(lights, point, &choice, &nearness);
    return ask(lights, number, nearness, 1, point, choice, place, out);
}

uint32_t lights_first_count(const lights_t *lights)
{
    return lights->asked_count;
}

uint32_t lights_first_pair(const lights_t *lights, uint32_t k)
{
    return lights->asked[k].pair;
}

float lights_first_times(const lights_t *lights, uint32_t number)
{
    return lights->lights[number].first_times;
}

/* Moves a number within [0, 1), round its end. */
static float shift(float u, float by)
{
    return u + by < 1 ? u + by : u + by - 1;
}

bool lights_illuminate_first(const lights_t *lights, uint32_t k, vec3_t point, float choice, vec2_t place,
                             light_view_t *out)
{
    const asked_t *asked = &lights->asked[k];
    place = (vec2_t){shift(place.x, asked->shift), shift(place.y, asked->shift)};
    choice = shift(choice, asked->shift);
    float nearness = 1;
    uint32_t number =
        asked->light != ANY_LIGHT ? asked->light : choose_near(lights, point, &choice, &nearness);
    return ask(lights, number, nearness, lights_first_times(lights, number), point, choice, place, out);
}

/* What is known of a hit before its kind of light is asked, */
static light_hit_t hit_on(const lights_t *lights, uint32_t number)
{
    return (light_hit_t){.light = number, .view_ratio = lights->lights[number].view_ratio};
}

/* and what is to be added after that. */
static void complete_hit(const light_t *light, light_hit_t *hit)
{
    hit->start.density *= light->first_lesson == NO_LESSON ? 0 : light->chance;
    hit->lesson = lesson_at(light, &hit->start, GUIDE_LEFT);
}

bool lights_hit(const lights_t *lights, vec3_t point, const surface_t *surface, vec3_t wo, light_hit_t *out)
{
    const light_t *light = &lights->lights[surface->light];
    *out = hit_on(lights, surface->light);
    if (!light_area_hit(light, surface, wo, out)) return false;
    out->view_ratio *= lights_nearness(lights, surface->light, point);
    complete_hit(light, out);
    return true;
}

uint32_t lights_sky_count(const lights_t *lights)
{
    return lights->sky_count;
}

bool lights_escape(const lights_t *lights, uint32_t k, vec3_t point, vec3_t w, light_hit_t *out)
{
    const light_t *light = &lights->lights[lights->sky[k]];
    *out = hit_on(lights, lights->sky[k]);
    if (!kinds[light->record->kind]->escape(light, point, w, out)) return false;
    complete_hit(light, out);
    return true;
}

float lights_enter(const lights_t *lights, uint32_t number, vec3_t point)
{
    const light_t *light = &lights->lights[number];
    return kinds[light->record->kind]->enter(light, point);
}
