/* nanovdb: a grid of numbers in a NanoVDB file, as a field of bricks (blob_field_t).
 *
 * NanoVDB's leaves are cubes of 8 x 8 x 8 voxels, as our bricks are: each leaf that holds a number but 0
 * becomes a brick, tiles of one number share one. The tree is read through NanoVDB's own PNanoVDB.h, by
 * functions of ours that read 0 outside of the grid's bytes; so whatever they say, nothing else is touched,
 * and the numbers are checked. The work is linear in the box and in the bytes.
 */
#ifndef LIGHTMILL_NANOVDB_H
#define LIGHTMILL_NANOVDB_H

#include "client/import/scene/scene_builder.h"

typedef struct {
    bool found;
    blob_field_t field; /* all but its transform; its numbers and bricks are in the scene's blob */
    affine_t from_box;  /* the file's world from the unit cube: as pbrt has it, the box of all active voxels,
                           from the lowest to one beyond the highest */
    float largest;      /* of the numbers */
} nanovdb_grid_t;

/* Reads the grid of this name; not found when the file has none, or one without active voxels. `at` is where
 * the scene asks for it. RESULT_INPUT when the file is damaged (nanovdb_file.h), the grid is not of floats, a
 * level set, too large, or surrounded by other numbers than 0, or when one of its numbers is not finite or
 * over 1e9; when one is negative, a lenient import takes it for 0. */
result_t nanovdb_read(const char *path, const char *name, scene_builder_t *scene, position_t at,
                      nanovdb_grid_t *grid);
/* The same of the bytes of a file. */
result_t nanovdb_read_bytes(const char *path, const uint8_t *file, size_t size, const char *name,
                            scene_builder_t *scene, position_t at, nanovdb_grid_t *grid);

#endif
