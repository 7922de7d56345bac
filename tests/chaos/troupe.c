/* troupe: see troupe.h. */
#include "tests/chaos/troupe.h"

#include "tests/chaos/process.h"
#include "tests/chaos/words.h"

#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>

static const double LEAVE_LIMIT = 60; /* seconds that one who was told to end may take */
static const double RETRY = 0.5;      /* seconds between attempts of a master that has no room to start */
static const char *const HEARTBEAT = "0.3", *const BATCH_INTERVAL = "0.5", *const CHECKPOINT = "0.4";

static void member_init(troupe_t *troupe, member_t *member, const char *name)
{
    *member = (member_t){.name = mem_strdup(name), .back_at = INFINITY};
    member->log = mem_printf("%s/%s.log", troupe->folder, name);
    if (!troupe->worlds) return;
    char *path = mem_printf("%s/%s.world", troupe->folder, name);
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

static void launch(troupe_t *troupe, member_t *member, const char *program, int network,
                   const char *const *arguments)
{
    const process_setup_t setup = {.program = program,
                                   .arguments = arguments,
                                   .log = member->log,
                                   .network = network,
                                   .world = member->world};
    member->process = process_start(&setup);
    member->started = troupe->now;
    member->back_at = INFINITY;
    member->stopped = member->leaving = false;
    member->starts++;
}

static void start_master(troupe_t *troupe)
{
    char *listen = mem_printf("%s:%d", troupe->listen, troupe->port);
    char *lease = mem_printf("%g", troupe->lease);
    words_t words = {0};
    WORDS_ADD(&words, "--listen", listen, "--data", troupe->data, "--heartbeat", HEARTBEAT, "--lease", lease,
              "--batch-interval", BATCH_INTERVAL, "--checkpoint", CHECKPOINT, "--verbose");
    words_add_all(&words, troupe->passes->master);
    launch(troupe, &troupe->master, troupe->master_program, -1, words.list);
    free(listen);
    free(lease);
}

void troupe_start_worker(troupe_t *troupe, troupe_worker_t *worker)
{
    words_t words = {0};
    WORDS_ADD(&words, worker->address, "--threads", "1", "--cache", worker->cache, "--name",
              worker->member.name, "--verbose");
    words_add_all(&words, worker->passes);
    launch(troupe, &worker->member, troupe->worker_program, worker->network, words.list);
}

static void start_relay(troupe_t *troupe)
{
    char *listen = mem_printf("%s:%d", troupe->listen, troupe->port + TROUPE_RELAY_PORT);
    char *lease = mem_printf("%g", troupe->lease), *data = mem_printf("%s/relay", troupe->folder);
    words_t words = {0};
    WORDS_ADD(&words, troupe->relay_address, "--listen", listen, "--data", data, "--heartbeat", HEARTBEAT,
              "--lease", lease, "--batch-interval", BATCH_INTERVAL, "--name", "relay", "--verbose");
    words_add_all(&words, troupe->passes->relay);
    launch(troupe, &troupe->relay, troupe->relay_program, -1, words.list);
    free(listen);
    free(lease);
    free(data);
}

void troupe_init(troupe_t *troupe)
{
    troupe->master_program = process_program("lightmill-master");
    troupe->worker_program = process_program("lightmill-worker");
    troupe->relay_program = process_program("lightmill-relay");
    troupe->now = clock_now();
    member_init(troupe, &troupe->master, "master");
    start_master(troupe);
}

void troupe_free(troupe_t *troupe)
{
    member_free(&troupe->master);
    member_free(&troupe->relay);
    free(troupe->relay_address);
    free(troupe->relay_program);
    for (size_t i = 0; i < troupe->frozen_count; i++) process_kill(troupe->frozen[i]);
    for (size_t i = 0; i < troupe->worker_count; i++) {
        member_free(&troupe->workers[i].member);
        free(troupe->workers[i].address);
        free(troupe->workers[i].cache);
    }
    free(troupe->master_program);
    free(troupe->worker_program);
}

static troupe_worker_t *add_worker(troupe_t *troupe, char *address, int network, const char *const *passes)
{
    troupe_worker_t *worker = &troupe->workers[troupe->worker_count];
    char *name = mem_printf("worker-%zu", troupe->worker_count++);
    *worker = (troupe_worker_t){.network = network, .address = address, .passes = passes};
    member_init(troupe, &worker->member, name);
    worker->cache = mem_printf("%s/cache-%s", troupe->folder, name);
    free(name);
    return worker;
}

troupe_worker_t *troupe_add_worker(troupe_t *troupe, const char *host, int network, bool later)
{
    char *address = mem_printf("%s:%d", host, troupe->port);
    troupe_worker_t *worker = add_worker(troupe, address, network, troupe->passes->worker);
    if (!later) troupe_start_worker(troupe, worker);
    return worker;
}

void troupe_add_relay(troupe_t *troupe, const char *host)
{
    member_init(troupe, &troupe->relay, "relay");
    troupe->relay_address = mem_printf("%s:%d", host, troupe->port);
    start_relay(troupe);
}

void troupe_add_relay_worker(troupe_t *troupe)
{
    char *address = mem_printf("%s:%d", troupe->listen, troupe->port + TROUPE_RELAY_PORT);
    troupe_start_worker(troupe, add_worker(troupe, address, -1, troupe->passes->relay_worker));
}

/* ---- watching ----------------------------------------------------------------------------------------- */

/* A process has ended that no fault had killed. */
static void judge_end(troupe_t *troupe, member_t *member, int how)
{
    bool master = member == &troupe->master;
    char *text = process_how(how);
    if (member->leaving && how == 0)
        report_line(troupe->report, "%s has left", member->name);
    else if (master && troupe->disk_full && how < PROCESS_SIGNALLED && !member->leaving)
        troupe->master_failures++;
    else
        report_violation(troupe->report, "%s ended by itself: %s (%s)", member->name, text, member->log);
    if (isinf(member->back_at) && !member->retired) member->back_at = troupe->now + RETRY;
    free(text);
}

static void watch(troupe_t *troupe, member_t *member)
{
    int how;
    if (member->process == 0) return;
    if (process_ended(member->process, &how)) {
        member->process = 0;
        judge_end(troupe, member, how);
    } else if (member->leaving && !member->stopped && troupe->now > member->started + LEAVE_LIMIT) {
        report_violation(troupe->report, "%s was told to end and has not for %g s", member->name,
                         LEAVE_LIMIT);
        member->leaving = false;
    }
}

void troupe_tick(troupe_t *troupe, double now)
{
    troupe->now = now;
    watch(troupe, &troupe->master);
    watch(troupe, &troupe->relay);
    if (troupe->relay_address && troupe->relay.process == 0 && now >= troupe->relay.back_at)
        start_relay(troupe);
    if (troupe->master.process == 0 && now >= troupe->master.back_at) start_master(troupe);
    for (size_t i = 0; i < troupe->worker_count; i++) {
        troupe_worker_t *worker = &troupe->workers[i];
        watch(troupe, &worker->member);
        if (worker->member.process == 0 && now >= worker->member.back_at) troupe_start_worker(troupe, worker);
    }
}

/* ---- orders ------------------------------------------------------------------------------------------- */

bool troupe_kill(troupe_t *troupe, member_t *member, double away)
{
    if (member->process == 0) return false;
    process_kill(member->process);
    member->process = 0;
    member->back_at = troupe->now + away;
    return true;
}

bool troupe_freeze(troupe_t *troupe, troupe_worker_t *worker, double away)
{
    if (worker->member.process == 0 || troupe->frozen_count == TROUPE_MAX_FROZEN) return false;
    kill(worker->member.process, SIGSTOP);
    troupe->frozen[troupe->frozen_count++] = worker->member.process;
    worker->member.process = 0;
    worker->member.back_at = troupe->now + away;
    return true;
}

bool troupe_dismiss(troupe_t *troupe, member_t *member, double away)
{
    if (member->process == 0 || member->leaving) return false;
    troupe_continue(member);
    kill(member->process, SIGTERM);
    member->leaving = true;
    member->started = troupe->now; /* from now on it is timed */
    member->back_at = troupe->now + away;
    return true;
}

bool troupe_stop(member_t *member)
{
    if (member->process == 0 || member->stopped) return false;
    kill(member->process, SIGSTOP);
    member->stopped = true;
    return true;
}

bool troupe_continue(member_t *member)
{
    if (member->process == 0 || !member->stopped) return false;
    kill(member->process, SIGCONT);
    member->stopped = false;
    return true;
}

troupe_worker_t *troupe_pick_worker(troupe_t *troupe, uint64_t pick)
{
    for (size_t i = 0; i < troupe->worker_count; i++) {
        troupe_worker_t *worker = &troupe->workers[(pick + i) % troupe->worker_count];
        if (worker->member.process && !worker->member.busy && !worker->member.leaving) return worker;
    }
    return NULL;
}

static void heal(troupe_t *troupe, member_t *member)
{
    troupe_continue(member);
    member->busy = false;
    if (member->world) world_shift_clock(member->world, 0);
    if (member->world) world_slow_disk(member->world, 0);
    if (member->process == 0 && member->starts > 0 && !member->retired) member->back_at = troupe->now;
}

void troupe_heal(troupe_t *troupe)
{
    heal(troupe, &troupe->master);
    if (troupe->relay_address) heal(troupe, &troupe->relay);
    for (size_t i = 0; i < troupe->worker_count; i++) heal(troupe, &troupe->workers[i].member);
}

static void check_log(troupe_t *troupe, const member_t *member)
{
    static const char *const words[] = {"Sanitizer", "runtime error:", "Assertion"};
    uint8_t *bytes;
    size_t size;
    if (file_read(member->log, (size_t)1 << 30, &bytes, &size).code != RESULT_OK) return;
    for (size_t i = 0; i < ARRAY_LENGTH(words); i++)
        if (memmem(bytes, size, words[i], strlen(words[i])))
            report_violation(troupe->report, "\"%s\" in %s", words[i], member->log);
    free(bytes);
}

void troupe_check_logs(troupe_t *troupe)
{
    check_log(troupe, &troupe->master);
    if (troupe->relay_address) check_log(troupe, &troupe->relay);
    for (size_t i = 0; i < troupe->worker_count; i++) check_log(troupe, &troupe->workers[i].member);
}
