/* passes: how the processes of a run show who they are: with keys, or with the word that there are none. */
#ifndef LIGHTMILL_PASSES_H
#define LIGHTMILL_PASSES_H

#include "common/base.h"

enum { PASS_WORDS = 6, PASS_FILES = 7 };

/* Options for the command lines, NULL-terminated. */
typedef struct {
    const char *master[PASS_WORDS], *worker[PASS_WORDS], *client[PASS_WORDS];
    const char *relay[PASS_WORDS + 2], *relay_worker[PASS_WORDS]; /* and of workers behind it */
    char *files[PASS_FILES];                                      /* that are named in them; owned */
} passes_t;

/* Everything is open. */
passes_t passes_open(void);
/* Makes keys and the list of those that are let in, in a new folder. */
result_t passes_with_keys(const char *folder, passes_t *passes);
void passes_free(passes_t *passes);

#endif
