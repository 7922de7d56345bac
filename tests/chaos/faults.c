/* faults: see faults.h. */
#include "tests/chaos/faults.h"

#include "tests/chaos/disk.h"
#include "tests/chaos/errand.h"
#include "tests/chaos/watch_films.h"
#include "tests/chaos/words.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MAX_ACTIVE = 64, CHANCES = 3 };
static const double CHECKPOINT_WRITE = 0.01; /* seconds for each write of a checkpoint that is to be hit */

typedef struct fault fault_t;

/* A kind of fault. `begin` returns false when it cannot be now; `end` undoes it. */
typedef struct {
    const char *name;
    unsigned cards;     /* of the deck */
    double least, most; /* seconds that it lasts */
    bool (*begin)(faults_t *, fault_t *);
    void (*end)(faults_t *, fault_t *);
    bool (*possible)(const faults_t *); /* on this machine; NULL: always */
    proxy_mischief_t mischief;
} kind_t;

struct fault {
    const kind_t *kind; /* NULL: the place is free */
    size_t number;
    uint64_t pick;
    double chance[CHANCES]; /* from 0 to 1, for whatever it needs */
    double duration, ends;
    bool spoilt; /* it hit nobody: it is not counted */
    char victim[80];
    /* What it works on. */
    troupe_worker_t *worker;
    member_t *member; /* the worker, the relay or the master */
    size_t index;     /* of a link or a site */
    film_event_t event;
    unsigned done;
    errand_t client;
};

struct faults {
    faults_setup_t setup;
    dice_t dice;
    double next;
    size_t dealt;
    fault_t active[MAX_ACTIVE];
    unsigned deck[200];
    size_t deck_left;
    bool link_busy[PROXY_MAX_LINKS], site_busy[NETWORK_MAX_SITES], disk_busy;
    troupe_worker_t *late[TROUPE_MAX_WORKERS]; /* workers that join late */
    film_watch_t films;
    fault_t *waiting;  /* for a checkpoint */
    size_t counts[64]; /* of each kind */
    size_t done[PROXY_MISCHIEFS];
    size_t count, kills, torn;
};

static void victim(fault_t *fault, const char *format, ...) __attribute__((format(printf, 2, 3)));
static void victim(fault_t *fault, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(fault->victim, sizeof fault->victim, format, arguments);
    va_end(arguments);
}

static double between(double chance, double least, double most)
{
    return least + chance * (most - least);
}

/* As likely between 1 and 10 as between 10 and 100. */
static double between_scales(double chance, double least, double most)
{
    return least * pow(most / least, chance);
}

/* ---- workers and the relay
 * ------------------------------------------------------------------------------------------ */

static bool pick_worker(faults_t *faults, fault_t *fault)
{
    fault->worker = troupe_pick_worker(faults->setup.troupe, fault->pick);
    if (fault->worker == NULL) return false;
    fault->member = &fault->worker->member;
    victim(fault, "%s", fault->member->name);
    return true;
}

static bool pick_relay(faults_t *faults, fault_t *fault)
{
    fault->member = &faults->setup.troupe->relay;
    return fault->member->process != 0 && !fault->member->busy && !fault->member->leaving;
}

static bool has_relay(const faults_t *faults)
{
    return faults->setup.troupe->relay_address != NULL;
}

static bool kill_member(faults_t *faults, fault_t *fault)
{
    return troupe_kill(faults->setup.troupe, fault->member, between(fault->chance[0], 0, 2));
}

static bool dismiss_member(faults_t *faults, fault_t *fault)
{
    return troupe_dismiss(faults->setup.troupe, fault->member, between(fault->chance[0], 0, 2));
}

static bool stop_member(fault_t *fault)
{
    fault->member->busy = true;
    return troupe_stop(fault->member);
}

static void continue_member(faults_t *faults, fault_t *fault)
{
    (void)faults;
    fault->member->busy = false;
    troupe_continue(fault->member);
}

static bool kill_worker(faults_t *faults, fault_t *fault)
{
    return pick_worker(faults, fault) && kill_member(faults, fault);
}

static bool dismiss_worker(faults_t *faults, fault_t *fault)
{
    return pick_worker(faults, fault) && dismiss_member(faults, fault);
}

