/* json: what commands say to programs (--json), on jansson. */
#ifndef LIGHTMILL_JSON_H
#define LIGHTMILL_JSON_H

#include "common/base.h"

#include <jansson.h>

/* Strings and numbers of unknown origin: a byte that is not UTF-8 becomes U+FFFD; a number that is not finite
 * becomes null. */
json_t *json_text(const char *text);
json_t *json_number(double value);

/* Members of an object. A count is a string where it is beyond what JSON programs take for an integer. */
void put_text(json_t *object, const char *key, const char *text);
void put_real(json_t *object, const char *key, double value);
void put_count(json_t *object, const char *key, uint64_t count);
void put_flag(json_t *object, const char *key, bool flag);
void put_hash(json_t *object, const char *key, const hash_t *hash); /* NULL: an empty text */

/* Prints to stdout as one line (indent 0) or indented, in ASCII, so that no string can command a terminal,
 * with so many digits of each real number; frees the object. */
void json_print(json_t *object, int indent, int digits);

#endif
