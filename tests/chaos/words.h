/* words: a command line that is put together piece by piece, NULL-terminated at any time. */
#ifndef LIGHTMILL_WORDS_H
#define LIGHTMILL_WORDS_H

#include <stddef.h>

enum { WORDS_MAX = 60 };

typedef struct {
    const char *list[WORDS_MAX + 1];
    size_t count;
} words_t;

/* Words belong to the caller; what is over WORDS_MAX is left out. */
static inline void words_add(words_t *words, const char *word)
{
    if (words->count < WORDS_MAX) words->list[words->count++] = word;
}

static inline void words_add_all(words_t *words, const char *const *list)
{
    for (; *list; list++) words_add(words, *list);
}

/* Words from a list in the code. */
#define WORDS_ADD(words, ...) words_add_all(words, (const char *[]){__VA_ARGS__, NULL})

#endif