static bool stop_worker(faults_t *faults, fault_t *fault)
{
    return pick_worker(faults, fault) && stop_member(fault);
}

static bool kill_relay(faults_t *faults, fault_t *fault)
{
    return pick_relay(faults, fault) && kill_member(faults, fault);
}

static bool dismiss_relay(faults_t *faults, fault_t *fault)
{
    return pick_relay(faults, fault) && dismiss_member(faults, fault);
}

static bool stop_relay(faults_t *faults, fault_t *fault)
{
    return pick_relay(faults, fault) && stop_member(fault);
}

static bool freeze_worker(faults_t *faults, fault_t *fault)
{
    return pick_worker(faults, fault) &&
           troupe_freeze(faults->setup.troupe, fault->worker, between(fault->chance[0], 0, 2));
}

static bool start_late_worker(faults_t *faults, fault_t *fault)
{
    for (size_t i = 0; i < TROUPE_MAX_WORKERS && fault->worker == NULL; i++)
        if (faults->late[i] && faults->late[i]->member.process == 0) fault->worker = faults->late[i];
    if (fault->worker == NULL) return false;
    victim(fault, "%s", fault->worker->member.name);
    troupe_start_worker(faults->setup.troupe, fault->worker);
    return true;
}

static void dismiss_late_worker(faults_t *faults, fault_t *fault)
{
    troupe_continue(&fault->worker->member);
    troupe_dismiss(faults->setup.troupe, &fault->worker->member, INFINITY);
}

/* ---- the master --------------------------------------------------------------------------------------- */

static bool end_master(faults_t *faults, double away)
{
    troupe_t *troupe = faults->setup.troupe;
    if (!troupe_kill(troupe, &troupe->master, away)) return false;
    faults->kills++;
    return true;
}

static bool kill_master(faults_t *faults, fault_t *fault)
{
    return end_master(faults, between(fault->chance[0], 0, 1));
}

/* Killed when it has just come up, and once more at the end of the fault: in the midst of coming up. */
static bool kill_master_twice(faults_t *faults, fault_t *fault)
{
    (void)fault;
    return end_master(faults, 0);
}

static void kill_master_again(faults_t *faults, fault_t *fault)
{
    fault->spoilt = !end_master(faults, between(fault->chance[0], 0, 1));
}

static void slow_master_disk(faults_t *faults, double seconds)
{
    world_t *world = faults->setup.troupe->master.world;
    if (world) world_slow_disk(world, seconds);
}

/* From now on the next such event is the master's end: on_film sees to it. */
static bool wait_for_film(faults_t *faults, fault_t *fault, film_event_t event)
{
    if (faults->waiting) return false;
    faults->waiting = fault;
    fault->event = event;
    fault->spoilt = true;
    return true;
}

/* The disk is slow meanwhile, so that a checkpoint takes long enough to be hit. */
static bool wait_for_beginning(faults_t *faults, fault_t *fault)
{
    if (!wait_for_film(faults, fault, FILM_BEGINS)) return false;
    slow_master_disk(faults, CHECKPOINT_WRITE);
    return true;
}

static bool wait_for_end(faults_t *faults, fault_t *fault)
{
    return wait_for_film(faults, fault, FILM_IS_THERE);
}

static void wait_no_more(faults_t *faults, fault_t *fault)
{
    if (faults->waiting != fault) return;
    faults->waiting = NULL;
    slow_master_disk(faults, 0);
}

static bool slow_disk(faults_t *faults, fault_t *fault)
{
    double seconds = between_scales(fault->chance[0], 1e-3, 0.1);
    victim(fault, "%.0f ms a write", 1e3 * seconds);
    slow_master_disk(faults, seconds);
    return true;
}

static void hurry_disk(faults_t *faults, fault_t *fault)
{
    (void)fault;
    slow_master_disk(faults, 0);
}

static bool dismiss_master(faults_t *faults, fault_t *fault)
{
    troupe_t *troupe = faults->setup.troupe;
    return !troupe->master.busy && troupe_dismiss(troupe, &troupe->master, between(fault->chance[0], 0, 1));
}

static bool stop_master(faults_t *faults, fault_t *fault)
{
    fault->member = &faults->setup.troupe->master;
    return !fault->member->busy && !fault->member->leaving && stop_member(fault);
}

