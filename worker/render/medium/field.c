/* field: see field.h. */
#include "worker/render/medium/field.h"

#include "worker/render/medium/cloud.h"

#include <string.h>

field_t field_open(const scene_blob_t *blob, blob_ref_t ref)
{
    field_t field = {0};
    if (ref == 0) return field;
    field.record = &blob->fields[ref - 1];
    field.numbers = blob->numbers + field.record->first;
    if (field.record->kind == FIELD_BRICKS) field.bricks = blob->bricks + field.record->first_brick;
    for (int i = 0; i < 3; i++) field.cells[i] = (int)field.record->cells[i];
    xform_invert(&field.record->world_from_field, &field.from_world);
    return field;
}

bool field_place(const field_t *field, vec3_t point, float place[3])
{
    vec3_t u = xform_point(&field->from_world, point);
    const float at[3] = {u.x, u.y, u.z};
    for (int i = 0; i < 3; i++) {
        if (!(at[i] >= 0 && at[i] <= 1)) return false;
        place[i] = field->record->origin[i] + at[i] * field->record->span[i];
    }
    return true;
}

/* ---- cells --------------------------------------------------------------------------------------------- */

static size_t cell_index(const int count[3], int x, int y, int z)
{
    return ((size_t)z * (size_t)count[1] + (size_t)y) * (size_t)count[0] + (size_t)x;
}

static bool has_cell(const field_t *f, int x, int y, int z)
{
    return x >= 0 && x < f->cells[0] && y >= 0 && y < f->cells[1] && z >= 0 && z < f->cells[2];
}

/* The numbers of the brick that a cell lies in; NULL: all are 0. */
static const float *brick_at(const field_t *f, int x, int y, int z)
{
    const int shift = BLOB_BRICK_SHIFT,
              bricks[3] = {f->cells[0] >> shift, f->cells[1] >> shift, f->cells[2] >> shift};
    uint32_t brick = f->bricks[cell_index(bricks, x >> shift, y >> shift, z >> shift)];
    return brick == BLOB_NONE ? NULL : f->numbers + (size_t)brick * BLOB_BRICK_CELLS;
}

/* Where a cell lies in its brick. */
static int in_brick(int x, int y, int z)
{
    const int last = BLOB_BRICK_SIDE - 1, shift = BLOB_BRICK_SHIFT;
    return ((x & last) << 2 * shift) + ((y & last) << shift) + (z & last);
}

static float cell_at(const field_t *f, int x, int y, int z)
{
    if (!has_cell(f, x, y, z)) return 0;
    if (f->bricks == NULL) return f->numbers[cell_index(f->cells, x, y, z)];
    const float *brick = brick_at(f, x, y, z);
    return brick != NULL ? brick[in_brick(x, y, z)] : 0;
}

static rgb_t colour_of_cell(const field_t *f, int x, int y, int z)
{
    if (!has_cell(f, x, y, z)) return vec3(0, 0, 0);
    const float *c = f->numbers + 3 * cell_index(f->cells, x, y, z);
    return vec3(c[0], c[1], c[2]);
}

/* The corners of a cube whose first is `at`; `steps` lead to the next along each axis. */
static void read_corners(const float *at, size_t step_x, size_t step_y, size_t step_z, float corners[8])
{
    for (int k = 0; k < 8; k++)
        corners[k] = at[(size_t)(k & 1) * step_x + (size_t)(k >> 1 & 1) * step_y + (size_t)(k >> 2) * step_z];
}

/* All eight corners lie in one brick. */
static void corners_in_brick(const field_t *f, const int first[3], float corners[8])
{
    const size_t side = BLOB_BRICK_SIDE;
    const float *brick = brick_at(f, first[0], first[1], first[2]);
    if (brick != NULL)
        read_corners(brick + in_brick(first[0], first[1], first[2]), side * side, side, 1, corners);
    else
        memset(corners, 0, 8 * sizeof *corners);
}

void field_corners(const field_t *field, const int first[3], float corners[8])
{
    const int *n = field->cells, last = BLOB_BRICK_SIDE - 1, x = first[0], y = first[1], z = first[2];
    if (x >= 0 && y >= 0 && z >= 0 && x < n[0] - 1 && y < n[1] - 1 && z < n[2] - 1) {
        if (field->bricks == NULL) {
            size_t row = (size_t)n[0], layer = row * (size_t)n[1];
            read_corners(field->numbers + cell_index(n, x, y, z), 1, row, layer, corners);
            return;
        }
        if ((x & last) != last && (y & last) != last && (z & last) != last) {
            corners_in_brick(field, first, corners);
            return;
        }
    }
    for (int k = 0; k < 8; k++) corners[k] = cell_at(field, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2));
}

