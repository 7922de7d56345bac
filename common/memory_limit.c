/* memory_limit: see memory_limit.h. */
#include "common/memory_limit.h"

#include "common/base.h"

#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#define UNKNOWN_MEMORY ((uint64_t)4 << 30)

static uint64_t least(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* The number in a file; UINT64_MAX when there is none ("max" among others). */
static uint64_t read_limit(const char *path)
{
    char text[64] = "";
    FILE *file = fopen(path, "re");
    if (file == NULL) return UINT64_MAX;
    char *line = fgets(text, sizeof text, file), *end = NULL;
    fclose(file);
    unsigned long long value = line != NULL ? strtoull(line, &end, 10) : 0;
    return end != NULL && end != line && value > 0 ? value : UINT64_MAX;
}

/* The least limit of a group and those that it is in; `group` is a path from the hierarchy's root, and the
 * limits are in `file`. */
static uint64_t group_limit(const char *root, char *group, const char *file)
{
    uint64_t limit = UINT64_MAX;
    for (;;) {
        char *path = mem_printf("%s%s/%s", root, group, file);
        limit = least(limit, read_limit(path));
        free(path);
        char *slash = strrchr(group, '/');
        if (slash == NULL) return limit;
        *slash = '\0';
    }
}

/* What a line of /proc/self/cgroup says, "0::/group" of version 2 or "4:memory:/group" of version 1. */
static uint64_t line_limit(char *line)
{
    static const char v1[] = ":memory:";
    char *memory = strstr(line, v1);
    line[strcspn(line, "\n")] = '\0';
    if (strncmp(line, "0::/", 4) == 0) return group_limit("/sys/fs/cgroup", line + 3, "memory.max");
    if (memory == NULL) return UINT64_MAX;
    return group_limit("/sys/fs/cgroup/memory", memory + strlen(v1), "memory.limit_in_bytes");
}

static uint64_t control_group_limit(void)
{
    uint64_t limit = read_limit("/sys/fs/cgroup/memory/memory.limit_in_bytes");
    char line[4096];
    FILE *file = fopen("/proc/self/cgroup", "re");
    while (file != NULL && fgets(line, sizeof line, file) != NULL) limit = least(limit, line_limit(line));
    if (file != NULL) fclose(file);
    return limit;
}

void file_limit_raise(void)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    if (setrlimit(RLIMIT_NOFILE, &limit) != 0) log_warning("cannot raise the limit of open files");
}

int core_count(void)
{
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) == 0) return int_max(1, CPU_COUNT(&set));
    return int_max(1, (int)sysconf(_SC_NPROCESSORS_ONLN));
}

uint64_t memory_limit(void)
{
    long pages = sysconf(_SC_PHYS_PAGES), size = sysconf(_SC_PAGESIZE);
    uint64_t limit = pages > 0 && size > 0 ? (uint64_t)pages * (uint64_t)size : UNKNOWN_MEMORY;
    struct rlimit space;
    if (getrlimit(RLIMIT_AS, &space) == 0 && space.rlim_cur != RLIM_INFINITY)
        limit = least(limit, space.rlim_cur);
    return least(limit, control_group_limit());
}

bool memory_is_there(uint64_t bytes)
{
    if (bytes == 0) return true;
    if (bytes > SIZE_MAX) return false;
    void *trial = mmap(NULL, (size_t)bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (trial == MAP_FAILED) return false;
    munmap(trial, (size_t)bytes);
    return true;
}
