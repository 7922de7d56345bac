/* scene_blob: layout, checks and building of scene blobs (see scene_blob.h).
 *
 * On disk: header_t, then the sections in the order of blob_section_t, each 64-byte aligned and followed by
 * at least 16 bytes of zeroes. header_t.checksum is the BLAKE2b-256 of everything behind the header, so
 * damage is told from malice only by its message: both are refused. The checks run in one pass over every
 * array.
 */
#include "common/scene_blob.h"

#include "common/film.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

typedef struct {
    uint64_t offset; /* bytes from the start of the blob */
    uint64_t count;  /* records */
} section_t;

typedef struct {
    char magic[8];
    uint32_t version;
    uint32_t section_count;
    uint64_t size; /* of the whole blob */
    hash_t checksum;
    section_t sections[BLOB_SECTION_COUNT];
} header_t;

static const char blob_magic[8] = "LMscene";
enum { SECTION_ALIGN = 64, SECTION_PADDING = 16 };

static const struct {
    const char *name;
    uint32_t size;
} section_types[BLOB_SECTION_COUNT] = {
    [BLOB_SECTION_SCENE] = {"scene", sizeof(blob_scene_t)},
    [BLOB_SECTION_POSITIONS] = {"positions", sizeof(vec3_t)},
    [BLOB_SECTION_NORMALS] = {"normals", sizeof(vec3_t)},
    [BLOB_SECTION_UVS] = {"uvs", sizeof(vec2_t)},
    [BLOB_SECTION_TRIANGLES] = {"triangles", sizeof(blob_triangle_t)},
    [BLOB_SECTION_MESHES] = {"meshes", sizeof(blob_mesh_t)},
    [BLOB_SECTION_SPHERES] = {"spheres", sizeof(blob_sphere_t)},
    [BLOB_SECTION_SHAPES] = {"shapes", sizeof(blob_shape_t)},
    [BLOB_SECTION_OBJECTS] = {"objects", sizeof(blob_object_t)},
    [BLOB_SECTION_INSTANCES] = {"instances", sizeof(blob_instance_t)},
    [BLOB_SECTION_MATERIALS] = {"materials", sizeof(blob_material_t)},
    [BLOB_SECTION_LIGHTS] = {"lights", sizeof(blob_light_t)},
    [BLOB_SECTION_STRINGS] = {"strings", 1},
};

/* ---- checking ------------------------------------------------------------------------------------------ */

#define CHECK(condition, ...)                                                                                \
    do {                                                                                                     \
        if (!(condition)) return result_fail(RESULT_INPUT, "scene blob: " __VA_ARGS__);                      \
    } while (0)

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

static result_t check_checksum(const uint8_t *bytes, uint64_t size)
{
    const header_t *header = (const header_t *)bytes;
    hash_t checksum = hash_bytes(bytes + sizeof *header, size - sizeof *header);
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
                  section->count * section_types[i].size + SECTION_PADDING <= size - section->offset,
              "section '%s' lies outside the blob", section_types[i].name);
        end = section->offset + section->count * section_types[i].size + SECTION_PADDING;
    }
    return result_ok();
}

static bool xform_is_finite(const xform_t *t)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
            if (!isfinite(t->m[i][j])) return false;
    return true;
}

static bool rgb_is_valid(rgb_t c)
{
    return v_is_finite(c) && c.x >= 0 && c.y >= 0 && c.z >= 0;
}

