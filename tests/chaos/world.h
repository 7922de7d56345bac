/* world: what a process sees of its machine: a wall clock that jumps, a disk that is slow. A program that
 * runs with BUILD/tests/chaos/world.so before its libraries looks into a file for what the driver wants it to
 * see; the real clock and the real disk are nobody's to change. */
#ifndef LIGHTMILL_WORLD_H
#define LIGHTMILL_WORLD_H

#include "common/base.h"

typedef struct world world_t;

/* RESULT_MISMATCH, saying why, when it cannot be done here: the library would come before the run time of a
 * sanitizer. */
result_t world_available(void);
/* A world as it is, in a file that is made; NULL when that fails. */
world_t *world_new(const char *path);
void world_free(world_t **world);
/* The wall clock is so many seconds from the true time. */
void world_shift_clock(world_t *world, double seconds);
/* Each write and each flush takes so many seconds more. */
void world_slow_disk(world_t *world, double seconds);
/* In a new process: its program will live in this world. */
void world_preload(const world_t *world);

#endif
