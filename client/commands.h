/* commands: what `lightmill` can do. Each takes its own arguments (argv[0] is the command's name) and returns
 * the result that decides the exit code; main.c prints the message of a failed one. */
#ifndef LIGHTMILL_COMMANDS_H
#define LIGHTMILL_COMMANDS_H

#include "common/base.h"

result_t cmd_render(int argc, char **argv);
result_t cmd_submit(int argc, char **argv);
result_t cmd_status(int argc, char **argv);
result_t cmd_fetch(int argc, char **argv);
/* cancel, pause, resume, retain, release, delete: one function, argv[0] tells them apart. */
result_t cmd_order(int argc, char **argv);
result_t cmd_priority(int argc, char **argv);
result_t cmd_extend(int argc, char **argv);
result_t cmd_import(int argc, char **argv);
result_t cmd_info(int argc, char **argv);
result_t cmd_keygen(int argc, char **argv);
result_t cmd_compare(int argc, char **argv);

#endif
