/* job_record: a job as it outlives the process. Each job of the farm holds one, the journal and every
 * checkpoint keep copies (record.h turns them into bytes), a restart gives them back. */
#ifndef LIGHTMILL_JOB_RECORD_H
#define LIGHTMILL_JOB_RECORD_H

#include "master/schedule/schedule.h"
#include "proto/wire/wire.h"

typedef struct {
    uint64_t job;
    job_terms_t terms;
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    job_state_t state;   /* JOB_FINISHING when its image is still due */
    job_state_t outcome; /* of one that is finishing */
    bool retained;
    bool removed;               /* deleted or forgotten: its record and its files are to go */
    hash_t fingerprint;         /* of the machines that may work on it; all zero: none yet */
    double elapsed;             /* seconds of work on it so far */
    double submitted, finished; /* seconds since 1970; 0: not yet */
    uint64_t bytes, batches, batches_refused, units_reissued, checks_passed, checks_failed;
    uint32_t workers_seen;
    uint64_t samples_done; /* pixel samples; with the next three for the status of a job without a film */
    schedule_account_t account; /* as it was when nothing was out */
    film_counts_t counts;       /* of the film */
    uint32_t saved;             /* samples a pixel of the last milestone whose image is written; 0: none */
    double error;               /* estimated relative error at the last fixed point; 0: not known */
    char message[500];
    job_state_t news; /* of which the operator is still to be told; 0: none (master/farm/news.c) */
} job_record_t;

#endif
