/* ply: see ply.h. The format is Greg Turk's "The PLY Polygon File Format", 1994.
 *
 * The header becomes a table of elements with their properties. One loop then walks the body element by
 * element, reading each scalar through read_scalar, which hides the encoding; a vertex property carries the
 * slot of the vertex it fills, the list of the faces is recognised by name, and everything else is read and
 * dropped.
 */
#include "client/import/files/ply.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/import/files/gunzip.h"
#include "client/import/files/number.h"

enum { MAX_ELEMENTS = 64, MAX_PROPERTIES = 256, MAX_WORD = 64 };
static const size_t largest_file = (size_t)1 << 36;
static const uint32_t most_vertices = BLOB_NONE - 1;

typedef enum { ENCODING_NONE, ENCODING_ASCII, ENCODING_LITTLE, ENCODING_BIG } encoding_t;

typedef enum {
    SCALAR_INT8,
    SCALAR_UINT8,
    SCALAR_INT16,
    SCALAR_UINT16,
    SCALAR_INT32,
    SCALAR_UINT32,
    SCALAR_FLOAT32,
    SCALAR_FLOAT64,
    SCALAR_NONE
} scalar_t;

static const struct {
    const char *name;
    scalar_t type;
} scalar_names[] = {
    {"char", SCALAR_INT8},       {"int8", SCALAR_INT8},       {"uchar", SCALAR_UINT8},
    {"uint8", SCALAR_UINT8},     {"short", SCALAR_INT16},     {"int16", SCALAR_INT16},
    {"ushort", SCALAR_UINT16},   {"uint16", SCALAR_UINT16},   {"int", SCALAR_INT32},
    {"int32", SCALAR_INT32},     {"uint", SCALAR_UINT32},     {"uint32", SCALAR_UINT32},
    {"float", SCALAR_FLOAT32},   {"float32", SCALAR_FLOAT32}, {"double", SCALAR_FLOAT64},
    {"float64", SCALAR_FLOAT64},
};
static const uint8_t scalar_sizes[] = {1, 1, 2, 2, 4, 4, 4, 8};

/* What a property of a vertex means. */
typedef enum {
    SLOT_X,
    SLOT_Y,
    SLOT_Z,
    SLOT_NX,
    SLOT_NY,
    SLOT_NZ,
    SLOT_U,
    SLOT_V,
    SLOT_RED,
    SLOT_GREEN,
    SLOT_BLUE,
    SLOT_COUNT
} slot_t;
enum { SLOT_DROPPED = SLOT_COUNT };

static const struct {
    const char *name;
    slot_t slot;
} slot_names[] = {
    {"x", SLOT_X},
    {"y", SLOT_Y},
    {"z", SLOT_Z},
    {"nx", SLOT_NX},
    {"ny", SLOT_NY},
    {"nz", SLOT_NZ},
    {"u", SLOT_U},
    {"v", SLOT_V},
    {"s", SLOT_U},
    {"t", SLOT_V},
    {"texture_u", SLOT_U},
    {"texture_v", SLOT_V},
    {"texture_s", SLOT_U},
    {"texture_t", SLOT_V},
    {"red", SLOT_RED},
    {"green", SLOT_GREEN},
    {"blue", SLOT_BLUE},
    {"diffuse_red", SLOT_RED},
    {"diffuse_green", SLOT_GREEN},
    {"diffuse_blue", SLOT_BLUE},
};

typedef struct {
    scalar_t count; /* type of a list's length; SCALAR_NONE for a property that is no list */
    scalar_t value;
    int slot;     /* slot_t or SLOT_DROPPED */
    bool corners; /* the list of a face's vertex indices */
} property_t;

typedef enum { ELEMENT_OTHER, ELEMENT_VERTEX, ELEMENT_FACE } element_kind_t;

typedef struct {
    element_kind_t kind;
    uint64_t count;
    int first_property, property_count;
} element_t;

