/* world: see world.h. */
#include "tests/chaos/world.h"

#include "tests/chaos/process.h"
#include "tests/chaos/world_page.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

struct world {
    char *path;
    world_page_t *page;
};

result_t world_available(void)
{
#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__
    return result_fail(RESULT_MISMATCH, "a sanitizer does not let a library in before itself");
#else
    char *library = process_program("tests/chaos/world.so");
    bool there = access(library, R_OK) == 0;
    free(library);
    return there ? result_ok() : result_fail(RESULT_MISMATCH, "world.so is not built");
#endif
}

world_t *world_new(const char *path)
{
    int file = open(path, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    void *page = MAP_FAILED;
    if (file >= 0 && ftruncate(file, sizeof(world_page_t)) == 0)
        page = mmap(NULL, sizeof(world_page_t), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (file >= 0) close(file);
    if (page == MAP_FAILED) return NULL;
    world_t *world = mem_zalloc(1, sizeof *world);
    *world = (world_t){mem_strdup(path), page};
    return world;
}

void world_free(world_t **world)
{
    if (*world == NULL) return;
    munmap((*world)->page, sizeof *(*world)->page);
    free((*world)->path);
    free(*world);
    *world = NULL;
}

void world_shift_clock(world_t *world, double seconds)
{
    atomic_store(&world->page->clock_offset, (int64_t)(1e9 * seconds));
}

void world_slow_disk(world_t *world, double seconds)
{
    atomic_store(&world->page->disk_delay, (int64_t)(1e9 * seconds));
}

void world_preload(const world_t *world)
{
    char *library = process_program("tests/chaos/world.so");
    setenv("LD_PRELOAD", library, 1);
    setenv(WORLD_VARIABLE, world->path, 1);
    free(library);
}
