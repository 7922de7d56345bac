/* processes: see processes.h. */
#include "tests/chaos/processes.h"

#include "tests/chaos/process.h"
#include "tests/chaos/words.h"

#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>

static const double LEAVE_LIMIT = 60; /* seconds that one who was told to end may take */
static const double YOUNG = 3; /* seconds, in which a program may not have come so far as to catch signals */
static const double RETRY = 0.5; /* seconds between attempts of a master that has no room to start */
static const char *const HEARTBEAT = "0.3", *const BATCH_INTERVAL = "0.5", *const CHECKPOINT = "0.4";

static void member_init(processes_t *processes, member_t *member, const char *name)
{
    *member = (member_t){.name = mem_strdup(name), .back_at = INFINITY};
    member->log = mem_printf("%s/%s.log", processes->folder, name);
    if (!processes->worlds) return;
    char *path = mem_printf("%s/%s.world", processes->folder, name);
    member->world = world_new(path);
    free(path);
}

static void member_free(member_t *member)
{
    if (member->process) process_kill(member->process);
    free(member->name);
    free(member->log);
    world_free(&member->world);
}

static void launch(processes_t *processes, member_t *member, const char *program, int network,
                   const char *const *arguments)
{
    const process_setup_t setup = {.program = program,
                                   .arguments = arguments,
                                   .log = member->log,
                                   .network = network,
                                   .world = member->world};
    member->process = process_start(&setup);
    member->started = processes->now;
    member->back_at = INFINITY;
    member->stopped = member->leaving = false;
    member->starts++;
}

static void start_master(processes_t *processes)
{
    char *listen = mem_printf("%s:%d", processes->listen, processes->port);
    char *lease = mem_printf("%g", processes->lease);
    words_t words = {0};
    WORDS_ADD(&words, "--listen", listen, "--data", processes->data, "--heartbeat", HEARTBEAT, "--lease",
              lease, "--batch-interval", BATCH_INTERVAL, "--checkpoint", CHECKPOINT, "--verbose");
    words_add_all(&words, processes->passes->master);
    launch(processes, &processes->master, processes->master_program, -1, words.list);
    free(listen);
    free(lease);
}

void processes_start_worker(processes_t *processes, processes_worker_t *worker)
{
    words_t words = {0};
    WORDS_ADD(&words, worker->address, "--threads", "1", "--cache", worker->cache, "--name",
              worker->member.name, "--verbose");
    words_add_all(&words, worker->passes);
    launch(processes, &worker->member, processes->worker_program, worker->network, words.list);
}

static void start_relay(processes_t *processes)
{
    char *listen = mem_printf("%s:%d", processes->listen, processes->port + PROCESSES_RELAY_PORT);
    char *lease = mem_printf("%g", processes->lease), *data = mem_printf("%s/relay", processes->folder);
    words_t words = {0};
    WORDS_ADD(&words, processes->relay_address, "--listen", listen, "--data", data, "--heartbeat", HEARTBEAT,
              "--lease", lease, "--batch-interval", BATCH_INTERVAL, "--name", "relay", "--verbose");
    words_add_all(&words, processes->passes->relay);
    launch(processes, &processes->relay, processes->relay_program, -1, words.list);
    free(listen);
    free(lease);
    free(data);
}

void processes_init(processes_t *processes)
{
    processes->master_program = process_program("lightmill-master");
    processes->worker_program = process_program("lightmill-worker");
    processes->relay_program = process_program("lightmill-relay");
    processes->now = clock_now();
    member_init(processes, &processes->master, "master");
    start_master(processes);
}

void processes_free(processes_t *processes)
{
    member_free(&processes->master);
    member_free(&processes->relay);
    free(processes->relay_address);
    free(processes->relay_program);
    for (size_t i = 0; i < processes->frozen_count; i++) process_kill(processes->frozen[i]);
    for (size_t i = 0; i < processes->worker_count; i++) {
        member_free(&processes->workers[i].member);
        free(processes->workers[i].address);
        free(processes->workers[i].cache);
    }
    free(processes->master_program);
    free(processes->worker_program);
}

static processes_worker_t *add_worker(processes_t *processes, char *address, int network,
                                      const char *const *passes)
{
    processes_worker_t *worker = &processes->workers[processes->worker_count];
    char *name = mem_printf("worker-%zu", processes->worker_count++);
    *worker = (processes_worker_t){.network = network, .address = address, .passes = passes};
    member_init(processes, &worker->member, name);
    worker->cache = mem_printf("%s/cache-%s", processes->folder, name);
    free(name);
    return worker;
}

processes_worker_t *processes_add_worker(processes_t *processes, const char *host, int network, bool later)
{
    char *address = mem_printf("%s:%d", host, processes->port);
    processes_worker_t *worker = add_worker(processes, address, network, processes->passes->worker);
    if (!later) processes_start_worker(processes, worker);
    return worker;
}

void processes_add_relay(processes_t *processes, const char *host)
{
    member_init(processes, &processes->relay, "relay");
    processes->relay_address = mem_printf("%s:%d", host, processes->port);
    start_relay(processes);
}

void processes_add_relay_worker(processes_t *processes)
{
    char *address = mem_printf("%s:%d", processes->listen, processes->port + PROCESSES_RELAY_PORT);
    processes_start_worker(processes, add_worker(processes, address, -1, processes->passes->relay_worker));
}

