/* display: see display.h. */
#include "client/farm/display.h"

#include "client/image/viewer.h"
#include "common/interrupt.h"
#include "common/thread.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

static const double STEP = 0.1;       /* seconds; how soon the thread notices anything */
static const double SHORT_REST = 1.0; /* seconds between images, at least */
static const double PACE = 20;        /* rest / work: at most 5 % of the time goes into images */
static const int NICENESS = 10;       /* reading and hashing an image goes behind rendering */

struct display {
    viewer_t *viewer; /* of the thread, once it runs */
    remote_t *remote;
    uint64_t job;
    pthread_t thread;
    bool started;
    atomic_bool stop;

    /* Of the thread alone: */
    uint64_t shown_samples, shown_connection, sent;
    bool shown_final;
    double last, next; /* clock: when the last image was fetched, when the next one may be */
    bool refused;      /* the master gives no image; said so */

    pthread_mutex_t lock; /* guards what follows */
    uint64_t samples;
    bool final;
    bool busy;      /* fetches an image */
    bool away;      /* the viewer is */
    bool finished;  /* the viewer has the last image, or there is none */
    double moved;   /* clock: when the last bytes went to the viewer, or a fetch ended */
    char news[500]; /* empty: none */
};

/* ---- the thread --------------------------------------------------------------------------------------- */

typedef struct {
    uint64_t samples;
    bool final;
} job_view_t;

static job_view_t job_view(display_t *display)
{
    pthread_mutex_lock(&display->lock);
    job_view_t view = {display->samples, display->final};
    pthread_mutex_unlock(&display->lock);
    return view;
}

/* A new viewer gets its image at once, but not when one comes and goes all the time. */
static bool image_due(const display_t *display, const job_view_t *job)
{
    uint64_t connection = viewer_connection(display->viewer);
    double now = clock_now();
    if (connection == 0 || job->samples == 0 || !viewer_idle(display->viewer)) return false;
    if (connection != display->shown_connection) return now >= display->last + SHORT_REST;
    if (job->final) return !display->shown_final && (!display->refused || now >= display->next);
    return job->samples != display->shown_samples && now >= display->next;
}

static result_t fetch_image(display_t *display, image_t *image)
{
    uint8_t *bytes;
    size_t size;
    TRY(remote_fetch_image(display->remote, &(image_wish_t){.job = display->job}, &bytes, &size));
    result_t result = image_decode_exr("the image", bytes, size, image);
    free(bytes);
    return result;
}

static void tell(display_t *display, const char *text)
{
    pthread_mutex_lock(&display->lock);
    snprintf(display->news, sizeof display->news, "%s", text);
    pthread_mutex_unlock(&display->lock);
}

/* A master that does not answer is the watcher's to tell. */
static void note_refusal(display_t *display, const result_t *result)
{
    if (!display->refused && result->code != RESULT_UNREACHABLE) {
        char *text = mem_printf("the viewer gets no image: %s", result->message);
        tell(display, text);
        free(text);
    }
    display->refused = true;
}

static void show_image(display_t *display, const job_view_t *job)
{
    image_t image;
    double begin = clock_now();
    result_t result = fetch_image(display, &image);
    display->last = clock_now();
    double rest = PACE * (display->last - begin);
    display->next = display->last + (rest > SHORT_REST ? rest : SHORT_REST);
    if (result.code != RESULT_OK) {
        note_refusal(display, &result);
        return;
    }
    display->refused = false;
    display->shown_samples = job->samples;
    display->shown_final = job->final;
    display->shown_connection = viewer_connection(display->viewer);
    viewer_show(display->viewer, &image);
}

/* Tells the others how it stands. What a viewer was shown is gone with it. */
static void report(display_t *display, const job_view_t *job, bool busy)
{
    uint64_t connection = viewer_connection(display->viewer), sent = viewer_sent(display->viewer);
    bool shown = display->shown_final && connection != 0 && connection == display->shown_connection;
    pthread_mutex_lock(&display->lock);
    if (busy || display->busy || sent != display->sent) display->moved = clock_now();
    display->busy = busy;
    display->away = viewer_away(display->viewer);
    display->finished = job->final && (job->samples == 0 || (shown && viewer_idle(display->viewer)));
    pthread_mutex_unlock(&display->lock);
    display->sent = sent;
}

