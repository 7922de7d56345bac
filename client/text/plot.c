/* plot: see plot.h.
 *
 * DESIGN. The line is error = scale / sqrt(samples), with the scale that fits the points of the last factor
 * FIT_SPAN in samples best on the logarithmic scale. Earlier points are left out: an image of few samples has
 * not seen all of its light yet, so its error is estimated too small.
 *
 * The status comes from a master that may be of another version, or worse: what cannot be drawn is skipped.
 */
#include "client/text/plot.h"

#include "client/text/progress.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    ROWS = 14,
    MARGIN = 9, /* columns of the labels of the errors, and of the axis */
    FIT_SPAN = 10,
    SHORT_AXIS = 6, /* from one end to the other, as a factor */
    AHEAD = 100     /* the plot goes on to so many times the samples, to show where the target is met */
};

typedef struct {
    double samples, error; /* samples a pixel */
} point_t;

typedef struct {
    const Lm__JobStatus *status;
    point_t *points;
    size_t count;
    double pixels;
    double target;            /* 0: none */
    double scale;             /* of the line */
    double needed;            /* samples a pixel where the line meets the target; 0: no target */
    double least[2], most[2]; /* of the axes, samples a pixel and error: logarithms */
    int columns;
    char cells[ROWS][PLOT_MAX_WIDTH];
    char *text;
    size_t length, room;
} plot_t;

/* ---- what is to be drawn ------------------------------------------------------------------------------- */

/* Within what a plot has a use for, and far from where logarithms and powers end. */
static bool drawable(double value)
{
    return value > 1e-30 && value < 1e30;
}

static void take_points(plot_t *plot)
{
    const Lm__JobStatus *status = plot->status;
    plot->points = mem_alloc((status->n_history + 1) * sizeof *plot->points);
    for (size_t i = 0; i < status->n_history; i++) {
        const Lm__ErrorPoint *point = status->history[i];
        double samples = (double)point->samples / plot->pixels;
        if (drawable(samples) && drawable(point->error))
            plot->points[plot->count++] = (point_t){samples, point->error};
    }
}

static void fit(plot_t *plot)
{
    double sum = 0, last = plot->points[plot->count - 1].samples;
    size_t count = 0;
    for (size_t i = 0; i < plot->count; i++) {
        if (plot->points[i].samples * FIT_SPAN < last) continue;
        sum += log(plot->points[i].error) + 0.5 * log(plot->points[i].samples);
        count++;
    }
    plot->scale = exp(sum / (double)count);
    plot->needed = plot->target > 0 ? pow(plot->scale / plot->target, 2) : 0;
}

/* Makes room for a value on one of the axes. */
static void include(plot_t *plot, int axis, double value)
{
    plot->least[axis] = fmin(plot->least[axis], log(value));
    plot->most[axis] = fmax(plot->most[axis], log(value));
}

/* Both axes show at least a factor of two, so that a single point has a place. */
static void choose_axes(plot_t *plot)
{
    for (int axis = 0; axis < 2; axis++) {
        plot->least[axis] = INFINITY;
        plot->most[axis] = -INFINITY;
    }
    for (size_t i = 0; i < plot->count; i++) {
        include(plot, 0, plot->points[i].samples);
        include(plot, 1, plot->points[i].error);
    }
    if (plot->target > 0) {
        include(plot, 0, fmin(fmax(plot->needed, exp(plot->least[0])), AHEAD * exp(plot->most[0])));
        include(plot, 1, fmax(plot->target, exp(plot->least[1]) / AHEAD));
    }
    for (int axis = 0; axis < 2; axis++) {
        double lacks = fmax(0, log(2.0) - (plot->most[axis] - plot->least[axis]));
        plot->least[axis] -= lacks / 2;
        plot->most[axis] += lacks / 2;
    }
}

/* ---- drawing ------------------------------------------------------------------------------------------- */

