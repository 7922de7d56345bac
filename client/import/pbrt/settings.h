/* settings: what all directives before WorldBegin share. pbrt stores them, and makes the last of each kind at
 * WorldBegin; each is an entry in a table of the types that pbrt knows.
 */
#ifndef LIGHTMILL_PBRT_SETTINGS_H
#define LIGHTMILL_PBRT_SETTINGS_H

#include "client/import/pbrt/state/state.h"

/* A type, and what reads its parameters. */
typedef struct {
    dialect_entry_t entry;
    result_t (*make)(pbrt_t *p, params_t *params);
} setting_entry_t;

/* Reads the type (`what` in messages) and the parameters, and stores them. As in pbrt the last of each kind
 * counts, and what was wrong with the others does not. */
result_t setting_keep(pbrt_t *p, setting_kind_t kind, const char *directive, const char *what, position_t at);
/* Puts a stored setting where its directive had it: in the state's arguments and parameters. False when there
 * is none. */
bool setting_recall(pbrt_t *p, setting_kind_t kind);
/* The entry of the recalled type in a table of records that begin with a dialect_entry_t: *index. Of an
 * unknown one a lenient import takes `nearest`; else, or when it belongs to the other dialect, RESULT_INPUT.
 */
result_t setting_find(pbrt_t *p, const void *table, size_t count, size_t size, const char *kind,
                      const char *nearest, position_t at, size_t *index);
#define SETTING_FIND(p, table, kind, nearest, at, index)                                                     \
    setting_find(p, table, ARRAY_LENGTH(table), sizeof *(table), kind, nearest, at, index)
/* Lets the table's function make what has been recalled; the nearest of an unknown type is the first of the
 * dialect. */
result_t setting_make(pbrt_t *p, const setting_entry_t *table, size_t count, const char *directive,
                      const char *kind, position_t at);

#endif
