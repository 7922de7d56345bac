/* scene_builder: see scene_builder.h. */
#include "client/import/scene/scene_builder.h"

#include "client/import/scene/bodies.h"
#include "client/import/scene/scene_box.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* Owned: shapes. */
struct scene_object {
    blob_shape_t *shapes;
    size_t count, capacity;
};

void scene_begin(scene_builder_t *scene, blob_builder_t *blob, report_t *report)
{
    *scene = (scene_builder_t){.report = report, .blob = blob};
    scene_add_object(scene);
}

void scene_end(scene_builder_t *scene)
{
    for (size_t i = 0; i < scene->object_count; ++i) free(scene->objects[i].shapes);
    for (size_t i = 0; i < scene->image_count; ++i) free(scene->images[i].key);
    free(scene->objects);
    free(scene->images);
    free(scene->texture_costs);
    free(scene->focused);
    *scene = (scene_builder_t){0};
}

result_t scene_charge(scene_builder_t *scene, scene_amount_t what, uint64_t amount, position_t at)
{
    static const struct {
        int free_bits; /* log2 of what is free */
        unsigned per_byte;
        const char *name, *cure;
    } bounds[SCENE_AMOUNTS] = {
        [SCENE_VERTICES] = {22, 64, "vertices", "do not let so many meshes share them"},
        [SCENE_TRIANGLES] = {26, 256, "triangles", "take fewer curved shapes or fewer levels of subdivision"},
        [SCENE_PIXELS] = {27, 512, "pixels", "let textures share their images"},
        [SCENE_BRICKS] = {22, 64, "bricks of grids", "make them coarser, or cut off what is empty"},
    };
    uint64_t *sum = &scene->amounts[what], limit = ((uint64_t)1 << bounds[what].free_bits);
    limit += bounds[what].per_byte * scene->source_bytes;
    *sum = amount > limit ? amount : *sum + amount;
    if (*sum <= limit) return result_ok();
    return error_at(at, "%" PRIu64 " %s so far are too many for files of %" PRIu64 " bytes; %s", *sum,
                    bounds[what].name, scene->source_bytes, bounds[what].cure);
}

uint64_t scene_count_file(scene_builder_t *scene, const char *path)
{
    struct stat status;
    uint64_t size = stat(path, &status) == 0 && status.st_size > 0 ? (uint64_t)status.st_size : 0;
    scene->source_bytes += size;
    return size;
}

/* ---- objects and shapes -------------------------------------------------------------------------------- */

uint32_t scene_add_object(scene_builder_t *scene)
{
    scene->objects =
        grow(scene->objects, &scene->object_capacity, scene->object_count + 1, sizeof *scene->objects);
    scene->objects[scene->object_count] = (struct scene_object){0};
    return (uint32_t)scene->object_count++;
}

/* The world comes first in the blob, so the index of a shape of it is known already. */
void scene_add_shape(scene_builder_t *scene, uint32_t object, blob_shape_t shape, const blob_light_t *light)
{
    if (object == scene->object_count) scene_add_object(scene);
    struct scene_object *to = &scene->objects[object];
    shape.light = BLOB_NONE;
    if (light) {
        blob_light_t record = *light;
        record.shape = (uint32_t)to->count;
        shape.light = blob_builder_add(scene->blob, BLOB_SECTION_LIGHTS, &record, 1);
    }
    to->shapes = grow(to->shapes, &to->capacity, to->count + 1, sizeof *to->shapes);
    to->shapes[to->count++] = shape;
}

blob_shape_t *scene_shapes(const scene_builder_t *scene, uint32_t object, size_t *count)
{
    *count = scene->objects[object].count;
    return scene->objects[object].shapes;
}