static result_t check_scene(const scene_blob_t *blob)
{
    CHECK(blob->counts[BLOB_SECTION_SCENE] == 1, "must have one scene record, has %llu",
          (unsigned long long)blob->counts[BLOB_SECTION_SCENE]);
    const blob_scene_t *scene = blob->scene;
    xform_t inverse;
    CHECK(xform_is_finite(&scene->world_from_camera) && xform_invert(&scene->world_from_camera, &inverse),
          "the camera's transform is singular or not finite");
    CHECK(scene->fov > 0 && scene->fov < 180, "the camera's fov is %g degrees, must be between 0 and 180",
          (double)scene->fov);
    const float *w = scene->screen_window;
    bool automatic = w[0] == 0 && w[1] == 0 && w[2] == 0 && w[3] == 0;
    for (int i = 0; i < 4; i++) CHECK(isfinite(w[i]), "the camera's screen window is not finite");
    CHECK(automatic || (w[0] < w[1] && w[2] < w[3]), "the camera's screen window is empty");
    const blob_filter_t *filter = &scene->filter;
    CHECK(filter->kind >= FILTER_BOX && filter->kind <= FILTER_GAUSSIAN, "unknown pixel filter %u",
          filter->kind);
    CHECK(filter->radius_x > 0 && filter->radius_x <= 32 && filter->radius_y > 0 && filter->radius_y <= 32,
          "the pixel filter's radius must be over 0 and at most 32 pixels");
    CHECK(filter->kind != FILTER_GAUSSIAN || (filter->gaussian_sigma > 0 && isfinite(filter->gaussian_sigma)),
          "the gaussian filter's sigma must be positive");
    job_settings_t settings = blob_default_settings(blob);
    result_t checked = job_settings_check(&settings);
    CHECK(checked.code == RESULT_OK, "%s", checked.message);
    return result_ok();
}

static result_t check_vectors(const char *what, const vec3_t *v, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++)
        CHECK(v_is_finite(v[i]), "%s %llu is not finite", what, (unsigned long long)i);
    return result_ok();
}

/* True when [first, first + count) lies inside [0, total). */
static bool range_inside(uint32_t first, uint32_t count, uint64_t total)
{
    return (uint64_t)first + count <= total;
}

/* Meshes own their triangles: ranges follow one another, so that the checks are linear in the blob's size. */
static result_t check_meshes(const scene_blob_t *blob)
{
    uint64_t next_triangle = 0;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MESHES]; i++) {
        const blob_mesh_t *mesh = &blob->meshes[i];
        unsigned long long id = i;
        CHECK(range_inside(mesh->first_position, mesh->vertex_count, blob->counts[BLOB_SECTION_POSITIONS]),
              "mesh %llu: its vertices lie outside the positions", id);
        CHECK(mesh->first_normal == BLOB_NONE ||
                  range_inside(mesh->first_normal, mesh->vertex_count, blob->counts[BLOB_SECTION_NORMALS]),
              "mesh %llu: its normals lie outside the normals", id);
        CHECK(mesh->first_uv == BLOB_NONE ||
                  range_inside(mesh->first_uv, mesh->vertex_count, blob->counts[BLOB_SECTION_UVS]),
              "mesh %llu: its uvs lie outside the uvs", id);
        CHECK(mesh->triangle_count > 0 && mesh->first_triangle >= next_triangle &&
                  range_inside(mesh->first_triangle, mesh->triangle_count,
                               blob->counts[BLOB_SECTION_TRIANGLES]),
              "mesh %llu: its triangles lie outside the triangles, or are another mesh's", id);
        next_triangle = (uint64_t)mesh->first_triangle + mesh->triangle_count;
        const blob_triangle_t *triangle = blob->triangles + mesh->first_triangle;
        for (uint32_t t = 0; t < mesh->triangle_count; t++)
            for (int k = 0; k < 3; k++)
                CHECK(triangle[t].v[k] < mesh->vertex_count, "mesh %llu: triangle %u uses vertex %u of %u",
                      id, t, triangle[t].v[k], mesh->vertex_count);
    }
    return result_ok();
}

static result_t check_spheres(const scene_blob_t *blob)
{
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_SPHERES]; i++) {
        const blob_sphere_t *sphere = &blob->spheres[i];
        xform_t inverse;
        CHECK(sphere->radius > 0 && isfinite(sphere->radius), "sphere %llu: its radius must be positive",
              (unsigned long long)i);
        CHECK(xform_is_finite(&sphere->object_from_sphere) &&
                  xform_invert(&sphere->object_from_sphere, &inverse),
              "sphere %llu: its transform is singular or not finite", (unsigned long long)i);
    }
    return result_ok();
}

