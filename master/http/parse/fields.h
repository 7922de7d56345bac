/* fields: what single fields of a request say: numbers, ranges, the ids of events. */
#ifndef LIGHTMILL_HTTP_FIELDS_H
#define LIGHTMILL_HTTP_FIELDS_H

#include "common/base.h"

/* A whole number in decimal digits; false when it is none. */
bool http_number_parse(const char *text, size_t length, uint64_t *value);
/* A number of stops (powers of two) from -most to most; false when it is none. */
bool http_stops_parse(const char *text, int most, float *stops);
/* "bytes FIRST-LAST/SIZE" (Content-Range, RFC 9110, 14.4): where a part lies, and how long the whole is.
 * False when it is none such. */
bool http_range_parse(const char *text, uint64_t *first, uint64_t *length, uint64_t *size);
/* "1234abcd-17": the number of an event of this life of the master; false when the id is none such. */
bool http_event_id_parse(const char *text, uint32_t life, uint64_t *number);

#endif
