/* names: a list of names with values, searched from the newest, so that an inner scope can hide an outer name
 * and be forgotten by cutting the list. */
#ifndef LIGHTMILL_NAMES_H
#define LIGHTMILL_NAMES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    struct name *items;
    size_t count, capacity;
} names_t;

/* Adds a copy of the name; an older one of the same name is hidden. */
void names_add(names_t *names, const char *name, uint32_t value);
bool names_find(const names_t *names, const char *name, uint32_t *value);
/* The same among the first `count` names alone. */
bool names_find_before(const names_t *names, size_t count, const char *name, uint32_t *value);
/* Forgets all but the first `count` names. */
void names_cut(names_t *names, size_t count);
/* Frees everything. */
void names_free(names_t *names);

#endif
