/* journal: the jobs of a master and their history, in an SQLite database that outlives the process.
 *
 * What a call has saved is on the disk when it returns. A damaged database is noticed when it is opened. It
 * is renamed, and what is readable in it goes into a new one.
 *
 *     jobs      the record of each job (record.h), and its name and state for people
 *     errors    how the estimated error of each job fell (error_history.h), a row for each point
 *     history   what happened to jobs and to the master, the last JOURNAL_MAX_HISTORY events
 *     meta      the next job's number, and whether a master is at work
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_JOURNAL_H
#define LIGHTMILL_JOURNAL_H

#include "master/store/error_history.h"
#include "master/store/job_record.h"

enum {
    JOURNAL_VERSION = 1,
    JOURNAL_MAX_HISTORY = 20000,
    JOURNAL_SKIPPED_NUMBERS = 1000 /* after a damaged database: a number is never given to two jobs */
};

typedef struct journal journal_t;

/* Opens the database, makes it if there is none. A damaged one is set aside, loudly. RESULT_IO when it cannot
 * be opened or made (a full disk, no permission), RESULT_INPUT when a later version of Lightmill made it.
 * With `fleeting` nothing is written to the disk. */
result_t journal_open(const char *path, bool fleeting, journal_t **journal);
/* Notes that this process ended properly, closes the database and sets *journal to NULL. */
void journal_close(journal_t **journal);

/* What was found on opening. */
typedef struct {
    bool fresh;   /* there was no database */
    bool damaged; /* there was one, and it is set aside */
    bool crashed; /* the last master did not end properly */
    uint64_t next_job;
    job_record_t *records; /* in the order of their numbers; the journal's, until journal_forget_found */
    size_t record_count;
    error_history_t *errors; /* of each record, empty where there is none; likewise */
} journal_found_t;
const journal_found_t *journal_found(const journal_t *journal);
void journal_forget_found(journal_t *journal);

/* Saves the records, all or none; those that are marked as removed go, with their errors. */
result_t journal_save(journal_t *journal, const job_record_t *records, size_t count);
/* Saves how the error of a job fell, in the place of what was saved of it before. */
result_t journal_save_errors(journal_t *journal, uint64_t job, const error_history_t *errors);
/* Adds to the history of a job, 0: of the master. */
result_t journal_note(journal_t *journal, uint64_t job, const char *event, const char *text);

#endif
