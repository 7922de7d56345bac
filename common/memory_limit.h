/* memory_limit: how much memory, how many files and how many cores this process may use. */
#ifndef LIGHTMILL_MEMORY_LIMIT_H
#define LIGHTMILL_MEMORY_LIMIT_H

#include <stdbool.h>
#include <stdint.h>

/* Bytes: the machine's memory, or less where a container, a batch system (control groups, version 1 or 2) or
 * a resource limit says so. */
uint64_t memory_limit(void);
/* True when this process could get so many bytes more now, as far as its limits and the kernel tell: memory
 * that nothing was written to yet costs nothing, and may still turn out to be missing. */
bool memory_is_there(uint64_t bytes);
/* Raises the limit of open files as far as it goes: every worker has two connections. */
void file_limit_raise(void);
/* Cores that it may run on, at least 1. */
int core_count(void);

#endif
