/* scene_blob: opens scene blobs (see scene_blob.h and blob_layout.h). */
#include "common/scene/blob_layout.h"

#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

const section_type_t blob_section_types[BLOB_SECTION_COUNT] = {
    [BLOB_SECTION_SCENE] = {"scene", sizeof(blob_scene_t)},
    [BLOB_SECTION_POSITIONS] = {"positions", sizeof(vec3_t)},
    [BLOB_SECTION_NORMALS] = {"normals", sizeof(vec3_t)},
    [BLOB_SECTION_UVS] = {"uvs", sizeof(vec2_t)},
    [BLOB_SECTION_COLOURS] = {"colours", sizeof(blob_colour_t)},
    [BLOB_SECTION_TRIANGLES] = {"triangles", sizeof(blob_triangle_t)},
    [BLOB_SECTION_MESHES] = {"meshes", sizeof(blob_mesh_t)},
    [BLOB_SECTION_QUADRICS] = {"quadrics", sizeof(blob_quadric_t)},
    [BLOB_SECTION_CURVE_POINTS] = {"curve points", sizeof(blob_curve_point_t)},
    [BLOB_SECTION_CURVES] = {"curves", sizeof(blob_curves_t)},
    [BLOB_SECTION_SHAPES] = {"shapes", sizeof(blob_shape_t)},
    [BLOB_SECTION_OBJECTS] = {"objects", sizeof(blob_object_t)},
    [BLOB_SECTION_INSTANCES] = {"instances", sizeof(blob_instance_t)},
    [BLOB_SECTION_TEXTURES] = {"textures", sizeof(blob_texture_t)},
    [BLOB_SECTION_IMAGES] = {"images", sizeof(blob_image_t)},
    [BLOB_SECTION_TEXELS] = {"texels", sizeof(uint32_t)},
    [BLOB_SECTION_MATERIALS] = {"materials", sizeof(blob_material_t)},
    [BLOB_SECTION_MEDIA] = {"media", sizeof(blob_medium_t)},
    [BLOB_SECTION_FIELDS] = {"fields", sizeof(blob_field_t)},
    [BLOB_SECTION_BRICKS] = {"bricks", sizeof(uint32_t)},
    [BLOB_SECTION_LIGHTS] = {"lights", sizeof(blob_light_t)},
    [BLOB_SECTION_LENS] = {"lens", sizeof(blob_lens_element_t)},
    [BLOB_SECTION_PUPILS] = {"pupils", sizeof(blob_pupil_t)},
    [BLOB_SECTION_FOURIERS] = {"fouriers", sizeof(blob_fourier_t)},
    [BLOB_SECTION_SERIES] = {"series", sizeof(blob_series_t)},
    [BLOB_SECTION_MEASUREMENTS] = {"measurements", sizeof(blob_measured_t)},
    [BLOB_SECTION_NUMBERS] = {"numbers", sizeof(float)},
    [BLOB_SECTION_SPECTRA] = {"spectra", sizeof(blob_spectrum_t)},
    [BLOB_SECTION_STRINGS] = {"strings", 1},
};

/* ---- the frame -------------------------------------------------------------------------------------------
 */

bool blob_recognise(const void *bytes, uint64_t size)
{
    return size >= sizeof blob_magic && memcmp(bytes, blob_magic, sizeof blob_magic) == 0;
}

static result_t check_header(const uint8_t *bytes, uint64_t size)
{
    const header_t *header = (const header_t *)bytes;
    CHECK(blob_recognise(bytes, size), "does not begin with its magic bytes; not a scene blob");
    CHECK(size >= sizeof *header, "truncated inside its header (%llu bytes)", (unsigned long long)size);
    CHECK(header->version == BLOB_VERSION,
          "is of version %u, this program reads version %d; import the scene again", header->version,
          BLOB_VERSION);
    CHECK(header->section_count == BLOB_SECTION_COUNT, "has %u sections, expected %d", header->section_count,
          BLOB_SECTION_COUNT);
    CHECK(header->size == size && size <= BLOB_MAX_BYTES,
          "says it has %llu bytes, but %llu are here; truncated?", (unsigned long long)header->size,
          (unsigned long long)size);
    return result_ok();
}

