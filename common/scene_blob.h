/* scene_blob: a whole scene as one flat, relocatable, versioned, checksummed run of bytes.
 *
 * The client writes a blob once (blob_builder_*); masters store it and workers map it read-only under the
 * name of its hash. A blob is a header, a table of sections and the sections: plain arrays of the records
 * below, little-endian, 64-byte aligned. Records refer to one another by array index, never by address;
 * BLOB_NONE says "no such thing". Vertex and index arrays have the layout that Embree shares without a copy;
 * 16 bytes of padding follow every section, since Embree may read that far past the last vertex.
 *
 * blob_open trusts nothing: sizes, the checksum, every index and every float that could take the renderer out
 * of bounds are checked before the view is handed out. A record with a new meaning takes a new BLOB_VERSION.
 */
#ifndef LIGHTMILL_SCENE_BLOB_H
#define LIGHTMILL_SCENE_BLOB_H

#include "common/job.h"
#include "common/vec.h"

enum { BLOB_VERSION = 1 };
#define BLOB_NONE 0xFFFFFFFFu
#define BLOB_MAX_BYTES ((uint64_t)1 << 36)

typedef enum {
    BLOB_SECTION_SCENE,     /* blob_scene_t, exactly one */
    BLOB_SECTION_POSITIONS, /* vec3_t, object space of the shape's object */
    BLOB_SECTION_NORMALS,   /* vec3_t, unit length, same space */
    BLOB_SECTION_UVS,       /* vec2_t */
    BLOB_SECTION_TRIANGLES, /* blob_triangle_t */
    BLOB_SECTION_MESHES,    /* blob_mesh_t */
    BLOB_SECTION_SPHERES,   /* blob_sphere_t */
    BLOB_SECTION_SHAPES,    /* blob_shape_t, grouped by object */
    BLOB_SECTION_OBJECTS,   /* blob_object_t; object 0 is the world */
    BLOB_SECTION_INSTANCES, /* blob_instance_t, all in the world */
    BLOB_SECTION_MATERIALS, /* blob_material_t */
    BLOB_SECTION_LIGHTS,    /* blob_light_t */
    BLOB_SECTION_STRINGS,   /* char, NUL-terminated names; offset 0 is the empty string */
    BLOB_SECTION_COUNT
} blob_section_t;

typedef enum { FILTER_BOX = 1, FILTER_TRIANGLE = 2, FILTER_GAUSSIAN = 3 } filter_kind_t;

typedef struct {
    uint32_t kind;  /* filter_kind_t */
    float radius_x; /* pixels; 0.5 for a box that is the pixel itself */
    float radius_y;
    float gaussian_sigma; /* pixels; only for FILTER_GAUSSIAN */
} blob_filter_t;

/* Camera, filter and what the scene file asks for; the job's settings start from these. */
typedef struct {
    xform_t world_from_camera; /* camera space: x right, y up, looks down +z, as in pbrt */
    float fov;                 /* degrees, along the shorter side of the screen window */
    float screen_window[4];    /* x min, x max, y min, y max in units of the window with half-height 1; all 0:
                                  made from the resolution, the shorter side spanning [-1, 1] */
    blob_filter_t filter;
    int32_t width, height; /* pixels asked for */
    int32_t max_depth;
    uint32_t spp;
    uint32_t integrator; /* integrator_t */
    uint32_t sampler;    /* sampler_kind_t */
} blob_scene_t;

typedef struct {
    uint32_t v[3]; /* relative to the mesh's first vertex */
} blob_triangle_t;

typedef struct {
    uint32_t first_position, vertex_count;
    uint32_t first_normal;                   /* BLOB_NONE: flat; else vertex_count normals from here */
    uint32_t first_uv;                       /* BLOB_NONE: none; else vertex_count uvs from here */
    uint32_t first_triangle, triangle_count; /* > 0; behind those of the mesh before */
} blob_mesh_t;

/* A full sphere about the origin of its own space. */
typedef struct {
    xform_t object_from_sphere;
    float radius;
} blob_sphere_t;

typedef enum { SHAPE_MESH = 1, SHAPE_SPHERE = 2 } shape_kind_t;

/* Geometric normals: of a triangle, (p1 - p0) x (p2 - p0), or, where the mesh has vertex normals, whichever
 * of the two signs agrees with them; of a sphere, outward. SHAPE_FLIP reverses those that do not come from
 * vertex normals (of a mesh: pbrt's ReverseOrientation exclusive-or a mirroring transform; of a sphere:
 * ReverseOrientation alone). */
