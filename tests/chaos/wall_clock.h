/* wall_clock: wall clocks that jump. A program that runs with BUILD/tests/chaos/shift_clock.so before its
 * libraries reads CLOCK_REALTIME with an offset that the driver writes into a file; the real clock is
 * nobody's to set. */
#ifndef LIGHTMILL_CHAOS_WALL_CLOCK_H
#define LIGHTMILL_CHAOS_WALL_CLOCK_H

#include "common/base.h"

/* The environment variable that names the file: 8 bytes, the offset in nanoseconds. */
#define WALL_CLOCK_VARIABLE "LIGHTMILL_CHAOS_CLOCK"

/* RESULT_MISMATCH, saying why, when clocks cannot be shifted here: the library would come before the run time
 * of a sanitizer. */
result_t wall_clock_available(void);
/* Makes the file, offset 0. */
result_t wall_clock_new(const char *path);
/* Moves the clocks that follow the file to `seconds` from the true time. */
void wall_clock_shift(const char *path, double seconds);
/* In a new process: its program will follow this file. */
void wall_clock_preload(const char *path);

#endif
