/* guess: what somebody who mistyped a word may have meant. */
#ifndef LIGHTMILL_GUESS_H
#define LIGHTMILL_GUESS_H

#include <stddef.h>

/* Zeroed but for `wrong` to begin with. */
typedef struct {
    const char *wrong, *nearest; /* nearest: of what was offered; NULL: nothing is near */
    size_t distance;
} guess_t;

/* Holds one more of the right words against the wrong one. `right` is kept. */
void guess_offer(guess_t *guess, const char *right);

#endif
