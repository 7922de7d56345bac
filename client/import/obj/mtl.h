/* mtl: Wavefront's libraries of materials (MTL), which OBJ files name.
 *
 * A library is read whole; a material is put into the blob, and its images are read, when a mesh has it
 * first.
 */
#ifndef LIGHTMILL_MTL_H
#define LIGHTMILL_MTL_H

#include "client/import/files/intern.h"
#include "client/import/scene/scene_builder.h"

/* What a material becomes. */
typedef struct {
    bool made;
    uint32_t index;        /* in the blob */
    blob_value_t alpha;    /* of the shapes that have it; factor 0: invisible */
    bool emits;            /* by its front */
    bool has_images;       /* in any of its maps */
    blob_value_t emission; /* radiance */
} mtl_material_t;

/* Use it zeroed but for `scene` and `encoded`. Owned: all else (mtl_free). */
typedef struct {
    scene_builder_t *scene;
    bool encoded;              /* colours are sRGB, as Mitsuba takes them; else linear */
    struct mtl_entry *entries; /* by the numbers of their names */
    size_t entry_capacity;
    intern_t names;
    char **paths; /* of the libraries, for messages */
    size_t path_count, path_capacity;
    mtl_material_t otherwise; /* of what has none */
} mtl_t;

/* Adds the materials of the libraries that the OBJ file `beside` names; of two with one name the later one
 * counts. That is a warning, and so is a library that is missing. RESULT_INPUT: see docs/import.md. */
result_t mtl_read_libraries(mtl_t *mtl, const char *beside, const intern_t *libraries);
/* Whether a library has a material of that name. */
bool mtl_has(const mtl_t *mtl, const char *name);
/* The material of a name, NULL for none: then, and when no library has it, a diffuse one that reflects half
 * of the light. *material is valid until mtl_free. */
result_t mtl_material(mtl_t *mtl, const char *name, position_t at, const mtl_material_t **material);
void mtl_free(mtl_t *mtl);

#endif
