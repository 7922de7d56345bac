/* plain_text: text from outside (names of workers, jobs and scenes, what a peer says, what a file holds) on
 * its way to a log, a terminal or a page. It must neither command a terminal nor begin a line of its own nor
 * turn round what stands beside it. */
#ifndef LIGHTMILL_PLAIN_TEXT_H
#define LIGHTMILL_PLAIN_TEXT_H

#include <stddef.h>

/* Bytes of the UTF-8 sequence at `text` (RFC 3629: no overlong forms, no surrogates), 0 when it is malformed.
 */
size_t plain_text_utf8(const char *text);
/* The same, and 0 also for what must not be shown as it is: control characters (C0, DEL, C1, which some
 * terminals obey), separators of lines and paragraphs, and characters that change the direction of writing.
 */
size_t plain_text_character(const char *text);
/* Puts '?' in the place of each character, and each byte, of which the above is 0. The text does not grow. */
void plain_text_clean(char *text);

#endif
