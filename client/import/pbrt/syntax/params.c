/* params: see params.h. Values lie in three arrays per list: numbers, texts and the offsets of strings in the
 * texts, so that a mesh of millions of numbers is one array. */
#include "client/import/pbrt/syntax/params.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_PARAMS = 256 }; /* in one directive: the longest of pbrt's takes about 20 */

struct params {
    param_t *items;
    size_t count, capacity;
    double *numbers;
    size_t number_count, number_capacity;
    size_t *strings; /* offsets in text */
    size_t string_count, string_capacity;
    char *text;
    size_t text_size, text_capacity;
    params_t *fallback;
    bool v3; /* read by the rules of pbrt-v3 */
};

/* The type names of both dialects: those that only one has mean nothing else in the other. */
static const struct {
    const char *name;
    param_type_t type;
} type_names[] = {
    {"integer", PARAM_INTEGER},     {"float", PARAM_FLOAT},       {"point2", PARAM_POINT2},
    {"vector2", PARAM_VECTOR2},     {"point3", PARAM_POINT3},     {"vector3", PARAM_VECTOR3},
    {"normal3", PARAM_NORMAL3},     {"rgb", PARAM_RGB},           {"xyz", PARAM_XYZ},
    {"blackbody", PARAM_BLACKBODY}, {"spectrum", PARAM_SPECTRUM}, {"bool", PARAM_BOOL},
    {"string", PARAM_STRING},       {"texture", PARAM_TEXTURE},   {"point", PARAM_POINT3},
    {"vector", PARAM_VECTOR3},      {"normal", PARAM_NORMAL3},    {"color", PARAM_RGB},
};

/* ---- life ---------------------------------------------------------------------------------------------- */

params_t *params_new(void)
{
    return mem_zalloc(1, sizeof(params_t));
}

void params_destroy(params_t **params)
{
    if (!*params) return;
    free((*params)->items);
    free((*params)->numbers);
    free((*params)->strings);
    free((*params)->text);
    free(*params);
    *params = NULL;
}

void params_clear(params_t *params)
{
    params->count = params->number_count = params->string_count = params->text_size = 0;
    params->fallback = NULL;
}

static size_t add_text(params_t *params, const char *text)
{
    size_t offset = params->text_size, size = strlen(text) + 1;
    params->text = grow(params->text, &params->text_capacity, offset + size, 1);
    memcpy(params->text + offset, text, size);
    params->text_size += size;
    return offset;
}

static void add_number(params_t *params, double value)
{
    params->numbers =
        grow(params->numbers, &params->number_capacity, params->number_count + 1, sizeof *params->numbers);
    params->numbers[params->number_count++] = value;
}

static void add_string(params_t *params, size_t offset)
{
    params->strings =
        grow(params->strings, &params->string_capacity, params->string_count + 1, sizeof *params->strings);
    params->strings[params->string_count++] = offset;
}

static const unsigned any_type = ~0u;

static bool is_called(const params_t *params, const param_t *item, const char *name)
{
    return strcmp(params->text + item->name, name) == 0;
}

/* The last of that name and one of the types; in v3 a texture before all else. */
static param_t *find_own(const params_t *params, const char *name, unsigned types)
{
    param_t *found = NULL;
    for (size_t i = params->count; i-- > 0;) {
        param_t *item = &params->items[i];
        if (!(types & PARAM_BIT(item->type)) || !is_called(params, item, name)) continue;
        if (!params->v3 || item->type == PARAM_TEXTURE) return item;
        if (!found) found = item;
    }
    return found;
}

/* The types that are one to the list's dialect. */
static unsigned types_like(const params_t *params, param_type_t type)
{
    return params->v3 && PARAM_COLOURS & PARAM_BIT(type) ? PARAM_COLOURS : PARAM_BIT(type);
}

static void drop(params_t *params, const param_t *item)
{
    size_t index = (size_t)(item - params->items);
    memmove(&params->items[index], item + 1, (params->count - index - 1) * sizeof *item);
    --params->count;
}

static void append(params_t *params, param_t item)
{
    params->items = grow(params->items, &params->capacity, params->count + 1, sizeof *params->items);
    params->items[params->count++] = item;
}

void params_set_fallback(params_t *params, params_t *fallback)
{
    params->fallback = fallback;
}

/* ---- reading them from the file ------------------------------------------------------------------------ */

const char *param_type_name(param_type_t type)
{
    return type_names[type].name; /* the first 14 rows are in the order of param_type_t */
}

