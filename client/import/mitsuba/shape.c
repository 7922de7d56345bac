/* shape: see shape.h. Spheres, disks and cylinders stay what they are; all else becomes meshes. */
#include "client/import/mitsuba/shape.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "client/import/files/ply.h"
#include "client/import/files/wavefront.h"
#include "client/import/mitsuba/bsdf.h"
#include "client/import/mitsuba/serialized.h"
#include "client/import/obj/mtl.h"
#include "client/import/scene/crease.h"
#include "client/import/scene/scene_images.h"

/* A shape while it is made. */
typedef struct {
    mitsuba_t *m;
    element_t *element;
    uint32_t object; /* where it goes: 0 for the world */
    affine_t object_from_shape;
    bool flip, flat; /* flat: without vertex normals */
    bool wound;      /* normals that its file does not have point where its triangles wind in the world */
    bool joined;     /* vertices that are alike become one before normals are made */
    bool creased;    /* its edges are smoothed up to `crease` degrees, whatever normals its file has */
    double crease;
    bool flipped;       /* its v is the other way round: see texture.h */
    char *path;         /* of its file; NULL: it has none */
    element_t *emitter; /* NULL: it does not emit */
    mtl_t *library;     /* materials of an OBJ file; NULL: none */
} work_t;

/* ---- what it has in common ----------------------------------------------------------------------------- */

static uint32_t name_of(const work_t *w)
{
    const char *id = element_attribute(w->element, "id");
    char text[64];
    snprintf(text, sizeof text, "%.40s:%u", object_type(w->element), w->element->at.line);
    return blob_builder_string(w->m->scene->blob, id ? id : text);
}

static result_t read_light(const work_t *w, blob_light_t *light)
{
    rgb_t radiance = {1, 1, 1};
    if (strcmp(object_type(w->emitter), "area") != 0)
        return error_at(w->emitter->at, "a shape can have an \"area\" emitter only, found \"%.40s\"",
                        object_type(w->emitter));
    TRY(property_colour(w->m, w->emitter, "radiance", &radiance));
    property_ignore(w->emitter, "samplingWeight");
    TRY(object_finish(w->m, w->emitter));
    *light = (blob_light_t){
        .kind = LIGHT_AREA, .radiance = blob_colour_value(radiance), .world_from_light = xform_identity()};
    return result_ok();
}

/* Adds what has its geometry, kind and flags already. */
static result_t add_shape(const work_t *w, blob_shape_t *shape, const material_t *material)
{
    blob_light_t light;
    if (shape->geometry == BLOB_NONE) return result_ok();
    shape->material = material->index;
    shape->alpha = material->alpha;
    shape->shadow_alpha = blob_constant(1);
    shape->name = name_of(w);
    if (!w->emitter) {
        scene_add_shape(w->m->scene, w->object, *shape, NULL);
        return result_ok();
    }
    if (w->object != 0)
        TRY(report_refuse(w->m->report, w->emitter->at,
                          "a shape that moves, or lies in a shapegroup, cannot emit; the nearest is a dark "
                          "one"));
    TRY(read_light(w, &light));
    bool dark = w->object != 0 || v_is_zero(light.radiance.factor);
    scene_add_shape(w->m->scene, w->object, *shape, dark ? NULL : &light);
    return result_ok();
}

/* A material of an OBJ file's own library. */
static result_t get_from_library(const work_t *w, const char *wanted, material_t *material)
{
    const mtl_material_t *found;
    TRY(mtl_material(w->library, wanted, w->element->at, &found));
    *material = (material_t){found->index, found->alpha};
    const blob_material_t *records = blob_builder_records(w->m->scene->blob, BLOB_SECTION_MATERIALS);
    if (records[found->index].kind == MATERIAL_DIFFUSE || w->m->said_library) return result_ok();
    report_warning(w->m->report, w->element->at,
                   "material \"%.60s\" of its MTL library becomes what it is in an OBJ file, which shines a "
                   "little differently from Mitsuba's Phong, glass and aluminium",
                   wanted);
    w->m->said_library = true;
    return result_ok();
}