static result_t check_shapes(const scene_blob_t *blob)
{
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_SHAPES]; i++) {
        const blob_shape_t *shape = &blob->shapes[i];
        unsigned long long id = i;
        CHECK(shape->kind == SHAPE_MESH || shape->kind == SHAPE_SPHERE, "shape %llu: unknown kind %u", id,
              shape->kind);
        blob_section_t section = shape->kind == SHAPE_MESH ? BLOB_SECTION_MESHES : BLOB_SECTION_SPHERES;
        CHECK(shape->geometry < blob->counts[section], "shape %llu: no geometry %u", id, shape->geometry);
        CHECK(shape->material < blob->counts[BLOB_SECTION_MATERIALS], "shape %llu: no material %u", id,
              shape->material);
        CHECK(shape->light == BLOB_NONE || (shape->light < blob->counts[BLOB_SECTION_LIGHTS] &&
                                            blob->lights[shape->light].shape == id),
              "shape %llu: light %u does not belong to it", id, shape->light);
        CHECK(shape->name < blob->counts[BLOB_SECTION_STRINGS],
              "shape %llu: its name lies outside the strings", id);
    }
    return result_ok();
}

static result_t check_objects(const scene_blob_t *blob)
{
    uint64_t next = 0, shapes = blob->counts[BLOB_SECTION_SHAPES];
    CHECK(blob->counts[BLOB_SECTION_OBJECTS] > 0, "has no world object");
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_OBJECTS]; i++) {
        const blob_object_t *object = &blob->objects[i];
        CHECK(range_inside(object->first_shape, object->shape_count, shapes),
              "object %llu: its shapes lie outside the shapes", (unsigned long long)i);
        next += object->shape_count;
    }
    CHECK(next == shapes, "objects hold %llu shapes of %llu", (unsigned long long)next,
          (unsigned long long)shapes);
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_INSTANCES]; i++) {
        const blob_instance_t *instance = &blob->instances[i];
        xform_t inverse;
        CHECK(instance->object > 0 && instance->object < blob->counts[BLOB_SECTION_OBJECTS],
              "instance %llu: no object %u", (unsigned long long)i, instance->object);
        CHECK(xform_is_finite(&instance->world_from_object) &&
                  xform_invert(&instance->world_from_object, &inverse),
              "instance %llu: its transform is singular or not finite", (unsigned long long)i);
    }
    return result_ok();
}

static result_t check_materials(const scene_blob_t *blob)
{
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_MATERIALS]; i++) {
        const blob_material_t *material = &blob->materials[i];
        unsigned long long id = i;
        CHECK(material->kind >= MATERIAL_DIFFUSE && material->kind <= MATERIAL_CONDUCTOR,
              "material %llu: unknown kind %u", id, material->kind);
        CHECK(material->name < blob->counts[BLOB_SECTION_STRINGS],
              "material %llu: its name lies outside the strings", id);
        CHECK(rgb_is_valid(material->reflectance) && rgb_is_valid(material->transmittance) &&
                  rgb_is_valid(material->eta) && rgb_is_valid(material->k),
              "material %llu: its colours must be finite and not negative", id);
        CHECK(material->kind != MATERIAL_DIELECTRIC || material->eta.x > 0,
              "material %llu: eta must be positive", id);
        CHECK(material->alpha_u >= 0 && material->alpha_u <= 10 && material->alpha_v >= 0 &&
                  material->alpha_v <= 10,
              "material %llu: its roughness must be from 0 to 10", id);
    }
    return result_ok();
}

static result_t check_lights(const scene_blob_t *blob)
{
    const blob_object_t *world = &blob->objects[0];
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++) {
        const blob_light_t *light = &blob->lights[i];
        CHECK(light->shape < blob->counts[BLOB_SECTION_SHAPES] && blob->shapes[light->shape].light == i &&
                  light->shape >= world->first_shape &&
                  light->shape - world->first_shape < world->shape_count,
              "light %llu does not belong to a shape of the world", (unsigned long long)i);
        CHECK(rgb_is_valid(light->radiance), "light %llu: its radiance must be finite and not negative",
              (unsigned long long)i);
    }
    return result_ok();
}

