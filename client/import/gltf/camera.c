/* camera: the first camera of the scene, or one that sees everything (the glTF 2.0 specification, 3.10).
 *
 * glTF's cameras look down -z with y up, in a right-handed space; the blob's look down +z with x to the right
 * and y up, so z is mirrored.
 */
#include "client/import/gltf/document.h"

#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { WIDTH = 1280 };
static const double wide = 16.0 / 9.0; /* when the file does not say */
static const double degrees = 180 / 3.14159265358979323846;

static blob_scene_t defaults(void)
{
    blob_scene_t scene = blob_default_scene();
    scene.fov = 40;
    scene.max_depth = 8;
    scene.spp = 64;
    return scene;
}

static void set_resolution(blob_scene_t *scene, double aspect)
{
    scene->width = WIDTH;
    scene->height = (int32_t)fmax(1, floor(WIDTH / aspect + 0.5));
}

static void set_transform(blob_scene_t *scene, const affine_t *frame)
{
    affine_t turn = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}}}, out = affine_multiply(frame, &turn);
    scene->world_from_camera = scene->world_from_camera_end = affine_to_xform(&out);
}

/* ---- the file's camera --------------------------------------------------------------------------------- */

static result_t perspective(const item_t *camera, blob_scene_t *scene)
{
    item_t lens;
    double yfov = 0, aspect = wide;
    TRY(item_member(camera, "perspective", JSON_OBJECT, &lens));
    TRY(item_number(&lens, "yfov", 1e-3, 3.14, &yfov));
    TRY(item_number(&lens, "aspectRatio", 0.1, 100, &aspect));
    if (yfov == 0) return item_fail(camera, "needs perspective.yfov");
    double shorter = aspect >= 1 ? yfov : 2 * atan(aspect * tan(yfov / 2));
    scene->fov = (float)(shorter * degrees);
    set_resolution(scene, aspect);
    return result_ok();
}

static result_t orthographic(const item_t *camera, blob_scene_t *scene)
{
    item_t lens;
    double x = 0, y = 0;
    TRY(item_member(camera, "orthographic", JSON_OBJECT, &lens));
    TRY(item_number(&lens, "xmag", -1e12, 1e12, &x));
    TRY(item_number(&lens, "ymag", -1e12, 1e12, &y));
    x = fabs(x), y = fabs(y);
    if (!(x > 1e-12 && y > 1e-12 && x / y >= 0.1 && x / y <= 100))
        return item_fail(camera, "needs orthographic.xmag and ymag above 0, of a ratio from 0.1 to 100");
    float window[4] = {(float)-x, (float)x, (float)-y, (float)y};
    scene->camera = CAMERA_ORTHOGRAPHIC;
    memcpy(scene->screen_window, window, sizeof window);
    set_resolution(scene, x / y);
    return result_ok();
}

static result_t use(const document_t *document, const placement_t *place, blob_scene_t *scene)
{
    item_t camera, node;
    const char *type = "";
    affine_t frame;
    TRY(document_item(document, TOP_CAMERAS, place->thing, &camera));
    TRY(document_item(document, TOP_NODES, place->node, &node));
    TRY(item_string(&camera, "type", &type));
    if (strcmp(type, "perspective") == 0)
        TRY(perspective(&camera, scene));
    else if (strcmp(type, "orthographic") == 0)
        TRY(orthographic(&camera, scene));
    else
        return item_fail(&camera, "its type must be perspective or orthographic, found \"%.20s\"", type);
    if (!affine_frame(&place->world_from_node, &frame))
        return item_fail(&node, "its camera has no direction, or lies beyond 1e18");
    set_transform(scene, &frame);
    return result_ok();
}

/* Says which camera is taken and which ones are not. */
static void warn_of_others(const document_t *document)
{
    char names[240] = "", name[PATH_ROOM];
    for (size_t i = 0; i < document->cameras.count; ++i) {
        size_t used = strlen(names);
        node_name(document, document->cameras.items[i].node, name, sizeof name);
        if (used + strlen(name) + 3 >= sizeof names) break;
        snprintf(names + used, sizeof names - used, "%s%s", i ? ", " : "", name);
    }
    item_warn(&document->root, "the scene has %zu cameras (%s); the first is taken", document->cameras.count,
              names);
}

