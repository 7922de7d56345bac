/* report: what a run says, on its standard output and in FOLDER/chaos.log, with the seconds since it began.
 */
#ifndef LIGHTMILL_CHAOS_REPORT_H
#define LIGHTMILL_CHAOS_REPORT_H

#include <stddef.h>
#include <stdio.h>

typedef struct {
    FILE *log;
    double began; /* clock_now() */
    size_t violations;
} report_t;

report_t report_open(const char *folder);
void report_close(report_t *report);
void report_line(report_t *report, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* Something that must never happen. */
void report_violation(report_t *report, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* Without the time: of tables. */
void report_text(report_t *report, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
