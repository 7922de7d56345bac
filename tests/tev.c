/* tev: see tev.h. */
#include "tests/tev.h"

#include "tests/scratch.h"

#include <fcntl.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double PATIENCE = 60; /* seconds */

static void run_viewer(const char *path, int port, bool deaf)
{
    char number[16];
    snprintf(number, sizeof number, "%d", port);
    int file = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0666);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(file, STDOUT_FILENO);
    dup2(file, STDERR_FILENO);
    execlp("python3", "python3", "tests/tev_viewer.py", number, deaf ? "--deaf" : NULL, NULL);
    _exit(127);
}

tev_t *tev_start(const char *folder, int port, bool deaf)
{
    tev_t *tev = mem_zalloc(1, sizeof *tev);
    char *name = mem_printf("viewer-%.6f", clock_now());
    tev->path = scratch_path(folder, name);
    free(name);
    scratch_write(tev->path, "", 0);
    tev->process = fork();
    assert_true(tev->process >= 0);
    if (tev->process == 0) run_viewer(tev->path, port, deaf);
    char *line = tev_wait(tev, "listening ", PATIENCE);
    assert_non_null(line);
    tev->port = atoi(line);
    tev->address = mem_printf("127.0.0.1:%d", tev->port);
    free(line);
    return tev;
}

void tev_kill(tev_t **tev_pointer)
{
    tev_t *tev = *tev_pointer;
    if (tev == NULL) return;
    kill(tev->process, SIGKILL);
    waitpid(tev->process, NULL, 0);
    free(tev->address);
    free(tev->path);
    free(tev);
    *tev_pointer = NULL;
}

/* The next whole line in fresh memory; NULL: there is none yet. */
static char *next_line(tev_t *tev)
{
    uint8_t *data;
    size_t size;
    assert_int_equal(file_read(tev->path, 1 << 24, &data, &size).code, RESULT_OK);
    const uint8_t *end = memchr(data + tev->read, '\n', size - tev->read);
    char *line = end ? mem_printf("%.*s", (int)(end - data - (long)tev->read), data + tev->read) : NULL;
    if (end) tev->read = (size_t)(end - data) + 1;
    free(data);
    return line;
}

char *tev_wait(tev_t *tev, const char *begin, double seconds)
{
    for (double end = clock_now() + seconds; clock_now() < end;) {
        char *line = next_line(tev);
        if (line == NULL) {
            nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
            continue;
        }
        if (strncmp(line, "error", 5) == 0 || strstr(line, "Traceback")) fail_msg("the viewer: %s", line);
        char *rest = strncmp(line, begin, strlen(begin)) == 0 ? mem_strdup(line + strlen(begin)) : NULL;
        free(line);
        if (rest) return rest;
    }
    return NULL;
}

bool tev_wait_shown(tev_t *tev, double seconds, tev_shown_t *shown)
{
    char *line = tev_wait(tev, "shown ", seconds);
    if (line == NULL) return false;
    assert_int_equal(
        sscanf(line, "updates=%u values=%u hash=%64s", &shown->updates, &shown->values, shown->hash), 3);
    free(line);
    return true;
}

void tev_expect_hash(tev_t *tev, const hash_t *hash)
{
    tev_shown_t shown = {.hash = ""};
    tev_expect_hash_after(tev, &shown, hash);
}

void tev_expect_hash_after(tev_t *tev, const tev_shown_t *before, const hash_t *hash)
{
    char expected[2 * HASH_BYTES + 1];
    tev_shown_t shown = *before;
    hash_to_hex(hash, expected);
    while (strcmp(shown.hash, expected) != 0)
        if (!tev_wait_shown(tev, PATIENCE, &shown)) fail_msg("the viewer never shows %s", expected);
}
