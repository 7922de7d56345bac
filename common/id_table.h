/* id_table: where things lie by their number: 64-bit numbers, each with an index into an array of its owner.
 *
 * A sorted array, which is searched by halves: with 8,192 numbers that is 13 steps. Numbers come and go far
 * more rarely than they are looked for, so that moving the rest along (128 kB at most) costs less than the
 * pointers, and the fixed addresses, that a hash table in C asks for. All zero is an empty table. */
#ifndef LIGHTMILL_ID_TABLE_H
#define LIGHTMILL_ID_TABLE_H

#include "common/base.h"

typedef struct {
    uint64_t id;
    size_t index;
} id_entry_t;

typedef struct {
    id_entry_t *entries; /* sorted by id */
    size_t count, capacity;
} id_table_t;

/* The index of a number; SIZE_MAX when it is not there. */
size_t id_table_find(const id_table_t *table, uint64_t id);
/* Adds a number, or gives it another index. */
void id_table_put(id_table_t *table, uint64_t id, size_t index);
/* Takes a number out, if it is there. */
void id_table_remove(id_table_t *table, uint64_t id);
/* Frees what the table holds; it is empty again. */
void id_table_free(id_table_t *table);

#endif
