/* account: see account.h. */
#include "tests/chaos/jobs/account.h"

#include <stdio.h>
#include <string.h>

/* Takes a number out of a job's status. */
static bool number_of(const json_t *object, const char *name, uint64_t *value)
{
    const json_t *field = json_object_get(object, name);
    if (!json_is_integer(field) || json_integer_value(field) < 0) return false;
    *value = (uint64_t)json_integer_value(field);
    return true;
}

bool account_read(const json_t *object, account_t *account)
{
    const char *state = json_string_value(json_object_get(object, "state"));
    if (state == NULL) return false;
    snprintf(account->state, sizeof account->state, "%s", state);
    return number_of(object, "job", &account->job) && number_of(object, "samples_issued", &account->issued) &&
           number_of(object, "samples_counted", &account->counted) &&
           number_of(object, "samples_returned", &account->returned) &&
           number_of(object, "samples_out", &account->out) &&
           number_of(object, "samples_skipped", &account->skipped) &&
           number_of(object, "samples_total", &account->total) &&
           number_of(object, "batches", &account->batches) &&
           number_of(object, "batches_refused", &account->batches_refused) &&
           number_of(object, "units_reissued", &account->units_reissued);
}

bool account_is(const account_t *account, const char *state)
{
    return strcmp(account->state, state) == 0;
}

const char *account_check(const account_t *a)
{
    if (a->issued != a->counted + a->returned + a->out) return "issued is not counted + returned + out";
    if (a->total > 0 && a->counted > a->total) return "more is counted than wanted";
    if (a->skipped > 0) return "samples were skipped";
    if (account_is(a, "failed") || account_is(a, "cancelled")) return "it has ended badly";
    if (!account_is(a, "done")) return NULL;
    if (a->out > 0) return "it is done and samples are out";
    if (a->total > 0 && a->counted != a->total) return "it is done and not all is counted";
    return NULL;
}
