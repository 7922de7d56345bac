/* blob_check_tables: what the tables of BSDFs and of media may say (see blob_layout.h). Samplers search sums
 * that ascend and divide by widths that are not 0; nothing that is read lies outside. Tables own their sums,
 * which follow one another, so that the checks are linear in the blob's size. */
#include "common/scene/blob_layout.h"

#include <string.h>

/* As range_inside, for a range that follows others, which end at *next; moves this on. */
static bool follows(uint32_t first, uint64_t count, uint64_t total, uint64_t *next)
{
    bool does = first >= *next && range_inside(first, count, total);
    *next = (uint64_t)first + count;
    return does;
}

/* Where the tables so far end. */
typedef struct {
    uint64_t number, series, brick;
} ends_t;

static result_t check_numbers(const scene_blob_t *blob)
{
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_NUMBERS]; i++)
        CHECK(fabsf(blob->numbers[i]) <= (float)BLOB_MAX_NUMBER, "number %llu is not finite, or too large",
              (unsigned long long)i);
    return result_ok();
}

static result_t check_spectra(const scene_blob_t *blob)
{
    const float largest = 1e9f;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_SPECTRA]; i++)
        for (int k = 0; k < BLOB_SPECTRUM_SAMPLES; k++)
            CHECK(blob->spectra[i].samples[k] >= 0 && blob->spectra[i].samples[k] <= largest,
                  "spectrum %llu has a negative sample, or one that is too large", (unsigned long long)i);
    return result_ok();
}

/* Each number exceeds the one before it by `least` or more. */
static bool ascends(const float *values, uint32_t count, float least)
{
    for (uint32_t i = 1; i < count; i++)
        if (!(values[i] - values[i - 1] >= least)) return false;
    return true;
}

/* Rows of cumulative sums: each ascends from 0. */
static bool are_sums(const float *sums, uint64_t rows, uint32_t columns)
{
    for (uint64_t row = 0; row < rows; row++, sums += columns)
        if (sums[0] != 0 || !ascends(sums, columns, 0)) return false;
    return true;
}

/* The same, to 1. */
static bool are_sums_to_1(const float *sums, uint64_t rows, uint32_t columns)
{
    for (uint64_t row = 0; row < rows; row++)
        if (sums[row * columns + columns - 1] != 1) return false;
    return are_sums(sums, rows, columns);
}

static bool are_nodes(const float *nodes, uint32_t count)
{
    const float least = 1e-12f; /* so that their distances are no denormal numbers */
    return nodes[0] >= -1 && nodes[count - 1] <= 1 && ascends(nodes, count, least);
}

static bool is_share(float x)
{
    return x >= 1e-3f && x <= 1;
}

static result_t check_series(const scene_blob_t *blob, const blob_fourier_t *table, ends_t *ends,
                             unsigned long long id)
{
    uint64_t count = (uint64_t)table->nodes * table->nodes;
    CHECK(follows(table->first_series, count, blob->counts[BLOB_SECTION_SERIES], &ends->series),
          "fourier %llu: its series lie outside the series, or are another's", id);
    for (uint64_t i = 0; i < count; i++) {
        const blob_series_t *series = &blob->series[table->first_series + i];
        CHECK(series->count <= BLOB_MAX_FOURIER_ORDER &&
                  range_inside(series->first, (uint64_t)series->count * table->channels,
                               blob->counts[BLOB_SECTION_NUMBERS]),
              "fourier %llu: a series is too long, or lies outside the numbers", id);
    }
    return result_ok();
}

