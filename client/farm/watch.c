/* watch: see watch.h. */
#include "client/farm/watch.h"

#include "common/interrupt.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const long POLL_NANOSECONDS = 100000000; /* between questions; also how soon a signal is noticed */

static void take_status(watch_t *watch, const Lm__JobStatus *status)
{
    watch->state = status->state;
    watch->final = job_state_final(status->state);
    snprintf(watch->name, sizeof watch->name, "%s", status->name);
    watch->samples_done = status->samples_done;
    watch->error = status->error;
    watch->elapsed = status->elapsed;
    watch->workers_seen = status->workers_seen;
    if (strcmp(watch->message, status->message) != 0) {
        snprintf(watch->message, sizeof watch->message, "%s", status->message);
        if (!watch->final && watch->message[0] != '\0') {
            progress_erase(watch->progress);
            log_warning("%s", watch->message);
        }
    }
    watch->halves = status->terms != NULL && status->terms->halves;
    job_settings_t settings;
    if (status->settings == NULL || wire_settings_get(status->settings, &settings).code != RESULT_OK) return;
    watch->width = settings.width;
    watch->height = settings.height;
    watch->save_at = settings.save_at;
    watch->saved = status->saved;
}

/* Tells, once each time, that the master does not answer, and that it does again. */
static void note_silence(watch_t *watch, const result_t *result)
{
    bool silent = result->code == RESULT_UNREACHABLE;
    if (silent == watch->silent) return;
    watch->silent = silent;
    progress_erase(watch->progress);
    if (silent)
        log_warning("%s; asking on", result->message);
    else
        log_warning("the master is back");
}

/* Lines of the viewer's thread, which must not be mixed with the progress. */
static void show_news(watch_t *watch)
{
    char text[500];
    if (!display_news(watch->display, text)) return;
    progress_erase(watch->progress);
    log_warning("%s", text);
}

/* Fetches what was kept since the last poll. A file that cannot be written does not end the job: that is told
 * at the end. */
static void take_saves(watch_t *watch)
{
    for (uint32_t i = 0; i < watch->save_at.count && watch->save_at.spp[i] <= watch->saved; i++) {
        uint32_t spp = watch->save_at.spp[i];
        if (spp <= watch->taken) continue;
        output_t output = output_at(watch->saves, spp);
        progress_erase(watch->progress);
        result_t result = watch_deliver_at(watch, spp, &output, watch->quiet);
        output_free(&output);
        watch->taken = spp;
        if (result.code == RESULT_OK) continue;
        log_warning("%s", result.message);
        if (watch->missed.code == RESULT_OK) watch->missed = result;
    }
}

result_t watch_poll(watch_t *watch)
{
    show_news(watch);
    nanosleep(&(struct timespec){.tv_nsec = POLL_NANOSECONDS}, NULL);
    wire_message_t message;
    result_t result = remote_status(watch->remote, watch->job, &message);
    if (watch->patient) note_silence(watch, &result);
    TRY(result);
    const Lm__JobStatus *status = message.envelope->job_status_reply->jobs[0];
    take_status(watch, status);
    progress_job(watch->progress, status);
    wire_free(&message);
    display_tell(watch->display, watch->samples_done, watch->final);
    if (watch->saves != NULL) take_saves(watch);
    return result_ok();
}

/* Polls until the job is over, or has kept an image at `spp` samples a pixel. */
static result_t wait_until(watch_t *watch, uint32_t spp)
{
    interrupt_catch();
    while (!watch->final && watch->saved < spp) {
        result_t result = watch_poll(watch);
        if (interrupt_seen())
            return result_fail(RESULT_CANCELLED,
                               "the job goes on; fetch its image with: lightmill fetch %" PRIu64, watch->job);
        if (!watch->patient || result.code != RESULT_UNREACHABLE) TRY(result);
    }
    return result_ok();
}

result_t watch_wait(watch_t *watch)
{
    return wait_until(watch, UINT32_MAX);
}

static void show_making(void *progress, uint32_t before, double share)
{
    progress_making(progress, before, share);
}

static void show_fetching(void *progress, uint64_t done, uint64_t size)
{
    progress_fetch(progress, done, size);
}

/* Fetches the image; a patient watch begins again when the master goes away meanwhile. */
static result_t fetch_image(const watch_t *watch, uint32_t at, const output_t *output, uint8_t **bytes,
                            size_t *size)
{
    const image_wish_t wish = {.job = watch->job,
                               .at = at,
                               .half = output->half,
                               .halves = output->halves,
                               .making = show_making,
                               .fetching = show_fetching,
                               .context = watch->progress};
    result_t result;
    do result = remote_fetch_image(watch->remote, &wish, bytes, size);
    while (watch->patient && result.code == RESULT_UNREACHABLE && !interrupt_seen());
    progress_erase(watch->progress);
    return result;
}