/* The material; false when the shape cannot be seen at all. */
static result_t get_material(const work_t *w, const char *wanted, material_t *material, bool *visible)
{
    bool given;
    TRY(bsdf_of_shape(w->m, w->element, wanted, w->flipped, material, &given));
    if (!given && w->library && mtl_has(w->library, wanted))
        TRY(get_from_library(w, wanted, material));
    else if (!given)
        *material = bsdf_default(w->m, w->element);
    *visible = material->index != BLOB_NONE && (material->alpha.texture != 0 || material->alpha.factor.x > 0);
    if (!*visible && w->emitter)
        report_warning(w->m->report, w->element->at, "an invisible shape that emits is left out");
    return result_ok();
}

/* ---- meshes -------------------------------------------------------------------------------------------- */

/* Mitsuba makes the normals that a file does not bring when the mesh stands in the world. A transform that
 * mirrors turns the triangles over there, but for meshes that say which side is out. */
static void place_mesh(const work_t *w, mesh_t *mesh, affine_t *object_from_mesh, bool *reverse)
{
    affine_t inverse;
    if (!affine_invert(object_from_mesh, &inverse)) return; /* mesh_add tells */
    for (uint32_t i = 0; i < mesh->vertex_count; ++i)
        mesh->positions[i] = affine_point(object_from_mesh, mesh->positions[i]);
    if (!w->wound && affine_determinant(object_from_mesh) < 0) *reverse = !*reverse;
    *object_from_mesh = affine_identity();
}

static result_t make_normals(const work_t *w, mesh_t *mesh, position_t at)
{
    if (w->flat) {
        free(mesh->normals);
        mesh->normals = NULL;
        return result_ok();
    }
    if (w->creased) return mesh_crease(mesh, w->crease, at);
    if (w->joined) mesh_join(mesh);
    return mesh_smooth(mesh, at);
}

/* Adds a mesh, if `made` is a success, and frees it. */
static result_t add_mesh(const work_t *w, mesh_t *mesh, const char *wanted, position_t at, result_t made)
{
    material_t material;
    blob_shape_t shape = {0};
    affine_t object_from_mesh = w->object_from_shape;
    bool visible = false, reverse = w->flip;
    if (made.code == RESULT_OK && (w->flat || w->creased || !mesh->normals)) {
        place_mesh(w, mesh, &object_from_mesh, &reverse);
        made = make_normals(w, mesh, at);
    }
    if (made.code == RESULT_OK) made = get_material(w, wanted, &material, &visible);
    if (made.code != RESULT_OK || !visible) {
        mesh_free(mesh);
        return made;
    }
    TRY(mesh_add(w->m->scene, mesh, &object_from_mesh, reverse, at, &shape));
    return add_shape(w, &shape, &material);
}

/* What all shapes say that lie in a file. Leaves the path NULL when the file is missing and is done without.
 */
static result_t read_file_name(work_t *w)
{
    const char *name = NULL;
    TRY(property_string(w->m, w->element, "filename", &name));
    TRY(property_bool(w->m, w->element, "faceNormals", &w->flat));
    TRY(property_number(w->m, w->element, "maxSmoothAngle", 0, 180, &w->crease));
    w->creased = property_find(w->element, "maxSmoothAngle");
    property_ignore(w->element, "collapse");
    if (!name) return error_at(w->element->at, "shape \"%.20s\" needs a filename", object_type(w->element));
    char *path = element_path(w->element, name);
    if (access(path, F_OK) == 0) {
        w->path = path;
        return result_ok();
    }
    result_t result =
        report_refuse(w->m->report, w->element->at,
                      "the file %.300s is missing; the nearest is to leave the shape out", path);
    free(path);
    return result;
}

static result_t add_parts(work_t *w, wavefront_t *file)
{
    if (file->part_count == 0) return error_at(w->element->at, "its file has no face");
    for (size_t i = 0; i < file->part_count; ++i) {
        wavefront_part_t *part = &file->parts[i];
        const char *name = part->material != WAVEFRONT_NONE ? file->materials.texts[part->material] : "";
        TRY(add_mesh(w, &part->mesh, name, w->element->at, result_ok()));
    }
    return result_ok();
}

