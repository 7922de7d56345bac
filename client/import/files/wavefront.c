/* wavefront: see wavefront.h. Faces are gathered as triangles of corners while the file is read, one list a
 * part; afterwards each part gets vertices of its own, one for each triple of indices that it has. */
#include "client/import/files/wavefront.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "client/import/files/lines.h"
#include "client/import/files/polygon.h"

static const size_t largest_file = (size_t)1 << 36;
/* Of polygon.h, of a file, which is a few seconds of work; and what each corner of a face adds to it. */
static const uint64_t patience_of_file = (uint64_t)1 << 30, patience_of_corner = 512;

/* Indices from 0 into the file's lists; uv and normal may be WAVEFRONT_NONE. */
typedef struct {
    uint32_t position, uv, normal;
} corner_t;

typedef struct {
    corner_t *items; /* three a triangle */
    size_t count, capacity;
} corners_t;

/* What has been warned of, once a file. */
typedef enum {
    SAID_LINES,
    SAID_COLOURS,
    SAID_SMOOTH,
    SAID_ABSENT,
    SAID_CUT,
    SAID_IGNORED,
    SAID_COUNT
} said_t;

typedef struct {
    lines_t lines;
    scene_builder_t *scene;
    wavefront_t *out;
    vec3_t *positions, *normals;
    vec2_t *uvs;
    size_t position_count, normal_count, uv_count;
    size_t position_capacity, normal_capacity, uv_capacity;
    corners_t *faces; /* of each part */
    size_t face_capacity;
    intern_t parts;          /* name, material and smoothness of each part, as text */
    uint32_t name, material; /* of the faces that come */
    uint32_t part[2];        /* theirs, flat and smooth; WAVEFRONT_NONE: not made yet */
    bool smoothing;          /* a smoothing group is on */
    bool said[SAID_COUNT];
    corner_t *polygon; /* the corners of the face that is being read */
    vec3_t *outline;
    size_t polygon_capacity, outline_capacity;
    uint64_t patience; /* for cutting faces: see polygon.h */
} reader_t;

static const char nothing_to_see[] = "points and lines have no surface and are left out";

static void say_once(reader_t *r, said_t what, position_t at, const char *text)
{
    if (!r->said[what]) report_warning(r->scene->report, at, "%s", text);
    r->said[what] = true;
}

/* ---- v, vt, vn ----------------------------------------------------------------------------------------- */

static result_t read_numbers(line_t *line, int least, int most, double *numbers, int *count)
{
    word_t word;
    char quote[WORD_QUOTE_SIZE];
    *count = 0;
    while (*count < most && line_number(line, &numbers[*count])) ++*count;
    if (*count < least) {
        if (line_word(line, &word))
            return error_at(line->at, "expected a number, found %s", word_quote(word, quote));
        return error_at(line->at, "expected %d numbers, found %d", least, *count);
    }
    return result_ok();
}

static result_t add_position(reader_t *r, line_t *line)
{
    double n[7] = {0};
    int count;
    TRY(read_numbers(line, 3, 7, n, &count));
    if (count >= 6) say_once(r, SAID_COLOURS, line->at, "colours at vertices are not read");
    r->positions = grow(r->positions, &r->position_capacity, r->position_count + 1, sizeof *r->positions);
    r->positions[r->position_count++] = vec3((float)n[0], (float)n[1], (float)n[2]);
    return result_ok();
}

static result_t add_normal(reader_t *r, line_t *line)
{
    double n[3];
    int count;
    TRY(read_numbers(line, 3, 3, n, &count));
    r->normals = grow(r->normals, &r->normal_capacity, r->normal_count + 1, sizeof *r->normals);
    r->normals[r->normal_count++] = vec3((float)n[0], (float)n[1], (float)n[2]);
    return result_ok();
}

static result_t add_uv(reader_t *r, line_t *line)
{
    double n[3] = {0};
    int count;
    TRY(read_numbers(line, 1, 3, n, &count));
    r->uvs = grow(r->uvs, &r->uv_capacity, r->uv_count + 1, sizeof *r->uvs);
    r->uvs[r->uv_count++] = (vec2_t){(float)n[0], (float)n[1]};
    return result_ok();
}

/* ---- f ------------------------------------------------------------------------------------------------- */

/* One index of a corner, from 1 or, negative, back from the last of `count`. */
static bool read_index(const char **at, const char *end, size_t count, uint32_t *index)
{
    bool negative = *at < end && **at == '-';
    uint64_t number = 0;
    const char *digits = *at + negative;
    const char *s = digits;
    for (; s < end && *s >= '0' && *s <= '9'; ++s)
        if (number < (uint64_t)1 << 40) number = 10 * number + (uint64_t)(*s - '0');
    *at = s;
    if (s == digits || number == 0 || number > count) return false;
    *index = (uint32_t)(negative ? count - number : number - 1);
    return true;
}

