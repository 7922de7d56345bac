/* display: a job whose image so far is shown in an image viewer, while somebody else watches the job.
 *
 * DESIGN. A thread of its own, with a connection of its own to the master, fetches the image when there is a
 * viewer that has taken the last one, and something new to see. So nobody waits for the viewer, and without
 * one nothing is fetched. Making and reading an image takes time of the machine that renders, in `lightmill
 * render`: after each one the thread rests for PACE times as long as it took.
 */
#ifndef LIGHTMILL_DISPLAY_H
#define LIGHTMILL_DISPLAY_H

#include "client/farm/remote.h"

typedef struct display display_t;

/* Reads the address of the viewer, "HOST[:PORT]", and looks it up; errors as of viewer_open. With NULL
 * *display is NULL, which all other calls take: nothing is shown. */
result_t display_open(const char *address, display_t **display);
/* Begins to show a job under a name. `remote` is taken over, also on failure; nobody else may use it. */
result_t display_start(display_t *display, remote_t *remote, uint64_t job, const char *name);
/* Says how far the job is: its image has changed when it has another number of samples. */
void display_tell(display_t *display, uint64_t samples_done, bool final);
/* True when there is something to tell people, once for each; it is put into `text`. */
bool display_news(display_t *display, char text[500]);
/* After the job has ended: waits until the viewer has its last image. RESULT_UNREACHABLE when it does not get
 * it: after `stall` seconds without any progress, or `limit` seconds in all. A viewer that is not there is
 * waited for only when `absent` is true. RESULT_CANCELLED after Ctrl-C. Logs what there is to tell. */
result_t display_finish(display_t *display, double stall, double limit, bool absent);
/* Ends the thread and frees all; sets *display to NULL. */
void display_close(display_t **display);

#endif