/* With its library's materials, unless loadMaterials is false. */
static result_t add_file(work_t *w, wavefront_t *file)
{
    mtl_t library = {.scene = w->m->scene, .encoded = true};
    bool load = true;
    TRY(property_bool(w->m, w->element, "loadMaterials", &load));
    TRY(wavefront_read(w->path, w->m->scene, file));
    result_t result = result_ok();
    if (load && file->libraries.count > 0) {
        w->library = &library;
        result = mtl_read_libraries(&library, w->path, &file->libraries);
    }
    if (result.code == RESULT_OK) result = add_parts(w, file);
    w->library = NULL;
    mtl_free(&library);
    return result;
}

static result_t make_obj(work_t *w)
{
    wavefront_t file = {0};
    w->flipped = w->wound = w->joined = true;
    TRY(property_bool(w->m, w->element, "flipTexCoords", &w->flipped));
    if (property_find(w->element, "shapeIndex"))
        TRY(report_refuse(w->m->report, w->element->at,
                          "shapeIndex is not supported in an obj; the nearest is all of the file"));
    result_t result = add_file(w, &file);
    wavefront_free(&file);
    return result;
}

static void decode_colours(mesh_t *mesh)
{
    for (uint32_t i = 0; mesh->colours && i < mesh->vertex_count; ++i) {
        blob_colour_t *c = &mesh->colours[i];
        c->r = (float)scene_decode_srgb((double)c->r);
        c->g = (float)scene_decode_srgb((double)c->g);
        c->b = (float)scene_decode_srgb((double)c->b);
    }
}

static result_t make_ply(work_t *w)
{
    mesh_t mesh = {0};
    bool encoded = true;
    w->wound = true;
    TRY(property_bool(w->m, w->element, "srgb", &encoded));
    scene_count_file(w->m->scene, w->path);
    result_t result = ply_read(w->path, PLY_FANS, w->m->report, &mesh, NULL);
    if (result.code == RESULT_OK && encoded) decode_colours(&mesh);
    if (result.code == RESULT_OK)
        result = scene_charge(w->m->scene, SCENE_VERTICES, mesh.vertex_count, w->element->at);
    return add_mesh(w, &mesh, NULL, w->element->at, result);
}

static result_t make_serialized(work_t *w)
{
    mesh_t mesh = {0};
    double index = 0;
    bool flat = false;
    TRY(property_number(w->m, w->element, "shapeIndex", 0, 1e9, &index));
    result_t result = serialized_read(w->path, (uint64_t)index, w->m->scene, w->element->at, &mesh, &flat);
    w->flat = w->flat || flat;
    return add_mesh(w, &mesh, NULL, w->element->at, result);
}

/* Appends a square: corner, and its two edges, along u and v. */
static void add_square(mesh_t *mesh, vec3_t corner, vec3_t a, vec3_t b)
{
    static const uint32_t corners[2][3] = {{0, 1, 2}, {0, 2, 3}};
    uint32_t first = mesh->vertex_count;
    for (int i = 0; i < 4; ++i) {
        float s = i == 1 || i == 2, t = i >= 2;
        mesh->positions[first + (uint32_t)i] = v_mad(v_mad(corner, s, a), t, b);
        mesh->uvs[first + (uint32_t)i] = (vec2_t){s, t};
    }
    for (int i = 0; i < 2; ++i)
        for (int k = 0; k < 3; ++k)
            mesh->triangles[mesh->triangle_count + (uint32_t)i].v[k] = first + corners[i][k];
    mesh->vertex_count += 4;
    mesh->triangle_count += 2;
}

static mesh_t room_for_squares(size_t count)
{
    return (mesh_t){.positions = mem_alloc(4 * count * sizeof(vec3_t)),
                    .uvs = mem_alloc(4 * count * sizeof(vec2_t)),
                    .triangles = mem_alloc(2 * count * sizeof(blob_triangle_t))};
}

/* From -1 to 1 in x and y, facing +z. */
static result_t make_rectangle(work_t *w)
{
    mesh_t mesh = room_for_squares(1);
    w->flat = true;
    add_square(&mesh, vec3(-1, -1, 0), vec3(2, 0, 0), vec3(0, 2, 0));
    return add_mesh(w, &mesh, NULL, w->element->at, result_ok());
}

