/* id_table: see id_table.h. */
#include "common/id_table.h"

#include <stdlib.h>
#include <string.h>

/* The place of the first entry that is not below a number. */
static size_t place_of(const id_table_t *table, uint64_t id)
{
    size_t low = 0, high = table->count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (table->entries[middle].id < id)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static bool is_at(const id_table_t *table, size_t at, uint64_t id)
{
    return at < table->count && table->entries[at].id == id;
}

size_t id_table_find(const id_table_t *table, uint64_t id)
{
    size_t at = place_of(table, id);
    return is_at(table, at, id) ? table->entries[at].index : SIZE_MAX;
}

void id_table_put(id_table_t *table, uint64_t id, size_t index)
{
    size_t at = place_of(table, id);
    if (!is_at(table, at, id)) {
        if (table->count == table->capacity) {
            table->capacity = 2 * table->capacity + 16;
            table->entries = mem_realloc(table->entries, table->capacity * sizeof *table->entries);
        }
        memmove(table->entries + at + 1, table->entries + at, (table->count - at) * sizeof *table->entries);
        table->count++;
    }
    table->entries[at] = (id_entry_t){id, index};
}

void id_table_remove(id_table_t *table, uint64_t id)
{
    size_t at = place_of(table, id);
    if (!is_at(table, at, id)) return;
    memmove(table->entries + at, table->entries + at + 1, (--table->count - at) * sizeof *table->entries);
}

void id_table_free(id_table_t *table)
{
    free(table->entries);
    *table = (id_table_t){.entries = NULL};
}
