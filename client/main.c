/* lightmill: the command of people. This file only finds the subcommand and turns its result into an exit
 * code. */
#include "client/commands.h"

#include <stdio.h>
#include <string.h>

static const char usage[] =
    "usage: lightmill COMMAND [arguments]\n"
    "\n"
    "  render SCENE     render on this machine and write the image\n"
    "  submit SCENE     hand a scene to a master; with --wait also fetch the image\n"
    "  status [JOB]     what a master is doing\n"
    "  fetch JOB        the image of a job so far\n"
    "  pause JOB        hand out no more of a job until resume JOB\n"
    "  priority JOB N   jobs of a higher priority go first\n"
    "  cancel JOB       end a job; the image so far stays\n"
    "  extend JOB       go on with a job that is over, for more samples\n"
    "  retain JOB       keep a job until it is deleted; release JOB takes that back\n"
    "  delete JOB       remove a job that is over, with its image\n"
    "  keygen [NAME]    a key, to be let in by a master on another machine\n"
    "  import SCENE     a scene with all its files as one scene blob\n"
    "  info FILE        describe a scene, a scene blob or an EXR\n"
    "  compare A B      compare two images\n"
    "  help, --help, --version\n"
    "\n"
    "lightmill COMMAND --help tells more. The other programs are lightmill-master, lightmill-worker and\n"
    "lightmill-relay.\n"
    "\n"
    "Exit codes:\n"
    "  0 success                              5 a limit was exceeded, or memory ran out\n"
    "  1 the command line is wrong            6 the master does not answer\n"
    "  2 a file is missing or malformed       7 cancelled by a user or a signal\n"
    "  3 the operating system refused         8 the images differ (compare)\n"
    "  4 the master broke the protocol        9 a key is missing, not accepted, or lacks the right\n";

typedef struct {
    const char *name;
    result_t (*run)(int argc, char **argv);
} command_t;

static const command_t commands[] = {
    {"render", cmd_render}, {"submit", cmd_submit}, {"status", cmd_status},   {"fetch", cmd_fetch},
    {"cancel", cmd_order},  {"pause", cmd_order},   {"resume", cmd_order},    {"retain", cmd_order},
    {"release", cmd_order}, {"delete", cmd_order},  {"extend", cmd_extend},   {"priority", cmd_priority},
    {"import", cmd_import}, {"info", cmd_info},     {"compare", cmd_compare}, {"keygen", cmd_keygen},
};

static result_t run(int argc, char **argv)
{
    if (argc < 2) {
        fputs(usage, stderr);
        return result_fail(RESULT_USAGE, "no command given");
    }
    const char *name = argv[1];
    if (strcmp(name, "--help") == 0 || strcmp(name, "-h") == 0 || strcmp(name, "help") == 0) {
        fputs(usage, stdout);
        return result_ok();
    }
    if (strcmp(name, "--version") == 0) {
        puts("lightmill " LIGHTMILL_VERSION);
        return result_ok();
    }
    for (size_t i = 0; i < ARRAY_LENGTH(commands); i++)
        if (strcmp(name, commands[i].name) == 0) return commands[i].run(argc - 1, argv + 1);
    return result_fail(RESULT_USAGE, "'%.100s' is no command; see lightmill --help", name);
}

int main(int argc, char **argv)
{
    result_t result = run(argc, argv);
    if (result.code != RESULT_OK && result.message[0]) fprintf(stderr, "lightmill: %s\n", result.message);
    return result_exit_code(result);
}