/* From -1 to 1 along all axes, facing outward. Seen from there, a texture is mirrored on all faces, and on
 * each turned in Mitsuba's own way. */
static result_t make_cube(work_t *w)
{
    static const vec3_t faces[6][3] = {
        /* the corner at u = v = 0, the edge along v, the edge along u */
        {{-1, -1, -1}, {2, 0, 0}, {0, 0, 2}}, {{1, 1, 1}, {0, 0, -2}, {-2, 0, 0}},
        {{1, -1, 1}, {0, 0, -2}, {0, 2, 0}},  {{-1, -1, 1}, {2, 0, 0}, {0, 2, 0}},
        {{-1, -1, -1}, {0, 0, 2}, {0, 2, 0}}, {{-1, 1, -1}, {2, 0, 0}, {0, -2, 0}}};
    mesh_t mesh = room_for_squares(6);
    w->flat = true;
    for (int i = 0; i < 6; ++i) add_square(&mesh, faces[i][0], faces[i][1], faces[i][2]);
    for (uint32_t i = 0; i < mesh.vertex_count; ++i) mesh.uvs[i] = (vec2_t){mesh.uvs[i].y, mesh.uvs[i].x};
    return add_mesh(w, &mesh, NULL, w->element->at, result_ok());
}

/* ---- quadrics ------------------------------------------------------------------------------------------ */

static result_t add_quadric(work_t *w, blob_quadric_t quadric, const affine_t *object_from_quadric)
{
    material_t material;
    bool visible;
    xform_t inverse;
    quadric.object_from_quadric = affine_to_xform(object_from_quadric);
    quadric.phi_max = TWO_PI_F;
    if (!xform_invert(&quadric.object_from_quadric, &inverse))
        return error_at(w->element->at, "its transform is singular or not finite");
    TRY(get_material(w, NULL, &material, &visible));
    if (!visible) return result_ok();
    blob_shape_t shape = {.kind = SHAPE_QUADRIC, .flags = w->flip ? SHAPE_FLIP : 0};
    shape.geometry = blob_builder_add(w->m->scene->blob, BLOB_SECTION_QUADRICS, &quadric, 1);
    return add_shape(w, &shape, &material);
}

/* v runs down from +z in Mitsuba, up in the blob. */
static result_t make_sphere(work_t *w)
{
    double centre[3] = {0, 0, 0}, radius = 1;
    TRY(property_point(w->m, w->element, "center", centre));
    TRY(property_number(w->m, w->element, "radius", 1e-18, 1e18, &radius));
    affine_t moved = affine_translation(centre), placed = affine_multiply(&w->object_from_shape, &moved);
    float r = (float)radius;
    w->flipped = true;
    return add_quadric(w, (blob_quadric_t){.kind = QUADRIC_SPHERE, .radius = r, .z_min = -r, .z_max = r},
                       &placed);
}

static result_t make_disk(work_t *w)
{
    return add_quadric(w, (blob_quadric_t){.kind = QUADRIC_DISK, .radius = 1}, &w->object_from_shape);
}

static result_t make_cylinder(work_t *w)
{
    double from[3] = {0, 0, 0}, to[3] = {0, 0, 1}, radius = 1, length2 = 0;
    affine_t frame;
    TRY(property_point(w->m, w->element, "p0", from));
    TRY(property_point(w->m, w->element, "p1", to));
    TRY(property_number(w->m, w->element, "radius", 1e-18, 1e18, &radius));
    for (int i = 0; i < 3; ++i) length2 += (to[i] - from[i]) * (to[i] - from[i]);
    double length = sqrt(length2);
    if (!(length > 1e-18 && length < 1e18) || !frame_towards(from, to, NULL, &frame))
        return error_at(w->element->at, "the cylinder has no length between p0 and p1");
    affine_t placed = affine_multiply(&w->object_from_shape, &frame);
    return add_quadric(
        w, (blob_quadric_t){.kind = QUADRIC_CYLINDER, .radius = (float)radius, .z_max = (float)length},
        &placed);
}

/* ---- the table, groups and instances ------------------------------------------------------------------- */