/* Splits "type name"; *item gets both. */
static result_t parse_declaration(params_t *params, const token_t *token, param_t *item)
{
    char quote[TOKEN_QUOTE_SIZE];
    const char *s = token->text, *end = s + token->length;
    while (s < end && (*s == ' ' || *s == '\t')) ++s;
    const char *type = s;
    while (s < end && *s != ' ' && *s != '\t') ++s;
    token_t type_token = {.kind = TOKEN_WORD, .text = type, .length = (size_t)(s - type)};
    while (s < end && (*s == ' ' || *s == '\t')) ++s;
    const char *name = s;
    while (s < end && *s != ' ' && *s != '\t') ++s;
    size_t length = (size_t)(s - name);
    while (s < end && (*s == ' ' || *s == '\t')) ++s;
    if (length == 0 || s < end)
        return error_at(token->at, "expected a parameter \"type name\", found %s", token_quote(token, quote));

    if (params->count == MAX_PARAMS) return error_at(token->at, "more than %d parameters", MAX_PARAMS);

    size_t row = 0;
    while (row < ARRAY_LENGTH(type_names) && !token_is(&type_token, type_names[row].name)) ++row;
    if (row == ARRAY_LENGTH(type_names))
        return error_at(token->at, "unknown parameter type %s", token_quote(&type_token, quote));
    char *copy = mem_printf("%.*s", (int)length, name);
    *item = (param_t){.type = type_names[row].type, .at = token->at, .name = add_text(params, copy)};
    free(copy);
    return result_ok();
}

/* A second one of the same name and type replaces the first. */
static result_t drop_former(params_t *params, const param_t *item, report_t *report)
{
    const char *name = params->text + item->name;
    const param_t *former = find_own(params, name, types_like(params, item->type));
    if (!former) return result_ok();
    position_t at = former->at;
    drop(params, former);
    return report_tolerate(report, item->at,
                           "parameter \"%s\" is given twice; as in pbrt, that of line %u is dropped", name,
                           at.line);
}

static bool type_is_quoted(param_type_t type)
{
    return type == PARAM_STRING || type == PARAM_TEXTURE;
}

static result_t parse_string(params_t *params, const token_t *token)
{
    char *text = mem_alloc(token->length + 1);
    result_t result = token_unescape(token, text);
    if (result.code == RESULT_OK) add_string(params, add_text(params, text));
    free(text);
    return result;
}

/* One value that is not a plain number: a string, or true and false with quotes (pbrt-v3) or without (v4). */
static result_t parse_value(params_t *params, param_t *item, const token_t *token)
{
    char quote[TOKEN_QUOTE_SIZE];
    if (item->type == PARAM_BOOL && (token->kind == TOKEN_STRING || token->kind == TOKEN_WORD) &&
        (token_is(token, "true") || token_is(token, "false"))) {
        add_number(params, token_is(token, "true"));
        return result_ok();
    }
    bool quoted = type_is_quoted(item->type) || item->type == PARAM_SPECTRUM;
    if (quoted && token->kind == TOKEN_STRING && (item->count == 0 || item->quoted)) {
        item->quoted = true;
        return parse_string(params, token);
    }
    const char *expected = item->type == PARAM_BOOL                     ? "true or false"
                           : item->quoted || type_is_quoted(item->type) ? "a quoted string"
                                                                        : "a number";
    return error_at(token->at, "parameter \"%s\": expected %s, found %s", params->text + item->name, expected,
                    token_quote(token, quote));
}

static result_t parse_one(params_t *params, lexer_t *lexer, param_t *item)
{
    double value;
    bool numeric = !type_is_quoted(item->type) && item->type != PARAM_BOOL && !item->quoted;
    if (numeric && lexer_number(lexer, &value)) {
        add_number(params, value);
    } else {
        token_t token;
        TRY(lexer_next(lexer, &token));
        TRY(parse_value(params, item, &token));
    }
    ++item->count;
    return result_ok();
}

static result_t parse_values(params_t *params, lexer_t *lexer, param_t *item)
{
    token_t token;
    TRY(lexer_peek(lexer, &token));
    if (token.kind != TOKEN_OPEN) return parse_one(params, lexer, item);
    position_t open = token.at;
    TRY(lexer_next(lexer, &token));
    for (;;) {
        double value;
        bool numeric = !type_is_quoted(item->type) && item->type != PARAM_BOOL && !item->quoted;
        if (numeric && lexer_number(lexer, &value)) { /* the fast path of large meshes */
            add_number(params, value);
            ++item->count;
            continue;
        }
        TRY(lexer_peek(lexer, &token));
        if (token.kind == TOKEN_END) return error_at(open, "this '[' has no ']'");
        if (token.kind == TOKEN_CLOSE) return lexer_next(lexer, &token);
        TRY(parse_one(params, lexer, item));
    }
}

