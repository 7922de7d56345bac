/* watch: a job seen from its client: the state again and again, then the image. */
#ifndef LIGHTMILL_WATCH_H
#define LIGHTMILL_WATCH_H

#include "client/farm/display.h"
#include "client/farm/remote.h"
#include "client/farm/tell.h"
#include "client/image/output.h"
#include "client/text/progress.h"

typedef struct {
    remote_t *remote;     /* kept by the caller */
    progress_t *progress; /* kept by the caller */
    uint64_t job;
    display_t *display;    /* kept by the caller; told of every status; NULL: none */
    bool patient;          /* a master that does not answer is waited for: it may be restarted */
    bool silent;           /* it does not answer at the moment */
    bool final;            /* done, cancelled or failed */
    const output_t *saves; /* where images that are kept on the way go as they come; NULL: nowhere */
    bool quiet;            /* nothing is said of them */
    uint32_t taken;        /* samples a pixel of the last of them that was seen to */
    result_t missed;       /* the first that could not be fetched or written */
    /* From the last status: */
    uint32_t state; /* job_state_t */
    char name[JOB_MAX_NAME + 1];
    int32_t width, height;
    uint64_t samples_done;
    double error;   /* estimated relative error; 0: not known */
    double elapsed; /* seconds */
    uint32_t workers_seen;
    save_at_t save_at; /* sample counts at which images are kept, */
    uint32_t saved;    /* and the last of which one is there */
    bool halves;       /* what is kept has the halves (job_terms_t) */
    char message[500]; /* why it failed */
} watch_t;

/* Waits a moment, asks for the state and shows it, and fetches images for `saves`. RESULT_UNREACHABLE when
 * there is no answer; a patient watch says so once, and when the master is back. */
result_t watch_poll(watch_t *watch);
/* Polls until the job is over. Ctrl-C ends the waiting, not the job: RESULT_CANCELLED. */
result_t watch_wait(watch_t *watch);
/* Fetches the image of a job, writes it and says so on stdout. A failed job is an error, and so is one
 * without any samples. */
result_t watch_deliver(const watch_t *watch, const output_t *output, bool quiet);
/* The same with the image that was kept at `spp` samples a pixel. */
result_t watch_deliver_at(const watch_t *watch, uint32_t spp, const output_t *output, bool quiet);
/* Waits patiently until the image at `spp` samples a pixel is there, and delivers it. */
result_t watch_to_milestone(remote_t *remote, uint64_t job, uint32_t spp, const output_t *output, bool quiet);
/* Tells whoever is to be told that the job is over. `image` is the path of what was written, NULL: nothing;
 * `message` is told when the job itself has none. */
void watch_tell(const watch_t *watch, const tell_t *tell, const char *image, const char *message);
/* All of it: waits patiently for the end of a job while its progress is shown (unless `quiet`), then writes
 * the image and tells. `saves`: the images that are kept on the way too. A job that was cancelled is no
 * success. */
result_t watch_to_end(remote_t *remote, uint64_t job, const output_t *output, bool saves, const tell_t *tell,
                      bool quiet);

#endif
