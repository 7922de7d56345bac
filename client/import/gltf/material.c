/* material: glTF's metallic-roughness material with its extensions (the glTF 2.0 specification, section 3.9
 * and appendix B; KHR_materials_*), and the specular-glossiness material that stands in its place.
 */
#include "client/import/gltf/document.h"
#include "common/colour/albedo.h"

#include <stdio.h>
#include <string.h>

static const rgb_t white = {1, 1, 1};

/* A material while it is made. */
typedef struct {
    document_t *document;
    const item_t *item; /* json NULL: glTF's default */
    bool coloured;      /* for meshes with colours at their vertices */
    item_t base;        /* what holds the base colour, whose names are ... */
    const char *factor, *texture;
    bool is_glossy; /* KHR_materials_pbrSpecularGlossiness */
    blob_material_t record;
    gltf_material_t *out;
} maker_t;

static rgb_t to_rgb(const double c[3])
{
    return vec3((float)c[0], (float)c[1], (float)c[2]);
}

static rgb_t to_grey(double number)
{
    return vec3((float)number, (float)number, (float)number);
}

/* A number with a texture in one channel of an image. */
static result_t number_value(maker_t *m, const item_t *owner, const char *factor_key, double factor,
                             const char *texture_key, channel_t channel, material_value_t value)
{
    TRY(item_number(owner, factor_key, 0, 1, &factor));
    return texture_value(m->document, owner, texture_key, ENCODING_LINEAR, channel, to_grey(factor),
                         &m->record.values[value]);
}

/* ---- the base ------------------------------------------------------------------------------------------ */

static result_t find_base(maker_t *m)
{
    TRY(item_extension(m->item, "KHR_materials_pbrSpecularGlossiness", &m->base));
    m->is_glossy = m->base.json != NULL;
    m->factor = m->is_glossy ? "diffuseFactor" : "baseColorFactor";
    m->texture = m->is_glossy ? "diffuseTexture" : "baseColorTexture";
    return m->is_glossy ? result_ok() : item_member(m->item, "pbrMetallicRoughness", JSON_OBJECT, &m->base);
}

static result_t base_colour(maker_t *m)
{
    double factor[4] = {1, 1, 1, 1};
    blob_value_t *colour = &m->record.values[VALUE_REFLECTANCE];
    TRY(item_numbers(&m->base, m->factor, 4, 0, 1, factor, NULL));
    TRY(texture_value(m->document, &m->base, m->texture, ENCODING_SRGB, CHANNEL_RGB, to_rgb(factor), colour));
    if (m->coloured)
        *colour = texture_product(m->document, *colour, texture_vertex_colour(m->document, CHANNEL_RGB));
    return result_ok();
}

static result_t metallic_roughness(maker_t *m)
{
    TRY(number_value(m, &m->base, "metallicFactor", 1, "metallicRoughnessTexture", CHANNEL_B,
                     VALUE_METALLIC));
    return number_value(m, &m->base, "roughnessFactor", 1, "metallicRoughnessTexture", CHANNEL_G,
                        VALUE_ROUGHNESS_U);
}

static result_t normal_map(const maker_t *m, const item_t *owner, const char *key, blob_ref_t *texture,
                           float *factor)
{
    item_t info;
    double scale = 1;
    blob_value_t map;
    TRY(item_member(owner, key, JSON_OBJECT, &info));
    TRY(item_number(&info, "scale", -1e3, 1e3, &scale));
    TRY(texture_value(m->document, owner, key, ENCODING_LINEAR, CHANNEL_RGB, white, &map));
    *texture = map.texture;
    *factor = (float)scale;
    return result_ok();
}

/* The alpha of the base colour, of its texture and of the vertices. */
static result_t base_alpha(maker_t *m)
{
    double factor[4] = {1, 1, 1, 1};
    blob_value_t *alpha = &m->out->alpha;
    TRY(item_numbers(&m->base, m->factor, 4, 0, 1, factor, NULL));
    TRY(texture_value(m->document, &m->base, m->texture, ENCODING_SRGB, CHANNEL_A, to_grey(factor[3]),
                      alpha));
    if (m->coloured)
        *alpha = texture_product(m->document, *alpha, texture_vertex_colour(m->document, CHANNEL_A));
    return result_ok();
}

