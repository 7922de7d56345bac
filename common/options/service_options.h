/* service_options: what all programs that serve take on their command line: how much they log, and how they
 * tell whether they are well. */
#ifndef LIGHTMILL_SERVICE_OPTIONS_H
#define LIGHTMILL_SERVICE_OPTIONS_H

#include "common/options/options.h"

typedef struct {
    bool quiet, verbose;
    const char *health; /* the socket that tells (common/health.h); NULL: nobody is told */
    bool ask_health;    /* ask the program that runs there, instead of being one */
} service_options_t;
extern const option_group_t service_options;

log_level_t service_log_level(const service_options_t *options);
/* Asks the program that runs, and prints its answer. */
result_t service_ask_health(const service_options_t *options);

#endif
