/* number: see number.h. */
#include "client/import/files/number.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum { LONGEST_NUMBER = 320, MOST_DIGITS = 19, EXACT_POWER = 22 };

static const double powers[EXACT_POWER + 1] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                               1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                               1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* The general case: strtod over a terminated copy. */
static bool parse_slowly(const char *text, const char *end, double *value)
{
    char copy[LONGEST_NUMBER + 1];
    size_t length = (size_t)(end - text);
    if (length > LONGEST_NUMBER) return false;
    memcpy(copy, text, length);
    copy[length] = '\0';
    char *stop;
    *value = strtod(copy, &stop);
    return stop == copy + length && isfinite(*value);
}

const char *number_parse(const char *text, const char *end, double *value)
{
    const char *s = text;
    bool negative = s < end && *s == '-';
    if (s < end && (*s == '-' || *s == '+')) ++s;

    uint64_t significand = 0;
    int digits = 0, power = 0; /* digits counts significant ones: leading zeroes are free */
    bool any = false;
    for (; s < end && is_digit(*s); ++s, any = true) {
        if (digits < MOST_DIGITS) significand = significand * 10 + (uint64_t)(*s - '0');
        digits += digits > 0 || *s != '0';
    }
    if (s < end && *s == '.') {
        for (++s; s < end && is_digit(*s); ++s, any = true) {
            if (digits < MOST_DIGITS) {
                significand = significand * 10 + (uint64_t)(*s - '0');
                --power;
            }
            digits += digits > 0 || *s != '0';
        }
    }
    if (!any) return NULL;

    if (s < end && (*s == 'e' || *s == 'E')) {
        const char *e = s + 1;
        bool minus = e < end && *e == '-';
        if (e < end && (*e == '-' || *e == '+')) ++e;
        if (e == end || !is_digit(*e)) return NULL;
        int exponent = 0;
        for (; e < end && is_digit(*e); ++e)
            if (exponent < 100000) exponent = exponent * 10 + (*e - '0');
        power += minus ? -exponent : exponent;
        s = e;
    }

    bool exact = digits <= MOST_DIGITS && significand <= (uint64_t)1 << 53;
    if (exact && power >= -EXACT_POWER && power <= EXACT_POWER) {
        double magnitude =
            power < 0 ? (double)significand / powers[-power] : (double)significand * powers[power];
        *value = negative ? -magnitude : magnitude;
        return s;
    }
    return parse_slowly(text, s, value) ? s : NULL;
}

static bool is_blank(char c)
{
    return c == ' ' || (c >= '\t' && c <= '\r');
}

const char *number_find(const char *text, const char *end, uint32_t *line)
{
    for (; text < end; ++text) {
        if (*text == '#') text = memchr(text, '\n', (size_t)(end - text));
        if (!text) return NULL;
        if (!is_blank(*text)) return text;
        *line += *text == '\n';
    }
    return NULL;
}

const char *number_parse_alone(const char *text, const char *end, double *value)
{
    const char *behind = number_parse(text, end, value);
    return behind && (behind == end || is_blank(*behind) || *behind == '#') ? behind : NULL;
}
