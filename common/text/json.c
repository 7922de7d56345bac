/* json: see json.h. */
#include "common/text/json.h"

#include "common/text/text.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

json_t *json_text(const char *text)
{
    char *clean = text_utf8(text);
    json_t *value = json_string(clean);
    free(clean);
    return value;
}

json_t *json_number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

void put_text(json_t *object, const char *key, const char *text)
{
    json_object_set_new(object, key, json_text(text));
}

void put_real(json_t *object, const char *key, double value)
{
    json_object_set_new(object, key, json_number(value));
}

void put_count(json_t *object, const char *key, uint64_t count)
{
    char digits[32];
    snprintf(digits, sizeof digits, "%" PRIu64, count);
    json_object_set_new(object, key,
                        count <= INT64_MAX ? json_integer((json_int_t)count) : json_string(digits));
}

void put_flag(json_t *object, const char *key, bool flag)
{
    json_object_set_new(object, key, json_boolean(flag));
}

void put_hash(json_t *object, const char *key, const hash_t *hash)
{
    char hex[2 * HASH_BYTES + 1] = "";
    if (hash != NULL) hash_to_hex(hash, hex);
    put_text(object, key, hex);
}

void json_print(json_t *object, int indent, int digits)
{
    json_dumpf(object, stdout, JSON_INDENT((size_t)indent) | JSON_REAL_PRECISION(digits) | JSON_ENSURE_ASCII);
    putchar('\n');
    json_decref(object);
}
