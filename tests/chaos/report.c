/* report: see report.h. */
#include "tests/chaos/report.h"

#include "common/base.h"

#include <stdarg.h>
#include <stdlib.h>

report_t report_open(const char *folder)
{
    char *path = mem_printf("%s/chaos.log", folder);
    report_t report = {.log = fopen(path, "we"), .began = clock_now()};
    free(path);
    return report;
}

void report_close(report_t *report)
{
    if (report->log) fclose(report->log);
    report->log = NULL;
}

static void say(report_t *report, const char *before, const char *format, va_list arguments)
{
    char text[2000];
    vsnprintf(text, sizeof text, format, arguments);
    FILE *files[] = {stdout, report->log};
    for (int i = 0; i < 2; i++) {
        if (files[i] == NULL) continue;
        fprintf(files[i], "%s%s\n", before, text);
        fflush(files[i]);
    }
}

static void say_at(report_t *report, const char *before, const char *format, va_list arguments)
{
    char start[60];
    snprintf(start, sizeof start, "%8.2f  %s", clock_now() - report->began, before);
    say(report, start, format, arguments);
}

void report_line(report_t *report, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    say_at(report, "", format, arguments);
    va_end(arguments);
}

void report_violation(report_t *report, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    report->violations++;
    say_at(report, "VIOLATION: ", format, arguments);
    va_end(arguments);
}

void report_text(report_t *report, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    say(report, "", format, arguments);
    va_end(arguments);
}
