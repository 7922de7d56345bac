/* image_writer: the thread that makes OpenEXR and PNG files of films, for finished jobs and for clients that
 * ask meanwhile. In between it estimates the errors of jobs.
 *
 * A finished job's image is DATA/job-<number>.exr and stays, and so do the images of its milestones
 * (job_settings_t.save_at), DATA/job-<number>-at-<samples>.exr, until the job is deleted. A client gets a
 * snapshot: a file in DATA/snapshots that is deleted a while after its last use (snapshots.h). People who ask
 * for the same image at about the same time get the same. To resolve and compress a large film takes seconds;
 * in a thread of its own it delays neither heartbeats nor batches.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_IMAGE_WRITER_H
#define LIGHTMILL_IMAGE_WRITER_H

#include "master/farm/farm.h"
#include "master/threads/checkpointer.h"
#include "master/threads/snapshots.h"

enum { IMAGE_WRITER_MAX_WAITING = 64 /* requests for new snapshots at a time */ };

typedef struct image_writer image_writer_t;

typedef struct {
    farm_t *farm;                 /* kept by the caller, outlives the image writer */
    const blob_store_t *blobs;    /* likewise; has the names for mattes */
    film_store_t *films;          /* likewise; of jobs that are over */
    checkpointer_t *checkpointer; /* makes room on a full disk; NULL: there is none */
    const char *data_dir;         /* copied */
    int image_wake;               /* the farm's eventfd */
    int answer_wake;              /* eventfd, written when image_writer_next_answer has something */
    uint64_t snapshot_limit;      /* bytes that snapshots may take on the disk; 0: any number */
} image_writer_options_t;

/* Empties the snapshot directory and starts the thread. */
result_t image_writer_start(const image_writer_options_t *options, image_writer_t **image_writer);
/* Writes the images of all finished jobs that are still due, joins the thread, deletes the snapshots, frees
 * everything and sets *image_writer to NULL. */
void image_writer_stop(image_writer_t **image_writer);

/* Who asked for a new snapshot, and for which part of it. */
typedef struct {
    /* Is called on the image writer's thread, which it must not hold up; *file only where the result is good.
     * NULL: the answer comes from image_writer_next_answer. */
    void (*done)(void *context, const result_t *result, const image_file_t *file);
    void *context;
    identity_t identity;
    uint64_t request;
    uint64_t job;
    image_format_t format;
    uint32_t at; /* samples a pixel of a milestone; 0: the image as it is now */
    uint64_t offset;
    uint32_t length;
    bool progress; /* it is to be told by image_writer_news; not with `done` */
} image_request_t;

/* Asks for a snapshot of a job. RESULT_LIMIT, and no answer, when too many wait, or after image_writer_close.
 */
result_t image_writer_ask(image_writer_t *image_writer, const image_request_t *request);
/* Takes no more requests of who is told by a call, and refuses those that wait: the process ends. One whose
 * image is being written still gets it. */
void image_writer_close(image_writer_t *image_writer);
/* The next request that has been served: *snapshot names the image unless *result is a failure. */
bool image_writer_next_answer(image_writer_t *image_writer, image_request_t *request, result_t *result,
                              uint64_t *snapshot);

/* How it stands with a request. */
typedef struct {
    identity_t identity;
    uint64_t request;
    uint32_t before; /* images that are made before its own */
    float share;     /* of its own that is made, 0 to 1 */
} image_news_t;
enum { IMAGE_WRITER_MAX_NEWS = IMAGE_WRITER_MAX_WAITING + 1 };
/* How it stands with all requests that want to be told and have no answer yet; returns how many. */
size_t image_writer_news(image_writer_t *image_writer, image_news_t news[IMAGE_WRITER_MAX_NEWS]);
/* Who asked is gone: the request is forgotten, and an image that nobody else wants is not made. */
void image_writer_forget(image_writer_t *image_writer, const identity_t *identity, uint64_t request);

/* Reads up to `length` bytes of a snapshot at `offset`; *length says how many there were, *size the file's
 * size. RESULT_INPUT when the snapshot is gone or the offset beyond its end. */
result_t image_writer_read(image_writer_t *image_writer, uint64_t snapshot, uint64_t offset, void *bytes,
                           size_t *length, uint64_t *size);

/* The path of a job's final image, in fresh memory. */
char *image_writer_image_path(const char *data_dir, uint64_t job);
/* Deletes a job's images; what cannot be deleted is complained of. */
void image_writer_delete(const char *data_dir, uint64_t job);
/* The highest number of a job whose final image lies in the directory, 0 for none. */
uint64_t image_writer_last_job(const char *data_dir);

#endif
