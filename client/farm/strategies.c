/* strategies: see strategies.h.
 *
 * DESIGN. All jobs are submitted at once: a farm begins the next job when all units of one are handed out,
 * so no worker waits between them. Images are fetched as their jobs finish, straight into the planes of the
 * image that is written at the end; the sum is taken in the order of the list, so that its bits do not depend
 * on the order of arrival.
 *
 * Without its weight a strategy has a heavy tail (the distance of two joined vertices is in the denominator),
 * so the films of these jobs get more room above at the cost of digits that noise hides. */
#include "client/farm/strategies.h"

#include "client/image/contact_sheet.h"
#include "client/text/progress.h"
#include "common/film/picture.h"
#include "common/interrupt.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const long POLL_NANOSECONDS = 100000000; /* between questions; also how soon a signal is noticed */
enum { UNWEIGHTED_HEADROOM = 10 };              /* bits of an unweighted film's scale that are given up */

/* ---- what is asked for --------------------------------------------------------------------------------- */

static int segments_of(const job_settings_t *settings)
{
    return settings->max_depth + 1;
}

result_t strategies_settings(const overrides_t *overrides, const scene_blob_t *blob, job_settings_t *settings)
{
    strategy_t list[STRATEGIES_MAX];
    TRY(overrides_apply(overrides, blob, settings));
    if (overrides->integrator != 0 && overrides->integrator != INTEGRATOR_BDPT)
        return result_fail(RESULT_USAGE,
                           "--strategies takes bdpt apart, and not %s: use it without --integrator",
                           integrator_name(overrides->integrator));
    if (settings->time_limit > 0)
        return result_fail(RESULT_USAGE,
                           "--strategies gives all images the same samples: use --spp, not --time");
    if (settings->save_at.count > 0)
        return result_fail(RESULT_USAGE, "--strategies writes one file: use it without --save-at");
    if (settings->cryptomatte)
        return result_fail(RESULT_USAGE, "images of strategies have no mattes: use --strategies without "
                                         "--cryptomatte");
    if (settings->light_groups[0] != '\0')
        return result_fail(RESULT_USAGE,
                           "--strategies shows strategies, not lights: use it without --light-groups");
    if (job_is_planned(settings))
        return result_fail(RESULT_USAGE, "--strategies gives all images the same samples: use --spp, not %s",
                           settings->adaptive ? "--adaptive" : "--error");
    if (segments_of(settings) > STRATEGIES_MAX_SEGMENTS)
        return result_fail(RESULT_USAGE,
                           "--strategies shows paths of at most %d segments, max depth %d makes %d: use "
                           "--max-depth %d or less",
                           STRATEGIES_MAX_SEGMENTS, settings->max_depth, segments_of(settings),
                           STRATEGIES_MAX_SEGMENTS - 1);
    settings->integrator = INTEGRATOR_BDPT;
    settings->features = false;
    settings->learn = false; /* strategies alone do not: they add up to an image that does not */
    uint64_t planes = 3 * (2 * strategies_list(segments_of(settings), list) + 1);
    uint64_t bytes = planes * sizeof(float) * (uint64_t)settings->width * (uint64_t)settings->height;
    if (bytes > IMAGE_MAX_BYTES)
        return result_fail(RESULT_LIMIT,
                           "%llu channels of %d x %d pixels take %.1f GB, more than the %.1f GB of an image: "
                           "use a smaller --resolution or --max-depth",
                           (unsigned long long)planes, settings->width, settings->height,
                           1e-9 * (double)bytes, 1e-9 * (double)IMAGE_MAX_BYTES);
    return job_settings_check(settings);
}

/* ---- the jobs ------------------------------------------------------------------------------------------ */

/* One image and its job. */
typedef struct {
    strategy_t strategy;
    bool weighted;
    float *rgb[3]; /* planes of the image, owned by it */
    uint64_t job;  /* 0: not submitted yet */
    uint32_t state;
    uint64_t samples_done;
    film_counts_t counts;
    uint32_t workers;
    bool reported; /* by the last status */
    bool fetched;
} part_t;

typedef struct {
    const strategies_t *order;
    image_t image;
    float *sum[3]; /* R, G, B of the image */
    part_t parts[2 * STRATEGIES_MAX];
    size_t part_count, fetched_count;
    double start; /* clock */
} run_t;

/* Fails when the render is to end. */
static result_t check(const run_t *run)
{
    if (interrupt_seen())
        return result_fail(RESULT_CANCELLED,
                           "interrupted before all strategies were done; nothing is written");
    return run->order->check != NULL ? run->order->check(run->order->check_context) : result_ok();
}