static const struct {
    const char *type;
    result_t (*make)(work_t *w);
    bool in_file;
} shapes[] = {
    {"obj", make_obj, true},
    {"ply", make_ply, true},
    {"serialized", make_serialized, true},
    {"sphere", make_sphere, false},
    {"rectangle", make_rectangle, false},
    {"cube", make_cube, false},
    {"disk", make_disk, false},
    {"cylinder", make_cylinder, false},
};

/* Into an object, 0 for the world. */
static result_t add_to(mitsuba_t *m, element_t *element, uint32_t object, const affine_t *object_from_shape)
{
    work_t w = {.m = m, .element = element, .object = object, .object_from_shape = *object_from_shape};
    TRY(property_bool(m, element, "flipNormals", &w.flip));
    TRY(object_only(m, element, "emitter", &w.emitter));
    for (size_t i = 0; i < ARRAY_LENGTH(shapes); ++i) {
        if (strcmp(object_type(element), shapes[i].type) != 0) continue;
        if (shapes[i].in_file) TRY(read_file_name(&w));
        if (shapes[i].in_file && !w.path) return result_ok();
        result_t result = shapes[i].make(&w);
        free(w.path);
        TRY(result);
        return object_finish(m, element);
    }
    return report_refuse(m->report, element->at,
                         "shape \"%.40s\" is not supported; the nearest is to leave it out",
                         object_type(element));
}

static result_t add_instance_of(mitsuba_t *m, const element_t *element, uint32_t object,
                                const affine_t motion[2])
{
    size_t count;
    const char *id = element_attribute(element, "id");
    scene_shapes(m->scene, object, &count);
    if (count == 0) return result_ok();
    TRY(scene_add_instance(m->scene, object, &motion[0], &motion[1], element->at));
    if (id) scene_name_instance(m->scene, id);
    return result_ok();
}

/* A shape of the world. One that moves is an instance of an object of its own. */
static result_t add_shape_of_world(mitsuba_t *m, element_t *shape)
{
    static const affine_t still = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
    affine_t motion[2];
    TRY(property_motion(m, shape, "toWorld", motion));
    if (motion_is_still(motion)) return add_to(m, shape, 0, &motion[0]);
    uint32_t object = scene_add_object(m->scene);
    TRY(add_to(m, shape, object, &still));
    return add_instance_of(m, shape, object, motion);
}

static result_t add_shape_of_group(mitsuba_t *m, element_t *shape, uint32_t object)
{
    affine_t object_from_shape;
    if (strcmp(object_type(shape), "instance") == 0 || strcmp(object_type(shape), "shapegroup") == 0)
        return error_at(shape->at, "a shapegroup may hold neither instances nor groups");
    TRY(property_transform(m, shape, "toWorld", &object_from_shape));
    return add_to(m, shape, object, &object_from_shape);
}

/* The object of a group, made when it is asked for first. */
static result_t group_object(mitsuba_t *m, element_t *group, uint32_t *object)
{
    element_t *at = NULL, *found;
    const char *name;
    if (group->object == 0) {
        uint32_t made = scene_add_object(m->scene);
        group->object = made;
        for (;;) {
            TRY(object_child(m, group, "shape", &at, &found, &name));
            if (!found) break;
            TRY(add_shape_of_group(m, found, made));
        }
        TRY(object_finish(m, group));
    }
    *object = group->object;
    return result_ok();
}

static result_t add_instance(mitsuba_t *m, element_t *instance)
{
    element_t *group;
    affine_t motion[2];
    uint32_t object;
    TRY(property_motion(m, instance, "toWorld", motion));
    TRY(object_only(m, instance, "shape", &group));
    if (!group || strcmp(object_type(group), "shapegroup") != 0)
        return error_at(instance->at, "an instance needs a reference to a shapegroup");
    TRY(group_object(m, group, &object));
    TRY(object_finish(m, instance));
    return add_instance_of(m, instance, object, motion);
}

result_t shape_add(mitsuba_t *m, element_t *shape)
{
    if (strcmp(object_type(shape), "shapegroup") == 0) return result_ok(); /* its instances show it */
    return strcmp(object_type(shape), "instance") == 0 ? add_instance(m, shape)
                                                       : add_shape_of_world(m, shape);
}
