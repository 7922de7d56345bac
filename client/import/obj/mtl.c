/* mtl: see mtl.h. Reading gathers what the statements of a material say; making puts it into the blob. */
#include "client/import/obj/mtl.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "client/import/files/lines.h"
#include "client/import/scene/scene_images.h"

static const size_t largest_file = (size_t)1 << 30;

typedef enum { KD, KS, KE, TF, COLOURS } colour_t;
typedef enum { NS, NI, DISSOLVE, TRANSPARENCY, ILLUM, PR, PM, PC, PCR, NUMBERS } number_t;
typedef enum { MAP_KD, MAP_KS, MAP_KE, MAP_D, MAP_PR, MAP_PM, MAP_NORMAL, MAP_BUMP, MAPS } map_kind_t;

/* An image, and how it lies on the surface: (u, v) times scale plus offset. Owned: name. */
typedef struct {
    char *name; /* NULL: no map */
    position_t at;
    double scale[2], offset[2];
    double gain; /* of -bm */
    bool has_gain, clamp;
    uint32_t channel; /* channel_t; 0: not said */
} map_t;

struct mtl_entry {
    position_t at;
    double colours[COLOURS][3];
    double numbers[NUMBERS];
    bool has_colour[COLOURS], has_number[NUMBERS];
    map_t maps[MAPS];
    mtl_material_t made;
};
typedef struct mtl_entry entry_t;

/* ---- files --------------------------------------------------------------------------------------------- */

static char *existing(char *path)
{
    if (access(path, F_OK) == 0) return path;
    free(path);
    return NULL;
}

/* The path of an existing file that a file at `beside` names: as it is named, relative to the other's folder,
 * else of that name in that folder. '\' counts as '/'. NULL when there is none; the caller frees it. */
static char *path_beside(const char *beside, const char *name)
{
    const char *slash = strrchr(beside, '/');
    int folder = slash ? (int)(slash + 1 - beside) : 0;
    char *named = mem_strdup(name);
    for (char *c = named; *c; ++c)
        if (*c == '\\') *c = '/';
    const char *last = strrchr(named, '/');
    char *found = existing(named[0] == '/' ? mem_strdup(named) : mem_printf("%.*s%s", folder, beside, named));
    if (!found && last) found = existing(mem_printf("%.*s%s", folder, beside, last + 1));
    free(named);
    return found;
}

/* ---- reading ------------------------------------------------------------------------------------------- */

static result_t read_colour(mtl_t *mtl, entry_t *entry, colour_t which, line_t *line)
{
    double *c = entry->colours[which];
    line_t start = *line;
    word_t word;
    char quote[WORD_QUOTE_SIZE];
    if (!line_number(line, &c[0])) {
        bool other = line_word(&start, &word) && (word_is(word, "spectral") || word_is(word, "xyz"));
        if (other)
            return report_refuse(mtl->scene->report, line->at,
                                 "colours must be red, green and blue, found %s; the nearest is the default",
                                 word_quote(word, quote));
        return error_at(line->at, "expected red, green and blue");
    }
    c[1] = c[2] = c[0];
    if (line_number(line, &c[1]) && !line_number(line, &c[2]))
        return error_at(line->at, "expected one number, or red, green and blue");
    for (int i = 0; i < 3; ++i) {
        if (c[i] < 0) report_warning(mtl->scene->report, line->at, "a colour below 0 is taken for 0");
        c[i] = fmin(fmax(c[i], 0), 1e12);
        if (mtl->encoded) c[i] = scene_decode_srgb(c[i]);
    }
    entry->has_colour[which] = true;
    return result_ok();
}

static result_t read_number(entry_t *entry, number_t which, line_t *line)
{
    line_t start = *line;
    word_t word;
    bool halo = line_word(&start, &word) && word_is(word, "-halo");
    if (halo) *line = start;
    if (!line_number(line, &entry->numbers[which])) return error_at(line->at, "expected a number");
    entry->has_number[which] = true;
    return result_ok();
}

/* What an option of a map takes; those without a meaning here are passed over. */
static const struct {
    const char *name;
    int most; /* words, as far as they are numbers; -1: one word, whatever it is */
} map_options[] = {
    {"-o", 3},     {"-s", 3},        {"-t", 3},       {"-mm", 2},      {"-bm", 1},
    {"-boost", 1}, {"-texres", 1},   {"-blendu", -1}, {"-blendv", -1}, {"-clamp", -1},
    {"-cc", -1},   {"-imfchan", -1}, {"-type", -1},
};