/* The image with all its layers, and what is to be rendered into them. */
static result_t lay_out(run_t *run)
{
    const job_settings_t *settings = &run->order->settings;
    pixel_type_t type = run->order->output->half ? PIXEL_HALF : PIXEL_FLOAT;
    strategy_t list[STRATEGIES_MAX];
    size_t count = strategies_list(segments_of(settings), list);
    image_init(&run->image, settings->width, settings->height);
    bool enough = image_add_rgb(&run->image, NULL, type, run->sum);
    for (size_t i = 0; i < 2 * count && enough; i++) {
        part_t *part = &run->parts[run->part_count++];
        *part = (part_t){.strategy = list[i / 2], .weighted = i % 2 == 0};
        char *layer = strategy_layer(part->strategy, part->weighted);
        enough = image_add_rgb(&run->image, layer, type, part->rgb);
        free(layer);
    }
    if (enough) return result_ok();
    return result_fail(RESULT_LIMIT, "no memory for %zu images of %d x %d pixels", 2 * count, settings->width,
                       settings->height);
}

static result_t submit_part(const run_t *run, part_t *part)
{
    const loaded_scene_t *scene = run->order->scene;
    job_settings_t settings = run->order->settings;
    settings.strategy_s = part->strategy.s;
    settings.strategy_t = part->strategy.t;
    settings.unweighted = !part->weighted;
    if (settings.unweighted)
        settings.film_scale = int_max(settings.film_scale - UNWEIGHTED_HEADROOM, FILM_MIN_SCALE);
    char *layer = strategy_layer(part->strategy, part->weighted);
    job_terms_t terms = run->order->terms;
    snprintf(terms.name, sizeof terms.name, "%.170s %s", scene->name, layer);
    result_t result = remote_submit_job(run->order->remote, &terms, &settings, &scene->blob.hash, &part->job);
    free(layer);
    return result;
}

static part_t *find_part(run_t *run, uint64_t job)
{
    for (size_t i = 0; i < run->part_count; i++)
        if (run->parts[i].job == job) return &run->parts[i];
    return NULL; /* somebody else's job */
}

/* Ends the jobs that are still wanted by nobody. Those that are over refuse, which does not matter. */
static void cancel_all(run_t *run)
{
    for (size_t i = 0; i < run->part_count; i++) {
        const part_t *part = &run->parts[i];
        if (part->job == 0 || job_state_final(part->state)) continue;
        if (remote_cancel(run->order->remote, part->job).code == RESULT_UNREACHABLE) return;
    }
}

static result_t take_status(part_t *part, const Lm__JobStatus *status)
{
    part->reported = true;
    part->state = status->state;
    part->samples_done = status->samples_done;
    part->workers = status->workers_seen;
    wire_counts_get(status->counts, &part->counts);
    if (status->state != JOB_FAILED && status->state != JOB_CANCELLED) return result_ok();
    return result_fail(status->state == JOB_FAILED ? RESULT_LIMIT : RESULT_CANCELLED,
                       "the job of the strategy s = %d, t = %d %s: %.300s", part->strategy.s,
                       part->strategy.t, job_state_name(status->state), status->message);
}

/* Asks for the state of all jobs. */
static result_t poll_jobs(run_t *run)
{
    wire_message_t message;
    result_t result = result_ok();
    for (size_t i = 0; i < run->part_count; i++) run->parts[i].reported = false;
    TRY(remote_status(run->order->remote, 0, &message));
    const Lm__JobStatusReply *reply = message.envelope->job_status_reply;
    for (size_t i = 0; i < reply->n_jobs && result.code == RESULT_OK; i++) {
        part_t *part = find_part(run, reply->jobs[i]->job);
        if (part) result = take_status(part, reply->jobs[i]);
    }
    wire_free(&message);
    TRY(result);
    for (size_t i = 0; i < run->part_count; i++)
        if (!run->parts[i].reported && !run->parts[i].fetched)
            return result_fail(RESULT_INPUT, "the master has forgotten job %llu",
                               (unsigned long long)run->parts[i].job);
    return result_ok();
}

/* Copies the picture of a job into its layer. */
static result_t take_image(const run_t *run, part_t *part, const uint8_t *bytes, size_t size)
{
    image_t image;
    const image_channel_t *rgb[3];
    TRY(image_decode_exr("an image from the master", bytes, size, &image));
    bool fits = image.width == run->image.width && image.height == run->image.height &&
                image_find_rgb(&image, NULL, rgb);
    size_t pixels = (size_t)run->image.width * (size_t)run->image.height;
    for (int c = 0; c < 3 && fits; c++)
        for (size_t i = 0; i < pixels; i++) part->rgb[c][i] = rgb[c]->data[i * rgb[c]->stride];
    image_free(&image);
    if (fits) return result_ok();
    return result_fail(RESULT_PROTOCOL, "the master's image of job %llu is not what was asked for",
                       (unsigned long long)part->job);
}

static result_t fetch_part(run_t *run, part_t *part)
{
    uint8_t *bytes;
    size_t size;
    TRY(remote_fetch_image(run->order->remote, &(image_wish_t){.job = part->job}, &bytes, &size));
    result_t result = take_image(run, part, bytes, size);
    free(bytes);
    part->fetched = result.code == RESULT_OK;
    run->fetched_count += part->fetched;
    return result;
}

