/* measured_table: see measured_table.h. */
#include "client/import/files/measured_table.h"

#include <stdlib.h>
#include <string.h>

#include "client/import/files/spectrum.h"

/* ---- fields -------------------------------------------------------------------------------------------- */

enum { MAGIC_SIZE = 12, HEADER_SIZE = MAGIC_SIZE + 2 + 4, MOST_DIMENSIONS = 5, TYPE_FLOAT = 10 };

/* The bytes of a file, and how far it has been read. */
typedef struct {
    const char *name;
    const uint8_t *data;
    size_t size, at;
} reader_t;

/* A field: `data` are its numbers, which need not be aligned. */
typedef struct {
    const uint8_t *data;
    uint32_t dimensions;
    uint64_t shape[MOST_DIMENSIONS];
    uint64_t count;
} field_t;

typedef enum { THETA, PHI, WAVELENGTHS, NDF, SIGMA, VNDF, LUMINANCE, SPECTRA, FIELDS } field_name_t;
static const struct {
    const char *name;
    uint32_t dimensions;
} wanted[FIELDS] = {[THETA] = {"theta_i", 1},
                    [PHI] = {"phi_i", 1},
                    [WAVELENGTHS] = {"wavelengths", 1},
                    [NDF] = {"ndf", 2},
                    [SIGMA] = {"sigma", 2},
                    [VNDF] = {"vndf", 4},
                    [LUMINANCE] = {"luminance", 4},
                    [SPECTRA] = {"spectra", 5}};

static uint64_t take(reader_t *r, size_t bytes, bool *good)
{
    uint64_t value = 0;
    *good = *good && r->size - r->at >= bytes;
    if (!*good) return 0;
    memcpy(&value, r->data + r->at, bytes);
    r->at += bytes;
    return value;
}

/* Which of the wanted fields has that name; FIELDS: none. */
static field_name_t find_name(const uint8_t *name, size_t length)
{
    field_name_t i = 0;
    while (i < FIELDS && (strlen(wanted[i].name) != length || memcmp(wanted[i].name, name, length) != 0)) i++;
    return i;
}

/* The dimensions of a field, and whether its contents lie in the file. */
static bool read_shape(reader_t *r, field_t *field, uint32_t dimensions, uint64_t offset)
{
    bool good = true;
    field->dimensions = dimensions;
    field->count = 1;
    for (uint32_t i = 0; i < dimensions && good; ++i) {
        uint64_t length = take(r, 8, &good);
        if (i < MOST_DIMENSIONS) field->shape[i] = length;
        if (length > r->size) field->count = UINT64_MAX;
        if (field->count <= r->size) field->count *= length; /* both are below 2^40 */
    }
    if (!good || offset > r->size) return false;
    field->data = r->data + offset;
    return true;
}

static result_t read_field(reader_t *r, field_t fields[FIELDS])
{
    bool good = true;
    size_t length = (size_t)take(r, 2, &good);
    good = good && r->size - r->at >= length;
    const uint8_t *name = r->data + r->at;
    if (good) r->at += length;
    uint32_t dimensions = (uint32_t)take(r, 2, &good);
    uint64_t type = take(r, 1, &good), offset = take(r, 8, &good);
    field_t field = {0};
    if (!good || !read_shape(r, &field, dimensions, offset))
        return result_fail(RESULT_INPUT, "%s: is truncated among its fields", r->name);
    field_name_t i = find_name(name, length);
    if (i == FIELDS) return result_ok();
    if (type != TYPE_FLOAT || dimensions != wanted[i].dimensions || field.count == 0)
        return result_fail(RESULT_INPUT, "%s: field %s has %u dimensions of type %u, must have %u of type %d",
                           r->name, wanted[i].name, dimensions, (unsigned)type, wanted[i].dimensions,
                           TYPE_FLOAT);
    if (field.count > (r->size - offset) / sizeof(float))
        return result_fail(RESULT_INPUT, "%s: field %s lies outside the file; truncated?", r->name,
                           wanted[i].name);
    fields[i] = field;
    return result_ok();
}

static result_t read_fields(reader_t *r, field_t fields[FIELDS])
{
    bool good = true;
    if (r->size < HEADER_SIZE || memcmp(r->data, "tensor_file\0\1\0", MAGIC_SIZE + 2) != 0)
        return result_fail(RESULT_INPUT, "%s: does not begin with tensor_file, version 1.0; no measured BRDF",
                           r->name);
    r->at = MAGIC_SIZE + 2;
    for (uint64_t left = take(r, 4, &good); left > 0; --left) TRY(read_field(r, fields));
    for (field_name_t i = 0; i < FIELDS; ++i)
        if (!fields[i].data) return result_fail(RESULT_INPUT, "%s: has no field %s", r->name, wanted[i].name);
    return result_ok();
}

