/* notifier: see notifier.h. */
#include "master/threads/notifier.h"

#include "common/notify/notify.h"
#include "common/thread.h"
#include "common/wake.h"
#include "master/threads/image_writer.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>

struct notifier {
    notifier_options_t options;
    char *target, *label, *data_dir;
    pthread_t thread;
    atomic_bool stop;
};

/* The absolute path of a job's last image, in fresh memory; NULL when there is none. */
static char *find_image(const notifier_t *notifier, const job_record_t *record)
{
    if (record->state != JOB_DONE && record->state != JOB_CANCELLED) return NULL;
    char *path = image_writer_image_path(notifier->data_dir, record->job);
    char *image = realpath(path, NULL);
    free(path);
    return image;
}

static result_t attempt(const notifier_t *notifier, const job_report_t *report)
{
    const job_record_t *record = &report->record;
    double pixels = (double)record->settings.width * (double)record->settings.height;
    char *image = find_image(notifier, record);
    news_t news = {.job = record->job,
                   .name = record->terms.name,
                   .state = job_state_name((uint32_t)record->state),
                   .message = record->message,
                   .samples = record->samples_done,
                   .spp = (double)record->samples_done / pixels,
                   .error = report->error,
                   .elapsed = record->elapsed,
                   .image = image};
    result_t result = notify_once(notifier->target, &news, NOTIFY_LIMIT, &notifier->stop);
    free(image);
    return result;
}

/* The first failure is worth a line in the log, and the last. */
static void note_failure(const notifier_t *notifier, const farm_news_t *news, const result_t *result)
{
    unsigned long long job = news->report.record.job;
    double now = clock_now();
    if (now - news->since >= NOTIFIER_PATIENCE) {
        log_error("job %llu: nobody is told of its state: %s: %s", job, notifier->label, result->message);
        farm_news_told(notifier->options.farm, news);
        return;
    }
    log_write(news->failures == 0 ? LOG_WARNING : LOG_DEBUG, "job %llu: nobody is told yet: %s: %s", job,
              notifier->label, result->message);
    farm_news_failed(notifier->options.farm, news, now + notify_pause(news->failures + 1));
}

static void tell(const notifier_t *notifier, const farm_news_t *news)
{
    const job_record_t *record = &news->report.record;
    result_t result = attempt(notifier, &news->report);
    if (result.code == RESULT_CANCELLED) return; /* it stays to be told */
    if (result.code != RESULT_OK) {
        note_failure(notifier, news, &result);
        return;
    }
    log_info("job %llu: %s was told that it is %s", (unsigned long long)record->job, notifier->label,
             job_state_name((uint32_t)record->state));
    farm_news_told(notifier->options.farm, news);
}

static void *notifier_run(void *argument)
{
    notifier_t *notifier = argument;
    farm_news_t news;
    double wait;
    while (!atomic_load(&notifier->stop)) {
        if (farm_next_news(notifier->options.farm, clock_now(), &news, &wait))
            tell(notifier, &news);
        else
            wake_wait(notifier->options.news_wake, isfinite(wait) ? (int)ceil(1000 * fmin(wait, 60)) : -1);
    }
    return NULL;
}

static void free_notifier(notifier_t *notifier)
{
    free(notifier->target);
    free(notifier->label);
    free(notifier->data_dir);
    free(notifier);
}

result_t notifier_start(const notifier_options_t *options, notifier_t **out)
{
    notifier_t *notifier = mem_zalloc(1, sizeof *notifier);
    notifier->options = *options;
    notifier->target = mem_strdup(options->target);
    notifier->label = notify_label(options->target);
    notifier->data_dir = mem_strdup(options->data_dir);
    result_t result = thread_start(&notifier->thread, "lm-notifier", notifier_run, notifier);
    if (result.code == RESULT_OK)
        *out = notifier;
    else
        free_notifier(notifier);
    return result;
}

void notifier_stop(notifier_t **out)
{
    notifier_t *notifier = *out;
    if (notifier == NULL) return;
    atomic_store(&notifier->stop, true);
    wake_up(notifier->options.news_wake);
    pthread_join(notifier->thread, NULL);
    free_notifier(notifier);
    *out = NULL;
}
