/* service_options: see service_options.h. */
#include "common/options/service_options.h"

#include "common/health.h"

#include <stdio.h>

static const option_t rows[] = {
    OPTION(service_options_t, quiet, "quiet", NULL, "log warnings and errors only"),
    OPTION(service_options_t, verbose, "verbose", NULL, "log every batch and assignment"),
    OPTION(service_options_t, health, "health", "PATH",
           "tell on this Unix socket how the program is (default: $LIGHTMILL_HEALTH)",
           .environment = "LIGHTMILL_HEALTH"),
    OPTION(service_options_t, ask_health, "ask-health", NULL,
           "ask the program that runs there, print its answer, exit 0 if it is well"),
};
const option_group_t service_options = OPTION_GROUP("Log and health", rows);

log_level_t service_log_level(const service_options_t *options)
{
    return options->verbose ? LOG_DEBUG : options->quiet ? LOG_WARNING : LOG_INFO;
}

result_t service_ask_health(const service_options_t *options)
{
    char text[500];
    if (options->health == NULL)
        return result_fail(RESULT_USAGE, "whom to ask? Give --health PATH or set LIGHTMILL_HEALTH");
    TRY(health_ask(options->health, text, sizeof text));
    puts(text);
    return result_ok();
}
