/* scene_details: what only textures and turned frames ask of a hit. */
#include "worker/render/scene/scene_internal.h"

/* Solves for the derivatives along u and v of something that changes by a and b along the triangle's edges.
 */
static void differentiate(vec2_t uv1, vec2_t uv2, float inverse, vec3_t a, vec3_t b, vec3_t *du, vec3_t *dv)
{
    *du = v_scale(v_sub(v_scale(a, uv2.y), v_scale(b, uv1.y)), inverse);
    *dv = v_scale(v_sub(v_scale(b, uv1.x), v_scale(a, uv2.x)), inverse);
}

static vec2_t uv_mean(const vec2_t uv[3], vec2_t place)
{
    float b0 = 1 - place.x - place.y;
    return (vec2_t){b0 * uv[0].x + place.x * uv[1].x + place.y * uv[2].x,
                    b0 * uv[0].y + place.x * uv[1].y + place.y * uv[2].y};
}

static vec3_t vector_mean(const vec3_t c[3], vec2_t place)
{
    return v_mad(v_mad(v_scale(c[0], 1 - place.x - place.y), place.x, c[1]), place.y, c[2]);
}

static blob_colour_t colour_mean(const blob_colour_t *c, const uint32_t v[3], vec2_t place)
{
    float b[3] = {1 - place.x - place.y, place.x, place.y};
    blob_colour_t mean = {0, 0, 0, 0};
    for (int i = 0; i < 3; i++) {
        mean.r += b[i] * c[v[i]].r;
        mean.g += b[i] * c[v[i]].g;
        mean.b += b[i] * c[v[i]].b;
        mean.a += b[i] * c[v[i]].a;
    }
    return mean;
}

static void mesh_details(const scene_blob_t *blob, const surface_t *surface, surface_details_t *details)
{
    const blob_mesh_t *mesh = &blob->meshes[surface->shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + surface->primitive].v;
    vec2_t uv[3] = {{0, 0}, {1, 0}, {1, 1}}, uv2[3];
    for (int i = 0; i < 3 && mesh->first_uv != BLOB_NONE; i++) uv[i] = blob->uvs[mesh->first_uv + v[i]];
    details->uv = details->uv2 = uv_mean(uv, surface->place);
    if (mesh->first_uv2 != BLOB_NONE) {
        for (int i = 0; i < 3; i++) uv2[i] = blob->uvs[mesh->first_uv2 + v[i]];
        details->uv2 = uv_mean(uv2, surface->place);
    }
    if (mesh->first_colour != BLOB_NONE)
        details->colour = colour_mean(blob->colours + mesh->first_colour, v, surface->place);
    vec2_t d1 = {uv[1].x - uv[0].x, uv[1].y - uv[0].y}, d2 = {uv[2].x - uv[0].x, uv[2].y - uv[0].y};
    float determinant = d1.x * d2.y - d1.y * d2.x;
    vec3_t p[3], n[3];
    mesh_corners(blob->positions + mesh->first_position, mesh, v, surface->time, p);
    if (!(fabsf(determinant) > 0x1p-100f)) {
        /* uvs do not say: any frame, so that bumps have one, as in pbrt. */
        n[0] = v_cross(v_sub(p[1], p[0]), v_sub(p[2], p[0]));
        if (!v_is_zero(n[0])) v_frame(v_normalize(n[0]), &details->dpdu, &details->dpdv);
        return;
    }
    differentiate(d1, d2, 1 / determinant, v_sub(p[1], p[0]), v_sub(p[2], p[0]), &details->dpdu,
                  &details->dpdv);
    if (mesh->first_normal == BLOB_NONE) return;
    mesh_corners(blob->normals + mesh->first_normal, mesh, v, surface->time, n);
    differentiate(d1, d2, 1 / determinant, v_sub(n[1], n[0]), v_sub(n[2], n[0]), &details->dndu,
                  &details->dndv);
}

/* pbrt-v3's frame of a triangle with vertex normals: unit tangents, which both point backwards. A bump map
 * whose texture goes by u and v is turned round by it, and its height is not related to the triangle's size.
 */
static void smooth_bumps(const scene_blob_t *blob, const surface_t *surface, surface_details_t *details)
{
    const blob_mesh_t *mesh = &blob->meshes[surface->shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + surface->primitive].v;
    if (mesh->first_normal == BLOB_NONE) return;
    vec3_t n[3];
    mesh_corners(blob->normals + mesh->first_normal, mesh, v, surface->time, n);
    vec3_t ns = v_normalize(vector_mean(n, surface->place));
    vec3_t s = v_normalize(v_mad(details->dpdu, -v_dot(details->dpdu, ns), ns));
    if (!v_is_finite(ns) || !v_is_finite(s)) return;
    details->bump_u = v_neg(s);
    details->bump_v = v_cross(s, ns);
}