typedef struct {
    const char *path;
    ply_rules_t rules;
    report_t *report;
    const char *data, *at, *end;
    uint32_t line; /* of `at`, in the header and in ASCII bodies */
    encoding_t encoding;
    bool in_body;
    element_t elements[MAX_ELEMENTS];
    property_t properties[MAX_PROPERTIES];
    int element_count, property_count;
    mesh_t *mesh;
    size_t triangle_capacity;
    uint64_t faces, thin_faces, large_faces; /* kept; left out */
} ply_t;

/* ---- where and what went wrong ------------------------------------------------------------------------- */

static result_t fail(const ply_t *ply, const char *format, ...) __attribute__((format(printf, 2, 3)));

static result_t fail(const ply_t *ply, const char *format, ...)
{
    char text[300];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (ply->in_body && ply->encoding != ENCODING_ASCII)
        return error_at((position_t){ply->path, 0, 0}, "byte %zu: %s", (size_t)(ply->at - ply->data), text);
    return error_at((position_t){ply->path, ply->line, 0}, "%s", text);
}

/* ---- the header ---------------------------------------------------------------------------------------- */

/* The words of one header line. */
typedef struct {
    char words[5][MAX_WORD];
    int count; /* words on the line, also those beyond the fifth */
} header_line_t;

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

/* Reads the next line, with line number ply->line; false at the end of the file. */
static bool next_header_line(ply_t *ply, header_line_t *line)
{
    const char *newline = memchr(ply->at, '\n', (size_t)(ply->end - ply->at));
    if (!newline) return false;
    ++ply->line;
    memset(line, 0, sizeof *line);
    for (const char *s = ply->at; s < newline;) {
        while (s < newline && is_blank(*s)) ++s;
        const char *start = s;
        while (s < newline && !is_blank(*s)) ++s;
        if (s == start) break;
        size_t length = (size_t)(s - start);
        if (line->count < 5)
            memcpy(line->words[line->count], start, length < MAX_WORD ? length : MAX_WORD - 1);
        ++line->count;
    }
    ply->at = newline + 1;
    return true;
}

static result_t read_format(ply_t *ply, const header_line_t *line)
{
    static const struct {
        const char *name;
        encoding_t encoding;
    } encodings[] = {{"ascii", ENCODING_ASCII},
                     {"binary_little_endian", ENCODING_LITTLE},
                     {"binary_big_endian", ENCODING_BIG}};
    for (size_t i = 0; i < ARRAY_LENGTH(encodings); ++i)
        if (strcmp(line->words[1], encodings[i].name) == 0) ply->encoding = encodings[i].encoding;
    if (ply->encoding == ENCODING_NONE)
        return fail(ply, "unknown format \"%s\": ascii, binary_little_endian and binary_big_endian are known",
                    line->words[1]);
    return result_ok();
}

static result_t read_element(ply_t *ply, const header_line_t *line)
{
    double count;
    const char *text = line->words[2], *end = text + strlen(text);
    if (line->count != 3 || number_parse(text, end, &count) != end || count < 0 || count != floor(count) ||
        count > 1e15)
        return fail(ply, "an element line must be: element NAME COUNT");
    if (ply->element_count == MAX_ELEMENTS) return fail(ply, "more than %d elements", MAX_ELEMENTS);
    element_kind_t kind = strcmp(line->words[1], "vertex") == 0 ? ELEMENT_VERTEX
                          : strcmp(line->words[1], "face") == 0 ? ELEMENT_FACE
                                                                : ELEMENT_OTHER;
    for (int i = 0; kind != ELEMENT_OTHER && i < ply->element_count; ++i)
        if (ply->elements[i].kind == kind) return fail(ply, "a second element \"%s\"", line->words[1]);
    if (kind == ELEMENT_VERTEX && count > most_vertices)
        return fail(ply, "%.0f vertices are more than the limit of %" PRIu32, count, most_vertices);
    ply->elements[ply->element_count++] =
        (element_t){.kind = kind, .count = (uint64_t)count, .first_property = ply->property_count};
    return result_ok();
}

