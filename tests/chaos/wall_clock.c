/* wall_clock: see wall_clock.h. */
#include "tests/chaos/wall_clock.h"

#include "tests/chaos/process.h"

#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

result_t wall_clock_available(void)
{
#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__
    return result_fail(RESULT_MISMATCH, "a sanitizer does not let a library in before itself");
#else
    char *library = process_program("tests/chaos/shift_clock.so");
    bool there = access(library, R_OK) == 0;
    free(library);
    return there ? result_ok() : result_fail(RESULT_MISMATCH, "shift_clock.so is not built");
#endif
}

static void write_offset(int file, int64_t nanoseconds)
{
    if (pwrite(file, &nanoseconds, sizeof nanoseconds, 0) != sizeof nanoseconds) abort();
}

result_t wall_clock_new(const char *path)
{
    int file = open(path, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (file < 0) return result_fail(RESULT_IO, "%s cannot be made", path);
    write_offset(file, 0);
    close(file);
    return result_ok();
}

void wall_clock_shift(const char *path, double seconds)
{
    int file = open(path, O_RDWR | O_CLOEXEC);
    if (file < 0) return;
    write_offset(file, (int64_t)(1e9 * seconds));
    close(file);
}

void wall_clock_preload(const char *path)
{
    char *library = process_program("tests/chaos/shift_clock.so");
    setenv("LD_PRELOAD", library, 1);
    setenv(WALL_CLOCK_VARIABLE, path, 1);
    free(library);
}
