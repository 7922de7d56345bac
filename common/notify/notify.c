/* notify: see notify.h. */
#include "common/notify/notify.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>

static const double LONGEST_PAUSE = 60; /* seconds */

static bool is_url(const char *target)
{
    return strncasecmp(target, "http://", 7) == 0 || strncasecmp(target, "https://", 8) == 0;
}

/* True for "ftp://host", which would be a strange command. */
static bool has_other_scheme(const char *text)
{
    const char *colon = strstr(text, "://");
    return colon != NULL && strcspn(text, " \t\n") > (size_t)(colon - text) && !is_url(text) &&
           strcspn(text, "/='\"$") > (size_t)(colon - text);
}

result_t option_notify(const option_t *option, const char *text, void *field)
{
    if (text[strspn(text, " \t\n")] == '\0')
        return result_fail(RESULT_USAGE, "--%s takes a URL or a command, not nothing", option->name);
    if (has_other_scheme(text))
        return result_fail(RESULT_USAGE, "--%s posts to http:// and https:// only, not to %.100s",
                           option->name, text);
    *(const char **)field = text;
    return result_ok();
}

char *notify_label(const char *target)
{
    if (!is_url(target)) return mem_strdup("the command");
    const char *host = strstr(target, "://") + 3;
    size_t end = strcspn(host, "/?#");
    for (size_t i = 0; i < end; i++)
        if (host[i] == '@') { /* a name and a password */
            host += i + 1;
            end -= i + 1;
            i = (size_t)-1;
        }
    return mem_printf("%.*s%.*s", (int)(strstr(target, "://") + 3 - target), target, (int)end, host);
}

result_t notify_once(const char *target, const news_t *news, double limit, const atomic_bool *stop)
{
    return (is_url(target) ? notify_post : notify_command)(target, news, limit, stop);
}

double notify_pause(uint32_t failures)
{
    return failures > 6 ? LONGEST_PAUSE : fmin(ldexp(1, (int)failures - 1), LONGEST_PAUSE);
}

static void sleep_seconds(double seconds)
{
    struct timespec time = {.tv_sec = (time_t)seconds, .tv_nsec = (long)(1e9 * fmod(seconds, 1))};
    nanosleep(&time, NULL);
}

result_t notify_insist(const char *target, const news_t *news, double limit, double patience)
{
    double end = clock_now() + patience;
    for (uint32_t failures = 1;; failures++) {
        result_t result = notify_once(target, news, fmin(limit, fmax(end - clock_now(), 1)), NULL);
        double pause = notify_pause(failures);
        if (result.code == RESULT_OK || clock_now() + pause >= end) return result;
        log_debug("not told: %s", result.message);
        sleep_seconds(pause);
    }
}
