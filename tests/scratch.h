/* scratch: a folder for the files of one test, and what tests ask about files. Calls end the test on failure.
 */
#ifndef LIGHTMILL_SCRATCH_H
#define LIGHTMILL_SCRATCH_H

#include <stddef.h>
#include <stdint.h>

/* A new empty folder under $TMPDIR or /tmp; free with scratch_destroy, which removes it with all in it. */
char *scratch_new(void);
void scratch_destroy(char **folder);
/* "folder/name" in fresh memory. */
char *scratch_path(const char *folder, const char *name);
void scratch_write(const char *path, const void *data, size_t size);
/* A PFM image "folder/name": a smooth pattern with a dark part and one bright pixel, `spot` above the rest.
 */
void scratch_write_light_image(const char *folder, const char *name, int width, int height, float spot);
/* The whole file in fresh memory. */
uint8_t *scratch_read(const char *path, size_t *size);
/* How many files are in the folder. */
size_t scratch_count(const char *folder);

/* Sends a stream (1: stdout, 2: stderr) to a file until scratch_uncapture, whose text is in fresh memory. */
typedef struct {
    int stream, saved;
    char *path;
} scratch_capture_t;
scratch_capture_t scratch_capture(const char *folder, int stream);
char *scratch_uncapture(scratch_capture_t *capture);

#endif