static result_t alpha(maker_t *m)
{
    const char *mode = "OPAQUE";
    double cutoff = 0.5;
    TRY(item_string(m->item, "alphaMode", &mode));
    TRY(item_number(m->item, "alphaCutoff", 0, 1e6, &cutoff));
    m->out->alpha = blob_constant(1);
    if (strcmp(mode, "OPAQUE") == 0) return result_ok();
    m->out->cutout = strcmp(mode, "MASK") == 0;
    if (!m->out->cutout && strcmp(mode, "BLEND") != 0)
        return item_fail(m->item, "alphaMode \"%.20s\" must be OPAQUE, MASK or BLEND", mode);
    TRY(base_alpha(m));
    if (m->out->cutout) m->out->alpha = texture_threshold(m->document, m->out->alpha, (float)cutoff);
    return result_ok();
}

static result_t emission(maker_t *m)
{
    item_t extension;
    double factor[3] = {0, 0, 0}, strength = 1;
    TRY(item_numbers(m->item, "emissiveFactor", 3, 0, 1, factor, NULL));
    TRY(item_extension(m->item, "KHR_materials_emissive_strength", &extension));
    TRY(item_number(&extension, "emissiveStrength", 0, 1e12, &strength));
    rgb_t radiance = v_scale(to_rgb(factor), (float)strength);
    m->out->emits = v_max(radiance) > 0;
    if (!m->out->emits) return result_ok();
    return texture_value(m->document, m->item, "emissiveTexture", ENCODING_SRGB, CHANNEL_RGB, radiance,
                         &m->out->emission);
}

/* Exporters mark nearly all materials as doubleSided, so the mark says nothing about lamps: light leaves the
 * front alone unless the material also has the custom property lightmill_two_sided. Blender's do it unless
 * back faces are culled, which docs/blender.md tells; of others a file is told of once. */
static result_t emitting_sides(maker_t *m)
{
    bool double_sided = false;
    TRY(item_bool(m->item, "doubleSided", &double_sided));
    if (!m->out->emits || !double_sided) return result_ok();
    const json_t *wish = json_object_get(json_object_get(m->item->json, "extras"), "lightmill_two_sided");
    m->out->two_sided = json_is_true(wish) || json_number_value(wish) > 0;
    if (!m->out->two_sided && !m->document->blender && !m->document->told_of_sides) {
        m->document->told_of_sides = true;
        item_warn(m->item, "is double-sided, but its light leaves the front alone; for both sides give the "
                           "material the custom property lightmill_two_sided");
    }
    return result_ok();
}

/* ---- extensions ---------------------------------------------------------------------------------------- */

static result_t ior(maker_t *m)
{
    item_t extension;
    double eta = 1.5;
    TRY(item_extension(m->item, "KHR_materials_ior", &extension));
    TRY(item_number(&extension, "ior", 0, 100, &eta));
    /* 0 stands for a Fresnel reflectance of 1 everywhere; an index so high comes close */
    if (eta == 0) eta = 1e4;
    if (eta < 1) {
        item_warn(&extension, "an index of refraction of %g is below 1 and taken for 1", eta);
        eta = 1;
    }
    m->record.values[VALUE_ETA] = blob_constant((float)eta);
    return result_ok();
}

static result_t specular(maker_t *m)
{
    item_t extension;
    double colour[3] = {1, 1, 1};
    TRY(item_extension(m->item, "KHR_materials_specular", &extension));
    TRY(number_value(m, &extension, "specularFactor", 1, "specularTexture", CHANNEL_A, VALUE_SPECULAR));
    TRY(item_numbers(&extension, "specularColorFactor", 3, 0, 1e6, colour, NULL));
    return texture_value(m->document, &extension, "specularColorTexture", ENCODING_SRGB, CHANNEL_RGB,
                         to_rgb(colour), &m->record.values[VALUE_SPECULAR_COLOUR]);
}

/* A normal map of the base does not turn the coat. */
static result_t clearcoat(maker_t *m)
{
    item_t extension;
    TRY(item_extension(m->item, "KHR_materials_clearcoat", &extension));
    TRY(number_value(m, &extension, "clearcoatFactor", 0, "clearcoatTexture", CHANNEL_R, VALUE_CLEARCOAT));
    TRY(number_value(m, &extension, "clearcoatRoughnessFactor", 0, "clearcoatRoughnessTexture", CHANNEL_G,
                     VALUE_CLEARCOAT_ROUGHNESS));
    if (!(m->record.values[VALUE_CLEARCOAT].factor.x > 0)) return result_ok();
    TRY(normal_map(m, &extension, "clearcoatNormalTexture", &m->record.coat_normal_map,
                   &m->record.coat_normal_scale));
    if (m->record.normal_map != 0 || m->record.coat_normal_map != 0) m->record.flags |= MATERIAL_COAT_NORMAL;
    return result_ok();
}

