/* world_preload: a library to be loaded before all others (LD_PRELOAD), which shows a program the wall clock
 * and the disk that world_page.h describes. CLOCK_MONOTONIC is left alone: it cannot jump. Built alone, never
 * linked to anything of ours. */
#include "tests/chaos/world_page.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const int64_t SECOND = 1000000000;
static const world_page_t as_it_is;
static const world_page_t *world = &as_it_is;

__attribute__((constructor)) static void open_world(void)
{
    const char *path = getenv(WORLD_VARIABLE);
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *map = mmap(NULL, sizeof *world, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (map != MAP_FAILED) world = map;
}

/* ---- the clock ---------------------------------------------------------------------------------------- */

int clock_gettime(clockid_t clock, struct timespec *time)
{
    int code = (int)syscall(SYS_clock_gettime, clock, time);
    if (code != 0 || (clock != CLOCK_REALTIME && clock != CLOCK_REALTIME_COARSE)) return code;
    int64_t now = (int64_t)time->tv_sec * SECOND + time->tv_nsec + atomic_load(&world->clock_offset);
    time->tv_sec = now / SECOND;
    time->tv_nsec = now % SECOND;
    return 0;
}

int gettimeofday(struct timeval *restrict time, void *restrict zone)
{
    struct timespec now;
    int code = clock_gettime(CLOCK_REALTIME, &now);
    if (zone) *(struct timezone *)zone = (struct timezone){0};
    *time = (struct timeval){now.tv_sec, now.tv_nsec / 1000};
    return code;
}

time_t time(time_t *result)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (result) *result = now.tv_sec;
    return now.tv_sec;
}

int timespec_get(struct timespec *now, int base)
{
    return base == TIME_UTC && clock_gettime(CLOCK_REALTIME, now) == 0 ? base : 0;
}

/* ---- the disk ----------------------------------------------------------------------------------------- */

static void wait_for_disk(void)
{
    int64_t delay = atomic_load(&world->disk_delay);
    if (delay == 0) return;
    struct timespec time = {.tv_sec = delay / SECOND, .tv_nsec = delay % SECOND};
    nanosleep(&time, NULL);
}

ssize_t pwrite(int file, const void *bytes, size_t size, off_t offset)
{
    wait_for_disk();
    return syscall(SYS_pwrite64, file, bytes, size, offset);
}

ssize_t pwrite64(int file, const void *bytes, size_t size, off64_t offset)
{
    return pwrite(file, bytes, size, offset);
}

int fsync(int file)
{
    wait_for_disk();
    return (int)syscall(SYS_fsync, file);
}

int fdatasync(int file)
{
    wait_for_disk();
    return (int)syscall(SYS_fdatasync, file);
}
