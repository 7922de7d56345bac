/* gltf: the order of things (see document.h). */
#include "client/import/gltf/gltf.h"

#include "client/import/gltf/document.h"

static result_t import(document_t *document)
{
    TRY(variant_choose(document));
    TRY(animation_open(document));
    TRY(node_walk(document));
    TRY(placement_meshes(document));
    TRY(light_add(document));
    return camera_add(document);
}

result_t gltf_import(const char *path, scene_builder_t *builder)
{
    document_t document;
    result_t result = document_open(&document, path, builder);
    if (result.code == RESULT_OK) result = import(&document);
    document_close(&document);
    return result;
}
