/* The journal: what was saved is there again; a number is never given twice; damage is found, set aside, and
 * costs no more than it must; a disk that refuses is an error and not the end. */
#include "master/store/journal.h"
#include "tests/scratch.h"

#include <dirent.h>
#include <setjmp.h>
#include <signal.h>
#include <sqlite3.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

typedef struct {
    char *folder, *path;
    journal_t *journal;
} fixture_t;

static int set_up(void **state)
{
    fixture_t *fixture = mem_zalloc(1, sizeof *fixture);
    fixture->folder = scratch_new();
    fixture->path = scratch_path(fixture->folder, "lightmill.db");
    must(journal_open(fixture->path, false, &fixture->journal));
    *state = fixture;
    return 0;
}

static int tear_down(void **state)
{
    fixture_t *fixture = *state;
    journal_close(&fixture->journal);
    scratch_destroy(&fixture->folder);
    free(fixture->path);
    free(fixture);
    return 0;
}

/* Ends the journal and begins it again, and returns what it finds. */
static const journal_found_t *reopen(fixture_t *fixture)
{
    journal_close(&fixture->journal);
    must(journal_open(fixture->path, false, &fixture->journal));
    return journal_found(fixture->journal);
}

static job_record_t record_of(uint64_t job)
{
    job_record_t record = {.job = job,
                           .settings = job_settings_default(),
                           .blob = hash_bytes(&job, sizeof job),
                           .blob_size = 100 + job,
                           .state = JOB_QUEUED,
                           .submitted = 1.7e9};
    snprintf(record.terms.name, sizeof record.terms.name, "scene %llu", (unsigned long long)job);
    return record;
}

static void save_one(fixture_t *fixture, uint64_t job)
{
    job_record_t record = record_of(job);
    must(journal_save(fixture->journal, &record, 1));
}

/* The first number that a query gives, asked on a connection of its own. */
static int64_t ask(const fixture_t *fixture, const char *sql)
{
    sqlite3 *database;
    sqlite3_stmt *statement;
    assert_int_equal(sqlite3_open(fixture->path, &database), SQLITE_OK);
    assert_int_equal(sqlite3_prepare_v2(database, sql, -1, &statement, NULL), SQLITE_OK);
    assert_int_equal(sqlite3_step(statement), SQLITE_ROW);
    int64_t value = sqlite3_column_int64(statement, 0);
    sqlite3_finalize(statement);
    sqlite3_close(database);
    return value;
}

static void change(const fixture_t *fixture, const char *sql)
{
    sqlite3 *database;
    assert_int_equal(sqlite3_open(fixture->path, &database), SQLITE_OK);
    assert_int_equal(sqlite3_exec(database, sql, NULL, NULL, NULL), SQLITE_OK);
    sqlite3_close(database);
}

static bool has_file(const char *folder, const char *part)
{
    bool found = false;
    DIR *directory = opendir(folder);
    for (const struct dirent *entry; (entry = readdir(directory)) != NULL;)
        found = found || strstr(entry->d_name, part) != NULL;
    closedir(directory);
    return found;
}

/* ---- saving -------------------------------------------------------------------------------------------- */

static void what_is_saved_is_there_again(void **state)
{
    fixture_t *fixture = *state;
    assert_true(journal_found(fixture->journal)->fresh);
    job_record_t records[3] = {record_of(1), record_of(2), record_of(3)};
    must(journal_save(fixture->journal, records, 3));
    records[1].state = JOB_RUNNING;
    records[1].elapsed = 17;
    records[1].account.issued = 99;
    snprintf(records[1].message, sizeof records[1].message, "a note");
    must(journal_save(fixture->journal, &records[1], 1));
    records[2].removed = true;
    must(journal_save(fixture->journal, &records[2], 1));
    const journal_found_t *found = reopen(fixture);
    assert_true(!found->fresh && !found->damaged && !found->crashed);
    assert_int_equal(found->record_count, 2);
    assert_true(found->records[0].job == 1 && found->records[1].job == 2);
    assert_true(found->records[1].state == JOB_RUNNING && found->records[1].elapsed == 17);
    assert_true(found->records[1].account.issued == 99);
    assert_string_equal(found->records[1].message, "a note");
    assert_string_equal(found->records[0].terms.name, "scene 1");
    assert_memory_equal(&found->records[0].settings, &records[0].settings, sizeof records[0].settings);
}

