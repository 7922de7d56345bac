/* scene_builder: a scene on its way from a file of any format into the blob.
 *
 * A reader knows what its format means; here is what every scene needs: objects and the order of their
 * shapes, area lights, instances that can be traced, textures that can be evaluated, and bounds on what a
 * small file may ask for. Images are in scene_images.h, triangle meshes in mesh.h, what a scene without
 * camera or light gets in scene_defaults.h. Materials, names and geometry that is no mesh are records that
 * readers add to `blob` themselves.
 *
 * The blob wants shapes grouped by object, the world's first, while a file mixes them. So shapes are gathered
 * here, and laid out by scene_finish.
 */
#ifndef LIGHTMILL_SCENE_BUILDER_H
#define LIGHTMILL_SCENE_BUILDER_H

#include "client/import/scene/affine.h"
#include "client/import/scene/report.h"
#include "common/scene/blob_builder.h"

/* What a few bytes can ask for much of; see scene_charge. */
typedef enum { SCENE_VERTICES, SCENE_TRIANGLES, SCENE_PIXELS, SCENE_BRICKS, SCENE_AMOUNTS } scene_amount_t;

/* An image as somebody asked for it; see scene_images.h. Owned: key. */
typedef struct {
    char *key;               /* tells it from others: its path, or its place in the scene's file */
    float gamma;             /* of blob_image_t; of an image of floats: what has been undone */
    bool encoded;            /* what the format of its file says */
    bool always_linear;      /* whatever is asked for */
    bool grey;               /* one channel */
    uint32_t use;            /* of scene_change_t; 0: as in the file */
    blob_ref_t image, alpha; /* alpha: 0 when there is none, or it is not apart */
} scene_image_t;

/* Readers use `report`, `blob`, `source_bytes` and `object_count`; the rest is for the functions below.
 * Owned: the arrays. */
typedef struct {
    report_t *report;
    blob_builder_t *blob;
    uint64_t source_bytes; /* of all files of the scene so far */
    uint64_t amounts[SCENE_AMOUNTS];
    struct scene_object *objects; /* 0 is the world */
    size_t object_count, object_capacity;
    double *texture_costs; /* of the blob's textures: how many one look-up evaluates */
    size_t texture_count, texture_capacity;
    scene_image_t *images;
    size_t image_count, image_capacity;
    uint32_t *focused; /* the instances whose name --focus asks for */
    size_t focused_count, focused_capacity;
} scene_builder_t;

/* An empty scene, whose world has no shape; `blob` and `report` are kept by the caller. */
void scene_begin(scene_builder_t *scene, blob_builder_t *blob, report_t *report);
/* Frees what the builder owns, which the blob is not. */
void scene_end(scene_builder_t *scene);

/* Counts what is about to be made. RESULT_INPUT beyond a bound that grows with source_bytes: small files can
 * ask for much, by many levels of subdivision, or many meshes that share the same bytes. `amount` is of
 * SCENE_VERTICES: vertices and indices to decode, 2^22 + 64 a byte; SCENE_TRIANGLES: 2^26 + 256 a byte;
 * SCENE_PIXELS: 2^27 + 512 a byte; SCENE_BRICKS, of the boxes of grids: 2^22 + 64 a byte. */
result_t scene_charge(scene_builder_t *scene, scene_amount_t what, uint64_t amount, position_t at);

/* Counts the bytes of a file of the scene that is opened by its path; returns them, 0 where it is missing. */
uint64_t scene_count_file(scene_builder_t *scene, const char *path);

/* ---- objects and shapes -------------------------------------------------------------------------------- */

/* Of blob_shape_t.flags, up to scene_finish: the inside is where the normal points. */
enum { SCENE_INSIDE_OUT = 1u << 31 };

/* A new, empty object. */
uint32_t scene_add_object(scene_builder_t *scene);
/* Adds a shape to an object, 0 for the world; the object after the last is made. `light`, or NULL, is what a
 * shape of the world emits. `shape` has everything but its light, `light` everything but its shape. `media`
 * may be there without SHAPE_INTERFACE: they count where the shape's material has a body, which then takes
 * the place of the one inside. */
void scene_add_shape(scene_builder_t *scene, uint32_t object, blob_shape_t shape, const blob_light_t *light);
/* The shapes of an object so far, writable, valid until one is added to it. */
blob_shape_t *scene_shapes(const scene_builder_t *scene, uint32_t object, size_t *count);
/* Adds an instance of an object, at two times. RESULT_INPUT when blob_instance_is_traceable does not hold of
 * its transforms, or when one mirrors and the other does not. */
result_t scene_add_instance(scene_builder_t *scene, uint32_t object, const affine_t *open,
                            const affine_t *close, position_t at);
/* Says what the last instance is called where its file has a name for it, so that --focus finds it. */
void scene_name_instance(scene_builder_t *scene, const char *name);

/* ---- lights, materials, the camera --------------------------------------------------------------------- */

/* Adds a light that is no shape, unless it is black. `light` has everything but its transform. RESULT_INPUT
 * when that is singular, or the light's radiance infinite. */
result_t scene_add_light(scene_builder_t *scene, blob_light_t light, const affine_t *world_from_light,
                         position_t at);
/* True when something lights the scene, be it a medium; pictures (LIGHT_PICTURE) do not. */
bool scene_has_light(const scene_builder_t *scene);
/* True when the scene gets an environment that its file does not have: import_wishes_t.environment. */
bool scene_gets_environment(const scene_builder_t *scene);

/* Lets a mix have one of its parts at each point (MATERIAL_CHOSEN) if a part has relief of its own. */
void scene_choose_parts(const scene_builder_t *scene, blob_material_t *mix);
/* Adds a spectrum, unless it is one of the last ones, and returns a reference to it. */
blob_ref_t scene_add_spectrum(scene_builder_t *scene, const blob_spectrum_t *spectrum);
/* Adds a texture and returns its value. */
blob_value_t scene_add_texture(scene_builder_t *scene, const blob_texture_t *texture);
/* Whether there is an image among the textures from number `first` on (from 0). */
bool scene_has_images(const scene_builder_t *scene, uint32_t first);
/* Refuses what a blob must not have in the textures that came since the last call: numbers that are not
 * finite, and more than BLOB_MAX_TEXTURE_COST textures in one. */
result_t scene_check_textures(scene_builder_t *scene, position_t at);

/* Places the camera at two times. RESULT_INPUT when a transform is singular or not finite. */
result_t scene_place_camera(blob_scene_t *record, const affine_t *open, const affine_t *close, position_t at);

/* Lays out objects, shapes and the scene's record in the blob, after a last look at the textures. Warns of a
 * scene that lies so far from the origin that the steps of floats there show. */
result_t scene_finish(scene_builder_t *scene, const blob_scene_t *record, position_t at);

#endif
