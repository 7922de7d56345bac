/* nanovdb: see nanovdb.h. */
#include "client/import/volume/nanovdb.h"

#include "client/import/volume/nanovdb_file.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

/* ---- the bytes of a grid, as PNanoVDB.h reads them ------------------------------------------------------
 */

typedef struct {
    const uint8_t *data;
    uint64_t size;
} pnanovdb_buf_t;

static inline bool buf_has(pnanovdb_buf_t buf, uint64_t offset, uint64_t size)
{
    return offset <= buf.size && size <= buf.size - offset;
}

static inline uint32_t pnanovdb_buf_read_uint32(pnanovdb_buf_t buf, uint64_t offset)
{
    uint32_t value = 0;
    if (buf_has(buf, offset, sizeof value)) memcpy(&value, buf.data + offset, sizeof value);
    return value;
}

static inline uint64_t pnanovdb_buf_read_uint64(pnanovdb_buf_t buf, uint64_t offset)
{
    uint64_t value = 0;
    if (buf_has(buf, offset, sizeof value)) memcpy(&value, buf.data + offset, sizeof value);
    return value;
}

typedef uint32_t pnanovdb_grid_type_t;
#define PNANOVDB_GRID_TYPE_GET(type, name) pnanovdb_grid_type_constants[type].name
#define PNANOVDB_C
#define PNANOVDB_BUF_CUSTOM
#include <nanovdb/PNanoVDB.h>

/* ---- the walk -------------------------------------------------------------------------------------------
 */

enum { TYPE = PNANOVDB_GRID_TYPE_FLOAT, SIDE = BLOB_BRICK_SIDE, BRICK = BLOB_BRICK_CELLS };
enum { PENDING = 256, MOST_TILES = 1 << 16 };

typedef struct {
    const char *path, *name;
    scene_builder_t *scene;
    position_t at;
    pnanovdb_buf_t buf;
    int32_t low[3], bricks[3]; /* of the box, in bricks; how many there are */
    uint32_t *table;           /* [bricks], x varying fastest */
    uint32_t count;            /* of bricks that have numbers */
    uint64_t most_leaves;      /* that fit into the bytes */
    uint32_t tiles;
    float around;         /* what is where the tree has nothing */
    float tile, *pending; /* the number of the last tile; bricks that are not in the blob yet */
    uint32_t tile_brick, pending_count;
    float largest;
    bool negative;
} walk_t;

static result_t damaged(const walk_t *w)
{
    return result_fail(RESULT_INPUT, "%s: the grid \"%.60s\" is damaged; copy or export the file again",
                       w->path, w->name);
}

static void flush(walk_t *w)
{
    blob_builder_add(w->scene->blob, BLOB_SECTION_NUMBERS, w->pending, (uint64_t)w->pending_count * BRICK);
    w->pending_count = 0;
}

/* Checks the numbers of a brick that is about to be added; *empty: all are 0. */
static result_t check_brick(walk_t *w, float *numbers, bool *empty)
{
    float least = 0, most = 0;
    bool finite = true;
    for (int i = 0; i < BRICK; ++i) {
        finite &= fabsf(numbers[i]) <= (float)BLOB_MAX_NUMBER;
        least = fminf(least, numbers[i]);
        most = fmaxf(most, numbers[i]);
    }
    if (!finite)
        return result_fail(RESULT_INPUT,
                           "%s: a number of the grid \"%.60s\" is not finite, or over %g; repair it where it "
                           "was made",
                           w->path, w->name, BLOB_MAX_NUMBER);
    if (least < 0 && !w->negative) {
        TRY(report_refuse(w->scene->report, w->at,
                          "%s: the grid \"%.60s\" has negative numbers; they are taken for 0", w->path,
                          w->name));
        w->negative = true;
    }
    if (least < 0)
        for (int i = 0; i < BRICK; ++i) numbers[i] = fmaxf(numbers[i], 0);
    w->largest = fmaxf(w->largest, most);
    *empty = most == 0;
    return result_ok();
}

/* Room for the numbers of one more brick, which counts once it is kept. */
static float *next_brick(walk_t *w)
{
    if (w->pending_count == PENDING) flush(w);
    return w->pending + (size_t)w->pending_count * BRICK;
}

static uint32_t keep_brick(walk_t *w)
{
    w->pending_count++;
    return w->count++;
}

static uint32_t *entry_at(const walk_t *w, const int32_t brick[3])
{
    const int32_t *low = w->low, *n = w->bricks;
    size_t row = (size_t)(brick[2] - low[2]) * (size_t)n[1] + (size_t)(brick[1] - low[1]);
    return &w->table[row * (size_t)n[0] + (size_t)(brick[0] - low[0])];
}