static void save_errors(fixture_t *fixture, uint64_t job, uint64_t points)
{
    error_history_t errors = {0};
    for (uint64_t i = 1; i <= points; i++)
        error_history_add(&errors, &(error_point_t){1.5 * (double)i, (i << 40) + job, 1 / (double)i});
    must(journal_save_errors(fixture->journal, job, &errors));
}

static void assert_errors(const error_history_t *errors, uint64_t job, size_t count)
{
    assert_int_equal(errors->count, count);
    for (size_t i = 0; i < count; i++) {
        assert_true(errors->points[i].elapsed == 1.5 * (double)(i + 1));
        assert_true(errors->points[i].samples == ((uint64_t)(i + 1) << 40) + job);
        assert_true(errors->points[i].error == 1 / (double)(i + 1));
    }
}

static void errors_are_there_again_and_go_with_their_job(void **state)
{
    fixture_t *fixture = *state;
    job_record_t records[4] = {record_of(1), record_of(2), record_of(3), record_of(4)};
    must(journal_save(fixture->journal, records, 4));
    save_errors(fixture, 1, ERROR_HISTORY_POINTS);
    save_errors(fixture, 2, 7);
    save_errors(fixture, 2, 3); /* in the place of those before */
    save_errors(fixture, 4, 5);
    records[3].removed = true;
    must(journal_save(fixture->journal, &records[3], 1));
    const journal_found_t *found = reopen(fixture);
    assert_int_equal(found->record_count, 3);
    assert_errors(&found->errors[0], 1, ERROR_HISTORY_POINTS);
    assert_errors(&found->errors[1], 2, 3);
    assert_errors(&found->errors[2], 3, 0);
    assert_int_equal(ask(fixture, "SELECT count(*) FROM errors WHERE job = 4"), 0);
    /* What makes no sense is left out; what an earlier version made has none. */
    change(fixture, "UPDATE errors SET error = -1 WHERE job = 1 AND elapsed > 2");
    change(fixture, "UPDATE errors SET samples = -5, error = 'x' WHERE job = 2 AND elapsed > 4");
    found = reopen(fixture);
    assert_errors(&found->errors[0], 1, 1);
    assert_errors(&found->errors[1], 2, 2);
    change(fixture, "DROP TABLE errors");
    found = reopen(fixture);
    assert_int_equal(found->record_count, 3);
    assert_int_equal(found->errors[0].count, 0);
    must(journal_save(fixture->journal, &records[3], 1));
    save_errors(fixture, 1, 9);
    assert_errors(&reopen(fixture)->errors[0], 1, 9);
}

static void a_number_is_never_given_twice(void **state)
{
    fixture_t *fixture = *state;
    assert_true(journal_found(fixture->journal)->next_job == 1);
    save_one(fixture, 1);
    save_one(fixture, 2);
    job_record_t gone = {.job = 2, .removed = true};
    must(journal_save(fixture->journal, &gone, 1));
    assert_true(reopen(fixture)->next_job == 3);
    assert_int_equal(journal_found(fixture->journal)->record_count, 1);
    job_record_t any_order[] = {record_of(9), record_of(7), {.job = 9, .removed = true}};
    must(journal_save(fixture->journal, any_order, 3));
    assert_true(reopen(fixture)->next_job == 10);
}

static void it_keeps_a_history(void **state)
{
    fixture_t *fixture = *state;
    job_record_t record = record_of(1);
    must(journal_save(fixture->journal, &record, 1));
    must(journal_save(fixture->journal, &record, 1)); /* nothing new */
    record.state = JOB_RUNNING;
    must(journal_save(fixture->journal, &record, 1));
    must(journal_note(fixture->journal, 1, "checkpoint damaged", "it was"));
    assert_int_equal(ask(fixture, "SELECT count(*) FROM history WHERE job = 1"), 3);
    assert_int_equal(ask(fixture, "SELECT count(*) FROM history WHERE event = 'running'"), 1);
}

