/* support: see fuzz.h. */
#include "tests/fuzz/fuzz.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "client/import/import.h"
#include "worker/render/medium/density.h"
#include "worker/render/texture/texture.h"

static const char assets[] = "tests/fuzz/assets";

void fuzz_expect(bool condition, const char *what)
{
    if (condition) return;
    fprintf(stderr, "finding: %s\n", what);
    abort();
}

/* ---- files --------------------------------------------------------------------------------------------- */

/* libFuzzer gives a target no place to keep anything. */
static struct {
    char folder[256], path[600];
} scratch;

static void drop_folder(void)
{
    DIR *folder = opendir(scratch.folder);
    if (!folder) return;
    for (struct dirent *entry; (entry = readdir(folder));)
        if (entry->d_name[0] != '.') unlink(fuzz_path(entry->d_name));
    closedir(folder);
    rmdir(scratch.folder);
}

static void copy_assets(void)
{
    DIR *folder = opendir(assets);
    fuzz_expect(folder != NULL, "no tests/fuzz/assets: a target runs from the repository's root");
    for (struct dirent *entry; (entry = readdir(folder));) {
        if (entry->d_name[0] == '.') continue;
        char *path = mem_printf("%s/%s", assets, entry->d_name);
        uint8_t *data;
        size_t size;
        result_t result = file_read(path, 1 << 20, &data, &size);
        fuzz_expect(result.code == RESULT_OK, result.message);
        fuzz_write(entry->d_name, data, size);
        free(data);
        free(path);
    }
    closedir(folder);
}

const char *fuzz_path(const char *name)
{
    if (!scratch.folder[0]) {
        const char *parent = getenv("TMPDIR");
        snprintf(scratch.folder, sizeof scratch.folder, "%s/lightmill-fuzz-XXXXXX", parent ? parent : "/tmp");
        fuzz_expect(mkdtemp(scratch.folder) != NULL, "no folder can be made in TMPDIR");
        atexit(drop_folder);
        copy_assets();
    }
    snprintf(scratch.path, sizeof scratch.path, "%s/%s", scratch.folder, name);
    return scratch.path;
}

void fuzz_write(const char *name, const void *data, size_t size)
{
    FILE *file = fopen(fuzz_path(name), "wb");
    bool written = file && fwrite(data, 1, size, file) == size && fclose(file) == 0;
    fuzz_expect(written, "a file cannot be written in TMPDIR");
}

/* ---- importing ----------------------------------------------------------------------------------------- */

static void count_warning(void *context, const char *message)
{
    fuzz_expect(message[0] != '\0', "a warning without text");
    ++*(int *)context;
}

static bool import(const char *path, const import_wishes_t *wishes, bool lenient, int *warnings)
{
    *warnings = 0;
    import_report_t report = {
        .warn = count_warning, .context = warnings, .lenient = lenient, .wishes = wishes};
    blob_builder_t *builder = blob_builder_new();
    uint8_t *bytes = NULL;
    uint64_t size;
    result_t result = import_scene(path, builder, &report);
    bool accepted = result.code == RESULT_OK;
    fuzz_expect(accepted || result.message[0] != '\0', "an error without text");
    if (accepted) {
        result = blob_builder_finish(builder, &bytes, &size);
        fuzz_expect(result.code == RESULT_OK, result.message);
        scene_blob_t blob;
        result = blob_open(bytes, size, &blob);
        fuzz_expect(result.code == RESULT_OK, result.message);
        fuzz_walk(&blob);
    }
    blob_builder_destroy(&builder);
    free(bytes);
    return accepted;
}

static void import_twice(const char *name, const import_wishes_t *wishes)
{
    int warnings;
    char *path = mem_strdup(fuzz_path(name));
    if (import(path, wishes, true, &warnings) && warnings) import(path, wishes, false, &warnings);
    free(path);
}

void fuzz_import(const char *name)
{
    import_twice(name, NULL);
}

void fuzz_import_at(const char *name, double time, const char *shutter)
{
    import_wishes_t wishes = import_wishes_none();
    wishes.time_point = time;
    wishes.shutter = shutter;
    import_twice(name, &wishes);
}

/* ---- blobs --------------------------------------------------------------------------------------------- */

/* Where a blob's header has them: see scene_blob.c. */
enum { VERSION_AT = 8, SIZE_AT = 16, CHECKSUM_AT = 24, SECTIONS_AT = CHECKSUM_AT + HASH_BYTES };
enum { HEADER_SIZE = SECTIONS_AT + 16 * BLOB_SECTION_COUNT };

uint8_t *fuzz_mend_blob(const uint8_t *data, size_t size)
{
    uint8_t *bytes = mem_alloc(size);
    if (size > 0) memcpy(bytes, data, size);
    if (size >= HEADER_SIZE) {
        uint64_t whole = size;
        uint32_t version = BLOB_VERSION; /* seeds outlive versions */
        memcpy(bytes + VERSION_AT, &version, sizeof version);
        hash_t checksum = hash_bytes(bytes + HEADER_SIZE, size - HEADER_SIZE);
        memcpy(bytes + SIZE_AT, &whole, sizeof whole);
        memcpy(bytes + CHECKSUM_AT, &checksum, sizeof checksum);
    }
    return bytes;
}

