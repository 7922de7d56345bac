/* watch_films: sees the master's checkpoints begin and end, as soon as the kernel does. */
#ifndef LIGHTMILL_WATCH_FILMS_H
#define LIGHTMILL_WATCH_FILMS_H

#include <stdbool.h>

typedef enum { FILM_NOTHING, FILM_BEGINS, FILM_IS_THERE } film_event_t;

typedef struct {
    int file;
    char *folder; /* DATA/films */
} film_watch_t;

/* Watches the films of a data directory; makes the folder if it is not there. */
void film_watch_open(film_watch_t *watch, const char *data);
void film_watch_close(film_watch_t *watch);
/* The next event, waiting for it at most so many seconds. */
film_event_t film_watch_wait(film_watch_t *watch, double seconds);
/* True when a checkpoint lies there half written. */
bool film_watch_torn(const film_watch_t *watch);

#endif
