/* master_calls: what the HTTP server asks of the master around it. The caller of http_server_start fills in
 * the functions, so that this folder needs none of the threads behind them. */
#ifndef LIGHTMILL_HTTP_MASTER_CALLS_H
#define LIGHTMILL_HTTP_MASTER_CALLS_H

#include "master/farm/farm.h"
#include "master/http/parse/bodies.h"
#include "proto/serve/gate.h"

/* Tells the outcome of a call, once, on some thread. `value` belongs to the call. */
typedef void (*http_done_fn)(void *ticket, const result_t *result, uint64_t value);

/* Which image of a job. */
typedef struct {
    uint64_t job;
    uint32_t at;    /* samples a pixel of a milestone; 0: the image as it is now */
    bool half;      /* half floats */
    bool halves;    /* with the two halves of the picture as layers */
    bool png;       /* a PNG instead of an OpenEXR file, */
    float exposure; /* brightened by so many stops */
} http_image_query_t;
/* Its file. */
typedef struct {
    int descriptor;   /* open for reading, the receiver's to close */
    uint64_t size;    /* bytes */
    uint64_t version; /* of the film that it shows, or of one before; 0 of a milestone */
    bool over;        /* it does not change any more, unless the job is extended */
} http_image_t;
/* Gives out an image, once, on some thread; *image is one only where the result is good. */
typedef void (*http_image_fn)(void *ticket, const result_t *result, const http_image_t *image);

/* A piece of a scene's blob of `size` bytes. */
typedef struct {
    hash_t blob;
    uint64_t offset, size;
    const void *bytes; /* kept by the caller until it is told of the outcome */
    size_t length;
} http_piece_t;

typedef struct {
    void *context; /* of the functions */
    farm_t *farm;  /* all are kept by the caller */
    gate_t *gate;  /* knows the names of keys; NULL: there are none */
    /* Carries out an order as one of `lightmill pause` is: `done` is called when it is safe on the disk, or
     * has failed. On a failure of the call itself `done` is not called. */
    result_t (*order)(void *context, const job_order_t *order, http_done_fn done, void *ticket);
    /* Submits a job: `done` is called with its number when it is safe on the disk, or with the failure.
     * RESULT_INPUT when the master does not have the scene, RESULT_USAGE when the settings do not fit. */
    result_t (*submit)(void *context, const http_submission_t *submission, http_done_fn done, void *ticket);
    /* Has a piece of a blob written: `done` is called with the offset from which to go on, the size when the
     * blob is complete and right. RESULT_INPUT when it is complete and wrong. */
    result_t (*put_blob)(void *context, const http_piece_t *piece, http_done_fn done, void *ticket);
    /* How many bytes of a blob are there, and whether these are all. */
    uint64_t (*find_blob)(void *context, const hash_t *blob, bool *complete);
    /* Has an image written: `done` is called when it is there, or cannot be: RESULT_INPUT when there is none.
     * On a failure of the call itself, RESULT_LIMIT, `done` is not called. */
    result_t (*image)(void *context, const http_image_query_t *query, http_image_fn done, void *ticket);
    /* The path of the image of a job that is over, in fresh memory. */
    char *(*image_path)(const char *data_dir, uint64_t job);
} http_master_t;

#endif
