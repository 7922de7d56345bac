/* health: see health.h. */
#include "common/health.h"

#include "common/thread.h"
#include "common/wake.h"

#include <errno.h>
#include <poll.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

enum { TEXT_SIZE = 500, BACKLOG = 8, ANSWER_MS = 5000, PAUSE_MS = 200 };

struct health {
    char *path;
    health_report_t report;
    void *context;
    int listener, wake;
    pthread_t thread;
    atomic_bool stop;
};

static result_t make_address(const char *path, struct sockaddr_un *address)
{
    *address = (struct sockaddr_un){.sun_family = AF_UNIX};
    if (strlen(path) >= sizeof address->sun_path)
        return result_fail(RESULT_USAGE, "the path of the health socket is longer than %zu bytes: %.200s",
                           sizeof address->sun_path - 1, path);
    strcpy(address->sun_path, path);
    return result_ok();
}

/* One that never waits: a process that was stopped accepts nobody, and many may have asked it. */
static result_t open_socket(int *descriptor)
{
    *descriptor = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (*descriptor >= 0) return result_ok();
    return result_fail(RESULT_IO, "cannot make a socket: %s", strerror(errno));
}

/* ---- answering ----------------------------------------------------------------------------------------- */

static void answer(const health_t *health, int peer)
{
    char text[TEXT_SIZE] = "", line[TEXT_SIZE + 16];
    bool well = health->report(health->context, text, sizeof text);
    int length = snprintf(line, sizeof line, "%s %s\n", well ? "ok" : "failing", text);
    if (send(peer, line, (size_t)length, MSG_NOSIGNAL | MSG_DONTWAIT) < 0)
        log_debug("nobody waited for the state of health: %s", strerror(errno));
}

static void *health_run(void *argument)
{
    health_t *health = argument;
    while (!atomic_load(&health->stop)) {
        struct pollfd waits[] = {{.fd = health->listener, .events = POLLIN},
                                 {.fd = health->wake, .events = POLLIN}};
        if (poll(waits, ARRAY_LENGTH(waits), -1) < 0 || !(waits[0].revents & POLLIN)) continue;
        int peer = accept4(health->listener, NULL, NULL, SOCK_CLOEXEC);
        if (peer < 0) { /* no descriptor is left: who asks goes on waiting */
            poll(&waits[1], 1, PAUSE_MS);
            continue;
        }
        answer(health, peer);
        close(peer);
    }
    return NULL;
}

/* Binds and listens. A socket file that nobody answers at is what a killed process left; any other file is
 * somebody's. */
static result_t listen_at(health_t *health)
{
    struct sockaddr_un address;
    struct stat status;
    TRY(make_address(health->path, &address));
    TRY(open_socket(&health->listener));
    if (connect(health->listener, (struct sockaddr *)&address, sizeof address) == 0 || errno == EAGAIN)
        return result_fail(RESULT_USAGE,
                           "another process answers at %s: give this one a health socket of its own",
                           health->path);
    bool left_over = errno == ECONNREFUSED && lstat(health->path, &status) == 0 && S_ISSOCK(status.st_mode);
    if (left_over) unlink(health->path);
    close(health->listener);
    TRY(open_socket(&health->listener));
    if (bind(health->listener, (struct sockaddr *)&address, sizeof address) == 0 &&
        chmod(health->path, S_IRUSR | S_IWUSR) == 0 && listen(health->listener, BACKLOG) == 0)
        return result_ok();
    return result_fail(RESULT_IO, "cannot answer at %s: %s", health->path, strerror(errno));
}

static result_t start(health_t *health)
{
    TRY(listen_at(health));
    result_t result = wake_new(&health->wake);
    if (result.code == RESULT_OK) result = thread_start(&health->thread, "lm-health", health_run, health);
    if (result.code != RESULT_OK) unlink(health->path);
    return result;
}

static void release(health_t *health)
{
    if (health->listener >= 0) close(health->listener);
    wake_close(health->wake);
    free(health->path);
    free(health);
}

result_t health_start(const char *path, health_report_t report, void *context, health_t **out)
{
    *out = NULL;
    if (path == NULL) return result_ok();
    health_t *health = mem_zalloc(1, sizeof *health);
    *health = (health_t){
        .path = mem_strdup(path), .report = report, .context = context, .listener = -1, .wake = -1};
    result_t result = start(health);
    if (result.code != RESULT_OK) release(health);
    *out = result.code == RESULT_OK ? health : NULL;
    return result;
}

void health_stop(health_t **out)
{
    health_t *health = *out;
    if (health == NULL) return;
    atomic_store(&health->stop, true);
    wake_up(health->wake);
    pthread_join(health->thread, NULL);
    unlink(health->path);
    release(health);
    *out = NULL;
}

/* ---- the pulse of a loop ------------------------------------------------------------------------------- */

void pulse_beat(pulse_t *pulse, const char *doing)
{
    if (pulse == NULL) return;
    atomic_store(&pulse->doing, doing);
    atomic_store(&pulse->beat, (long long)(1e3 * clock_now()));
}

bool pulse_report(void *context, char *text, size_t size)
{
    pulse_t *pulse = context;
    long long beat = atomic_load(&pulse->beat);
    const char *doing = atomic_load(&pulse->doing);
    double age = clock_now() - 1e-3 * (double)beat;
    if (beat == 0) {
        snprintf(text, size, "starting");
    } else if (age <= PULSE_LATE) {
        snprintf(text, size, "%s", doing != NULL ? doing : "at work");
    } else {
        snprintf(text, size, "no sign of life for %.0f s", age);
        return false;
    }
    return true;
}

/* ---- asking -------------------------------------------------------------------------------------------- */

/* Reads to the end of the answer, or until it takes too long. */
static result_t read_answer(int peer, const char *path, char *line, size_t size)
{
    size_t length = 0;
    double deadline = clock_now() + 1e-3 * ANSWER_MS;
    for (double now; length + 1 < size && (now = clock_now()) < deadline;) {
        struct pollfd wait = {.fd = peer, .events = POLLIN};
        if (poll(&wait, 1, (int)(1e3 * (deadline - now)) + 1) <= 0) continue;
        ssize_t got = read(peer, line + length, size - 1 - length);
        if (got <= 0) break;
        length += (size_t)got;
    }
    line[length] = '\0';
    line[strcspn(line, "\n")] = '\0';
    if (length > 0) return result_ok();
    return result_fail(RESULT_UNREACHABLE, "the process at %s does not answer", path);
}

static result_t ask(int peer, const char *path, char *text, size_t size)
{
    struct sockaddr_un address;
    char line[TEXT_SIZE + 16];
    TRY(make_address(path, &address));
    if (connect(peer, (struct sockaddr *)&address, sizeof address) != 0)
        return result_fail(RESULT_UNREACHABLE, "nobody answers at %s: %s", path,
                           errno == EAGAIN ? "others wait for an answer already" : strerror(errno));
    TRY(read_answer(peer, path, line, sizeof line));
    bool well = strncmp(line, "ok ", 3) == 0;
    snprintf(text, size, "%s", well ? line + 3 : line);
    return well ? result_ok() : result_fail(RESULT_MISMATCH, "%s", line);
}

result_t health_ask(const char *path, char *text, size_t size)
{
    int peer;
    text[0] = '\0';
    TRY(open_socket(&peer));
    result_t result = ask(peer, path, text, size);
    close(peer);
    return result;
}
