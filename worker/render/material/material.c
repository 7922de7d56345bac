/* material: see material.h. The frame in which lobes stand is turned in shading_frame.c. */
#include "worker/render/material/material.h"

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

void material_bsdf_of(const scene_t *scene, const surface_t *surface, const waves_t *waves, bsdf_t *bsdf)
{
    texture_point_t at = {.p = surface->p, .n = surface->ns, .colour = {1, 1, 1, 1}};
    bsdf->ng = surface->ng;
    bsdf->ns = surface->ns;
    bsdf->attenuation = vec3(0, 0, 0);
    bsdf->absorbs = false;
    bsdf->count = 0;
    vec3_t coat_normal = {0, 0, 1};
    if (surface->fibre) {
        bsdf->s = surface->along;
        bsdf->t = v_cross(bsdf->ns, bsdf->s);
        at.uv = at.uv2 = (vec2_t){0, 0.5f + 0.5f * surface->place.y};
        if (scene_material_varies(scene, surface->material)) {
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
        shading_frame_turn(bsdf, scene, surface->material, &details, &at);
        if (surface->material->flags & MATERIAL_COAT_NORMAL)
            coat_normal = shading_frame_coat(bsdf, scene, surface->material, &details, &at);
    } else {
        v_frame(bsdf->ns, &bsdf->s, &bsdf->t);
    }
    shading_t shading = {scene, surface->material, &at, vec3(1, 1, 1), bsdf, shade, coat_normal, waves};
    shade(&shading);
    bsdf_complete(bsdf);
}
