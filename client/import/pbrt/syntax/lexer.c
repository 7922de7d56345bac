/* lexer: see lexer.h. */
#include "client/import/pbrt/syntax/lexer.h"

#include <stdio.h>
#include <string.h>

#include "client/import/files/number.h"
#include "common/plain_text.h"

lexer_t lexer_begin(const char *path, const char *data, size_t size)
{
    return (lexer_t){
        .path = path, .data = data, .cursor = data, .end = data + size, .line_start = data, .line = 1};
}

static bool is_space(char c)
{
    return c == ' ' || c == '\t' || c == '\n' || c == '\r' || c == '\f' || c == '\v';
}

/* What ends a word. */
static bool is_delimiter(char c)
{
    return is_space(c) || c == '"' || c == '[' || c == ']' || c == '#';
}

static void skip_blanks(lexer_t *lexer)
{
    const char *s = lexer->cursor;
    while (s < lexer->end) {
        if (*s == '\n') {
            ++lexer->line;
            lexer->line_start = ++s;
        } else if (is_space(*s)) {
            ++s;
        } else if (*s == '#') {
            const char *newline = memchr(s, '\n', (size_t)(lexer->end - s));
            s = newline ? newline : lexer->end;
        } else {
            break;
        }
    }
    lexer->cursor = s;
}

position_t lexer_position(lexer_t *lexer)
{
    skip_blanks(lexer);
    return (position_t){lexer->path, lexer->line, (uint32_t)(lexer->cursor - lexer->line_start) + 1};
}

static result_t next_string(lexer_t *lexer, token_t *token)
{
    const char *start = ++lexer->cursor, *s = start;
    for (; s < lexer->end && *s != '"' && *s != '\n'; ++s)
        if (*s == '\\' && s + 1 < lexer->end && s[1] != '\n') ++s;
    if (s >= lexer->end || *s != '"')
        return error_at(token->at, "this string has no closing quote on its line");
    for (const char *c = start; c < s; ++c)
        if ((unsigned char)*c < ' ' && *c != '\t')
            return error_at(token->at, "this string holds a control character (byte %d)", *c);
    token->kind = TOKEN_STRING;
    token->text = start;
    token->length = (size_t)(s - start);
    lexer->cursor = s + 1;
    return result_ok();
}

static result_t next_word(lexer_t *lexer, token_t *token)
{
    const char *s = lexer->cursor;
    for (; s < lexer->end && !is_delimiter(*s); ++s)
        if ((unsigned char)*s < ' ' || *s == 0x7f)
            return error_at(token->at, "a byte %d, which no text file holds; is this a pbrt scene?", *s);
    token->kind = TOKEN_WORD;
    token->text = lexer->cursor;
    token->length = (size_t)(s - lexer->cursor);
    lexer->cursor = s;
    return result_ok();
}

/* Goes past blanks, and from the end of an inner file on in the outer one. */
static void skip_to_token(lexer_t *lexer)
{
    skip_blanks(lexer);
    while (lexer->cursor == lexer->end && lexer->outer) {
        *lexer = *lexer->outer;
        skip_blanks(lexer);
    }
}

result_t lexer_next(lexer_t *lexer, token_t *token)
{
    skip_to_token(lexer);
    *token = (token_t){.kind = TOKEN_END, .text = "", .at = lexer_position(lexer)};
    if (lexer->cursor == lexer->end) return result_ok();
    switch (*lexer->cursor) {
    case '"':
        return next_string(lexer, token);
    case '[':
    case ']':
        token->kind = *lexer->cursor == '[' ? TOKEN_OPEN : TOKEN_CLOSE;
        token->text = lexer->cursor++;
        token->length = 1;
        return result_ok();
    default:
        return next_word(lexer, token);
    }
}

result_t lexer_peek(lexer_t *lexer, token_t *token)
{
    lexer_t ahead = *lexer;
    return lexer_next(&ahead, token);
}

/* What stands behind a number without a blank between: of a line the first time. */
static result_t forgive(lexer_t *lexer, const char *stop)
{
    token_t token;
    char quote[TOKEN_QUOTE_SIZE];
    position_t at = lexer_position(lexer);
    if (lexer->forgiven == at.line) return result_ok();
    int length = (int)(stop - lexer->cursor < 40 ? stop - lexer->cursor : 40);
    const char *text = lexer->cursor;
    TRY(lexer_peek(lexer, &token));
    TRY(report_tolerate(lexer->forgiving, at,
                        "%s is read as %.*s, as by pbrt-v3, and others in this line likewise",
                        token_quote(&token, quote), length, text));
    lexer->forgiven = at.line;
    return result_ok();
}

bool lexer_number(lexer_t *lexer, double *value)
{
    skip_to_token(lexer);
    const char *stop = number_parse(lexer->cursor, lexer->end, value);
    if (!stop) return false;
    if (stop < lexer->end && !is_delimiter(*stop)) {
        if (!lexer->forgiving || forgive(lexer, stop).code != RESULT_OK) return false;
        while (stop < lexer->end && !is_delimiter(*stop)) ++stop;
    }
    lexer->cursor = stop;
    return true;
}

bool token_is(const token_t *token, const char *word)
{
    return token->length == strlen(word) && memcmp(token->text, word, token->length) == 0;
}

result_t token_unescape(const token_t *token, char *out)
{
    static const char escapes[] = "bfnrt\\'\"", meanings[] = "\b\f\n\r\t\\'\"";
    for (size_t i = 0; i < token->length; ++i) {
        char c = token->text[i];
        if (c == '\\') {
            char escape = ++i < token->length ? token->text[i] : 'x';
            const char *known = strchr(escapes, escape);
            if (!known)
                return error_at(token->at, "unknown escape \\%c in this string; write \\\\ for a backslash",
                                escape);
            c = meanings[known - escapes];
        }
        *out++ = c;
    }
    *out = '\0';
    return result_ok();
}

const char *token_quote(const token_t *token, char out[TOKEN_QUOTE_SIZE])
{
    if (token->kind == TOKEN_END) return "the end of the file";
    const int room = 40;
    int length = token->length > (size_t)room ? room : (int)token->length;
    const char *mark = token->kind == TOKEN_STRING ? "\"" : "'";
    snprintf(out, TOKEN_QUOTE_SIZE, "%s%.*s%s%s", mark, length, token->text,
             token->length > (size_t)room ? "..." : "", mark);
    plain_text_clean(out);
    return out;
}
