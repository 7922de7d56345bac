/* references: the images that jobs have to give: the same settings in `lightmill render`, which nobody
 * disturbs. Each is rendered once, in the background, when a job first needs it. */
#ifndef LIGHTMILL_REFERENCES_H
#define LIGHTMILL_REFERENCES_H

#include "tests/chaos/command.h"
#include "tests/chaos/jobs/job_kinds.h"
#include "tests/chaos/report.h"

enum { MAX_REFERENCES = 200 };

typedef struct {
    const job_kind_t *kind;
    unsigned seed;
    bool extended;
    command_t render;
    char *image; /* its file */
    bool ready;
    hash_t hash; /* of its pixels, when it is ready */
} reference_t;

typedef struct {
    report_t *report;
    const char *folder; /* for images and logs */
    unsigned smaller;   /* what the samples of jobs are divided by */
    reference_t list[MAX_REFERENCES];
    size_t count;
} references_t;

/* The one for these settings; it may not be ready yet. It stays where it is. */
const reference_t *references_get(references_t *references, const job_kind_t *kind, unsigned seed,
                                  bool extended);
/* Notices what has been rendered. */
void references_tick(references_t *references, double now);
void references_free(references_t *references);

/* The hash of the pixels of an EXR file. */
result_t references_hash(const char *path, hash_t *hash);

#endif