/* ---- watching ----------------------------------------------------------------------------------------- */

/* A process has ended that no fault had killed. */
static void judge_end(processes_t *processes, member_t *member, int how)
{
    bool master = member == &processes->master;
    char *text = process_how(how);
    bool ended = how == 0 || (member->young && how == PROCESS_SIGNALLED + SIGTERM);
    bool cut_off = how == RESULT_UNREACHABLE && !master;
    if (member->leaving && ended)
        report_line(processes->report, "%s has left", member->name);
    else if (member->leaving && cut_off) /* as it promises: what it had is rendered by others */
        report_line(processes->report, "%s has left, and could not deliver its last batch", member->name);
    else if (master && processes->disk_full && how < PROCESS_SIGNALLED && !member->leaving)
        processes->master_failures++;
    else
        report_violation(processes->report, "%s ended by itself: %s (%s)", member->name, text, member->log);
    if (isinf(member->back_at) && !member->retired) member->back_at = processes->now + RETRY;
    free(text);
}

static void watch(processes_t *processes, member_t *member)
{
    int how;
    if (member->process == 0) return;
    if (process_ended(member->process, &how)) {
        member->process = 0;
        judge_end(processes, member, how);
    } else if (member->leaving && !member->stopped && processes->now > member->started + LEAVE_LIMIT) {
        report_violation(processes->report, "%s was told to end and has not for %g s", member->name,
                         LEAVE_LIMIT);
        member->leaving = false;
    }
}

void processes_tick(processes_t *processes, double now)
{
    processes->now = now;
    watch(processes, &processes->master);
    watch(processes, &processes->relay);
    if (processes->relay_address && processes->relay.process == 0 && now >= processes->relay.back_at)
        start_relay(processes);
    if (processes->master.process == 0 && now >= processes->master.back_at) start_master(processes);
    for (size_t i = 0; i < processes->worker_count; i++) {
        processes_worker_t *worker = &processes->workers[i];
        watch(processes, &worker->member);
        if (worker->member.process == 0 && now >= worker->member.back_at)
            processes_start_worker(processes, worker);
    }
}

/* ---- orders ------------------------------------------------------------------------------------------- */

bool processes_kill(processes_t *processes, member_t *member, double away)
{
    if (member->process == 0) return false;
    process_kill(member->process);
    member->process = 0;
    member->back_at = processes->now + away;
    return true;
}

bool processes_freeze(processes_t *processes, processes_worker_t *worker, double away)
{
    if (worker->member.process == 0 || processes->frozen_count == PROCESSES_MAX_FROZEN) return false;
    kill(worker->member.process, SIGSTOP);
    processes->frozen[processes->frozen_count++] = worker->member.process;
    worker->member.process = 0;
    worker->member.back_at = processes->now + away;
    return true;
}

bool processes_dismiss(processes_t *processes, member_t *member, double away)
{
    if (member->process == 0 || member->leaving) return false;
    processes_continue(member);
    kill(member->process, SIGTERM);
    member->leaving = true;
    member->young = processes->now < member->started + YOUNG;
    member->started = processes->now; /* from now on it is timed */
    member->back_at = processes->now + away;
    return true;
}

bool processes_stop(member_t *member)
{
    if (member->process == 0 || member->stopped) return false;
    kill(member->process, SIGSTOP);
    member->stopped = true;
    return true;
}

bool processes_continue(member_t *member)
{
    if (member->process == 0 || !member->stopped) return false;
    kill(member->process, SIGCONT);
    member->stopped = false;
    return true;
}

processes_worker_t *processes_pick_worker(processes_t *processes, uint64_t pick)
{
    for (size_t i = 0; i < processes->worker_count; i++) {
        processes_worker_t *worker = &processes->workers[(pick + i) % processes->worker_count];
        if (worker->member.process && !worker->member.busy && !worker->member.leaving) return worker;
    }
    return NULL;
}

static void heal(processes_t *processes, member_t *member)
{
    processes_continue(member);
    member->busy = false;
    if (member->world) world_shift_clock(member->world, 0);
    if (member->world) world_slow_disk(member->world, 0);
    if (member->process == 0 && member->starts > 0 && !member->retired) member->back_at = processes->now;
}

void processes_heal(processes_t *processes)
{
    heal(processes, &processes->master);
    if (processes->relay_address) heal(processes, &processes->relay);
    for (size_t i = 0; i < processes->worker_count; i++) heal(processes, &processes->workers[i].member);
}

static void check_log(processes_t *processes, const member_t *member)
{
    static const char *const words[] = {"Sanitizer", "runtime error:", "Assertion"};
    uint8_t *bytes;
    size_t size;
    if (file_read(member->log, (size_t)1 << 30, &bytes, &size).code != RESULT_OK) return;
    for (size_t i = 0; i < ARRAY_LENGTH(words); i++)
        if (memmem(bytes, size, words[i], strlen(words[i])))
            report_violation(processes->report, "\"%s\" in %s", words[i], member->log);
    free(bytes);
}

void processes_check_logs(processes_t *processes)
{
    check_log(processes, &processes->master);
    if (processes->relay_address) check_log(processes, &processes->relay);
    for (size_t i = 0; i < processes->worker_count; i++) check_log(processes, &processes->workers[i].member);
}
