/* account: what `lightmill status --json` says of a job, and what must hold of it at any time. */
#ifndef LIGHTMILL_ACCOUNT_H
#define LIGHTMILL_ACCOUNT_H

#include <jansson.h>
#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint64_t job; /* its number; 0: the master does not know it */
    char state[16];
    uint64_t issued, counted, returned, out, skipped, total; /* pixel samples; total 0: an error ends it */
    uint64_t batches, batches_refused, units_reissued;
} account_t;

/* From the object of a job; false when a field is missing or no number. */
bool account_read(const json_t *object, account_t *account);
bool account_is(const account_t *account, const char *state);
/* NULL, or what is wrong. */
const char *account_check(const account_t *account);

#endif
