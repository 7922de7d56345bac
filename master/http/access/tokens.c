/* tokens: see tokens.h. */
#include "master/http/access/tokens.h"

#include "common/atomic_file.h"
#include "proto/wire/keys.h"

#include <errno.h>
#include <sodium.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

static char *tokens_path(const char *data_dir)
{
    return mem_printf("%s/keys/http", data_dir);
}

/* ---- reading ------------------------------------------------------------------------------------------- */

static bool take_line(const char *line, const char *name, char token[HTTP_TOKEN_TEXT + 1])
{
    size_t length = strlen(name);
    if (strncmp(line, name, length) != 0 || line[length] != ' ') return false;
    const char *text = line + length + 1 + strspn(line + length + 1, " ");
    if (strlen(text) != HTTP_TOKEN_TEXT || strspn(text, "0123456789abcdef") != HTTP_TOKEN_TEXT) return false;
    memcpy(token, text, HTTP_TOKEN_TEXT + 1);
    return true;
}

static result_t parse(const char *path, const char *text, size_t size, http_tokens_t *tokens)
{
    int number = 0;
    bool found;
    *tokens = (http_tokens_t){0};
    for (const char *end = text + size;;) {
        char line[KEY_MAX_LINE + 1];
        TRY(key_next_line(&text, end, path, &number, line, &found));
        if (!found) break;
        if (!take_line(line, "view", tokens->view) && !take_line(line, "operate", tokens->operate))
            return result_fail(
                RESULT_INPUT,
                "%s:%d: expected 'view TOKEN' or 'operate TOKEN' with %d hexadecimal digits; delete "
                "the file, and the master makes a new one",
                path, number, HTTP_TOKEN_TEXT);
    }
    if (tokens->view[0] != '\0' && tokens->operate[0] != '\0') return result_ok();
    return result_fail(RESULT_INPUT, "%s lacks a token: delete it, and the master makes a new one", path);
}

static result_t read_file(const char *path, http_tokens_t *tokens)
{
    uint8_t *text;
    size_t size;
    TRY(file_read(path, KEY_MAX_FILE, &text, &size));
    result_t result = parse(path, (const char *)text, size, tokens);
    sodium_memzero(text, size);
    free(text);
    return result;
}

result_t http_tokens_read(const char *data_dir, http_tokens_t *tokens)
{
    char *path = tokens_path(data_dir);
    result_t result = read_file(path, tokens);
    free(path);
    return result;
}

/* ---- making -------------------------------------------------------------------------------------------- */

static void new_token(char token[HTTP_TOKEN_TEXT + 1])
{
    uint8_t bytes[HTTP_TOKEN_TEXT / 2];
    randombytes_buf(bytes, sizeof bytes);
    sodium_bin2hex(token, HTTP_TOKEN_TEXT + 1, bytes, sizeof bytes);
    sodium_memzero(bytes, sizeof bytes);
}

static result_t make_file(const char *path)
{
    http_tokens_t tokens;
    new_token(tokens.view);
    new_token(tokens.operate);
    char *text =
        mem_printf("# Lightmill: who has a token may open the master's page. Keep them to yourself.\n"
                   "view %s\n"
                   "operate %s\n",
                   tokens.view, tokens.operate);
    result_t result = file_write_private(path, text, strlen(text));
    sodium_memzero(text, strlen(text));
    free(text);
    http_tokens_forget(&tokens);
    return result;
}

result_t http_tokens_load(const char *data_dir, http_tokens_t *tokens)
{
    char *path = tokens_path(data_dir);
    result_t result = result_ok();
    if (access(path, F_OK) != 0 && errno == ENOENT) result = make_file(path);
    if (result.code == RESULT_OK) {
        key_file_check_mode(path);
        result = read_file(path, tokens);
    }
    free(path);
    return result;
}

void http_tokens_forget(http_tokens_t *tokens)
{
    sodium_memzero(tokens, sizeof *tokens);
}

/* ---- asking -------------------------------------------------------------------------------------------- */

http_right_t http_tokens_right(const http_tokens_t *tokens, const char *authorization)
{
    static const char scheme[] = "Bearer ";
    size_t length = sizeof scheme - 1;
    if (authorization == NULL || strncasecmp(authorization, scheme, length) != 0) return HTTP_ANYBODY;
    const char *token = authorization + length;
    if (strlen(token) != HTTP_TOKEN_TEXT) return HTTP_ANYBODY;
    bool operate = sodium_memcmp(token, tokens->operate, HTTP_TOKEN_TEXT) == 0;
    bool view = sodium_memcmp(token, tokens->view, HTTP_TOKEN_TEXT) == 0;
    return operate ? HTTP_OPERATE : view ? HTTP_VIEW : HTTP_ANYBODY;
}
