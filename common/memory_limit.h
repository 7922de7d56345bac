/* memory_limit: how much memory, and how many files, this process may use. */
#ifndef LIGHTMILL_MEMORY_LIMIT_H
#define LIGHTMILL_MEMORY_LIMIT_H

#include <stdint.h>

/* Bytes: the machine's memory, or less where a container, a batch system (control groups, version 1 or 2) or
 * a resource limit says so. */
uint64_t memory_limit(void);
/* Raises the limit of open files as far as it goes: every worker has two connections. */
void file_limit_raise(void);

#endif
