/* lines: text files that say one thing a line, as Wavefront's OBJ and MTL do: a keyword, then words.
 *
 * '#' behind a blank starts a comment that ends with its line (names may have one within); a backslash at the
 * end of a line joins the next one to it.
 * The file is in memory; lines and words point into it.
 */
#ifndef LIGHTMILL_LINES_H
#define LIGHTMILL_LINES_H

#include "client/import/scene/report.h"

/* A file on its way; `path` and the bytes are kept by the caller. */
typedef struct {
    const char *path, *cursor, *end;
    uint32_t line; /* the number of the next line */
} lines_t;

typedef struct {
    const char *text;
    size_t length;
} word_t;

/* What is left of a line behind its keyword. */
typedef struct {
    word_t keyword;
    const char *cursor, *end;
    position_t at; /* of the keyword */
} line_t;

/* How many bytes the mark takes that some programs put before text in UTF-8: 3, or 0 without one. */
size_t byte_order_mark(const char *data, size_t size);

lines_t lines_begin(const char *path, const char *data, size_t size);
/* The next line that has a keyword; false at the end of the file. */
bool lines_next(lines_t *lines, line_t *line);

/* The next word of the line; false at its end. */
bool line_word(line_t *line, word_t *word);
/* The next word as a number; false, and the line as it was, where it is none. */
bool line_number(line_t *line, double *value);
/* Everything that is left, without blanks at either end: names may have blanks within. */
word_t line_rest(line_t *line);

bool word_is(word_t word, const char *text);
enum { WORD_QUOTE_SIZE = 48 };
/* The word for messages, shortened. */
const char *word_quote(word_t word, char out[WORD_QUOTE_SIZE]);

#endif
