/* names: see names.h. A hash is compared before the text; scenes have at most some thousands of names. */
#include "client/import/pbrt/syntax/names.h"

#include <stdlib.h>
#include <string.h>

#include "client/import/scene/report.h"

struct name {
    char *text;
    uint32_t hash, value;
};

/* FNV-1a */
static uint32_t hash_of(const char *text)
{
    uint32_t hash = 2166136261u;
    for (; *text; ++text) hash = (hash ^ (uint8_t)*text) * 16777619u;
    return hash;
}

void names_add(names_t *names, const char *name, uint32_t value)
{
    names->items = grow(names->items, &names->capacity, names->count + 1, sizeof *names->items);
    names->items[names->count++] = (struct name){mem_strdup(name), hash_of(name), value};
}

bool names_find(const names_t *names, const char *name, uint32_t *value)
{
    return names_find_before(names, names->count, name, value);
}

bool names_find_before(const names_t *names, size_t count, const char *name, uint32_t *value)
{
    uint32_t hash = hash_of(name);
    for (size_t i = count < names->count ? count : names->count; i-- > 0;) {
        const struct name *item = &names->items[i];
        if (item->hash != hash || strcmp(item->text, name) != 0) continue;
        *value = item->value;
        return true;
    }
    return false;
}

void names_cut(names_t *names, size_t count)
{
    while (names->count > count) free(names->items[--names->count].text);
}

void names_free(names_t *names)
{
    names_cut(names, 0);
    free(names->items);
    *names = (names_t){0};
}
