/* The plot of a job's error: its text is what its points, target and line say, and what a master cannot have
 * meant is not drawn. */
#include "client/text/plot.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { SIDE = 100, MAX_POINTS = 64, MARGIN = 9 };

typedef struct {
    Lm__JobStatus status;
    Lm__Settings settings;
    Lm__ErrorPoint points[MAX_POINTS], *list[MAX_POINTS];
} job_t;

/* A job of 100 x 100 pixels whose error falls as it should: 0.1 at one sample a pixel, 64 samples at the end,
 * one sample a second. */
static void make_job(job_t *job, size_t count)
{
    lm__job_status__init(&job->status);
    lm__settings__init(&job->settings);
    job->settings.width = job->settings.height = SIDE;
    job->settings.spp = JOB_MAX_SPP;
    job->status.settings = &job->settings;
    job->status.state = JOB_RUNNING;
    for (size_t i = 0; i < count; i++) {
        double samples = pow(64, count > 1 ? (double)i / (double)(count - 1) : 1);
        lm__error_point__init(&job->points[i]);
        job->points[i].samples = (uint64_t)(samples * SIDE * SIDE);
        job->points[i].elapsed = samples;
        job->points[i].error = 0.1 / sqrt(samples);
        job->list[i] = &job->points[i];
    }
    job->status.n_history = count;
    job->status.history = job->list;
    job->status.samples_done = 64 * SIDE * SIDE;
    job->status.elapsed = 64;
}

/* The text of a line, counted from 0, without its end; fresh memory. */
static char *line_of(const char *text, int number)
{
    for (; number > 0 && text != NULL; number--) text = strchr(text, '\n') + 1;
    return strndup(text, strcspn(text, "\n"));
}

static int count_marks(const char *text, char mark)
{
    int count = 0;
    bool grid = false;
    for (const char *c = text; *c != '\0'; c++) {
        if (*c == '\n') grid = false;
        count += grid && *c == mark;
        grid = grid || *c == '|';
    }
    return count;
}

static void assert_says(const char *text, const char *part)
{
    if (strstr(text, part) != NULL) return;
    print_error("%s", text);
    fail_msg("'%s' is not in it", part);
}

static void points_fall_on_the_line(void **state)
{
    (void)state;
    job_t job;
    make_job(&job, 7);
    char *text = plot_error(&job.status, 79);
    assert_non_null(text);
    assert_int_equal(count_marks(text, '*'), 7);
    assert_int_equal(count_marks(text, '-'), 0);
    /* Line and points meet: a column has one or the other. The first row has the first point, the last row
     * the last. */
    assert_int_equal(count_marks(text, '.') + count_marks(text, '*'), 79 - MARGIN);
    char *first = line_of(text, 1), *last = line_of(text, 14);
    assert_int_equal(strcspn(first, "*"), MARGIN);
    assert_int_equal(strcspn(last, "*"), 79 - 1);
    assert_says(first, "10% |");
    assert_says(text, "\n     5% |");
    char *labels = line_of(text, 16);
    assert_int_equal(strcspn(labels, "1"), MARGIN);
    assert_says(labels, "  10  ");
    free(first);
    free(last);
    free(labels);
    free(text);
}

static void a_target_has_its_line_and_its_time(void **state)
{
    (void)state;
    job_t job;
    make_job(&job, 20);
    job.settings.error = 0.01; /* at 100 samples: 36 seconds away */
    char *text = plot_error(&job.status, 79);
    assert_in_range(count_marks(text, '-'), 40, 79);
    assert_says(text, "\n     1% |");
    assert_says(text, "by the fit, 1% takes 100 samples a pixel: ETA 0:3");
    free(text);
    job.status.state = JOB_PAUSED;
    text = plot_error(&job.status, 79);
    assert_says(text, "takes 100 samples a pixel\n");
    free(text);
    job.settings.spp = 81;
    text = plot_error(&job.status, 79);
    assert_says(text, "the job ends at 81, with about 1.11%\n");
    free(text);
    job.settings.error = 0.02;
    text = plot_error(&job.status, 79);
    assert_says(text, "the target of 2% is reached: 1.25%\n");
    free(text);
}

