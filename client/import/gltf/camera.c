/* camera: the camera of the scene that is asked for, its first, or one that sees everything (the glTF 2.0
 * specification, 3.10).
 *
 * glTF's cameras look down -z with y up, in a right-handed space; the blob's look down +z with x to the right
 * and y up, so z is mirrored.
 */
#include "client/import/gltf/document.h"
#include "client/import/scene/scene_defaults.h"

#include <stdio.h>
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

static result_t use(document_t *document, size_t index, blob_scene_t *scene)
{
    const gltf_placement_t *place = &document->pose->cameras.items[index];
    static const affine_t turn = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}}};
    item_t camera, node;
    const char *type = "";
    affine_t ends[2];
    TRY(document_item(document, TOP_CAMERAS, place->thing, &camera));
    TRY(document_item(document, TOP_NODES, place->node, &node));
    TRY(item_string(&camera, "type", &type));
    if (strcmp(type, "perspective") == 0)
        TRY(perspective(&camera, scene));
    else if (strcmp(type, "orthographic") == 0)
        TRY(orthographic(&camera, scene));
    else
        return item_fail(&camera, "its type must be perspective or orthographic, found \"%.20s\"", type);
    for (size_t i = 0; i < 2; ++i) {
        const pose_t *pose = &document->poses[i * (document->pose_count - 1)];
        if (!affine_frame(&pose->cameras.items[index].world_from_node, &ends[i]))
            return item_fail(&node, "its camera has no direction, or lies beyond 1e18");
        ends[i] = affine_multiply(&ends[i], &turn);
    }
    return scene_place_camera(scene, &ends[0], &ends[1], document_at(document, &camera));
}

/* ---- which one ----------------------------------------------------------------------------------------- */

/* "1: nodes[4] (front), 2: nodes[7] (side)", cut short where there is no room. */
static void list_cameras(const document_t *document, char names[ITEM_LIST_ROOM])
{
    const placements_t *cameras = &document->pose->cameras;
    item_t node;
    char name[PATH_ROOM];
    names[0] = '\0';
    for (size_t i = 0; i < cameras->count; ++i) {
        size_t used = strlen(names);
        if (document_item(document, TOP_NODES, cameras->items[i].node, &node).code != RESULT_OK) break;
        item_name(&node, name, sizeof name);
        if (used + strlen(name) + 24 >= ITEM_LIST_ROOM) break;
        snprintf(names + used, ITEM_LIST_ROOM - used, "%s%zu: %s", i ? ", " : "", i + 1, name);
    }
}

/* The camera of a name, of a node or its own; else of a number. *index is unchanged when there is none. */
static bool find_camera(const document_t *document, const char *wanted, size_t *index)
{
    const placements_t *cameras = &document->pose->cameras;
    for (size_t i = 0; i < cameras->count; ++i) {
        if (!document_is_named(document, TOP_NODES, cameras->items[i].node, wanted) &&
            !document_is_named(document, TOP_CAMERAS, cameras->items[i].thing, wanted))
            continue;
        *index = i;
        return true;
    }
    return wishes_number(wanted, cameras->count, index);
}

static result_t choose(document_t *document, size_t *index)
{
    const import_wishes_t *wishes = document->builder->report->sink.wishes;
    char names[ITEM_LIST_ROOM];
    *index = 0;
    list_cameras(document, names);
    if (wishes && wishes->camera) {
        if (find_camera(document, wishes->camera, index)) return result_ok();
        return result_fail(RESULT_USAGE, "--camera: the scene has no camera '%.100s'; it has %zu%s%s",
                           wishes->camera, document->pose->cameras.count, names[0] ? ": " : "", names);
    }
    if (document->pose->cameras.count > 1)
        item_warn(&document->root,
                  "the scene has %zu cameras (%s); the first is taken, --camera takes another",
                  document->pose->cameras.count, names);
    return result_ok();
}

result_t camera_add(document_t *document)
{
    blob_scene_t scene = defaults();
    size_t index;
    TRY(choose(document, &index));
    if (document->pose->cameras.count > 0) {
        TRY(use(document, index, &scene));
    } else {
        item_warn(&document->root, "the scene has no camera: one that sees all of it is put in front of it");
        set_resolution(&scene, wide);
        TRY(scene_see_everything(document->builder, &scene, document_at(document, &document->root)));
    }
    return scene_finish(document->builder, &scene, document_at(document, &document->root));
}