static result_t check_fourier(const scene_blob_t *blob, const blob_fourier_t *table, ends_t *ends,
                              unsigned long long id)
{
    uint64_t numbers = blob->counts[BLOB_SECTION_NUMBERS], nodes = table->nodes;
    CHECK(nodes >= 2 && nodes <= BLOB_MAX_FOURIER_NODES && (table->channels == 1 || table->channels == 3),
          "fourier %llu: %u nodes, %u channels", id, table->nodes, table->channels);
    uint64_t cells = nodes * (nodes - 1);
    CHECK(follows(table->first_node, nodes, numbers, &ends->number) &&
              follows(table->first_marginal, nodes * nodes, numbers, &ends->number) &&
              follows(table->first_conditional, cells * (FOURIER_AZIMUTHS + 1), numbers, &ends->number),
          "fourier %llu: its numbers lie outside the numbers, or are another's", id);
    CHECK(are_nodes(blob->numbers + table->first_node, table->nodes),
          "fourier %llu: its cosines do not ascend from -1 to 1", id);
    CHECK(are_sums_to_1(blob->numbers + table->first_marginal, nodes, table->nodes) &&
              are_sums_to_1(blob->numbers + table->first_conditional, cells, FOURIER_AZIMUTHS + 1),
          "fourier %llu: its probabilities do not add up to 1", id);
    CHECK(table->eta >= 0.01f && table->eta <= 100 && is_share(table->albedo.x) &&
              is_share(table->albedo.y) && is_share(table->albedo.z),
          "fourier %llu: its index or albedo is out of range", id);
    return check_series(blob, table, ends, id);
}

/* ---- measured ------------------------------------------------------------------------------------------ */

/* Numbers that are not negative. */
static bool are_positive(const float *values, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++)
        if (!(values[i] >= 0)) return false;
    return true;
}

static bool has_grid(const scene_blob_t *blob, const blob_grid_t *grid, uint64_t numbers, ends_t *ends)
{
    return grid->width >= 2 && grid->width <= BLOB_MAX_MEASURED_SIDE && grid->height >= 2 &&
           grid->height <= BLOB_MAX_MEASURED_SIDE &&
           follows(grid->first, numbers, blob->counts[BLOB_SECTION_NUMBERS], &ends->number) &&
           are_positive(blob->numbers + grid->first, numbers);
}

static uint64_t pixels_of(const blob_grid_t *grid)
{
    return (uint64_t)grid->width * grid->height;
}

static bool has_warp(const scene_blob_t *blob, const blob_grid_t *grid, uint64_t slices, ends_t *ends)
{
    uint64_t all = slices * pixels_of(grid), rows = slices * grid->height;
    if (!has_grid(blob, grid, 2 * all + rows, ends)) return false;
    const float *sums = blob->numbers + grid->first + all;
    return are_sums_to_1(sums, slices, grid->height) && are_sums(sums + rows, rows, grid->width);
}

static result_t check_measured(const scene_blob_t *blob, const blob_measured_t *table, ends_t *ends,
                               unsigned long long id)
{
    const float least = 1e-6f; /* between two directions */
    uint64_t numbers = blob->counts[BLOB_SECTION_NUMBERS];
    CHECK(table->azimuths > 0 && table->azimuths <= BLOB_MAX_MEASURED_SIDE && table->elevations > 0 &&
              table->elevations <= BLOB_MAX_MEASURED_SIDE && table->isotropic <= 1,
          "measured %llu: %u azimuths, %u elevations", id, table->azimuths, table->elevations);
    uint64_t slices = (uint64_t)table->azimuths * table->elevations;
    CHECK(follows(table->first_azimuth, table->azimuths, numbers, &ends->number) &&
              follows(table->first_elevation, table->elevations, numbers, &ends->number) &&
              ascends(blob->numbers + table->first_azimuth, table->azimuths, least) &&
              ascends(blob->numbers + table->first_elevation, table->elevations, least),
          "measured %llu: its directions lie outside the numbers, are another's, or do not ascend", id);
    CHECK(has_grid(blob, &table->ndf, pixels_of(&table->ndf), ends) &&
              has_grid(blob, &table->sigma, pixels_of(&table->sigma), ends) &&
              has_warp(blob, &table->visible, slices, ends) &&
              has_warp(blob, &table->luminance, slices, ends),
          "measured %llu: a grid is too large, or lies outside the numbers, or does not ascend", id);
    uint64_t colours = 3 * slices * pixels_of(&table->luminance);
    CHECK(follows(table->first_colour, colours, numbers, &ends->number) &&
              are_positive(blob->numbers + table->first_colour, colours),
          "measured %llu: its colours lie outside the numbers, are another's, or are negative", id);
    CHECK(is_share(table->albedo.x) && is_share(table->albedo.y) && is_share(table->albedo.z),
          "measured %llu: its albedo is out of range", id);
    return result_ok();
}

