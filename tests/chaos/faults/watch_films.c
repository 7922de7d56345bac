/* watch_films: see watch_films.h. A checkpoint is written as NAME.film.<something>.part and renamed. */
#include "tests/chaos/faults/watch_films.h"

#include "common/base.h"

#include <dirent.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <unistd.h>

void film_watch_open(film_watch_t *watch, const char *data)
{
    watch->folder = mem_printf("%s/films", data);
    mkdir(watch->folder, 0777);
    watch->file = inotify_init1(IN_CLOEXEC | IN_NONBLOCK);
    inotify_add_watch(watch->file, watch->folder, IN_CREATE | IN_MOVED_TO);
}

void film_watch_close(film_watch_t *watch)
{
    close(watch->file);
    free(watch->folder);
}

static bool is_part(const char *name)
{
    const char *end = strrchr(name, '.');
    return end && strcmp(end, ".part") == 0;
}

film_event_t film_watch_wait(film_watch_t *watch, double seconds)
{
    char bytes[8192] __attribute__((aligned(__alignof__(struct inotify_event))));
    struct pollfd item = {.fd = watch->file, .events = POLLIN};
    if (poll(&item, 1, (int)(1e3 * seconds)) <= 0) return FILM_NOTHING;
    ssize_t size = read(watch->file, bytes, sizeof bytes);
    film_event_t found = FILM_NOTHING;
    for (ssize_t at = 0; at < size;) {
        const struct inotify_event *event = (const struct inotify_event *)(bytes + at);
        if (event->len > 0 && event->mask & IN_CREATE && is_part(event->name)) found = FILM_BEGINS;
        if (event->len > 0 && event->mask & IN_MOVED_TO && !is_part(event->name)) found = FILM_IS_THERE;
        at += (ssize_t)(sizeof *event + event->len);
    }
    return found;
}

bool film_watch_torn(const film_watch_t *watch)
{
    DIR *entries = opendir(watch->folder);
    bool torn = false;
    if (entries == NULL) return false;
    for (const struct dirent *entry; (entry = readdir(entries)) != NULL;)
        torn = torn || is_part(entry->d_name);
    closedir(entries);
    return torn;
}