/* Checks the checksum and makes the hash of all bytes in one pass: what does not fit into memory is read from
 * the disk once. A piece stays in the processor's cache for both. */
static result_t check_checksum(const uint8_t *bytes, uint64_t size, hash_t *whole)
{
    enum { PIECE = 1 << 17 };
    const header_t *header = (const header_t *)bytes;
    crypto_generichash_state all, behind;
    hash_t checksum;
    crypto_generichash_init(&all, NULL, 0, HASH_BYTES);
    crypto_generichash_init(&behind, NULL, 0, HASH_BYTES);
    crypto_generichash_update(&all, bytes, sizeof *header);
    for (uint64_t at = sizeof *header; at < size; at += PIECE) {
        uint64_t piece = size - at < PIECE ? size - at : PIECE;
        crypto_generichash_update(&all, bytes + at, piece);
        crypto_generichash_update(&behind, bytes + at, piece);
    }
    crypto_generichash_final(&all, whole->bytes, HASH_BYTES);
    crypto_generichash_final(&behind, checksum.bytes, HASH_BYTES);
    CHECK(hash_equal(&checksum, &header->checksum), "is damaged: its checksum does not match");
    return result_ok();
}

static result_t check_sections(const uint8_t *bytes, uint64_t size)
{
    const header_t *header = (const header_t *)bytes;
    uint64_t end = sizeof *header;
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) {
        const section_t *section = &header->sections[i];
        CHECK(section->offset >= end && section->offset % SECTION_ALIGN == 0 && section->offset <= size &&
                  section->count < BLOB_NONE &&
                  section->count * blob_section_types[i].size + SECTION_PADDING <= size - section->offset,
              "section '%s' lies outside the blob", blob_section_types[i].name);
        end = section->offset + section->count * blob_section_types[i].size + SECTION_PADDING;
    }
    return result_ok();
}

/* ---- opening ------------------------------------------------------------------------------------------- */

/* A view of sections whose contents are not checked. */
static result_t find_sections(const void *bytes, uint64_t size, scene_blob_t *blob)
{
    TRY(check_sections(bytes, size));
    const header_t *header = bytes;
    scene_blob_t view = {.bytes = bytes, .size = size};
    const void *at[BLOB_SECTION_COUNT];
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) {
        at[i] = view.bytes + header->sections[i].offset;
        view.counts[i] = header->sections[i].count;
    }
    view.scene = at[BLOB_SECTION_SCENE];
    view.positions = at[BLOB_SECTION_POSITIONS];
    view.normals = at[BLOB_SECTION_NORMALS];
    view.uvs = at[BLOB_SECTION_UVS];
    view.colours = at[BLOB_SECTION_COLOURS];
    view.triangles = at[BLOB_SECTION_TRIANGLES];
    view.meshes = at[BLOB_SECTION_MESHES];
    view.quadrics = at[BLOB_SECTION_QUADRICS];
    view.curve_points = at[BLOB_SECTION_CURVE_POINTS];
    view.curves = at[BLOB_SECTION_CURVES];
    view.shapes = at[BLOB_SECTION_SHAPES];
    view.objects = at[BLOB_SECTION_OBJECTS];
    view.instances = at[BLOB_SECTION_INSTANCES];
    view.textures = at[BLOB_SECTION_TEXTURES];
    view.images = at[BLOB_SECTION_IMAGES];
    view.texels = at[BLOB_SECTION_TEXELS];
    view.materials = at[BLOB_SECTION_MATERIALS];
    view.media = at[BLOB_SECTION_MEDIA];
    view.fields = at[BLOB_SECTION_FIELDS];
    view.bricks = at[BLOB_SECTION_BRICKS];
    view.lights = at[BLOB_SECTION_LIGHTS];
    view.lens = at[BLOB_SECTION_LENS];
    view.pupils = at[BLOB_SECTION_PUPILS];
    view.fouriers = at[BLOB_SECTION_FOURIERS];
    view.series = at[BLOB_SECTION_SERIES];
    view.measurements = at[BLOB_SECTION_MEASUREMENTS];
    view.numbers = at[BLOB_SECTION_NUMBERS];
    view.spectra = at[BLOB_SECTION_SPECTRA];
    view.strings = at[BLOB_SECTION_STRINGS];
    *blob = view;
    return result_ok();
}

