/* passes: see passes.h. */
#include "tests/chaos/passes.h"

#include "tests/chaos/command.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

passes_t passes_open(void)
{
    return (passes_t){.master = {"--insecure"},
                      .worker = {"--insecure"},
                      .client = {"--insecure"},
                      .relay = {"--insecure"},
                      .relay_worker = {"--insecure"}};
}

/* The line for the list, "RIGHT KEY NAME", among what keygen says. */
static void add_to_list(FILE *list, const char *right, char *said)
{
    for (char *line; (line = strsep(&said, "\n")) != NULL;)
        if (strncmp(line, right, strlen(right)) == 0) fprintf(list, "%s\n", line);
}

/* Runs `lightmill keygen`; what it prints is the line for the list. */
static result_t make_key(const char *folder, const char *name, const char *right, FILE *list)
{
    command_t command = {0};
    command_state_t state;
    char *output = mem_printf("%s/%s.log", folder, name);
    command_start(&command, output,
                  (const char *[]){"keygen", name, "--out", folder, right ? "--right" : NULL, right, NULL},
                  false);
    while ((state = command_poll(&command, clock_now(), 60)) == COMMAND_RUNS) usleep(1000);
    char *said = command_said(&command);
    result_t result = result_ok();
    if (state != COMMAND_DONE)
        result = result_fail(RESULT_IO, "no key for %s: %.300s", name, said);
    else if (list)
        add_to_list(list, right, said);
    free(said);
    free(output);
    command_end(&command);
    return result;
}

static result_t make_keys(const char *folder, FILE *list)
{
    TRY(make_key(folder, "master", NULL, NULL));
    TRY(make_key(folder, "worker", "worker", list));
    TRY(make_key(folder, "relay", "worker", list));
    return make_key(folder, "client", "client", list);
}

result_t passes_with_keys(const char *folder, passes_t *passes)
{
    enum { ALLOW, MASTER_KEY, MASTER, WORKER, CLIENT, RELAY, RELAY_KEY };
    static const char *const names[PASS_FILES] = {"allow",         "master.key",    "master.secret",
                                                  "worker.secret", "client.secret", "relay.secret",
                                                  "relay.key"};
    char *files[PASS_FILES];
    for (int i = 0; i < PASS_FILES; i++) files[i] = mem_printf("%s/%s", folder, names[i]);
    char *allow = files[ALLOW], *master = files[MASTER_KEY];
    mkdir(folder, 0700);
    FILE *list = fopen(allow, "we");
    if (list == NULL) return result_fail(RESULT_IO, "%s cannot be written", allow);
    result_t result = make_keys(folder, list);
    fclose(list);
    *passes = (passes_t){.master = {"--key", files[MASTER], "--allow", allow},
                         .worker = {"--key", files[WORKER], "--master-key", master},
                         .client = {"--key", files[CLIENT], "--master-key", master},
                         .relay = {"--key", files[RELAY], "--master-key", master, "--allow", allow},
                         .relay_worker = {"--key", files[WORKER], "--master-key", files[RELAY_KEY]}};
    memcpy(passes->files, files, sizeof passes->files);
    return result;
}

void passes_free(passes_t *passes)
{
    for (int i = 0; i < PASS_FILES; i++) free(passes->files[i]);
}
