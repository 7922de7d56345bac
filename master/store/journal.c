/* journal: see journal.h.
 *
 * DESIGN. A write-ahead log with full flushing: a commit is one flush of the log, and it is safe against a
 * power cut. SQLite finds damage to its structure, but not a flipped bit in a record, so each record has a
 * hash of its own. A database that fails either check is not mended: it is set aside under another name, a
 * new one is made, and the records in it that are whole are taken over. The films say of themselves what they
 * are (checkpoint.h), so what the journal has lost of a job that has samples comes back from there.
 *
 * The points of errors have no hashes: a wrong one is a dot in the wrong place of a plot, and nothing is
 * decided by it. Their table is made when the first are saved, since journals of earlier versions have none.
 *
 * A job's number is never used again, for a worker may still hold a batch of the job that had it. So the next
 * number is kept apart from the jobs, and saved together with each new one. */
#include "master/store/journal.h"

#include "master/store/record.h"

#include <errno.h>
#include <pthread.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum {
    APPLICATION_ID = 0x4c4d494c, /* "LMIL", so that `file` can tell what it is */
    BUSY_MS = 5000,              /* somebody looks at the database with another program */
    PRUNE_EVERY = 1000           /* events */
};

struct journal {
    char *path;
    sqlite3 *database;
    pthread_mutex_t lock; /* guards what follows, and the use of the database */
    journal_found_t found;
    unsigned events; /* since the history was pruned last */
};

static const char SCHEMA[] =
    "CREATE TABLE jobs (job INTEGER PRIMARY KEY, name TEXT NOT NULL, state TEXT NOT NULL, submitted REAL NOT "
    "NULL,"
    " finished REAL NOT NULL, record BLOB NOT NULL, hash BLOB NOT NULL);"
    "CREATE TABLE history (id INTEGER PRIMARY KEY, at TEXT NOT NULL DEFAULT (datetime('now')), job INTEGER "
    "NOT NULL,"
    " event TEXT NOT NULL, text TEXT NOT NULL);"
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value INTEGER NOT NULL);"
    "INSERT INTO meta VALUES ('next_job', 1), ('running', 0);";
static const char ERRORS_SCHEMA[] = "CREATE TABLE IF NOT EXISTS errors (job INTEGER NOT NULL, samples "
                                    "INTEGER NOT NULL, elapsed REAL NOT NULL,"
                                    " error REAL NOT NULL, PRIMARY KEY (job, samples)) WITHOUT ROWID;";

/* ---- SQLite -------------------------------------------------------------------------------------------- */

/* The last failure as a result. A full disk is named as what it is. */
static result_t failure(const journal_t *journal)
{
    int code = sqlite3_errcode(journal->database) & 0xff;
    bool of_system = code == SQLITE_IOERR || code == SQLITE_CANTOPEN || code == SQLITE_FULL;
    int system = of_system ? sqlite3_system_errno(journal->database) : 0;
    const char *why = sqlite3_errmsg(journal->database);
    bool full = code == SQLITE_FULL || system == ENOSPC || system == EDQUOT;
    if (full)
        return result_fail(RESULT_IO, "the journal %.300s cannot be written: the disk is full",
                           journal->path);
    return result_fail(RESULT_IO, "the journal %.300s cannot be used: %.150s%s%s", journal->path, why,
                       system != 0 ? ": " : "", system != 0 ? strerror(system) : "");
}

static result_t run(journal_t *journal, const char *sql)
{
    if (sqlite3_exec(journal->database, sql, NULL, NULL, NULL) == SQLITE_OK) return result_ok();
    return failure(journal);
}

static result_t prepare(journal_t *journal, const char *sql, sqlite3_stmt **statement)
{
    if (sqlite3_prepare_v2(journal->database, sql, -1, statement, NULL) == SQLITE_OK) return result_ok();
    return failure(journal);
}

/* Runs a statement that gives no rows, and finalizes it. */
static result_t finish(journal_t *journal, sqlite3_stmt *statement)
{
    int code = sqlite3_step(statement);
    result_t result = code == SQLITE_DONE || code == SQLITE_ROW ? result_ok() : failure(journal);
    sqlite3_finalize(statement);
    return result;
}

/* The first number of the first row; when there is no row it stays as it was. */
static result_t number(journal_t *journal, const char *sql, int64_t *value)
{
    sqlite3_stmt *statement;
    TRY(prepare(journal, sql, &statement));
    int code = sqlite3_step(statement);
    if (code == SQLITE_ROW) *value = sqlite3_column_int64(statement, 0);
    result_t result = code == SQLITE_ROW || code == SQLITE_DONE ? result_ok() : failure(journal);
    sqlite3_finalize(statement);
    return result;
}