static scalar_t scalar_of(const char *name)
{
    for (size_t i = 0; i < ARRAY_LENGTH(scalar_names); ++i)
        if (strcmp(name, scalar_names[i].name) == 0) return scalar_names[i].type;
    return SCALAR_NONE;
}

static int slot_of(const char *name)
{
    for (size_t i = 0; i < ARRAY_LENGTH(slot_names); ++i)
        if (strcmp(name, slot_names[i].name) == 0) return (int)slot_names[i].slot;
    return SLOT_DROPPED;
}

static result_t read_property(ply_t *ply, const header_line_t *line)
{
    if (ply->element_count == 0) return fail(ply, "a property before any element");
    if (ply->property_count == MAX_PROPERTIES) return fail(ply, "more than %d properties", MAX_PROPERTIES);
    element_t *element = &ply->elements[ply->element_count - 1];
    bool list = strcmp(line->words[1], "list") == 0;
    if (line->count != (list ? 5 : 3))
        return fail(ply, "a property line must be: property TYPE NAME, or: property list TYPE TYPE NAME");
    const char *name = line->words[list ? 4 : 2];
    property_t property = {.count = list ? scalar_of(line->words[2]) : SCALAR_NONE,
                           .value = scalar_of(line->words[list ? 3 : 1]),
                           .slot = SLOT_DROPPED};
    if (property.value == SCALAR_NONE || (list && property.count == SCALAR_NONE))
        return fail(ply, "unknown type of property \"%s\"", name);
    if (list && property.count >= SCALAR_FLOAT32)
        return fail(ply, "the length of list \"%s\" must have an integer type", name);
    if (element->kind == ELEMENT_VERTEX && !list) property.slot = slot_of(name);
    if (element->kind == ELEMENT_FACE && list)
        property.corners = strcmp(name, "vertex_indices") == 0 || strcmp(name, "vertex_index") == 0;
    ply->properties[ply->property_count++] = property;
    ++element->property_count;
    return result_ok();
}

static result_t read_header(ply_t *ply)
{
    header_line_t line;
    if (!next_header_line(ply, &line) || strcmp(line.words[0], "ply") != 0 || line.count != 1) {
        ply->line = 1;
        return fail(ply, "not a PLY file: its first line must be \"ply\"");
    }
    while (next_header_line(ply, &line)) {
        const char *word = line.words[0];
        if (strcmp(word, "end_header") == 0) {
            if (ply->encoding == ENCODING_NONE) return fail(ply, "the header has no format line");
            return result_ok();
        }
        if (strcmp(word, "format") == 0)
            TRY(read_format(ply, &line));
        else if (strcmp(word, "element") == 0)
            TRY(read_element(ply, &line));
        else if (strcmp(word, "property") == 0)
            TRY(read_property(ply, &line));
        else if (line.count && strcmp(word, "comment") != 0 && strcmp(word, "obj_info") != 0)
            return fail(ply, "unknown header line \"%s\"", word);
    }
    return fail(ply, "the header has no end_header line; is the file truncated?");
}

/* ---- scalars ------------------------------------------------------------------------------------------- */

static bool read_ascii(ply_t *ply, double *value)
{
    const char *s = ply->at;
    for (; s < ply->end && (is_blank(*s) || *s == '\n'); ++s) ply->line += *s == '\n';
    ply->at = s;
    const char *stop = number_parse(s, ply->end, value);
    if (!stop || (stop < ply->end && !is_blank(*stop) && *stop != '\n')) return false;
    ply->at = stop;
    return true;
}

static uint64_t load(const uint8_t *bytes, int size, bool big)
{
    uint64_t bits = 0;
    for (int i = 0; i < size; ++i) bits |= (uint64_t)bytes[big ? size - 1 - i : i] << (8 * i);
    return bits;
}

