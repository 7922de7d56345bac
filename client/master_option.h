/* master_option: which master a command speaks to, and how long it waits for answers. */
#ifndef LIGHTMILL_MASTER_OPTION_H
#define LIGHTMILL_MASTER_OPTION_H

#include "client/remote.h"

typedef struct {
    const char *address; /* HOST[:PORT] */
    double timeout;      /* seconds */
    dial_options_t dial; /* keys */
} master_option_t;

/* Entries for a getopt_long table. */
#define MASTER_OPTIONS                                                                                       \
    DIAL_OPTIONS, {"master", required_argument, NULL, 0},                                                    \
    {                                                                                                        \
        "timeout", required_argument, NULL, 0                                                                \
    }
extern const char master_usage[];

master_option_t master_option_default(void);
/* Takes an option of MASTER_OPTIONS; *taken is false when it is another one. `value` is kept. */
result_t master_option(master_option_t *master, const char *option, const char *value, bool *taken);
/* Opens the connection; on failure *remote is NULL. */
result_t master_connect(const master_option_t *master, remote_t **remote);

#endif
