/* xml: a Mitsuba scene's file as a tree of elements, by expat.
 *
 * Includes are read into the tree, and the $parameters in attributes are replaced by what --define or
 * <default> says. expat reads no other file: whoever declares an entity, of its own or of another file, is
 * refused before it could grow. What includes and parameters may amount to is bounded.
 */
#ifndef LIGHTMILL_XML_H
#define LIGHTMILL_XML_H

#include "client/import/files/intern.h"
#include "client/import/scene/scene_builder.h"

typedef struct element {
    const char *tag;
    const char **attributes; /* name, value, name, value ... NULL */
    position_t at;
    struct element *parent, *first, *last, *next; /* its children, and the next child of its parent */
    struct element *older;                        /* the one that was read before it; all are in that list */
    bool used;                                    /* somebody asked for it: see property.h */
    bool replaced;    /* a property of the same name follows, which counts instead */
    uint32_t object;  /* what it became, where only one thing is made of it; 0: nothing */
    uint32_t variant; /* the same, of a material on flipped coordinates */
} element_t;

/* What stands for $NAME. Owned: value. */
typedef struct {
    char *value;
    bool defined; /* by the command line, not by the scene */
    bool used;
} parameter_t;

/* Owned: all (xml_free). */
typedef struct {
    element_t *root, *newest;
    scene_builder_t *scene;
    char **paths; /* of all files, for messages */
    size_t path_count, path_capacity;
    intern_t names; /* of the parameters, by their numbers */
    parameter_t *parameters;
    size_t parameter_capacity;
    uint64_t replaced; /* bytes that parameters have been replaced by */
} xml_t;

/* Reads the file and what it includes, with the definitions of the scene's wishes. A definition that nothing
 * uses is a warning. RESULT_USAGE: one is not NAME=VALUE. The caller calls xml_free, also after an error. */
result_t xml_read(const char *path, scene_builder_t *scene, xml_t *xml);
void xml_free(xml_t *xml);

/* The value of an attribute, or NULL. */
const char *element_attribute(const element_t *element, const char *name);
/* The path of a file that the scene names: relative to the main file's folder, as in Mitsuba, else to that of
 * the included file that names it. The caller frees it. */
char *element_path(const element_t *element, const char *name);

#endif