result_t params_parse(params_t *params, lexer_t *lexer, dialect_t dialect, report_t *report)
{
    params->v3 = dialect == DIALECT_V3;
    for (;;) {
        token_t token;
        TRY(lexer_peek(lexer, &token));
        if (token.kind != TOKEN_STRING) return result_ok();
        TRY(lexer_next(lexer, &token));
        param_t item;
        TRY(parse_declaration(params, &token, &item));
        TRY(drop_former(params, &item, report));
        size_t numbers = params->number_count, strings = params->string_count;
        TRY(parse_values(params, lexer, &item));
        item.quoted = item.quoted || type_is_quoted(item.type);
        item.first = item.quoted ? strings : numbers;
        append(params, item);
    }
}

/* ---- looking them up ----------------------------------------------------------------------------------- */

static param_t *find(const params_t *params, const char *name, unsigned types, const params_t **owner)
{
    for (const params_t *list = params; list; list = list->fallback) {
        param_t *item = find_own(list, name, types);
        if (!item) continue;
        if (owner) *owner = list;
        return item;
    }
    return NULL;
}

const param_t *params_find(params_t *params, const char *name, unsigned types, const params_t **owner)
{
    param_t *item = find(params, name, types, owner);
    if (item) {
        item->used = true;
        return item;
    }
    item = find(params, name, any_type, NULL);
    if (item) item->wanted |= types;
    return NULL;
}

bool params_has(const params_t *params, const char *name)
{
    return find(params, name, any_type, NULL) != NULL;
}

position_t params_where(const params_t *params, const char *name, position_t otherwise)
{
    const param_t *item = find(params, name, any_type, NULL);
    return item ? item->at : otherwise;
}

const double *params_numbers(const params_t *owner, const param_t *param)
{
    return param->count ? owner->numbers + param->first : NULL;
}

const char *params_text(const params_t *owner, const param_t *param, size_t index)
{
    return owner->text + owner->strings[param->first + index];
}

bool params_textures_known(const params_t *params, bool (*known)(const void *context, const char *texture),
                           const void *context)
{
    for (const params_t *list = params; list; list = list->fallback)
        for (size_t i = 0; i < list->count; ++i)
            if (list->items[i].type == PARAM_TEXTURE && list->items[i].count == 1 &&
                !known(context, params_text(list, &list->items[i], 0)))
                return false;
    return true;
}

/* The parameter with one value of the given type; *item is NULL when it is not there. To pbrt-v3 it is not
 * when it has another number of values. */
static result_t find_single(params_t *params, const char *name, param_type_t type, const param_t **item,
                            const params_t **owner)
{
    *item = params_find(params, name, PARAM_BIT(type), owner);
    if (!*item || (*item)->count == 1) return result_ok();
    if (!params->v3)
        return error_at((*item)->at, "parameter \"%s\" takes one value, found %zu", name, (*item)->count);
    param_t *unread = find(params, name, PARAM_BIT(type), NULL);
    unread->used = false;
    unread->miscounted = true;
    *item = NULL;
    return result_ok();
}

result_t params_float(params_t *params, const char *name, double *value)
{
    const param_t *item;
    const params_t *owner;
    TRY(find_single(params, name, PARAM_FLOAT, &item, &owner));
    if (item) *value = *params_numbers(owner, item);
    return result_ok();
}

result_t params_float_in(params_t *params, const char *name, double low, double high, double *value)
{
    TRY(params_float(params, name, value));
    const param_t *item = find(params, name, PARAM_BIT(PARAM_FLOAT), NULL);
    if (item && !(*value >= low && *value <= high))
        return error_at(item->at, "parameter \"%s\" is %g, but must be from %g to %g", name, *value, low,
                        high);
    return result_ok();
}

result_t params_int_in(params_t *params, const char *name, int low, int high, int32_t *value)
{
    const param_t *item;
    const params_t *owner;
    TRY(find_single(params, name, PARAM_INTEGER, &item, &owner));
    if (!item) return result_ok();
    double number = *params_numbers(owner, item);
    if (!(number >= low && number <= high) || number != floor(number))
        return error_at(item->at, "parameter \"%s\" is %g, but must be an integer from %d to %d", name,
                        number, low, high);
    *value = (int32_t)number;
    return result_ok();
}

