/* medium_fields: see medium_fields.h. */
#include "client/import/pbrt/materials/medium_fields.h"

#include "client/import/files/spectrum.h"
#include "client/import/pbrt/state/colour_spaces.h"
#include "client/import/volume/nanovdb.h"

#include <math.h>
#include <stdlib.h>

static blob_ref_t add_field(pbrt_t *p, const blob_field_t *field)
{
    return 1 + blob_builder_add(p->builder->blob, BLOB_SECTION_FIELDS, field, 1);
}

static blob_field_t field_of(const pbrt_t *p, blob_ref_t ref)
{
    const blob_field_t *fields = blob_builder_records(p->builder->blob, BLOB_SECTION_FIELDS);
    return fields[ref - 1];
}

/* ---- boxes ----------------------------------------------------------------------------------------------
 */

/* Places a box of the current transform's space. */
static result_t place(pbrt_t *p, position_t at, const affine_t *box, blob_field_t *field)
{
    affine_t close, t;
    xform_t inverse;
    if (pbrt_motion(p, at, &t, &close))
        report_warning(p->report, at,
                       "media do not move: this one stands where it is when the shutter opens");
    t = affine_multiply(&t, box);
    field->world_from_field = affine_to_xform(&t);
    if (xform_invert(&field->world_from_field, &inverse)) return result_ok();
    return error_at(at, "the box of this medium's grid, from p0 to p1 under the current transform, has no "
                        "volume, or is not finite");
}

static result_t read_box(pbrt_t *p, params_t *params, position_t at, double p0[3], double sides[3],
                         blob_field_t *field)
{
    const unsigned types = PARAM_BIT(PARAM_POINT3) | PARAM_BIT(PARAM_VECTOR3);
    double p1[3] = {1, 1, 1};
    for (int i = 0; i < 3; ++i) p0[i] = 0;
    TRY(params_point(params, "p0", types, p0));
    TRY(params_point(params, "p1", types, p1));
    for (int i = 0; i < 3; ++i) {
        double corner = p0[i];
        if (p->dialect.dialect == DIALECT_V4 && p1[i] < corner) { /* which sorts them */
            p0[i] = p1[i];
            p1[i] = corner;
        }
        sides[i] = p1[i] - p0[i];
    }
    affine_t corner = affine_translation(p0), stretch = affine_scaling(sides);
    corner = affine_multiply(&corner, &stretch);
    return place(p, at, &corner, field);
}

/* The cells of a grid from p0 to p1, without their numbers. */
static result_t read_grid(pbrt_t *p, params_t *params, position_t at, blob_field_t *field)
{
    static const char *const names[3] = {"nx", "ny", "nz"};
    double p0[3], sides[3];
    *field = (blob_field_t){.kind = FIELD_CELLS, .channels = 1};
    for (int i = 0; i < 3; ++i) {
        int32_t count = 1;
        TRY(params_int_in(params, names[i], 1, BLOB_MAX_GRID_SIDE, &count));
        field->cells[i] = (uint32_t)count;
        field->origin[i] = -0.5f;
        field->span[i] = (float)count;
    }
    return read_box(p, params, at, p0, sides, field);
}

/* ---- numbers in cells -----------------------------------------------------------------------------------
 */

/* The numbers of a parameter, one for each cell. `what` are they. */
static result_t read_numbers(params_t *params, const char *name, const char *what, unsigned type,
                             size_t channels, position_t at, const blob_field_t *field,
                             const double **numbers)
{
    const uint32_t *n = field->cells;
    uint64_t cells = (uint64_t)n[0] * n[1] * n[2];
    size_t count;
    TRY(params_array(params, name, PARAM_BIT(type), channels, numbers, &count));
    if (count == cells * channels) return result_ok();
    return error_at(params_where(params, name, at),
                    "%zu %s for a grid of nx x ny x nz = %u x %u x %u cells; give %llu", count / channels,
                    what, n[0], n[1], n[2], (unsigned long long)cells);
}

/* Adds a field of numbers; *most is the largest. */
static result_t add_numbers(pbrt_t *p, params_t *params, const char *name, const char *what, position_t at,
                            blob_field_t field, blob_ref_t *ref, double *most)
{
    const double *numbers;
    TRY(read_numbers(params, name, what, PARAM_FLOAT, 1, at, &field, &numbers));
    size_t count = (size_t)field.cells[0] * field.cells[1] * field.cells[2];
    float *cells = mem_alloc(count * sizeof *cells);
    *most = 0;
    for (size_t i = 0; i < count; ++i) {
        cells[i] = (float)numbers[i];
        *most = fmax(*most, numbers[i]);
        if (numbers[i] >= 0 && numbers[i] <= BLOB_MAX_NUMBER) continue;
        free(cells);
        return error_at(params_where(params, name, at), "%s number %zu is %g, but must be from 0 to %g", name,
                        i, numbers[i], BLOB_MAX_NUMBER);
    }
    field.first = blob_builder_add(p->builder->blob, BLOB_SECTION_NUMBERS, cells, count);
    free(cells);
    *ref = add_field(p, &field);
    return result_ok();
}