/* ---- media --------------------------------------------------------------------------------------------- */

static bool is_rate(rgb_t c)
{
    const float largest = (float)BLOB_MAX_NUMBER;
    return c.x >= 0 && c.x <= largest && c.y >= 0 && c.y <= largest && c.z >= 0 && c.z <= largest;
}

static bool is_finite3(const float v[3])
{
    const float largest = 1e9f;
    return fabsf(v[0]) <= largest && fabsf(v[1]) <= largest && fabsf(v[2]) <= largest;
}

/* Which brick of its own lies in each brick of the grid. */
static bool has_bricks(const scene_blob_t *blob, const blob_field_t *field, ends_t *ends)
{
    const uint32_t *n = field->cells;
    if ((n[0] | n[1] | n[2]) % BLOB_BRICK_SIDE != 0) return false;
    uint64_t count = (uint64_t)n[0] * n[1] * n[2] / BLOB_BRICK_CELLS;
    if (!follows(field->first_brick, count, blob->counts[BLOB_SECTION_BRICKS], &ends->brick)) return false;
    const uint32_t *bricks = blob->bricks + field->first_brick;
    for (uint64_t i = 0; i < count; i++)
        if (bricks[i] != BLOB_NONE && bricks[i] >= field->brick_count) return false;
    return true;
}

static result_t check_cells(const scene_blob_t *blob, const blob_field_t *field, ends_t *ends,
                            unsigned long long id)
{
    const uint32_t *n = field->cells;
    CHECK(n[0] > 0 && n[0] <= BLOB_MAX_GRID_SIDE && n[1] > 0 && n[1] <= BLOB_MAX_GRID_SIDE && n[2] > 0 &&
              n[2] <= BLOB_MAX_GRID_SIDE,
          "field %llu: its grid has %u x %u x %u cells", id, n[0], n[1], n[2]);
    uint64_t numbers = (uint64_t)n[0] * n[1] * n[2] * field->channels;
    if (field->kind == FIELD_BRICKS) {
        CHECK(has_bricks(blob, field, ends), "field %llu: its bricks are not there, or are another's", id);
        numbers = (uint64_t)field->brick_count * BLOB_BRICK_CELLS;
    }
    CHECK(follows(field->first, numbers, blob->counts[BLOB_SECTION_NUMBERS], &ends->number) &&
              are_positive(blob->numbers + field->first, numbers),
          "field %llu: its numbers lie outside the numbers, are another's, or are negative", id);
    return result_ok();
}

static result_t check_field(const scene_blob_t *blob, const blob_field_t *field, ends_t *ends,
                            unsigned long long id)
{
    xform_t inverse;
    CHECK(field->kind >= FIELD_CELLS && field->kind <= FIELD_CLOUD, "field %llu: is of no known kind %u", id,
          field->kind);
    CHECK(field->channels == 1 || (field->channels == 3 && field->kind == FIELD_CELLS),
          "field %llu: cannot have %u channels", id, field->channels);
    CHECK(xform_invert(&field->world_from_field, &inverse),
          "field %llu: its transform is singular or not finite", id);
    const float *span = field->span, *parameters = field->parameters;
    bool cloud = field->kind == FIELD_CLOUD;
    const float least = cloud ? 1e-9f : 1, most = cloud ? 1e9f : BLOB_MAX_GRID_SIDE;
    for (int i = 0; i < 3; i++)
        CHECK(span[i] >= least && span[i] <= most, "field %llu: the span of its box is out of range", id);
    CHECK(is_finite3(field->origin) && is_finite3(parameters) && (!cloud || parameters[0] >= 0),
          "field %llu: a number is out of range", id);
    return cloud ? result_ok() : check_cells(blob, field, ends, id);
}

static const blob_field_t *field_of(const scene_blob_t *blob, blob_ref_t ref)
{
    return ref == 0 ? NULL : &blob->fields[ref - 1];
}

