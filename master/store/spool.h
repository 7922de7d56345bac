/* spool: merged batches on the disk, as they came, until their job is over (trust/evidence.c).
 *
 * DIR/job-<number>/<clock>-<serial>.<kind> is one batch: who sent it, its units and counts, and its payload
 * frames, with checksums over both. Whatever may change is in the name, so that a change is a rename. Clock
 * and serial are 16 hexadecimal digits each. A batch that was taken out of the film also has the clock at
 * which that happened: <clock>-<serial>-<out>.out.
 *
 * Files are trusted no more than peers: whatever is read is checked against the job and the limits of wire.h.
 */
#ifndef LIGHTMILL_SPOOL_H
#define LIGHTMILL_SPOOL_H

#include "proto/wire/wire.h"

enum { SPOOL_MAX_PARTY = WIRE_MAX_ADDRESS + 10 };

typedef enum {
    SPOOL_KEPT,  /* in the film */
    SPOOL_CHECK, /* in the film, and being compared with another rendering */
    SPOOL_WRONG, /* in the film, and to be taken out */
    SPOOL_OUT,   /* taken out of the film */
    SPOOL_NONE   /* of no use: never the name of a file */
} spool_kind_t;

typedef struct {
    uint64_t clock, serial, out_clock;
    spool_kind_t kind;
    uint64_t bytes; /* of the file, in a list */
} spool_name_t;

/* What is known of a batch beside its sums. */
typedef struct {
    char name[JOB_MAX_NAME + 1];     /* of the sender */
    char party[SPOOL_MAX_PARTY + 1]; /* who is judged for it; a key alone in files of earlier versions */
    hash_t fingerprint;
    film_counts_t counts;
    unit_t *units;
    size_t unit_count;
} spool_head_t;

void spool_head_free(spool_head_t *head);

/* Bytes that the file of a batch takes. */
uint64_t spool_size(const spool_head_t *head, const zmq_msg_t payload[BATCH_PAYLOADS]);
/* Writes a batch; the folder is made if need be. Nothing is left behind on failure. */
result_t spool_write(const char *dir, uint64_t job, const spool_name_t *name, const spool_head_t *head,
                     const zmq_msg_t payload[BATCH_PAYLOADS]);
/* Reads who and what a batch is, and checks it against the job; the caller frees the head. */
result_t spool_read_head(const char *dir, uint64_t job, const spool_name_t *name,
                         const job_settings_t *settings, spool_head_t *head);
/* The same with the payloads, which the caller closes. */
result_t spool_read(const char *dir, uint64_t job, const spool_name_t *name, const job_settings_t *settings,
                    spool_head_t *head, zmq_msg_t payload[BATCH_PAYLOADS]);
/* RESULT_LIMIT: the disk is full, it may be possible later. */
result_t spool_rename(const char *dir, uint64_t job, const spool_name_t *from, const spool_name_t *to);
void spool_delete(const char *dir, uint64_t job, const spool_name_t *name);

/* The batches of a job, by clock and serial, in fresh memory that the caller frees; NULL and 0 when there are
 * none. Files of other names are left alone. */
spool_name_t *spool_list(const char *dir, uint64_t job, size_t *count);
/* The jobs that have a folder, likewise. */
uint64_t *spool_jobs(const char *dir, size_t *count);
/* Deletes the folder of a job with all that is in it. */
void spool_delete_job(const char *dir, uint64_t job);
/* All that was written, renamed and deleted is safe from a power cut when this returns. */
result_t spool_sync(const char *dir);

/* The head at the beginning of a file's bytes, checked, and where each payload lies in a file of `size`
 * bytes. `bytes` are the first `present` ones, at least the whole head. For spool_read, and for tests. */
result_t spool_decode(const uint8_t *bytes, size_t present, uint64_t size, uint64_t job,
                      const job_settings_t *settings, spool_head_t *head, uint64_t offset[BATCH_PAYLOADS],
                      uint64_t length[BATCH_PAYLOADS], hash_t *payload_hash);

#endif
