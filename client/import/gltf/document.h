/* document: everything that is known while a glTF file becomes a blob, and what the parts of the importer
 * ask of one another.
 *
 * The order of work: file.c opens the file; node.c walks the scene and gathers where meshes, cameras and
 * lights stand, at several times while a shutter is open; then each mesh is put into the world, or, when it
 * stands in several places, into an object with instances; materials and textures are made when a mesh first
 * has them. Work is bounded by what the file holds: see scene_charge.
 */
#ifndef LIGHTMILL_DOCUMENT_H
#define LIGHTMILL_DOCUMENT_H

#include "client/import/gltf/item.h"
#include "client/import/packed/draco.h"
#include "client/import/scene/mesh.h"
#include "client/import/scene/scene_images.h"

/* The arrays at the root of the file that others refer to by index. */
typedef enum {
    TOP_ACCESSORS,
    TOP_ANIMATIONS,
    TOP_BUFFER_VIEWS,
    TOP_BUFFERS,
    TOP_CAMERAS,
    TOP_IMAGES,
    TOP_MATERIALS,
    TOP_MESHES,
    TOP_NODES,
    TOP_SAMPLERS,
    TOP_SCENES,
    TOP_SKINS,
    TOP_TEXTURES,
    TOP_COUNT
} top_t;

typedef struct {
    const uint8_t *data;
    size_t size;
} bytes_t;

/* A file beside the glTF file, or the bytes of a data URI. Owned: path, data. */
typedef struct {
    char *path; /* NULL: a data URI */
    uint8_t *data;
    size_t size;
} gltf_source_t;

/* What a glTF material becomes, for meshes with and without colours at their vertices. */
typedef struct {
    bool made;
    uint32_t index;        /* in the blob */
    blob_value_t alpha;    /* of the shapes that have it; factor 0: invisible */
    bool cutout;           /* alpha is 0 or 1 */
    bool emits, two_sided; /* two_sided: emission leaves the back as well */
    bool unlit;            /* emits to the camera alone */
    bool needs_tangents;   /* has normal maps or anisotropy */
    bool has_images;       /* in any of its textures */
    bool swaps_sets;       /* its textures take a mesh's first texture coordinates for the second, and back */
    blob_value_t emission; /* radiance */
} gltf_material_t;

/* One place where a mesh, a camera or a light stands. */
typedef struct {
    uint32_t node, thing; /* thing: index of the mesh, the camera or the light */
    affine_t world_from_node;
    uint32_t skin; /* of a mesh; ITEM_NONE: none */
    bool posed;    /* a mesh whose vertices are elsewhere than at other places: by a skin, or by weights */
} gltf_placement_t;

/* A skin as its joints stand. Owned: joints. */
typedef struct {
    affine_t *joints; /* world from mesh; NULL: not made yet */
    size_t count;
} gltf_skin_t;

/* What puts the vertices of a mesh elsewhere than its arrays say. Owned: weights. */
typedef struct {
    double *weights;         /* of the morph targets, finite */
    size_t count;            /* targets behind these weigh 0 */
    const gltf_skin_t *skin; /* or NULL */
} deform_t;

typedef struct {
    gltf_placement_t *items;
    size_t count, capacity;
} placements_t;

/* Everything at one time. Owned: all. */
typedef struct {
    double time;                          /* of the animations, seconds */
    placements_t meshes, cameras, lights; /* the same things in the same order in all poses */
    uint8_t *visits;                      /* of each node: what node.c did with it */
    affine_t *worlds;                     /* world from node, of those that were visited */
    gltf_skin_t *skins;
} pose_t;
enum { MOST_POSES = 5 };

/* For each vertex of an accessor, its new number in the mesh that is being read. */
typedef struct {
    uint32_t stamp, number;
} mark_t;

typedef struct document {
    const char *path;
    char *folder; /* of the file, with a '/' at its end, or empty */
    scene_builder_t *builder;
    char *place; /* see document_at */

    uint8_t *data; /* the file */
    size_t size;
    bytes_t binary; /* the BIN chunk of a .glb; data NULL: none */
    json_t *json;
    item_t root, tops[TOP_COUNT];
    bool needs_meshopt;       /* KHR_meshopt_compression: there are no buffers that are not packed */
    bool blender;             /* written by Blender's exporter ... */
    unsigned blender_version; /* ... of this version, 304 for 3.4; a large number when it does not say */
    bool told_of_sides;       /* the warning about emission of doubleSided materials */

    bytes_t *buffers;  /* as many as there are; data NULL: not read yet */
    bytes_t *unpacked; /* buffer views, as many as there are; data NULL: not packed, or not unpacked yet */
    gltf_source_t *sources;
    size_t source_count, source_capacity;

    gltf_material_t *materials[2]; /* without and with colours at the vertices; the last is glTF's default */

    pose_t poses[MOST_POSES];    /* at even distances from the opening of the shutter to its close */
    size_t pose_count;           /* 1 without a shutter */
    pose_t *pose;                /* the one that is looked at: first and last the middle one */
    bool joints_only;            /* the nodes that are visited now are not in the scene, but may be joints */
    bool hidden;                 /* what the nodes that are visited now hold (KHR_node_visibility) */
    struct animation *animation; /* NULL: nothing moves */

    uint32_t variant; /* of KHR_materials_variants, the one that is asked for; ITEM_NONE: none */

    mark_t *marks;
    size_t mark_capacity;
    uint32_t stamp;
} document_t;

