/* item: see item.h. */
#include "client/import/gltf/item.h"

#include "common/plain_text.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- messages ------------------------------------------------------------------------------------------ */

static size_t append(char *text, size_t size, size_t used, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

static size_t append(char *text, size_t size, size_t used, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int added = used < size ? vsnprintf(text + used, size - used, format, arguments) : 0;
    va_end(arguments);
    return added > 0 ? used + (size_t)added : used;
}

static size_t append_way(const item_t *item, char *text, size_t size)
{
    if (!item->parent) return 0;
    size_t used = append_way(item->parent, text, size);
    if (item->key) return append(text, size, used, "%s%.60s", used ? "." : "", item->key);
    used = append(text, size, used, "[%zu]", item->index);
    const char *name = json_string_value(json_object_get(item->json, "name"));
    return name && *name ? append(text, size, used, " (%.60s)", name) : used;
}

void item_name(const item_t *item, char *text, size_t size)
{
    text[0] = '\0';
    append_way(item, text, size);
    plain_text_clean(text);
}

static void format_message(const item_t *item, char *text, size_t size, const char *format, va_list arguments)
{
    item_name(item, text, size / 2);
    size_t used = strlen(text);
    if (used) used = append(text, size, used, ": ");
    vsnprintf(text + used, size - used, format, arguments);
}

result_t item_fail(const item_t *item, const char *format, ...)
{
    char text[400];
    va_list arguments;
    va_start(arguments, format);
    format_message(item, text, sizeof text, format, arguments);
    va_end(arguments);
    return error_at((position_t){item->path, 0, 0}, "%s", text);
}

void item_warn(const item_t *item, const char *format, ...)
{
    char text[400];
    va_list arguments;
    va_start(arguments, format);
    format_message(item, text, sizeof text, format, arguments);
    va_end(arguments);
    report_warning(item->report, (position_t){item->path, 0, 0}, "%s", text);
}

/* ---- structure ----------------------------------------------------------------------------------------- */

static item_t child(const item_t *parent, const json_t *json, const char *key, size_t index)
{
    return (item_t){parent->path, parent->report, json, parent, key, index};
}

static result_t require_type(const item_t *item, json_type type)
{
    if (!item->json || json_typeof(item->json) == type) return result_ok();
    return item_fail(item, "must be %s",
                     type == JSON_OBJECT  ? "an object"
                     : type == JSON_ARRAY ? "an array"
                                          : "a string");
}

result_t item_member(const item_t *object, const char *key, json_type type, item_t *out)
{
    *out = child(object, json_object_get(object->json, key), key, 0);
    return require_type(out, type);
}

result_t item_element(const item_t *array, size_t index, json_type type, item_t *out)
{
    *out = child(array, json_array_get(array->json, index), NULL, index);
    return require_type(out, type);
}

size_t item_count(const item_t *array)
{
    return json_array_size(array->json);
}

result_t item_extension(const item_t *object, const char *name, item_t *out)
{
    item_t extensions;
    TRY(item_member(object, "extensions", JSON_OBJECT, &extensions));
    *out = child(object, json_object_get(extensions.json, name), name, 0);
    return require_type(out, JSON_OBJECT);
}

/* ---- values -------------------------------------------------------------------------------------------- */

static result_t read_number(const item_t *item, double low, double high, double *value)
{
    if (!json_is_number(item->json)) return item_fail(item, "must be a number");
    double number = json_number_value(item->json);
    *value = number < low ? low : number > high ? high : number;
    if (number != *value) item_warn(item, "is %g and taken for %g", number, *value);
    return result_ok();
}

result_t item_number(const item_t *object, const char *key, double low, double high, double *value)
{
    item_t item = child(object, json_object_get(object->json, key), key, 0);
    return item.json ? read_number(&item, low, high, value) : result_ok();
}

result_t item_numbers(const item_t *object, const char *key, size_t count, double low, double high,
                      double *values, bool *present)
{
    item_t array;
    TRY(item_member(object, key, JSON_ARRAY, &array));
    if (present) *present = array.json != NULL;
    if (!array.json) return result_ok();
    if (item_count(&array) != count)
        return item_fail(&array, "must be %zu numbers, found %zu", count, item_count(&array));
    for (size_t i = 0; i < count; ++i) {
        item_t element = child(&array, json_array_get(array.json, i), NULL, i);
        TRY(read_number(&element, low, high, &values[i]));
    }
    return result_ok();
}

static result_t read_whole(const item_t *item, uint64_t most, uint64_t *value)
{
    double number = json_is_number(item->json) ? json_number_value(item->json) : -1;
    if (!(number >= 0 && number <= (double)most) || number != (double)(uint64_t)number)
        return item_fail(item, "must be a whole number from 0 to %" PRIu64, most);
    *value = (uint64_t)number;
    return result_ok();
}

result_t item_whole(const item_t *object, const char *key, uint64_t most, uint64_t *value)
{
    item_t item = child(object, json_object_get(object->json, key), key, 0);
    return item.json ? read_whole(&item, most, value) : result_ok();
}

result_t item_index(const item_t *object, const char *key, size_t count, uint32_t *index)
{
    item_t item = child(object, json_object_get(object->json, key), key, 0);
    if (!item.json) return result_ok();
    uint64_t value = 0;
    TRY(read_whole(&item, ITEM_NONE - 1, &value));
    if (value >= count)
        return item_fail(&item, "is %" PRIu64 ", but there are %zu, counted from 0", value, count);
    *index = (uint32_t)value;
    return result_ok();
}

result_t item_index_at(const item_t *array, size_t i, size_t count, const char *things, uint32_t *index)
{
    const json_t *element = json_array_get(array->json, i);
    json_int_t value = json_is_integer(element) ? json_integer_value(element) : -1;
    if (value < 0 || (uint64_t)value >= count)
        return item_fail(array, "element %zu must be the index of one of the %zu %s", i, count, things);
    *index = (uint32_t)value;
    return result_ok();
}

result_t item_bool(const item_t *object, const char *key, bool *value)
{
    item_t item = child(object, json_object_get(object->json, key), key, 0);
    if (!item.json) return result_ok();
    if (!json_is_boolean(item.json)) return item_fail(&item, "must be true or false");
    *value = json_is_true(item.json);
    return result_ok();
}

result_t item_string(const item_t *object, const char *key, const char **value)
{
    item_t item;
    TRY(item_member(object, key, JSON_STRING, &item));
    if (item.json) *value = json_string_value(item.json);
    return result_ok();
}

result_t item_name_at(const item_t *array, size_t index, const char **name)
{
    item_t item;
    *name = "";
    TRY(item_element(array, index, JSON_OBJECT, &item));
    return item_string(&item, "name", name);
}

result_t item_list_names(const item_t *array, char list[ITEM_LIST_ROOM])
{
    size_t used = 0;
    list[0] = '\0';
    for (size_t i = 0; i < item_count(array) && used + 80 < ITEM_LIST_ROOM; ++i) {
        const char *name;
        TRY(item_name_at(array, i, &name));
        used = append(list, ITEM_LIST_ROOM, used, "%s%zu: %.50s", i ? ", " : "", i + 1, name);
    }
    plain_text_clean(list);
    return result_ok();
}
