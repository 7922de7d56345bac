/* viewer: an image viewer at the other end of a TCP connection, which is shown one image as it changes.
 *
 * DESIGN. Nobody waits for a viewer: the socket does not block, and the next tile is only prepared when the
 * last one is gone, so a viewer that never reads costs the memory of one image and no time. Of each channel
 * of each tile the hash is kept that was sent last; what has it still is not sent again. A connection that
 * ends is tried again and again, ever less often, and a new one begins with the whole image. One thread at a
 * time.
 */
#ifndef LIGHTMILL_VIEWER_H
#define LIGHTMILL_VIEWER_H

#include "common/image/image.h"

typedef struct viewer viewer_t;

enum { VIEWER_TILE = 64 }; /* pixels, the side of the squares that are sent */

/* Reads "HOST[:PORT]" and looks the host up. RESULT_USAGE for what is no address, RESULT_INPUT for a host
 * that nobody knows. Nothing is sent yet. */
result_t viewer_open(const char *address, viewer_t **viewer);
/* Ends the connection, harmless on NULL; the viewer keeps its image. Sets *viewer to NULL. */
void viewer_close(viewer_t **viewer);

/* Names the image of what is shown from now on; before the first image. The text is copied. */
void viewer_name(viewer_t *viewer, const char *name);
/* Shows this image, which is taken over; one that is still on its way is given up for it. Without a
 * connection it is lost. */
void viewer_show(viewer_t *viewer, image_t *image);
/* Connects, sends and notices a connection that has ended; waits for that at most `seconds`. */
void viewer_step(viewer_t *viewer, double seconds);

/* A number of the connection, other for each; 0 when there is none, or it is so young that it may be a tunnel
 * without a viewer behind it. */
uint64_t viewer_connection(const viewer_t *viewer);
/* True when the last attempt failed, or the connection ended, and there is no new one. */
bool viewer_away(const viewer_t *viewer);
/* True when nothing is on its way. An image that was shown is lost when the connection ends. */
bool viewer_idle(const viewer_t *viewer);
/* Bytes that the system has taken so far. */
uint64_t viewer_sent(const viewer_t *viewer);
/* "HOST:PORT", as long as the viewer lives. */
const char *viewer_label(const viewer_t *viewer);
/* True when there is something to tell people, once for each; it is put into `text`. */
bool viewer_news(viewer_t *viewer, char text[500]);

#endif