static result_t begin(journal_t *journal)
{
    return run(journal, "BEGIN IMMEDIATE");
}

/* Ends what was begun: all of it is done and safe, or, when it had failed or fails now, nothing. */
static result_t end(journal_t *journal, result_t result)
{
    if (result.code == RESULT_OK) result = run(journal, "COMMIT");
    if (result.code != RESULT_OK && !sqlite3_get_autocommit(journal->database)) run(journal, "ROLLBACK");
    return result;
}

/* ---- records ------------------------------------------------------------------------------------------- */

static result_t set_meta(journal_t *journal, const char *key, int64_t value)
{
    sqlite3_stmt *statement;
    TRY(prepare(journal, "UPDATE meta SET value = ?2 WHERE key = ?1", &statement));
    sqlite3_bind_text(statement, 1, key, -1, SQLITE_STATIC);
    sqlite3_bind_int64(statement, 2, value);
    return finish(journal, statement);
}

static result_t add_event(journal_t *journal, uint64_t job, const char *event, const char *text)
{
    sqlite3_stmt *statement;
    TRY(prepare(journal, "INSERT INTO history (job, event, text) VALUES (?1, ?2, ?3)", &statement));
    sqlite3_bind_int64(statement, 1, (int64_t)job);
    sqlite3_bind_text(statement, 2, event, -1, SQLITE_STATIC);
    sqlite3_bind_text(statement, 3, text, -1, SQLITE_STATIC);
    TRY(finish(journal, statement));
    if (++journal->events < PRUNE_EVERY) return result_ok();
    journal->events = 0;
    char sql[120];
    snprintf(sql, sizeof sql, "DELETE FROM history WHERE id <= (SELECT max(id) FROM history) - %d",
             JOURNAL_MAX_HISTORY);
    return run(journal, sql);
}

/* Adds a change of state to the history. */
static result_t note_state(journal_t *journal, const job_record_t *record)
{
    char before[20] = "", sql[80];
    const char *now = job_state_name((uint32_t)record->state);
    sqlite3_stmt *statement;
    snprintf(sql, sizeof sql, "SELECT state FROM jobs WHERE job = %lld", (long long)record->job);
    TRY(prepare(journal, sql, &statement));
    if (sqlite3_step(statement) == SQLITE_ROW)
        snprintf(before, sizeof before, "%s", (const char *)sqlite3_column_text(statement, 0));
    sqlite3_finalize(statement);
    return strcmp(before, now) == 0 ? result_ok() : add_event(journal, record->job, now, record->message);
}

static result_t put_record(journal_t *journal, const job_record_t *record)
{
    sqlite3_stmt *statement;
    TRY(note_state(journal, record));
    TRY(prepare(journal, "INSERT OR REPLACE INTO jobs VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)", &statement));
    size_t size;
    uint8_t *bytes = record_pack(record, &size);
    hash_t hash = hash_bytes(bytes, size);
    sqlite3_bind_int64(statement, 1, (int64_t)record->job);
    sqlite3_bind_text(statement, 2, record->terms.name, -1, SQLITE_STATIC);
    sqlite3_bind_text(statement, 3, job_state_name((uint32_t)record->state), -1, SQLITE_STATIC);
    sqlite3_bind_double(statement, 4, record->submitted);
    sqlite3_bind_double(statement, 5, record->finished);
    sqlite3_bind_blob(statement, 6, bytes, (int)size, SQLITE_STATIC);
    sqlite3_bind_blob(statement, 7, hash.bytes, HASH_BYTES, SQLITE_STATIC);
    result_t result = finish(journal, statement);
    free(bytes);
    return result;
}

/* Makes the table of errors, and drops what it has of a job. */
static result_t clear_errors(journal_t *journal, uint64_t job)
{
    char sql[80];
    TRY(run(journal, ERRORS_SCHEMA));
    snprintf(sql, sizeof sql, "DELETE FROM errors WHERE job = %lld", (long long)job);
    return run(journal, sql);
}

static result_t put_errors(journal_t *journal, uint64_t job, const error_history_t *errors)
{
    sqlite3_stmt *statement;
    TRY(clear_errors(journal, job));
    TRY(prepare(journal, "INSERT INTO errors (job, samples, elapsed, error) VALUES (?1, ?2, ?3, ?4)",
                &statement));
    int code = SQLITE_DONE;
    for (size_t i = 0; i < errors->count && code == SQLITE_DONE; i++) {
        sqlite3_bind_int64(statement, 1, (int64_t)job);
        sqlite3_bind_int64(statement, 2, (int64_t)errors->points[i].samples);
        sqlite3_bind_double(statement, 3, errors->points[i].elapsed);
        sqlite3_bind_double(statement, 4, errors->points[i].error);
        code = sqlite3_step(statement);
        sqlite3_reset(statement);
    }
    result_t result = code == SQLITE_DONE ? result_ok() : failure(journal);
    sqlite3_finalize(statement);
    return result;
}

