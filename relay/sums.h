/* sums: adds up many batches of one job to one, exactly. Several threads may add at once. The caller closes a
 * sum only when no thread is adding to it. */
#ifndef LIGHTMILL_SUMS_H
#define LIGHTMILL_SUMS_H

#include "proto/wire/wire.h"

typedef struct sum sum_t;

/* A batch that is to be added: its tiles are decoded, its frames are not. */
typedef struct {
    batch_t batch;            /* units and counts are checked; without frames */
    const zmq_msg_t *payload; /* all BATCH_PAYLOADS, which are good */
} addend_t;

sum_t *sum_new(const job_settings_t *settings);
void sum_free(sum_t **sum);

/* Takes over a batch that has come, with units and counts and nothing else, reads its sums from the payloads,
 * and checks all of it against the job; tiles may take `limit` bytes. The addend points into the
 * payloads. To be freed with batch_free(&addend->batch), also after a failure. */
result_t sum_read(batch_t *batch, const zmq_msg_t payload[BATCH_PAYLOADS], const job_settings_t *settings,
                  uint64_t limit, addend_t *addend);
/* Adds it, and returns the bytes that the sum then takes. An addition that would overflow is left out and
 * counted, so that the job fails for it as it would have without a relay. */
size_t sum_add(sum_t *sum, const addend_t *addend);
/* What there is. */
batch_t *sum_batch(sum_t *sum);

#endif