/* ---- clocks, the disk, clients ------------------------------------------------------------------------ */

static bool jump_clock(faults_t *faults, fault_t *fault)
{
    static const double YEAR = 365.25 * 86400;
    member_t *member = &faults->setup.troupe->master;
    if (fault->chance[0] < 0.5) {
        if (!pick_worker(faults, fault)) return false;
        member = &fault->worker->member;
    }
    double seconds = between_scales(fault->chance[1], 1, YEAR);
    if (fault->chance[2] < 0.5) seconds = -seconds;
    victim(fault, "%s by %+.0f s", member->name, seconds);
    if (member->world == NULL) return false;
    world_shift_clock(member->world, seconds);
    return true;
}

static bool has_worlds(const faults_t *faults)
{
    return faults->setup.troupe->worlds;
}

static bool fill_disk(faults_t *faults, fault_t *fault)
{
    (void)fault;
    if (faults->disk_busy) return false;
    faults->disk_busy = faults->setup.troupe->disk_full = true;
    return disk_fill(faults->setup.troupe->data).code == RESULT_OK;
}

static void free_disk(faults_t *faults, fault_t *fault)
{
    (void)fault;
    disk_free(faults->setup.troupe->data);
    faults->disk_busy = faults->setup.troupe->disk_full = false;
}

static bool can_fill(const faults_t *faults)
{
    return faults->setup.disk;
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
    atomic_store(&link->bytes_per_second, (unsigned)between_scales(fault->chance[0], 1e5, 2e6));
    char *scene = write_new_scene(faults, fault), *log = mem_printf("%s.log", scene);
    char *master = mem_printf("%s:%d", faults->setup.client_host, faults->setup.troupe->port);
    words_t words = {0};
    WORDS_ADD(&words, "submit", scene, "--name", "upload", "--spp", "1", "--master", master);
    words_add_all(&words, faults->setup.troupe->passes->client);
    errand_start(&fault->client, log, words.list, false);
    free(master);
    free(log);
    free(scene);
    return true;
}

static void kill_client(faults_t *faults, fault_t *fault)
{
    (void)faults;
    fault->spoilt = errand_poll(&fault->client, 0, INFINITY) != ERRAND_RUNS;
    errand_end(&fault->client);
}

/* ---- networks ----------------------------------------------------------------------------------------- */

static bool pick_free(const bool *busy, size_t count, fault_t *fault)
{
    for (size_t i = 0; i < count; i++) {
        fault->index = (fault->pick + i) % count;
        if (!busy[fault->index]) return true;
    }
    return false;
}

static bool pick_site(faults_t *faults, fault_t *fault)
{
    if (!pick_free(faults->site_busy, faults->setup.sites, fault)) return false;
    faults->site_busy[fault->index] = true;
    return true;
}

static void note_network(faults_t *faults, result_t result)
{
    if (result.code != RESULT_OK) report_violation(faults->setup.report, "the network: %s", result.message);
}

static bool cut_site(faults_t *faults, fault_t *fault)
{
    static const char *const ways[] = {"to", "from", "to and from"};
    if (!pick_site(faults, fault)) return false;
    int way = fault->chance[0] < 0.5    ? NETWORK_BOTH
              : fault->chance[0] < 0.75 ? NETWORK_INWARD
                                        : NETWORK_OUTWARD;
    victim(fault, "%s site %zu", ways[way - 1], fault->index);
    note_network(faults, network_cut(faults->setup.network, fault->index, (network_way_t)way));
    return true;
}

static bool thin_site(faults_t *faults, fault_t *fault)
{
    if (!pick_site(faults, fault)) return false;
    unsigned rate = (unsigned)between_scales(fault->chance[0], 10e3, 300e3);
    victim(fault, "site %zu, %u bytes/s", fault->index, rate);
    note_network(faults, network_thin(faults->setup.network, fault->index, rate));
    return true;
}

static void heal_site(faults_t *faults, fault_t *fault)
{
    faults->site_busy[fault->index] = false;
    note_network(faults, network_heal(faults->setup.network, fault->index));
}

static bool has_sites(const faults_t *faults)
{
    return faults->setup.network != NULL;
}

/* ---- the proxy ---------------------------------------------------------------------------------------- */

static proxy_link_t *link_of(faults_t *faults, const fault_t *fault)
{
    return proxy_link(faults->setup.proxy, fault->index);
}

