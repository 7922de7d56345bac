/* scene_blob: a whole scene as one flat, relocatable, versioned, checksummed run of bytes.
 *
 * The client writes a blob once (blob_builder.h); masters store it and workers map it read-only under the
 * name of its hash. A blob is a header, a table of sections and the sections: plain arrays of the records
 * of blob_format.h, little-endian, 64-byte aligned. Records refer to one another by array index, never by
 * address; BLOB_NONE says "no such thing". Vertex and index arrays have the layout that Embree shares without
 * a copy; 16 bytes of padding follow every section, since Embree may read that far past the last vertex.
 *
 * blob_open trusts nothing: sizes, the checksum, every index and every float that could take the renderer out
 * of bounds are checked before the view is handed out.
 */
#ifndef LIGHTMILL_SCENE_BLOB_H
#define LIGHTMILL_SCENE_BLOB_H

#include "common/job.h"
#include "common/scene/blob_format.h"

/* A checked view of a blob in memory. */
typedef struct {
    const uint8_t *bytes;
    uint64_t size;
    hash_t hash; /* of all bytes: the blob's name */
    bool mapped; /* bytes are mapped by blob_open_file and unmapped by blob_close */
    const blob_scene_t *scene;
    const vec3_t *positions;
    const vec3_t *normals;
    const vec2_t *uvs;
    const blob_colour_t *colours;
    const blob_triangle_t *triangles;
    const blob_mesh_t *meshes;
    const blob_quadric_t *quadrics;
    const blob_curve_point_t *curve_points;
    const blob_curves_t *curves;
    const blob_shape_t *shapes;
    const blob_object_t *objects;
    const blob_instance_t *instances;
    const blob_texture_t *textures;
    const blob_image_t *images;
    const uint32_t *texels;
    const blob_material_t *materials;
    const blob_medium_t *media;
    const blob_field_t *fields;
    const uint32_t *bricks;
    const blob_light_t *lights;
    const blob_lens_element_t *lens;
    const blob_pupil_t *pupils;
    const blob_fourier_t *fouriers;
    const blob_series_t *series;
    const blob_measured_t *measurements;
    const float *numbers;
    const blob_spectrum_t *spectra;
    const char *strings;
    uint64_t counts[BLOB_SECTION_COUNT]; /* records in each section */
} scene_blob_t;

/* Checks `size` bytes at `bytes` (8-byte aligned, kept by the caller while the view is used) and makes the
 * view. RESULT_INPUT with the reason when anything is wrong. */
result_t blob_open(const void *bytes, uint64_t size, scene_blob_t *blob);
/* False when a segment of a curve has a size, but less than 1e-30: Embree's arithmetic overflows there. */
bool blob_segment_is_traceable(const blob_curve_point_t points[4]);
/* False when an instance that moves from `start` to `end` (each world from object) may on its way be too
 * flat, small or large for Embree, which inverts its transform in single precision: each axis of the object
 * must be 1e-10 to 1e10 long in the world, and they must span 1e-5 of the volume that they would at right
 * angles. */
bool blob_instance_is_traceable(const xform_t *start, const xform_t *end);
/* Maps a file read-only and checks it. RESULT_IO when the system, not the file, is to blame. */
result_t blob_open_file(const char *path, scene_blob_t *blob);
/* The same for an open file, which has no name or is not to be found by it; `name` is for messages. The file
 * stays the caller's to close. */
result_t blob_open_descriptor(int file, const char *name, scene_blob_t *blob);
/* Maps a file that was checked before, and looks only at what tells where its sections lie: quick, whatever
 * its size. Its view is for blob_default_settings, blob_film_scale and blob_grouped_lights alone. */
result_t blob_peek_file(const char *path, scene_blob_t *blob);
/* Unmaps what these two mapped; harmless on a zeroed or an already closed view. */
void blob_close(scene_blob_t *blob);
/* True when the bytes begin like a blob, whatever follows. */
bool blob_recognise(const void *bytes, uint64_t size);

/* Positions of a mesh, at all its times. */
static inline uint64_t blob_mesh_places(const blob_mesh_t *mesh)
{
    return (uint64_t)mesh->vertex_count * (mesh->steps ? mesh->steps : 1);
}

/* A value that does not vary. */
static inline blob_value_t blob_constant(float number)
{
    return (blob_value_t){.factor = {number, number, number}};
}
static inline blob_value_t blob_colour_value(rgb_t colour)
{
    return (blob_value_t){.factor = colour};
}

/* The lights in the order of their numbers, as light_groups.h takes them, in fresh memory; their places are
 * the blob's. */
grouped_light_t *blob_grouped_lights(const scene_blob_t *blob);

/* A scene record to start from: a pinhole camera of 90 degrees at the origin, nothing moving, a film of 640 x
 * 480 pixels as its own filter, bdpt, sobol, depth 5, 16 spp. */
blob_scene_t blob_default_scene(void);

/* The scale that a film of this scene needs so that its sums cannot overflow in practice: FILM_DEFAULT_SCALE,
 * or less by one for each doubling of the brightest light over 2^10. */
int blob_film_scale(const scene_blob_t *blob);

/* RESULT_USAGE when the scene cannot be rendered so: light tracing sees nothing through a lens of elements.
 */
result_t blob_check_settings(const scene_blob_t *blob, const job_settings_t *settings);
/* Settings that the scene itself asks for, the rest at their defaults. */
job_settings_t blob_default_settings(const scene_blob_t *blob);

#endif
