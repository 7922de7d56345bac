/* news: what is told of a job that is over or waits for somebody, for notify.h: as JSON, and as variables of
 * a command's environment.
 *
 * Names and messages come from clients. Control characters in them become blanks, so that none begins a new
 * line in the head of an e-mail, and what is not UTF-8 becomes question marks. */
#ifndef LIGHTMILL_NEWS_H
#define LIGHTMILL_NEWS_H

#include "common/base.h"

typedef struct {
    uint64_t job;        /* its number */
    const char *name;    /* of the job */
    const char *state;   /* "done" */
    const char *message; /* why it failed or waits; empty: nothing is to be said */
    uint64_t samples;    /* pixel samples that were counted */
    double spp;          /* the same, a pixel */
    double error;        /* estimated relative error; <= 0: not known */
    double elapsed;      /* seconds of work */
    const char *image;   /* absolute path on this machine; NULL: there is none */
} news_t;

/* A JSON object in one line, in fresh memory that the caller frees. Beside the fields above it has `text`, a
 * sentence, and `host`, the name of this machine. */
char *news_json(const news_t *news);
/* The environment of this process and a variable LIGHTMILL_... for each key of the object; a null is empty.
 * LIGHTMILL_NOTIFY is left out: a command that renders would tell of itself. Freed with
 * news_environment_free.
 */
char **news_environment(const news_t *news);
void news_environment_free(char **environment);

#endif
