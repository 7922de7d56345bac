/* number: decimal text to double, quickly and correctly rounded.
 *
 * Scene files are mostly numbers. Those with at most 2^53 as significand and a power of ten within 10^+-22
 * (all that a program prints with nine digits) are converted exactly with one multiplication or division
 * (Clinger 1990, "How to Read Floating Point Numbers Accurately"); the rest goes to strtod.
 */
#ifndef LIGHTMILL_NUMBER_H
#define LIGHTMILL_NUMBER_H

#include <stdint.h>

/* Reads a number that starts at `text` and ends before `end`. Returns the first byte behind it, or NULL when
 * there is no finite number. "nan", "inf" and hexadecimal are not numbers. */
const char *number_parse(const char *text, const char *end, double *value);

/* Of files of numbers alone, with blanks between them, in which '#' starts a comment up to the line's end:
 * where the next number, or what stands in its place, begins, from `text` on; NULL when there is none before
 * `end`. *line goes up with the lines that end on the way. */
const char *number_find(const char *text, const char *end, uint32_t *line);
/* As number_parse, of a number of such a file: NULL also when a blank, a comment or `end` does not follow. */
const char *number_parse_alone(const char *text, const char *end, double *value);

#endif
