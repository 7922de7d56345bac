/* item: a value of a glTF file's JSON, with the way to it, so that every message can name it.
 *
 * The getters check type and range, and say what is wrong with which property. A property that is absent
 * leaves the caller's default as it is. Items lie on the stack: an item must not outlive its parent.
 */
#ifndef LIGHTMILL_ITEM_H
#define LIGHTMILL_ITEM_H

#include <jansson.h>

#include "client/import/scene/report.h"

/* No such index; no glTF file has that many things. */
#define ITEM_NONE UINT32_MAX

typedef struct item {
    const char *path; /* of the file */
    report_t *report;
    const json_t *json;        /* NULL: the property is absent */
    const struct item *parent; /* NULL: the file's root */
    const char *key;           /* of a property of an object; NULL: an element of an array */
    size_t index;              /* of that element */
} item_t;

/* "path: materials[3] (gold).normalTexture: text" as a RESULT_INPUT result, or as a warning. */
result_t item_fail(const item_t *item, const char *format, ...) __attribute__((format(printf, 2, 3)));
void item_warn(const item_t *item, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* The way from the root, "materials[3] (gold).normalTexture"; cut short where there is no room. Control
 * characters, which names may hold, become '?'. */
void item_name(const item_t *item, char *text, size_t size);

/* The property `key` of an object; out->json is NULL when it is absent. An error when it is not of the type:
 * JSON_OBJECT, JSON_ARRAY or JSON_STRING. */
result_t item_member(const item_t *object, const char *key, json_type type, item_t *out);
/* The element of an array, index in range, likewise. */
result_t item_element(const item_t *array, size_t index, json_type type, item_t *out);
/* Elements of an array; 0 when it is absent. */
size_t item_count(const item_t *array);
/* The object extensions[name]; out->json is NULL when it is absent. */
result_t item_extension(const item_t *object, const char *name, item_t *out);

/* A number; outside of [low, high] it is moved there with a warning. */
result_t item_number(const item_t *object, const char *key, double low, double high, double *value);
/* The same for `count` numbers; *present, which may be NULL, says whether they are there. */
result_t item_numbers(const item_t *object, const char *key, size_t count, double low, double high,
                      double *values, bool *present);
/* A whole number from 0 to `most`; anything else is an error. */
result_t item_whole(const item_t *object, const char *key, uint64_t most, uint64_t *value);
/* An index below `count`. */
result_t item_index(const item_t *object, const char *key, size_t count, uint32_t *index);
/* The i-th element of an array, in range, which must be an index below `count`; `things` are what it counts,
 * for messages: "nodes". */
result_t item_index_at(const item_t *array, size_t i, size_t count, const char *things, uint32_t *index);
result_t item_bool(const item_t *object, const char *key, bool *value);
/* Owned by the file's JSON. */
result_t item_string(const item_t *object, const char *key, const char **value);

/* The "name" of an array's object; "" when it has none. Owned by the file's JSON. */
result_t item_name_at(const item_t *array, size_t index, const char **name);
enum { ITEM_LIST_ROOM = 240 };
/* "1: beach, 2: street": all of these, for messages; cut short where there is no room. */
result_t item_list_names(const item_t *array, char list[ITEM_LIST_ROOM]);

#endif
