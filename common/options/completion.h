/* completion: what a shell offers when the Tab key is pressed in one of our command lines.
 *
 * The shell's script (client/commands/completion.c) asks the program itself: PROGRAM --complete WORD...
 * prints what the last of these words can become, a line each. So the script never ages, and nothing printed
 * means that the shell offers files. */
#ifndef LIGHTMILL_COMPLETION_H
#define LIGHTMILL_COMPLETION_H

#include "common/options/options.h"

/* Prints what the last of `count` words after the command's name can become. */
void completion_print(const command_t *command, int count, char **words);

#endif