result_t blob_make_view(const void *bytes, uint64_t size, scene_blob_t *blob)
{
    scene_blob_t view;
    TRY(find_sections(bytes, size, &view));
    TRY(blob_check_contents(&view));
    *blob = view;
    return result_ok();
}

result_t blob_open(const void *bytes, uint64_t size, scene_blob_t *blob)
{
    *blob = (scene_blob_t){0};
    scene_blob_t view;
    hash_t hash;
    TRY(check_header(bytes, size));
    TRY(check_checksum(bytes, size, &hash));
    TRY(blob_make_view(bytes, size, &view));
    view.hash = hash;
    *blob = view;
    return result_ok();
}

typedef result_t open_bytes_t(const void *bytes, uint64_t size, scene_blob_t *blob);

/* Maps an open file and makes its view by `open_bytes`. */
static result_t map_file(int file, const char *name, open_bytes_t *open_bytes, scene_blob_t *blob)
{
    struct stat about = {.st_size = 0};
    void *bytes = MAP_FAILED;
    int error = fstat(file, &about) != 0 ? errno : 0;
    bool has_bytes = S_ISREG(about.st_mode) && about.st_size > 0;
    if (has_bytes) bytes = mmap(NULL, (size_t)about.st_size, PROT_READ, MAP_SHARED, file, 0);
    if (has_bytes && bytes == MAP_FAILED) error = errno;
    if (error != 0) return result_fail(RESULT_IO, "%s: cannot be mapped: %s", name, strerror(error));
    if (bytes == MAP_FAILED) return result_fail(RESULT_INPUT, "%s: is empty, or no file", name);
    madvise(bytes, (size_t)about.st_size, MADV_SEQUENTIAL);
    result_t result = open_bytes(bytes, (uint64_t)about.st_size, blob);
    if (result.code == RESULT_OK) {
        madvise(bytes, (size_t)about.st_size, MADV_NORMAL);
        blob->mapped = true;
        return result;
    }
    munmap(bytes, (size_t)about.st_size);
    return result_fail(result.code, "%s: %s", name, result.message);
}

static result_t open_file(const char *path, open_bytes_t *open_bytes, scene_blob_t *blob)
{
    *blob = (scene_blob_t){0};
    int file = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); /* a FIFO would wait for its other end */
    if (file < 0) {
        bool fault =
            errno == EMFILE || errno == ENFILE || errno == ENOMEM || errno == EIO; /* not the file's */
        return result_fail(fault ? RESULT_IO : RESULT_INPUT, "%s: cannot be opened: %s", path,
                           strerror(errno));
    }
    result_t result = map_file(file, path, open_bytes, blob);
    close(file);
    return result;
}

result_t blob_open_descriptor(int file, const char *name, scene_blob_t *blob)
{
    *blob = (scene_blob_t){0};
    return map_file(file, name, blob_open, blob);
}

result_t blob_open_file(const char *path, scene_blob_t *blob)
{
    return open_file(path, blob_open, blob);
}

static result_t peek(const void *bytes, uint64_t size, scene_blob_t *blob)
{
    scene_blob_t view;
    TRY(check_header(bytes, size));
    TRY(find_sections(bytes, size, &view));
    uint64_t scenes = view.counts[BLOB_SECTION_SCENE];
    CHECK(scenes == 1, "has %llu scenes, expected 1", (unsigned long long)scenes);
    *blob = view;
    return result_ok();
}

result_t blob_peek_file(const char *path, scene_blob_t *blob)
{
    return open_file(path, peek, blob);
}

