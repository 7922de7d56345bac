/* scene: its tables, its life, and what is known of it as a whole (see scene.h).
 *
 * The device is pinned to one instruction set and builds on the calling thread alone: which of two triangles
 * at exactly the same distance is hit depends on the tree, so the tree must not depend on the machine.
 */
#include "worker/render/scene/scene_internal.h"

#include <stdlib.h>

#define EMBREE_CONFIG "isa=avx2,threads=1,start_threads=0,set_affinity=0"

static bool has_textures(const blob_material_t *m)
{
    for (int i = 0; i < MATERIAL_VALUES; i++)
        if (m->values[i].texture != 0) return true;
    return false;
}

/* Materials that look at more than the frame. */
static bool material_varies(const bool *before, const blob_material_t *m)
{
    if (m->kind == MATERIAL_MIX && (before[m->parts[0]] || before[m->parts[1]])) return true;
    bool varies = m->normal_map != 0 || m->coat_normal_map != 0 || m->bump != 0 ||
                  m->kind == MATERIAL_DISNEY || m->kind == MATERIAL_MEASURED || m->kind == MATERIAL_HAIR ||
                  has_textures(m);
    return varies || m->values[VALUE_ROUGHNESS_U].factor.x != m->values[VALUE_ROUGHNESS_V].factor.x ||
           m->values[VALUE_BASE_ROUGHNESS_U].factor.x != m->values[VALUE_BASE_ROUGHNESS_V].factor.x ||
           m->values[VALUE_ANISOTROPIC].factor.x != 0;
}

static void prepare_tables(scene_t *scene)
{
    const scene_blob_t *blob = scene->blob;
    const uint64_t *counts = blob->counts;
    scene->textures = textures_new(blob);
    scene->varies = mem_zalloc(counts[BLOB_SECTION_MATERIALS] + 1, sizeof *scene->varies);
    scene->textured = mem_zalloc(counts[BLOB_SECTION_MATERIALS] + 1, sizeof *scene->textured);
    for (uint64_t i = 0; i < counts[BLOB_SECTION_MATERIALS]; i++) {
        scene->varies[i] = material_varies(scene->varies, &blob->materials[i]);
        scene->textured[i] = has_textures(&blob->materials[i]);
    }
    scene->objects = mem_zalloc(counts[BLOB_SECTION_OBJECTS], sizeof *scene->objects);
    scene->geometries = mem_zalloc(counts[BLOB_SECTION_SHAPES] + 1, sizeof *scene->geometries);
    scene->quadrics = mem_zalloc(counts[BLOB_SECTION_QUADRICS] + 1, sizeof *scene->quadrics);
    for (uint64_t i = 0; i < counts[BLOB_SECTION_QUADRICS]; i++)
        quadric_init(&scene->quadrics[i], &blob->quadrics[i]);
    scene->instances = mem_zalloc(counts[BLOB_SECTION_INSTANCES] + 1, sizeof *scene->instances);
    uint32_t segments = 0;
    for (uint64_t i = 0; i < counts[BLOB_SECTION_CURVES]; i++)
        if (blob->curves[i].segment_count > segments) segments = blob->curves[i].segment_count;
    /* One more: Embree may read 16 bytes from the last index on. */
    scene->curve_indices = mem_zalloc((size_t)segments + 4, sizeof *scene->curve_indices);
    for (uint32_t i = 0; i < segments; i++) scene->curve_indices[i] = 4 * i;
}

result_t scene_new(const scene_blob_t *blob, scene_t **result)
{
    *result = NULL;
    RTCDevice device = rtcNewDevice(EMBREE_CONFIG);
    if (device == NULL)
        return result_fail(RESULT_LIMIT, "Embree cannot start (error %d); this needs an x86-64-v3 processor",
                           (int)rtcGetDeviceError(NULL));
    scene_t *scene = mem_zalloc(1, sizeof *scene);
    scene->blob = blob;
    scene->device = device;
    scene->reach = EMBREE_LARGEST;
    prepare_tables(scene);
    scene_build(scene);
    enum RTCError error = rtcGetDeviceError(scene->device);
    if (error != RTC_ERROR_NONE) {
        scene_destroy(&scene);
        return result_fail(RESULT_LIMIT, "Embree could not build the scene (error %d)%s", (int)error,
                           error == RTC_ERROR_OUT_OF_MEMORY ? ": out of memory" : "");
    }
    *result = scene;
    return result_ok();
}

void scene_destroy(scene_t **scene)
{
    scene_t *self = *scene;
    if (self == NULL) return;
    for (uint64_t k = 0; k < self->blob->counts[BLOB_SECTION_OBJECTS]; k++) rtcReleaseScene(self->objects[k]);
    if (self->borders != NULL) rtcReleaseScene(self->borders);
    rtcReleaseDevice(self->device);
    textures_destroy(&self->textures);
    free(self->varies);
    free(self->textured);
    free(self->objects);
    free(self->geometries);
    free(self->quadrics);
    free(self->instances);
    free(self->curve_indices);
    free(self);
    *scene = NULL;
}

const scene_blob_t *scene_blob(const scene_t *scene)
{
    return scene->blob;
}

const textures_t *scene_textures(const scene_t *scene)
{
    return scene->textures;
}

const quadric_t *scene_quadric(const scene_t *scene, const blob_shape_t *shape)
{
    return &scene->quadrics[shape->geometry];
}

bool scene_material_varies(const scene_t *scene, const blob_material_t *material)
{
    return scene->varies[material - scene->blob->materials];
}

bool scene_material_is_textured(const scene_t *scene, const blob_material_t *material)
{
    return scene->textured[material - scene->blob->materials];
}

bool scene_moves(const scene_t *scene)
{
    return scene->moves;
}

vec3_t scene_half_sides(const scene_t *scene)
{
    struct RTCBounds b;
    rtcGetSceneBounds(scene->world, &b);
    if (!(b.lower_x <= b.upper_x)) return vec3(0, 0, 0);
    return v_scale(vec3(b.upper_x - b.lower_x, b.upper_y - b.lower_y, b.upper_z - b.lower_z), 0.5f);
}

void scene_bounds(const scene_t *scene, vec3_t *centre, float *radius)
{
    struct RTCBounds b;
    rtcGetSceneBounds(scene->world, &b);
    *centre = vec3(0, 0, 0);
    *radius = v_length(scene_half_sides(scene)) * 1.0001f;
    if (!(b.lower_x <= b.upper_x)) return;
    vec3_t low = vec3(b.lower_x, b.lower_y, b.lower_z), high = vec3(b.upper_x, b.upper_y, b.upper_z);
    *centre = v_scale(v_add(low, high), 0.5f);
}
