/* redirect: a file that leads a browser to an address that holds a secret.
 *
 * Every user of the machine can read the command lines of all programs, so a browser is never started with
 * the address itself. It gets the path of a small page instead, which only its owner can read. */
#ifndef LIGHTMILL_REDIRECT_H
#define LIGHTMILL_REDIRECT_H

#include "common/base.h"

/* Writes DIRECTORY/open-PID.html (mode 0600), which leads to `address`, and removes those that are older than
 * a minute: their browsers have read them. `path` becomes the absolute path, in fresh memory. RESULT_IO when
 * the directory cannot be written to, RESULT_INPUT for an address with characters that HTML gives a meaning
 * to. */
result_t redirect_write(const char *directory, const char *address, char **path);

#endif
