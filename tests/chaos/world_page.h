/* world_page: what the driver and world_preload.c share, in a file that both map. */
#ifndef LIGHTMILL_WORLD_PAGE_H
#define LIGHTMILL_WORLD_PAGE_H

#include <stdatomic.h>
#include <stdint.h>

/* The environment variable that names the file. */
#define WORLD_VARIABLE "LIGHTMILL_CHAOS_WORLD"

typedef struct {
    _Atomic int64_t clock_offset; /* nanoseconds, of the wall clock */
    _Atomic int64_t disk_delay;   /* nanoseconds that each write and each flush takes more */
} world_page_t;

#endif
