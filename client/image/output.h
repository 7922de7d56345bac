/* output: where an image goes: an EXR, a PNG, or both. */
#ifndef LIGHTMILL_OUTPUT_H
#define LIGHTMILL_OUTPUT_H

#include "common/image/image.h"
#include "common/job.h"
#include "common/options/options.h"

typedef struct {
    const char *path;         /* -o: .exr, or .png for a PNG alone; NULL: to be named after the scene */
    const char *png;          /* --png: a PNG as well, or NULL */
    double exposure;          /* of PNGs, stops */
    bool half;                /* EXR in half floats */
    bool halves;              /* with the two halves of the picture as layers; not an option of its own here:
                                 only some commands can have them */
    char *own_path, *own_png; /* of output_name, owned */
} output_t;

extern const option_group_t output_options;

/* Names what the command line did not: the image after the scene, and with `strategies` a contact sheet
 * beside it. The caller frees the names with output_free. */
void output_name(output_t *output, const char *scene, bool strategies);
void output_free(output_t *output);
/* The same output for an image that is kept at `spp` samples a pixel: a.exr becomes a-0016.exr, and so does
 * the PNG. The caller frees the names with output_free. */
output_t output_at(const output_t *output, uint32_t spp);
/* True for the name of a PNG. */
bool output_is_png(const char *path);
/* Checks, before any work is done, that a file can be written; that all of them can. */
result_t output_writable(const char *path);
result_t output_check(const output_t *output);
/* The same for the images that are kept on the way. */
result_t output_check_saves(const output_t *output, const save_at_t *save_at);
/* Writes the files from the bytes of an EXR, each whole or not at all. `path` must be set. *noise becomes the
 * image's estimated relative error (common/film/film.h), negative when it is not known. */
result_t output_write(const output_t *output, const uint8_t *exr, size_t size, double *noise);
/* Writes the PNGs alone: --png, and the output itself when it is one. */
result_t output_write_pngs(const output_t *output, const image_t *image);

#endif
