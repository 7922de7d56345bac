/* lexer: the tokens of one pbrt file, each with its place.
 *
 * A token is a word (also a number), a quoted string, '[' or ']'; '#' starts a comment that ends with its
 * line. The whole file is in memory and tokens point into it. The long runs of numbers, which are most of a
 * file, have a fast path of their own: lexer_number.
 */
#ifndef LIGHTMILL_LEXER_H
#define LIGHTMILL_LEXER_H

#include "client/import/scene/report.h"

typedef enum { TOKEN_END, TOKEN_WORD, TOKEN_STRING, TOKEN_OPEN, TOKEN_CLOSE } token_kind_t;

/* `text` points into the file: a word as it stands, or a string between its quotes, escapes not yet replaced.
 */
typedef struct {
    token_kind_t kind;
    const char *text;
    size_t length;
    position_t at;
} token_t;

typedef struct lexer {
    const char *path; /* kept by the caller */
    const char *data, *cursor, *end;
    const char *line_start;
    uint32_t line;
    /* Where to go on at the end of the file, as pbrt does: even in the middle of a directive. NULL: the end
     * is the end. Kept by the caller, who sees by `path` where the lexer is. */
    const struct lexer *outer;
    report_t *forgiving; /* takes "0," for the number 0, as pbrt-v3 does, and warns here; NULL: does not */
    uint32_t forgiven;   /* the last line of which it warned */
} lexer_t;

/* Reads tokens from `size` bytes, which the caller keeps. */
lexer_t lexer_begin(const char *path, const char *data, size_t size);

/* The next token; TOKEN_END for ever at the end of the outermost file. Fails on an unterminated string or a
 * control character. */
result_t lexer_next(lexer_t *lexer, token_t *token);
/* The same, without going past it. */
result_t lexer_peek(lexer_t *lexer, token_t *token);
/* When the next token is a number, goes past it; otherwise stays and returns false. */
bool lexer_number(lexer_t *lexer, double *value);
/* The place of the next token of this file, or its end. */
position_t lexer_position(lexer_t *lexer);

bool token_is(const token_t *token, const char *word);
/* Writes the string with its escapes replaced to `out`, which has room for token->length + 1 bytes. */
result_t token_unescape(const token_t *token, char *out);

enum { TOKEN_QUOTE_SIZE = 64 };
/* What was found, for messages: the end of the file, or the token itself, shortened and printable. */
const char *token_quote(const token_t *token, char out[TOKEN_QUOTE_SIZE]);

#endif
