/* report: see report.h. */
#include "client/import/scene/report.h"

#include "common/plain_text.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { LONGEST_MESSAGE = 1000, LONGEST_PATH = 160 };

/* The end of a path that is too long to leave room for the message. */
static const char *tail_of(const char *path)
{
    size_t length = strlen(path);
    return length > LONGEST_PATH ? path + length - LONGEST_PATH : path;
}

static int format_position(char *text, size_t size, position_t at)
{
    const char *path = tail_of(at.path), *mark = path == at.path ? "" : "...";
    if (at.line == 0) return snprintf(text, size, "%s%s: ", mark, path);
    if (at.column == 0) return snprintf(text, size, "%s%s:%" PRIu32 ": ", mark, path, at.line);
    return snprintf(text, size, "%s%s:%" PRIu32 ":%" PRIu32 ": ", mark, path, at.line, at.column);
}

static void format_message(char text[LONGEST_MESSAGE], position_t at, const char *format, va_list arguments)
{
    int used = format_position(text, LONGEST_MESSAGE, at);
    if (used >= 0 && used < LONGEST_MESSAGE)
        vsnprintf(text + used, (size_t)(LONGEST_MESSAGE - used), format, arguments);
    plain_text_clean(text); /* a name in a scene may hold what a terminal would obey */
}

/* Counts a warning; true when it is one of those that are told. */
static bool is_told(report_t *report)
{
    return !report->quiet && ++report->warnings <= REPORT_MAX_WARNINGS;
}

static void say(const report_t *report, const char *message)
{
    if (report->sink.warn)
        report->sink.warn(report->sink.context, message);
    else
        log_warning("%s", message);
}

report_t report_begin(const import_report_t *sink)
{
    return (report_t){.sink = sink ? *sink : (import_report_t){0}};
}

void report_end(report_t *report)
{
    if (report->warnings <= REPORT_MAX_WARNINGS) return;
    char message[LONGEST_MESSAGE];
    snprintf(message, sizeof message, "%" PRIu64 " more warnings are not shown",
             report->warnings - REPORT_MAX_WARNINGS);
    say(report, message);
}

void report_warning(report_t *report, position_t at, const char *format, ...)
{
    if (!is_told(report)) return;
    char message[LONGEST_MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    format_message(message, at, format, arguments);
    va_end(arguments);
    say(report, message);
}

result_t error_at(position_t at, const char *format, ...)
{
    char message[LONGEST_MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    format_message(message, at, format, arguments);
    va_end(arguments);
    return result_fail(RESULT_INPUT, "%s", message);
}

/* An error, or a warning alone. */
static result_t settle(report_t *report, bool is_error, const char *message)
{
    if (is_error) return result_fail(RESULT_INPUT, "%s", message);
    if (is_told(report)) say(report, message);
    return result_ok();
}

result_t report_refuse(report_t *report, position_t at, const char *format, ...)
{
    char message[LONGEST_MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    format_message(message, at, format, arguments);
    va_end(arguments);
    return settle(report, !report->sink.lenient, message);
}

result_t report_tolerate(report_t *report, position_t at, const char *format, ...)
{
    char message[LONGEST_MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    format_message(message, at, format, arguments);
    va_end(arguments);
    return settle(report, report->sink.strict, message);
}

result_t report_excuse(report_t *report, result_t failure, const char *substitute)
{
    if (failure.code != RESULT_INPUT || !substitute || !report->sink.lenient) return failure;
    if (!is_told(report)) return result_ok();
    char message[LONGEST_MESSAGE];
    snprintf(message, sizeof message, "%s; %s", failure.message, substitute);
    say(report, message);
    return result_ok();
}

void report_progress(const report_t *report, double fraction)
{
    if (report->sink.progress) report->sink.progress(report->sink.context, fraction);
}

void *grow(void *array, size_t *capacity, size_t need, size_t size)
{
    if (need <= *capacity) return array;
    size_t larger = *capacity < 8 ? 8 : *capacity * 2;
    if (larger < need) larger = need;
    *capacity = larger;
    return mem_realloc(array, larger * size);
}
