/* allow_list: see allow_list.h. */
#include "proto/serve/allow_list.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int compare_keys(const void *a, const void *b)
{
    return strcmp(((const allow_entry_t *)a)->key, ((const allow_entry_t *)b)->key);
}

/* The next word of a line, which is cut there; *rest is what follows, without blanks. */
static char *next_word(char **rest)
{
    char *word = *rest, *stop = word + strcspn(word, " \t");
    *rest = stop + strspn(stop, " \t");
    *stop = '\0';
    return word;
}

static bool parse_rights(const char *word, unsigned *rights)
{
    static const struct {
        const char *word;
        unsigned rights;
    } known[] = {{"worker", RIGHT_WORK}, {"client", RIGHT_CLIENT}, {"all", RIGHTS_ALL}};
    for (size_t i = 0; i < ARRAY_LENGTH(known); i++) {
        if (strcmp(word, known[i].word) != 0) continue;
        *rights = known[i].rights;
        return true;
    }
    return false;
}

static result_t parse_entry(char *line, const char *path, int number, allow_entry_t *entry)
{
    *entry = (allow_entry_t){.line = number};
    char *rest = line, *word = next_word(&rest);
    if (!parse_rights(word, &entry->rights))
        return result_fail(RESULT_INPUT,
                           "%s:%d: a line begins with \"worker\", \"client\" or \"all\", not \"%.60s\"", path,
                           number, word);
    const char *key = next_word(&rest);
    if (!key_valid(key))
        return result_fail(RESULT_INPUT, "%s:%d: after the right comes a public key, %d characters of Z85",
                           path, number, KEY_TEXT);
    memcpy(entry->key, key, sizeof entry->key);
    size_t length = strcspn(rest, "#");
    while (length > 0 && (rest[length - 1] == ' ' || rest[length - 1] == '\t')) length--;
    if (length > KEY_MAX_NAME)
        return result_fail(RESULT_INPUT, "%s:%d: a name of %zu characters, the limit is %d", path, number,
                           length, KEY_MAX_NAME);
    memcpy(entry->name, rest, length);
    return result_ok();
}

static result_t parse_entries(const char *text, const char *end, const char *path, allow_list_t *list)
{
    char line[KEY_MAX_LINE + 1];
    int number = 0;
    size_t capacity = 0;
    for (;;) {
        bool found;
        TRY(key_next_line(&text, end, path, &number, line, &found));
        if (!found) return result_ok();
        if (list->count == ALLOW_MAX_KEYS)
            return result_fail(RESULT_INPUT, "%s:%d: more than %d keys", path, number, ALLOW_MAX_KEYS);
        if (list->count == capacity) {
            capacity = capacity == 0 ? 16 : 2 * capacity;
            list->entries = mem_realloc(list->entries, capacity * sizeof *list->entries);
        }
        TRY(parse_entry(line, path, number, &list->entries[list->count]));
        list->count++;
    }
}

static result_t check_unique(const char *path, const allow_list_t *list)
{
    for (size_t i = 1; i < list->count; i++) {
        const allow_entry_t *a = &list->entries[i - 1], *b = &list->entries[i];
        if (strcmp(a->key, b->key) == 0)
            return result_fail(RESULT_INPUT, "%s:%d: the key of line %d once more; \"all\" gives both rights",
                               path, int_max(a->line, b->line), int_min(a->line, b->line));
    }
    return result_ok();
}

result_t allow_list_parse(const char *text, size_t size, const char *path, allow_list_t *list)
{
    *list = (allow_list_t){0};
    result_t result = parse_entries(text, text + size, path, list);
    if (result.code == RESULT_OK && list->count > 0) {
        qsort(list->entries, list->count, sizeof *list->entries, compare_keys);
        result = check_unique(path, list);
    }
    if (result.code != RESULT_OK) allow_list_free(list);
    return result;
}

result_t allow_list_read(const char *path, allow_list_t *list)
{
    uint8_t *bytes;
    size_t size;
    *list = (allow_list_t){0};
    TRY(file_read(path, ALLOW_MAX_FILE, &bytes, &size));
    result_t result = allow_list_parse((const char *)bytes, size, path, list);
    free(bytes);
    return result;
}

void allow_list_free(allow_list_t *list)
{
    free(list->entries);
    *list = (allow_list_t){0};
}

const allow_entry_t *allow_list_find(const allow_list_t *list, const char *key)
{
    allow_entry_t wanted = {0};
    if (list->count == 0) return NULL;
    snprintf(wanted.key, sizeof wanted.key, "%s", key);
    return bsearch(&wanted, list->entries, list->count, sizeof *list->entries, compare_keys);
}

bool allow_list_holds(const allow_list_t *list, const allow_list_t *other)
{
    for (size_t i = 0; i < other->count; i++) {
        const allow_entry_t *entry = allow_list_find(list, other->entries[i].key);
        if (entry == NULL || (other->entries[i].rights & ~entry->rights) != 0) return false;
    }
    return true;
}
