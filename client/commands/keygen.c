/* keygen: the command that makes a key. */
#include "client/commands/commands.h"
#include "proto/wire/keys.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef struct {
    const char *directory, *right; /* NULL: the default */
} values_t;

static const char *const rights[] = {"worker", "client", "all", NULL};

static const option_t rows[] = {
    OPTION(
        values_t, directory, "out", "DIR",
        "where the files go (default: ~/.config/lightmill, where client.secret, worker.secret and master.key "
        "are found without being named)",
        .letter = 'o'),
    OPTION(
        values_t, right, "right", "RIGHT",
        "what the line is to allow: worker (may work), client (may submit and control jobs) or all (default: "
        "worker for names that begin with worker or relay, else client)",
        .choices = rights),
};
static const option_group_t keygen_options = OPTION_GROUP(NULL, rows);

/* A relay is a worker to its master. */
static const char *right_of(const char *name)
{
    bool works = strncmp(name, "worker", 6) == 0 || strncmp(name, "relay", 5) == 0;
    return works ? "worker" : "client";
}

/* Names the key after this machine: a list of twenty keys called "worker" tells nothing. */
static void print_line(const char *right, const char *key, const char *name)
{
    char host[200] = "", called[KEY_MAX_NAME + 1];
    bool known = gethostname(host, sizeof host - 1) == 0 && host[0] != '\0';
    int length = snprintf(called, sizeof called, "%s%s%s", name, known ? "@" : "", host);
    if (length >= (int)sizeof called) snprintf(called, sizeof called, "%s", name);
    fprintf(stderr, "on the master's machine, in its directory: lightmill allow '%s %s %s'\n", right, key,
            called);
    printf("%s %s %s\n", right, key, called);
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    const char *name = call->count > 0 ? call->arguments[0] : "client";
    key_pair_t pair;
    char *directory = values->directory ? mem_strdup(values->directory) : key_default_directory();
    if (directory == NULL) return result_fail(RESULT_USAGE, "there is no home directory here: say --out DIR");
    result_t result = key_files_make(directory, name, &pair);
    key_pair_forget(&pair);
    if (result.code == RESULT_OK) {
        fprintf(stderr, "wrote %s/%s.secret, which is to stay here, and %s.key\n", directory, name, name);
        if (strcmp(name, "master") == 0)
            printf("%s\n", pair.open);
        else
            print_line(values->right ? values->right : right_of(name), pair.open, name);
    }
    free(directory);
    return result;
}

const command_t keygen_command = {
    .name = "lightmill keygen",
    .arguments = "[NAME]",
    .summary = "a key, to be let in by a master on another machine",
    .about =
        "Makes a key: NAME.secret, which is to stay here, and NAME.key, which may be given to anyone. NAME "
        "is client, worker, relay, or what you like (default: client). Prints the line for the list of "
        "keys that a master lets in (its DATA/keys/allow); for a NAME of master, which is the master's own "
        "key, only the public half.",
    .groups = {{&keygen_options, 0}},
    .after = "Files that are there already are never written over. docs/security.md tells the rest.",
    .size = sizeof(values_t),
    .run = run};
