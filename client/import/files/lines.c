/* lines: see lines.h. */
#include "client/import/files/lines.h"

#include <stdio.h>
#include <string.h>

#include "client/import/files/number.h"

size_t byte_order_mark(const char *data, size_t size)
{
    return size >= 3 && memcmp(data, "\xEF\xBB\xBF", 3) == 0 ? 3 : 0;
}

lines_t lines_begin(const char *path, const char *data, size_t size)
{
    return (lines_t){path, data + byte_order_mark(data, size), data + size, 1};
}

/* How many bytes the end of a line that goes on takes: a backslash, and the newline behind it; 0: none. */
static size_t joint(const char *at, const char *end)
{
    if (end - at >= 2 && at[0] == '\\' && at[1] == '\n') return 2;
    return end - at >= 3 && at[0] == '\\' && at[1] == '\r' && at[2] == '\n' ? 3 : 0;
}

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r' || c == '\0' || c == '\v' || c == '\f';
}

static const char *skip_blanks(const char *at, const char *end)
{
    while (at < end) {
        size_t joined = joint(at, end);
        if (joined == 0 && !is_blank(*at)) break;
        at += joined ? joined : 1;
    }
    return at;
}

/* The end of a line, comment included; *shown is where its comment begins, or its end. */
static const char *line_end(lines_t *lines, const char *begin, const char **shown)
{
    const char *at = begin;
    *shown = NULL;
    while (at < lines->end && *at != '\n') {
        size_t joined = *shown ? 0 : joint(at, lines->end);
        if (*at == '#' && !*shown && (at == begin || is_blank(at[-1]))) *shown = at;
        lines->line += joined > 0;
        at += joined ? joined : 1;
    }
    if (!*shown) *shown = at;
    return at;
}

bool lines_next(lines_t *lines, line_t *line)
{
    while (lines->cursor < lines->end) {
        const char *begin = lines->cursor, *shown;
        *line = (line_t){.at = {lines->path, lines->line, 0}};
        const char *end = line_end(lines, begin, &shown);
        lines->cursor = end < lines->end ? end + 1 : end;
        ++lines->line;
        line->cursor = begin;
        line->end = shown;
        if (line_word(line, &line->keyword)) return true;
    }
    return false;
}

bool line_word(line_t *line, word_t *word)
{
    const char *at = skip_blanks(line->cursor, line->end), *begin = at;
    while (at < line->end && !is_blank(*at) && joint(at, line->end) == 0) ++at;
    *word = (word_t){begin, (size_t)(at - begin)};
    line->cursor = at;
    return at > begin;
}

bool line_number(line_t *line, double *value)
{
    line_t after = *line;
    word_t word;
    if (!line_word(&after, &word)) return false;
    if (number_parse(word.text, word.text + word.length, value) != word.text + word.length) return false;
    *line = after;
    return true;
}

word_t line_rest(line_t *line)
{
    const char *begin = skip_blanks(line->cursor, line->end), *end = line->end;
    while (end > begin && is_blank(end[-1])) --end;
    line->cursor = line->end;
    return (word_t){begin, (size_t)(end - begin)};
}

bool word_is(word_t word, const char *text)
{
    return strlen(text) == word.length && memcmp(text, word.text, word.length) == 0;
}

const char *word_quote(word_t word, char out[WORD_QUOTE_SIZE])
{
    int shown = word.length < WORD_QUOTE_SIZE - 8 ? (int)word.length : WORD_QUOTE_SIZE - 8;
    snprintf(out, WORD_QUOTE_SIZE, "\"%.*s%s\"", shown, word.text, (size_t)shown < word.length ? "..." : "");
    return out;
}