static result_t check_contents(const scene_blob_t *blob)
{
    uint64_t strings = blob->counts[BLOB_SECTION_STRINGS];
    CHECK(strings > 0 && blob->strings[0] == 0 && blob->strings[strings - 1] == 0,
          "its strings are not terminated");
    TRY(check_scene(blob));
    TRY(check_vectors("position", blob->positions, blob->counts[BLOB_SECTION_POSITIONS]));
    TRY(check_vectors("normal", blob->normals, blob->counts[BLOB_SECTION_NORMALS]));
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_UVS]; i++)
        CHECK(isfinite(blob->uvs[i].x) && isfinite(blob->uvs[i].y), "uv %llu is not finite",
              (unsigned long long)i);
    TRY(check_meshes(blob));
    TRY(check_spheres(blob));
    TRY(check_shapes(blob));
    TRY(check_objects(blob));
    TRY(check_materials(blob));
    return check_lights(blob);
}

/* ---- opening ------------------------------------------------------------------------------------------- */

/* Checks all but the checksum, and makes the view, without its hash. */
static result_t make_view(const void *bytes, uint64_t size, scene_blob_t *blob)
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
    view.triangles = at[BLOB_SECTION_TRIANGLES];
    view.meshes = at[BLOB_SECTION_MESHES];
    view.spheres = at[BLOB_SECTION_SPHERES];
    view.shapes = at[BLOB_SECTION_SHAPES];
    view.objects = at[BLOB_SECTION_OBJECTS];
    view.instances = at[BLOB_SECTION_INSTANCES];
    view.materials = at[BLOB_SECTION_MATERIALS];
    view.lights = at[BLOB_SECTION_LIGHTS];
    view.strings = at[BLOB_SECTION_STRINGS];
    TRY(check_contents(&view));
    *blob = view;
    return result_ok();
}

result_t blob_open(const void *bytes, uint64_t size, scene_blob_t *blob)
{
    *blob = (scene_blob_t){0};
    scene_blob_t view;
    TRY(check_header(bytes, size));
    TRY(check_checksum(bytes, size));
    TRY(make_view(bytes, size, &view));
    view.hash = hash_bytes(bytes, size);
    *blob = view;
    return result_ok();
}

result_t blob_open_file(const char *path, scene_blob_t *blob)
{
    *blob = (scene_blob_t){0};
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0) return result_fail(RESULT_INPUT, "%s: cannot be opened: %s", path, strerror(errno));
    struct stat about;
    void *bytes = MAP_FAILED;
    if (fstat(file, &about) == 0 && about.st_size > 0)
        bytes = mmap(NULL, (size_t)about.st_size, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (bytes == MAP_FAILED) return result_fail(RESULT_INPUT, "%s: cannot be mapped (is it empty?)", path);
    result_t result = blob_open(bytes, (uint64_t)about.st_size, blob);
    if (result.code == RESULT_OK) {
        blob->mapped = true;
        return result;
    }
    munmap(bytes, (size_t)about.st_size);
    return result_fail(result.code, "%s: %s", path, result.message);
}

void blob_close(scene_blob_t *blob)
{
    if (blob->mapped) munmap((void *)blob->bytes, blob->size);
    *blob = (scene_blob_t){0};
}

/* ---- building ------------------------------------------------------------------------------------------ */

struct blob_builder {
    struct {
        uint8_t *bytes;
        uint64_t count, capacity; /* records */
    } sections[BLOB_SECTION_COUNT];
    bool full; /* a section would have passed 2^32 - 2 records */
};

blob_builder_t *blob_builder_new(void)
{
    blob_builder_t *builder = mem_zalloc(1, sizeof *builder);
    blob_builder_add(builder, BLOB_SECTION_STRINGS, "", 1);
    return builder;
}

void blob_builder_destroy(blob_builder_t **builder)
{
    if (*builder == NULL) return;
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) free((*builder)->sections[i].bytes);
    free(*builder);
    *builder = NULL;
}

