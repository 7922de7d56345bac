/* keygen: the command that makes a key. */
#include "client/commands.h"
#include "proto/wire/keys.h"

#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "usage: lightmill keygen [NAME] [options]\n"
    "\n"
    "Makes a key: NAME.secret, which is to stay here, and NAME.key, which may be given to anyone. Prints "
    "the\n"
    "line for the list of keys that a master lets in (its DATA/keys/allow); for a NAME of master, which is "
    "the\n"
    "master's own key, only the public half.\n"
    "\n"
    "  NAME               client, worker, relay, or what you like (client)\n"
    "  --out DIR          where the files go (~/.config/lightmill, where client.secret, worker.secret and\n"
    "                     master.key are found without being named)\n"
    "  --right RIGHT      what the line is to allow: worker (may work), client (may submit and control jobs) "
    "or\n"
    "                     all (worker for names that begin with worker or relay, else client)\n"
    "  --help\n"
    "\n"
    "Files that are there already are never written over. docs/security.md tells the rest.\n";

typedef struct {
    const char *name, *directory, *right;
    bool help;
} command_t;

/* A relay is a worker to its master. */
static const char *right_of(const char *name)
{
    bool works = strncmp(name, "worker", 6) == 0 || strncmp(name, "relay", 5) == 0;
    return works ? "worker" : "client";
}

static result_t parse_arguments(int argc, char **argv, command_t *command)
{
    static const struct option options[] = {{"out", required_argument, NULL, 'o'},
                                            {"right", required_argument, NULL, 'r'},
                                            {"help", no_argument, NULL, 'h'},
                                            {NULL, 0, NULL, 0}};
    *command = (command_t){.name = "client"};
    for (int found; (found = getopt_long(argc, argv, "o:", options, NULL)) != -1;) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill keygen --help");
        if (found == 'o') command->directory = optarg;
        if (found == 'r') command->right = optarg;
        if (found == 'h') command->help = true;
    }
    if (argc - optind > 1)
        return result_fail(RESULT_USAGE, "keygen takes one name; see lightmill keygen --help");
    if (optind < argc) command->name = argv[optind];
    if (command->right == NULL) command->right = right_of(command->name);
    if (strcmp(command->right, "worker") == 0 || strcmp(command->right, "client") == 0 ||
        strcmp(command->right, "all") == 0)
        return result_ok();
    return result_fail(RESULT_USAGE, "--right is worker, client or all, not '%.60s'", command->right);
}

result_t cmd_keygen(int argc, char **argv)
{
    command_t command;
    key_pair_t pair;
    TRY(parse_arguments(argc, argv, &command));
    if (command.help) {
        fputs(usage, stdout);
        return result_ok();
    }
    char *directory = command.directory != NULL ? mem_strdup(command.directory) : key_default_directory();
    if (directory == NULL) return result_fail(RESULT_USAGE, "there is no home directory here: say --out DIR");
    result_t result = key_files_make(directory, command.name, &pair);
    key_pair_forget(&pair);
    if (result.code == RESULT_OK) {
        fprintf(stderr, "wrote %s/%s.secret, which is to stay here, and %s.key\n", directory, command.name,
                command.name);
        if (strcmp(command.name, "master") == 0)
            printf("%s\n", pair.open);
        else
            printf("%s %s %s\n", command.right, pair.open, command.name);
    }
    free(directory);
    return result;
}
