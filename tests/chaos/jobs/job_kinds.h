/* job_kinds: what the jobs of a run render. Each takes a few seconds of one core when nobody disturbs it. */
#ifndef LIGHTMILL_JOB_KINDS_H
#define LIGHTMILL_JOB_KINDS_H

#include "tests/chaos/words.h"

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    const char *name;
    const char
        *options[12];      /* of submit and render: what the image depends on, but the seed and the samples */
    const char *terms[6];  /* of submit alone */
    unsigned spp;          /* samples a pixel; 0: the options say when it ends, */
    unsigned extended_spp; /* and to so many it is extended when it is done; 0: it is not */
    bool paused;           /* it is paused and resumed on the way */
    bool deleted;          /* when it is proved, which makes room on the disk */
} job_kind_t;

enum { JOB_KINDS = 14 };
extern const job_kind_t JOB_KIND_LIST[JOB_KINDS];

/* Where the numbers of a command line lie as text. */
typedef struct {
    char spp[16], seed[16];
} job_text_t;

/* Its samples a pixel divided by `smaller`, in text->spp. */
const char *job_kind_spp(const job_kind_t *kind, unsigned smaller, bool extended, job_text_t *text);
/* What the image depends on, for submit and render; some of the words lie in `text`. */
void job_kind_words(const job_kind_t *kind, unsigned smaller, unsigned seed, bool extended, words_t *words,
                    job_text_t *text);

#endif