uint32_t blob_builder_add(blob_builder_t *builder, blob_section_t section, const void *records,
                          uint32_t count)
{
    uint64_t size = section_types[section].size, first = builder->sections[section].count;
    if (first + count >= BLOB_NONE) {
        builder->full = true;
        return 0;
    }
    if (first + count > builder->sections[section].capacity) {
        uint64_t capacity = 2 * first + count;
        builder->sections[section].bytes = mem_realloc(builder->sections[section].bytes, capacity * size);
        builder->sections[section].capacity = capacity;
    }
    uint8_t *to = builder->sections[section].bytes + first * size;
    if (records != NULL && count > 0)
        memcpy(to, records, count * size);
    else if (count > 0)
        memset(to, 0, count * size);
    builder->sections[section].count = first + count;
    return (uint32_t)first;
}

void *blob_builder_records(blob_builder_t *builder, blob_section_t section)
{
    return builder->sections[section].bytes;
}

uint32_t blob_builder_count(const blob_builder_t *builder, blob_section_t section)
{
    return (uint32_t)builder->sections[section].count;
}

uint32_t blob_builder_string(blob_builder_t *builder, const char *text)
{
    return *text == 0 ? 0 : blob_builder_add(builder, BLOB_SECTION_STRINGS, text, (uint32_t)strlen(text) + 1);
}

static uint64_t align_up(uint64_t offset)
{
    return (offset + SECTION_ALIGN - 1) / SECTION_ALIGN * SECTION_ALIGN;
}

/* Copies a section to its place in the blob and frees it, so that no large scene is in memory twice. */
static void move_section(blob_builder_t *builder, blob_section_t section, uint8_t *blob,
                         const header_t *header)
{
    const section_t *to = &header->sections[section];
    if (to->count > 0)
        memcpy(blob + to->offset, builder->sections[section].bytes, to->count * section_types[section].size);
    free(builder->sections[section].bytes);
    builder->sections[section].bytes = NULL;
    builder->sections[section].count = builder->sections[section].capacity = 0;
}

result_t blob_builder_finish(blob_builder_t *builder, uint8_t **bytes, uint64_t *size)
{
    *bytes = NULL;
    *size = 0;
    if (builder->full)
        return result_fail(RESULT_LIMIT, "the scene has more than %u records of one kind", BLOB_NONE - 1);
    header_t header = {.version = BLOB_VERSION, .section_count = BLOB_SECTION_COUNT};
    memcpy(header.magic, blob_magic, sizeof header.magic);
    uint64_t end = align_up(sizeof header);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) {
        header.sections[i] = (section_t){.offset = end, .count = builder->sections[i].count};
        end = align_up(end + builder->sections[i].count * section_types[i].size + SECTION_PADDING);
    }
    header.size = end;
    if (end > BLOB_MAX_BYTES)
        return result_fail(RESULT_LIMIT, "the scene takes %llu bytes, over the limit of %llu",
                           (unsigned long long)end, (unsigned long long)BLOB_MAX_BYTES);
    uint8_t *blob = mem_zalloc(1, end);
    for (int i = 0; i < BLOB_SECTION_COUNT; i++) move_section(builder, (blob_section_t)i, blob, &header);
    header.checksum = hash_bytes(blob + sizeof header, end - sizeof header);
    memcpy(blob, &header, sizeof header);

    scene_blob_t view;
    result_t result = make_view(blob, end, &view);
    if (result.code != RESULT_OK) {
        free(blob);
        return result;
    }
    *bytes = blob;
    *size = end;
    return result_ok();
}

/* ---- what a job starts from ---------------------------------------------------------------------------- */

int blob_film_scale(const scene_blob_t *blob)
{
    float brightest = 0;
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++)
        brightest = float_max(brightest, v_max(blob->lights[i].radiance));
    int excess = brightest > 0 ? ilogbf(brightest) - 9 : 0;
    return int_max(FILM_MIN_SCALE, FILM_DEFAULT_SCALE - int_max(0, excess));
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
