/* fields: see fields.h. */
#include "master/http/parse/fields.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

bool http_number_parse(const char *text, size_t length, uint64_t *value)
{
    *value = 0;
    if (length == 0 || length > 19) return false; /* 19 digits fit */
    for (size_t i = 0; i < length; i++) {
        if (text[i] < '0' || text[i] > '9') return false;
        *value = 10 * *value + (uint64_t)(text[i] - '0');
    }
    return true;
}

bool http_stops_parse(const char *text, int most, float *stops)
{
    char *end;
    double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(fabs(value) <= most)) return false;
    *stops = (float)value;
    return true;
}

/* *text moves behind the number. */
static bool read_number(const char **text, const char *before, uint64_t *number)
{
    size_t skip = strlen(before);
    if (strncmp(*text, before, skip) != 0) return false;
    *text += skip;
    size_t length = strspn(*text, "0123456789");
    bool good = http_number_parse(*text, length, number);
    *text += length;
    return good;
}

bool http_range_parse(const char *text, uint64_t *first, uint64_t *length, uint64_t *size)
{
    uint64_t last;
    bool good = read_number(&text, "bytes ", first) && read_number(&text, "-", &last) &&
                read_number(&text, "/", size) && *text == '\0' && *first <= last && last < *size;
    *length = good ? last - *first + 1 : 0;
    return good;
}

bool http_event_id_parse(const char *text, uint32_t life, uint64_t *number)
{
    char begin[16];
    snprintf(begin, sizeof begin, "%08" PRIx32 "-", life);
    size_t length = strlen(begin);
    return strncmp(text, begin, length) == 0 &&
           http_number_parse(text + length, strlen(text + length), number);
}
