/* clerk: the thread that takes down what clients order, so that it outlives the process. A job that is
 * submitted, or ordered about, is safe on the disk before the client has its answer. It also writes down
 * whatever else changes the record of a job, and sees to it that the files of deleted jobs go.
 *
 * The control server asks with clerk_ask and collects the answers with clerk_next_answer: a slow disk delays
 * the answers, never a heartbeat.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_CLERK_H
#define LIGHTMILL_CLERK_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "master/store/journal.h"
#include "master/store/keeper.h"

enum { CLERK_MAX_WAITING = 256 }; /* requests that wait to be carried out, or whose answers wait */

typedef struct clerk clerk_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the next three; all outlive the clerk */
    blob_store_t *store;
    journal_t *journal;
    keeper_t *keeper;     /* NULL: no film outlives the process */
    const char *data_dir; /* copied */
    uint64_t first_job;   /* the number that the farm gives the next job */
    int clerk_wake;       /* the farm's eventfd */
    int answer_wake;      /* eventfd, written when clerk_next_answer has something */
} clerk_options_t;

/* Starts the thread. */
result_t clerk_start(const clerk_options_t *options, clerk_t **clerk);
/* Carries out what waits, writes the last records, joins the thread, frees everything and sets *clerk to
 * NULL.
 */
void clerk_stop(clerk_t **clerk);

typedef enum { CLERK_SUBMIT, CLERK_ORDER } clerk_kind_t;

/* What a client wants, and who it is. */
typedef struct {
    identity_t identity;
    uint64_t request; /* of the envelope */
    clerk_kind_t kind;
    /* CLERK_SUBMIT; the settings and terms have been checked, the clerk looks for the blob */
    job_terms_t terms;
    job_settings_t settings;
    hash_t blob;
    /* CLERK_ORDER */
    job_order_t order;
} clerk_request_t;

typedef struct {
    identity_t identity;
    uint64_t request;
    clerk_kind_t kind;
    result_t result; /* for the client: RESULT_OK when it is done, and safe */
    uint64_t job;
} clerk_answer_t;

/* Asks for something to be done; the answer comes from clerk_next_answer. RESULT_LIMIT when too many wait. */
result_t clerk_ask(clerk_t *clerk, const clerk_request_t *request);
/* The next answer; false when there is none. */
bool clerk_next_answer(clerk_t *clerk, clerk_answer_t *answer);

#endif
