/* remote: the client's side of the protocol: questions to a master and their answers.
 *
 * Every call asks and waits for the answer, at most `timeout` seconds (longer where the master has long work
 * to do: making an image, checking a large scene). RESULT_UNREACHABLE names the address and the cure; the
 * call may be made again and again, since nothing of what was not answered stays queued. A Refusal becomes a
 * result with the master's own code and reason; RESULT_DENIED says that the keys do not fit, as soon as that
 * is seen. One thread at a time.
 */
#ifndef LIGHTMILL_REMOTE_H
#define LIGHTMILL_REMOTE_H

#include "common/scene/scene_blob.h"
#include "proto/wire/dial.h"
#include "proto/wire/wire.h"

typedef struct remote remote_t;

/* The default of --timeout, seconds. */
#define REMOTE_DEFAULT_TIMEOUT 5.0

/* Connects to "tcp://host:port" or "inproc://name". `bulk_endpoint` may be NULL on TCP: the master tells its
 * port with the first status. `context` NULL: one is made. Strings are copied. Nothing is sent yet. */
result_t remote_open(void *context, const char *control_endpoint, const char *bulk_endpoint, double timeout,
                     remote_t **remote);
/* The same with keys, which are taken over and freed; NULL: none. */
result_t remote_open_with(void *context, const char *control_endpoint, const char *bulk_endpoint,
                          double timeout, dial_keys_t *keys, remote_t **remote);
/* Closes the sockets and sets *remote to NULL. */
void remote_close(remote_t **remote);

/* Told how many bytes of how many are across. */
typedef void (*remote_progress_fn)(void *context, uint64_t done, uint64_t size);

/* Puts a blob into the master's store, unless it is there; goes on where an earlier upload ended. */
result_t remote_put_blob(remote_t *remote, const scene_blob_t *blob, remote_progress_fn progress,
                         void *progress_context);
/* Submits a job whose blob is in the store. A master that is too old to keep images at settings->save_at, or
 * with terms->halves, is warned of; the job is submitted without them. */
result_t remote_submit_job(remote_t *remote, const job_terms_t *terms, const job_settings_t *settings,
                           const hash_t *blob, uint64_t *job);
/* The same with nothing but a name (cut to JOB_MAX_NAME) as its terms. */
result_t remote_submit(remote_t *remote, const char *name, const job_settings_t *settings, const hash_t *blob,
                       uint64_t *job);
/* The state of a job, or of all jobs when `job` is 0: the answer is message->envelope->job_status_reply, and
 * the caller frees the message with wire_free. With a job the reply holds exactly that one. */
result_t remote_status(remote_t *remote, uint64_t job, wire_message_t *message);
/* The state of one job with the history of its error (JobStatus.history), which a master that knows none
 * leaves empty. */
result_t remote_history(remote_t *remote, uint64_t job, wire_message_t *message);
/* All workers: the answer is message->envelope->worker_list, freed likewise. */
result_t remote_workers(remote_t *remote, wire_message_t *message);
/* Has something done with a job. */
result_t remote_order(remote_t *remote, const job_order_t *order);
result_t remote_cancel(remote_t *remote, uint64_t job);
/* Has something done with workers; *count is to how many it was done. */
result_t remote_order_workers(remote_t *remote, worker_order_t kind, const char *who, uint32_t *count);
/* Which image of a job. */
typedef struct {
    uint64_t job;
    uint32_t at; /* the one kept at so many samples a pixel (job_settings_t.save_at); 0: as it is now */
    bool half;   /* half floats */
    bool halves; /* with the two halves of the picture as layers */
    /* Told, about once a second, how the master gets on: how many images of others it makes before, and how
     * much of this one it has made, 0 to 1; and then how many bytes of it are here. NULL: not told. */
    void (*making)(void *context, uint32_t before, double share);
    remote_progress_fn fetching;
    void *context; /* of both */
} image_wish_t;
/* An image of a job, as the bytes of an EXR file; the caller frees *bytes. RESULT_INPUT when it is not there
 * (yet). While the master says that it gets on with the image, the call waits. */
result_t remote_fetch_image(remote_t *remote, const image_wish_t *wish, uint8_t **bytes, size_t *size);

#endif