static bool read_binary(ply_t *ply, scalar_t type, double *value)
{
    int size = scalar_sizes[type];
    if (ply->end - ply->at < size) return false;
    uint64_t bits = load((const uint8_t *)ply->at, size, ply->encoding == ENCODING_BIG);
    uint32_t low = (uint32_t)bits;
    float narrow;
    switch (type) {
    case SCALAR_INT8:
        *value = (int8_t)low;
        break;
    case SCALAR_INT16:
        *value = (int16_t)low;
        break;
    case SCALAR_INT32:
        *value = (int32_t)low;
        break;
    case SCALAR_FLOAT32:
        memcpy(&narrow, &low, sizeof narrow);
        *value = (double)narrow;
        break;
    case SCALAR_FLOAT64:
        memcpy(value, &bits, sizeof bits);
        break;
    default:
        *value = low;
        break;
    }
    ply->at += size;
    return true;
}

/* False when the file ends or what is there is no number; `at` then points to it. */
static bool read_scalar(ply_t *ply, scalar_t type, double *value)
{
    return ply->encoding == ENCODING_ASCII ? read_ascii(ply, value) : read_binary(ply, type, value);
}

static result_t scalar_missing(const ply_t *ply, const char *what, uint64_t index)
{
    if (ply->encoding != ENCODING_ASCII || ply->at == ply->end)
        return fail(ply, "the file ends inside %s %" PRIu64 "; is it truncated?", what, index);
    return fail(ply, "%s %" PRIu64 ": expected a finite number", what, index);
}

/* ---- the body ------------------------------------------------------------------------------------------ */

/* The least bytes that one record of the element takes: what a count is checked against. */
static uint64_t least_record(const ply_t *ply, const element_t *element)
{
    uint64_t size = 0;
    for (int i = 0; i < element->property_count; ++i) {
        const property_t *property = &ply->properties[element->first_property + i];
        scalar_t first = property->count != SCALAR_NONE ? property->count : property->value;
        size += ply->encoding == ENCODING_ASCII ? 2 : scalar_sizes[first];
    }
    return size;
}

static result_t check_count(const ply_t *ply, const element_t *element, const char *name)
{
    uint64_t left = (uint64_t)(ply->end - ply->at) + 1; /* the last number needs no separator */
    uint64_t least = least_record(ply, element);
    if (element->count && least && element->count > left / least)
        return fail(
            ply, "%" PRIu64 " %s records cannot fit in the %" PRIu64 " bytes that are left; is it truncated?",
            element->count, name, left - 1);
    return result_ok();
}

static result_t skip_list(ply_t *ply, const property_t *property, const char *what, uint64_t index)
{
    double length, value;
    if (!read_scalar(ply, property->count, &length)) return scalar_missing(ply, what, index);
    if (length < 0 || length != floor(length))
        return fail(ply, "%s %" PRIu64 ": bad list length", what, index);
    for (double i = 0; i < length; ++i)
        if (!read_scalar(ply, property->value, &value)) return scalar_missing(ply, what, index);
    return result_ok();
}

static result_t skip_element(ply_t *ply, const element_t *element)
{
    TRY(check_count(ply, element, "element"));
    if (element->property_count == 0) return result_ok();
    for (uint64_t i = 0; i < element->count; ++i) {
        for (int k = 0; k < element->property_count; ++k) {
            const property_t *property = &ply->properties[element->first_property + k];
            double value;
            if (property->count != SCALAR_NONE)
                TRY(skip_list(ply, property, "record", i));
            else if (!read_scalar(ply, property->value, &value))
                return scalar_missing(ply, "record", i);
        }
    }
    return result_ok();
}

/* Which slots the vertices fill; all of x y z must be there, half a normal or half a uv is none. */
static result_t find_slots(const ply_t *ply, const element_t *element, bool present[SLOT_COUNT + 1])
{
    memset(present, 0, (SLOT_COUNT + 1) * sizeof *present);
    for (int i = 0; i < element->property_count; ++i)
        present[ply->properties[element->first_property + i].slot] = true;
    if (!present[SLOT_X] || !present[SLOT_Y] || !present[SLOT_Z])
        return fail(ply, "the vertices have no x, y and z");
    return result_ok();
}

