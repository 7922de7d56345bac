/* xml: see xml.h. */
#include "client/import/mitsuba/xml.h"

#include <expat.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const size_t largest_file = (size_t)1 << 28;
enum { MOST_DEPTH = 200, MOST_NESTED = 16, MOST_INCLUDES = 10000, LONGEST_VALUE = 1 << 16 };

/* One file on its way. */
typedef struct reader {
    xml_t *xml;
    XML_Parser parser;
    const char *path;
    const struct reader *including; /* the file that includes this one */
    element_t *open;                /* the element whose children are read */
    int depth;
    bool top;        /* the next element is the file's root */
    result_t result; /* why the parser was stopped */
} reader_t;

static result_t read_file(xml_t *xml, const char *path, const reader_t *including, element_t *parent,
                          position_t at);

static position_t here(const reader_t *r)
{
    return (position_t){r->path, (uint32_t)XML_GetCurrentLineNumber(r->parser),
                        (uint32_t)XML_GetCurrentColumnNumber(r->parser) + 1};
}

static void stop(reader_t *r, result_t result)
{
    if (r->result.code == RESULT_OK) r->result = result;
    XML_StopParser(r->parser, XML_FALSE);
}

/* ---- parameters ---------------------------------------------------------------------------------------- */

enum { LONGEST_NAME = 256 };

/* The parameter of that name, which is added where it is new. */
static parameter_t *add_parameter(xml_t *xml, const char *name, size_t length)
{
    size_t known = xml->names.count;
    uint32_t number = intern_add(&xml->names, name, length);
    xml->parameters =
        grow(xml->parameters, &xml->parameter_capacity, xml->names.count, sizeof *xml->parameters);
    if (number == known) xml->parameters[number] = (parameter_t){0};
    return &xml->parameters[number];
}

static void set_value(parameter_t *parameter, const char *value)
{
    free(parameter->value);
    parameter->value = mem_strdup(value);
}

/* The last definition of a name counts, and goes before the scene's defaults, as in Mitsuba. */
static result_t add_definitions(xml_t *xml, const option_list_t *definitions)
{
    for (size_t i = 0; i < definitions->count; ++i) {
        const char *text = definitions->texts[i], *equals = strchr(text, '=');
        if (!equals || equals == text || equals - text > LONGEST_NAME)
            return result_fail(RESULT_USAGE, "--define takes NAME=VALUE, not '%.100s'", text);
        parameter_t *parameter = add_parameter(xml, text, (size_t)(equals - text));
        set_value(parameter, equals + 1);
        parameter->defined = true;
    }
    return result_ok();
}

static void tell_unused(const xml_t *xml)
{
    for (size_t i = 0; i < xml->names.count; ++i)
        if (xml->parameters[i].defined && !xml->parameters[i].used)
            report_warning(xml->scene->report, (position_t){"--define", 0, 0},
                           "nothing in the scene uses the parameter $%.60s", xml->names.texts[i]);
}

/* The first default of a parameter counts, as in Mitsuba. */
static result_t add_default(reader_t *r, const element_t *element)
{
    const char *name = element_attribute(element, "name"), *value = element_attribute(element, "value");
    if (!name || !value || !*name) return error_at(element->at, "<default> needs a name and a value");
    parameter_t *parameter = add_parameter(r->xml, name, strlen(name));
    if (!parameter->value) set_value(parameter, value);
    return result_ok();
}

/* The parameter with the longest name that `text` begins with; NULL: none. */
static parameter_t *find_parameter(const xml_t *xml, const char *text, size_t *length)
{
    uint32_t number;
    for (*length = 0; *length < LONGEST_NAME && text[*length] && text[*length] != '$';) ++*length;
    for (; *length > 0; --*length)
        if (intern_find(&xml->names, text, *length, &number)) return &xml->parameters[number];
    return NULL;
}

