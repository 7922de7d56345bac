/* help: what a command says of itself, made from its table: --help, and the manual page of --man. */
#ifndef LIGHTMILL_HELP_H
#define LIGHTMILL_HELP_H

#include "common/options/options.h"

/* Prints the help to stdout. */
void help_print(const command_t *command);
/* Prints the manual page to stdout, in the man macros of roff. */
void help_print_man(const command_t *command);

#endif