void blob_close(scene_blob_t *blob)
{
    if (blob->mapped) munmap((void *)blob->bytes, blob->size);
    *blob = (scene_blob_t){0};
}

/* ---- lights -------------------------------------------------------------------------------------------- */

_Static_assert((int)LIGHT_INFINITE == (int)LIGHT_KINDS_COUNT, "light_kind_names has other kinds");

/* Where an area light comes from; NULL when the blob, of which little may have been checked, does not say. */
static const char *light_place(const scene_blob_t *blob, const blob_light_t *light)
{
    uint64_t strings = blob->counts[BLOB_SECTION_STRINGS];
    if (light->kind != LIGHT_AREA || light->shape >= blob->counts[BLOB_SECTION_SHAPES]) return NULL;
    uint32_t name = blob->shapes[light->shape].name;
    return name < strings && blob->strings[strings - 1] == '\0' ? blob->strings + name : NULL;
}

grouped_light_t *blob_grouped_lights(const scene_blob_t *blob)
{
    size_t count = blob->counts[BLOB_SECTION_LIGHTS];
    grouped_light_t *lights = mem_alloc((count + 1) * sizeof *lights);
    for (size_t i = 0; i < count; i++)
        lights[i] = (grouped_light_t){blob->lights[i].kind, light_place(blob, &blob->lights[i])};
    return lights;
}

/* ---- defaults ------------------------------------------------------------------------------------------ */

blob_scene_t blob_default_scene(void)
{
    return (blob_scene_t){.camera = CAMERA_PERSPECTIVE,
                          .world_from_camera = xform_identity(),
                          .world_from_camera_end = xform_identity(),
                          .fov = 90,
                          .focal_distance = 1,
                          .film_window = {0, 1, 0, 1},
                          .filter = {.kind = FILTER_BOX, .radius_x = 0.5f, .radius_y = 0.5f},
                          .width = 640,
                          .height = 480,
                          .max_depth = 5,
                          .spp = 16,
                          .integrator = INTEGRATOR_BDPT,
                          .sampler = SAMPLER_SOBOL,
                          .max_luminance = INFINITY,
                          .occlusion_distance = INFINITY,
                          .occlusion_radiance = {1, 1, 1}};
}

/* ---- what a job starts from ---------------------------------------------------------------------------- */

/* As bright as a light may make the picture. How far away what has an intensity stands is not known: however
 * strong, a film must be left that shows less than a thousandth. */
static float brightness_of(const blob_light_t *light)
{
    bool intensity = light->kind > LIGHT_AREA && light->kind < LIGHT_DISTANT;
    return float_min(v_max(light->radiance.factor), intensity ? 0x1p25f : INFINITY);
}

int blob_film_scale(const scene_blob_t *blob)
{
    float brightest = v_max(blob->scene->occlusion_radiance);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++)
        brightest = float_max(brightest, brightness_of(&blob->lights[i]));
    int excess = brightest > 0 ? ilogbf(brightest) - 9 : 0;
    return int_max(FILM_MIN_SCALE, FILM_DEFAULT_SCALE - int_max(0, excess));
}

result_t blob_check_settings(const scene_blob_t *blob, const job_settings_t *settings)
{
    if (settings->integrator != INTEGRATOR_LIGHT || blob->scene->camera != CAMERA_REALISTIC)
        return result_ok();
    return result_fail(RESULT_USAGE, "the integrator light joins paths from the lights to the camera, which "
                                     "cannot be done through this scene's lens: use bdpt or path");
}

job_settings_t blob_default_settings(const scene_blob_t *blob)
{
    const blob_scene_t *scene = blob->scene;
    job_settings_t settings = job_settings_default();
    settings.integrator = (integrator_t)scene->integrator;
    settings.sampler = (sampler_kind_t)scene->sampler;
    settings.width = scene->width;
    settings.height = scene->height;
    settings.max_depth = scene->max_depth;
    settings.spp = scene->spp;
    settings.film_scale = blob_film_scale(blob);
    return settings;
}