static result_t remove_record(journal_t *journal, const job_record_t *record)
{
    char sql[80];
    snprintf(sql, sizeof sql, "DELETE FROM jobs WHERE job = %lld", (long long)record->job);
    TRY(run(journal, sql));
    TRY(clear_errors(journal, record->job));
    return add_event(journal, record->job, "removed", "");
}

/* *next becomes the number that a job after these may have. */
static result_t save_records(journal_t *journal, const job_record_t *records, size_t count, uint64_t *next)
{
    *next = journal->found.next_job;
    for (size_t i = 0; i < count; i++) {
        TRY(records[i].removed ? remove_record(journal, &records[i]) : put_record(journal, &records[i]));
        if (records[i].job >= *next) *next = records[i].job + 1;
    }
    return *next > journal->found.next_job ? set_meta(journal, "next_job", (int64_t)*next) : result_ok();
}

result_t journal_save(journal_t *journal, const job_record_t *records, size_t count)
{
    uint64_t next;
    if (count == 0) return result_ok();
    pthread_mutex_lock(&journal->lock);
    result_t result = begin(journal);
    if (result.code == RESULT_OK) result = end(journal, save_records(journal, records, count, &next));
    if (result.code == RESULT_OK) journal->found.next_job = next;
    pthread_mutex_unlock(&journal->lock);
    return result;
}

result_t journal_save_errors(journal_t *journal, uint64_t job, const error_history_t *errors)
{
    pthread_mutex_lock(&journal->lock);
    result_t result = begin(journal);
    if (result.code == RESULT_OK) result = end(journal, put_errors(journal, job, errors));
    pthread_mutex_unlock(&journal->lock);
    return result;
}

result_t journal_note(journal_t *journal, uint64_t job, const char *event, const char *text)
{
    pthread_mutex_lock(&journal->lock);
    result_t result = begin(journal);
    if (result.code == RESULT_OK) result = end(journal, add_event(journal, job, event, text));
    pthread_mutex_unlock(&journal->lock);
    return result;
}

/* ---- opening ------------------------------------------------------------------------------------------- */

/* True when the last failure was the database's own, not the system's: what is in it is wrong, or is missing.
 */
static bool is_damage(const journal_t *journal)
{
    int code = sqlite3_errcode(journal->database) & 0xff;
    return code == SQLITE_CORRUPT || code == SQLITE_NOTADB || code == SQLITE_ERROR;
}

/* One row of the table of jobs; RESULT_INPUT when it is not as it was written. */
static result_t read_row(sqlite3_stmt *statement, job_record_t *record)
{
    const void *bytes = sqlite3_column_blob(statement, 0), *wanted = sqlite3_column_blob(statement, 1);
    int size = sqlite3_column_bytes(statement, 0);
    if (bytes == NULL || wanted == NULL || sqlite3_column_bytes(statement, 1) != HASH_BYTES)
        return result_fail(RESULT_INPUT, "a record is empty");
    hash_t hash = hash_bytes(bytes, (size_t)size);
    if (memcmp(hash.bytes, wanted, HASH_BYTES) != 0)
        return result_fail(RESULT_INPUT, "the checksum of a record is wrong");
    return record_unpack(bytes, (size_t)size, record);
}

/* Reads the records that are whole; *whole becomes false unless all were. */
static result_t read_records(journal_t *journal, bool *whole)
{
    sqlite3_stmt *statement;
    journal_found_t *found = &journal->found;
    TRY(prepare(journal, "SELECT record, hash FROM jobs ORDER BY job", &statement));
    int code;
    while ((code = sqlite3_step(statement)) == SQLITE_ROW) {
        job_record_t record;
        result_t result = read_row(statement, &record);
        if (result.code != RESULT_OK) {
            log_error("the journal: %s", result.message);
            *whole = false;
            continue;
        }
        found->records = mem_realloc(found->records, (found->record_count + 1) * sizeof record);
        found->records[found->record_count++] = record;
    }
    result_t result = code == SQLITE_DONE ? result_ok() : failure(journal);
    sqlite3_finalize(statement);
    return result;
}