static result_t transmission(maker_t *m)
{
    item_t extension;
    TRY(item_extension(m->item, "KHR_materials_transmission", &extension));
    return number_value(m, &extension, "transmissionFactor", 0, "transmissionTexture", CHANNEL_R,
                        VALUE_TRANSMISSION);
}

/* KHR_materials_volume_scatter: a part of what the volume absorbs it scatters: that which shows a colour.
 * Then it is a medium, and not Beer's law along segments. */
static result_t scattering(maker_t *m, const item_t *extension, const double loss[3])
{
    double colour[3] = {0, 0, 0}, g = 0;
    blob_medium_t medium = {0};
    TRY(item_numbers(extension, "multiscatterColor", 3, 0, 1, colour, NULL));
    TRY(item_number(extension, "scatterAnisotropy", -0.999, 0.999, &g));
    double scattered[3], absorbed[3];
    for (int i = 0; i < 3; ++i) {
        double share = albedo_of_colour(colour[i], g);
        scattered[i] = fmin(share * loss[i], 1e9);
        absorbed[i] = fmin((1 - share) * loss[i], 1e9);
    }
    medium.scattering = to_rgb(scattered);
    medium.absorption = to_rgb(absorbed);
    medium.g = (float)g;
    if (v_is_zero(medium.scattering)) return result_ok();
    medium.is_of_colour = 1;
    m->record.values[VALUE_ATTENUATION] = m->record.values[VALUE_THICKNESS] = blob_constant(0);
    m->record.body = 1 + blob_builder_add(m->document->builder->blob, BLOB_SECTION_MEDIA, &medium, 1);
    return result_ok();
}

/* Light that went the distance d through the body is left with attenuationColor. Where it is scattered there
 * is a body, too, if the file does not say how thick it is. */
static result_t volume(maker_t *m)
{
    item_t extension, scatter;
    double thickness = 0, distance = INFINITY, colour[3] = {1, 1, 1};
    TRY(item_extension(m->item, "KHR_materials_volume", &extension));
    TRY(item_extension(m->item, "KHR_materials_volume_scatter", &scatter));
    if (extension.json && scatter.json) thickness = 1;
    TRY(item_number(&extension, "thicknessFactor", 0, 1e18, &thickness));
    TRY(item_number(&extension, "attenuationDistance", 1e-9, 1e18, &distance));
    TRY(item_numbers(&extension, "attenuationColor", 3, 0, 1, colour, NULL));
    if (!(thickness > 0)) {
        if (scatter.json)
            item_warn(&scatter, "scatters nothing without KHR_materials_volume and a thickness");
        m->record.flags |= MATERIAL_THIN;
        return result_ok();
    }
    for (int i = 0; i < 3; ++i) colour[i] = -log(fmax(colour[i], 1e-6)) / distance;
    m->record.values[VALUE_ATTENUATION] = blob_colour_value(to_rgb(colour));
    if (distance < INFINITY) m->record.values[VALUE_THICKNESS] = blob_constant((float)distance);
    return scatter.json ? scattering(m, &scatter, colour) : result_ok();
}

/* KHR_materials_pbrSpecularGlossiness: the specular colour is the reflectance at normal incidence, for which
 * an index of refraction of 0 leaves the specular colour as it is. The extension dims the diffuse colour by
 * 1 - max(specular), as the appendix B of its time dimmed that of metallic-roughness by 1 - 0.04. Today's
 * leaves to the base what reflection leaves at the angle in question, which is the same at normal incidence:
 * so does ours, and a specular colour of 0.04 is the same dielectric in both. */
static result_t specular_glossiness(maker_t *m)
{
    double specular[3] = {1, 1, 1}, glossiness = 1;
    const char *texture = "specularGlossinessTexture";
    TRY(item_numbers(&m->base, "specularFactor", 3, 0, 1, specular, NULL));
    TRY(item_number(&m->base, "glossinessFactor", 0, 1, &glossiness));
    m->record.values[VALUE_SPECULAR] = blob_constant(1);
    TRY(texture_value(m->document, &m->base, texture, ENCODING_SRGB, CHANNEL_RGB, to_rgb(specular),
                      &m->record.values[VALUE_SPECULAR_COLOUR]));
    return texture_complement(m->document, &m->base, texture, ENCODING_SRGB, CHANNEL_A, (float)glossiness,
                              &m->record.values[VALUE_ROUGHNESS_U]);
}