static result_t add_leaf(walk_t *w, pnanovdb_leaf_handle_t leaf, const int32_t brick[3])
{
    bool empty;
    float *numbers = next_brick(w);
    uint64_t table = leaf.address.byte_offset + PNANOVDB_GRID_TYPE_GET(TYPE, leaf_off_table);
    if (table < leaf.address.byte_offset || !buf_has(w->buf, table, BRICK * sizeof *numbers))
        return damaged(w);
    memcpy(numbers, w->buf.data + table, BRICK * sizeof *numbers);
    TRY(check_brick(w, numbers, &empty));
    if (empty) return result_ok();
    if (w->count >= w->most_leaves + w->tiles) return damaged(w);
    *entry_at(w, brick) = keep_brick(w);
    return result_ok();
}

/* The bricks from one to another, in all axes, as far as they are in the box. */
typedef struct {
    int32_t from[3], to[3];
} range_t;

static range_t clip(const walk_t *w, const int32_t from[3], int32_t side)
{
    range_t range;
    for (int i = 0; i < 3; ++i) {
        int32_t last = w->low[i] + w->bricks[i] - 1;
        range.from[i] = from[i] > w->low[i] ? from[i] : w->low[i];
        range.to[i] = from[i] + side - 1 < last ? from[i] + side - 1 : last;
    }
    return range;
}

/* A cube of bricks that all have one number. */
static result_t add_tile(walk_t *w, float number, const int32_t from[3], int32_t side)
{
    bool empty;
    if (number == 0) return result_ok();
    if (w->tiles == 0 || number != w->tile) {
        float *numbers = next_brick(w);
        for (int i = 0; i < BRICK; ++i) numbers[i] = number;
        TRY(check_brick(w, numbers, &empty));
        if (empty) return result_ok();
        if (w->tiles++ == MOST_TILES)
            return result_fail(RESULT_INPUT, "%s: the grid \"%.60s\" has more than %d tiles that differ",
                               w->path, w->name, MOST_TILES);
        w->tile = number;
        w->tile_brick = keep_brick(w);
    }
    range_t range = clip(w, from, side);
    int32_t brick[3];
    for (brick[2] = range.from[2]; brick[2] <= range.to[2]; ++brick[2])
        for (brick[1] = range.from[1]; brick[1] <= range.to[1]; ++brick[1])
            for (brick[0] = range.from[0]; brick[0] <= range.to[0]; ++brick[0])
                *entry_at(w, brick) = w->tile_brick;
    return result_ok();
}

enum { LOWER_SIDE = 16, UPPER_SIDE = 512 }; /* of nodes, in bricks */

static pnanovdb_coord_t voxel_of(const int32_t brick[3])
{
    return (pnanovdb_coord_t){brick[0] * SIDE, brick[1] * SIDE, brick[2] * SIDE};
}

static result_t walk_lower(walk_t *w, pnanovdb_lower_handle_t lower, const int32_t from[3])
{
    range_t range = clip(w, from, LOWER_SIDE);
    int32_t at[3];
    for (at[2] = range.from[2]; at[2] <= range.to[2]; ++at[2])
        for (at[1] = range.from[1]; at[1] <= range.to[1]; ++at[1])
            for (at[0] = range.from[0]; at[0] <= range.to[0]; ++at[0]) {
                pnanovdb_coord_t voxel = voxel_of(at);
                uint32_t n = pnanovdb_lower_coord_to_offset(&voxel);
                if (pnanovdb_lower_get_child_mask(w->buf, lower, n))
                    TRY(add_leaf(w, pnanovdb_lower_get_child(TYPE, w->buf, lower, n), at));
                else
                    TRY(add_tile(
                        w,
                        pnanovdb_read_float(w->buf, pnanovdb_lower_get_table_address(TYPE, w->buf, lower, n)),
                        at, 1));
            }
    return result_ok();
}

/* The first of the children of a node, `side` bricks large, that is in the box. */
static int32_t first_child(int32_t from, int32_t node, int32_t side)
{
    return node + (from - node) / side * side;
}

static result_t walk_upper(walk_t *w, pnanovdb_upper_handle_t upper, const int32_t from[3])
{
    range_t range = clip(w, from, UPPER_SIDE);
    int32_t at[3], first[3];
    for (int i = 0; i < 3; ++i) first[i] = first_child(range.from[i], from[i], LOWER_SIDE);
    for (at[2] = first[2]; at[2] <= range.to[2]; at[2] += LOWER_SIDE)
        for (at[1] = first[1]; at[1] <= range.to[1]; at[1] += LOWER_SIDE)
            for (at[0] = first[0]; at[0] <= range.to[0]; at[0] += LOWER_SIDE) {
                pnanovdb_coord_t voxel = voxel_of(at);
                uint32_t n = pnanovdb_upper_coord_to_offset(&voxel);
                if (pnanovdb_upper_get_child_mask(w->buf, upper, n))
                    TRY(walk_lower(w, pnanovdb_upper_get_child(TYPE, w->buf, upper, n), at));
                else
                    TRY(add_tile(
                        w,
                        pnanovdb_read_float(w->buf, pnanovdb_upper_get_table_address(TYPE, w->buf, upper, n)),
                        at, LOWER_SIDE));
            }
    return result_ok();
}