static result_t read_vertex(ply_t *ply, const element_t *element, uint32_t index)
{
    mesh_t *mesh = ply->mesh;
    double slots[SLOT_COUNT + 1] = {0};
    for (int k = 0; k < element->property_count; ++k) {
        const property_t *property = &ply->properties[element->first_property + k];
        if (property->count != SCALAR_NONE)
            TRY(skip_list(ply, property, "vertex", index));
        else if (!read_scalar(ply, property->value, &slots[property->slot]))
            return scalar_missing(ply, "vertex", index);
        else if (property->slot >= SLOT_RED && property->value == SCALAR_UINT8)
            slots[property->slot] /= 255;
    }
    mesh->positions[index] = vec3((float)slots[SLOT_X], (float)slots[SLOT_Y], (float)slots[SLOT_Z]);
    if (mesh->normals)
        mesh->normals[index] = vec3((float)slots[SLOT_NX], (float)slots[SLOT_NY], (float)slots[SLOT_NZ]);
    if (mesh->uvs) mesh->uvs[index] = (vec2_t){(float)slots[SLOT_U], (float)slots[SLOT_V]};
    if (mesh->colours)
        mesh->colours[index] =
            (blob_colour_t){(float)slots[SLOT_RED], (float)slots[SLOT_GREEN], (float)slots[SLOT_BLUE], 1};
    if (!v_is_finite(mesh->positions[index])) return fail(ply, "vertex %" PRIu32 " is not finite", index);
    return result_ok();
}

static result_t read_vertices(ply_t *ply, const element_t *element)
{
    bool present[SLOT_COUNT + 1];
    TRY(find_slots(ply, element, present));
    TRY(check_count(ply, element, "vertex"));
    mesh_t *mesh = ply->mesh;
    size_t room = element->count + 1; /* never an allocation of nothing */
    mesh->vertex_count = (uint32_t)element->count;
    mesh->positions = mem_alloc(room * sizeof *mesh->positions);
    if (present[SLOT_NX] && present[SLOT_NY] && present[SLOT_NZ])
        mesh->normals = mem_alloc(room * sizeof *mesh->normals);
    if (present[SLOT_U] && present[SLOT_V]) mesh->uvs = mem_alloc(room * sizeof *mesh->uvs);
    if (present[SLOT_RED] && present[SLOT_GREEN] && present[SLOT_BLUE])
        mesh->colours = mem_alloc(room * sizeof *mesh->colours);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) TRY(read_vertex(ply, element, i));
    return result_ok();
}

static void add_triangle(ply_t *ply, uint32_t a, uint32_t b, uint32_t c)
{
    mesh_t *mesh = ply->mesh;
    if (mesh->triangle_count == ply->triangle_capacity)
        mesh->triangles = grow(mesh->triangles, &ply->triangle_capacity, (size_t)mesh->triangle_count + 1,
                               sizeof *mesh->triangles);
    mesh->triangles[mesh->triangle_count++] = (blob_triangle_t){{a, b, c}};
}

/* Reads one corner of a face: the number of a vertex. */
static result_t read_corner(ply_t *ply, const property_t *property, uint64_t face, uint32_t *corner)
{
    double value;
    if (!read_scalar(ply, property->value, &value)) return scalar_missing(ply, "face", face);
    if (!(value >= 0 && value < ply->mesh->vertex_count) || value != floor(value))
        return fail(ply,
                    "face %" PRIu64 " uses vertex %g, but there are %" PRIu32 " vertices, counted from 0",
                    face, value, ply->mesh->vertex_count);
    *corner = (uint32_t)value;
    return result_ok();
}

/* The triangle of a face between its first corner, its corner i - 1 and its corner i. */
static void add_corner(ply_t *ply, double i, uint32_t first, uint32_t last, uint32_t corner)
{
    if (i < 3 || ply->rules == PLY_FANS)
        add_triangle(ply, first, last, corner);
    else if (ply->rules == PLY_PBRT_V3)
        add_triangle(ply, corner, first, last);
    else
        add_triangle(ply, last, corner, first);
}

