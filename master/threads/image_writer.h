/* image_writer: the thread that makes OpenEXR and PNG files of films, for finished jobs and for clients that
 * ask meanwhile. In between it estimates the errors of jobs.
 *
 * A finished job's image is DATA/job-<number>.exr and stays, and so do the images of its milestones
 * (job_settings_t.save_at), DATA/job-<number>-at-<samples>.exr, until the job is deleted. A client gets a
 * snapshot: a file in DATA/snapshots that is deleted a while after its last use. There are at most
 * IMAGE_WRITER_MAX_SNAPSHOTS. To resolve and compress a large film takes seconds; in a thread of its own it
 * delays neither heartbeats nor batches.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_IMAGE_WRITER_H
#define LIGHTMILL_IMAGE_WRITER_H

#include "master/farm/farm.h"
#include "master/threads/checkpointer.h"

enum {
    IMAGE_WRITER_MAX_SNAPSHOTS = 16,
    IMAGE_WRITER_MAX_WAITING = 64, /* requests for new snapshots at a time */
    IMAGE_WRITER_KEEP = 60         /* seconds after the last use of a snapshot */
};

typedef struct image_writer image_writer_t;

typedef struct {
    farm_t *farm;                 /* kept by the caller, outlives the image writer */
    const blob_store_t *blobs;    /* likewise; has the names for mattes */
    film_store_t *films;          /* likewise; of jobs that are over */
    checkpointer_t *checkpointer; /* makes room on a full disk; NULL: there is none */
    const char *data_dir;         /* copied */
    int image_wake;               /* the farm's eventfd */
    int answer_wake;              /* eventfd, written when image_writer_next_answer has something */
} image_writer_options_t;

/* Empties the snapshot directory and starts the thread. */
result_t image_writer_start(const image_writer_options_t *options, image_writer_t **image_writer);
/* Writes the images of all finished jobs that are still due, joins the thread, deletes the snapshots, frees
 * everything and sets *image_writer to NULL. */
void image_writer_stop(image_writer_t **image_writer);

/* How a snapshot is written. */
typedef struct {
    bool half;      /* EXR with half floats */
    bool halves;    /* EXR with the two halves of the picture */
    bool png;       /* not an EXR but a PNG, 8 bits sRGB, */
    float exposure; /* brightened by so many stops */
} image_format_t;

/* A file for who is told by a call. */
typedef struct {
    int descriptor;   /* open for reading, the receiver's to close */
    uint64_t size;    /* bytes */
    uint64_t version; /* of the film when it was asked for (farm_image_version); 0 of a milestone */
    bool over;        /* the job's last image, or a milestone's */
} image_file_t;

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
