/* report: where in a file something is, and what is said about it.
 *
 * An error ends the import and travels as a result_t; a warning goes to the caller's sink (or the log) and
 * the import goes on. After REPORT_MAX_WARNINGS lines the rest is only counted, and the count is told at the
 * end.
 */
#ifndef LIGHTMILL_REPORT_H
#define LIGHTMILL_REPORT_H

#include "client/import/scene/wishes.h"
#include "common/base.h"

/* Where warnings go: `warn` gets one line for people, "file:line:column: text", valid during the call.
 * `progress` (may be NULL) is told the share of the bytes known so far that has been read, 0 to 1: a file
 * names others, so it may fall. It is called every 64 KiB or so. */
typedef struct {
    void (*warn)(void *context, const char *message);
    void *context;
    bool lenient; /* what is not supported gets its nearest substitute and a warning instead of an error */
    bool strict;  /* a slip that the scene's own program forgives is an error instead of a warning */
    void (*progress)(void *context, double fraction);
    const import_wishes_t
        *wishes; /* NULL: none; its own `lenient` and `strict` are for whoever fills this in */
} import_report_t;

enum { REPORT_MAX_WARNINGS = 100 };

/* A place in a text file, counted from 1; column counts bytes. `path` is owned by whoever read the file and
 * lives as long as the import. Line 0 is the file as a whole. */
typedef struct {
    const char *path;
    uint32_t line, column;
} position_t;

typedef struct {
    import_report_t sink;
    uint64_t warnings;
    bool quiet; /* what warns now has warned before */
} report_t;

report_t report_begin(const import_report_t *sink);
/* Tells how many warnings were not written out, if any. */
void report_end(report_t *report);

/* "path:line:column: text" to the sink. */
void report_warning(report_t *report, position_t at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* A RESULT_INPUT result "path:line:column: text". */
result_t error_at(position_t at, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* About something that Lightmill does not do, but has a substitute for: an error like error_at, or, when the
 * import is lenient, a warning and RESULT_OK. */
result_t report_refuse(report_t *report, position_t at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* About a failure that has a substitute: itself, or, when it is RESULT_INPUT and the import is lenient,
 * RESULT_OK and a warning of its message and of `substitute`, what is done instead. NULL: nothing can be
 * done. */
result_t report_excuse(report_t *report, result_t failure, const char *substitute);

/* About a slip in the file that the program which it was written for forgives: a warning, which says what
 * that program does, and RESULT_OK; or, when the import is strict, an error like error_at. */
result_t report_tolerate(report_t *report, position_t at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Tells how far the import is: see import_report_t. */
void report_progress(const report_t *report, double fraction);

/* Makes room for `need` records of `size` bytes in an array that holds *capacity of them, doubling it;
 * returns the array, which may have moved. */
void *grow(void *array, size_t *capacity, size_t need, size_t size);

#endif