/* ---- looking at a blob --------------------------------------------------------------------------------- */

static void walk_images(const scene_blob_t *blob, const textures_t *textures)
{
    static const float places[] = {0, 0.3f, 1, -7.7f, 1e9f, -1e38f};
    for (uint32_t i = 0; i < blob->counts[BLOB_SECTION_IMAGES] && i < 64; ++i) {
        uint32_t width, height;
        textures_size(textures, i, &width, &height);
        textures_texel(textures, i, 0, 0);
        textures_texel(textures, i, width - 1, height - 1);
        for (size_t k = 0; k < ARRAY_LENGTH(places); ++k)
            for (int wrap = WRAP_REPEAT; wrap <= WRAP_MIRROR; ++wrap)
                textures_image(textures, i, (wrap_t)wrap, (wrap_t)wrap,
                               (vec2_t){places[k], places[ARRAY_LENGTH(places) - 1 - k]});
    }
}

static void walk_textures(const scene_blob_t *blob)
{
    static const texture_point_t points[] = {
        {{0.3f, 0.7f}, {0.1f, 0.2f}, {1, 2, 3}, {0, 0, 1}, {1, 1, 1, 1}},
        {{-1e30f, 1e30f}, {1e10f, -0.0f}, {1e18f, -1e18f, 1e9f}, {0, 1, 0}, {0, 0, 0, 0}},
    };
    textures_t *textures = textures_new(blob);
    walk_images(blob, textures);
    for (uint32_t i = 0; i < blob->counts[BLOB_SECTION_TEXTURES] && i < 256; ++i)
        for (size_t k = 0; k < ARRAY_LENGTH(points); ++k) textures_eval(textures, i, &points[k]);
    textures_destroy(&textures);
}

/* False so far from a grid that floats cannot tell places in it apart. */
static bool is_near(const march_t *march)
{
    for (int i = 0; i < 3; i++)
        if (!(fabsf(march->origin[i]) < 0x1p16f)) return false;
    return true;
}

/* Goes through the densities of media on two ways: what is there is finite, and no more than it may be. */
static void walk_density(const scene_blob_t *blob, blob_ref_t field)
{
    const vec3_t middle = {0.5f, 0.5f, 0.5f}, directions[] = {{0.6f, 0.8f, 0}, {0, 0, -1}};
    vec3_t from = xform_point(&blob->fields[field - 1].world_from_field, middle);
    density_t *density = density_new(blob, field);
    for (size_t i = 0; i < ARRAY_LENGTH(directions); ++i) {
        march_t march;
        float begin, end, most;
        march_begin(&march, density, from, directions[i], INFINITY);
        for (int piece = 0; piece < 100 && march_next(&march, &begin, &end, &most); ++piece)
            if (most > 0 && end < 1e9f && is_near(&march)) {
                float number = density_along(&march, 0.5f * (begin + end));
                fuzz_expect(number >= 0 && number <= 2 * most, "a density that is not within its bound");
            }
    }
    density_destroy(&density);
}

void fuzz_walk(const scene_blob_t *blob)
{
    walk_textures(blob);
    for (uint32_t i = 0; i < blob->counts[BLOB_SECTION_MEDIA] && i < 16; ++i)
        if (blob->media[i].density != 0) walk_density(blob, blob->media[i].density);
}

/* ---- scattering ---------------------------------------------------------------------------------------- */

blob_builder_t *fuzz_begin_blob(void)
{
    blob_builder_t *builder = blob_builder_new();
    blob_scene_t scene = blob_default_scene();
    blob_object_t world = {0, 0};
    blob_builder_add(builder, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, &world, 1);
    return builder;
}

void fuzz_end_blob(blob_builder_t **builder, uint8_t **bytes, scene_blob_t *blob)
{
    uint64_t size;
    result_t result = blob_builder_finish(*builder, bytes, &size);
    fuzz_expect(result.code == RESULT_OK, result.message);
    result = blob_open(*bytes, size, blob);
    fuzz_expect(result.code == RESULT_OK, result.message);
    blob_builder_destroy(builder);
}

static void check_sample(const lobe_t *lobe, vec3_t wo, vec2_t u)
{
    bsdf_sample_t sample;
    for (int mode = TRANSPORT_RADIANCE; mode <= TRANSPORT_IMPORTANCE; ++mode) {
        if (!lobe->kind->sample(lobe, wo, u, u.x, (transport_t)mode, &sample)) continue;
        fuzz_expect(v_is_finite(sample.wi) && v_is_finite(sample.weight), "a sample that is not finite");
        fuzz_expect(sample.pdf > 0 && isfinite(sample.pdf) && sample.pdf_rev >= 0,
                    "a sample without density");
    }
}

void fuzz_scatter(const lobe_t *lobe)
{
    static const float places[] = {0, 0.3f, 0.5f, 0.8f, 0x1.fffffep-1f};
    for (size_t i = 0; i < ARRAY_LENGTH(places); ++i)
        for (size_t k = 0; k < ARRAY_LENGTH(places); ++k) {
            float z = 2 * places[i] - 1, r = sqrtf(1 - z * z);
            check_sample(lobe, vec3(r, 0, z), (vec2_t){places[k], places[(i + k) % ARRAY_LENGTH(places)]});
        }
}