/* A process that is killed right after a call has returned loses nothing of it. */
static void it_survives_a_kill(void **state)
{
    fixture_t *fixture = *state;
    save_one(fixture, 1);
    journal_close(&fixture->journal);
    int ready[2];
    assert_int_equal(pipe(ready), 0);
    pid_t child = fork();
    if (child == 0) {
        journal_t *journal;
        job_record_t record = record_of(2);
        if (journal_open(fixture->path, false, &journal).code != RESULT_OK) _exit(1);
        if (journal_save(journal, &record, 1).code != RESULT_OK) _exit(2);
        (void)!write(ready[1], "", 1);
        pause();
    }
    char byte;
    assert_int_equal(read(ready[0], &byte, 1), 1);
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    close(ready[0]);
    close(ready[1]);
    must(journal_open(fixture->path, false, &fixture->journal));
    const journal_found_t *found = journal_found(fixture->journal);
    assert_true(found->crashed);
    assert_int_equal(found->record_count, 2);
    assert_true(found->next_job == 3);
}

/* ---- damage -------------------------------------------------------------------------------------------- */

static void damage(const fixture_t *fixture, size_t from, size_t count, uint8_t with)
{
    size_t size;
    uint8_t *bytes = scratch_read(fixture->path, &size);
    for (size_t i = from; i < size && i < from + count; i++) bytes[i] ^= with;
    scratch_write(fixture->path, bytes, size);
    free(bytes);
}

static void fill_journal(fixture_t *fixture, uint64_t jobs)
{
    for (uint64_t job = 1; job <= jobs; job++) save_one(fixture, job);
    journal_close(&fixture->journal);
}

static const journal_found_t *assert_set_aside(fixture_t *fixture)
{
    must(journal_open(fixture->path, false, &fixture->journal));
    assert_true(journal_found(fixture->journal)->damaged);
    assert_true(has_file(fixture->folder, "lightmill.db.damaged-"));
    return journal_found(fixture->journal);
}

static void a_file_of_garbage_is_set_aside(void **state)
{
    fixture_t *fixture = *state;
    fill_journal(fixture, 3);
    damage(fixture, 0, 1 << 20, 0x5a);
    const journal_found_t *found = assert_set_aside(fixture);
    assert_int_equal(found->record_count, 0);
    save_one(fixture, found->next_job);
    assert_int_equal(reopen(fixture)->record_count, 1);
    assert_false(journal_found(fixture->journal)->damaged);
}

static void a_short_file_is_set_aside(void **state)
{
    fixture_t *fixture = *state;
    fill_journal(fixture, 3);
    assert_int_equal(truncate(fixture->path, 5000), 0);
    assert_set_aside(fixture);
}

/* SQLite itself would not see it. */
static void a_flipped_bit_in_a_record_is_found(void **state)
{
    fixture_t *fixture = *state;
    save_one(fixture, 3);
    save_errors(fixture, 3, 4);
    fill_journal(fixture, 3);
    change(fixture,
           "UPDATE jobs SET record = substr(record, 1, 5) || x'ff' || substr(record, 7) WHERE job = 2");
    const journal_found_t *found = assert_set_aside(fixture);
    assert_int_equal(found->record_count, 2); /* the others are whole */
    assert_true(found->records[0].job == 1 && found->records[1].job == 3);
    assert_true(found->next_job > 3);
    assert_int_equal(reopen(fixture)->record_count, 2);
    assert_errors(&journal_found(fixture->journal)->errors[1], 3, 4); /* they are taken over */
}

static void a_missing_table_is_found(void **state)
{
    fixture_t *fixture = *state;
    fill_journal(fixture, 2);
    change(fixture, "DROP TABLE meta");
    assert_int_equal(assert_set_aside(fixture)->record_count, 2);
}