/* A colour with a texture in sRGB. */
static result_t colour_value(maker_t *m, const item_t *extension, const char *factor_key, double factor,
                             const char *texture_key, material_value_t value)
{
    double c[3] = {factor, factor, factor};
    TRY(item_numbers(extension, factor_key, 3, 0, 1, c, NULL));
    return texture_value(m->document, extension, texture_key, ENCODING_SRGB, CHANNEL_RGB, to_rgb(c),
                         &m->record.values[value]);
}

/* Without a colour there is none, whatever its roughness. */
static result_t sheen(maker_t *m)
{
    item_t extension;
    TRY(item_extension(m->item, "KHR_materials_sheen", &extension));
    TRY(colour_value(m, &extension, "sheenColorFactor", 0, "sheenColorTexture", VALUE_SHEEN_COLOUR));
    return number_value(m, &extension, "sheenRoughnessFactor", 0, "sheenRoughnessTexture", CHANNEL_A,
                        VALUE_SHEEN_ROUGHNESS);
}

/* The texture's blue is the strength, its red and green are the direction; without one that is the tangent.
 */
static result_t anisotropy(maker_t *m)
{
    item_t extension;
    double angle = 0;
    blob_value_t *direction = &m->record.values[VALUE_ANISOTROPY_DIRECTION];
    TRY(item_extension(m->item, "KHR_materials_anisotropy", &extension));
    TRY(number_value(m, &extension, "anisotropyStrength", 0, "anisotropyTexture", CHANNEL_B,
                     VALUE_ANISOTROPIC));
    if (m->record.values[VALUE_ANISOTROPIC].factor.x == 0) return result_ok();
    TRY(item_number(&extension, "anisotropyRotation", -1e6, 1e6, &angle));
    TRY(texture_value(m->document, &extension, "anisotropyTexture", ENCODING_LINEAR, CHANNEL_RGB, white,
                      direction));
    if (direction->texture == 0) *direction = blob_colour_value(vec3(1, 0.5f, 0));
    m->record.values[VALUE_ANISOTROPY_TURN] =
        blob_colour_value(vec3((float)cos(angle), (float)sin(angle), 0));
    return result_ok();
}

/* Between both ends by the texture's green, or the latter of them. */
static result_t film_thickness(maker_t *m, const item_t *extension, blob_value_t *value)
{
    double least = 100, most = 400;
    blob_value_t amount;
    TRY(item_number(extension, "iridescenceThicknessMinimum", 0, 1e6, &least));
    TRY(item_number(extension, "iridescenceThicknessMaximum", 0, 1e6, &most));
    TRY(texture_value(m->document, extension, "iridescenceThicknessTexture", ENCODING_LINEAR, CHANNEL_G,
                      white, &amount));
    *value = blob_constant((float)most);
    if (amount.texture != 0) *value = texture_mix(m->document, blob_constant((float)least), *value, amount);
    return result_ok();
}

static result_t iridescence(maker_t *m)
{
    item_t extension;
    double eta = 1.3;
    blob_value_t *values = m->record.values;
    TRY(item_extension(m->item, "KHR_materials_iridescence", &extension));
    TRY(number_value(m, &extension, "iridescenceFactor", 0, "iridescenceTexture", CHANNEL_R,
                     VALUE_IRIDESCENCE));
    if (values[VALUE_IRIDESCENCE].factor.x == 0) return result_ok();
    TRY(item_number(&extension, "iridescenceIor", 1, 100, &eta));
    values[VALUE_IRIDESCENCE_ETA] = blob_constant((float)eta);
    return film_thickness(m, &extension, &values[VALUE_IRIDESCENCE_THICKNESS]);
}

static result_t diffuse_transmission(maker_t *m)
{
    item_t extension;
    TRY(item_extension(m->item, "KHR_materials_diffuse_transmission", &extension));
    if (!extension.json) return result_ok();
    TRY(number_value(m, &extension, "diffuseTransmissionFactor", 0, "diffuseTransmissionTexture", CHANNEL_A,
                     VALUE_DIFFUSE_TRANSMISSION));
    return colour_value(m, &extension, "diffuseTransmissionColorFactor", 1, "diffuseTransmissionColorTexture",
                        VALUE_TRANSMITTANCE);
}