/* ---- file.c -------------------------------------------------------------------------------------------- */

/* Reads the file, parses its JSON, and checks what it requires. document_close frees everything, also after
 * an error. */
result_t document_open(document_t *document, const char *path, scene_builder_t *builder);
void document_close(document_t *document);

/* An element of an array at the root. */
result_t document_item(const document_t *document, top_t which, uint32_t index, item_t *out);
size_t document_count(const document_t *document, top_t which);
/* Whether an element has that name. */
bool document_is_named(const document_t *document, top_t which, uint32_t index, const char *name);

/* The bytes of a buffer view, unpacked, in memory that the document owns. */
result_t document_view(document_t *document, uint32_t view, bytes_t *bytes);
/* The bytes that the properties buffer, byteOffset and byteLength of an object name. */
result_t document_range(document_t *document, const item_t *owner, bytes_t *bytes);
/* The bytes that a property "uri" stands for: a data URI, or a file, relative to the glTF file. `path`, of
 * size PATH_ROOM, becomes a name for messages. */
enum { PATH_ROOM = 200 };
result_t document_uri(document_t *document, const item_t *owner, const char *uri, bytes_t *bytes,
                      char path[PATH_ROOM]);

/* Where an item is, for messages of the scene builder. Its path is valid until the next call. */
position_t document_at(document_t *document, const item_t *item);
/* Counts vertices and indices that are about to be decoded: see scene_charge. */
result_t document_charge(document_t *document, const item_t *item, uint64_t amount);

/* ---- unpack.c ------------------------------------------------------------------------------------------ */

/* A buffer view that has EXT_meshopt_compression, `packed`; unpacked once. */
result_t unpack_view(document_t *document, uint32_t index, const item_t *packed, bytes_t *bytes);

/* The mesh that a primitive holds by KHR_draco_mesh_compression. */
typedef struct {
    bool present;
    const char *names[DRACO_MOST_ATTRIBUTES]; /* of its attributes; owned by the file's JSON */
    uint32_t ids[DRACO_MOST_ATTRIBUTES];
    size_t count;
    draco_mesh_t mesh; /* owned: draco_free */
} unpacked_t;

/* Unpacks it; not present when the primitive is not packed. After an error there is nothing to free. */
result_t unpack_primitive(document_t *document, const item_t *primitive, unpacked_t *unpacked);
/* The attribute of that name; NULL when the packed mesh has none. */
const draco_attribute_t *unpack_find(const unpacked_t *unpacked, const char *name);

/* ---- accessor.c ---------------------------------------------------------------------------------------- */

typedef enum {
    COMPONENT_INT8 = 5120,
    COMPONENT_UINT8 = 5121,
    COMPONENT_INT16 = 5122,
    COMPONENT_UINT16 = 5123,
    COMPONENT_UINT32 = 5125,
    COMPONENT_FLOAT = 5126
} component_t;

/* An array of small vectors, checked, in the file's memory. */
typedef struct {
    size_t count;      /* at least 1 */
    size_t components; /* 1 to 4, or 16: a matrix, column by column */
    component_t type;
    bool normalized;
    const uint8_t *data; /* NULL: zeroes */
    size_t stride;
    size_t sparse_count; /* elements that are replaced; their indices ascend */
    component_t sparse_type;
    const uint8_t *sparse_indices, *sparse_values;
} accessor_t;

result_t accessor_open(document_t *document, uint32_t index, accessor_t *accessor);
/* The values of an attribute that was unpacked; `index` is the accessor that stands for it, or ITEM_NONE.
 * Where that says the same type, it also says whether integers are fractions. */
result_t accessor_of_draco(document_t *document, uint32_t index, const draco_attribute_t *attribute,
                           uint32_t count, accessor_t *accessor);
/* The components of an element, index in range: as many doubles; those behind them stay as they are.
 * Normalized integers become fractions. */
