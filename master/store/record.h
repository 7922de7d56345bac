/* record: the record of a job (job_record.h) as bytes on a disk, and back (master/store/record.proto). */
#ifndef LIGHTMILL_RECORD_H
#define LIGHTMILL_RECORD_H

#include "master/store/job_record.h"
#include "master/store/record.pb-c.h"

/* What decoding a record, or what else of a job lies on a disk, may allocate, in bytes (wire_allocator). */
enum { RECORD_MAX_DECODED = 1 << 20 };

/* A record as a message that points into it and into the parts beside it. */
typedef struct {
    Lm__JobRecord message;
    Lm__Settings settings;
    Lm__Terms terms;
    Lm__Account account;
    Lm__Counts counts;
} record_message_t;

/* The record must outlive the message. */
void record_put(const job_record_t *record, record_message_t *out);
/* RESULT_INPUT, naming what is wrong, unless all of it is what a job can be. */
result_t record_get(const Lm__JobRecord *message, job_record_t *record);

/* The same as bytes, in fresh memory that the caller frees. */
uint8_t *record_pack(const job_record_t *record, size_t *size);
result_t record_unpack(const void *bytes, size_t size, job_record_t *record);

#endif