static float number(const field_t *field, uint64_t i)
{
    float value;
    memcpy(&value, field->data + i * sizeof value, sizeof value);
    return value;
}

/* ---- what they must hold ------------------------------------------------------------------------------- */

static bool has_shape(const field_t *field, const uint64_t *shape, uint32_t first, uint32_t count)
{
    return memcmp(field->shape + first, shape, count * sizeof *shape) == 0;
}

static bool is_grid(const field_t *field, uint32_t first)
{
    for (uint32_t i = first; i < first + 2; ++i)
        if (field->shape[i] < 2 || field->shape[i] > BLOB_MAX_MEASURED_SIDE) return false;
    return true;
}

static result_t check_shapes(const char *name, const field_t f[FIELDS])
{
    const uint64_t slices[3] = {f[PHI].count, f[THETA].count, f[WAVELENGTHS].count};
    bool good = slices[0] <= BLOB_MAX_MEASURED_SIDE && slices[1] <= BLOB_MAX_MEASURED_SIDE &&
                has_shape(&f[VNDF], slices, 0, 2) && has_shape(&f[LUMINANCE], slices, 0, 2) &&
                has_shape(&f[SPECTRA], slices, 0, 3) &&
                has_shape(&f[SPECTRA], f[LUMINANCE].shape + 2, 3, 2) && is_grid(&f[NDF], 0) &&
                is_grid(&f[SIGMA], 0) && is_grid(&f[VNDF], 2) && is_grid(&f[LUMINANCE], 2);
    return good ? result_ok()
                : result_fail(RESULT_INPUT, "%s: the dimensions of its fields do not fit together", name);
}

static result_t check_ascent(const char *name, const field_t *field, const char *what)
{
    const float least = 1e-6f, most = 1e6f;
    bool good = fabsf(number(field, 0)) <= most && fabsf(number(field, field->count - 1)) <= most;
    for (uint64_t i = 1; i < field->count; ++i)
        good = good && number(field, i) - number(field, i - 1) >= least;
    return good ? result_ok()
                : result_fail(RESULT_INPUT, "%s: %s does not ascend, or is too large", name, what);
}

/* pbrt-v4 takes tables of all azimuths alone, or of none. */
static result_t check_azimuths(const char *name, const field_t *phi)
{
    if (phi->count <= 2) return result_ok();
    double span = (double)number(phi, phi->count - 1) - (double)number(phi, 0);
    if (rint(2 * M_PI / span) == 1) return result_ok();
    return result_fail(RESULT_INPUT,
                       "%s: phi_i spans %g of 6.28 radians; pbrt-v4 does not read a part either", name, span);
}

/* ---- copying ------------------------------------------------------------------------------------------- */

static float *copy_numbers(const field_t *field)
{
    float *copy = mem_alloc(field->count * sizeof *copy);
    memcpy(copy, field->data, field->count * sizeof *copy);
    return copy;
}

/* Numbers that are not finite or too large; what is below 0 becomes 0. */
static bool limit_numbers(float *values, uint64_t count)
{
    const float largest = 1e9f;
    for (uint64_t i = 0; i < count; ++i) {
        if (!(fabsf(values[i]) <= largest)) return false;
        values[i] = fmaxf(values[i], 0);
    }
    return true;
}

static result_t copy_grid(const char *name, const field_t *field, field_name_t which, measured_grid_t *grid)
{
    uint32_t last = field->dimensions - 1;
    *grid = (measured_grid_t){(uint32_t)field->shape[last], (uint32_t)field->shape[last - 1],
                              copy_numbers(field)};
    if (limit_numbers(grid->values, field->count)) return result_ok();
    return result_fail(RESULT_INPUT, "%s: a number in field %s is not finite, or over 1e9", name,
                       wanted[which].name);
}

/* Each slice's spectra, whose planes lie one behind the other, become one plane of colours. */
static void mix_colours(const field_t *spectra, const double *weights, uint64_t slices, uint64_t planes,
                        uint64_t pixels, float *colours)
{
    double *sums = mem_alloc(3 * pixels * sizeof *sums);
    for (uint64_t slice = 0; slice < slices; ++slice) {
        memset(sums, 0, 3 * pixels * sizeof *sums);
        for (uint64_t plane = 0; plane < planes; ++plane)
            for (uint64_t i = 0; i < pixels; ++i) {
                double value = (double)number(spectra, (slice * planes + plane) * pixels + i);
                for (uint64_t c = 0; c < 3; ++c) sums[3 * i + c] += weights[3 * plane + c] * value;
            }
        for (uint64_t i = 0; i < 3 * pixels; ++i) colours[slice * 3 * pixels + i] = (float)sums[i];
    }
    free(sums);
}

