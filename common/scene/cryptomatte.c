/* cryptomatte: see cryptomatte.h. */
#include "common/scene/cryptomatte.h"

#include "common/text/json.h"

#include <murmurhash.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *const matte_kind_names[MATTE_KINDS] = {"crypto_object", "crypto_material"};

uint32_t matte_id(const char *name)
{
    uint32_t hash;
    lmmh_x86_32(name, (unsigned)strlen(name), 0, &hash);
    uint32_t exponent = hash >> 23 & 255;
    if (exponent == 0) return hash | 1u << 23;      /* zero or denormal */
    if (exponent == 255) return hash & ~(1u << 23); /* infinite or not a number */
    return hash;
}

void matte_key(matte_kind_t kind, char key[MATTE_KEY])
{
    snprintf(key, MATTE_KEY, "%07x", matte_id(matte_kind_names[kind]) >> 4);
}

/* Enters a name into a manifest, and returns its id. A name that is no UTF-8 is mended first: decoders are to
 * come to the same id by the manifest's name. */
static uint32_t enter(json_t *manifest, const char *name, const char *kind, size_t number)
{
    char digits[9], stand_in[40];
    snprintf(stand_in, sizeof stand_in, "%s %zu", kind, number);
    json_t *text = json_text(name[0] != '\0' ? name : stand_in);
    const char *mended = json_string_value(text);
    uint32_t id = matte_id(mended);
    snprintf(digits, sizeof digits, "%08x", id);
    json_object_set_new(manifest, mended, json_string(digits));
    json_decref(text);
    return id;
}

/* Frees the manifest. */
static char *manifest_text(json_t *manifest)
{
    char *text = json_dumps(manifest, JSON_COMPACT | JSON_SORT_KEYS);
    json_decref(manifest);
    if (text != NULL && strlen(text) <= MATTE_MANIFEST_LIMIT) return text;
    free(text);
    return NULL;
}

static void name_objects(const scene_blob_t *blob, mattes_t *mattes)
{
    json_t *manifest = json_object();
    for (size_t s = 0; s < mattes->shape_count; s++)
        mattes->ids[MATTE_OBJECT][s] = enter(manifest, blob->strings + blob->shapes[s].name, "object", s + 1);
    mattes->manifests[MATTE_OBJECT] = manifest_text(manifest);
}

static void name_materials(const scene_blob_t *blob, mattes_t *mattes)
{
    json_t *manifest = json_object();
    size_t count = blob->counts[BLOB_SECTION_MATERIALS];
    uint32_t *ids = mem_alloc((count + 1) * sizeof *ids);
    for (size_t m = 0; m < count; m++)
        ids[m] = enter(manifest, blob->strings + blob->materials[m].name, "material", m + 1);
    for (size_t s = 0; s < mattes->shape_count; s++)
        mattes->ids[MATTE_MATERIAL][s] = ids[blob->shapes[s].material];
    free(ids);
    mattes->manifests[MATTE_MATERIAL] = manifest_text(manifest);
}

mattes_t *mattes_new(const scene_blob_t *blob)
{
    mattes_t *mattes = mem_zalloc(1, sizeof *mattes);
    mattes->shape_count = blob->counts[BLOB_SECTION_SHAPES];
    for (int k = 0; k < MATTE_KINDS; k++)
        mattes->ids[k] = mem_alloc((mattes->shape_count + 1) * sizeof *mattes->ids[k]);
    name_objects(blob, mattes);
    name_materials(blob, mattes);
    return mattes;
}

void mattes_free(mattes_t **pointer)
{
    mattes_t *mattes = *pointer;
    if (mattes == NULL) return;
    for (int k = 0; k < MATTE_KINDS; k++) {
        free(mattes->ids[k]);
        free(mattes->manifests[k]);
    }
    free(mattes);
    *pointer = NULL;
}