/* The same of texture coordinates or normals, which a corner can do without: some programs write indices of
 * what the file has none of, or too few. */
static bool read_other_index(reader_t *r, position_t where, const char **at, const char *end, size_t count,
                             uint32_t *index)
{
    const char *begin = *at;
    uint32_t absent;
    if (read_index(at, end, count, index)) return true;
    *at = begin;
    if (!read_index(at, end, UINT32_MAX, &absent)) return false;
    say_once(r, SAID_ABSENT, where, "corners do without the vt or vn of their indices, which are not above");
    return true;
}

/* position, position/uv, position//normal or position/uv/normal. */
static result_t read_corner(reader_t *r, position_t where, word_t word, corner_t *corner)
{
    const char *at = word.text, *end = at + word.length;
    char quote[WORD_QUOTE_SIZE];
    bool good = read_index(&at, end, r->position_count, &corner->position);
    corner->uv = corner->normal = WAVEFRONT_NONE;
    if (good && at < end && *at == '/') {
        ++at;
        if (at < end && *at != '/') good = read_other_index(r, where, &at, end, r->uv_count, &corner->uv);
        if (good && at < end && *at == '/') {
            ++at;
            if (at < end) good = read_other_index(r, where, &at, end, r->normal_count, &corner->normal);
        }
    }
    if (good && at == end) return result_ok();
    return error_at(where,
                    "%s is no corner of a face: it must be vertex/texture/normal, of the %zu v, %zu vt and "
                    "%zu vn above this line, counted from 1",
                    word_quote(word, quote), r->position_count, r->uv_count, r->normal_count);
}

/* The part that takes faces of the current name and material, made when the first one comes. */
static corners_t *current_part(reader_t *r, bool smooth, position_t at)
{
    wavefront_t *out = r->out;
    if (r->part[smooth] == WAVEFRONT_NONE) {
        uint32_t key[3] = {r->name, r->material, smooth};
        char text[32];
        int length = snprintf(text, sizeof text, "%" PRIx32 " %" PRIx32 " %" PRIx32, key[0], key[1], key[2]);
        r->part[smooth] = intern_add(&r->parts, text, (size_t)length);
    }
    uint32_t index = r->part[smooth];
    if (index == out->part_count) {
        out->parts = grow(out->parts, &out->part_capacity, out->part_count + 1, sizeof *out->parts);
        r->faces = grow(r->faces, &r->face_capacity, out->part_count + 1, sizeof *r->faces);
        out->parts[index] = (wavefront_part_t){.name = r->name, .material = r->material, .at = at};
        r->faces[index] = (corners_t){0};
        ++out->part_count;
    }
    return &r->faces[index];
}

/* Cuts the polygon of `count` corners into triangles of the part. */
static void add_triangles(reader_t *r, position_t at, corners_t *part, size_t count)
{
    part->items = grow(part->items, &part->capacity, part->count + 3 * (count - 2), sizeof *part->items);
    uint32_t *triangles = mem_alloc(3 * (count - 2) * sizeof *triangles);
    r->patience += patience_of_corner * count;
    if (!polygon_cut(r->outline, count, triangles, &r->patience))
        say_once(r, SAID_CUT, at,
                 "this face crosses itself, or has so many corners that cutting it takes too long: what is "
                 "left of it becomes a fan, which may cover what the face does not; export triangles");
    for (size_t i = 0; i < 3 * (count - 2); ++i) part->items[part->count++] = r->polygon[triangles[i]];
    free(triangles);
}

static result_t add_face(reader_t *r, line_t *line)
{
    size_t count = 0;
    bool smooth = true;
    word_t word;
    while (line_word(line, &word)) {
        r->polygon = grow(r->polygon, &r->polygon_capacity, count + 1, sizeof *r->polygon);
        r->outline = grow(r->outline, &r->outline_capacity, count + 1, sizeof *r->outline);
        TRY(read_corner(r, line->at, word, &r->polygon[count]));
        r->outline[count] = r->positions[r->polygon[count].position];
        smooth = smooth && r->polygon[count].normal != WAVEFRONT_NONE;
        ++count;
    }
    if (count < 3) {
        say_once(r, SAID_LINES, line->at, nothing_to_see);
        return result_ok();
    }
    if (!smooth && r->smoothing)
        say_once(r, SAID_SMOOTH, line->at,
                 "this face is in a smoothing group but has no normals, and is flat; export with normals");
    for (size_t i = 0; i < count && !smooth; ++i) r->polygon[i].normal = WAVEFRONT_NONE;
    add_triangles(r, line->at, current_part(r, smooth, line->at), count);
    return result_ok();
}