void accessor_get(const accessor_t *accessor, size_t index, double *values);
/* The same for an index of a vertex. */
uint32_t accessor_whole(const accessor_t *accessor, size_t index);
bool accessor_is_unsigned(const accessor_t *accessor);

/* ---- primitive.c --------------------------------------------------------------------------------------- */

/* Reads a primitive; without triangles when it has none that can be seen (with a warning). The caller frees
 * the mesh. The texture coordinates' v is turned over (1 - v), so that dp/du and dp/dv are the tangents that
 * glTF's normal maps refer to; where the first set is missing it is (0, 0) everywhere for a material with
 * images. Tangents of its own are read only for a material that needs them; the two sets of texture
 * coordinates change places for one that wants it so. *skinned: a skin has put the vertices into the world.
 */
result_t primitive_read(document_t *document, const item_t *primitive, const gltf_material_t *material,
                        const deform_t *deform, mesh_t *mesh, bool *skinned);

/* ---- animation.c --------------------------------------------------------------------------------------- */

/* The properties of a node that animations move. */
typedef enum { MOVING_TRANSLATION, MOVING_ROTATION, MOVING_SCALE, MOVING_WEIGHTS, MOVING_COUNT } moving_t;

/* Reads the animations that the wishes ask for, and sets the times of the poses. animation_close frees them,
 * also after an error. */
result_t animation_open(document_t *document);
void animation_close(document_t *document);
/* Numbers of a property: 3, of a rotation 4, of weights any number; 0 when no animation moves it. */
size_t animation_width(const document_t *document, uint32_t node, moving_t property);
/* Sets so many values to what they are at a time in seconds; leaves them alone when no animation moves the
 * property. RESULT_INPUT when they are not finite. */
result_t animation_value(const document_t *document, uint32_t node, moving_t property, double time,
                         double *values);

/* ---- deform.c ------------------------------------------------------------------------------------------ */

/* What deforms a mesh: at a place, or, without one (NULL), by the mesh's own weights alone. */
result_t deform_begin(document_t *document, uint32_t mesh, const gltf_placement_t *place, deform_t *deform);
void deform_end(deform_t *deform);

/* ---- texture.c ----------------------------------------------------------------------------------------- */

typedef enum { ENCODING_LINEAR, ENCODING_SRGB } encoding_t;

/* factor times the texture that the property `key` of the material (or of its extension) refers to. */
result_t texture_value(document_t *document, const item_t *owner, const char *key, encoding_t encoding,
                       channel_t channel, rgb_t factor, blob_value_t *value);
/* 1 - factor times that texture, for a factor from 0 to 1. */
result_t texture_complement(document_t *document, const item_t *owner, const char *key, encoding_t encoding,
                            channel_t channel, float factor, blob_value_t *value);
/* The bytes of an image of the file, and a name for messages. */
result_t texture_bytes(document_t *document, const item_t *image, bytes_t *bytes, char name[PATH_ROOM]);
/* a times b, where either may vary. */
blob_value_t texture_product(document_t *document, blob_value_t a, blob_value_t b);
/* (1 - amount) a + amount b. */
blob_value_t texture_mix(document_t *document, blob_value_t a, blob_value_t b, blob_value_t amount);
/* The colours at the vertices: RGB or A. */
blob_value_t texture_vertex_colour(document_t *document, channel_t channel);
/* 1 where the value is at least the cutoff, else 0. */
blob_value_t texture_threshold(document_t *document, blob_value_t value, float cutoff);

/* ---- material.c ---------------------------------------------------------------------------------------- */

/* The material of that index, or glTF's default (ITEM_NONE), made when it is asked for first. The pointer is
 * good until document_close. */
result_t material_get(document_t *document, uint32_t index, bool coloured, const gltf_material_t **material);

/* Finds the variant of the materials that is asked for (--variant). RESULT_USAGE when there is none such. */
result_t variant_choose(document_t *document);
/* The material of a primitive in that variant; unchanged when it has none. */
result_t variant_material(const document_t *document, const item_t *primitive, uint32_t *material);

/* ---- node.c, placement.c, light.c, camera.c ------------------------------------------------------------ */

/* Walks the scene and gathers meshes, cameras and lights, in all poses. */
result_t node_walk(document_t *document);
/* The transform of a node after that, in the scene or not; NULL when it hangs from itself. */
const affine_t *node_world(const document_t *document, uint32_t node);

/* Puts all meshes into the blob: shapes, objects, instances and area lights. */
result_t placement_meshes(document_t *document);

/* The lights that a node names, and puts all of them into the blob. */
result_t light_find(const document_t *document, const item_t *node, uint32_t *light);
result_t light_add(document_t *document);

/* Finishes the scene with its first camera, or with one that sees everything. Meshes are there already. */
result_t camera_add(document_t *document);

#endif
