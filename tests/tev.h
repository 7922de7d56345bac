/* tev: an image viewer for tests, tests/tev_viewer.py, as a process of its own. Calls end the test on
 * failure, and the process dies with the test. */
#ifndef LIGHTMILL_TESTS_TEV_H
#define LIGHTMILL_TESTS_TEV_H

#include "common/base.h"

#include <sys/types.h>

typedef struct {
    pid_t process;
    int port;
    char *address; /* "127.0.0.1:PORT" */
    char *path;    /* what it prints */
    size_t read;   /* bytes of that which tev_expect has read */
} tev_t;

/* Starts one at a port (0: a free one), which reads or, `deaf`, never does. Its output goes to the folder. */
tev_t *tev_start(const char *folder, int port, bool deaf);
/* Kills it with -9. */
void tev_kill(tev_t **tev);
/* Waits for the next line that begins so, at most `seconds`; without it the rest in fresh memory, NULL when
 * it does not come. An error of the viewer ends the test. */
char *tev_wait(tev_t *tev, const char *begin, double seconds);

/* A line "shown". */
typedef struct {
    unsigned updates, values;
    char hash[2 * HASH_BYTES + 1];
} tev_shown_t;
/* Waits for the next one; false when it does not come. */
bool tev_wait_shown(tev_t *tev, double seconds, tev_shown_t *shown);
/* Waits until a viewer shows an image of this pixel hash. */
void tev_expect_hash(tev_t *tev, const hash_t *hash);
/* The same, of one that showed `before` last. */
void tev_expect_hash_after(tev_t *tev, const tev_shown_t *before, const hash_t *hash);

#endif