result_t params_bool(params_t *params, const char *name, bool *value)
{
    const param_t *item;
    const params_t *owner;
    TRY(find_single(params, name, PARAM_BOOL, &item, &owner));
    if (item) *value = *params_numbers(owner, item) != 0;
    return result_ok();
}

result_t params_string(params_t *params, const char *name, const char **value)
{
    const param_t *item;
    const params_t *owner;
    TRY(find_single(params, name, PARAM_STRING, &item, &owner));
    if (item) *value = params_text(owner, item, 0);
    return result_ok();
}

result_t params_array(params_t *params, const char *name, unsigned types, size_t group, const double **values,
                      size_t *count)
{
    *values = NULL;
    *count = 0;
    const params_t *owner;
    const param_t *item = params_find(params, name, types, &owner);
    if (!item) return result_ok();
    if (item->quoted)
        return error_at(item->at, "parameter \"%s\" cannot be of type %s", name, param_type_name(item->type));
    if (item->count % group)
        return error_at(item->at, "parameter \"%s\" takes groups of %zu numbers, but has %zu", name, group,
                        item->count);
    *values = params_numbers(owner, item);
    *count = item->count;
    return result_ok();
}

result_t params_point(params_t *params, const char *name, unsigned types, double point[3])
{
    const double *numbers;
    size_t count;
    TRY(params_array(params, name, types, 3, &numbers, &count));
    if (count > 3)
        return error_at(params_where(params, name, (position_t){.path = ""}),
                        "parameter \"%s\" takes three numbers, found %zu: it is one point or vector", name,
                        count);
    if (count == 3) memcpy(point, numbers, 3 * sizeof *point);
    return result_ok();
}

/* ---- what is left -------------------------------------------------------------------------------------- */

static result_t apply(params_t *params, const param_rule_t *rule, const char *name, report_t *report)
{
    param_t *item = find(params, name, any_type, NULL);
    if (!item || item->used) return result_ok();
    item->used = true;
    if (rule->fate == PARAM_REFUSE)
        return report_refuse(report, item->at, "parameter \"%s\": %s", name, rule->why);
    if (rule->fate == PARAM_IGNORE)
        report_warning(report, item->at, "parameter \"%s\" is ignored: %s", name, rule->why);
    return result_ok();
}

result_t params_apply(params_t *params, const param_rule_t *rules, size_t count, report_t *report)
{
    for (const param_rule_t *rule = rules; rule < rules + count; ++rule)
        for (size_t i = 0; i < ARRAY_LENGTH(rule->names) && rule->names[i]; ++i)
            TRY(apply(params, rule, rule->names[i], report));
    return result_ok();
}

/* The first of the types, of which there is one. */
static param_type_t first_type(unsigned types)
{
    param_type_t type = PARAM_INTEGER;
    while (!(types & PARAM_BIT(type))) ++type;
    return type;
}

static result_t report_unread(const params_t *params, const param_t *item, const char *what, bool strict,
                              report_t *report)
{
    const char *name = params->text + item->name, *type = param_type_name(item->type);
    if (item->miscounted)
        return report_tolerate(report, item->at,
                               "parameter \"%s\" takes one value, found %zu; it is ignored, as by pbrt-v3",
                               name, item->count);
    if (item->wanted && strict)
        return report_refuse(report, item->at, "parameter \"%s\" must be of type %s, not %s; it is ignored",
                             name, param_type_name(first_type(item->wanted)), type);
    if (item->wanted)
        return report_tolerate(report, item->at,
                               "parameter \"%s\" must be of type %s, not %s; it is ignored, as by pbrt-v3",
                               name, param_type_name(first_type(item->wanted)), type);
    if (strict)
        return report_refuse(report, item->at, "%s has no parameter \"%s %s\"; is it misspelled?", what, type,
                             name);
    report_warning(report, item->at, "unused parameter \"%s %s\" of %s", type, name, what);
    return result_ok();
}

result_t params_finish(params_t *params, const char *what, bool strict, report_t *report)
{
    for (size_t i = 0; i < params->count; ++i) {
        param_t *item = &params->items[i];
        bool used = item->used;
        item->used = true;
        if (!used) TRY(report_unread(params, item, what, strict, report));
    }
    return result_ok();
}

size_t params_unread(const params_t *params)
{
    size_t unread = 0;
    for (size_t i = 0; i < params->count; ++i) unread += !params->items[i].used;
    return unread;
}
