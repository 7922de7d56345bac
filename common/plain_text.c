/* plain_text: see plain_text.h. */
#include "common/plain_text.h"

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

size_t plain_text_utf8(const char *text)
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

static bool within(uint32_t code, uint32_t first, uint32_t last)
{
    return code >= first && code <= last;
}

/* The bidirectional controls are those of Unicode's annex 9: marks (U+061C, U+200E, U+200F), embeddings and
 * overrides (U+202A to U+202E), isolates (U+2066 to U+2069). U+2028 and U+2029 end lines. */
static bool is_harmful(uint32_t code)
{
    return code < 0x20 || within(code, 0x7F, 0x9F) || code == 0x061C || within(code, 0x200E, 0x200F) ||
           within(code, 0x2028, 0x202E) || within(code, 0x2066, 0x2069);
}

size_t plain_text_character(const char *text)
{
    const uint8_t *b = (const uint8_t *)text;
    size_t length = plain_text_utf8(text);
    /* None of the harmful ones has more than three bytes. */
    uint32_t code = length == 1   ? b[0]
                    : length == 2 ? (uint32_t)(b[0] & 0x1F) << 6 | (b[1] & 0x3F)
                    : length == 3
                        ? (uint32_t)(b[0] & 0x0F) << 12 | (uint32_t)(b[1] & 0x3F) << 6 | (b[2] & 0x3F)
                        : UINT32_MAX;
    return length > 0 && is_harmful(code) ? 0 : length;
}

void plain_text_clean(char *text)
{
    char *end = text;
    while (*text != '\0') {
        size_t sound = plain_text_utf8(text), shown = plain_text_character(text);
        if (shown > 0)
            memmove(end, text, shown);
        else
            *end = '?';
        end += shown > 0 ? shown : 1;
        text += sound > 0 ? sound : 1;
    }
    *end = '\0';
}
