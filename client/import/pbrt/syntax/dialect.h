/* dialect: pbrt-v3 or pbrt-v4, and the entries of the tables by which the two are told apart and served.
 *
 * The two dialects share their syntax; they differ in names and defaults. Every name that the importer knows
 * (a directive, a material, a shape, ...) is a table entry that begins with a dialect_entry_t and says in
 * which dialects it exists. The dialect of a scene is that of the first thing in its main file which only one
 * of them has:
 *
 *   - a directive (WorldEnd is v3's; Attribute, Option, ColorSpace, Import are v4's),
 *   - the type that a Film, Camera, Sampler, Integrator, Material or MakeNamedMaterial names,
 *   - a bare true or false (v4).
 *
 * So WorldEnd decides at the latest, and a scene with nothing to tell is v4, which has no WorldEnd. A name of
 * the other dialect further down is an error that says what the scene was taken for, and why.
 */
#ifndef LIGHTMILL_DIALECT_H
#define LIGHTMILL_DIALECT_H

#include "client/import/pbrt/syntax/lexer.h"

typedef enum { DIALECT_V3 = 1, DIALECT_V4 = 2, DIALECT_BOTH = 3 } dialect_t;

typedef struct {
    dialect_t dialect;
    position_t at;                   /* of the evidence; line 0: there is none */
    char evidence[TOKEN_QUOTE_SIZE]; /* the token that decided */
} dialect_choice_t;

/* What every table of named things begins with. */
typedef struct {
    const char *name;
    dialect_t dialects;
} dialect_entry_t;

/* Looks through the main file. Malformed input only ends the search; the parser will report it. */
dialect_choice_t dialect_detect(const char *path, const char *data, size_t size);

/* Whether a table has an entry called `name`, of either dialect. */
bool entry_knows(const void *table, size_t count, size_t size, const char *name);

/* The entry called `name` in a table of `count` records of `size` bytes that begin with a dialect_entry_t:
 * *index. Fails at `at` when the name is unknown or belongs to the other dialect; `kind` says what it was to
 * be ("material"). */
result_t entry_find(const void *table, size_t count, size_t size, const char *kind, const char *name,
                    const dialect_choice_t *choice, position_t at, size_t *index);

#endif
