/* hook: see hook.h. One thread serves one connection after the other. */
#include "tests/hook.h"

#include "common/base.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { MAX_REQUESTS = 64, MAX_SIZE = 16384, POLL_MS = 20 };

struct hook {
    int listener, silent[MAX_REQUESTS];
    size_t silent_count;
    char *url;
    int statuses[MAX_REQUESTS];
    size_t status_count;
    atomic_bool stop;
    pthread_t thread;
    pthread_mutex_t lock; /* guards the next two */
    char *requests[MAX_REQUESTS];
    size_t count;
};

/* True when head and body are there. */
static bool is_whole(const char *request)
{
    const char *body = strstr(request, "\r\n\r\n"), *length = strcasestr(request, "\r\nContent-Length:");
    return body != NULL && length != NULL && strlen(body + 4) >= strtoul(length + 17, NULL, 10);
}

/* A request in fresh memory; NULL when the peer went away. */
static char *receive(hook_t *hook, int peer)
{
    char *request = mem_zalloc(1, MAX_SIZE + 1);
    size_t size = 0;
    while (!is_whole(request) && size < MAX_SIZE && !atomic_load(&hook->stop)) {
        struct pollfd wait = {.fd = peer, .events = POLLIN};
        if (poll(&wait, 1, POLL_MS) <= 0) continue;
        ssize_t got = recv(peer, request + size, MAX_SIZE - size, 0);
        if (got <= 0) break;
        size += (size_t)got;
    }
    if (is_whole(request)) return request;
    free(request);
    return NULL;
}

static void answer(hook_t *hook, int peer, int status)
{
    if (status == HOOK_SILENCE) {
        hook->silent[hook->silent_count++] = peer;
        return;
    }
    char *text = mem_printf("HTTP/1.1 %d Status\r\nLocation: %s\r\nContent-Length: 2\r\nConnection: "
                            "close\r\n\r\nok",
                            status, hook->url);
    send(peer, text, strlen(text), MSG_NOSIGNAL);
    free(text);
    close(peer);
}

static void *hook_run(void *argument)
{
    hook_t *hook = argument;
    while (!atomic_load(&hook->stop)) {
        struct pollfd wait = {.fd = hook->listener, .events = POLLIN};
        if (poll(&wait, 1, POLL_MS) <= 0) continue;
        int peer = accept4(hook->listener, NULL, NULL, SOCK_CLOEXEC);
        char *request = peer >= 0 ? receive(hook, peer) : NULL;
        if (request == NULL || hook->count == MAX_REQUESTS) {
            if (peer >= 0) close(peer);
            free(request);
            continue;
        }
        pthread_mutex_lock(&hook->lock);
        size_t index = hook->count++;
        hook->requests[index] = request;
        pthread_mutex_unlock(&hook->lock);
        answer(hook, peer, hook->statuses[index < hook->status_count ? index : hook->status_count - 1]);
    }
    return NULL;
}

hook_t *hook_start(int port, const int *statuses, size_t count)
{
    hook_t *hook = mem_zalloc(1, sizeof *hook);
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    socklen_t size = sizeof address;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    memcpy(hook->statuses, statuses, count * sizeof *statuses);
    hook->status_count = count;
    hook->listener = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    setsockopt(hook->listener, SOL_SOCKET, SO_REUSEADDR, &(int){1}, sizeof(int));
    assert_int_equal(bind(hook->listener, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(listen(hook->listener, 8), 0);
    assert_int_equal(getsockname(hook->listener, (struct sockaddr *)&address, &size), 0);
    hook->url = mem_printf("http://127.0.0.1:%d/secret", ntohs(address.sin_port));
    pthread_mutex_init(&hook->lock, NULL);
    assert_int_equal(pthread_create(&hook->thread, NULL, hook_run, hook), 0);
    return hook;
}

void hook_stop(hook_t **out)
{
    hook_t *hook = *out;
    if (hook == NULL) return;
    atomic_store(&hook->stop, true);
    pthread_join(hook->thread, NULL);
    for (size_t i = 0; i < hook->silent_count; i++) close(hook->silent[i]);
    for (size_t i = 0; i < hook->count; i++) free(hook->requests[i]);
    close(hook->listener);
    pthread_mutex_destroy(&hook->lock);
    free(hook->url);
    free(hook);
    *out = NULL;
}

const char *hook_url(const hook_t *hook)
{
    return hook->url;
}

size_t hook_count(hook_t *hook)
{
    pthread_mutex_lock(&hook->lock);
    size_t count = hook->count;
    pthread_mutex_unlock(&hook->lock);
    return count;
}

char *hook_wait(hook_t *hook, size_t index, double seconds)
{
    double deadline = clock_now() + seconds;
    while (hook_count(hook) <= index) {
        if (clock_now() > deadline) fail_msg("request %zu did not come within %g s", index, seconds);
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    }
    pthread_mutex_lock(&hook->lock);
    char *request = mem_strdup(hook->requests[index]);
    pthread_mutex_unlock(&hook->lock);
    return request;
}