/* Tangents that a mesh has of its own take the place of dp/du and dp/dv. Bump maps, to which their lengths
 * matter, do without. */
static void use_tangents(const scene_blob_t *blob, const surface_t *surface, surface_details_t *details)
{
    const blob_mesh_t *mesh = &blob->meshes[surface->shape->geometry];
    const uint32_t *v = blob->triangles[mesh->first_triangle + surface->primitive].v;
    if (mesh->first_tangent == 0) return;
    const vec3_t *tangents = blob->normals + mesh->first_tangent - 1;
    vec3_t along[3], across[3];
    mesh_corners(tangents, mesh, v, surface->time, along);
    mesh_corners(tangents + blob_mesh_places(mesh), mesh, v, surface->time, across);
    vec3_t tangent = vector_mean(along, surface->place), bitangent = vector_mean(across, surface->place);
    if (v_is_zero(tangent) || v_is_zero(bitangent)) return;
    details->dpdu = tangent;
    details->dpdv = bitangent;
}

static void curve_details(const scene_blob_t *blob, const surface_t *surface, vec3_t ng,
                          surface_details_t *details)
{
    const blob_curves_t *curves = &blob->curves[surface->shape->geometry];
    const blob_curve_point_t *c = blob->curve_points + curves->first_point + 4 * (size_t)surface->primitive;
    float t = surface->place.x, s = 1 - t;
    const float weights[4] = {-s * s, s * s - 2 * s * t, 2 * s * t - t * t, t * t};
    vec3_t along = vec3(0, 0, 0);
    for (int i = 0; i < 4; i++) along = v_mad(along, 3 * weights[i], vec3(c[i].x, c[i].y, c[i].z));
    /* Embree's v is from 0 to 1 across ribbons, from -1 to 1 across fibres, and 0 on tubes. */
    float v = curves->kind == CURVES_RIBBON ? surface->place.y : 0.5f + 0.5f * surface->place.y;
    details->uv = details->uv2 = (vec2_t){((float)surface->primitive + t) / (float)curves->segment_count, v};
    details->dpdu = v_scale(along, (float)curves->segment_count);
    details->dpdv = v_cross(ng, details->dpdu);
}

void scene_details(const scene_t *scene, const surface_t *surface, surface_details_t *details)
{
    const scene_blob_t *blob = scene->blob;
    bool instanced = surface->instance != BLOB_NONE;
    placement_t moved;
    const placement_t *placement =
        instanced ? instance_at(&scene->instances[surface->instance], surface->time, &moved) : NULL;
    *details = (surface_details_t){.colour = {1, 1, 1, 1}};
    if (surface->shape->kind == SHAPE_MESH) {
        mesh_details(blob, surface, details);
    } else if (surface->shape->kind == SHAPE_QUADRIC) {
        quadric_details_t on;
        vec3_t p = instanced ? xform_point(&placement->object_from_world, surface->p) : surface->p;
        quadric_details(&scene->quadrics[surface->shape->geometry], p, &on);
        /* As in pbrt, the derivatives of the normal do not turn with it where the shape is reversed. */
        *details = (surface_details_t){.uv = on.uv,
                                       .uv2 = on.uv,
                                       .dpdu = on.dpdu,
                                       .dpdv = on.dpdv,
                                       .dndu = on.dndu,
                                       .dndv = on.dndv,
                                       .colour = {1, 1, 1, 1}};
    } else {
        vec3_t ng = instanced ? xform_normal(&placement->world_from_object, surface->ng) : surface->ng;
        curve_details(blob, surface, ng, details);
    }
    details->bump_u = details->dpdu;
    details->bump_v = details->dpdv;
    if (surface->shape->flags & SHAPE_BUMPS_V3) smooth_bumps(blob, surface, details);
    if (surface->shape->kind == SHAPE_MESH) use_tangents(blob, surface, details);
    if (instanced) {
        const xform_t *world = &placement->world_from_object, *inverse = &placement->object_from_world;
        details->dpdu = xform_vector(world, details->dpdu);
        details->dpdv = xform_vector(world, details->dpdv);
        details->bump_u = xform_vector(world, details->bump_u);
        details->bump_v = xform_vector(world, details->bump_v);
        /* Of the unit normal in the world: the transpose of the inverse changes its length by 1 / scale. */
        float scale = v_length(xform_normal(world, surface->ns));
        details->dndu = v_scale(xform_normal(inverse, details->dndu), scale);
        details->dndv = v_scale(xform_normal(inverse, details->dndv), scale);
    }
}
