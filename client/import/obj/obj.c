/* obj: see obj.h. */
#include "client/import/obj/obj.h"

#include "client/import/files/wavefront.h"
#include "client/import/obj/mtl.h"
#include "client/import/scene/scene_defaults.h"

/* What the shapes of a part are called: as the file calls them, else as their material. */
static const char *name_of(const wavefront_t *file, const wavefront_part_t *part)
{
    if (part->name != WAVEFRONT_NONE) return file->names.texts[part->name];
    return part->material != WAVEFRONT_NONE ? file->materials.texts[part->material] : "object";
}

static result_t add_part(scene_builder_t *scene, const wavefront_t *file, wavefront_part_t *part,
                         mtl_t *materials)
{
    affine_t identity = affine_identity();
    const mtl_material_t *material;
    const char *wanted = part->material != WAVEFRONT_NONE ? file->materials.texts[part->material] : NULL;
    TRY(mtl_material(materials, wanted, part->at, &material));
    if (material->alpha.texture == 0 && material->alpha.factor.x <= 0) return result_ok();
    if (material->has_images && !part->mesh.uvs) /* one texel, and not all of the image in each triangle */
        part->mesh.uvs = mem_zalloc(part->mesh.vertex_count, sizeof *part->mesh.uvs);
    blob_shape_t shape = {.material = material->index,
                          .name = blob_builder_string(scene->blob, name_of(file, part)),
                          .alpha = material->alpha,
                          .shadow_alpha = blob_constant(1)};
    TRY(mesh_add(scene, &part->mesh, &identity, false, part->at, &shape));
    if (shape.geometry == BLOB_NONE) return result_ok();
    blob_light_t light = {
        .kind = LIGHT_AREA, .radiance = material->emission, .world_from_light = xform_identity()};
    scene_add_shape(scene, 0, shape, material->emits ? &light : NULL);
    return result_ok();
}

/* A camera that sees everything, and light where there is none. */
static result_t finish(scene_builder_t *scene, position_t at)
{
    blob_scene_t record = blob_default_scene();
    record.fov = 40;
    record.max_depth = 8;
    record.spp = 64;
    record.width = 1280;
    record.height = 720;
    scene_default_light(scene, false, at);
    TRY(scene_see_everything(scene, &record, at));
    return scene_finish(scene, &record, at);
}

static result_t import(const char *path, scene_builder_t *scene, wavefront_t *file, mtl_t *materials)
{
    position_t at = {path, 0, 0};
    TRY(wavefront_read(path, scene, file));
    if (file->position_count == 0) return error_at(at, "has no vertex; is it a Wavefront OBJ file?");
    TRY(mtl_read_libraries(materials, path, &file->libraries));
    for (size_t i = 0; i < file->part_count; ++i) TRY(add_part(scene, file, &file->parts[i], materials));
    TRY(scene_expect_shapes(scene, at));
    return finish(scene, at);
}

result_t obj_import(const char *path, scene_builder_t *builder)
{
    wavefront_t file = {0};
    mtl_t materials = {.scene = builder};
    result_t result = import(path, builder, &file, &materials);
    mtl_free(&materials);
    wavefront_free(&file);
    return result;
}
