/* light: KHR_lights_punctual, and EXT_lights_image_based.
 *
 * The extension speaks of candela and lux, the core of nits for what surfaces emit; one nit is our radiance
 * 1, so one candela is our intensity 1 and one lux our irradiance 1. Blender's exporter writes radiance as it
 * is, but multiplies its lamps' watts by 683 lumens a watt (its lighting mode "Standard", the default), which
 * is undone for its files, so that lamps and emitting surfaces are as bright beside one another as in Cycles.
 */
#include "client/import/environment/cube.h"
#include "client/import/gltf/document.h"
#include "client/import/scene/scene_defaults.h"

#include <inttypes.h>
#include <string.h>

static const double lumens_per_watt = 683;

static result_t all_lights(const document_t *document, item_t *extension, item_t *lights)
{
    TRY(item_extension(&document->root, "KHR_lights_punctual", extension));
    return item_member(extension, "lights", JSON_ARRAY, lights);
}

result_t light_find(const document_t *document, const item_t *node, uint32_t *light)
{
    item_t extension, root, lights;
    TRY(item_extension(node, "KHR_lights_punctual", &extension));
    if (!extension.json) return result_ok();
    TRY(all_lights(document, &root, &lights));
    TRY(item_index(&extension, "light", item_count(&lights), light));
    return *light == ITEM_NONE ? item_fail(&extension, "names no light") : result_ok();
}

static result_t radiance_of(const document_t *document, const item_t *item, blob_light_t *light)
{
    double colour[3] = {1, 1, 1}, intensity = 1, range = INFINITY;
    TRY(item_numbers(item, "color", 3, 0, 1e6, colour, NULL));
    TRY(item_number(item, "intensity", 0, 1e20, &intensity));
    TRY(item_number(item, "range", 0, 1e30, &range));
    if (isfinite(range)) item_warn(item, "its range is ignored: light only fades with the distance squared");
    double scale = document->blender ? intensity / lumens_per_watt : intensity;
    light->radiance = blob_colour_value(
        vec3((float)(colour[0] * scale), (float)(colour[1] * scale), (float)(colour[2] * scale)));
    return result_ok();
}

/* Cycles' spots: a smooth step of the cosine from the rim of the cone to a share of the way to the axis, the
 * lamp's Blend, which Blender's exporter writes as a share of the angle. Before 3.5 the cosine is a factor,
 * too. */
static void soften_as_cycles(const document_t *document, double inner, double outer, blob_light_t *light)
{
    double rim = cos(outer), blend = 1 - inner / outer;
    light->flags = LIGHT_SMOOTHSTEP;
    if (document->blender_version < 305) light->flags |= LIGHT_COSINE;
    light->parameters[1] = fmaxf((float)(rim + (1 - rim) * blend), light->parameters[0]);
}

static result_t cone_of(const document_t *document, const item_t *item, blob_light_t *light)
{
    item_t spot;
    const double right_angle = 1.57079632679489662;
    double inner = 0, outer = right_angle / 2;
    TRY(item_member(item, "spot", JSON_OBJECT, &spot));
    TRY(item_number(&spot, "outerConeAngle", 1e-3, right_angle, &outer));
    TRY(item_number(&spot, "innerConeAngle", 0, outer, &inner));
    light->flags = LIGHT_SQUARE;
    light->parameters[0] = (float)cos(outer);
    light->parameters[1] = (float)fmax(cos(inner), cos(outer));
    if (document->blender) soften_as_cycles(document, inner, outer, light);
    return result_ok();
}

/* Lights shine along the node's -z; the blob's spot lights shine along +z, its distant ones stand at +z.
 * False when there is no such direction, or no such place. */
static bool orient(const gltf_placement_t *place, uint32_t kind, affine_t *frame)
{
    static const affine_t turn = {{{-1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, -1, 0}}};
    if (kind != LIGHT_POINT) {
        if (!affine_frame(&place->world_from_node, frame)) return false;
        if (kind == LIGHT_SPOT) *frame = affine_multiply(frame, &turn);
        return true;
    }
    bool usable = true;
    *frame = affine_identity();
    for (int i = 0; i < 3; ++i) {
        frame->m[i][3] = place->world_from_node.m[i][3];
        usable = usable && fabs(frame->m[i][3]) <= 1e18;
    }
    return usable;
}

/* Animations hide lights by a scale of 0, as they do meshes. */
static result_t leave_out(const document_t *document, const gltf_placement_t *place)
{
    item_t node;
    TRY(document_item(document, TOP_NODES, place->node, &node));
    item_warn(&node, "its light has no direction, or lies beyond 1e18, and is left out");
    return result_ok();
}