static result_t fetch_done(run_t *run)
{
    for (size_t i = 0; i < run->part_count; i++) {
        part_t *part = &run->parts[i];
        if (part->state != JOB_DONE || part->fetched) continue;
        TRY(fetch_part(run, part));
        TRY(check(run));
    }
    return result_ok();
}

static uint64_t samples_done(const run_t *run)
{
    uint64_t sum = 0;
    for (size_t i = 0; i < run->part_count; i++) sum += run->parts[i].samples_done;
    return sum;
}

static void show_progress(const run_t *run, progress_t *progress)
{
    const job_settings_t *settings = &run->order->settings;
    double total = (double)settings->width * settings->height * settings->spp * (double)run->part_count;
    progress_series(progress, &(progress_series_t){.samples_done = (double)samples_done(run),
                                                   .samples_total = total,
                                                   .elapsed = clock_now() - run->start,
                                                   .images_done = run->fetched_count,
                                                   .images_total = run->part_count});
}

static result_t watch_all(run_t *run, progress_t *progress)
{
    while (run->fetched_count < run->part_count) {
        TRY(check(run));
        result_t result = poll_jobs(run);
        if (result.code == RESULT_OK) {
            show_progress(run, progress);
            result = fetch_done(run);
        }
        if (result.code == RESULT_UNREACHABLE && run->order->patient) {
            progress_erase(progress);
            log_warning("%s; waiting on", result.message);
        } else {
            TRY(result);
        }
        nanosleep(&(struct timespec){.tv_nsec = POLL_NANOSECONDS}, NULL);
    }
    show_progress(run, progress);
    return result_ok();
}

static result_t render_all(run_t *run, progress_t *progress)
{
    TRY(remote_put_blob(run->order->remote, &run->order->scene->blob, NULL, NULL));
    for (size_t i = 0; i < run->part_count; i++) {
        TRY(check(run));
        TRY(submit_part(run, &run->parts[i]));
    }
    return watch_all(run, progress);
}

/* ---- what becomes of the images ------------------------------------------------------------------------ */

static void add_up(run_t *run)
{
    size_t pixels = (size_t)run->image.width * (size_t)run->image.height;
    for (int c = 0; c < 3; c++)
        for (size_t p = 0; p < pixels; p++) {
            double sum = 0;
            for (size_t i = 0; i < run->part_count; i++)
                if (run->parts[i].weighted) sum += (double)run->parts[i].rgb[c][p];
            run->sum[c][p] = (float)sum;
        }
}

static void describe(run_t *run)
{
    picture_meta_t meta = {.scene = run->order->scene->blob.hash,
                           .scene_name = run->order->scene->name,
                           .settings = run->order->settings,
                           .wall_seconds = clock_now() - run->start};
    for (size_t i = 0; i < run->part_count; i++) {
        film_counts_add(&meta.counts, &run->parts[i].counts);
        if (run->parts[i].workers > meta.workers) meta.workers = run->parts[i].workers;
    }
    picture_describe(&run->image, &meta, samples_done(run));
    image_set_int(&run->image, "lightmill.strategies", (int32_t)(run->part_count / 2));
}

static result_t write_sheet(const run_t *run, const char *path)
{
    image_t sheet;
    TRY(contact_sheet_make(&run->image, segments_of(&run->order->settings), run->order->output->exposure,
                           &sheet));
    result_t result = image_write_png(path, &sheet, 0);
    image_free(&sheet);
    return result;
}

static result_t write_files(run_t *run)
{
    const output_t *output = run->order->output;
    add_up(run);
    describe(run);
    if (output_is_png(output->path))
        TRY(write_sheet(run, output->path));
    else
        TRY(image_write_exr(output->path, &run->image));
    if (output->png) TRY(write_sheet(run, output->png));
    if (run->order->quiet) return result_ok();
    char duration[32];
    format_duration(clock_now() - run->start, duration);
    printf("wrote %s%s%s: %zu strategies, weighted and unweighted, %d x %d, %u spp each, in %s\n",
           output->path, output->png ? " and " : "", output->png ? output->png : "", run->part_count / 2,
           run->image.width, run->image.height, run->order->settings.spp, duration);
    return result_ok();
}

result_t strategies_render(const strategies_t *strategies)
{
    run_t *run = mem_zalloc(1, sizeof *run);
    run->order = strategies;
    run->start = clock_now();
    progress_t progress = progress_start(strategies->quiet);
    result_t result = lay_out(run);
    if (result.code == RESULT_OK) {
        result = render_all(run, &progress);
        if (result.code != RESULT_OK) cancel_all(run);
    }
    progress_end(&progress);
    if (result.code == RESULT_OK) result = write_files(run);
    image_free(&run->image);
    free(run);
    return result;
}
