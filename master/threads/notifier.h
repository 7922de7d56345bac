/* notifier: the thread that tells the operator of jobs that are over, or wait for him: it calls what
 * `--notify` of lightmill-master says (common/notify/notify.h). A target that hangs or fails costs nobody
 * else anything; it is tried again, for NOTIFIER_PATIENCE seconds, then the log says that nobody was told. */
#ifndef LIGHTMILL_NOTIFIER_H
#define LIGHTMILL_NOTIFIER_H

#include "master/farm/farm.h"

enum { NOTIFIER_PATIENCE = 600 }; /* seconds */

typedef struct notifier notifier_t;

typedef struct {
    farm_t *farm;         /* kept by the caller, outlives the notifier */
    const char *target;   /* URL or command; copied */
    const char *data_dir; /* where images are; copied */
    int news_wake;        /* the farm's eventfd */
} notifier_options_t;

/* Starts the thread. */
result_t notifier_start(const notifier_options_t *options, notifier_t **notifier);
/* Ends an attempt that is under way, joins the thread, frees everything and sets *notifier to NULL. What was
 * not told stays in the jobs' records. */
void notifier_stop(notifier_t **notifier);

#endif
