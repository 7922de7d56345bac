/* cryptomatte: the ids of what a scene consists of, as the Cryptomatte specification 1.2.0 (Friedman and
 * Jones, Psyop) has them: the hash of a name, whose bits are those of a float.
 *
 * Objects are the shapes of a scene, by the name that says where they come from: the node of a glTF file,
 * file and line of a pbrt file. Things with the same name have the same id, and so one matte.
 */
#ifndef LIGHTMILL_CRYPTOMATTE_H
#define LIGHTMILL_CRYPTOMATTE_H

#include "common/scene/scene_blob.h"

typedef enum { MATTE_OBJECT, MATTE_MATERIAL, MATTE_KINDS } matte_kind_t;
/* The typename of each kind of matte: its layers are "crypto_object00" and so on. */
extern const char *const matte_kind_names[MATTE_KINDS];

enum {
    MATTE_RANKS = 6,                /* ids of a pixel that are kept, those that cover most of it */
    MATTE_LEVELS = MATTE_RANKS / 2, /* images of two ids and their coverages each */
    MATTE_KEY = 8,                  /* room for the key of a kind */
    MATTE_MANIFEST_LIMIT = 16 << 20 /* bytes of a manifest; a longer one is left out */
};

/* The ids of a scene. */
typedef struct {
    size_t shape_count;
    uint32_t *ids[MATTE_KINDS];   /* of each shape, and of its material: the bits of floats, never 0 */
    char *manifests[MATTE_KINDS]; /* JSON, {"name":"id in hexadecimal",...}; NULL: too long */
} mattes_t;

/* The ids of a scene that was checked. A shape or material without a name is "object N" or "material N", N
 * being its number in the layers object.id and material.id. */
mattes_t *mattes_new(const scene_blob_t *blob);
/* Sets *mattes to NULL. */
void mattes_free(mattes_t **mattes);

/* The id of a name: MurmurHash3_x86_32 with seed 0, its exponent clamped so that it is a finite, normal float
 * (the specification's uint32_to_float32). Never 0. */
uint32_t matte_id(const char *name);
/* The key under which the attributes of a kind are found: seven hexadecimal digits of the id of its typename.
 */
void matte_key(matte_kind_t kind, char key[MATTE_KEY]);

#endif