static result_t kind_of(const item_t *item, uint32_t *kind)
{
    static const struct {
        const char *name;
        light_kind_t kind;
    } kinds[] = {{"point", LIGHT_POINT}, {"spot", LIGHT_SPOT}, {"directional", LIGHT_DISTANT}};
    const char *name = "";
    TRY(item_string(item, "type", &name));
    for (size_t i = 0; i < ARRAY_LENGTH(kinds); ++i) {
        if (strcmp(name, kinds[i].name) != 0) continue;
        *kind = kinds[i].kind;
        return result_ok();
    }
    return item_fail(item, "its type must be point, spot or directional, found \"%.20s\"", name);
}

/* Whether a light stands elsewhere at another time while the shutter is open. */
static bool moves(const document_t *document, size_t index)
{
    for (size_t i = 0; i < document->pose_count; ++i)
        if (memcmp(&document->poses[i].lights.items[index].world_from_node,
                   &document->pose->lights.items[index].world_from_node, sizeof(affine_t)) != 0)
            return true;
    return false;
}

static result_t add_one(document_t *document, const gltf_placement_t *place)
{
    item_t root, lights, item;
    blob_light_t light = {0};
    affine_t frame;
    TRY(all_lights(document, &root, &lights));
    TRY(item_element(&lights, place->thing, JSON_OBJECT, &item));
    TRY(kind_of(&item, &light.kind));
    TRY(radiance_of(document, &item, &light));
    if (light.kind == LIGHT_SPOT) TRY(cone_of(document, &item, &light));
    if (v_max(light.radiance.factor) <= 0) return result_ok();
    if (!orient(place, light.kind, &frame)) return leave_out(document, place);
    if (moves(document, (size_t)(place - document->pose->lights.items)))
        item_warn(&item, "moves while the shutter is open; it stands where it is in the middle of that");
    return scene_add_light(document->builder, light, &frame, document_at(document, &item));
}

/* ---- light from all around (EXT_lights_image_based) ---------------------------------------------------- */

static result_t keep_face(document_t *document, const item_t *item, const texture_image_t *image, int face,
                          cube_t *cube)
{
    uint64_t pixels = (uint64_t)image->width * image->height;
    TRY(scene_charge(document->builder, SCENE_PIXELS, pixels, document_at(document, item)));
    if (cube_set_face(cube, face, image)) return result_ok();
    return item_fail(item, "has %" PRIu32 " x %" PRIu32 " pixels; the faces of a cube are equal squares",
                     image->width, image->height);
}

static result_t read_face(document_t *document, const item_t *indices, int face, cube_t *cube)
{
    uint32_t index = 0;
    item_t item;
    bytes_t bytes;
    char name[PATH_ROOM];
    texture_image_t image;
    TRY(item_index_at(indices, (size_t)face, document_count(document, TOP_IMAGES), "images", &index));
    TRY(document_item(document, TOP_IMAGES, index, &item));
    TRY(texture_bytes(document, &item, &bytes, name));
    result_t result = texture_image_decode(name, bytes.data, bytes.size, &image);
    if (result.code != RESULT_OK) return item_fail(&item, "%s", result.message);
    result = keep_face(document, &item, &image, face, cube);
    texture_image_free(&image);
    return result;
}

/* The largest cube of the light is what a path tracer needs; the blurred ones and the spherical harmonics
 * beside it are for others. */
static result_t read_cube(document_t *document, const item_t *levels, cube_t *cube)
{
    item_t faces;
    TRY(item_element(levels, 0, JSON_ARRAY, &faces));
    if (item_count(&faces) != CUBE_FACES)
        return item_fail(&faces, "must be the %d faces of a cube, found %zu", CUBE_FACES, item_count(&faces));
    for (int i = 0; i < CUBE_FACES; ++i) TRY(read_face(document, &faces, i, cube));
    return result_ok();
}

static affine_t turn_of(const double q[4])
{
    affine_t turn = affine_identity();
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
    double degrees = 2 * atan2(length, q[3]) * 180 / 3.14159265358979323846;
    affine_rotation(degrees, q, &turn); /* which stays as it is without an axis */
    return turn;
}

