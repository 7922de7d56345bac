/* What the tests of the importer share: scenes written to a directory of their own, imported, with the
 * warnings kept. All static inline: a test program is one file. */
#ifndef LIGHTMILL_TEST_IMPORT_H
#define LIGHTMILL_TEST_IMPORT_H

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "client/import/import.h"

/* One test's directory, and what came of its last import. Use it zeroed; bench_close frees all. */
typedef struct {
    char folder[64];
    char *files[16]; /* written, to be removed */
    int file_count;
    char warnings[32768]; /* of the last import, one a line */
    int warning_count;
    bool lenient, strict;          /* set them before an import */
    const import_wishes_t *wishes; /* the same */
    result_t result;
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
} bench_t;

static inline void bench_warn(void *context, const char *message)
{
    bench_t *bench = context;
    size_t used = strlen(bench->warnings);
    snprintf(bench->warnings + used, sizeof bench->warnings - used, "%s\n", message);
    ++bench->warning_count;
}

static inline char *bench_path(bench_t *bench, const char *name)
{
    if (!bench->folder[0]) {
        strcpy(bench->folder, "/tmp/lightmill-import-XXXXXX");
        assert_non_null(mkdtemp(bench->folder));
    }
    return mem_printf("%s/%s", bench->folder, name);
}

static inline void bench_write(bench_t *bench, const char *name, const void *data, size_t size)
{
    char *path = bench_path(bench, name);
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(data, 1, size, file), size);
    assert_int_equal(fclose(file), 0);
    for (int i = 0; i < bench->file_count; ++i) {
        if (strcmp(bench->files[i], path) != 0) continue;
        free(path);
        return;
    }
    assert_true(bench->file_count < 16);
    bench->files[bench->file_count++] = path;
}

static inline void bench_drop_result(bench_t *bench)
{
    blob_close(&bench->blob);
    free(bench->bytes);
    bench->bytes = NULL;
    bench->warnings[0] = '\0';
    bench->warning_count = 0;
}

static inline void bench_close(bench_t *bench)
{
    bench_drop_result(bench);
    for (int i = 0; i < bench->file_count; ++i) {
        unlink(bench->files[i]);
        free(bench->files[i]);
    }
    if (bench->folder[0]) rmdir(bench->folder);
    *bench = (bench_t){0};
}

/* Imports any path; result, warnings and blob are in the bench. */
static inline void bench_import(bench_t *bench, const char *path)
{
    bench_drop_result(bench);
    import_report_t report = {.warn = bench_warn,
                              .context = bench,
                              .lenient = bench->lenient,
                              .strict = bench->strict,
                              .wishes = bench->wishes};
    bench->result = import_scene_blob(path, &report, &bench->bytes, &bench->size);
    if (bench->result.code != RESULT_OK) return;
    result_t opened = blob_open(bench->bytes, bench->size, &bench->blob);
    assert_string_equal(opened.message, "");
}

/* Imports a file of the bench's directory. */
static inline void bench_import_file(bench_t *bench, const char *name)
{
    char *path = bench_path(bench, name);
    bench_import(bench, path);
    free(path);
}

/* Writes a scene and imports it. */
static inline void bench_run(bench_t *bench, const char *text)
{
    bench_write(bench, "s.pbrt", text, strlen(text));
    bench_import_file(bench, "s.pbrt");
}

/* A v3 scene around the given world. */
static inline void bench_run_v3(bench_t *bench, const char *world)
{
    char *text = mem_printf("WorldBegin\n%s\nWorldEnd\n", world);
    bench_run(bench, text);
    free(text);
}

static inline void bench_expect_ok(const bench_t *bench)
{
    assert_string_equal(bench->result.message, "");
    assert_int_equal(bench->result.code, RESULT_OK);
}

static inline void bench_expect_silence(const bench_t *bench)
{
    bench_expect_ok(bench);
    assert_string_equal(bench->warnings, "");
}

/* How many records of a kind the import made. */
static inline uint64_t count_of(const bench_t *bench, blob_section_t section)
{
    return bench->blob.counts[section];
}

/* The mesh of a shape, and its positions. */
static inline const blob_mesh_t *mesh_of(const bench_t *bench, uint64_t shape)
{
    assert_true(shape < count_of(bench, BLOB_SECTION_SHAPES));
    return &bench->blob.meshes[bench->blob.shapes[shape].geometry];
}

static inline const vec3_t *positions_of(const bench_t *bench, uint64_t shape)
{
    return bench->blob.positions + mesh_of(bench, shape)->first_position;
}

static inline void expect_text(const char *text, const char *part)
{
    if (!strstr(text, part)) fail_msg("expected \"%s\" in \"%s\"", part, text);
}

static inline void expect_near(double a, double b, double tolerance)
{
    if (!(a - b <= tolerance && b - a <= tolerance)) fail_msg("%.9g is not %.9g +- %g", a, b, tolerance);
}

static inline void expect_vec3(vec3_t v, double x, double y, double z)
{
    if (fabs((double)v.x - x) > 1e-5 || fabs((double)v.y - y) > 1e-5 || fabs((double)v.z - z) > 1e-5)
        fail_msg("(%g %g %g) is not (%g %g %g)", (double)v.x, (double)v.y, (double)v.z, x, y, z);
}

#endif
