/* text: see text.h. */
#include "common/text/text.h"

#include "common/base.h"
#include "common/plain_text.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

/* Prints the next character and moves on; returns how many columns it took. */
static int print_character(const char **text)
{
    size_t length = plain_text_character(*text);
    bool plain = length > 0;
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
        size_t length = plain_text_utf8(text);
        size_t size = length > 0 ? length : sizeof replacement - 1;
        memcpy(end, length > 0 ? text : replacement, size);
        end += size;
        text += length > 0 ? length : 1;
    }
    *end = '\0';
    return copy;
}
