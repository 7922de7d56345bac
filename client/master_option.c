/* master_option: see master_option.h. */
#include "client/master_option.h"

#include "client/options.h"
#include "common/address.h"

#include <stdlib.h>
#include <string.h>

const char master_usage[] =
    "  --master HOST[:PORT]  the master (default: $LIGHTMILL_MASTER or 127.0.0.1:7420)\n"
    "  --timeout SECONDS  how long to wait for its answers (default: 5)\n";

master_option_t master_option_default(void)
{
    const char *address = getenv("LIGHTMILL_MASTER");
    return (master_option_t){.address = address && address[0] ? address : "127.0.0.1",
                             .timeout = REMOTE_DEFAULT_TIMEOUT,
                             .dial.role = "client"};
}

result_t master_option(master_option_t *master, const char *option, const char *value, bool *taken)
{
    *taken = true;
    if (dial_option(&master->dial, option, value)) return result_ok();
    if (strcmp(option, "master") == 0)
        master->address = value;
    else if (strcmp(option, "timeout") == 0)
        return option_real(option, value, 0.01, 1e6, &master->timeout);
    else
        *taken = false;
    return result_ok();
}

result_t master_connect(const master_option_t *master, remote_t **remote)
{
    address_t address;
    *remote = NULL;
    TRY(address_parse(master->address, WIRE_DEFAULT_PORT, &address));
    dial_keys_t keys;
    TRY(dial_keys_find(&master->dial, address.host, &keys));
    char *endpoint = address_endpoint(&address, address.port);
    result_t result = remote_open_with(NULL, endpoint, NULL, master->timeout, &keys, remote);
    free(endpoint);
    return result;
}
