/* master_option: which master a command speaks to, and how long it waits for answers. */
#ifndef LIGHTMILL_MASTER_OPTION_H
#define LIGHTMILL_MASTER_OPTION_H

#include "client/farm/remote.h"

typedef struct {
    const char *address; /* HOST[:PORT]; NULL: this machine */
    double timeout;      /* seconds */
    dial_options_t dial; /* keys */
} master_option_t;

extern const option_group_t master_options;
/* The groups of a command whose values have a master_option_t. */
#define MASTER_GROUPS(type, field)                                                                           \
    {&master_options, offsetof(type, field)},                                                                \
    {                                                                                                        \
        &dial_options, offsetof(type, field.dial)                                                            \
    }

master_option_t master_option_default(void);
/* The `begin` of a command whose values begin with a master_option_t. */
void master_option_begin(void *values);
/* Opens the connection; on failure *remote is NULL. */
result_t master_connect(const master_option_t *master, remote_t **remote);

#endif
