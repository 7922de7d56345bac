/* death_and_sleep: faults of the master, the relay and the workers: they die, are told to end, stop and come
 * late.
 */
#include "tests/chaos/faults/faults_state.h"

#include <math.h>
#include <unistd.h>

static const double CHECKPOINT_WRITE = 0.01; /* seconds for each write of a checkpoint that is to be hit */

/* ---- workers and the relay ----------------------------------------------------------------------------- */

bool fault_pick_worker(faults_t *faults, fault_t *fault)
{
    fault->worker = processes_pick_worker(faults->setup.processes, fault->pick);
    if (fault->worker == NULL) return false;
    fault->member = &fault->worker->member;
    fault_victim(fault, "%s", fault->member->name);
    return true;
}

static bool pick_relay(faults_t *faults, fault_t *fault)
{
    fault->member = &faults->setup.processes->relay;
    return fault->member->process != 0 && !fault->member->busy && !fault->member->leaving;
}

static bool has_relay(const faults_t *faults)
{
    return faults->setup.processes->relay_address != NULL;
}

static bool kill_member(faults_t *faults, fault_t *fault)
{
    return processes_kill(faults->setup.processes, fault->member, fault_between(fault->chance[0], 0, 2));
}

static bool dismiss_member(faults_t *faults, fault_t *fault)
{
    return processes_dismiss(faults->setup.processes, fault->member, fault_between(fault->chance[0], 0, 2));
}

static bool stop_member(fault_t *fault)
{
    fault->member->busy = processes_stop(fault->member);
    return fault->member->busy;
}

static void continue_member(faults_t *faults, fault_t *fault)
{
    (void)faults;
    fault->member->busy = false;
    processes_continue(fault->member);
}

static bool kill_worker(faults_t *faults, fault_t *fault)
{
    return fault_pick_worker(faults, fault) && kill_member(faults, fault);
}

static bool dismiss_worker(faults_t *faults, fault_t *fault)
{
    return fault_pick_worker(faults, fault) && dismiss_member(faults, fault);
}

static bool stop_worker(faults_t *faults, fault_t *fault)
{
    return fault_pick_worker(faults, fault) && stop_member(fault);
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
    return fault_pick_worker(faults, fault) &&
           processes_freeze(faults->setup.processes, fault->worker, fault_between(fault->chance[0], 0, 2));
}

static bool start_late_worker(faults_t *faults, fault_t *fault)
{
    for (size_t i = 0; i < PROCESSES_MAX_WORKERS && fault->worker == NULL; i++)
        if (faults->late[i] && faults->late[i]->member.process == 0) fault->worker = faults->late[i];
    if (fault->worker == NULL) return false;
    fault_victim(fault, "%s", fault->worker->member.name);
    processes_start_worker(faults->setup.processes, fault->worker);
    return true;
}

static void dismiss_late_worker(faults_t *faults, fault_t *fault)
{
    processes_continue(&fault->worker->member);
    processes_dismiss(faults->setup.processes, &fault->worker->member, INFINITY);
}

/* ---- the master --------------------------------------------------------------------------------------- */

static bool end_master(faults_t *faults, double away)
{
    processes_t *processes = faults->setup.processes;
    if (!processes_kill(processes, &processes->master, away)) return false;
    faults->kills++;
    return true;
}

static bool kill_master(faults_t *faults, fault_t *fault)
{
    return end_master(faults, fault_between(fault->chance[0], 0, 1));
}

/* Killed when it has just come up, and once more at the end of the fault: in the midst of coming up. */
static bool kill_master_twice(faults_t *faults, fault_t *fault)
{
    (void)fault;
    return end_master(faults, 0);
}

static void kill_master_again(faults_t *faults, fault_t *fault)
{
    fault->spoilt = !end_master(faults, fault_between(fault->chance[0], 0, 1));
}

void fault_slow_master_disk(faults_t *faults, double seconds)
{
    world_t *world = faults->setup.processes->master.world;
    if (world) world_slow_disk(world, seconds);
}

/* From now on the next such event is the master's end: faults_on_film sees to it. */
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
    fault_slow_master_disk(faults, CHECKPOINT_WRITE);
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
    fault_slow_master_disk(faults, 0);
}

void faults_on_film(faults_t *faults, film_event_t event)
{
    fault_t *fault = faults->waiting;
    if (fault == NULL || event != fault->event) return;
    /* At least two writes and a flush: it is still at it, wherever. */
    usleep((useconds_t)(3e6 * CHECKPOINT_WRITE * fault->chance[1]));
    if (!end_master(faults, fault_between(fault->chance[0], 0, 1))) return;
    bool torn = film_watch_torn(&faults->films);
    faults->torn += torn;
    report_line(faults->setup.report, "#%zu killed the master%s", fault->number,
                torn ? " with a checkpoint half written" : "");
    fault->spoilt = false;
    fault->ends = 0;
}

static bool dismiss_master(faults_t *faults, fault_t *fault)
{
    processes_t *processes = faults->setup.processes;
    return !processes->master.busy &&
           processes_dismiss(processes, &processes->master, fault_between(fault->chance[0], 0, 1));
}

static bool stop_master(faults_t *faults, fault_t *fault)
{
    fault->member = &faults->setup.processes->master;
    return !fault->member->busy && !fault->member->leaving && stop_member(fault);
}

/* ---- the kinds ---------------------------------------------------------------------------------------- */

/* Stops are shorter or longer than the lease of a worker, 1.5 s. */
static const fault_kind_t KINDS[] = {
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
};

const fault_family_t PROCESS_FAULTS = {KINDS, ARRAY_LENGTH(KINDS)};
