/* arguments: what follows a directive's name.
 *
 * A directive's function (see the table in pbrt.c) is called with the place of its name when the name has
 * been read; it reads the rest. */
#ifndef LIGHTMILL_PBRT_ARGUMENTS_H
#define LIGHTMILL_PBRT_ARGUMENTS_H

#include "client/import/pbrt/state/state.h"

/* Reads a quoted string into p->arguments[slot], where it lives until the slot is read again. `what` says
 * what it is, for messages ("material"). */
result_t pbrt_read_string(pbrt_t *p, int slot, const char *what);
/* Reads `count` numbers, with or without brackets. */
result_t pbrt_read_numbers(pbrt_t *p, int count, double *numbers, const char *directive, position_t at);
/* Reads the parameters that follow into p->params. */
result_t pbrt_read_params(pbrt_t *p);
/* The same with the defaults of an Attribute directive behind them. */
result_t pbrt_read_params_for(pbrt_t *p, target_t target);
enum { LEFT_OUT = 1 << 30 };
/* Reads a type and its parameters, with the defaults of `target`: *index is its entry in a table as
 * entry_find takes it, or LEFT_OUT of an unknown type that pbrt-v3 or a lenient import leaves out. `what`
 * completes "expected ..." and `kind` "unknown ...". */
result_t pbrt_read_kind(pbrt_t *p, target_t target, const void *table, size_t count, size_t size,
                        const char *what, const char *kind, position_t at, size_t *index);
#define PBRT_READ_KIND(p, target, table, what, kind, at, index)                                              \
    pbrt_read_kind(p, target, table, ARRAY_LENGTH(table), sizeof *(table), what, kind, at, index)
/* Reports the parameters nobody read: `kind` and `name` say whose ("Camera", "perspective"). */
result_t pbrt_finish_params(pbrt_t *p, const char *kind, const char *name);

#endif
