/* output: where an image goes: an EXR, a PNG, or both. */
#ifndef LIGHTMILL_OUTPUT_H
#define LIGHTMILL_OUTPUT_H

#include "common/base.h"

#include <getopt.h>

typedef struct {
    const char *path; /* -o: .exr, or .png for a PNG alone; NULL: to be named after the scene */
    const char *png;  /* --png: a PNG as well, or NULL */
    double exposure;  /* of PNGs, stops */
    bool half;        /* EXR in half floats */
} output_t;

/* Entries for a getopt_long table; -o is its one short option. */
#define OUTPUT_OPTIONS                                                                                       \
    {"output", required_argument, NULL, 'o'}, {"png", required_argument, NULL, 0},                           \
        {"exposure", required_argument, NULL, 0},                                                            \
    {                                                                                                        \
        "half", no_argument, NULL, 0                                                                         \
    }
extern const char output_usage[];

/* Takes an option of OUTPUT_OPTIONS; *taken is false when it is another one. `value` is kept. */
result_t output_option(output_t *output, const char *option, const char *value, bool *taken);
/* True for the name of a PNG. */
bool output_is_png(const char *path);
/* Checks, before any work is done, that a file can be written; that all of them can. */
result_t output_writable(const char *path);
result_t output_check(const output_t *output);
/* Writes the files from the bytes of an EXR, each whole or not at all. `path` must be set. *noise becomes the
 * image's estimated relative error (common/film/film.h), negative when it is not known. */
result_t output_write(const output_t *output, const uint8_t *exr, size_t size, double *noise);

#endif