/* Of a solid alone; the interface of a film does not disperse. */
static result_t dispersion(maker_t *m)
{
    item_t extension;
    double amount = 0;
    TRY(item_extension(m->item, "KHR_materials_dispersion", &extension));
    TRY(item_number(&extension, "dispersion", 0, 1e6, &amount));
    if (amount > 0 && m->record.values[VALUE_IRIDESCENCE].factor.x > 0)
        item_warn(&extension, "is ignored beside KHR_materials_iridescence, whose film does not disperse");
    else
        m->record.values[VALUE_DISPERSION] = blob_constant((float)amount);
    return result_ok();
}

/* These do not go together with specular-glossiness. */
static result_t extensions_of_metallic_roughness(maker_t *m)
{
    if (m->is_glossy) return result_ok();
    TRY(ior(m));
    TRY(specular(m));
    TRY(clearcoat(m));
    TRY(transmission(m));
    TRY(volume(m));
    TRY(sheen(m));
    TRY(anisotropy(m));
    TRY(iridescence(m));
    TRY(diffuse_transmission(m));
    return dispersion(m);
}

/* KHR_materials_unlit: the camera sees the base colour as it is, and nothing else sees the surface at all.
 * Its values stay 0, so that it scatters nothing. */
static result_t unlit(maker_t *m)
{
    blob_value_t *colour = &m->record.values[VALUE_REFLECTANCE];
    TRY(alpha(m));
    m->out->emits = m->out->two_sided = m->out->unlit = true;
    m->out->emission = *colour;
    *colour = blob_constant(0);
    return result_ok();
}

/* Blender's exporter writes a surface that it does not understand as a material without any value, which is
 * glTF's default: rough white metal. What it understands has a metallicFactor, since that is 0 in Blender. */