result_t scene_add_instance(scene_builder_t *scene, uint32_t object, const affine_t *open,
                            const affine_t *close, position_t at)
{
    blob_instance_t instance = {object, affine_to_xform(open), affine_to_xform(close)};
    if (!blob_instance_is_traceable(&instance.world_from_object, &instance.world_from_object_end))
        return error_at(
            at, "the current transform is close to singular, or scales to less than 1e-10 or over 1e10");
    if ((affine_determinant(open) < 0) != (affine_determinant(close) < 0))
        return error_at(at,
                        "what moves from a transform to its mirror image would turn inside out on the way");
    blob_builder_add(scene->blob, BLOB_SECTION_INSTANCES, &instance, 1);
    return result_ok();
}

void scene_name_instance(scene_builder_t *scene, const char *name)
{
    const import_wishes_t *wishes = scene->report->sink.wishes;
    if (!wishes || !wishes->focus || !*name || strcmp(wishes->focus, name) != 0) return;
    scene->focused =
        grow(scene->focused, &scene->focused_capacity, scene->focused_count + 1, sizeof *scene->focused);
    scene->focused[scene->focused_count++] = blob_builder_count(scene->blob, BLOB_SECTION_INSTANCES) - 1;
}

/* ---- lights, textures, the camera ---------------------------------------------------------------------- */

result_t scene_add_light(scene_builder_t *scene, blob_light_t light, const affine_t *world_from_light,
                         position_t at)
{
    xform_t inverse;
    light.world_from_light = affine_to_xform(world_from_light);
    if (!xform_invert(&light.world_from_light, &inverse))
        return error_at(at, "the light's transform is singular or not finite");
    if (!v_is_finite(light.radiance.factor)) return error_at(at, "this light's radiance is not finite");
    if (!v_is_zero(light.radiance.factor)) blob_builder_add(scene->blob, BLOB_SECTION_LIGHTS, &light, 1);
    return result_ok();
}

bool scene_has_light(const scene_builder_t *scene)
{
    const blob_light_t *lights = blob_builder_records(scene->blob, BLOB_SECTION_LIGHTS);
    uint32_t count = blob_builder_count(scene->blob, BLOB_SECTION_LIGHTS);
    for (uint32_t i = 0; i < count; ++i)
        if ((lights[i].flags & LIGHT_PICTURE) == 0) return true;
    const blob_medium_t *media = blob_builder_records(scene->blob, BLOB_SECTION_MEDIA);
    count = blob_builder_count(scene->blob, BLOB_SECTION_MEDIA);
    for (uint32_t i = 0; i < count; ++i)
        if (!v_is_zero(media[i].emission)) return true;
    return false;
}

bool scene_gets_environment(const scene_builder_t *scene)
{
    const import_wishes_t *wishes = scene->report->sink.wishes;
    return wishes && wishes->environment;
}

bool scene_has_images(const scene_builder_t *scene, uint32_t first)
{
    const blob_texture_t *textures = blob_builder_records(scene->blob, BLOB_SECTION_TEXTURES);
    for (uint32_t i = first; i < blob_builder_count(scene->blob, BLOB_SECTION_TEXTURES); ++i)
        if (textures[i].kind == TEXTURE_IMAGE) return true;
    return false;
}

blob_value_t scene_add_texture(scene_builder_t *scene, const blob_texture_t *texture)
{
    return (blob_value_t){.factor = {1, 1, 1},
                          .texture = 1 + blob_builder_add(scene->blob, BLOB_SECTION_TEXTURES, texture, 1)};
}

void scene_choose_parts(const scene_builder_t *scene, blob_material_t *mix)
{
    const blob_material_t *records = blob_builder_records(scene->blob, BLOB_SECTION_MATERIALS);
    for (int i = 0; i < 2; ++i) {
        const blob_material_t *part = &records[mix->parts[i]];
        if (part->normal_map != 0 || part->bump != 0 || part->flags & MATERIAL_CHOSEN)
            mix->flags |= MATERIAL_CHOSEN;
    }
}