static void take_option(map_t *map, const char *name, const double *n, int count, word_t word)
{
    static const struct {
        char letter;
        channel_t channel;
    } channels[] = {
        {'r', CHANNEL_R}, {'g', CHANNEL_G}, {'b', CHANNEL_B}, {'m', CHANNEL_A}, {'l', CHANNEL_LUMINANCE}};
    if (strcmp(name, "-o") == 0) memcpy(map->offset, n, (size_t)int_min(count, 2) * sizeof *n);
    if (strcmp(name, "-s") == 0) memcpy(map->scale, n, (size_t)int_min(count, 2) * sizeof *n);
    if (strcmp(name, "-clamp") == 0) map->clamp = word_is(word, "on");
    if (strcmp(name, "-bm") == 0 && count == 1) {
        map->gain = n[0];
        map->has_gain = true;
    }
    for (size_t i = 0; strcmp(name, "-imfchan") == 0 && i < ARRAY_LENGTH(channels); ++i)
        if (word.length == 1 && word.text[0] == channels[i].letter) map->channel = channels[i].channel;
}

/* Reads one option; false when the next word is none, and so begins the file's name. */
static bool read_option(map_t *map, line_t *line)
{
    line_t start = *line;
    word_t word;
    if (!line_word(line, &word)) return false;
    for (size_t i = 0; i < ARRAY_LENGTH(map_options); ++i) {
        if (!word_is(word, map_options[i].name)) continue;
        double n[3] = {0};
        int count = 0;
        word_t value = {"", 0};
        while (count < map_options[i].most && line_number(line, &n[count])) ++count;
        if (map_options[i].most < 0) line_word(line, &value);
        take_option(map, map_options[i].name, n, count, value);
        return true;
    }
    *line = start;
    return false;
}

static result_t read_map(entry_t *entry, map_kind_t which, line_t *line)
{
    map_t map = {.at = line->at, .scale = {1, 1}, .gain = 1};
    while (read_option(&map, line)) continue;
    word_t name = line_rest(line);
    if (name.length == 0) return error_at(line->at, "expected the name of an image file");
    map.name = mem_printf("%.*s", (int)(name.length < 4096 ? name.length : 4096), name.text);
    free(entry->maps[which].name);
    entry->maps[which] = map;
    return result_ok();
}

/* What a statement sets. */
static const struct {
    const char *name;
    enum { A_COLOUR, A_NUMBER, A_MAP, NOTHING } what; /* NOTHING: it means nothing to a path tracer */
    int which;
} statements[] = {
    {"Kd", A_COLOUR, KD},
    {"Ks", A_COLOUR, KS},
    {"Ke", A_COLOUR, KE},
    {"Tf", A_COLOUR, TF},
    {"Ns", A_NUMBER, NS},
    {"Ni", A_NUMBER, NI},
    {"d", A_NUMBER, DISSOLVE},
    {"Tr", A_NUMBER, TRANSPARENCY},
    {"illum", A_NUMBER, ILLUM},
    {"Pr", A_NUMBER, PR},
    {"Pm", A_NUMBER, PM},
    {"Pc", A_NUMBER, PC},
    {"Pcr", A_NUMBER, PCR},
    {"map_Kd", A_MAP, MAP_KD},
    {"map_Ks", A_MAP, MAP_KS},
    {"map_Ke", A_MAP, MAP_KE},
    {"map_d", A_MAP, MAP_D},
    {"map_Pr", A_MAP, MAP_PR},
    {"map_Pm", A_MAP, MAP_PM},
    {"norm", A_MAP, MAP_NORMAL},
    {"map_Norm", A_MAP, MAP_NORMAL},
    {"map_bump", A_MAP, MAP_BUMP},
    {"bump", A_MAP, MAP_BUMP},
    {"map_opacity", A_MAP, MAP_D},
    {"Ka", NOTHING, 0},
    {"map_Ka", NOTHING, 0},
    {"sharpness", NOTHING, 0},
};