/* ---- names and the rest -------------------------------------------------------------------------------- */

static void choose(reader_t *r, intern_t *list, line_t *line, uint32_t *chosen)
{
    word_t name = line_rest(line);
    *chosen = name.length ? intern_add(list, name.text, name.length) : WAVEFRONT_NONE;
    r->part[0] = r->part[1] = WAVEFRONT_NONE;
}

/* mtllib names one file or several, whose names may hold blanks: what ends with .mtl ends a name. */
static void add_libraries(reader_t *r, line_t *line)
{
    word_t rest = line_rest(line);
    const char *begin = rest.text, *end = begin + rest.length;
    for (const char *at = begin; at < end; ++at) {
        bool last = at + 1 == end, blank = !last && (at[1] == ' ' || at[1] == '\t');
        if (!last && !(blank && at - begin >= 3 && strncasecmp(at - 3, ".mtl", 4) == 0)) continue;
        intern_add(&r->out->libraries, begin, (size_t)(at + 1 - begin));
        for (begin = at + 1; begin < end && (*begin == ' ' || *begin == '\t'); ++begin) at = begin;
    }
}

static result_t ignore(reader_t *r, line_t *line)
{
    static const char *const free_forms[] = {"vp",   "cstype", "deg",  "bmat", "step", "curv", "curv2",
                                             "surf", "parm",   "trim", "hole", "scrv", "sp",   "end",
                                             "con",  "bzp",    "bsp",  "cdc",  "cdp",  "res"};
    char quote[WORD_QUOTE_SIZE];
    for (size_t i = 0; i < ARRAY_LENGTH(free_forms); ++i)
        if (word_is(line->keyword, free_forms[i]))
            return report_refuse(r->scene->report, line->at,
                                 "free-form curves and surfaces (%s) are not supported; export polygons. "
                                 "The nearest is to leave them out",
                                 free_forms[i]);
    if (!r->said[SAID_IGNORED])
        report_warning(r->scene->report, line->at, "the statement %s is ignored, and so are others like it",
                       word_quote(line->keyword, quote));
    r->said[SAID_IGNORED] = true;
    return result_ok();
}

static result_t read_line(reader_t *r, line_t *line)
{
    word_t word = line->keyword, group;
    if (word_is(word, "v")) return add_position(r, line);
    if (word_is(word, "vt")) return add_uv(r, line);
    if (word_is(word, "vn")) return add_normal(r, line);
    if (word_is(word, "f") || word_is(word, "fo")) return add_face(r, line);
    if (word_is(word, "o") || word_is(word, "g"))
        choose(r, &r->out->names, line, &r->name);
    else if (word_is(word, "usemtl"))
        choose(r, &r->out->materials, line, &r->material);
    else if (word_is(word, "mtllib"))
        add_libraries(r, line);
    else if (word_is(word, "s"))
        r->smoothing = line_word(line, &group) && !word_is(group, "off") && !word_is(group, "0");
    else if (word_is(word, "l") || word_is(word, "p"))
        say_once(r, SAID_LINES, line->at, nothing_to_see);
    else
        return ignore(r, line);
    return result_ok();
}

static result_t read_lines(reader_t *r, size_t size)
{
    enum { EVERY = 1 << 14 };
    const char *begin = r->lines.cursor;
    line_t line;
    for (size_t i = 1; lines_next(&r->lines, &line); ++i) {
        TRY(read_line(r, &line));
        if (i % EVERY == 0)
            report_progress(r->scene->report, (double)(r->lines.cursor - begin) / (double)(size + 1));
    }
    if (r->position_count >= WAVEFRONT_NONE || r->uv_count >= WAVEFRONT_NONE ||
        r->normal_count >= WAVEFRONT_NONE)
        return error_at((position_t){r->lines.path, 0, 0}, "has more than 2^32 - 2 vertices; split it");
    return result_ok();
}

/* ---- meshes of parts ----------------------------------------------------------------------------------- */

static uint64_t hash_of(const corner_t *c)
{
    uint64_t hash = c->position * 0x9E3779B97F4A7C15u ^ c->uv * 0xC2B2AE3D27D4EB4Fu;
    hash = (hash ^ hash >> 29) * 0xBF58476D1CE4E5B9u ^ c->normal * 0x94D049BB133111EBu;
    return (hash ^ hash >> 32) * 0x9E3779B97F4A7C15u >> 20;
}

