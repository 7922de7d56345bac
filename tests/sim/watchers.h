/* watchers: people who look at a job in their browsers, as far as the master can tell: each listens to its
 * events and asks for jobs, workers, history and tiles when the page does (web/app.js, web/tiles.js), and at
 * the page's pace. What comes is counted and thrown away. */
#ifndef LIGHTMILL_WATCHERS_H
#define LIGHTMILL_WATCHERS_H

#include "common/base.h"
#include "master/http/access/tokens.h"

typedef struct {
    int port; /* of the page, on this machine */
    char token[HTTP_TOKEN_TEXT + 1];
    uint64_t job;
    uint32_t level;
    int width, height; /* of what is in sight, from the upper left corner, in texels of the level */
    int count;
    int deaf; /* of them: they ask and never read */
} watchers_options_t;

/* What came to all of them. */
typedef struct {
    double bytes, tile_bytes;
    uint64_t requests, pictures; /* answers with tiles */
    uint64_t events, lost;       /* events of which these said that some are lost */
    uint64_t refused;            /* requests and connections */
} watched_t;

typedef struct watchers watchers_t;

/* Starts a thread for each. */
result_t watchers_start(const watchers_options_t *options, watchers_t **watchers);
/* Ends them, frees everything and sets *watchers to NULL. */
watched_t watchers_stop(watchers_t **watchers);

#endif