static result_t read_statement(mtl_t *mtl, entry_t *entry, line_t *line)
{
    char quote[WORD_QUOTE_SIZE];
    for (size_t i = 0; i < ARRAY_LENGTH(statements); ++i) {
        if (strlen(statements[i].name) != line->keyword.length ||
            strncasecmp(statements[i].name, line->keyword.text, line->keyword.length) != 0)
            continue;
        switch (statements[i].what) {
        case A_COLOUR:
            return read_colour(mtl, entry, (colour_t)statements[i].which, line);
        case A_NUMBER:
            return read_number(entry, (number_t)statements[i].which, line);
        case A_MAP:
            return read_map(entry, (map_kind_t)statements[i].which, line);
        default:
            return result_ok();
        }
    }
    report_warning(mtl->scene->report, line->at, "the statement %s is ignored",
                   word_quote(line->keyword, quote));
    return result_ok();
}

static void clear(entry_t *entry)
{
    for (int i = 0; i < MAPS; ++i) free(entry->maps[i].name);
    *entry = (entry_t){0};
}

/* The entry of a newmtl statement, empty. */
static entry_t *begin_entry(mtl_t *mtl, line_t *line)
{
    word_t name = line_rest(line);
    size_t before = mtl->names.count;
    uint32_t number = intern_add(&mtl->names, name.text, name.length);
    mtl->entries = grow(mtl->entries, &mtl->entry_capacity, mtl->names.count, sizeof *mtl->entries);
    if (number == before)
        mtl->entries[number] = (entry_t){0};
    else
        report_warning(mtl->scene->report, line->at, "material \"%.60s\" is defined twice; this one counts",
                       mtl->names.texts[number]);
    clear(&mtl->entries[number]);
    mtl->entries[number].at = line->at;
    return &mtl->entries[number];
}

static result_t read_lines(mtl_t *mtl, lines_t lines)
{
    entry_t *entry = NULL;
    line_t line;
    while (lines_next(&lines, &line)) {
        if (word_is(line.keyword, "newmtl"))
            entry = begin_entry(mtl, &line);
        else if (!entry)
            return error_at(line.at,
                            "expected newmtl and a name first; is it a library of materials (.mtl)?");
        else
            TRY(read_statement(mtl, entry, &line));
    }
    return result_ok();
}

static result_t read_library(mtl_t *mtl, const char *path)
{
    uint8_t *data;
    size_t size;
    TRY(file_read(path, largest_file, &data, &size));
    mtl->scene->source_bytes += size;
    mtl->paths = grow(mtl->paths, &mtl->path_capacity, mtl->path_count + 1, sizeof *mtl->paths);
    char *kept = mtl->paths[mtl->path_count++] = mem_strdup(path);
    result_t result = read_lines(mtl, lines_begin(kept, (const char *)data, size));
    free(data);
    return result;
}

result_t mtl_read_libraries(mtl_t *mtl, const char *beside, const intern_t *libraries)
{
    for (size_t i = 0; i < libraries->count; ++i) {
        char *library = path_beside(beside, libraries->texts[i]);
        result_t result = result_ok();
        if (library)
            result = read_library(mtl, library);
        else
            report_warning(mtl->scene->report, (position_t){beside, 0, 0},
                           "its library of materials %.200s is missing", libraries->texts[i]);
        free(library);
        TRY(result);
    }
    return result_ok();
}

bool mtl_has(const mtl_t *mtl, const char *name)
{
    uint32_t number;
    return intern_find(&mtl->names, name, strlen(name), &number);
}

/* ---- maps ---------------------------------------------------------------------------------------------- */

/* A material while it is made. */
typedef struct {
    scene_builder_t *scene;
    const entry_t *entry;
    blob_material_t record;
    mtl_material_t *out;
} maker_t;

/* The image of a map; NULL when it is not to be had, which `instead` says what is done about. */
static result_t find_image(const maker_t *m, const map_t *map, float gamma, const scene_image_t **image)
{
    report_t *report = m->scene->report;
    *image = NULL;
    char *path = path_beside(map->at.path, map->name);
    if (!path)
        return report_refuse(report, map->at, "the image %.200s is missing; the nearest is to do without",
                             map->name);
    result_t result = scene_image_of_file(m->scene, path, gamma, SCENE_ALPHA_APART, map->at, image);
    free(path);
    if (result.code == RESULT_OK || !report->sink.lenient) return result;
    report_warning(report, map->at, "the image %.200s cannot be read; the material does without", map->name);
    return result_ok();
}