/* Young images see too little of their light: their errors do not count for the line. */
static void early_points_do_not_bend_the_line(void **state)
{
    (void)state;
    job_t job;
    make_job(&job, 20);
    job.settings.error = 0.01;
    for (size_t i = 0; i < 8; i++) job.points[i].error /= 10;
    char *text = plot_error(&job.status, 79);
    assert_says(text, "takes 100 samples a pixel");
    free(text);
}

static void it_fits_into_its_width(void **state)
{
    (void)state;
    job_t job;
    make_job(&job, 30);
    job.settings.error = 0.003;
    for (int width = 0; width < 200; width += 13) {
        char *text = plot_error(&job.status, width);
        size_t most = (size_t)int_max(PLOT_MIN_WIDTH, int_min(width, PLOT_MAX_WIDTH));
        for (int i = 0; i <= 16; i++) {
            char *line = line_of(text, i);
            if (strlen(line) > most) fail_msg("%zu columns at width %d: %s", strlen(line), width, line);
            free(line);
        }
        free(text);
    }
}

/* A short axis has labels in between, so that it is never without any. */
static void each_axis_has_labels(void **state)
{
    (void)state;
    for (double span = 1; span < 100; span *= 1.3) {
        job_t job;
        make_job(&job, 2);
        job.points[0].error = 0.0253;
        job.points[1].error = 0.0253 / span;
        job.points[0].samples = (uint64_t)((double)job.points[1].samples / span) - 1;
        char *text = plot_error(&job.status, 79), *samples = line_of(text, 16);
        int errors = 0, words = 0;
        for (const char *at = text; (at = strstr(at, "% |")) != NULL; at++) errors++;
        for (const char *at = samples; *at != '\0'; at++)
            words += at[0] == ' ' && at[1] != ' ' && at[1] != '\0';
        if (errors < 2 || words < 2) fail_msg("%d and %d labels at a span of %g", errors, words, span);
        free(samples);
        free(text);
    }
}

static void a_single_point_is_drawn(void **state)
{
    (void)state;
    job_t job;
    make_job(&job, 1);
    char *text = plot_error(&job.status, 60);
    assert_int_equal(count_marks(text, '*'), 1);
    free(text);
    job.settings.error = 0.01;
    text = plot_error(&job.status, 60);
    assert_says(text, "takes 100 samples a pixel: ETA 0:3"); /* by the mean speed */
    free(text);
}

static void what_cannot_be_is_not_drawn(void **state)
{
    (void)state;
    job_t job;
    make_job(&job, 0);
    assert_null(plot_error(&job.status, 79));
    make_job(&job, 6);
    const double errors[] = {0, -1, NAN, INFINITY, 1e-320, 1e300};
    for (size_t i = 0; i < 6; i++) job.points[i].error = errors[i];
    assert_null(plot_error(&job.status, 79));
    job.points[5].error = 1e29;
    job.points[4].error = 1e-29;
    job.points[4].samples = UINT64_MAX;
    job.points[3].samples = 0;
    job.settings.error = 1e-29;
    char *text = plot_error(&job.status, 79);
    assert_in_range(count_marks(text, '*'), 1, 2);
    free(text);
    job.settings.width = job.settings.height = 0;
    assert_null(plot_error(&job.status, 79));
    job.status.settings = NULL;
    assert_null(plot_error(&job.status, 79));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_fall_on_the_line),
        cmocka_unit_test(a_target_has_its_line_and_its_time),
        cmocka_unit_test(early_points_do_not_bend_the_line),
        cmocka_unit_test(it_fits_into_its_width),
        cmocka_unit_test(each_axis_has_labels),
        cmocka_unit_test(a_single_point_is_drawn),
        cmocka_unit_test(what_cannot_be_is_not_drawn),
    };
    return cmocka_run_group_tests_name("plot", tests, NULL, NULL);
}
