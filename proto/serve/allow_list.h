/* allow_list: the list of the keys that a master admits: a text file with a line for every key.
 *
 *     # the farm
 *     worker KEY render-1        may work
 *     client KEY ada             may submit and control jobs
 *     all    KEY tower           may do both
 *
 * The name is for people: it is the rest of the line, up to a '#'. */
#ifndef LIGHTMILL_ALLOW_LIST_H
#define LIGHTMILL_ALLOW_LIST_H

#include "proto/wire/wire.h"

enum {
    ALLOW_MAX_KEYS = 1 << 16,
    ALLOW_MAX_FILE = 16 << 20 /* bytes */
};

typedef struct {
    char key[KEY_TEXT + 1];
    char name[KEY_MAX_NAME + 1];
    unsigned rights;
    int line;
} allow_entry_t;

typedef struct {
    allow_entry_t *entries; /* by key */
    size_t count;
} allow_list_t;

/* The list in the bytes of a file. RESULT_INPUT names `path` and the line; the list is empty then. */
result_t allow_list_parse(const char *text, size_t size, const char *path, allow_list_t *list);
result_t allow_list_read(const char *path, allow_list_t *list);
void allow_list_free(allow_list_t *list);
/* NULL when the key is not on the list. */
const allow_entry_t *allow_list_find(const allow_list_t *list, const char *key);
/* True when `list` gives every key of `other` all the rights that it has there. */
bool allow_list_holds(const allow_list_t *list, const allow_list_t *other);

#endif