/* Reads what is known of a record's errors; rows that make no sense are left out. */
static void read_errors_of(sqlite3_stmt *statement, uint64_t job, error_history_t *errors)
{
    sqlite3_bind_int64(statement, 1, (int64_t)job);
    while (sqlite3_step(statement) == SQLITE_ROW) {
        error_point_t point = {.samples = (uint64_t)sqlite3_column_int64(statement, 0),
                               .elapsed = sqlite3_column_double(statement, 1),
                               .error = sqlite3_column_double(statement, 2)};
        if (sqlite3_column_int64(statement, 0) > 0 && error_point_valid(&point))
            error_history_add(errors, &point);
    }
    sqlite3_reset(statement);
}

/* Reads the errors of the records that were found. That some cannot be read is no reason to do without the
 * rest. */
static void read_errors(journal_t *journal)
{
    journal_found_t *found = &journal->found;
    sqlite3_stmt *statement;
    int64_t tables = 0;
    free(found->errors);
    found->errors = mem_zalloc(found->record_count + 1, sizeof *found->errors);
    (void)number(journal, "SELECT count(*) FROM sqlite_master WHERE name = 'errors'", &tables);
    if (tables == 0) return;
    result_t result = prepare(
        journal, "SELECT samples, elapsed, error FROM errors WHERE job = ?1 ORDER BY samples", &statement);
    if (result.code != RESULT_OK) {
        log_error("%s; the history of errors is not read", result.message);
        return;
    }
    for (size_t i = 0; i < found->record_count; i++)
        read_errors_of(statement, found->records[i].job, &found->errors[i]);
    sqlite3_finalize(statement);
}

/* *good becomes false when SQLite finds the database's structure damaged. */
static result_t check_structure(journal_t *journal, bool *good)
{
    sqlite3_stmt *statement;
    TRY(prepare(journal, "PRAGMA integrity_check(1)", &statement));
    int code = sqlite3_step(statement);
    if (code == SQLITE_ROW && strcmp((const char *)sqlite3_column_text(statement, 0), "ok") != 0)
        *good = false;
    result_t result = code == SQLITE_ROW ? result_ok() : failure(journal);
    sqlite3_finalize(statement);
    return result;
}

static void close_database(journal_t *journal)
{
    sqlite3_close(journal->database);
    journal->database = NULL;
}

static result_t open_database(journal_t *journal, bool fleeting)
{
    const char *path = fleeting ? ":memory:" : journal->path;
    int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX;
    if (sqlite3_open_v2(path, &journal->database, flags, NULL) != SQLITE_OK) return failure(journal);
    sqlite3_busy_timeout(journal->database, BUSY_MS);
    int stay = 1; /* the files of the log, emptied, so that it can be opened on a full disk, too */
    sqlite3_file_control(journal->database, "main", SQLITE_FCNTL_PERSIST_WAL, &stay);
    TRY(run(journal, "PRAGMA journal_mode = WAL"));
    TRY(run(journal, "PRAGMA journal_size_limit = 1048576"));
    return run(journal, "PRAGMA synchronous = FULL; PRAGMA trusted_schema = OFF");
}

static result_t make_tables(journal_t *journal)
{
    char sql[100];
    TRY(run(journal, SCHEMA));
    snprintf(sql, sizeof sql, "PRAGMA application_id = %d; PRAGMA user_version = %d", APPLICATION_ID,
             JOURNAL_VERSION);
    return run(journal, sql);
}

static result_t make_schema(journal_t *journal)
{
    TRY(begin(journal));
    return end(journal, make_tables(journal));
}

/* Checks the tables and reads what is in them; *whole becomes false when something is damaged. */
static result_t read_tables(journal_t *journal, bool *whole)
{
    journal_found_t *found = &journal->found;
    int64_t next = 0, running = 0;
    TRY(check_structure(journal, whole));
    TRY(read_records(journal, whole));
    read_errors(journal);
    TRY(number(journal, "SELECT value FROM meta WHERE key = 'next_job'", &next));
    TRY(number(journal, "SELECT value FROM meta WHERE key = 'running'", &running));
    found->next_job = next > 0 ? (uint64_t)next : 0;
    for (size_t i = 0; i < found->record_count; i++)
        if (found->next_job <= found->records[i].job) *whole = false;
    found->crashed = running != 0;
    *whole = *whole && next > 0;
    return result_ok();
}

