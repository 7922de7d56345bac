/* master_option: see master_option.h. */
#include "client/farm/master_option.h"

#include <stdlib.h>

static const option_t rows[] = {
    OPTION(master_option_t, address, "master", "HOST[:PORT]",
           "the master (default: $LIGHTMILL_MASTER or 127.0.0.1:7420)", .environment = "LIGHTMILL_MASTER"),
    OPTION(master_option_t, timeout, "timeout", "SECONDS", "how long to wait for its answers (default: 5)",
           OPTION_RANGE(0.01, 1e6)),
};
const option_group_t master_options = OPTION_GROUP("The master", rows);

master_option_t master_option_default(void)
{
    return (master_option_t){.timeout = REMOTE_DEFAULT_TIMEOUT, .dial.role = "client"};
}

void master_option_begin(void *values)
{
    *(master_option_t *)values = master_option_default();
}

result_t master_connect(const master_option_t *master, remote_t **remote)
{
    dial_keys_t keys;
    char *endpoint;
    *remote = NULL;
    TRY(dial_find(&master->dial, master->address, &keys, &endpoint));
    result_t result = remote_open_with(NULL, endpoint, NULL, master->timeout, &keys, remote);
    free(endpoint);
    return result;
}
