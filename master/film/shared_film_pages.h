/* shared_film_pages: what a shared film is made of, and how sums get into its pages; for shared_film*.c
 * alone. */
#ifndef LIGHTMILL_SHARED_FILM_PAGES_H
#define LIGHTMILL_SHARED_FILM_PAGES_H

#include "master/film/shared_film.h"

#include <pthread.h>

typedef struct {
    pthread_mutex_t lock; /* guards the page's part of the film, and what follows */
    bool wanted;          /* by the snapshot, which has not read it yet */
    uint8_t *copy;        /* of what it was like then; NULL: it has not changed since */
} page_t;

struct shared_film {
    film_t *film;
    pthread_rwlock_t lock;        /* mergers hold it for reading, readers for writing */
    pthread_mutex_t counting;     /* guards film->counts */
    size_t first_page[FILM_SUMS]; /* of each of the sums */
    page_t *pages;
    size_t page_count;
};

typedef enum {
    ADD_STRICT,   /* stops before the first sum that would leave the range of the film */
    ADD_TOLERANT, /* leaves such sums out, and counts them */
    ADD_EXACT,    /* undoes or repeats what went well before: no sum is looked at */
    ADD_NOTHING   /* for who only wants to see whether the values can be read */
} add_mode_t;

/* Adds to a film, one page locked at a time. What it does is a series of steps, each of which is done whole
 * or not at all, so that the same series with the other sign, up to the same step, takes all of it back. */
typedef struct {
    shared_film_t *shared_film;
    add_mode_t mode;
    bool negative;         /* subtracts; ADD_EXACT only */
    uint64_t steps, limit; /* done, and to be done at most */
    uint64_t overflows;    /* sums that were left out; in ADD_STRICT 1: stopped by one */
    size_t held;           /* the page that is locked; SIZE_MAX: none */
} adder_t;

adder_t adder_new(shared_film_t *shared_film, add_mode_t mode, bool negative, uint64_t limit);
/* Lets go of the page that is locked: to be called before anything that takes long. */
void adder_rest(adder_t *adder);
/* These add to one of the sums, from value `first` on. `large`: some values may be out of the range of the
 * film (+-2^62); otherwise they are far inside. False when the adder stopped: at the limit, or at an
 * overflow. */

/* Adds to those of up to 64 pixels of three values that are marked; `values` has theirs alone. */
bool adder_add_marked(adder_t *adder, sum_kind_t kind, size_t first, uint64_t mask, const int64_t *values,
                      bool large);
/* Adds to `lanes` values of each of `count` pixels that are `stride` values apart, the first of them at
 * `first`. */
bool adder_add_strided(adder_t *adder, sum_kind_t kind, size_t first, size_t stride, size_t lanes,
                       const int64_t *values, size_t count);
/* Adds the same number to `count` entries of the sample counts. */
bool adder_count(adder_t *adder, size_t first, uint32_t samples, size_t count);

#endif