/* ---- a camera for a scene without one ------------------------------------------------------------------ */

typedef struct {
    vec3_t low, high;
} box_t;

static void extend(box_t *box, vec3_t p)
{
    box->low = vec3(float_min(box->low.x, p.x), float_min(box->low.y, p.y), float_min(box->low.z, p.z));
    box->high = vec3(float_max(box->high.x, p.x), float_max(box->high.y, p.y), float_max(box->high.z, p.z));
}

static box_t object_box(const document_t *document, const blob_object_t *object)
{
    const blob_shape_t *shapes = blob_builder_records(document->builder, BLOB_SECTION_SHAPES);
    const blob_mesh_t *meshes = blob_builder_records(document->builder, BLOB_SECTION_MESHES);
    const vec3_t *positions = blob_builder_records(document->builder, BLOB_SECTION_POSITIONS);
    box_t box = {vec3(FLT_MAX, FLT_MAX, FLT_MAX), vec3(-FLT_MAX, -FLT_MAX, -FLT_MAX)};
    for (uint32_t i = 0; i < object->shape_count; ++i) {
        const blob_mesh_t *mesh = &meshes[shapes[object->first_shape + i].geometry];
        for (uint32_t k = 0; k < mesh->vertex_count; ++k) extend(&box, positions[mesh->first_position + k]);
    }
    return box;
}

static void extend_by_instance(box_t *world, const box_t *box, const xform_t *transform)
{
    for (int i = 0; i < 8; ++i) {
        vec3_t p = vec3(i & 1 ? box->high.x : box->low.x, i & 2 ? box->high.y : box->low.y,
                        i & 4 ? box->high.z : box->low.z);
        p = xform_point(transform, p);
        if (v_is_finite(p)) extend(world, p);
    }
}

static box_t scene_box(const document_t *document)
{
    const blob_object_t *objects = blob_builder_records(document->builder, BLOB_SECTION_OBJECTS);
    const blob_instance_t *instances = blob_builder_records(document->builder, BLOB_SECTION_INSTANCES);
    uint32_t count = blob_builder_count(document->builder, BLOB_SECTION_OBJECTS);
    box_t *boxes = mem_zalloc(count, sizeof *boxes);
    for (uint32_t i = 0; i < count; ++i) boxes[i] = object_box(document, &objects[i]);
    for (uint32_t i = 0; i < blob_builder_count(document->builder, BLOB_SECTION_INSTANCES); ++i)
        extend_by_instance(&boxes[0], &boxes[instances[i].object], &instances[i].world_from_object);
    box_t world = boxes[0];
    free(boxes);
    return world;
}

/* From the front (+z), a little from the right and from above, so far away that the sphere about the box of
 * everything fits into the image. */
static void frame_everything(const document_t *document, blob_scene_t *scene)
{
    box_t box = scene_box(document);
    vec3_t low = v_scale(box.low, 0.5f), high = v_scale(box.high, 0.5f);
    vec3_t centre = v_add(low, high), from = v_normalize(vec3(0.4f, 0.3f, 1));
    float radius = float_max(v_length(v_sub(high, low)), FLT_MIN);
    double distance = (double)radius / sin((double)scene->fov / 2 / degrees);
    vec3_t x = v_normalize(v_cross(vec3(0, 1, 0), from)), y = v_cross(from, x);
    double eye[3] = {(double)centre.x + distance * (double)from.x,
                     (double)centre.y + distance * (double)from.y,
                     (double)centre.z + distance * (double)from.z};
    affine_t frame = {{{(double)x.x, (double)y.x, (double)from.x, eye[0]},
                       {(double)x.y, (double)y.y, (double)from.y, eye[1]},
                       {(double)x.z, (double)y.z, (double)from.z, eye[2]}}};
    set_transform(scene, &frame);
    set_resolution(scene, wide);
}

result_t camera_add(document_t *document)
{
    blob_scene_t scene = defaults();
    if (document->cameras.count > 1) warn_of_others(document);
    if (document->cameras.count > 0) {
        TRY(use(document, &document->cameras.items[0], &scene));
    } else {
        item_warn(&document->root, "the scene has no camera: one that sees all of it is put in front of it");
        frame_everything(document, &scene);
    }
    blob_builder_add(document->builder, BLOB_SECTION_SCENE, &scene, 1);
    return result_ok();
}
