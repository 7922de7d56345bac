/* prepared: batches of a film that is really rendered, once, for workers that only pretend to render.
 *
 * A worker that has been at it for longer has hit more pixels of the splat frame, so there are frames of
 * several densities. They are encoded once and sent again and again, without being copied. */
#ifndef LIGHTMILL_PREPARED_H
#define LIGHTMILL_PREPARED_H

#include "common/scene/scene_blob.h"
#include "proto/wire/wire.h"

typedef struct prepared prepared_t;

/* Renders the scene in a file for so many CPU seconds of one thread. `settings` are what the job will have.
 */
result_t prepared_new(const char *scene, int width, int height, double seconds, bool learn,
                      prepared_t **prepared);
/* No message of it is in use any more. */
void prepared_destroy(prepared_t **prepared);

const scene_blob_t *prepared_blob(const prepared_t *prepared);
const job_settings_t *prepared_settings(const prepared_t *prepared);
/* Pixel samples a CPU second. */
double prepared_speed(const prepared_t *prepared);
/* Share of the splat frame that so many CPU seconds of rendering hit, and bytes of the frame on the wire. */
double prepared_density(const prepared_t *prepared, double seconds);
size_t prepared_bytes(const prepared_t *prepared, double seconds);

/* Opens the payloads of a batch of these units, as if they had taken so many CPU seconds. Thread-safe. */
void prepared_payloads(prepared_t *prepared, const unit_t *units, size_t count, double seconds,
                       zmq_msg_t payload[BATCH_PAYLOADS]);

#endif
