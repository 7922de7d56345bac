/* tell: --notify of the commands that see a job through: who is told, from this machine, that it is over. */
#ifndef LIGHTMILL_TELL_H
#define LIGHTMILL_TELL_H

#include "common/notify/notify.h"

typedef struct {
    const char *target; /* a URL or a command (common/notify/notify.h); NULL: nobody */
} tell_t;

extern const option_group_t tell_options;

/* RESULT_USAGE when somebody is to be told by a command that does not wait for the end. */
result_t tell_check(const tell_t *tell, bool waits);
/* Tells, if anybody is to be told; tries for a minute. A failure is an error in the log, and none of the
 * command: the image is there. */
void tell_news(const tell_t *tell, const news_t *news);

#endif