static blob_value_t add_texture(const maker_t *m, const map_t *map, blob_ref_t image, channel_t channel,
                                double gain)
{
    blob_texture_t texture = {.kind = TEXTURE_IMAGE,
                              .mapping = MAPPING_UV,
                              .image = image,
                              .channel = channel,
                              .inputs = {blob_constant((float)gain)},
                              .texture_from_world = xform_identity()};
    texture.wrap_s = texture.wrap_t = map->clamp ? WRAP_CLAMP : WRAP_REPEAT;
    texture.matrix[0][0] = (float)map->scale[0];
    texture.matrix[0][2] = (float)map->offset[0];
    texture.matrix[1][1] = (float)-map->scale[1]; /* v = 0 is an image's bottom row */
    texture.matrix[1][2] = (float)(1 - map->offset[1]);
    return scene_add_texture(m->scene, &texture);
}

/* factor times a map of colours. */
static result_t colour_map(const maker_t *m, map_kind_t which, rgb_t factor, blob_value_t *value)
{
    const map_t *map = &m->entry->maps[which];
    const scene_image_t *image = NULL;
    *value = blob_colour_value(factor);
    if (map->name) TRY(find_image(m, map, SCENE_GAMMA_OF_FILE, &image));
    if (!image) return result_ok();
    *value = add_texture(m, map, image->image, map->channel ? map->channel : CHANNEL_RGB, 1);
    value->factor = factor;
    return result_ok();
}

/* factor times a map of numbers: the luminance, or, of an opacity, an alpha that is not 1 everywhere. */
static result_t number_map(const maker_t *m, map_kind_t which, double factor, blob_value_t *value)
{
    const map_t *map = &m->entry->maps[which];
    const scene_image_t *image = NULL;
    *value = blob_constant((float)factor);
    if (map->name) TRY(find_image(m, map, 1, &image));
    if (!image) return result_ok();
    bool alpha = which == MAP_D && image->alpha != 0 && map->channel == 0;
    channel_t channel = alpha ? CHANNEL_R : map->channel ? map->channel : CHANNEL_LUMINANCE;
    *value = add_texture(m, map, alpha ? image->alpha : image->image, channel, 1);
    value->factor = vec3((float)factor, (float)factor, (float)factor);
    return result_ok();
}

/* ---- making -------------------------------------------------------------------------------------------- */

static rgb_t colour_of(const entry_t *entry, colour_t which, double otherwise)
{
    const double *c = entry->colours[which];
    if (!entry->has_colour[which]) return vec3((float)otherwise, (float)otherwise, (float)otherwise);
    return vec3((float)c[0], (float)c[1], (float)c[2]);
}

static double number_of(const entry_t *entry, number_t which, double low, double high, double otherwise)
{
    return entry->has_number[which] ? fmin(fmax(entry->numbers[which], low), high) : otherwise;
}

/* The colour of a map's factor: where a program wrote black beside a map it means the map alone. */
static rgb_t factor_of(const maker_t *m, colour_t which, map_kind_t map, double otherwise)
{
    const entry_t *entry = m->entry;
    rgb_t factor = colour_of(entry, which, entry->maps[map].name ? 1 : otherwise);
    if (!entry->maps[map].name || !v_is_zero(factor)) return factor;
    report_warning(m->scene->report, entry->maps[map].at,
                   "the colour that multiplies this map is black, and taken for white");
    return vec3(1, 1, 1);
}

/* illum 3, 4, 5 and 8 trace reflections, 6 and 7 refractions. */
static bool traces_reflections(int illum)
{
    return (illum >= 3 && illum <= 5) || illum == 8;
}

/* An exponent of Blinn's as a width of normals (Walter et al. 2007, section 5.3). */
static double alpha_of_exponent(double exponent)
{
    return sqrt(2 / (exponent + 2));
}