/* A reference to nothing, or to a field of so many channels. */
static bool is_field(const scene_blob_t *blob, blob_ref_t ref, uint32_t channels)
{
    return ref == 0 ||
           (ref <= blob->counts[BLOB_SECTION_FIELDS] && blob->fields[ref - 1].channels == channels);
}

/* Tints lie over one box, in the same cells. */
static bool are_alike(const blob_field_t *a, const blob_field_t *b)
{
    return a == NULL || b == NULL ||
           (memcmp(a->cells, b->cells, sizeof a->cells) == 0 &&
            memcmp(a->origin, b->origin, sizeof a->origin) == 0 &&
            memcmp(a->span, b->span, sizeof a->span) == 0 &&
            memcmp(&a->world_from_field, &b->world_from_field, sizeof a->world_from_field) == 0);
}

/* The colours of black bodies. */
static result_t check_glow(const scene_blob_t *blob, const blob_medium_t *medium, ends_t *ends,
                           unsigned long long id)
{
    const uint64_t numbers = 3 * BLOB_GLOW_STEPS;
    const float largest = 1e9f;
    CHECK(fabsf(medium->coldest) <= largest && medium->hottest > medium->coldest &&
              medium->hottest <= largest,
          "medium %llu: its temperatures are out of range", id);
    CHECK(follows(medium->first_glow, numbers, blob->counts[BLOB_SECTION_NUMBERS], &ends->number) &&
              are_positive(blob->numbers + medium->first_glow, numbers),
          "medium %llu: the colours of its glow lie outside the numbers, are another's, or are negative", id);
    return result_ok();
}

static result_t check_medium(const scene_blob_t *blob, const blob_medium_t *medium, ends_t *ends,
                             unsigned long long id)
{
    CHECK(medium->name < blob->counts[BLOB_SECTION_STRINGS], "medium %llu: its name lies outside the strings",
          id);
    CHECK(is_rate(medium->absorption) && is_rate(medium->scattering) && is_rate(medium->emission),
          "medium %llu: a coefficient is negative, too large, or not finite", id);
    CHECK(medium->g > -1 && medium->g < 1, "medium %llu: its g must be between -1 and 1", id);
    CHECK(medium->is_of_colour <= 1, "medium %llu is of no sort that is known", id);
    CHECK(is_field(blob, medium->density, 1) && is_field(blob, medium->absorption_tint, 3) &&
              is_field(blob, medium->scattering_tint, 3) && is_field(blob, medium->temperature, 1) &&
              (is_field(blob, medium->emission_tint, 1) || is_field(blob, medium->emission_tint, 3)),
          "medium %llu: one of its fields is not there, or of the wrong sort", id);
    bool tinted = medium->absorption_tint != 0 || medium->scattering_tint != 0;
    CHECK(!tinted || medium->density == 0, "medium %llu: has tints and a density", id);
    CHECK(tinted || medium->density != 0 || (medium->emission_tint == 0 && medium->temperature == 0),
          "medium %llu: glows in no box", id);
    CHECK(are_alike(field_of(blob, medium->absorption_tint), field_of(blob, medium->scattering_tint)),
          "medium %llu: its tints lie in different cells", id);
    return medium->temperature != 0 ? check_glow(blob, medium, ends, id) : result_ok();
}

result_t blob_check_tables(const scene_blob_t *blob)
{
    ends_t ends = {0};
    TRY(check_numbers(blob));
    TRY(check_spectra(blob));
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_FOURIERS]; i++)
        TRY(check_fourier(blob, &blob->fouriers[i], &ends, i));
    ends.number = 0; /* of these no table of the other kind is read */
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MEASUREMENTS]; i++)
        TRY(check_measured(blob, &blob->measurements[i], &ends, i));
    ends.number = 0;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_FIELDS]; i++)
        TRY(check_field(blob, &blob->fields[i], &ends, i));
    ends.number = 0;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MEDIA]; i++)
        TRY(check_medium(blob, &blob->media[i], &ends, i));
    return result_ok();
}