static result_t add_cube(document_t *document, const item_t *item, cube_t *cube, bool *added)
{
    double intensity = 1, rotation[4] = {0, 0, 0, 1};
    item_t levels;
    TRY(item_number(item, "intensity", 0, 1e20, &intensity));
    TRY(item_numbers(item, "rotation", 4, -1e6, 1e6, rotation, NULL));
    TRY(item_member(item, "specularImages", JSON_ARRAY, &levels));
    if (item_count(&levels) == 0) {
        item_warn(item, "has no specularImages, which the extension demands, and is left out; --environment "
                        "gives the scene its surroundings");
        return result_ok();
    }
    TRY(read_cube(document, &levels, cube));
    *added = true;
    blob_light_t light = {.kind = LIGHT_INFINITE,
                          .radiance = blob_constant((float)intensity),
                          .image = cube_add_image(document->builder, cube),
                          .mapping = LIGHT_LATLONG_Y};
    affine_t turn = turn_of(rotation);
    return scene_add_light(document->builder, light, &turn, document_at(document, item));
}

/* The light that the scene names; json NULL when it names none. */
static result_t find_surroundings(const document_t *document, item_t *scene, item_t *root, item_t *lights,
                                  item_t *light)
{
    static const char name[] = "EXT_lights_image_based";
    uint32_t scenes = (uint32_t)document_count(document, TOP_SCENES), number = 0, index = ITEM_NONE;
    item_t extension;
    light->json = NULL;
    if (scenes == 0) return result_ok();
    TRY(item_index(&document->root, "scene", scenes, &number));
    TRY(document_item(document, TOP_SCENES, number, scene));
    TRY(item_extension(scene, name, &extension));
    if (!extension.json) return result_ok();
    TRY(item_extension(&document->root, name, root));
    TRY(item_member(root, "lights", JSON_ARRAY, lights));
    TRY(item_index(&extension, "light", item_count(lights), &index));
    if (index == ITEM_NONE) return item_fail(&extension, "names no light");
    return item_element(lights, index, JSON_OBJECT, light);
}

static result_t add_surroundings(document_t *document, bool *added)
{
    item_t scene, root, lights, light;
    cube_t cube = {.side = 0};
    *added = false;
    TRY(find_surroundings(document, &scene, &root, &lights, &light));
    if (!light.json) return result_ok();
    if (scene_gets_environment(document->builder)) {
        item_warn(&light, "gives way to --environment");
        return result_ok();
    }
    result_t result = add_cube(document, &light, &cube, added);
    cube_free(&cube);
    return report_excuse(document->builder->report, result, "the scene's surroundings are left out");
}

/* ---- all of them --------------------------------------------------------------------------------------- */

/* Whether a node is what Blender's exporter leaves of an area lamp: nothing but a place, called as Blender
 * calls these lamps, "Area" and "Area.001". Its extras do not tell: those of a lamp go with the lamp. */
static bool looks_like_area_lamp(const item_t *node)
{
    static const char *const contents[] = {"mesh", "camera", "children", "skin", "extensions"};
    for (size_t i = 0; i < ARRAY_LENGTH(contents); ++i)
        if (json_object_get(node->json, contents[i])) return false;
    const char *name = json_string_value(json_object_get(node->json, "name"));
    return name && strncmp(name, "Area", 4) == 0 && (name[4] == '\0' || name[4] == '.');
}

static result_t tell_of_area_lamps(const document_t *document)
{
    item_t first = document->root, node;
    size_t lost = 0;
    for (uint32_t i = 0; document->blender && i < document_count(document, TOP_NODES); ++i) {
        TRY(document_item(document, TOP_NODES, i, &node));
        if (!node_world(document, i) || !looks_like_area_lamp(&node)) continue;
        if (lost++ == 0) first = node;
    }
    if (lost > 0)
        item_warn(
            &first,
            "holds nothing: it looks like an area lamp, which Blender does not export (%zu in all); put a "
            "plane with an emitting material there",
            lost);
    return result_ok();
}

result_t light_add(document_t *document)
{
    bool surrounded;
    TRY(tell_of_area_lamps(document));
    if (document->blender && document->pose->lights.count > 0)
        item_warn(&document->root,
                  "written by Blender: its lamps are taken for exported with the lighting mode "
                  "\"Standard\", Blender's default; with \"Unitless\" they come out 683 times too dark");
    for (size_t i = 0; i < document->pose->lights.count; ++i)
        TRY(add_one(document, &document->pose->lights.items[i]));
    TRY(add_surroundings(document, &surrounded));
    scene_default_light(document->builder, document->pose->lights.count > 0 || surrounded,
                        document_at(document, &document->root));
    return result_ok();
}
