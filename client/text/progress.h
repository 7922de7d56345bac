/* progress: how far a job is, for people: one line redrawn on a terminal, plain lines now and then otherwise.
 */
#ifndef LIGHTMILL_PROGRESS_H
#define LIGHTMILL_PROGRESS_H

#include "proto/wire/wire.h"

typedef struct {
    bool quiet;
    bool terminal; /* stderr is one */
    bool drawn;    /* a line is on the terminal that is not ended yet */
    double last;   /* clock of the last plain line */
} progress_t;

progress_t progress_start(bool quiet);
/* Shows a status; call a few times a second. */
void progress_job(progress_t *progress, const Lm__JobStatus *status);
/* Several jobs that make one thing. */
typedef struct {
    double samples_done, samples_total; /* pixel samples of all jobs */
    double elapsed;                     /* seconds */
    size_t images_done, images_total;
} progress_series_t;
/* Shows how far they are; call a few times a second. */
void progress_series(progress_t *progress, const progress_series_t *series);
/* Shows an upload. */
void progress_upload(progress_t *progress, uint64_t done, uint64_t size);
/* Shows how far a master is with an image that it makes: how many others it makes before, and the share of
 * this one that is made, 0 to 1. */
void progress_making(progress_t *progress, uint32_t before, double share);
/* Shows how many bytes of how many of an image are here. */
void progress_fetch(progress_t *progress, uint64_t done, uint64_t size);
/* Shows how far a scene has been read, on a terminal and after the first second. May be called often. */
void progress_import(progress_t *progress, double fraction);
/* Takes the line from the terminal. */
void progress_erase(progress_t *progress);
/* Ends the line on a terminal. */
void progress_end(progress_t *progress);

/* "1:02:03" or "4:05" or "6.7 s" into text[32]. */
void format_duration(double seconds, char text[32]);
/* "12.3 M" and the like into text[32]. */
void format_count(double count, char text[32]);
/* The share of a job that is done, 0 to 1; 1 when it is done, and not before. */
double job_fraction(const Lm__JobStatus *status);

#endif