static bool pick_link(faults_t *faults, fault_t *fault)
{
    if (!pick_free(faults->link_busy, faults->setup.links, fault)) return false;
    faults->link_busy[fault->index] = true;
    victim(fault, "link %zu", fault->index);
    return true;
}

static void heal_link(faults_t *faults, fault_t *fault)
{
    faults->link_busy[fault->index] = false;
    proxy_heal(link_of(faults, fault));
}

static bool delay_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    unsigned delay = (unsigned)between_scales(fault->chance[0], 10, 700);
    unsigned jitter = (unsigned)between_scales(fault->chance[1], 10, 300);
    victim(fault, "link %zu, %u to %u ms", fault->index, delay, delay + jitter);
    atomic_store(&link_of(faults, fault)->delay_ms, delay);
    atomic_store(&link_of(faults, fault)->jitter_ms, jitter);
    return true;
}

static bool thin_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    unsigned rate = (unsigned)between_scales(fault->chance[0], 10e3, 300e3);
    victim(fault, "link %zu, %u bytes/s", fault->index, rate);
    atomic_store(&link_of(faults, fault)->bytes_per_second, rate);
    return true;
}

static bool stall_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    atomic_store(&link_of(faults, fault)->stalled, true);
    return true;
}

static bool reset_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    atomic_fetch_add(&link_of(faults, fault)->cuts, 1);
    return true;
}

static bool refuse_link(faults_t *faults, fault_t *fault)
{
    if (!reset_link(faults, fault)) return false;
    atomic_store(&link_of(faults, fault)->refusing, true);
    return true;
}

static bool mistreat_link(faults_t *faults, fault_t *fault)
{
    if (!pick_link(faults, fault)) return false;
    proxy_link_t *link = link_of(faults, fault);
    unsigned times = 1 + (unsigned)(5.99 * fault->chance[0]);
    fault->done = atomic_load(&link->done[fault->kind->mischief]);
    victim(fault, "link %zu, up to %u times", fault->index, times);
    atomic_store(&link->todo[fault->kind->mischief], times);
    return true;
}

static void end_mischief(faults_t *faults, fault_t *fault)
{
    unsigned done = atomic_load(&link_of(faults, fault)->done[fault->kind->mischief]) - fault->done;
    fault->spoilt = done == 0;
    faults->done[fault->kind->mischief] += done;
    heal_link(faults, fault);
}

/* ---- the kinds ---------------------------------------------------------------------------------------- */

#define MISCHIEF(name, what)                                                                                 \
    {                                                                                                        \
        name, 1, 2, 4, mistreat_link, end_mischief, NULL, what                                               \
    }

