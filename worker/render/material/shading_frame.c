/* shading_frame: see shading_frame.h. */
#include "worker/render/material/shading_frame.h"

/* Makes n the shading normal, turned to the side of the geometric one; keeps the old one if n is no
 * direction. */
static void set_normal(bsdf_t *bsdf, vec3_t n)
{
    float length2 = v_length2(n);
    if (!(length2 > 1e-30f && length2 < 1e30f)) return;
    bsdf->ns = v_scale(n, (v_dot(n, bsdf->ng) < 0 ? -1 : 1) / sqrtf(length2));
}

/* Gram-Schmidt keeps the direction of dp/du. */
static void set_tangents(bsdf_t *bsdf, vec3_t dpdu)
{
    vec3_t along = v_mad(dpdu, -v_dot(dpdu, bsdf->ns), bsdf->ns);
    float length2 = v_length2(along);
    if (length2 > 1e-8f * v_length2(dpdu) && length2 > 1e-30f && length2 < 1e30f) {
        /* Once more: what is left of a long vector is only roughly perpendicular. */
        along = v_scale(along, 1 / sqrtf(length2));
        bsdf->s = v_normalize(v_mad(along, -v_dot(along, bsdf->ns), bsdf->ns));
        bsdf->t = v_cross(bsdf->ns, bsdf->s);
    } else {
        v_frame(bsdf->ns, &bsdf->s, &bsdf->t);
    }
}

/* Displaces the surface along its normal by the map and takes the normal of what comes out (Blinn 1978,
 * "Simulation of Wrinkled Surfaces"), by finite differences. Returns dp/du of it in *dpdu. */
static void bump(bsdf_t *bsdf, const textures_t *textures, uint32_t map, const surface_details_t *details,
                 const texture_point_t *at, vec3_t *dpdu)
{
    const float step = 0.0005f;
    texture_point_t along_u = *at, along_v = *at;
    along_u.p = v_mad(at->p, step, details->bump_u);
    along_v.p = v_mad(at->p, step, details->bump_v);
    along_u.uv.x += step;
    along_u.uv2.x += step;
    along_v.uv.y += step;
    along_v.uv2.y += step;
    float d = textures_eval(textures, map, at).x;
    float slope_u = (textures_eval(textures, map, &along_u).x - d) / step;
    float slope_v = (textures_eval(textures, map, &along_v).x - d) / step;
    *dpdu = v_mad(v_mad(details->bump_u, slope_u, bsdf->ns), d, details->dndu);
    vec3_t dpdv = v_mad(v_mad(details->bump_v, slope_v, bsdf->ns), d, details->dndv);
    set_normal(bsdf, v_cross(*dpdu, dpdv));
}

/* The map's colour is (n + 1) / 2, with n along dp/du, dp/dv and the normal; `v4`: MATERIAL_NORMALS_V4. */
static void map_normal(bsdf_t *bsdf, const textures_t *textures, uint32_t map, float scale, bool v4,
                       const surface_details_t *details, const texture_point_t *at)
{
    rgb_t colour = textures_eval(textures, map, at);
    float x = (2 * colour.x - 1) * scale, y = (2 * colour.y - 1) * scale;
    set_tangents(bsdf, details->dpdu);
    if (!v4 && v_dot(bsdf->t, details->dpdv) < 0) y = -y;
    set_normal(bsdf, bsdf_to_world(bsdf, vec3(x, y, 2 * colour.z - 1)));
}

/* Turns the tangents so that s is the direction of the greater roughness of glTF's material. */
static void follow_anisotropy(bsdf_t *bsdf, const textures_t *textures, const blob_value_t *values,
                              const surface_details_t *details, const texture_point_t *at)
{
    rgb_t colour = textures_value(textures, &values[VALUE_ANISOTROPY_DIRECTION], at),
          turn = values[VALUE_ANISOTROPY_TURN].factor;
    float along = 2 * colour.x - 1, across = 2 * colour.y - 1;
    float x = turn.x * along - turn.y * across, y = turn.y * along + turn.x * across;
    if (v_dot(bsdf->t, details->dpdv) < 0) y = -y;
    if (x * x + y * y > 1e-10f) set_tangents(bsdf, bsdf_to_world(bsdf, vec3(x, y, 0)));
}

void shading_frame_turn(bsdf_t *bsdf, const scene_t *scene, const blob_material_t *material,
                        const surface_details_t *details, const texture_point_t *at)
{
    vec3_t dpdu = details->dpdu;
    if (material->normal_map != 0)
        map_normal(bsdf, scene_textures(scene), material->normal_map - 1, material->normal_scale,
                   (material->flags & MATERIAL_NORMALS_V4) != 0, details, at);
    if (material->bump != 0) bump(bsdf, scene_textures(scene), material->bump - 1, details, at, &dpdu);
    set_tangents(bsdf, dpdu);
    if (material->kind == MATERIAL_GLTF && material->values[VALUE_ANISOTROPIC].factor.x != 0)
        follow_anisotropy(bsdf, scene_textures(scene), material->values, details, at);
}

vec3_t shading_frame_coat(const bsdf_t *bsdf, const scene_t *scene, const blob_material_t *material,
                          const surface_details_t *details, const texture_point_t *at)
{
    bsdf_t coat = {.ng = bsdf->ng, .ns = at->n};
    if (material->coat_normal_map != 0)
        map_normal(&coat, scene_textures(scene), material->coat_normal_map - 1, material->coat_normal_scale,
                   false, details, at);
    return bsdf_to_local(bsdf, coat.ns);
}