result_t medium_density_cells(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    blob_field_t field;
    double most;
    TRY(read_grid(p, params, at, &field));
    return add_numbers(p, params, "density", "densities", at, field, &medium->density, &most);
}

result_t medium_emission_cells(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    double most;
    if (!params_has(params, "Lescale") || v_is_zero(medium->emission)) {
        const params_t *owner;
        params_find(params, "Lescale", PARAM_BIT(PARAM_FLOAT), &owner);
        return result_ok();
    }
    return add_numbers(p, params, "Lescale", "numbers of \"Lescale\"", at, field_of(p, medium->density),
                       &medium->emission_tint, &most);
}

/* ---- temperatures ---------------------------------------------------------------------------------------
 */

/* How temperatures are read: (t - offset) scale is in kelvin. As in pbrt-v4, nothing emits at 100 K and
 * below.
 */
static result_t read_kelvins(params_t *params, position_t at, double *offset, double *scale)
{
    *offset = 0;
    *scale = 1;
    TRY(params_float_in(params, "temperaturecutoff", -BLOB_MAX_NUMBER, BLOB_MAX_NUMBER, offset));
    TRY(params_float_in(params, "temperatureoffset", -BLOB_MAX_NUMBER, BLOB_MAX_NUMBER, offset));
    TRY(params_float_in(params, "temperaturescale", 0, BLOB_MAX_NUMBER, scale));
    if (*scale > 0) return result_ok();
    return error_at(params_where(params, "temperaturescale", at), "temperaturescale must be over 0");
}

/* Adds the colours of what has the temperatures of the field; without them where nothing is warm enough. */
static void add_glow(pbrt_t *p, double offset, double scale, double hottest, blob_ref_t temperature,
                     double emission_scale, blob_medium_t *medium)
{
    const double coldest_kelvin = 100;
    float *colours;
    medium->coldest = (float)(offset + coldest_kelvin / scale);
    medium->hottest = (float)hottest;
    medium->emission = vec3(0, 0, 0);
    if (!(medium->hottest > medium->coldest) || emission_scale == 0) return;
    colours = mem_alloc(3 * BLOB_GLOW_STEPS * sizeof *colours);
    for (int i = 0; i < BLOB_GLOW_STEPS; ++i) {
        double t = (double)medium->coldest +
                   ((double)medium->hottest - (double)medium->coldest) * i / (BLOB_GLOW_STEPS - 1);
        rgb_t c = spectrum_glow((t - offset) * scale);
        colours[3 * i] = c.x, colours[3 * i + 1] = c.y, colours[3 * i + 2] = c.z;
    }
    medium->first_glow =
        blob_builder_add(p->builder->blob, BLOB_SECTION_NUMBERS, colours, 3 * BLOB_GLOW_STEPS);
    free(colours);
    medium->temperature = temperature;
    medium->emission = v_scale(medium->absorption, (float)emission_scale);
}

result_t medium_temperature_cells(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    double offset, scale, most;
    blob_ref_t temperature;
    if (params_has(params, "Le"))
        return error_at(params_where(params, "Le", at),
                        "a medium emits by either \"Le\" or \"temperature\", not both");
    TRY(read_kelvins(params, at, &offset, &scale));
    TRY(add_numbers(p, params, "temperature", "temperatures", at, field_of(p, medium->density), &temperature,
                    &most));
    add_glow(p, offset, scale, most, temperature, 1, medium);
    return result_ok();
}

/* ---- colours in cells -----------------------------------------------------------------------------------
 */

/* Adds a field of colours, times a number, if there are any. */
static result_t add_colours(pbrt_t *p, params_t *params, const char *name, position_t at, bool emitted,
                            blob_field_t field, blob_ref_t *ref)
{
    const double *numbers;
    if (!params_has(params, name)) return result_ok();
    at = params_where(params, name, at);
    TRY(read_numbers(params, name, "colours", PARAM_RGB, 3, at, &field, &numbers));
    size_t count = (size_t)field.cells[0] * field.cells[1] * field.cells[2];
    float *cells = mem_alloc(3 * count * sizeof *cells);
    result_t result = result_ok();
    for (size_t i = 0; i < count && result.code == RESULT_OK; ++i) {
        const double *v = numbers + 3 * i;
        rgb_t c = pbrt_srgb(p, vec3((float)v[0], (float)v[1], (float)v[2]), emitted);
        if (!(v[0] >= 0 && v[1] >= 0 && v[2] >= 0) || !((double)v_max(c) <= BLOB_MAX_NUMBER))
            result = error_at(at, "colour number %zu of \"%s\" is (%g %g %g), but must be from 0 to %g", i,
                              name, v[0], v[1], v[2], BLOB_MAX_NUMBER);
        cells[3 * i] = fmaxf(c.x, 0), cells[3 * i + 1] = fmaxf(c.y, 0), cells[3 * i + 2] = fmaxf(c.z, 0);
    }
    field.channels = 3;
    if (result.code == RESULT_OK) {
        field.first = blob_builder_add(p->builder->blob, BLOB_SECTION_NUMBERS, cells, 3 * count);
        *ref = add_field(p, &field);
    }
    free(cells);
    return result;
}