static result_t no_value(position_t at, const char *text)
{
    int length = (int)strspn(text, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_");
    if (length > 60) length = 60;
    return error_at(at,
                    "the parameter $%.*s has no value; give it one by the option --define %.*s=VALUE, or by "
                    "<default name=\"%.*s\" value=\"...\"/> above",
                    length, text, length, text, length, text);
}

/* Appends to a text of *used bytes. */
static char *append_bytes(char *text, size_t *capacity, size_t *used, const char *from, size_t count)
{
    text = grow(text, capacity, *used + count + 1, 1);
    memcpy(text + *used, from, count);
    *used += count;
    text[*used] = '\0';
    return text;
}

/* Writes the value with its parameters replaced to *out, which is the caller's, also after an error. */
static result_t replace_parameters(xml_t *xml, const char *value, position_t at, char **out)
{
    size_t capacity = 0, used = 0;
    const size_t most = strlen(value) + LONGEST_VALUE;
    *out = append_bytes(NULL, &capacity, &used, "", 0);
    while (*value) {
        size_t length = strcspn(value, "$");
        *out = append_bytes(*out, &capacity, &used, value, length);
        value += length;
        if (!*value) break;
        parameter_t *parameter = find_parameter(xml, ++value, &length);
        if (!parameter) return no_value(at, value);
        parameter->used = true;
        value += length;
        *out = append_bytes(*out, &capacity, &used, parameter->value, strlen(parameter->value));
        xml->replaced += strlen(parameter->value);
        if (used > most || xml->replaced > ((uint64_t)1 << 24) + 16 * xml->scene->source_bytes)
            return error_at(at, "the parameters of this scene make too much text");
    }
    return result_ok();
}

/* ---- elements ------------------------------------------------------------------------------------------ */

static void lower(char *text)
{
    for (; *text; ++text)
        if (*text >= 'A' && *text <= 'Z') *text = (char)(*text - 'A' + 'a');
}

static result_t copy_attributes(reader_t *r, element_t *element, const char **attributes)
{
    size_t count = 0;
    while (attributes[count]) ++count;
    element->attributes = mem_zalloc(count + 1, sizeof *element->attributes);
    for (size_t i = 0; i < count; i += 2) {
        element->attributes[i] = mem_strdup(attributes[i]);
        char **value = (char **)&element->attributes[i + 1];
        TRY(replace_parameters(r->xml, attributes[i + 1], element->at, value));
        if (strcmp(attributes[i], "type") == 0) lower(*value); /* Mitsuba does not tell them apart */
    }
    return result_ok();
}

static void append(element_t *parent, element_t *child)
{
    child->parent = parent;
    if (parent->last)
        parent->last->next = child;
    else
        parent->first = child;
    parent->last = child;
}

/* The children of an included file's root stand where the include stands. */
static result_t include(reader_t *r, element_t *element)
{
    const char *name = element_attribute(element, "filename");
    if (!name) return error_at(element->at, "<include> needs a filename");
    char *path = element_path(element, name);
    result_t result = read_file(r->xml, path, r, element->parent, element->at);
    free(path);
    return result;
}

static result_t open_element(reader_t *r, const char *tag, const char **attributes)
{
    xml_t *xml = r->xml;
    element_t *element = mem_zalloc(1, sizeof *element);
    element->at = here(r);
    element->older = xml->newest;
    xml->newest = element;
    element->tag = mem_strdup(tag);
    element->parent = r->open;
    if (++r->depth > MOST_DEPTH) return error_at(element->at, "more than %d elements deep", MOST_DEPTH);
    TRY(copy_attributes(r, element, attributes));
    bool top = r->top;
    r->top = false;
    if (top && r->including && strcmp(tag, "scene") == 0) return result_ok(); /* its parent stays open */
    element->parent = NULL;
    if (r->open)
        append(r->open, element);
    else
        xml->root = element;
    r->open = element;
    if (strcmp(tag, "default") == 0) return add_default(r, element);
    return strcmp(tag, "include") == 0 ? include(r, element) : result_ok();
}

static void on_start(void *data, const char *tag, const char **attributes)
{
    reader_t *r = data;
    if (r->result.code != RESULT_OK) return;
    result_t result = open_element(r, tag, attributes);
    if (result.code != RESULT_OK) stop(r, result);
}

static void on_end(void *data, const char *tag)
{
    reader_t *r = data;
    bool scene_of_include = r->including && r->depth == 1 && strcmp(tag, "scene") == 0;
    --r->depth;
    if (!scene_of_include && r->open) r->open = r->open->parent;
}

static void on_text(void *data, const char *text, int length)
{
    reader_t *r = data;
    int i = 0;
    while (i < length && strchr(" \t\r\n", text[i])) ++i;
    if (i == length || r->result.code != RESULT_OK) return;
    result_t result = report_tolerate(r->xml->scene->report, here(r),
                                      "text between elements means nothing: Mitsuba ignores it");
    if (result.code != RESULT_OK) stop(r, result);
}

static void on_entity(void *data, const char *name, int is_parameter, const char *value, int length,
                      const char *base, const char *system, const char *public_id, const char *notation)
{
    (void)name, (void)is_parameter, (void)value, (void)length;
    (void)base, (void)system, (void)public_id, (void)notation;
    reader_t *r = data;
    stop(r, error_at(here(r), "entities may not be declared here; write out what they stand for"));
}

/* ---- files --------------------------------------------------------------------------------------------- */

static result_t parse(reader_t *r, const uint8_t *data, size_t size)
{
    XML_SetUserData(r->parser, r);
    XML_SetElementHandler(r->parser, on_start, on_end);
    XML_SetCharacterDataHandler(r->parser, on_text);
    XML_SetEntityDeclHandler(r->parser, on_entity);
    XML_SetParamEntityParsing(r->parser, XML_PARAM_ENTITY_PARSING_NEVER);
    enum XML_Status status = XML_Parse(r->parser, (const char *)data, (int)size, XML_TRUE);
    TRY(r->result);
    if (status == XML_STATUS_OK) return result_ok();
    return error_at(here(r), "not XML: %s", XML_ErrorString(XML_GetErrorCode(r->parser)));
}

/* A file that includes itself, by whatever way, ends with the bound on nesting. */
static result_t check_include(const xml_t *xml, const reader_t *including, position_t at)
{
    int nested = 0;
    for (const reader_t *r = including; r; r = r->including) ++nested;
    if (nested > MOST_NESTED) return error_at(at, "more than %d includes in one another", MOST_NESTED);
    if (xml->path_count > MOST_INCLUDES) return error_at(at, "more than %d includes", MOST_INCLUDES);
    if (xml->scene->source_bytes > largest_file)
        return error_at(at, "the scene's XML files are larger than 256 MiB together");
    return result_ok();
}

static result_t read_file(xml_t *xml, const char *path, const reader_t *including, element_t *parent,
                          position_t at)
{
    uint8_t *data;
    size_t size;
    TRY(check_include(xml, including, at));
    result_t opened = file_read(path, largest_file, &data, &size);
    if (opened.code != RESULT_OK) return including ? error_at(at, "%s", opened.message) : opened;
    xml->scene->source_bytes += size;
    xml->paths = grow(xml->paths, &xml->path_capacity, xml->path_count + 1, sizeof *xml->paths);
    char *kept = xml->paths[xml->path_count++] = mem_strdup(path);
    reader_t r = {.xml = xml, .path = kept, .including = including, .open = parent, .top = true};
    r.parser = XML_ParserCreate(NULL);
    result_t result =
        r.parser ? parse(&r, data, size) : result_fail(RESULT_LIMIT, "%s: no memory to parse it", path);
    if (r.parser) XML_ParserFree(r.parser);
    free(data);
    return result;
}

result_t xml_read(const char *path, scene_builder_t *scene, xml_t *xml)
{
    const import_wishes_t *wishes = scene->report->sink.wishes;
    *xml = (xml_t){.scene = scene};
    if (wishes) TRY(add_definitions(xml, &wishes->definitions));
    TRY(read_file(xml, path, NULL, NULL, (position_t){path, 0, 0}));
    if (!xml->root || strcmp(xml->root->tag, "scene") != 0)
        return error_at((position_t){path, 1, 0}, "its root must be <scene>: it is no scene of Mitsuba's");
    tell_unused(xml);
    return result_ok();
}

void xml_free(xml_t *xml)
{
    while (xml->newest) {
        element_t *element = xml->newest;
        xml->newest = element->older;
        for (size_t i = 0; element->attributes && element->attributes[i]; ++i)
            free((char *)element->attributes[i]);
        free(element->attributes);
        free((char *)element->tag);
        free(element);
    }
    for (size_t i = 0; i < xml->path_count; ++i) free(xml->paths[i]);
    for (size_t i = 0; i < xml->names.count; ++i) free(xml->parameters[i].value);
    free(xml->paths);
    free(xml->parameters);
    intern_free(&xml->names);
    *xml = (xml_t){0};
}

const char *element_attribute(const element_t *element, const char *name)
{
    for (size_t i = 0; element->attributes && element->attributes[i]; i += 2)
        if (strcmp(element->attributes[i], name) == 0) return element->attributes[i + 1];
    return NULL;
}

/* The path of `name` in the folder of the file `path`. */
static char *beside(const char *path, const char *name)
{
    const char *slash = strrchr(path, '/');
    if (name[0] == '/' || !slash) return mem_strdup(name);
    return mem_printf("%.*s%s", (int)(slash + 1 - path), path, name);
}

char *element_path(const element_t *element, const char *name)
{
    const element_t *root = element;
    while (root->parent) root = root->parent;
    char *path = beside(root->at.path, name);
    if (root->at.path == element->at.path || access(path, F_OK) == 0) return path;
    free(path);
    return beside(element->at.path, name);
}