static result_t make_glass(maker_t *m)
{
    double eta = number_of(m->entry, NI, 0, 10, 1.5);
    double exponent = number_of(m->entry, NS, 0, 1e7, 1e7);
    if (!(eta > 1.0001)) {
        report_warning(m->scene->report, m->entry->at,
                       "glass (illum 6, 7) with an index Ni of %g is taken for 1.5", eta);
        eta = 1.5;
    }
    m->record.kind = MATERIAL_DIELECTRIC;
    m->record.values[VALUE_REFLECTANCE] = blob_constant(1);
    m->record.values[VALUE_TRANSMITTANCE] = blob_colour_value(colour_of(m->entry, TF, 1));
    m->record.values[VALUE_ETA] = blob_constant((float)eta);
    double alpha = exponent < 1000 ? alpha_of_exponent(exponent) : 0;
    m->record.values[VALUE_ROUGHNESS_U] = m->record.values[VALUE_ROUGHNESS_V] = blob_constant((float)alpha);
    return result_ok();
}

/* The index that makes Ks what the surface reflects where it is seen straight on: for traced reflections Ks
 * is all of it, for highlights a share of what a dielectric reflects. */
static float specular_index(const maker_t *m, int illum)
{
    double eta = number_of(m->entry, NI, 0, 10, 1.5);
    if (traces_reflections(illum)) return 1e4f;
    return eta > 1.0001 ? (float)eta : 1.5f;
}

static result_t make_glossy(maker_t *m, int illum)
{
    rgb_t specular = factor_of(m, KS, MAP_KS, 0);
    blob_value_t *values = m->record.values;
    m->record.kind = MATERIAL_GLTF;
    m->record.flags = MATERIAL_THIN;
    values[VALUE_SPECULAR] = blob_constant(1);
    values[VALUE_ETA] = blob_constant(specular_index(m, illum));
    values[VALUE_ROUGHNESS_U] = blob_constant((float)alpha_of_exponent(number_of(m->entry, NS, 0, 1e7, 0)));
    return colour_map(m, MAP_KS, specular, &values[VALUE_SPECULAR_COLOUR]);
}

/* The statements that newer programs write: roughness, metalness, coat. */
static result_t make_pbr(maker_t *m)
{
    blob_value_t *values = m->record.values;
    m->record.kind = MATERIAL_GLTF;
    m->record.flags = MATERIAL_THIN | MATERIAL_REMAP_SQUARE;
    values[VALUE_SPECULAR] = values[VALUE_SPECULAR_COLOUR] = blob_constant(1);
    values[VALUE_ETA] = blob_constant(specular_index(m, 2));
    values[VALUE_CLEARCOAT] = blob_constant((float)number_of(m->entry, PC, 0, 1, 0));
    values[VALUE_CLEARCOAT_ROUGHNESS] = blob_constant((float)number_of(m->entry, PCR, 0, 1, 0));
    bool mapped = m->entry->maps[MAP_PM].name != NULL;
    TRY(number_map(m, MAP_PM, number_of(m->entry, PM, 0, 1, mapped), &values[VALUE_METALLIC]));
    mapped = m->entry->maps[MAP_PR].name != NULL;
    return number_map(m, MAP_PR, number_of(m->entry, PR, 0, 1, mapped ? 1 : 0.5), &values[VALUE_ROUGHNESS_U]);
}

static result_t make_surface(maker_t *m)
{
    const entry_t *entry = m->entry;
    bool pbr = entry->has_number[PR] || entry->has_number[PM] || entry->maps[MAP_PR].name ||
               entry->maps[MAP_PM].name;
    bool glossy = entry->maps[MAP_KS].name || !v_is_zero(colour_of(entry, KS, 0));
    int illum = (int)number_of(entry, ILLUM, 0, 10, glossy ? 2 : 1);
    if (illum == 6 || illum == 7) return make_glass(m);
    m->record.kind = MATERIAL_DIFFUSE;
    TRY(colour_map(m, MAP_KD, factor_of(m, KD, MAP_KD, 0.5), &m->record.values[VALUE_REFLECTANCE]));
    if (pbr) return make_pbr(m);
    return glossy && illum >= 2 ? make_glossy(m, illum) : result_ok();
}

static void add_normals(maker_t *m, const map_t *map, blob_ref_t image)
{
    m->record.normal_map = add_texture(m, map, image, CHANNEL_RGB, 1).texture;
    m->record.normal_scale = (float)map->gain;
}