/* No byte of the file can be changed so that the journal does something else than read it right or set it
 * aside. */
static void no_damage_is_believed(void **state)
{
    fixture_t *fixture = *state;
    fill_journal(fixture, 4);
    size_t size;
    uint8_t *whole = scratch_read(fixture->path, &size);
    for (size_t at = 0; at < size; at += 97 + at / 16) {
        scratch_write(fixture->path, whole, size);
        damage(fixture, at, 1 + at % 40, 0xa5);
        result_t result = journal_open(fixture->path, false, &fixture->journal);
        if (result.code == RESULT_INPUT) continue; /* its version became a later one */
        must(result);
        const journal_found_t *found = journal_found(fixture->journal);
        for (size_t i = 0; i < found->record_count; i++) {
            job_record_t expected = record_of(found->records[i].job);
            assert_in_range(found->records[i].job, 1, 4);
            assert_true(hash_equal(&found->records[i].blob, &expected.blob));
        }
        assert_true(found->damaged || found->record_count == 4);
        assert_true(found->next_job >= 5 || found->damaged);
        journal_close(&fixture->journal);
    }
    free(whole);
}

static void a_later_version_is_left_alone(void **state)
{
    fixture_t *fixture = *state;
    fill_journal(fixture, 1);
    change(fixture, "PRAGMA user_version = 99");
    result_t result = journal_open(fixture->path, false, &fixture->journal);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "later"));
    assert_false(has_file(fixture->folder, "damaged"));
    assert_null(fixture->journal);
}

/* ---- disks that refuse --------------------------------------------------------------------------------- */

/* A limit on the size of files stands for a full disk. */
static void a_full_disk_is_an_error_and_passes(void **state)
{
    fixture_t *fixture = *state;
    save_one(fixture, 1);
    struct rlimit before, small;
    getrlimit(RLIMIT_FSIZE, &before);
    small = (struct rlimit){1000, before.rlim_max};
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    job_record_t record = record_of(2);
    result_t result = journal_save(fixture->journal, &record, 1);
    setrlimit(RLIMIT_FSIZE, &before);
    assert_int_equal(result.code, RESULT_IO);
    assert_non_null(strstr(result.message, fixture->path));
    must(journal_save(fixture->journal, &record, 1));
    assert_int_equal(reopen(fixture)->record_count, 2);
    assert_false(has_file(fixture->folder, "damaged"));
}

static void a_folder_that_is_not_ours_is_an_error(void **state)
{
    (void)state;
    journal_t *journal;
    result_t result = journal_open("/proc/lightmill.db", false, &journal);
    assert_int_equal(result.code, RESULT_IO);
    assert_null(journal);
}

static void a_fleeting_one_writes_nothing(void **state)
{
    (void)state;
    char *folder = scratch_new(), *path = scratch_path(folder, "lightmill.db");
    journal_t *journal;
    must(journal_open(path, true, &journal));
    job_record_t record = record_of(1);
    must(journal_save(journal, &record, 1));
    journal_close(&journal);
    assert_int_equal(scratch_count(folder), 0);
    free(path);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(what_is_saved_is_there_again, set_up, tear_down),
        cmocka_unit_test_setup_teardown(errors_are_there_again_and_go_with_their_job, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_number_is_never_given_twice, set_up, tear_down),
        cmocka_unit_test_setup_teardown(it_keeps_a_history, set_up, tear_down),
        cmocka_unit_test_setup_teardown(it_survives_a_kill, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_file_of_garbage_is_set_aside, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_short_file_is_set_aside, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_flipped_bit_in_a_record_is_found, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_missing_table_is_found, set_up, tear_down),
        cmocka_unit_test_setup_teardown(no_damage_is_believed, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_later_version_is_left_alone, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_full_disk_is_an_error_and_passes, set_up, tear_down),
        cmocka_unit_test(a_folder_that_is_not_ours_is_an_error),
        cmocka_unit_test(a_fleeting_one_writes_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
