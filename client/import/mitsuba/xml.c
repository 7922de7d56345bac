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

static bool is_name(char c)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
}

/* The longest parameter whose name begins at `text`. */
static bool find_parameter(const xml_t *xml, const char *text, size_t *length, uint32_t *parameter)
{
    for (*length = 0; *length < 256 && is_name(text[*length]);) ++*length;
    for (; *length > 0; --*length)
        if (intern_find(&xml->parameters, text, *length, parameter)) return true;
    return false;
}

/* The value with its parameters replaced, in fresh memory. */
static result_t replace_parameters(xml_t *xml, const char *value, position_t at, char **out)
{
    size_t size = strlen(value), capacity = 0;
    char *text = NULL;
    *out = NULL;
    size_t used = 0;
    for (size_t i = 0; i <= size; ++i) {
        uint32_t parameter;
        size_t length;
        const char *from = value + i;
        size_t count = 1;
        if (value[i] == '$') {
            if (!find_parameter(xml, value + i + 1, &length, &parameter)) {
                free(text);
                return error_at(at,
                                "the parameter %.40s has no value; add <default name=\"...\" value=\"...\"/>",
                                value + i);
            }
            from = xml->values[parameter];
            count = strlen(from);
            xml->replaced += count;
            i += length;
        }
        text = grow(text, &capacity, used + count, 1);
        memcpy(text + used, from, count);
        used += count;
        if (used > size + LONGEST_VALUE ||
            xml->replaced > ((uint64_t)1 << 24) + 16 * xml->scene->source_bytes) {
            free(text);
            return error_at(at, "the parameters of this scene make too much text");
        }
    }
    *out = text;
    return result_ok();
}

/* The first value of a parameter counts, as in Mitsuba. */
static result_t add_default(reader_t *r, const element_t *element)
{
    const char *name = element_attribute(element, "name"), *value = element_attribute(element, "value");
    xml_t *xml = r->xml;
    uint32_t number;
    if (!name || !value || !*name) return error_at(element->at, "<default> needs a name and a value");
    if (intern_find(&xml->parameters, name, strlen(name), &number)) return result_ok();
    number = intern_add(&xml->parameters, name, strlen(name));
    xml->values = grow(xml->values, &xml->value_capacity, xml->parameters.count, sizeof *xml->values);
    xml->values[number] = mem_strdup(value);
    return result_ok();
}

/* ---- elements ------------------------------------------------------------------------------------------ */

static result_t copy_attributes(reader_t *r, element_t *element, const char **attributes)
{
    size_t count = 0;
    while (attributes[count]) ++count;
    element->attributes = mem_zalloc(count + 1, sizeof *element->attributes);
    for (size_t i = 0; i < count; i += 2) {
        char *value;
        TRY(replace_parameters(r->xml, attributes[i + 1], element->at, &value));
        element->attributes[i] = mem_strdup(attributes[i]);
        element->attributes[i + 1] = value;
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
    for (int i = 0; i < length; ++i)
        if (!strchr(" \t\r\n", text[i]) && r->result.code == RESULT_OK)
            stop(r, error_at(here(r), "text between elements means nothing here"));
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
    *xml = (xml_t){.scene = scene};
    TRY(read_file(xml, path, NULL, NULL, (position_t){path, 0, 0}));
    if (xml->root && strcmp(xml->root->tag, "scene") == 0) return result_ok();
    return error_at((position_t){path, 1, 0}, "its root must be <scene>: it is no scene of Mitsuba's");
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
    for (size_t i = 0; i < xml->parameters.count; ++i) free(xml->values[i]);
    free(xml->paths);
    free(xml->values);
    intern_free(&xml->parameters);
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