/* Blender writes "map_Bump -bm STRENGTH" for an image of normals. */
static void add_bump(maker_t *m, const map_t *map, blob_ref_t image)
{
    if (map->channel != 0 || !scene_image_holds_normals(m->scene, image)) {
        m->record.bump = add_texture(m, map, image, CHANNEL_LUMINANCE, map->gain).texture;
        return;
    }
    report_warning(m->scene->report, map->at,
                   "this bump map holds normals and not heights: it is taken for a normal map of strength %g",
                   map->gain);
    add_normals(m, map, image);
}

static result_t make_bumps(maker_t *m)
{
    const map_t *normal = &m->entry->maps[MAP_NORMAL], *bump = &m->entry->maps[MAP_BUMP];
    const scene_image_t *image = NULL;
    if (normal->name) TRY(find_image(m, normal, 1, &image));
    if (image) {
        add_normals(m, normal, image->image);
        return result_ok();
    }
    if (!bump->name) return result_ok();
    if (!bump->has_gain) {
        report_warning(m->scene->report, bump->at,
                       "a bump map without a height is left out; give it \"-bm HEIGHT\" in the scene's unit");
        return result_ok();
    }
    TRY(find_image(m, bump, 1, &image));
    if (image) add_bump(m, bump, image->image);
    return result_ok();
}

/* d, or 1 - Tr; glass is seen through by refraction instead. */
static result_t make_alpha(maker_t *m)
{
    const entry_t *entry = m->entry;
    double opacity = number_of(entry, DISSOLVE, 0, 1, 1 - number_of(entry, TRANSPARENCY, 0, 1, 0));
    m->out->alpha = blob_constant(1);
    if (m->record.kind == MATERIAL_DIELECTRIC) return result_ok();
    if (opacity == 0 && !entry->has_number[DISSOLVE]) {
        report_warning(m->scene->report, entry->at,
                       "Tr 1 would make it invisible, and is taken for opaque as many programs write it; d 0 "
                       "makes it invisible");
        opacity = 1;
    } else if (opacity == 0) {
        report_warning(m->scene->report, entry->at, "d 0 makes what has this material invisible");
    }
    return number_map(m, MAP_D, opacity, &m->out->alpha);
}

static result_t make_emission(maker_t *m)
{
    rgb_t radiance = factor_of(m, KE, MAP_KE, 0);
    m->out->emits = !v_is_zero(radiance);
    return m->out->emits ? colour_map(m, MAP_KE, radiance, &m->out->emission) : result_ok();
}

static result_t make(mtl_t *mtl, const entry_t *entry, const char *name, mtl_material_t *out)
{
    maker_t m = {.scene = mtl->scene, .entry = entry, .out = out};
    uint32_t first_texture = blob_builder_count(mtl->scene->blob, BLOB_SECTION_TEXTURES);
    TRY(make_surface(&m));
    TRY(make_bumps(&m));
    TRY(make_alpha(&m));
    TRY(make_emission(&m));
    m.record.name = blob_builder_string(mtl->scene->blob, name);
    out->index = blob_builder_add(mtl->scene->blob, BLOB_SECTION_MATERIALS, &m.record, 1);
    out->has_images = scene_has_images(mtl->scene, first_texture);
    out->made = true;
    return result_ok();
}

result_t mtl_material(mtl_t *mtl, const char *name, position_t at, const mtl_material_t **material)
{
    static const entry_t plain = {0};
    uint32_t number;
    if (name && intern_find(&mtl->names, name, strlen(name), &number)) {
        entry_t *entry = &mtl->entries[number];
        *material = &entry->made;
        return entry->made.made ? result_ok() : make(mtl, entry, name, &entry->made);
    }
    if (name)
        report_warning(mtl->scene->report, at,
                       "no library has the material \"%.60s\"; a grey diffuse one is taken", name);
    *material = &mtl->otherwise;
    return mtl->otherwise.made ? result_ok() : make(mtl, &plain, "default", &mtl->otherwise);
}

void mtl_free(mtl_t *mtl)
{
    for (size_t i = 0; i < mtl->names.count; ++i) clear(&mtl->entries[i]);
    for (size_t i = 0; i < mtl->path_count; ++i) free(mtl->paths[i]);
    free(mtl->entries);
    free(mtl->paths);
    intern_free(&mtl->names);
    *mtl = (mtl_t){0};
}