static void *display_thread(void *argument)
{
    display_t *display = argument;
    char news[500];
    setpriority(PRIO_PROCESS, (id_t)gettid(), NICENESS);
    while (!atomic_load(&display->stop)) {
        viewer_step(display->viewer, STEP);
        if (viewer_news(display->viewer, news)) tell(display, news);
        job_view_t job = job_view(display);
        if (image_due(display, &job)) {
            report(display, &job, true);
            show_image(display, &job);
        }
        report(display, &job, false);
    }
    return NULL;
}

/* ---- the others --------------------------------------------------------------------------------------- */

result_t display_open(const char *address, display_t **display_pointer)
{
    viewer_t *viewer;
    *display_pointer = NULL;
    if (address == NULL) return result_ok();
    TRY(viewer_open(address, &viewer));
    display_t *display = mem_zalloc(1, sizeof *display);
    display->viewer = viewer;
    pthread_mutex_init(&display->lock, NULL);
    *display_pointer = display;
    return result_ok();
}

result_t display_start(display_t *display, remote_t *remote, uint64_t job, const char *name)
{
    display->remote = remote;
    display->job = job;
    display->moved = clock_now();
    viewer_name(display->viewer, name);
    TRY(thread_start(&display->thread, "lm-display", display_thread, display));
    display->started = true;
    return result_ok();
}

void display_tell(display_t *display, uint64_t samples_done, bool final)
{
    if (display == NULL) return;
    pthread_mutex_lock(&display->lock);
    display->samples = samples_done;
    display->final = final;
    pthread_mutex_unlock(&display->lock);
}

bool display_news(display_t *display, char text[500])
{
    if (display == NULL) return false;
    pthread_mutex_lock(&display->lock);
    bool some = display->news[0] != '\0';
    memcpy(text, display->news, sizeof display->news);
    display->news[0] = '\0';
    pthread_mutex_unlock(&display->lock);
    return some;
}

typedef enum { FINISH_DONE, FINISH_GOES_ON, FINISH_STUCK } finish_t;

static finish_t see_finish(display_t *display, double stall, bool absent)
{
    pthread_mutex_lock(&display->lock);
    bool stuck = !display->busy && clock_now() - display->moved > stall;
    finish_t finish = FINISH_GOES_ON;
    if (stuck || (display->away && !absent)) finish = FINISH_STUCK;
    if (display->finished) finish = FINISH_DONE;
    pthread_mutex_unlock(&display->lock);
    return finish;
}

/* Waits a moment, and logs what there is to tell. */
static void wait_moment(display_t *display)
{
    char news[500];
    nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    if (display_news(display, news)) log_warning("%s", news);
}

result_t display_finish(display_t *display, double stall, double limit, bool absent)
{
    if (display == NULL || !display->started) return result_ok();
    const atomic_int *interrupts = interrupt_catch();
    int interrupts_before = atomic_load(interrupts);
    double begin = clock_now();
    pthread_mutex_lock(&display->lock);
    display->moved = begin;
    pthread_mutex_unlock(&display->lock);
    for (;; wait_moment(display)) {
        finish_t finish = see_finish(display, stall, absent);
        if (finish == FINISH_DONE) return result_ok();
        if (atomic_load(interrupts) > interrupts_before) return result_fail(RESULT_CANCELLED, "interrupted");
        if (finish == FINISH_STUCK || clock_now() - begin > limit)
            return result_fail(RESULT_UNREACHABLE, "the image viewer at %s has not taken the last image",
                               viewer_label(display->viewer));
    }
}

void display_close(display_t **display_pointer)
{
    display_t *display = *display_pointer;
    if (display == NULL) return;
    atomic_store(&display->stop, true);
    if (display->started) pthread_join(display->thread, NULL);
    remote_close(&display->remote);
    viewer_close(&display->viewer);
    pthread_mutex_destroy(&display->lock);
    free(display);
    *display_pointer = NULL;
}
