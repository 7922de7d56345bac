/* values: the parsers of options' values that many commands need (options.h). */
#include "common/options/options.h"

#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

result_t option_flag(const option_t *option, const char *text, void *field)
{
    (void)option, (void)text;
    *(bool *)field = true;
    return result_ok();
}

/* "bdpt, path or light"; a list that is too long for the text is cut. */
static void list_choices(const char *const *choices, char *text, size_t size)
{
    size_t used = 0;
    for (size_t i = 0; choices[i] != NULL && used < size; i++) {
        const char *before = i == 0 ? "" : choices[i + 1] == NULL ? " or " : ", ";
        used += (size_t)snprintf(text + used, size - used, "%s%s", before, choices[i]);
    }
}

/* Finds which of the choices the text is. */
static result_t choose(const option_t *option, const char *text, int *index)
{
    char known[200] = "";
    for (*index = 0; option->choices[*index] != NULL; ++*index)
        if (strcmp(text, option->choices[*index]) == 0) return result_ok();
    list_choices(option->choices, known, sizeof known);
    return result_fail(RESULT_USAGE, "--%s takes %s, not '%.100s'", option->name, known, text);
}

result_t option_text(const option_t *option, const char *text, void *field)
{
    int index;
    if (option->choices != NULL) TRY(choose(option, text, &index));
    *(const char **)field = text;
    return result_ok();
}

result_t option_choice(const option_t *option, const char *text, void *field)
{
    int index;
    TRY(choose(option, text, &index));
    *(int *)field = index + 1;
    return result_ok();
}

static result_t parse_whole(const option_t *option, const char *text, long long *value)
{
    char *end;
    errno = 0;
    *value = strtoll(text, &end, 10);
    if (end != text && *end == '\0' && errno == 0 && (double)*value >= option->least &&
        (double)*value <= option->most)
        return result_ok();
    return result_fail(RESULT_USAGE, "--%s takes a whole number from %.0f to %.0f, not '%.100s'",
                       option->name, option->least, option->most, text);
}

result_t option_int32(const option_t *option, const char *text, void *field)
{
    long long value;
    TRY(parse_whole(option, text, &value));
    *(int32_t *)field = (int32_t)value;
    return result_ok();
}

result_t option_uint32(const option_t *option, const char *text, void *field)
{
    long long value;
    TRY(parse_whole(option, text, &value));
    *(uint32_t *)field = (uint32_t)value;
    return result_ok();
}

result_t option_uint64(const option_t *option, const char *text, void *field)
{
    long long value;
    TRY(parse_whole(option, text, &value));
    *(uint64_t *)field = (uint64_t)value;
    return result_ok();
}

result_t option_real(const option_t *option, const char *text, void *field)
{
    char *end;
    errno = 0;
    double value = strtod(text, &end);
    if (end == text || *end != '\0' || errno != 0 || !(value >= option->least && value <= option->most))
        return result_fail(RESULT_USAGE, "--%s takes a number from %g to %g, not '%.100s'", option->name,
                           option->least, option->most, text);
    *(double *)field = value;
    return result_ok();
}

result_t option_share(const option_t *option, const char *text, void *field)
{
    char *end;
    errno = 0;
    double value = strtod(text, &end);
    if (end != text && *end == '%') {
        value /= 100;
        end++;
    }
    if (end == text || *end != '\0' || errno != 0 || !(value >= 0 && value <= 1))
        return result_fail(RESULT_USAGE, "--%s takes a share like 1%% or 0.01, at most 1, not '%.100s'",
                           option->name, text);
    *(double *)field = value;
    return result_ok();
}

result_t option_gigabytes(const option_t *option, const char *text, void *field)
{
    double value = 0;
    TRY(option_real(option, text, &value));
    *(uint64_t *)field = (uint64_t)(1e9 * value);
    return result_ok();
}

result_t option_list(const option_t *option, const char *text, void *field)
{
    (void)option;
    option_list_t *list = field;
    list->texts = mem_realloc(list->texts, (list->count + 1) * sizeof *list->texts);
    list->texts[list->count++] = text;
    return result_ok();
}