static result_t make_colours(const char *name, const field_t f[FIELDS], measured_table_t *table)
{
    uint64_t slices = f[PHI].count * f[THETA].count, planes = f[WAVELENGTHS].count,
             pixels = (uint64_t)table->luminance.width * table->luminance.height;
    double *lambda = mem_alloc(planes * sizeof *lambda), *weights = mem_alloc(3 * planes * sizeof *weights);
    for (uint64_t i = 0; i < planes; ++i) lambda[i] = (double)number(&f[WAVELENGTHS], i);
    spectrum_reflectance_weights(lambda, planes, weights);
    table->colours = (measured_grid_t){table->luminance.width, table->luminance.height,
                                       mem_alloc(3 * slices * pixels * sizeof(float))};
    mix_colours(&f[SPECTRA], weights, slices, planes, pixels, table->colours.values);
    free(lambda);
    free(weights);
    if (limit_numbers(table->colours.values, 3 * slices * pixels)) return result_ok();
    return result_fail(RESULT_INPUT, "%s: a colour is not finite, or over 1e9", name);
}

/* A distribution that is 0 everywhere cannot be sampled. */
static result_t check_sums(const char *name, const measured_grid_t *grid, uint64_t slices, field_name_t which)
{
    uint64_t pixels = (uint64_t)grid->width * grid->height;
    for (uint64_t slice = 0; slice < slices; ++slice) {
        double sum = 0;
        for (uint64_t i = 0; i < pixels; ++i) sum += (double)grid->values[slice * pixels + i];
        if (!(sum > 1e-6))
            return result_fail(RESULT_INPUT, "%s: field %s is black for outgoing direction %llu", name,
                               wanted[which].name, (unsigned long long)slice);
    }
    return result_ok();
}

static result_t fill(const char *name, const field_t f[FIELDS], measured_table_t *table)
{
    uint64_t slices = f[PHI].count * f[THETA].count;
    table->azimuths = (uint32_t)f[PHI].count;
    table->elevations = (uint32_t)f[THETA].count;
    table->isotropic = table->azimuths <= 2;
    table->azimuth = copy_numbers(&f[PHI]);
    table->elevation = copy_numbers(&f[THETA]);
    TRY(copy_grid(name, &f[NDF], NDF, &table->ndf));
    TRY(copy_grid(name, &f[SIGMA], SIGMA, &table->sigma));
    TRY(copy_grid(name, &f[VNDF], VNDF, &table->visible));
    TRY(copy_grid(name, &f[LUMINANCE], LUMINANCE, &table->luminance));
    TRY(check_sums(name, &table->visible, slices, VNDF));
    TRY(check_sums(name, &table->luminance, slices, LUMINANCE));
    return make_colours(name, f, table);
}

result_t measured_table_decode(const char *name, const uint8_t *data, size_t size, measured_table_t *table)
{
    *table = (measured_table_t){0};
    reader_t reader = {.name = name, .data = data, .size = size};
    field_t fields[FIELDS] = {{0}};
    TRY(read_fields(&reader, fields));
    TRY(check_shapes(name, fields));
    TRY(check_ascent(name, &fields[PHI], wanted[PHI].name));
    TRY(check_ascent(name, &fields[THETA], wanted[THETA].name));
    TRY(check_ascent(name, &fields[WAVELENGTHS], wanted[WAVELENGTHS].name));
    TRY(check_azimuths(name, &fields[PHI]));
    result_t result = fill(name, fields, table);
    if (result.code != RESULT_OK) measured_table_free(table);
    return result;
}

void measured_table_free(measured_table_t *table)
{
    free(table->azimuth);
    free(table->elevation);
    free(table->ndf.values);
    free(table->sigma.values);
    free(table->visible.values);
    free(table->luminance.values);
    free(table->colours.values);
    *table = (measured_table_t){0};
}

/* ---- sums ---------------------------------------------------------------------------------------------- */

/* The integral of a row up to each column, with straight lines between the values. */
static void sum_row(const float *values, uint32_t width, double *sums)
{
    sums[0] = 0;
    for (uint32_t x = 1; x < width; ++x)
        sums[x] = sums[x - 1] + ((double)values[x - 1] + (double)values[x]) / 2;
}

/* Of one slice: the integral of each row up to each column, and that over all rows up to each row; scaled,
 * with the values, so that the whole is 1. */