float field_between(const float corners[8], const float part[3])
{
    float lines[4], faces[2];
    for (int k = 0; k < 4; k++) lines[k] = corners[2 * k] + part[0] * (corners[2 * k + 1] - corners[2 * k]);
    for (int k = 0; k < 2; k++) faces[k] = lines[2 * k] + part[1] * (lines[2 * k + 1] - lines[2 * k]);
    return faces[0] + part[2] * (faces[1] - faces[0]);
}

/* The cube between eight cells that a place lies in, and the part of it. */
static void cube_of(const float place[3], int first[3], float part[3])
{
    for (int i = 0; i < 3; i++) {
        float below = floorf(place[i]);
        first[i] = (int)below;
        part[i] = place[i] - below;
    }
}

float field_number(const field_t *field, const float place[3])
{
    float corners[8], part[3];
    int first[3];
    if (field->record->kind == FIELD_CLOUD) return cloud_density(field->record->parameters, place);
    cube_of(place, first, part);
    field_corners(field, first, corners);
    return field_between(corners, part);
}

rgb_t field_colour(const field_t *field, const float place[3])
{
    float red[8], green[8], blue[8], part[3];
    int first[3];
    if (field->record->channels == 1) {
        float grey = field_number(field, place);
        return vec3(grey, grey, grey);
    }
    cube_of(place, first, part);
    for (int k = 0; k < 8; k++) {
        rgb_t c = colour_of_cell(field, first[0] + (k & 1), first[1] + (k >> 1 & 1), first[2] + (k >> 2));
        red[k] = c.x, green[k] = c.y, blue[k] = c.z;
    }
    return vec3(field_between(red, part), field_between(green, part), field_between(blue, part));
}

/* ---- bounds -------------------------------------------------------------------------------------------- */

static float most_of_cells(const field_t *f, const int low[3], const int high[3])
{
    float most = 0;
    for (int z = low[2]; z <= high[2]; z++)
        for (int y = low[1]; y <= high[1]; y++)
            for (int x = low[0]; x <= high[0]; x++)
                most = float_max(most, f->numbers[cell_index(f->cells, x, y, z)]);
    return most;
}

/* Of the cells that lie in one brick. */
static float most_in_brick(const float *brick, const int low[3], const int high[3])
{
    float most = 0;
    for (int x = low[0]; x <= high[0]; x++)
        for (int y = low[1]; y <= high[1]; y++) {
            const float *row = brick + in_brick(x, y, 0);
            int first = low[2] % BLOB_BRICK_SIDE, last = first + high[2] - low[2];
            for (int z = first; z <= last; z++) most = float_max(most, row[z]);
        }
    return most;
}

/* Brick by brick; those that are not there cost nothing. */
static float most_of_bricks(const field_t *f, const int low[3], const int high[3])
{
    const int side = BLOB_BRICK_SIDE;
    float most = 0;
    int at[3];
    for (at[2] = low[2] / side; at[2] <= high[2] / side; at[2]++)
        for (at[1] = low[1] / side; at[1] <= high[1] / side; at[1]++)
            for (at[0] = low[0] / side; at[0] <= high[0] / side; at[0]++) {
                const float *brick = brick_at(f, at[0] * side, at[1] * side, at[2] * side);
                if (brick == NULL) continue;
                int from[3], to[3];
                for (int i = 0; i < 3; i++) {
                    from[i] = int_max(low[i], at[i] * side);
                    to[i] = int_min(high[i], at[i] * side + side - 1);
                }
                most = float_max(most, most_in_brick(brick, from, to));
            }
    return most;
}

float field_most(const field_t *field, const float low[3], const float high[3])
{
    int first[3], last[3];
    if (field->record->kind == FIELD_CLOUD) return cloud_most(field->record->parameters, low[1], high[1]);
    for (int i = 0; i < 3; i++) {
        first[i] = int_max((int)floorf(low[i]), 0);
        last[i] = int_min((int)floorf(high[i]) + 1, field->cells[i] - 1);
        if (first[i] > last[i]) return 0;
    }
    return field->bricks != NULL ? most_of_bricks(field, first, last) : most_of_cells(field, first, last);
}