/* The database is open: checks it, or makes its tables. */
static result_t examine(journal_t *journal, bool *whole)
{
    int64_t version = 0, tables = 0;
    TRY(number(journal, "PRAGMA user_version", &version));
    TRY(number(journal, "SELECT count(*) FROM sqlite_master", &tables));
    if (version > JOURNAL_VERSION)
        return result_fail(RESULT_INPUT,
                           "the journal %.300s is of version %lld, made by a later Lightmill; this one "
                           "reads version %d",
                           journal->path, (long long)version, JOURNAL_VERSION);
    journal->found.fresh = version == 0 && tables == 0;
    return journal->found.fresh ? make_schema(journal) : read_tables(journal, whole);
}

/* Gives the damaged database, with its log, another name. */
static result_t set_aside(journal_t *journal)
{
    static const char *const suffixes[] = {"", "-wal", "-shm"};
    char stamp[40];
    time_t now = time(NULL);
    struct tm local;
    localtime_r(&now, &local);
    strftime(stamp, sizeof stamp, "%Y%m%d-%H%M%S", &local);
    result_t result = result_ok();
    for (size_t i = 0; i < ARRAY_LENGTH(suffixes); i++) {
        char *from = mem_printf("%s%s", journal->path, suffixes[i]);
        char *to = mem_printf("%s.damaged-%s%s", journal->path, stamp, suffixes[i]);
        if (rename(from, to) != 0 && errno != ENOENT)
            result = result_fail(RESULT_IO, "cannot set the damaged journal %.300s aside: %s", from,
                                 strerror(errno));
        free(from);
        free(to);
    }
    if (result.code == RESULT_OK)
        log_error("THE JOURNAL IS DAMAGED: %s is set aside as %s.damaged-%s; %zu jobs could be read from it, "
                  "others come back from their films; jobs that had no checkpoint yet and could not be read "
                  "are lost",
                  journal->path, journal->path, stamp, journal->found.record_count);
    return result;
}

/* Begins anew with the records that could be read. */
static result_t rebuild(journal_t *journal)
{
    journal_found_t *found = &journal->found;
    uint64_t next = found->next_job + JOURNAL_SKIPPED_NUMBERS;
    bool whole;
    if (found->record_count == 0)
        (void)read_records(journal, &whole); /* the check may have ended before them */
    read_errors(journal);
    close_database(journal);
    TRY(set_aside(journal));
    TRY(open_database(journal, false));
    TRY(make_schema(journal));
    found->damaged = true;
    found->fresh = false;
    for (size_t i = 0; i < found->record_count; i++)
        if (next <= found->records[i].job) next = found->records[i].job + JOURNAL_SKIPPED_NUMBERS;
    found->next_job = next;
    TRY(set_meta(journal, "next_job", (int64_t)next));
    TRY(journal_save(journal, found->records, found->record_count));
    for (size_t i = 0; i < found->record_count; i++)
        if (found->errors[i].count > 0)
            TRY(journal_save_errors(journal, found->records[i].job, &found->errors[i]));
    return journal_note(journal, 0, "journal damaged", "it was set aside and rebuilt");
}

static result_t open_all(journal_t *journal, bool fleeting)
{
    bool whole = true;
    result_t result = open_database(journal, fleeting);
    if (result.code == RESULT_OK) result = examine(journal, &whole);
    if (!whole || (result.code == RESULT_IO && is_damage(journal))) result = rebuild(journal);
    TRY(result);
    if (journal->found.next_job == 0) journal->found.next_job = 1;
    result = set_meta(journal, "running", 1);
    if (result.code != RESULT_OK) log_error("%s; it is read for now", result.message);
    return result_ok();
}

static void free_journal(journal_t *journal)
{
    close_database(journal);
    journal_forget_found(journal);
    pthread_mutex_destroy(&journal->lock);
    free(journal->path);
    free(journal);
}

result_t journal_open(const char *path, bool fleeting, journal_t **out)
{
    journal_t *journal = mem_zalloc(1, sizeof *journal);
    journal->path = mem_strdup(path);
    pthread_mutex_init(&journal->lock, NULL);
    result_t result = open_all(journal, fleeting);
    *out = result.code == RESULT_OK ? journal : NULL;
    if (*out == NULL) free_journal(journal);
    return result;
}

void journal_close(journal_t **out)
{
    journal_t *journal = *out;
    if (journal == NULL) return;
    result_t result = set_meta(journal, "running", 0);
    if (result.code != RESULT_OK) log_warning("%s", result.message);
    free_journal(journal);
    *out = NULL;
}

const journal_found_t *journal_found(const journal_t *journal)
{
    return &journal->found;
}

void journal_forget_found(journal_t *journal)
{
    free(journal->found.records);
    free(journal->found.errors);
    journal->found.records = NULL;
    journal->found.errors = NULL;
    journal->found.record_count = 0;
}
