/* bsdf_files: see bsdf_files.h. A file is read once, however many materials name it. */
#include "client/import/pbrt/materials/bsdf_files.h"

#include <stdlib.h>

#include "client/import/files/fourier_table.h"
#include "client/import/files/measured_table.h"

static const size_t largest_file = (size_t)1 << 34;

/* Decodes a file's bytes and adds the table to the blob. */
typedef result_t add_table_t(blob_builder_t *blob, const char *path, const uint8_t *data, size_t size,
                             uint32_t *index);

static result_t add_fourier(blob_builder_t *blob, const char *path, const uint8_t *data, size_t size,
                            uint32_t *index)
{
    fourier_table_t table;
    TRY(fourier_table_decode(path, data, size, &table));
    *index = fourier_table_add(&table, blob);
    fourier_table_free(&table);
    return result_ok();
}

static result_t add_measured(blob_builder_t *blob, const char *path, const uint8_t *data, size_t size,
                             uint32_t *index)
{
    measured_table_t table;
    TRY(measured_table_decode(path, data, size, &table));
    *index = measured_table_add(&table, blob);
    measured_table_free(&table);
    return result_ok();
}

static result_t read_table(pbrt_t *p, const char *path, add_table_t *add, uint32_t *index)
{
    uint8_t *data;
    size_t size;
    TRY(file_read(path, largest_file, &data, &size));
    result_t result = add(p->builder->blob, path, data, size, index);
    free(data);
    if (result.code != RESULT_OK) return result;
    p->builder->source_bytes += size;
    names_add(&p->bsdf_files, path, *index);
    return result_ok();
}

/* A material that is a diffuse surface instead, when its file is missing or wrong. `does` says which. */
static result_t use_file(pbrt_t *p, const char *path, position_t at, add_table_t *add, float reflectance,
                         const char *does, blob_material_t *record)
{
    if (names_find(&p->bsdf_files, path, &record->table)) return result_ok();
    bool missing = pbrt_is_missing(path);
    result_t result = missing ? result_ok() : read_table(p, path, add, &record->table);
    if (!missing && result.code != RESULT_INPUT) return result;
    record->kind = MATERIAL_DIFFUSE;
    record->values[VALUE_REFLECTANCE] = blob_constant(reflectance);
    if (missing) return pbrt_missing(p, at, path, does);
    if (p->dialect.dialect == DIALECT_V3) return pbrt_slip(p, at, does, "%s", result.message);
    return report_refuse(p->report, at, "%s; the nearest: %s", result.message, does);
}

static result_t read_table_of(pbrt_t *p, params_t *params, const char *parameter, const char *name,
                              position_t at, add_table_t *add, float reflectance, const char *does,
                              blob_material_t *record)
{
    char *path = pbrt_resolve(p, name);
    result_t result = use_file(p, path, params_where(params, parameter, at), add, reflectance, does, record);
    free(path);
    return result;
}

result_t pbrt_read_fourier(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    static const char does[] = "the surface is black";
    const char *name = NULL;
    TRY(params_string(params, "bsdffile", &name));
    if (name) return read_table_of(p, params, "bsdffile", name, at, add_fourier, 0, does, record);
    record->kind = MATERIAL_DIFFUSE;
    return pbrt_slip(p, at, does, "a fourier material needs a \"string bsdffile\"");
}

result_t pbrt_read_measured(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    const char *name = NULL;
    TRY(params_string(params, "filename", &name));
    if (name)
        return read_table_of(p, params, "filename", name, at, add_measured, 0.5f, "a diffuse surface",
                             record);
    return error_at(at, "a measured material needs a \"string filename\"");
}