/* Where a value is on an axis, as a cell of `cells`; out of range for what is not on it. */
static int cell_of(const plot_t *plot, int axis, double value, int cells)
{
    double share = (log(value) - plot->least[axis]) / (plot->most[axis] - plot->least[axis]);
    return share > -1 && share < 2 ? (int)lround(share * (cells - 1)) : -1;
}

static int row_of(const plot_t *plot, double error)
{
    int from_below = cell_of(plot, 1, error, ROWS);
    return from_below < 0 ? -1 : ROWS - 1 - from_below;
}

static void put(plot_t *plot, int column, int row, char mark)
{
    if (column >= 0 && column < plot->columns && row >= 0 && row < ROWS) plot->cells[row][column] = mark;
}

static void draw(plot_t *plot)
{
    memset(plot->cells, ' ', sizeof plot->cells);
    for (int x = 0; x < plot->columns; x++) {
        double share = (double)x / (plot->columns - 1);
        double samples = exp(plot->least[0] + share * (plot->most[0] - plot->least[0]));
        if (plot->target > 0) put(plot, x, row_of(plot, plot->target), '-');
        put(plot, x, row_of(plot, plot->scale / sqrt(samples)), '.');
    }
    for (size_t i = 0; i < plot->count; i++)
        put(plot, cell_of(plot, 0, plot->points[i].samples, plot->columns),
            row_of(plot, plot->points[i].error), '*');
}

/* ---- text ---------------------------------------------------------------------------------------------- */

__attribute__((format(printf, 2, 3))) static void print(plot_t *plot, const char *format, ...)
{
    va_list list;
    if (plot->room - plot->length < 300) {
        plot->room = 2 * plot->room + 300;
        plot->text = mem_realloc(plot->text, plot->room);
    }
    va_start(list, format);
    plot->length += (size_t)vsnprintf(plot->text + plot->length, 300, format, list);
    va_end(list);
}

/* The labels of an axis are 1, 2 and 5 times powers of ten, and more where the axis is short: the least one
 * from `value` on. */
static double next_label(const plot_t *plot, int axis, double value)
{
    static const double coarse[] = {1, 2, 5}, fine[] = {1, 1.5, 2, 2.5, 3, 4, 5, 6, 7, 8, 9};
    bool is_short = plot->most[axis] - plot->least[axis] < log(SHORT_AXIS);
    const double *steps = is_short ? fine : coarse;
    size_t count = is_short ? ARRAY_LENGTH(fine) : ARRAY_LENGTH(coarse);
    double power = pow(10, floor(log10(value)));
    for (size_t i = 0; i < count; i++)
        if (steps[i] * power >= value * (1 - 1e-9)) return steps[i] * power;
    return 10 * power;
}

/* The label of a row of errors, or blanks. */
static void label_row(const plot_t *plot, int row, char text[16])
{
    snprintf(text, 16, "%*s", MARGIN - 2, "");
    double top = exp(plot->most[1]) * (1 + 1e-9);
    for (double error = next_label(plot, 1, exp(plot->least[1])); error <= top;
         error = next_label(plot, 1, error * 1.01)) {
        char label[16];
        if (row_of(plot, error) != row) continue;
        snprintf(label, sizeof label, "%.3g%%", 100 * error);
        snprintf(text, 16, "%*.*s", MARGIN - 2, MARGIN - 2, label);
        return;
    }
}

static void label_samples(double samples, char text[32])
{
    if (samples < 1)
        snprintf(text, 32, "%.2g", samples);
    else
        format_count(samples, text);
}