static void sum_slice(float *values, uint32_t width, uint32_t height, float *rows, float *sums)
{
    double *row = mem_alloc(width * sizeof *row), *whole = mem_alloc(height * sizeof *whole), end = 0;
    whole[0] = 0;
    for (uint32_t y = 0; y < height; ++y) {
        sum_row(values + (size_t)y * width, width, row);
        if (y > 0) whole[y] = whole[y - 1] + (end + row[width - 1]) / 2;
        end = row[width - 1];
    }
    double total = whole[height - 1];
    for (uint32_t y = 0; y < height; ++y) {
        rows[y] = (float)(whole[y] / total);
        sum_row(values + (size_t)y * width, width, row);
        for (uint32_t x = 0; x < width; ++x) sums[(size_t)y * width + x] = (float)(row[x] / total);
    }
    for (size_t i = 0; i < (size_t)width * height; ++i) values[i] = (float)((double)values[i] / total);
    free(row);
    free(whole);
}

/* ---- adding -------------------------------------------------------------------------------------------- */

static blob_grid_t add_grid(blob_builder_t *blob, const measured_grid_t *grid, uint64_t slices)
{
    uint64_t count = slices * grid->width * grid->height;
    return (blob_grid_t){blob_builder_add(blob, BLOB_SECTION_NUMBERS, grid->values, count), grid->width,
                         grid->height};
}

/* A grid with its sums: the values of all slices, then the sums over rows of all, then those along them. */
static blob_grid_t add_warp(blob_builder_t *blob, const measured_grid_t *grid, uint64_t slices)
{
    uint64_t pixels = (uint64_t)grid->width * grid->height, all = slices * pixels,
             rows = slices * grid->height;
    float *numbers = mem_alloc((2 * all + rows) * sizeof *numbers);
    memcpy(numbers, grid->values, all * sizeof *numbers);
    for (uint64_t slice = 0; slice < slices; ++slice)
        sum_slice(numbers + slice * pixels, grid->width, grid->height, numbers + all + slice * grid->height,
                  numbers + all + rows + slice * pixels);
    uint32_t first = blob_builder_add(blob, BLOB_SECTION_NUMBERS, numbers, 2 * all + rows);
    free(numbers);
    return (blob_grid_t){first, grid->width, grid->height};
}

/* What the colours of a slice are in the mean, which is its albedo: the parameterisation spreads light
 * evenly. */
static rgb_t mean_colour(const measured_grid_t *colours, uint64_t slice)
{
    uint64_t pixels = (uint64_t)colours->width * colours->height;
    double sum[3] = {0, 0, 0};
    for (uint64_t i = 0; i < 3 * pixels; ++i)
        sum[i % 3] += (double)colours->values[slice * 3 * pixels + i] / (double)pixels;
    return vec3((float)sum[0], (float)sum[1], (float)sum[2]);
}

/* Over the outgoing directions, by their cosines. */
static rgb_t albedo(const measured_table_t *table)
{
    rgb_t sum = {0, 0, 0};
    float weights = 0;
    for (uint32_t slice = 0; slice < table->azimuths * table->elevations; ++slice) {
        float theta = table->elevation[slice % table->elevations];
        float weight = fmaxf(sinf(theta) * cosf(theta), 1e-6f);
        sum = v_mad(sum, weight, mean_colour(&table->colours, slice));
        weights += weight;
    }
    sum = v_scale(sum, 1 / weights);
    return vec3(float_clamp(sum.x, 1e-3f, 1), float_clamp(sum.y, 1e-3f, 1), float_clamp(sum.z, 1e-3f, 1));
}

uint32_t measured_table_add(const measured_table_t *table, blob_builder_t *blob)
{
    uint64_t slices = (uint64_t)table->azimuths * table->elevations;
    blob_measured_t record = {.azimuths = table->azimuths,
                              .elevations = table->elevations,
                              .isotropic = table->isotropic,
                              .albedo = albedo(table)};
    record.first_azimuth = blob_builder_add(blob, BLOB_SECTION_NUMBERS, table->azimuth, table->azimuths);
    record.first_elevation =
        blob_builder_add(blob, BLOB_SECTION_NUMBERS, table->elevation, table->elevations);
    record.ndf = add_grid(blob, &table->ndf, 1);
    record.sigma = add_grid(blob, &table->sigma, 1);
    record.visible = add_warp(blob, &table->visible, slices);
    record.luminance = add_warp(blob, &table->luminance, slices);
    record.first_colour = blob_builder_add(blob, BLOB_SECTION_NUMBERS, table->colours.values,
                                           3 * slices * table->colours.width * table->colours.height);
    return blob_builder_add(blob, BLOB_SECTION_MEASUREMENTS, &record, 1);
}