enum { SHAPE_FLIP = 1 };

typedef struct {
    uint32_t kind;     /* shape_kind_t */
    uint32_t geometry; /* index of a mesh or a sphere */
    uint32_t material; /* index of a material */
    uint32_t light;    /* index of the area light that this shape emits, or BLOB_NONE */
    uint32_t flags;
    uint32_t name; /* offset in the strings: where the shape comes from, "file:line" */
} blob_shape_t;

typedef struct {
    uint32_t first_shape, shape_count;
} blob_object_t;

typedef struct {
    uint32_t object; /* not 0; shapes in it do not emit */
    xform_t world_from_object;
} blob_instance_t;

typedef enum {
    MATERIAL_DIFFUSE = 1,    /* reflectance */
    MATERIAL_MIRROR = 2,     /* reflectance */
    MATERIAL_DIELECTRIC = 3, /* reflectance, transmittance (factors on the Fresnel terms), eta.x; smooth */
    MATERIAL_CONDUCTOR = 4   /* eta, k, alpha (Trowbridge-Reitz); alpha 0 in both axes is smooth */
} material_kind_t;

typedef struct {
    uint32_t kind; /* material_kind_t */
    uint32_t name; /* offset in the strings */
    rgb_t reflectance;
    rgb_t transmittance;
    rgb_t eta; /* index of refraction, relative to the outside */
    rgb_t k;   /* absorption of a conductor */
    float alpha_u, alpha_v;
} blob_material_t;

enum { LIGHT_TWO_SIDED = 1 };

/* A diffuse area light; each belongs to exactly one shape of the world. */
typedef struct {
    rgb_t radiance;
    uint32_t shape;
    uint32_t flags;
} blob_light_t;

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
    const blob_triangle_t *triangles;
    const blob_mesh_t *meshes;
    const blob_sphere_t *spheres;
    const blob_shape_t *shapes;
    const blob_object_t *objects;
    const blob_instance_t *instances;
    const blob_material_t *materials;
    const blob_light_t *lights;
    const char *strings;
    uint64_t counts[BLOB_SECTION_COUNT]; /* records in each section */
} scene_blob_t;

/* Checks `size` bytes at `bytes` (8-byte aligned, kept by the caller while the view is used) and makes the
 * view. RESULT_INPUT with the reason when anything is wrong. */
result_t blob_open(const void *bytes, uint64_t size, scene_blob_t *blob);
/* Maps a file read-only and checks it. */
result_t blob_open_file(const char *path, scene_blob_t *blob);
/* Unmaps what blob_open_file mapped; harmless on a zeroed or an already closed view. */
void blob_close(scene_blob_t *blob);
/* True when the bytes begin like a blob, whatever follows. */
bool blob_recognise(const void *bytes, uint64_t size);

/* Gathers a scene section by section. */
typedef struct blob_builder blob_builder_t;

blob_builder_t *blob_builder_new(void);
/* Frees the builder and sets *builder to NULL. */
void blob_builder_destroy(blob_builder_t **builder);
/* Appends `count` records to a section and returns the index of the first; `records` may be NULL for zeroes.
 * Records are sizeof(the section's type) each. Sections hold less than 2^32 - 1 records. */
uint32_t blob_builder_add(blob_builder_t *builder, blob_section_t section, const void *records,
                          uint32_t count);
/* The records gathered so far, valid until the next add; writable, so that references can be filled in late.
 */
void *blob_builder_records(blob_builder_t *builder, blob_section_t section);
uint32_t blob_builder_count(const blob_builder_t *builder, blob_section_t section);
/* Adds a name to the strings and returns its offset. */
uint32_t blob_builder_string(blob_builder_t *builder, const char *text);
/* Lays the blob out in fresh memory (the caller frees *bytes), and checks it as blob_open does. The builder
 * is left without records, good only for blob_builder_destroy, unless the scene was too large. */
result_t blob_builder_finish(blob_builder_t *builder, uint8_t **bytes, uint64_t *size);

/* The scale that a film of this scene needs so that its sums cannot overflow in practice: FILM_DEFAULT_SCALE,
 * or less by one for each doubling of the brightest light over 2^10. */
int blob_film_scale(const scene_blob_t *blob);

/* Settings that the scene itself asks for, the rest at their defaults. */
job_settings_t blob_default_settings(const scene_blob_t *blob);

#endif