/* The labels below: as many as fit. */
static void print_labels(plot_t *plot)
{
    char line[MARGIN + PLOT_MAX_WIDTH + 32];
    memset(line, ' ', sizeof line);
    int free_from = 0;
    double end = exp(plot->most[0]) * (1 + 1e-9);
    for (double samples = next_label(plot, 0, exp(plot->least[0])); samples <= end;
         samples = next_label(plot, 0, samples * 1.01)) {
        char label[32];
        label_samples(samples, label);
        int length = (int)strlen(label), at = cell_of(plot, 0, samples, plot->columns);
        if (at < free_from || at + length > plot->columns) continue;
        memcpy(line + MARGIN + at, label, (size_t)length);
        free_from = at + length + 2;
    }
    int length = MARGIN + plot->columns;
    while (length > 0 && line[length - 1] == ' ') length--;
    print(plot, "%.*s\n", length, line);
}

static void print_cells(plot_t *plot)
{
    for (int row = 0; row < ROWS; row++) {
        char label[16];
        int length = plot->columns;
        while (length > 0 && plot->cells[row][length - 1] == ' ') length--;
        label_row(plot, row, label);
        print(plot, "%s |%.*s\n", label, length, plot->cells[row]);
    }
    print(plot, "%*s+", MARGIN - 1, "");
    for (int x = 0; x < plot->columns; x++) print(plot, "-");
    print(plot, "\n");
    print_labels(plot);
}

/* Pixel samples a second, since the samples were a FIT_SPAN-th of what they are; 0: not known. */
static double speed(const Lm__JobStatus *status)
{
    const Lm__ErrorPoint *last = status->history[status->n_history - 1];
    for (size_t i = 0; i < status->n_history; i++) {
        const Lm__ErrorPoint *point = status->history[i];
        if ((double)point->samples * FIT_SPAN < (double)last->samples) continue;
        double seconds = last->elapsed - point->elapsed,
               samples = (double)last->samples - (double)point->samples;
        if (seconds > 0 && samples > 0) return samples / seconds;
        break;
    }
    return status->elapsed > 0 ? (double)status->samples_done / status->elapsed : 0;
}

/* What the line promises: when the target is met, or what is there when the job ends before. */
static void print_promise(plot_t *plot)
{
    const Lm__JobStatus *status = plot->status;
    const point_t *last = &plot->points[plot->count - 1];
    char needed[32], end[32], duration[32];
    if (last->error <= plot->target) {
        print(plot, "  the target of %.3g%% is reached: %.3g%%\n", 100 * plot->target, 100 * last->error);
        return;
    }
    label_samples(plot->needed, needed);
    print(plot, "  by the fit, %.3g%% takes %s samples a pixel", 100 * plot->target, needed);
    double spp = status->settings->spp, done = (double)status->samples_done / plot->pixels;
    if (spp < JOB_MAX_SPP && spp < plot->needed) {
        label_samples(spp, end);
        print(plot, "; the job ends at %s, with about %.3g%%\n", end, 100 * plot->scale / sqrt(spp));
        return;
    }
    double rate = speed(status), left = (plot->needed - done) * plot->pixels;
    if (status->state == JOB_RUNNING && rate > 0 && left > 0) {
        format_duration(left / rate, duration);
        print(plot, ": ETA %s", duration);
    }
    print(plot, "\n");
}

char *plot_error(const Lm__JobStatus *status, int width)
{
    if (status->settings == NULL || status->n_history == 0) return NULL;
    plot_t plot = {.status = status,
                   .pixels = (double)status->settings->width * (double)status->settings->height,
                   .target = drawable(status->settings->error) ? status->settings->error : 0,
                   .columns = int_max(PLOT_MIN_WIDTH, int_min(width, PLOT_MAX_WIDTH)) - MARGIN};
    if (plot.pixels > 0) take_points(&plot);
    if (plot.count > 0) {
        fit(&plot);
        choose_axes(&plot);
        draw(&plot);
        print(&plot, "  error against samples a pixel%s\n", status->settings->adaptive ? " in the mean" : "");
        print_cells(&plot);
        print(&plot, "  * estimated   . falling with the root of the samples%s\n",
              plot.target > 0 ? "   - target" : "");
        if (plot.target > 0) print_promise(&plot);
    }
    free(plot.points);
    return plot.text;
}
