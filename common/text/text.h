/* text: strings of unknown origin on the way to a terminal or into JSON (json.h). */
#ifndef LIGHTMILL_TEXT_H
#define LIGHTMILL_TEXT_H

/* Prints to stdout with bytes that are not UTF-8, and those of characters that must not be shown
 * (common/plain_text.h), as \xNN, so that a file cannot command the terminal. */
void text_print(const char *text);
/* The same for a column of a table: at most `width` characters, filled up with blanks. */
void text_print_cell(const char *text, int width);
/* The text with every byte that is not UTF-8 replaced by U+FFFD, in fresh memory. */
char *text_utf8(const char *text);

#endif