blob_ref_t scene_add_spectrum(scene_builder_t *scene, const blob_spectrum_t *spectrum)
{
    enum { LOOK_BACK = 16 };
    const blob_spectrum_t *records = blob_builder_records(scene->blob, BLOB_SECTION_SPECTRA);
    uint32_t count = blob_builder_count(scene->blob, BLOB_SECTION_SPECTRA);
    for (uint32_t i = count; i > 0 && count - i < LOOK_BACK; --i)
        if (memcmp(&records[i - 1], spectrum, sizeof *spectrum) == 0) return i;
    return 1 + blob_builder_add(scene->blob, BLOB_SECTION_SPECTRA, spectrum, 1);
}

static bool texture_is_finite(const blob_texture_t *texture)
{
    bool finite = true;
    for (int i = 0; i < 6; ++i) finite = finite && isfinite((&texture->matrix[0][0])[i]);
    for (int i = 0; i < 12; ++i) finite = finite && isfinite((&texture->texture_from_world.m[0][0])[i]);
    for (int i = 0; i < TEXTURE_PARAMETERS; ++i) finite = finite && isfinite(texture->parameters[i]);
    for (int i = 0; i < TEXTURE_INPUTS; ++i) finite = finite && v_is_finite(texture->inputs[i].factor);
    return finite;
}

result_t scene_check_textures(scene_builder_t *scene, position_t at)
{
    const blob_texture_t *records = blob_builder_records(scene->blob, BLOB_SECTION_TEXTURES);
    size_t count = blob_builder_count(scene->blob, BLOB_SECTION_TEXTURES);
    scene->texture_costs =
        grow(scene->texture_costs, &scene->texture_capacity, count, sizeof *scene->texture_costs);
    for (; scene->texture_count < count; ++scene->texture_count) {
        const blob_texture_t *texture = &records[scene->texture_count];
        double *cost = &scene->texture_costs[scene->texture_count];
        *cost = 1;
        for (int i = 0; i < TEXTURE_INPUTS; ++i)
            if (texture->inputs[i].texture) *cost += scene->texture_costs[texture->inputs[i].texture - 1];
        if (*cost > BLOB_MAX_TEXTURE_COST)
            return error_at(at, "a texture combines more than %d others", BLOB_MAX_TEXTURE_COST - 1);
        if (!texture_is_finite(texture)) return error_at(at, "a number of a texture is infinite");
    }
    return result_ok();
}

result_t scene_place_camera(blob_scene_t *record, const affine_t *open, const affine_t *close, position_t at)
{
    xform_t inverse;
    record->world_from_camera = affine_to_xform(open);
    record->world_from_camera_end = affine_to_xform(close);
    if (xform_invert(&record->world_from_camera, &inverse) &&
        xform_invert(&record->world_from_camera_end, &inverse))
        return result_ok();
    return error_at(at, "the camera's transform is singular or not finite");
}

/* Coordinates are floats, whose steps grow with the distance from the origin. */
static void warn_of_distance(const scene_builder_t *scene, position_t at)
{
    box_t box = scene_box(scene);
    float across = v_length(v_sub(box.high, box.low));
    float far = v_max(v_high(v_neg(box.low), box.high));
    float step = nextafterf(far, INFINITY) - far;
    if (!(step > 1e-4f * across)) return;
    report_warning(
        scene->report, at,
        "the scene is %g across but lies %g from the origin, where coordinates are rounded to steps "
        "of %g: surfaces come out torn; move the scene to the origin",
        (double)across, (double)far, (double)step);
}

result_t scene_finish(scene_builder_t *scene, const blob_scene_t *record, position_t at)
{
    TRY(scene_check_textures(scene, at));
    warn_of_distance(scene, at);
    scene_settle_media(scene, at);
    for (size_t i = 0; i < scene->object_count; ++i) {
        const struct scene_object *object = &scene->objects[i];
        blob_object_t laid = {.shape_count = (uint32_t)object->count};
        laid.first_shape =
            blob_builder_add(scene->blob, BLOB_SECTION_SHAPES, object->shapes, laid.shape_count);
        blob_builder_add(scene->blob, BLOB_SECTION_OBJECTS, &laid, 1);
    }
    blob_builder_add(scene->blob, BLOB_SECTION_SCENE, record, 1);
    return result_ok();
}