/* Times of stops, cuts and stalls are shorter or longer than the lease of a worker, 1.5 s. */
static const kind_t KINDS[] = {
    {"kill worker", 5, 0, 0, kill_worker, NULL, NULL, 0},
    {"kill master", 5, 0, 0, kill_master, NULL, NULL, 0},
    {"kill master in a checkpoint", 4, 5, 5, wait_for_beginning, wait_no_more, NULL, 0},
    {"kill master after a checkpoint", 2, 5, 5, wait_for_end, wait_no_more, NULL, 0},
    {"kill master twice", 2, 0.02, 0.6, kill_master_twice, kill_master_again, NULL, 0},
    {"end master", 1, 0, 0, dismiss_master, NULL, NULL, 0},
    {"stop master, short", 2, 0.1, 1.2, stop_master, continue_member, NULL, 0},
    {"stop master, long", 1, 2, 4, stop_master, continue_member, NULL, 0},
    {"stop worker, short", 2, 0.1, 1.2, stop_worker, continue_member, NULL, 0},
    {"stop worker, long", 3, 2, 6, stop_worker, continue_member, NULL, 0},
    {"stop worker for ever", 1, 0, 0, freeze_worker, NULL, NULL, 0},
    {"end worker", 2, 0, 0, dismiss_worker, NULL, NULL, 0},
    {"kill relay", 2, 0, 0, kill_relay, NULL, has_relay, 0},
    {"stop relay, short", 1, 0.1, 1.2, stop_relay, continue_member, has_relay, 0},
    {"stop relay, long", 1, 2, 6, stop_relay, continue_member, has_relay, 0},
    {"end relay", 1, 0, 0, dismiss_relay, NULL, has_relay, 0},
    {"late worker", 1, 2, 15, start_late_worker, dismiss_late_worker, NULL, 0},
    {"jump clock", 3, 0, 0, jump_clock, NULL, has_worlds, 0},
    {"fill disk", 2, 1, 5, fill_disk, free_disk, can_fill, 0},
    {"slow disk", 1, 1, 5, slow_disk, hurry_disk, has_worlds, 0},
    {"kill client in upload", 2, 0.05, 1.5, start_client, kill_client, NULL, 0},
    {"partition, short", 2, 0.2, 1.2, cut_site, heal_site, has_sites, 0},
    {"partition, long", 2, 2, 6, cut_site, heal_site, has_sites, 0},
    {"thin cable", 2, 2, 6, thin_site, heal_site, has_sites, 0},
    {"delay", 1, 2, 6, delay_link, heal_link, NULL, 0},
    {"thin link", 1, 2, 6, thin_link, heal_link, NULL, 0},
    {"stall, short", 1, 0.2, 1.2, stall_link, heal_link, NULL, 0},
    {"stall, long", 1, 2, 6, stall_link, heal_link, NULL, 0},
    {"reset connections", 3, 0.1, 0.1, reset_link, heal_link, NULL, 0},
    {"refuse connections", 1, 1, 3, refuse_link, heal_link, NULL, 0},
    MISCHIEF("corrupt bytes", PROXY_FLIP_BYTES),
    MISCHIEF("repeat bytes", PROXY_REPEAT_BYTES),
    MISCHIEF("reorder bytes", PROXY_SWAP_BYTES),
    MISCHIEF("lose bytes", PROXY_LOSE_BYTES),
    MISCHIEF("corrupt message", PROXY_FLIP_MESSAGE),
    MISCHIEF("repeat message", PROXY_REPEAT_MESSAGE),
    MISCHIEF("reorder messages", PROXY_SWAP_MESSAGES),
    MISCHIEF("lose message", PROXY_LOSE_MESSAGE),
};

static bool is_wanted(const faults_t *faults, const kind_t *kind)
{
    if (kind->possible && !kind->possible(faults)) return false;
    if (faults->setup.only == NULL) return true;
    char *list = mem_strdup(faults->setup.only), *rest = list;
    bool found = false;
    for (char *part; (part = strsep(&rest, ",")) != NULL;) found = found || strstr(kind->name, part);
    free(list);
    return found;
}

static void shuffle_deck(faults_t *faults)
{
    faults->deck_left = 0;
    for (unsigned kind = 0; kind < ARRAY_LENGTH(KINDS); kind++)
        for (unsigned i = 0; i < KINDS[kind].cards && is_wanted(faults, &KINDS[kind]); i++)
            faults->deck[faults->deck_left++] = kind;
    if (faults->deck_left == 0) {
        fputs("chaos: no fault of such a kind is possible here\n", stderr);
        exit(RESULT_USAGE);
    }
    for (size_t i = faults->deck_left; i > 1; i--) {
        size_t other = dice_below(&faults->dice, i);
        unsigned card = faults->deck[i - 1];
        faults->deck[i - 1] = faults->deck[other];
        faults->deck[other] = card;
    }
}

/* The next fault of the list. What it draws from the dice never depends on what goes on. */
static fault_t deal(faults_t *faults)
{
    if (faults->deck_left == 0) shuffle_deck(faults);
    const kind_t *kind = &KINDS[faults->deck[--faults->deck_left]];
    fault_t fault = {.kind = kind, .number = ++faults->dealt, .pick = dice_next(&faults->dice) >> 8};
    fault.duration = dice_between(&faults->dice, kind->least, kind->most);
    for (int i = 0; i < CHANCES; i++) fault.chance[i] = dice_between(&faults->dice, 0, 1);
    return fault;
}

/* ---- the course of things ----------------------------------------------------------------------------- */

