/* journal: the jobs of a master and their history, in SQLite. */
#ifndef LIGHTMILL_JOURNAL_H
#define LIGHTMILL_JOURNAL_H

#include "master/farm.h"

typedef struct journal journal_t;

#endif
