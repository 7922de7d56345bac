/* passes: see passes.h. */
#include "tests/chaos/passes.h"

#include "tests/chaos/errand.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

passes_t passes_open(void)
{
    return (passes_t){.master = {"--insecure"}, .worker = {"--insecure"}, .client = {"--insecure"}};
}

/* The line for the list, "worker KEY NAME", among what keygen says. */
static void add_to_list(FILE *list, const char *name, char *said)
{
    for (char *line; (line = strsep(&said, "\n")) != NULL;)
        if (strncmp(line, name, strlen(name)) == 0) fprintf(list, "%s\n", line);
}

static result_t make_key(const char *folder, const char *name, FILE *list)
{
    errand_t errand = {0};
    errand_state_t state;
    char *output = mem_printf("%s/%s.log", folder, name);
    errand_start(&errand, output, (const char *[]){"keygen", name, "--out", folder, NULL}, false);
    while ((state = errand_poll(&errand, clock_now(), 60)) == ERRAND_RUNS) usleep(1000);
    char *said = errand_said(&errand);
    result_t result = result_ok();
    if (state != ERRAND_DONE)
        result = result_fail(RESULT_IO, "no key for %s: %.300s", name, said);
    else if (list)
        add_to_list(list, name, said);
    free(said);
    free(output);
    errand_end(&errand);
    return result;
}

result_t passes_with_keys(const char *folder, passes_t *passes)
{
    char *allow = mem_printf("%s/allow", folder), *master = mem_printf("%s/master.secret", folder);
    char *public = mem_printf("%s/master.key", folder);
    mkdir(folder, 0700);
    TRY(make_key(folder, "master", NULL));
    FILE *list = fopen(allow, "we");
    if (list == NULL) return result_fail(RESULT_IO, "%s cannot be written", allow);
    result_t result = make_key(folder, "worker", list);
    if (result.code == RESULT_OK) result = make_key(folder, "client", list);
    fclose(list);
    *passes = (passes_t){.master = {"--key", master, "--allow", allow},
                         .worker = {"--key", mem_printf("%s/worker.secret", folder), "--master-key", public},
                         .client = {"--key", mem_printf("%s/client.secret", folder), "--master-key", public}};
    return result;
}