/* Gives each triple of indices a number: numbers[i] of corner i; *first[number] is the corner that had it
 * first. Returns how many there are. */
static uint32_t number_corners(const corners_t *corners, uint32_t *numbers, uint32_t *first)
{
    size_t slots = 16, mask;
    while (slots < 2 * corners->count) slots *= 2;
    mask = slots - 1;
    uint32_t count = 0, *table = mem_zalloc(slots, sizeof *table);
    for (size_t i = 0; i < corners->count; ++i) {
        size_t at = hash_of(&corners->items[i]) & mask;
        while (table[at] != 0 &&
               memcmp(&corners->items[first[table[at] - 1]], &corners->items[i], sizeof(corner_t)) != 0)
            at = (at + 1) & mask;
        if (table[at] == 0) {
            first[count] = (uint32_t)i;
            table[at] = ++count;
        }
        numbers[i] = table[at] - 1;
    }
    free(table);
    return count;
}

/* A corner without a texture coordinate among others that have one gets (0, 0). */
static void fill_vertices(const reader_t *r, const corners_t *corners, const uint32_t *first, mesh_t *mesh)
{
    bool any_uv = false;
    for (uint32_t i = 0; i < mesh->vertex_count; ++i)
        any_uv = any_uv || corners->items[first[i]].uv != WAVEFRONT_NONE;
    mesh->positions = mem_alloc(mesh->vertex_count * sizeof *mesh->positions);
    if (any_uv) mesh->uvs = mem_zalloc(mesh->vertex_count, sizeof *mesh->uvs);
    if (corners->items[0].normal != WAVEFRONT_NONE)
        mesh->normals = mem_alloc(mesh->vertex_count * sizeof *mesh->normals);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        const corner_t *c = &corners->items[first[i]];
        mesh->positions[i] = r->positions[c->position];
        if (c->uv != WAVEFRONT_NONE) mesh->uvs[i] = r->uvs[c->uv];
        if (mesh->normals) mesh->normals[i] = r->normals[c->normal];
    }
}

static result_t make_mesh(const reader_t *r, const corners_t *corners, wavefront_part_t *part)
{
    mesh_t *mesh = &part->mesh;
    if (corners->count >= (uint64_t)1 << 31)
        return error_at(part->at, "this part has more than 2^31 corners; split it");
    mesh->triangle_count = (uint32_t)(corners->count / 3);
    mesh->triangles = mem_alloc(corners->count * sizeof(uint32_t));
    uint32_t *first = mem_alloc(corners->count * sizeof *first);
    mesh->vertex_count = number_corners(corners, (uint32_t *)mesh->triangles, first);
    fill_vertices(r, corners, first, mesh);
    free(first);
    return result_ok();
}

static result_t make_meshes(reader_t *r)
{
    for (size_t i = 0; i < r->out->part_count; ++i) {
        wavefront_part_t *part = &r->out->parts[i];
        TRY(scene_charge(r->scene, SCENE_VERTICES, r->faces[i].count, part->at));
        TRY(make_mesh(r, &r->faces[i], part));
        free(r->faces[i].items);
        r->faces[i] = (corners_t){0};
    }
    return result_ok();
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

static void free_reader(reader_t *r)
{
    for (size_t i = 0; r->faces && i < r->out->part_count; ++i) free(r->faces[i].items);
    free(r->faces);
    free(r->positions);
    free(r->normals);
    free(r->uvs);
    free(r->polygon);
    free(r->outline);
    intern_free(&r->parts);
}

result_t wavefront_read(const char *path, scene_builder_t *scene, wavefront_t *out)
{
    uint8_t *data;
    size_t size;
    *out = (wavefront_t){0};
    TRY(file_read(path, largest_file, &data, &size));
    scene->source_bytes += size;
    reader_t r = {.lines = lines_begin(path, (const char *)data, size),
                  .scene = scene,
                  .out = out,
                  .patience = patience_of_file};
    r.name = r.material = r.part[0] = r.part[1] = WAVEFRONT_NONE;
    result_t result = read_lines(&r, size);
    if (result.code == RESULT_OK) result = make_meshes(&r);
    out->position_count = r.position_count;
    free_reader(&r);
    free(data);
    return result;
}

void wavefront_free(wavefront_t *file)
{
    for (size_t i = 0; i < file->part_count; ++i) mesh_free(&file->parts[i].mesh);
    free(file->parts);
    intern_free(&file->names);
    intern_free(&file->materials);
    intern_free(&file->libraries);
    *file = (wavefront_t){0};
}