faults_t *faults_new(const faults_setup_t *setup)
{
    faults_t *faults = mem_zalloc(1, sizeof *faults);
    faults->setup = *setup;
    faults->dice = dice_new(setup->seed, 1);
    faults->next = clock_now() + setup->pause;
    size_t late = 0;
    for (size_t i = 0; i < setup->troupe->worker_count; i++) {
        troupe_worker_t *worker = &setup->troupe->workers[i];
        if (worker->member.process != 0) continue;
        worker->member.retired = true;
        faults->late[late++] = worker;
    }
    film_watch_open(&faults->films, setup->troupe->data);
    return faults;
}

void faults_free(faults_t **faults)
{
    if (*faults == NULL) return;
    film_watch_close(&(*faults)->films);
    free(*faults);
    *faults = NULL;
}

static void finish(faults_t *faults, fault_t *fault)
{
    if (fault->kind->end) fault->kind->end(faults, fault);
    if (fault->spoilt) {
        report_line(faults->setup.report, "#%zu %s: it hit nobody", fault->number, fault->kind->name);
    } else {
        faults->counts[fault->kind - KINDS]++;
        faults->count++;
    }
    fault->kind = NULL;
}

static void begin(faults_t *faults, fault_t *place)
{
    fault_t *fault = place;
    *fault = deal(faults);
    double now = clock_now();
    bool begun = fault->kind->begin(faults, fault);
    fault->ends = now + fault->duration;
    char lasting[40] = "";
    if (fault->duration > 0) snprintf(lasting, sizeof lasting, " for %.2f s", fault->duration);
    report_line(faults->setup.report, "#%zu %s%s%s%s%s", fault->number, fault->kind->name,
                fault->victim[0] ? ": " : "", fault->victim, lasting, begun ? "" : " (cannot be now)");
    if (!begun)
        fault->kind = NULL;
    else if (fault->duration == 0)
        finish(faults, fault);
    faults->next = now + (begun ? 1 : 0.2) * dice_between(&faults->dice, 0.3 * faults->setup.pause,
                                                          1.7 * faults->setup.pause);
}

/* A checkpoint begins or is there: the master is killed if a fault waits for it. */
static void on_film(faults_t *faults, film_event_t event)
{
    fault_t *fault = faults->waiting;
    if (fault == NULL) return;
    if (event != fault->event) return;
    /* At least two writes and a flush: it is still at it, wherever. */
    usleep((useconds_t)(3e6 * CHECKPOINT_WRITE * fault->chance[1]));
    if (!end_master(faults, between(fault->chance[0], 0, 1))) return;
    bool torn = film_watch_torn(&faults->films);
    faults->torn += torn;
    report_line(faults->setup.report, "#%zu killed the master%s", fault->number,
                torn ? " with a checkpoint half written" : "");
    fault->spoilt = false;
    fault->ends = 0;
}

void faults_tick(faults_t *faults, bool more, double seconds)
{
    on_film(faults, film_watch_wait(&faults->films, seconds));
    double now = clock_now();
    fault_t *place = NULL;
    for (size_t i = 0; i < MAX_ACTIVE; i++) {
        fault_t *fault = &faults->active[i];
        if (fault->kind && now >= fault->ends) finish(faults, fault);
        if (fault->kind == NULL) place = fault;
    }
    if (faults->disk_busy) disk_fill(faults->setup.troupe->data);
    if (more && place && now >= faults->next) begin(faults, place);
}

void faults_heal(faults_t *faults)
{
    for (size_t i = 0; i < MAX_ACTIVE; i++)
        if (faults->active[i].kind) finish(faults, &faults->active[i]);
}

size_t faults_count(const faults_t *faults)
{
    return faults->count;
}

size_t faults_master_kills(const faults_t *faults)
{
    return faults->kills;
}

void faults_print(const faults_t *faults)
{
    report_t *report = faults->setup.report;
    report_text(report, "%6s  %s", "faults", "kind");
    for (size_t i = 0; i < ARRAY_LENGTH(KINDS); i++) {
        const kind_t *kind = &KINDS[i];
        if (faults->counts[i] == 0) continue;
        if (kind->begin == mistreat_link)
            report_text(report, "%6zu  %s (%zu times)", faults->counts[i], kind->name,
                        faults->done[kind->mischief]);
        else
            report_text(report, "%6zu  %s", faults->counts[i], kind->name);
    }
    report_text(report,
                "%6zu  in all; the master was killed %zu times, %zu times with a checkpoint half written",
                faults->count, faults->kills, faults->torn);
}