static result_t walk_root(walk_t *w, pnanovdb_root_handle_t root)
{
    int32_t at[3], first[3];
    for (int i = 0; i < 3; ++i) first[i] = w->low[i] & ~(UPPER_SIDE - 1);
    for (at[2] = first[2]; at[2] < w->low[2] + w->bricks[2]; at[2] += UPPER_SIDE)
        for (at[1] = first[1]; at[1] < w->low[1] + w->bricks[1]; at[1] += UPPER_SIDE)
            for (at[0] = first[0]; at[0] < w->low[0] + w->bricks[0]; at[0] += UPPER_SIDE) {
                pnanovdb_coord_t voxel = voxel_of(at);
                pnanovdb_root_tile_handle_t tile = pnanovdb_root_find_tile(TYPE, w->buf, root, &voxel);
                if (pnanovdb_address_is_null(tile.address))
                    TRY(add_tile(w, w->around, at, UPPER_SIDE));
                else if (pnanovdb_int64_is_zero(pnanovdb_root_tile_get_child(w->buf, tile)))
                    TRY(add_tile(
                        w,
                        pnanovdb_read_float(w->buf, pnanovdb_root_tile_get_value_address(TYPE, w->buf, tile)),
                        at, UPPER_SIDE));
                else
                    TRY(walk_upper(w, pnanovdb_root_get_child(TYPE, w->buf, root, tile), at));
            }
    return result_ok();
}

/* ---- the grid -------------------------------------------------------------------------------------------
 */

/* The box of the active voxels: [low, high]. False when there are none. */
static bool box_of(const walk_t *w, pnanovdb_root_handle_t root, int64_t low[3], int64_t high[3])
{
    pnanovdb_coord_t a = pnanovdb_root_get_bbox_min(w->buf, root),
                     b = pnanovdb_root_get_bbox_max(w->buf, root);
    const int32_t from[3] = {a.x, a.y, a.z}, to[3] = {b.x, b.y, b.z};
    for (int i = 0; i < 3; ++i) {
        low[i] = from[i];
        high[i] = to[i];
        if (low[i] > high[i]) return false;
    }
    return true;
}

static result_t lay_out(walk_t *w, const int64_t low[3], const int64_t high[3], blob_field_t *field)
{
    const int64_t far = (int64_t)1 << 30;
    uint64_t count = 1;
    for (int i = 0; i < 3; ++i) {
        int64_t first = low[i] >> 3, last = (high[i] + 1) >> 3;
        if (low[i] < -far || high[i] > far || (last - first + 1) * SIDE > BLOB_MAX_GRID_SIDE)
            return result_fail(RESULT_INPUT,
                               "%s: the grid \"%.60s\" has %" PRId64
                               " voxels along an axis, over the limit of %d; "
                               "make it coarser",
                               w->path, w->name, high[i] - low[i] + 1, BLOB_MAX_GRID_SIDE - SIDE);
        w->low[i] = (int32_t)first;
        w->bricks[i] = (int32_t)(last - first + 1);
        field->cells[i] = (uint32_t)w->bricks[i] * SIDE;
        field->origin[i] = (float)(low[i] - first * SIDE);
        field->span[i] = (float)(high[i] + 1 - low[i]);
        count *= (uint64_t)w->bricks[i];
    }
    TRY(scene_charge(w->scene, SCENE_BRICKS, count, w->at));
    w->table = mem_alloc(count * sizeof *w->table);
    memset(w->table, 0xFF, count * sizeof *w->table); /* BLOB_NONE */
    return result_ok();
}

static affine_t place_of(const walk_t *w, pnanovdb_grid_handle_t grid, const int64_t low[3],
                         const blob_field_t *field)
{
    pnanovdb_map_handle_t map = pnanovdb_grid_get_map(w->buf, grid);
    affine_t from_index;
    for (uint32_t r = 0; r < 3; ++r) {
        for (uint32_t c = 0; c < 3; ++c) from_index.m[r][c] = pnanovdb_map_get_matd(w->buf, map, 3 * r + c);
        from_index.m[r][3] = pnanovdb_map_get_vecd(w->buf, map, r);
    }
    const double corner[3] = {(double)low[0], (double)low[1], (double)low[2]},
                 span[3] = {(double)field->span[0], (double)field->span[1], (double)field->span[2]};
    affine_t move = affine_translation(corner), stretch = affine_scaling(span);
    move = affine_multiply(&move, &stretch);
    return affine_multiply(&from_index, &move);
}

