/* fuzz_nanovdb: any bytes as a NanoVDB file; and, since files of use are packed or large, any changes of the
 * grid of tests/fuzz/assets/a.nvdb, each of which is 8 bytes: where, and the word that is there then. What is
 * accepted makes a blob that passes its checks, whose densities can be looked up. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>
#include <string.h>

#include "client/import/volume/nanovdb.h"
#include "client/import/volume/nanovdb_file.h"

enum { HEADER = 16, RECORD = 176, NAME = 8, CHANGE = 8 };

static void ignore(void *context, const char *message)
{
    (void)context, (void)message;
}

static void read_file(const uint8_t *file, size_t size)
{
    const import_report_t sink = {.warn = ignore, .lenient = true};
    report_t report = report_begin(&sink);
    blob_builder_t *builder = fuzz_begin_blob();
    scene_builder_t scene;
    nanovdb_grid_t grid;
    scene_begin(&scene, builder, &report);
    scene.source_bytes = size;
    result_t result = nanovdb_read_bytes("fuzz.nvdb", file, size, "density", &scene,
                                         (position_t){"fuzz.pbrt", 1, 1}, &grid);
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    xform_t inverse;
    grid.field.world_from_field = affine_to_xform(&grid.from_box);
    if (result.code == RESULT_OK && grid.found && xform_invert(&grid.field.world_from_field, &inverse)) {
        uint8_t *bytes;
        scene_blob_t blob;
        blob_medium_t medium = {.density = 1};
        blob_builder_add(builder, BLOB_SECTION_FIELDS, &grid.field, 1);
        blob_builder_add(builder, BLOB_SECTION_MEDIA, &medium, 1);
        fuzz_end_blob(&builder, &bytes, &blob);
        fuzz_walk(&blob);
        free(bytes);
    }
    scene_end(&scene);
    blob_builder_destroy(&builder);
}

/* A file with the grid of a.nvdb, not packed, with the changes. */
static void change_grid(const uint8_t *data, size_t size)
{
    uint8_t *asset;
    size_t asset_size;
    nanovdb_bytes_t grid = {0};
    result_t result = file_read(fuzz_path("a.nvdb"), 1 << 20, &asset, &asset_size);
    if (result.code == RESULT_OK) result = nanovdb_find("a.nvdb", asset, asset_size, "density", &grid);
    fuzz_expect(result.code == RESULT_OK && grid.data != NULL, "a.nvdb cannot be read");
    size_t head = HEADER + RECORD + NAME, whole = head + grid.size;
    uint8_t *file = mem_alloc(whole);
    memcpy(file, asset, head);
    memcpy(file + 12, (const uint8_t[]){1, 0, 0, 0}, 4); /* one grid, not packed */
    memcpy(file + HEADER + 8, &grid.size, sizeof grid.size);
    memcpy(file + HEADER + RECORD, "density", NAME);
    memcpy(file + head, grid.data, grid.size);
    for (size_t at = 0; at + CHANGE <= size; at += CHANGE) {
        uint32_t where;
        memcpy(&where, data + at, sizeof where);
        memcpy(file + head + where % (grid.size - 3), data + at + 4, 4);
    }
    read_file(file, whole);
    free(file);
    nanovdb_bytes_free(&grid);
    free(asset);
}

int fuzz_nanovdb(const uint8_t *data, size_t size)
{
    if (size >= 7 && memcmp(data, "NanoVDB", 7) == 0)
        read_file(data, size);
    else
        change_grid(data, size);
    return 0;
}
