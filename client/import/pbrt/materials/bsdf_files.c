/* bsdf_files: see bsdf_files.h. A file is read once, however many materials name it. */
#include "client/import/pbrt/materials/bsdf_files.h"

#include <stdlib.h>

#include "client/import/files/fourier_table.h"

static const size_t largest_file = (size_t)1 << 34;

static result_t read_table(pbrt_t *p, const char *path, uint32_t *index)
{
    uint8_t *data;
    size_t size;
    fourier_table_t table;
    TRY(file_read(path, largest_file, &data, &size));
    result_t result = fourier_table_decode(path, data, size, &table);
    free(data);
    if (result.code != RESULT_OK) return result;
    p->builder->source_bytes += size;
    *index = fourier_table_add(&table, p->builder->blob);
    fourier_table_free(&table);
    names_add(&p->bsdf_files, path, *index);
    return result_ok();
}

static result_t use_file(pbrt_t *p, const char *path, position_t at, blob_material_t *record)
{
    if (names_find(&p->bsdf_files, path, &record->table)) return result_ok();
    if (pbrt_is_missing(path)) {
        record->kind = MATERIAL_DIFFUSE;
        return pbrt_missing(p, at, path, "the surface is black");
    }
    result_t result = read_table(p, path, &record->table);
    if (result.code != RESULT_INPUT) return result;
    record->kind = MATERIAL_DIFFUSE;
    return pbrt_slip(p, at, "the surface is black", "%s", result.message);
}

result_t pbrt_read_fourier(pbrt_t *p, params_t *params, position_t at, blob_material_t *record)
{
    const char *name = NULL;
    TRY(params_string(params, "bsdffile", &name));
    if (!name) {
        record->kind = MATERIAL_DIFFUSE;
        return pbrt_slip(p, at, "the surface is black", "a fourier material needs a \"string bsdffile\"");
    }
    char *path = pbrt_resolve(p, name);
    result_t result = use_file(p, path, params_where(params, "bsdffile", at), record);
    free(path);
    return result;
}
