/* material: see material.h. The frame in which lobes stand is turned in shading_frame.c. */
#include "worker/render/material/material.h"

#include "common/sampler.h"
#include "worker/render/material/shading_frame.h"

#define TABLE_ENTRY(kind, shade) [kind] = shade,
static material_shade_t *const materials[MATERIAL_KIND_END] = {MATERIALS(TABLE_ENTRY)};
#undef TABLE_ENTRY

/* What is not in the table scatters nothing. */
static void shade(const shading_t *shading)
{
    material_shade_t *material = materials[shading->material->kind];
    if (material != NULL) material(shading);
}

static bool is_chosen(const blob_material_t *material)
{
    return material->kind == MATERIAL_MIX && (material->flags & MATERIAL_CHOSEN) != 0;
}

/* The part that a point of a mix has (MATERIAL_CHOSEN), and what it then counts. That of a part which is
 * such a mix is asked with what is left of the number. */
static const blob_material_t *choose_part(const shading_t *mix, rgb_t *scale)
{
    const blob_material_t *records = scene_blob(mix->scene)->materials;
    shading_t shading = *mix;
    float u = sampler_float((uint32_t)(shading_point_key(mix->at->p) >> 32));
    while (is_chosen(shading.material)) {
        rgb_t amount = v_low(shading_colour(&shading, VALUE_AMOUNT), vec3(1, 1, 1));
        rgb_t rest = v_sub(vec3(1, 1, 1), amount);
        float chance = float_min(v_dot(amount, vec3(1, 1, 1)) / 3, 1);
        bool second = u < chance;
        u = second ? u / chance : (u - chance) / (1 - chance);
        *scale = v_mul(*scale, second ? v_scale(amount, 1 / chance) : v_scale(rest, 1 / (1 - chance)));
        shading.material = &records[shading.material->parts[second]];
    }
    return shading.material;
}

void material_bsdf_of(const scene_t *scene, const surface_t *surface, const waves_t *waves, bsdf_t *bsdf)
{
    texture_point_t at = {.p = surface->p, .n = surface->ns, .colour = {1, 1, 1, 1}};
    bsdf->ng = surface->ng;
    bsdf->ns = surface->ns;
    bsdf->attenuation = vec3(0, 0, 0);
    bsdf->absorbs = false;
    bsdf->count = 0;
    shading_t shading = {scene, surface->material, &at, vec3(1, 1, 1), bsdf, shade, vec3(0, 0, 1), waves};
    if (surface->fibre) {
        bsdf->s = surface->along;
        bsdf->t = v_cross(bsdf->ns, bsdf->s);
        at.uv = at.uv2 = (vec2_t){0, 0.5f + 0.5f * surface->place.y};
        if (scene_material_is_textured(scene, surface->material)) {
            surface_details_t details;
            scene_details(scene, surface, &details);
            at.uv = details.uv;
            at.uv2 = details.uv2;
        }
    } else if (scene_material_varies(scene, surface->material)) {
        surface_details_t details;
        scene_details(scene, surface, &details);
        at.uv = details.uv;
        at.uv2 = details.uv2;
        at.colour = details.colour;
        if (is_chosen(shading.material)) shading.material = choose_part(&shading, &shading.scale);
        shading_frame_turn(bsdf, scene, shading.material, &details, &at);
        if (shading.material->flags & MATERIAL_COAT_NORMAL)
            shading.coat_normal = shading_frame_coat(bsdf, scene, shading.material, &details, &at);
    } else {
        v_frame(bsdf->ns, &bsdf->s, &bsdf->t);
    }
    shade(&shading);
    bsdf_complete(bsdf);
}
