/* intern: names of a file as numbers, 0, 1, 2 and so on in the order of their first use. A file may have as
 * many as it likes: finding one takes the same time among a million. */
#ifndef LIGHTMILL_INTERN_H
#define LIGHTMILL_INTERN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Use it zeroed. Owned: all of it (intern_free). */
typedef struct {
    char **texts; /* the names by their numbers, each with a NUL at its end */
    uint64_t *hashes;
    size_t count, text_capacity, hash_capacity;
    uint32_t *slots; /* 1 + a number; a power of two of them, at most half of them in use */
    size_t slot_count;
} intern_t;

/* The number of a name of `length` bytes, which is added where it is new. At most 2^31 names. */
uint32_t intern_add(intern_t *names, const char *text, size_t length);
/* False when there is none of that name. */
bool intern_find(const intern_t *names, const char *text, size_t length, uint32_t *number);
/* Frees everything. */
void intern_free(intern_t *names);

#endif
