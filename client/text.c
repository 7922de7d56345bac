/* text: see text.h. */
#include "client/text.h"

#include <math.h>
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

void text_print(const char *text)
{
    while (*text != '\0') {
        size_t length = utf8_length(text);
        if (length == 0 || is_control(text)) {
            length = 1;
            printf("\\x%02x", (unsigned)(uint8_t)*text);
        } else {
            fwrite(text, 1, length, stdout);
        }
        text += length;
    }
}

void text_print_json(const char *text)
{
    putchar('"');
    while (*text != '\0') {
        size_t length = utf8_length(text);
        if (length == 0)
            fputs("\\ufffd", stdout);
        else if (*text == '"' || *text == '\\')
            printf("\\%c", *text);
        else if (is_control(text)) /* of one byte, or U+0080 and up, whose last byte is the code point's */
            printf("\\u%04x", (unsigned)(uint8_t)text[length - 1]);
        else
            fwrite(text, 1, length, stdout);
        text += length > 0 ? length : 1;
    }
    putchar('"');
}

void text_print_json_number(double value)
{
    if (isfinite(value))
        printf("%.9g", value);
    else
        fputs("null", stdout);
}
