/* progress: see progress.h.
 *
 * DESIGN. Everything goes to stderr, so that stdout stays for results (a job's number, JSON). The master
 * counts a sample when its batch is merged, so the bar moves in steps of the batch interval; the rate is the
 * mean since the first assignment, which does not jump with them.
 */
#include "client/text/progress.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { BAR_CELLS = 28 };
static const double PLAIN_INTERVAL = 5.0; /* seconds between plain lines */

progress_t progress_start(bool quiet)
{
    return (progress_t){.quiet = quiet, .terminal = isatty(STDERR_FILENO) == 1, .last = clock_now()};
}

void format_duration(double seconds, char text[32])
{
    if (!(seconds >= 0))
        snprintf(text, 32, "?");
    else if (seconds < 10)
        snprintf(text, 32, "%.1f s", seconds);
    else if (seconds < 3600)
        snprintf(text, 32, "%d:%02d", (int)seconds / 60, (int)seconds % 60);
    else if (seconds < 1e8)
        snprintf(text, 32, "%d:%02d:%02d", (int)seconds / 3600, (int)seconds / 60 % 60, (int)seconds % 60);
    else
        snprintf(text, 32, "years");
}

void format_count(double count, char text[32])
{
    if (count < 1e4)
        snprintf(text, 32, "%.0f", count);
    else if (count < 1e6)
        snprintf(text, 32, "%.0f k", 1e-3 * count);
    else if (count < 1e9)
        snprintf(text, 32, "%.2f M", 1e-6 * count);
    else
        snprintf(text, 32, "%.2f G", 1e-9 * count);
}

double job_fraction(const Lm__JobStatus *status)
{
    /* An adaptive job may be done with fewer samples than it could have taken, and one that has all of them
     * is not done before its image is written. */
    static const double ALMOST = 0.9999;
    double done = 0;
    if (status->state == JOB_DONE) return 1;
    if (status->samples_total > 0) done = (double)status->samples_done / (double)status->samples_total;
    double limit = status->settings ? status->settings->time_limit : 0;
    if (limit > 0) done = fmax(done, status->elapsed / limit);
    /* The error falls with the square root of the samples. */
    double error = status->settings ? status->settings->error : 0;
    if (error > 0 && status->error > 0) done = fmax(done, pow(error / status->error, 2));
    return fmin(fmax(done, 0), ALMOST);
}

/* "  error 2.1% of 1%" of a job that is to reach one, or nothing. */
static void describe_error(const Lm__JobStatus *status, char text[48])
{
    text[0] = '\0';
    if (status->settings && status->settings->error > 0 && status->error > 0)
        snprintf(text, 48, "error %.2g%% (to be %.2g%%)  ", 100 * status->error,
                 100 * status->settings->error);
}

/* "  45%  210 k samples/s  2 workers  ETA 0:42" */
static void describe(const Lm__JobStatus *status, char *text, size_t size)
{
    char rate[32], eta[32], error[48];
    describe_error(status, error);
    double speed = status->elapsed > 0 ? (double)status->samples_done / status->elapsed : 0;
    format_count(speed, rate);
    format_duration(status->remaining, eta);
    bool counting = status->samples_done > 0;
    snprintf(text, size, "%3.0f%%  %s samples/s  %u worker%s  %s%s%s", floor(100 * job_fraction(status)),
             counting ? rate : "-", status->workers, status->workers == 1 ? "" : "s", error,
             status->state == JOB_RUNNING ? "ETA " : "",
             status->state == JOB_RUNNING ? eta : job_state_name(status->state));
}

static void draw_bar(progress_t *progress, double fraction, const char *text)
{
    char bar[BAR_CELLS + 1];
    int full = (int)(fraction * BAR_CELLS + 0.5);
    for (int i = 0; i < BAR_CELLS; i++) bar[i] = i < full ? '#' : '-';
    bar[BAR_CELLS] = '\0';
    fprintf(stderr, "\r[%s] %s\033[K", bar, text);
    progress->drawn = true;
}

static bool plain_line_due(progress_t *progress)
{
    double now = clock_now();
    if (now - progress->last < PLAIN_INTERVAL) return false;
    progress->last = now;
    return true;
}

/* As a bar on a terminal, else as a line now and then. */
static void show(progress_t *progress, double fraction, const char *text)
{
    if (progress->terminal)
        draw_bar(progress, fraction, text);
    else if (plain_line_due(progress))
        fprintf(stderr, "%s\n", text);
}

void progress_job(progress_t *progress, const Lm__JobStatus *status)
{
    if (progress->quiet) return;
    char text[240];
    describe(status, text, sizeof text);
    show(progress, job_fraction(status), text);
}

void progress_series(progress_t *progress, const progress_series_t *series)
{
    if (progress->quiet) return;
    char text[160], rate[32], eta[32];
    double done = series->samples_total > 0 ? fmin(series->samples_done / series->samples_total, 1) : 0;
    format_count(series->elapsed > 0 ? series->samples_done / series->elapsed : 0, rate);
    format_duration(done > 0 ? series->elapsed * (1 - done) / done : -1, eta);
    snprintf(text, sizeof text, "%3.0f%%  %s samples/s  %zu of %zu images  ETA %s", floor(100 * done),
             done > 0 ? rate : "-", series->images_done, series->images_total, eta);
    show(progress, done, text);
}

static void show_bytes(progress_t *progress, const char *what, uint64_t done, uint64_t size)
{
    if (progress->quiet || size == 0) return;
    char text[80];
    snprintf(text, sizeof text, "%s: %.1f of %.1f MB", what, 1e-6 * (double)done, 1e-6 * (double)size);
    show(progress, (double)done / (double)size, text);
}

void progress_upload(progress_t *progress, uint64_t done, uint64_t size)
{
    show_bytes(progress, "uploading the scene", done, size);
}

void progress_making(progress_t *progress, uint32_t before, double share)
{
    if (progress->quiet) return;
    char text[100];
    if (before > 0)
        snprintf(text, sizeof text, "the master makes %u other image%s before", before,
                 before == 1 ? "" : "s");
    else
        snprintf(text, sizeof text, "the master is writing the image: %.0f %%", floor(100 * share));
    show(progress, share, text);
}

void progress_fetch(progress_t *progress, uint64_t done, uint64_t size)
{
    show_bytes(progress, "fetching the image", done, size);
}

void progress_import(progress_t *progress, double fraction)
{
    static const double first = 1.0, interval = 0.1; /* seconds */
    double now = clock_now();
    if (progress->quiet || !progress->terminal) return;
    if (now - progress->last < (progress->drawn ? interval : first)) return;
    progress->last = now;
    fprintf(stderr, "\rimporting the scene: %.0f %%\033[K", floor(100 * fraction));
    progress->drawn = true;
}

void progress_erase(progress_t *progress)
{
    if (progress->drawn) fputs("\r\033[K", stderr);
    progress->drawn = false;
}

void progress_end(progress_t *progress)
{
    if (progress->drawn) fputc('\n', stderr);
    progress->drawn = false;
}