static result_t tell_of_lost_nodes(const maker_t *m)
{
    bool empty = !m->is_glossy && m->base.json && json_object_size(m->base.json) == 0;
    if (!m->document->blender || !empty || m->out->emits) return result_ok();
    item_warn(
        &m->base,
        "is empty, as Blender writes a surface whose node is not a Principled BSDF: it arrives as rough "
        "white metal; give the material a Principled BSDF, or bake it");
    return result_ok();
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

static result_t fill(maker_t *m)
{
    item_t unshaded;
    TRY(item_extension(m->item, "KHR_materials_unlit", &unshaded));
    TRY(find_base(m));
    TRY(base_colour(m));
    if (unshaded.json) return unlit(m);
    TRY(m->is_glossy ? specular_glossiness(m) : metallic_roughness(m));
    TRY(normal_map(m, m->item, "normalTexture", &m->record.normal_map, &m->record.normal_scale));
    TRY(alpha(m));
    TRY(emission(m));
    TRY(extensions_of_metallic_roughness(m));
    TRY(tell_of_lost_nodes(m));
    return emitting_sides(m);
}

/* On a mesh without TANGENT normal maps lie along the texture coordinates of the normal texture (the glTF 2.0
 * specification, section 3.7.2.1), and the renderer's along those that are a mesh's first. Where the normal
 * texture has the second, the two change places: here in the textures from the first on that the material
 * made, and in its meshes when they are read. */
static void choose_first_set(maker_t *m, uint32_t first)
{
    blob_builder_t *blob = m->document->builder->blob;
    blob_texture_t *textures = blob_builder_records(blob, BLOB_SECTION_TEXTURES);
    blob_ref_t base = m->record.normal_map, coat = m->record.coat_normal_map, map = base ? base : coat;
    if (base && coat && textures[base - 1].mapping != textures[coat - 1].mapping)
        item_warn(m->item,
                  "its normal maps have different texture coordinates; on a mesh without TANGENT both lie "
                  "along those of normalTexture");
    m->out->swaps_sets = map && textures[map - 1].mapping == MAPPING_UV2;
    if (!m->out->swaps_sets) return;
    for (uint32_t i = first; i < blob_builder_count(blob, BLOB_SECTION_TEXTURES); ++i)
        if (textures[i].kind == TEXTURE_IMAGE)
            textures[i].mapping = textures[i].mapping == MAPPING_UV ? MAPPING_UV2 : MAPPING_UV;
}

result_t material_get(document_t *document, uint32_t index, bool coloured, const gltf_material_t **material)
{
    size_t count = document_count(document, TOP_MATERIALS);
    gltf_material_t *out = &document->materials[coloured][index == ITEM_NONE ? count : index];
    *material = out;
    if (out->made) return result_ok();
    item_t item = document->root;
    item.json = NULL;
    const char *name = "default";
    if (index != ITEM_NONE) {
        name = "";
        TRY(document_item(document, TOP_MATERIALS, index, &item));
        TRY(item_string(&item, "name", &name));
    }
    maker_t m = {.document = document, .item = &item, .coloured = coloured, .out = out};
    m.record.kind = MATERIAL_GLTF;
    m.record.flags = MATERIAL_REMAP_SQUARE;
    uint32_t first_texture = blob_builder_count(document->builder->blob, BLOB_SECTION_TEXTURES);
    TRY(fill(&m));
    choose_first_set(&m, first_texture);
    m.record.name = blob_builder_string(document->builder->blob, name);
    out->index = blob_builder_add(document->builder->blob, BLOB_SECTION_MATERIALS, &m.record, 1);
    out->needs_tangents = m.record.normal_map != 0 || m.record.coat_normal_map != 0 ||
                          m.record.values[VALUE_ANISOTROPIC].factor.x != 0;
    out->has_images = scene_has_images(document->builder, first_texture);
    out->made = true;
    return result_ok();
}

/* ---- variants (KHR_materials_variants) ----------------------------------------------------------------- */

/* The file names its variants once; a primitive says which material it has in which of them. */
static const char variants_extension[] = "KHR_materials_variants";

static result_t all_variants(const document_t *document, item_t *extension, item_t *variants)
{
    TRY(item_extension(&document->root, variants_extension, extension));
    return item_member(extension, "variants", JSON_ARRAY, variants);
}

/* By its name, else by its number. */
static result_t find_variant(const item_t *variants, const char *wanted, size_t *index, bool *found)
{
    *found = true;
    for (*index = 0; *index < item_count(variants); ++*index) {
        const char *name;
        TRY(item_name_at(variants, *index, &name));
        if (strcmp(name, wanted) == 0) return result_ok();
    }
    *found = wishes_number(wanted, item_count(variants), index);
    return result_ok();
}

result_t variant_choose(document_t *document)
{
    const import_wishes_t *wishes = document->builder->report->sink.wishes;
    item_t extension, variants;
    char list[ITEM_LIST_ROOM];
    document->variant = ITEM_NONE;
    TRY(all_variants(document, &extension, &variants));
    TRY(item_list_names(&variants, list));
    size_t count = item_count(&variants), index = 0;
    if (!wishes || !wishes->variant) {
        if (count > 0)
            item_warn(
                &extension,
                "the scene has %zu variants (%s); its materials are taken as they stand, --variant takes "
                "one of these",
                count, list);
        return result_ok();
    }
    bool found;
    TRY(find_variant(&variants, wishes->variant, &index, &found));
    if (!found)
        return result_fail(RESULT_USAGE, "--variant: the scene has no variant '%.100s'; it has %zu%s%s",
                           wishes->variant, count, list[0] ? ": " : "", list);
    document->variant = (uint32_t)index;
    return result_ok();
}

/* Whether a mapping is for the variant that is asked for. */
static result_t is_meant(const document_t *document, const item_t *mapping, size_t count, bool *meant)
{
    item_t list;
    *meant = false;
    TRY(item_member(mapping, "variants", JSON_ARRAY, &list));
    for (size_t i = 0; i < item_count(&list); ++i) {
        uint32_t variant = 0;
        TRY(item_index_at(&list, i, count, "variants", &variant));
        *meant = *meant || variant == document->variant;
    }
    return result_ok();
}

result_t variant_material(const document_t *document, const item_t *primitive, uint32_t *material)
{
    size_t materials = document_count(document, TOP_MATERIALS);
    item_t extension, mappings, root, variants;
    TRY(item_index(primitive, "material", materials, material));
    if (document->variant == ITEM_NONE) return result_ok();
    TRY(all_variants(document, &root, &variants));
    TRY(item_extension(primitive, variants_extension, &extension));
    TRY(item_member(&extension, "mappings", JSON_ARRAY, &mappings));
    for (size_t i = 0; i < item_count(&mappings); ++i) {
        item_t mapping;
        bool meant;
        TRY(item_element(&mappings, i, JSON_OBJECT, &mapping));
        TRY(is_meant(document, &mapping, item_count(&variants), &meant));
        if (meant) return item_index(&mapping, "material", materials, material);
    }
    return result_ok();
}
