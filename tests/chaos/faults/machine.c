/* machine: faults of what is around the processes: clocks jump, disks are full or slow, clients are killed.
 */
#include "tests/chaos/disk.h"
#include "tests/chaos/faults/faults_state.h"
#include "tests/chaos/words.h"

#include <math.h>
#include <stdlib.h>

static bool jump_clock(faults_t *faults, fault_t *fault)
{
    static const double YEAR = 365.25 * 86400;
    member_t *member = &faults->setup.processes->master;
    if (fault->chance[0] < 0.5) {
        if (!fault_pick_worker(faults, fault)) return false;
        member = &fault->worker->member;
    }
    double seconds = fault_scales(fault->chance[1], 1, YEAR);
    if (fault->chance[2] < 0.5) seconds = -seconds;
    fault_victim(fault, "%s by %+.0f s", member->name, seconds);
    if (member->world == NULL) return false;
    world_shift_clock(member->world, seconds);
    return true;
}

static bool has_worlds(const faults_t *faults)
{
    return faults->setup.processes->worlds;
}

static void free_disk(faults_t *faults, fault_t *fault)
{
    (void)fault;
    disk_free(faults->setup.processes->data);
    faults->disk_busy = faults->setup.processes->disk_full = false;
}

static bool fill_disk(faults_t *faults, fault_t *fault)
{
    if (faults->disk_busy) return false;
    faults->disk_busy = faults->setup.processes->disk_full = true;
    if (disk_fill(faults->setup.processes->data).code == RESULT_OK) return true;
    free_disk(faults, fault);
    return false;
}

static bool can_fill(const faults_t *faults)
{
    return faults->setup.disk;
}

static bool slow_disk(faults_t *faults, fault_t *fault)
{
    double seconds = fault_scales(fault->chance[0], 1e-3, 0.1);
    fault_victim(fault, "%.0f ms a write", 1e3 * seconds);
    fault_slow_master_disk(faults, seconds);
    return true;
}

static void hurry_disk(faults_t *faults, fault_t *fault)
{
    (void)fault;
    fault_slow_master_disk(faults, 0);
}

/* A scene that no other client has sent, of some hundred kilobytes. */
static char *write_new_scene(faults_t *faults, const fault_t *fault)
{
    enum { TRIANGLES = 8000 };
    char *path = mem_printf("%s/upload-%zu.pbrt", faults->setup.folder, fault->number);
    FILE *file = fopen(path, "we");
    if (file == NULL) return path;
    fprintf(file, "LookAt 0 0 -5 0 0 0 0 1 0\nCamera \"perspective\" \"float fov\" 40\nFilm \"image\" "
                  "\"integer xresolution\" 16 \"integer yresolution\" 16\nWorldBegin\nLightSource \"point\" "
                  "\"rgb I\" [9 9 9] \"point from\" [0 0 -5]\nShape \"trianglemesh\" \"point P\" [");
    dice_t dice = dice_new(fault->pick, fault->number);
    for (int i = 0; i < 9 * TRIANGLES; i++) fprintf(file, "%.4f\n", dice_between(&dice, -1, 1));
    fprintf(file, "] \"integer indices\" [");
    for (int i = 0; i < 3 * TRIANGLES; i++) fprintf(file, "%d\n", i);
    fprintf(file, "]\nWorldEnd\n");
    fclose(file);
    return path;
}

/* A client uploads a scene over a thin line, and is killed at the end of the fault, most often before it is
 * through. */
static bool start_client(faults_t *faults, fault_t *fault)
{
    proxy_link_t *link = proxy_link(faults->setup.proxy, faults->setup.links);
    atomic_store(&link->bytes_per_second, (unsigned)fault_scales(fault->chance[0], 1e5, 2e6));
    char *scene = write_new_scene(faults, fault), *log = mem_printf("%s.log", scene);
    char *master = mem_printf("%s:%d", faults->setup.client_host, faults->setup.processes->port);
    words_t words = {0};
    WORDS_ADD(&words, "submit", scene, "--name", "upload", "--spp", "1", "--master", master);
    words_add_all(&words, faults->setup.processes->passes->client);
    command_start(&fault->client, log, words.list, false);
    free(master);
    free(log);
    free(scene);
    return true;
}

static void kill_client(faults_t *faults, fault_t *fault)
{
    (void)faults;
    fault->spoilt = command_poll(&fault->client, 0, INFINITY) != COMMAND_RUNS;
    command_end(&fault->client);
}

static const fault_kind_t KINDS[] = {
    {"jump clock", 3, 0, 0, jump_clock, NULL, has_worlds, 0},
    {"fill disk", 2, 1, 5, fill_disk, free_disk, can_fill, 0},
    {"slow disk", 1, 1, 5, slow_disk, hurry_disk, has_worlds, 0},
    {"kill client in upload", 2, 0.05, 1.5, start_client, kill_client, NULL, 0},
};

const fault_family_t MACHINE_FAULTS = {KINDS, ARRAY_LENGTH(KINDS)};
