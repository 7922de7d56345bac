/* bsdf_files: see bsdf_files.h. A file is read once, however many materials name it. */
#include "client/import/pbrt/materials/bsdf_files.h"

#include <stdlib.h>

#include "client/import/files/fourier_table.h"
#include "client/import/files/measured_table.h"

static const size_t largest_file = (size_t)1 << 34;

/* A kind of file, and the diffuse surface that a material is when its file is missing or wrong. */
typedef struct {
    const char *parameter; /* of the material; names the file */
    /* Decodes the file's bytes and adds the table to the blob. */
    result_t (*add)(blob_builder_t *blob, const char *path, const uint8_t *data, size_t size,
                    uint32_t *index);
    float reflectance; /* of the diffuse surface ... */
    const char *does;  /* ... and how messages name it */
} bsdf_file_t;

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

static const bsdf_file_t fourier = {"bsdffile", add_fourier, 0, "the surface is black"};
static const bsdf_file_t measured = {"filename", add_measured, 0.5f, "a diffuse surface"};

static result_t read_table(pbrt_t *p, const bsdf_file_t *kind, const char *path, uint32_t *index)
{
    uint8_t *data;
    size_t size;
    TRY(file_read(path, largest_file, &data, &size));
    result_t result = kind->add(p->builder->blob, path, data, size, index);
    free(data);
    if (result.code != RESULT_OK) return result;
    p->builder->source_bytes += size;
    names_add(&p->bsdf_files, path, *index);
    return result_ok();
}

static result_t use_file(pbrt_t *p, const bsdf_file_t *kind, const char *path, position_t at,
                         blob_material_t *record)
{
    if (names_find(&p->bsdf_files, path, &record->table)) return result_ok();
    bool missing = pbrt_is_missing(path);
    result_t result = missing ? result_ok() : read_table(p, kind, path, &record->table);
    if (!missing && result.code != RESULT_INPUT) return result;
    record->kind = MATERIAL_DIFFUSE;
    record->values[VALUE_REFLECTANCE] = blob_constant(kind->reflectance);
    if (missing) return pbrt_missing(p, at, path, kind->does);
    if (p->dialect.dialect == DIALECT_V3) return pbrt_slip(p, at, kind->does, "%s", result.message);
    return report_refuse(p->report, at, "%s; the nearest: %s", result.message, kind->does);
}

static result_t read_file(pbrt_t *p, params_t *params, const bsdf_file_t *kind, const char *name,
                          position_t at, blob_material_t *record)
{
    char *path = pbrt_resolve(p, name);
    result_t result = use_file(p, kind, path, params_where(params, kind->parameter, at), record);
    free(path);
    return result;
}

result_t pbrt_read_fourier(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    const char *name = NULL;
    TRY(params_string(params, fourier.parameter, &name));
    if (name) return read_file(p, params, &fourier, name, at, record);
    record->kind = MATERIAL_DIFFUSE;
    return pbrt_slip(p, at, fourier.does, "a fourier material needs a \"string bsdffile\"");
}

result_t pbrt_read_measured(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    const char *name = NULL;
    TRY(params_string(params, measured.parameter, &name));
    if (name) return read_file(p, params, &measured, name, at, record);
    return error_at(at, "a measured material needs a \"string filename\"");
}