result_t medium_tints(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    blob_field_t field;
    double scale = 1;
    TRY(read_grid(p, params, at, &field));
    TRY(add_colours(p, params, "sigma_a", at, false, field, &medium->absorption_tint));
    TRY(add_colours(p, params, "sigma_s", at, false, field, &medium->scattering_tint));
    if (medium->absorption_tint == 0 && medium->scattering_tint == 0)
        return error_at(at,
                        "an rgbgrid needs colours: \"rgb sigma_a\", \"rgb sigma_s\" or both, one for each "
                        "cell");
    TRY(params_float_in(params, "Lescale", 0, 1e30, &scale));
    if (!params_has(params, "Le")) return result_ok();
    if (medium->absorption_tint == 0)
        return error_at(params_where(params, "Le", at), "an rgbgrid with \"Le\" needs \"sigma_a\"");
    medium->emission = v_scale(medium->absorption, (float)(scale * SPECTRUM_LUMINANCE_OF_1));
    if (!((double)v_max(medium->emission) <= BLOB_MAX_NUMBER))
        return error_at(params_where(params, "Lescale", at), "Lescale, times the scale, must be at most %g",
                        BLOB_MAX_NUMBER / SPECTRUM_LUMINANCE_OF_1);
    return add_colours(p, params, "Le", at, true, field, &medium->emission_tint);
}

/* ---- clouds ---------------------------------------------------------------------------------------------
 */

result_t medium_cloud(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    double density = 1, wispiness = 1, frequency = 5, p0[3], sides[3];
    blob_field_t field = {.kind = FIELD_CLOUD, .channels = 1};
    TRY(params_float_in(params, "density", 0, BLOB_MAX_NUMBER, &density));
    TRY(params_float_in(params, "wispiness", 0, BLOB_MAX_NUMBER, &wispiness));
    TRY(params_float_in(params, "frequency", -BLOB_MAX_NUMBER, BLOB_MAX_NUMBER, &frequency));
    TRY(read_box(p, params, at, p0, sides, &field));
    for (int i = 0; i < 3; ++i) {
        field.origin[i] = (float)p0[i];
        field.span[i] = (float)sides[i];
        if (!(sides[i] >= 1e-6 && sides[i] <= 1e6 && fabs(p0[i]) <= 1e6))
            return error_at(
                at,
                "p0 and p1 must differ by at least 1e-6 in each coordinate, and lie within a million of 0");
    }
    field.parameters[0] = (float)density;
    field.parameters[1] = (float)wispiness;
    field.parameters[2] = (float)frequency;
    medium->density = add_field(p, &field);
    return result_ok();
}

/* ---- files ----------------------------------------------------------------------------------------------
 */

/* Adds a grid of a file, if it has it; *ref 0: it has not. */
static result_t add_file(pbrt_t *p, position_t at, const char *path, const char *name, blob_ref_t *ref,
                         double *most)
{
    nanovdb_grid_t grid;
    *ref = 0;
    result_t result = nanovdb_read(path, name, p->builder, at, &grid);
    if (result.code == RESULT_INPUT) return error_at(at, "%s", result.message);
    TRY(result);
    if (!grid.found) return result_ok();
    TRY(place(p, at, &grid.from_box, &grid.field));
    *most = (double)grid.largest;
    *ref = add_field(p, &grid.field);
    return result_ok();
}

static result_t read_files(pbrt_t *p, params_t *params, position_t at, const char *path,
                           blob_medium_t *medium)
{
    const char *density = "density", *temperature = "temperature";
    double most, hottest, offset, scale, emission_scale = 1;
    blob_ref_t warm;
    TRY(params_string(params, "gridname", &density));
    TRY(params_string(params, "temperaturename", &temperature));
    TRY(read_kelvins(params, at, &offset, &scale));
    TRY(params_float_in(params, "Lescale", 0, BLOB_MAX_NUMBER, &emission_scale));
    TRY(add_file(p, at, path, density, &medium->density, &most));
    if (medium->density == 0)
        return error_at(at, "%s: there is no grid \"%.60s\", or it has no active voxels", path, density);
    TRY(add_file(p, at, path, temperature, &warm, &hottest));
    if (warm != 0) add_glow(p, offset, scale, hottest, warm, emission_scale, medium);
    if ((double)v_max(medium->emission) <= BLOB_MAX_NUMBER) return result_ok();
    return error_at(params_where(params, "Lescale", at), "Lescale, times sigma_a, must be at most %g",
                    BLOB_MAX_NUMBER);
}

result_t medium_nanovdb(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium)
{
    const char *filename = "";
    TRY(params_string(params, "filename", &filename));
    if (*filename == '\0') return error_at(at, "a nanovdb medium needs its file: \"string filename\"");
    at = params_where(params, "filename", at);
    char *path = pbrt_resolve(p, filename);
    scene_count_file(p->builder, path);
    result_t result = read_files(p, params, at, path, medium);
    free(path);
    if (result.code == RESULT_OK) return result;
    *medium = (blob_medium_t){.g = medium->g};
    return report_excuse(p->report, result, "the medium is empty space");
}
