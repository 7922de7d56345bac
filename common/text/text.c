/* text: see text.h. */
#include "common/text/text.h"

#include "common/base.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

/* Bytes of the UTF-8 sequence at `text` (RFC 3629: no overlong forms, no surrogates), 0 when it is malformed.
 */
static size_t utf8_length(const char *text)
{
    const uint8_t *b = (const uint8_t *)text;
    size_t length = b[0] < 0x80   ? 1
                    : b[0] < 0xC2 ? 0
                    : b[0] < 0xE0 ? 2
                    : b[0] < 0xF0 ? 3
                    : b[0] < 0xF5 ? 4
                                  : 0;
    for (size_t i = 1; i < length; i++)
        if ((b[i] & 0xC0) != 0x80) return 0; /* also where the string ends */
    bool overlong = (b[0] == 0xE0 && b[1] < 0xA0) || (b[0] == 0xF0 && b[1] < 0x90);
    bool forbidden = (b[0] == 0xED && b[1] > 0x9F) || (b[0] == 0xF4 && b[1] > 0x8F);
    return length > 1 && (overlong || forbidden) ? 0 : length;
}

/* True for C0 controls, DEL, and C1 controls (U+0080 to U+009F, which some terminals obey). */
static bool is_control(const char *text)
{
    const uint8_t *b = (const uint8_t *)text;
    return b[0] < 0x20 || b[0] == 0x7F || (b[0] == 0xC2 && b[1] < 0xA0);
}

/* Prints the next character and moves on; returns how many columns it took. */
static int print_character(const char **text)
{
    size_t length = utf8_length(*text);
    bool plain = length > 0 && !is_control(*text);
    if (plain)
        fwrite(*text, 1, length, stdout);
    else
        printf("\\x%02x", (unsigned)(uint8_t) * *text);
    *text += plain ? length : 1;
    return plain ? 1 : 4;
}

void text_print(const char *text)
{
    while (*text != '\0') print_character(&text);
}

void text_print_cell(const char *text, int width)
{
    while (*text != '\0' && width > 0) width -= print_character(&text);
    for (; width > 0; width--) putchar(' ');
}

char *text_utf8(const char *text)
{
    static const char replacement[] = "\xEF\xBF\xBD";
    char *copy = mem_alloc(3 * strlen(text) + 1), *end = copy;
    while (*text != '\0') {
        size_t length = utf8_length(text);
        size_t size = length > 0 ? length : sizeof replacement - 1;
        memcpy(end, length > 0 ? text : replacement, size);
        end += size;
        text += length > 0 ? length : 1;
    }
    *end = '\0';
    return copy;
}
