/* guess: see guess.h. */
#include "common/options/guess.h"

#include <string.h>

enum { LONGEST = 40, FAR = 2 /* mistakes in a word that is still recognised */ };

static size_t least_of(size_t a, size_t b, size_t c)
{
    size_t least = a < b ? a : b;
    return least < c ? least : c;
}

/* How many letters must be put in, taken out or exchanged (Levenshtein 1966), row by row of the table. */
static size_t distance(const char *a, const char *b)
{
    size_t columns = strlen(b), row[LONGEST + 1];
    for (size_t k = 0; k <= columns; k++) row[k] = k;
    for (size_t i = 1; a[i - 1] != '\0'; i++) {
        size_t diagonal = row[0];
        row[0] = i;
        for (size_t k = 1; k <= columns; k++) {
            size_t above = row[k];
            row[k] = least_of(above + 1, row[k - 1] + 1, diagonal + (a[i - 1] != b[k - 1]));
            diagonal = above;
        }
    }
    return row[columns];
}

void guess_offer(guess_t *guess, const char *right)
{
    if (strlen(right) > LONGEST || strlen(guess->wrong) > LONGEST) return;
    size_t mistakes = distance(guess->wrong, right);
    if (mistakes > FAR || mistakes >= strlen(right)) return;
    if (guess->nearest != NULL && mistakes >= guess->distance) return;
    guess->nearest = right;
    guess->distance = mistakes;
}