static result_t read_corners(ply_t *ply, const property_t *property, uint64_t face)
{
    double length;
    if (!read_scalar(ply, property->count, &length)) return scalar_missing(ply, "face", face);
    if (!(length >= 0) || length != floor(length))
        return fail(ply, "face %" PRIu64 " has %g vertices", face, length);
    uint32_t first = 0, last = 0, corner = 0;
    bool large = length > 4 && ply->rules != PLY_FANS;
    for (double i = 0; i < length; ++i) {
        TRY(read_corner(ply, property, face, &corner));
        if (i == 0) first = corner;
        if (i >= 2 && ply->mesh->triangle_count == BLOB_NONE - 1) return fail(ply, "too many triangles");
        if (i >= 2 && !large) add_corner(ply, i, first, last, corner);
        last = corner;
    }
    ply->thin_faces += length < 3;
    ply->large_faces += large;
    ply->faces += length >= 3 && !large;
    return result_ok();
}

/* Room for a triangle a face, which is all that most files need; the count has been checked against the file.
 */
static void reserve_triangles(ply_t *ply, const element_t *element)
{
    size_t room = element->count < BLOB_NONE ? element->count : BLOB_NONE;
    ply->mesh->triangles = grow(NULL, &ply->triangle_capacity, room + 1, sizeof *ply->mesh->triangles);
}

static result_t read_faces(ply_t *ply, const element_t *element)
{
    int lists = 0;
    for (int k = 0; k < element->property_count; ++k)
        lists += ply->properties[element->first_property + k].corners;
    if (lists != 1) return fail(ply, "the faces need one list vertex_indices, they have %d", lists);
    if (!ply->mesh->positions) return fail(ply, "the faces come before the vertices, which is not supported");
    TRY(check_count(ply, element, "face"));
    reserve_triangles(ply, element);
    for (uint64_t i = 0; i < element->count; ++i) {
        for (int k = 0; k < element->property_count; ++k) {
            const property_t *property = &ply->properties[element->first_property + k];
            double value;
            if (property->corners)
                TRY(read_corners(ply, property, i));
            else if (property->count != SCALAR_NONE)
                TRY(skip_list(ply, property, "face", i));
            else if (!read_scalar(ply, property->value, &value))
                return scalar_missing(ply, "face", i);
        }
    }
    return result_ok();
}

static result_t read_body(ply_t *ply)
{
    ply->in_body = true;
    ++ply->line;
    bool faces = false;
    for (int i = 0; i < ply->element_count && !faces; ++i) {
        const element_t *element = &ply->elements[i];
        faces = element->kind == ELEMENT_FACE;
        switch (element->kind) {
        case ELEMENT_VERTEX:
            TRY(read_vertices(ply, element));
            break;
        case ELEMENT_FACE:
            TRY(read_faces(ply, element));
            break;
        case ELEMENT_OTHER:
            TRY(skip_element(ply, element));
            break;
        }
    }
    if (!faces) return fail(ply, "the file has no faces");
    position_t at = {ply->path, 0, 0};
    if (ply->thin_faces)
        report_warning(ply->report, at, "%" PRIu64 " faces have fewer than three vertices and are left out",
                       ply->thin_faces);
    if (!ply->large_faces) return result_ok();
    return report_tolerate(ply->report, at,
                           "%" PRIu64 " faces have more than four vertices and are left out, as by pbrt",
                           ply->large_faces);
}

result_t ply_read(const char *path, ply_rules_t rules, report_t *report, mesh_t *mesh, uint64_t *faces)
{
    uint8_t *data;
    size_t size;
    TRY(gunzip_read_file(path, largest_file, &data, &size));
    ply_t *ply = mem_zalloc(1, sizeof *ply);
    ply->path = path;
    ply->rules = rules;
    ply->report = report;
    ply->mesh = mesh;
    ply->data = ply->at = (const char *)data;
    ply->end = ply->data + size;
    result_t result = read_header(ply);
    if (result.code == RESULT_OK) result = read_body(ply);
    if (faces) *faces = ply->faces;
    free(ply);
    free(data);
    return result;
}
