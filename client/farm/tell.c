/* tell: see tell.h. */
#include "client/farm/tell.h"

#include <stdlib.h>

static const double PATIENCE = 60; /* seconds */

static const option_t rows[] = {
    OPTION_BY(
        option_notify, tell_t, target, "notify", "URL|COMMAND",
        "when the job is over and its image written, post JSON to a URL, or run a command on this machine "
        "with it as input and in LIGHTMILL_... variables; tried again for a minute (docs/notify.md)"),
};
const option_group_t tell_options = OPTION_GROUP("When it is over", rows);

result_t tell_check(const tell_t *tell, bool waits)
{
    if (tell->target == NULL || waits) return result_ok();
    return result_fail(RESULT_USAGE,
                       "--notify needs --wait: it is this command that tells; a master tells of all "
                       "its jobs when it is started with --notify itself");
}

void tell_news(const tell_t *tell, const news_t *news)
{
    if (tell->target == NULL) return;
    result_t result = notify_insist(tell->target, news, NOTIFY_LIMIT, PATIENCE);
    if (result.code == RESULT_OK) return;
    char *label = notify_label(tell->target);
    log_error("nobody is told that the job is over: %s: %s", label, result.message);
    free(label);
}