static result_t check_root(walk_t *w, pnanovdb_root_handle_t root)
{
    uint64_t tiles = pnanovdb_root_get_tile_count(w->buf, root);
    if (tiles > w->buf.size / PNANOVDB_GRID_TYPE_GET(TYPE, root_tile_size)) return damaged(w);
    w->around = pnanovdb_read_float(
        w->buf, pnanovdb_address_offset(root.address, PNANOVDB_GRID_TYPE_GET(TYPE, root_off_background)));
    if (w->around == 0) return result_ok();
    return report_refuse(
        w->scene->report, w->at,
        "%s: the grid \"%.60s\" is surrounded by the number %g; outside of its box it is taken for 0",
        w->path, w->name, (double)w->around);
}

static result_t read_tree(walk_t *w, nanovdb_grid_t *out)
{
    pnanovdb_grid_handle_t grid = {{0}};
    pnanovdb_root_handle_t root = pnanovdb_tree_get_root(w->buf, pnanovdb_grid_get_tree(w->buf, grid));
    int64_t low[3], high[3];
    if (!buf_has(w->buf, root.address.byte_offset, PNANOVDB_GRID_TYPE_GET(TYPE, root_size)) ||
        memcmp(w->buf.data, "NanoVDB", 7) != 0 || pnanovdb_grid_get_grid_type(w->buf, grid) != TYPE)
        return damaged(w);
    TRY(check_root(w, root));
    if (!box_of(w, root, low, high)) return result_ok();
    TRY(lay_out(w, low, high, &out->field));
    out->from_box = place_of(w, grid, low, &out->field);
    TRY(walk_root(w, root));
    flush(w);
    uint64_t count = (uint64_t)w->bricks[0] * (uint64_t)w->bricks[1] * (uint64_t)w->bricks[2];
    out->field.first_brick = blob_builder_add(w->scene->blob, BLOB_SECTION_BRICKS, w->table, count);
    out->field.brick_count = w->count;
    out->largest = w->largest;
    out->found = true;
    return result_ok();
}

/* Of a kind that is no density: pbrt refuses these, too. */
static result_t check_kind(const char *path, const char *name, const nanovdb_bytes_t *bytes)
{
    if (bytes->type != TYPE)
        return result_fail(
            RESULT_INPUT,
            "%s: the grid \"%.60s\" is not of floats (its type has the number %u); export it so", path, name,
            bytes->type);
    if (bytes->class == PNANOVDB_GRID_CLASS_UNKNOWN || bytes->class == PNANOVDB_GRID_CLASS_FOG_VOLUME)
        return result_ok();
    return result_fail(RESULT_INPUT,
                       "%s: the grid \"%.60s\" is not a fog volume (its class has the number %u)", path, name,
                       bytes->class);
}

result_t nanovdb_read_bytes(const char *path, const uint8_t *file, size_t size, const char *name,
                            scene_builder_t *scene, position_t at, nanovdb_grid_t *grid)
{
    nanovdb_bytes_t bytes;
    *grid = (nanovdb_grid_t){.field = {.kind = FIELD_BRICKS, .channels = 1}};
    TRY(nanovdb_find(path, file, size, name, &bytes));
    if (bytes.data == NULL) return result_ok();
    result_t result = check_kind(path, name, &bytes);
    walk_t w = {.path = path, .name = name, .scene = scene, .at = at, .buf = {bytes.data, bytes.size}};
    w.most_leaves = bytes.size / PNANOVDB_GRID_TYPE_GET(TYPE, leaf_size);
    w.pending = mem_alloc(PENDING * BRICK * sizeof *w.pending);
    grid->field.first = blob_builder_count(scene->blob, BLOB_SECTION_NUMBERS);
    if (result.code == RESULT_OK) result = read_tree(&w, grid);
    free(w.pending);
    free(w.table);
    nanovdb_bytes_free(&bytes);
    return result;
}

result_t nanovdb_read(const char *path, const char *name, scene_builder_t *scene, position_t at,
                      nanovdb_grid_t *grid)
{
    struct stat about;
    int file;
    TRY(file_open(path, &file, &about));
    size_t size = (size_t)about.st_size;
    void *bytes = size > 0 ? mmap(NULL, size, PROT_READ, MAP_PRIVATE, file, 0) : MAP_FAILED;
    close(file);
    if (bytes == MAP_FAILED)
        return result_fail(RESULT_INPUT, "%s: the file is empty, or cannot be mapped", path);
    result_t result = nanovdb_read_bytes(path, bytes, size, name, scene, at, grid);
    munmap(bytes, size);
    return result;
}
