/* journal_writer: the thread that writes what clients order to the journal, so that it outlives the process.
 * A submitted job, and an order, is safe on the disk before the client has its answer. The thread also writes
 * every other change of a job's record, how its error falls, and deletes the files of deleted jobs.
 *
 * The control server asks with journal_writer_ask and collects the answers with journal_writer_next_answer: a
 * slow disk delays the answers, never a heartbeat.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_JOURNAL_WRITER_H
#define LIGHTMILL_JOURNAL_WRITER_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "master/store/journal.h"
#include "master/threads/checkpointer.h"

enum { JOURNAL_WRITER_MAX_WAITING = 256 }; /* requests that wait to be carried out, or whose answers wait */

typedef struct journal_writer journal_writer_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the next three; all outlive the journal writer */
    blob_store_t *store;
    journal_t *journal;
    checkpointer_t *checkpointer; /* NULL: no film outlives the process */
    const char *data_dir;         /* copied */
    uint64_t first_job;           /* the number that the farm gives the next job */
    int journal_writer_wake;      /* the farm's eventfd */
    int answer_wake;              /* eventfd, written when journal_writer_next_answer has something */
} journal_writer_options_t;

/* Starts the thread. */
result_t journal_writer_start(const journal_writer_options_t *options, journal_writer_t **journal_writer);
/* Carries out what waits, writes the last records, joins the thread, frees everything and sets
 * *journal_writer to NULL.
 */
void journal_writer_stop(journal_writer_t **journal_writer);

typedef enum { JOURNAL_WRITER_SUBMIT, JOURNAL_WRITER_ORDER } journal_writer_kind_t;

typedef struct journal_writer_answer journal_writer_answer_t;

/* What a client wants, and who it is. */
typedef struct {
    /* Is called with the answer on the journal writer's thread, which it must not hold up; NULL: the answer
     * comes from journal_writer_next_answer. */
    void (*done)(void *context, const journal_writer_answer_t *answer);
    void *context;
    identity_t identity;
    uint64_t request; /* of the envelope */
    journal_writer_kind_t kind;
    /* JOURNAL_WRITER_SUBMIT; the settings and terms have been checked, the journal writer looks for the blob
     */
    job_terms_t terms;
    job_settings_t settings;
    hash_t blob;
    /* JOURNAL_WRITER_ORDER */
    job_order_t order;
} journal_writer_request_t;

struct journal_writer_answer {
    identity_t identity;
    uint64_t request;
    journal_writer_kind_t kind;
    result_t result; /* for the client: RESULT_OK when it is done, and safe */
    uint64_t job;
    uint32_t save_at; /* JOURNAL_WRITER_SUBMIT: the milestones that it has, */
    bool halves;      /* and whether its images have the halves */
};

/* Asks for something to be done. RESULT_LIMIT, and no answer, when too many wait. */
result_t journal_writer_ask(journal_writer_t *journal_writer, const journal_writer_request_t *request);
/* The next answer; false when there is none. */
bool journal_writer_next_answer(journal_writer_t *journal_writer, journal_writer_answer_t *answer);

#endif