static void say_names(const watch_t *watch, const output_t *output)
{
    printf("wrote %s%s%s: %d x %d", output->path, output->png ? " and " : "", output->png ? output->png : "",
           watch->width, watch->height);
}

static void say_noise(double noise)
{
    if (noise >= 0) printf(", noise %.2g%%", 100 * noise);
    printf("\n");
    fflush(stdout);
}

/* "wrote a.exr: 128 x 128, 64.0 spp, 1.05 M samples in 8.2 s (128 k samples/s), noise 3.1%" */
static void say_written(const watch_t *watch, const output_t *output, double noise)
{
    char samples[32], duration[32], rate[32];
    format_count((double)watch->samples_done, samples);
    format_duration(watch->elapsed, duration);
    format_count(watch->elapsed > 0 ? (double)watch->samples_done / watch->elapsed : 0, rate);
    double pixels = (double)watch->width * (double)watch->height;
    say_names(watch, output);
    printf(", %.4g spp, %s samples in %s (%s samples/s)",
           pixels > 0 ? (double)watch->samples_done / pixels : 0, samples, duration, rate);
    say_noise(noise);
}

result_t watch_deliver_at(const watch_t *watch, uint32_t spp, const output_t *output, bool quiet)
{
    uint8_t *bytes;
    size_t size;
    double noise;
    TRY(fetch_image(watch, spp, output, &bytes, &size));
    result_t result = output_write(output, bytes, size, &noise);
    free(bytes);
    if (result.code != RESULT_OK || quiet) return result;
    say_names(watch, output);
    printf(", %u spp", spp);
    say_noise(noise);
    return result;
}

/* Tells when the job ended before all images came that were to be kept, and gives the failure of one that
 * came. */
static result_t close_saves(const watch_t *watch)
{
    if (watch->saves == NULL) return result_ok();
    for (uint32_t i = 0; i < watch->save_at.count; i++) {
        if (watch->save_at.spp[i] <= watch->saved) continue;
        log_warning("the job ended before %u samples a pixel: there is no image at %u", watch->save_at.spp[i],
                    watch->save_at.spp[i]);
        break;
    }
    return watch->missed;
}

result_t watch_deliver(const watch_t *watch, const output_t *output, bool quiet)
{
    if (watch->state == JOB_FAILED) return result_fail(RESULT_LIMIT, "the job failed: %s", watch->message);
    if (watch->samples_done == 0 && watch->final)
        return result_fail(RESULT_CANCELLED, "the job ended before any sample was made; no image is written");
    if (watch->samples_done == 0)
        return result_fail(
            RESULT_INPUT,
            "job %" PRIu64 " has no samples yet, so there is no image; --wait waits for its end", watch->job);
    uint8_t *bytes;
    size_t size;
    double noise;
    TRY(fetch_image(watch, 0, output, &bytes, &size));
    result_t result = output_write(output, bytes, size, &noise);
    free(bytes);
    if (result.code == RESULT_OK && !quiet) say_written(watch, output, noise);
    return result.code == RESULT_OK ? close_saves(watch) : result;
}

void watch_tell(const watch_t *watch, const tell_t *tell, const char *image, const char *message)
{
    double pixels = (double)watch->width * (double)watch->height;
    char *path = image != NULL ? realpath(image, NULL) : NULL;
    news_t news = {.job = watch->job,
                   .name = watch->name,
                   .state = job_state_name(watch->state),
                   .message = watch->message[0] != '\0' ? watch->message : message,
                   .samples = watch->samples_done,
                   .spp = pixels > 0 ? (double)watch->samples_done / pixels : 0,
                   .error = watch->error,
                   .elapsed = watch->elapsed,
                   .image = path};
    if (watch->final) tell_news(tell, &news); /* else the job goes on */
    free(path);
}

result_t watch_to_milestone(remote_t *remote, uint64_t job, uint32_t spp, const output_t *output, bool quiet)
{
    progress_t progress = progress_start(quiet);
    watch_t watch = {.remote = remote, .job = job, .progress = &progress, .patient = true};
    result_t result = wait_until(&watch, spp);
    progress_end(&progress);
    TRY(result);
    return watch_deliver_at(&watch, spp, output, quiet);
}

result_t watch_to_end(remote_t *remote, uint64_t job, const output_t *output, bool saves, const tell_t *tell,
                      bool quiet)
{
    progress_t progress = progress_start(quiet);
    watch_t watch = {.remote = remote, .job = job, .progress = &progress, .patient = true, .quiet = quiet};
    if (saves) watch.saves = output;
    result_t result = watch_wait(&watch);
    progress_end(&progress);
    TRY(result);
    result = watch_deliver(&watch, output, quiet);
    watch_tell(&watch, tell, result.code == RESULT_OK ? output->path : NULL, result.message);
    TRY(result);
    if (watch.state == JOB_CANCELLED) return result_fail(RESULT_CANCELLED, "the job was cancelled");
    return result_ok();
}
