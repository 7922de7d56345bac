/* intern: see intern.h. An open hash table with linear probing. */
#include "client/import/files/intern.h"

#include <stdlib.h>
#include <string.h>

#include "client/import/scene/report.h"

/* FNV-1a, its halves mixed, since the slots look at the lower bits. */
static uint64_t hash_of(const char *text, size_t length)
{
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < length; ++i) hash = (hash ^ (uint8_t)text[i]) * 1099511628211u;
    return hash ^ (hash >> 32);
}

/* The slot that holds the name, or the free one where it belongs. */
static size_t slot_of(const intern_t *names, uint64_t hash, const char *text, size_t length)
{
    size_t mask = names->slot_count - 1, at = hash & mask;
    for (; names->slots[at] != 0; at = (at + 1) & mask) {
        uint32_t number = names->slots[at] - 1;
        const char *found = names->texts[number];
        if (names->hashes[number] == hash && strlen(found) == length && memcmp(found, text, length) == 0)
            break;
    }
    return at;
}

static void enlarge(intern_t *names)
{
    free(names->slots);
    names->slot_count = names->slot_count ? 2 * names->slot_count : 64;
    names->slots = mem_zalloc(names->slot_count, sizeof *names->slots);
    size_t mask = names->slot_count - 1;
    for (size_t i = 0; i < names->count; ++i) {
        size_t at = names->hashes[i] & mask;
        while (names->slots[at] != 0) at = (at + 1) & mask;
        names->slots[at] = (uint32_t)i + 1;
    }
}

uint32_t intern_add(intern_t *names, const char *text, size_t length)
{
    if (2 * (names->count + 1) > names->slot_count) enlarge(names);
    uint64_t hash = hash_of(text, length);
    size_t at = slot_of(names, hash, text, length);
    if (names->slots[at] != 0) return names->slots[at] - 1;
    names->texts = grow(names->texts, &names->text_capacity, names->count + 1, sizeof *names->texts);
    names->hashes = grow(names->hashes, &names->hash_capacity, names->count + 1, sizeof *names->hashes);
    char *copy = mem_alloc(length + 1);
    memcpy(copy, text, length);
    copy[length] = '\0';
    names->texts[names->count] = copy;
    names->hashes[names->count++] = hash;
    names->slots[at] = (uint32_t)names->count;
    return (uint32_t)names->count - 1;
}

bool intern_find(const intern_t *names, const char *text, size_t length, uint32_t *number)
{
    if (names->count == 0) return false;
    size_t at = slot_of(names, hash_of(text, length), text, length);
    if (names->slots[at] == 0) return false;
    *number = names->slots[at] - 1;
    return true;
}

void intern_free(intern_t *names)
{
    for (size_t i = 0; i < names->count; ++i) free(names->texts[i]);
    free(names->texts);
    free(names->hashes);
    free(names->slots);
    *names = (intern_t){0};
}
