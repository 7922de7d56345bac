/* keys: see keys.h. */
#include "proto/wire/keys.h"

#include "common/file_io.h"

#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zmq.h>

enum { KEY_BYTES = 32 };

/* ---- keys ---------------------------------------------------------------------------------------------- */

bool key_valid(const char *text)
{
    uint8_t bytes[KEY_BYTES];
    bool valid = strlen(text) == KEY_TEXT && zmq_z85_decode(bytes, text) != NULL;
    sodium_memzero(bytes, sizeof bytes);
    return valid;
}

static result_t no_curve(void)
{
    return result_fail(RESULT_IO, "this libzmq cannot encrypt: it was built without CURVE");
}

result_t key_pair_new(key_pair_t *pair)
{
    do {
        if (zmq_curve_keypair(pair->open, pair->secret) != 0) return no_curve();
    } while (pair->open[0] == '#'); /* a line that begins so would be a comment */
    return result_ok();
}

result_t key_pair_complete(const char *secret, key_pair_t *pair)
{
    if (!key_valid(secret))
        return result_fail(RESULT_INPUT, "a secret key has %d characters of Z85", KEY_TEXT);
    memmove(pair->secret, secret, KEY_TEXT + 1);
    if (zmq_curve_public(pair->open, pair->secret) == 0) return result_ok();
    return no_curve();
}

void key_pair_forget(key_pair_t *pair)
{
    sodium_memzero(pair->secret, sizeof pair->secret);
}

/* ---- lines --------------------------------------------------------------------------------------------- */

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

static result_t take_line(const char *start, size_t length, const char *path, int number,
                          char line[KEY_MAX_LINE + 1])
{
    while (length > 0 && is_blank(start[length - 1])) length--;
    while (length > 0 && is_blank(*start)) start++, length--;
    line[0] = '\0';
    if (length > 0 && *start == '#') return result_ok();
    if (length > KEY_MAX_LINE)
        return result_fail(RESULT_INPUT, "%s:%d: a line of %zu characters; is this the right file?", path,
                           number, length);
    for (size_t i = 0; i < length; i++)
        if (((unsigned char)start[i] < 0x20 && start[i] != '\t') || start[i] == 0x7f)
            return result_fail(RESULT_INPUT, "%s:%d: a control character; is this the right file?", path,
                               number);
    memcpy(line, start, length);
    line[length] = '\0';
    return result_ok();
}

result_t key_next_line(const char **text, const char *end, const char *path, int *number,
                       char line[KEY_MAX_LINE + 1], bool *found)
{
    *found = false;
    while (!*found && *text < end) {
        const char *newline = memchr(*text, '\n', (size_t)(end - *text));
        const char *stop = newline != NULL ? newline : end;
        ++*number;
        TRY(take_line(*text, (size_t)(stop - *text), path, *number, line));
        *text = newline != NULL ? newline + 1 : end;
        *found = line[0] != '\0';
    }
    return result_ok();
}

/* ---- reading key files --------------------------------------------------------------------------------- */

/* A line "public KEY", "secret KEY" or "KEY". */
static result_t parse_line(char *line, const char *path, int number, key_pair_t *pair)
{
    char *rest = line + strcspn(line, " \t"), *key = rest + strspn(rest, " \t");
    bool secret = strncmp(line, "secret", 6) == 0 && rest == line + 6;
    bool open = strncmp(line, "public", 6) == 0 && rest == line + 6;
    if (!secret && !open && *rest == '\0') {
        key = line;
        open = true;
    }
    if (!secret && !open)
        return result_fail(RESULT_INPUT, "%s:%d: expected \"public KEY\" or \"secret KEY\"", path, number);
    if (!key_valid(key))
        return result_fail(RESULT_INPUT, "%s:%d: a key has %d characters of Z85", path, number, KEY_TEXT);
    char *half = secret ? pair->secret : pair->open;
    if (half[0] != '\0')
        return result_fail(RESULT_INPUT, "%s:%d: a second %s key", path, number,
                           secret ? "secret" : "public");
    memcpy(half, key, KEY_TEXT + 1);
    return result_ok();
}

/* The public half follows from the secret one; if the file has it too, they must go together. */
static result_t match_halves(const char *path, key_pair_t *pair)
{
    if (pair->secret[0] == '\0') {
        if (pair->open[0] != '\0') return result_ok();
        return result_fail(RESULT_INPUT, "%s: there is no key in this file", path);
    }
    key_pair_t whole;
    TRY(key_pair_complete(pair->secret, &whole));
    bool same = pair->open[0] == '\0' || memcmp(whole.open, pair->open, sizeof whole.open) == 0;
    memcpy(pair->open, whole.open, sizeof whole.open);
    key_pair_forget(&whole);
    if (same) return result_ok();
    return result_fail(RESULT_INPUT, "%s: the public key does not belong to the secret one", path);
}

result_t key_file_parse(const char *text, size_t size, const char *path, key_pair_t *pair)
{
    const char *end = text + size;
    char line[KEY_MAX_LINE + 1];
    int number = 0;
    bool found;
    *pair = (key_pair_t){0};
    result_t result = key_next_line(&text, end, path, &number, line, &found);
    while (result.code == RESULT_OK && found) {
        result = parse_line(line, path, number, pair);
        if (result.code == RESULT_OK) result = key_next_line(&text, end, path, &number, line, &found);
    }
    sodium_memzero(line, sizeof line);
    if (result.code == RESULT_OK) result = match_halves(path, pair);
    if (result.code != RESULT_OK) key_pair_forget(pair);
    return result;
}

static result_t read_file(const char *path, key_pair_t *pair)
{
    uint8_t *bytes;
    size_t size;
    TRY(file_read(path, KEY_MAX_FILE, &bytes, &size));
    result_t result = key_file_parse((const char *)bytes, size, path, pair);
    sodium_memzero(bytes, size);
    free(bytes);
    return result;
}

result_t key_file_read_secret(const char *path, key_pair_t *pair)
{
    TRY(read_file(path, pair));
    if (pair->secret[0] != '\0') return result_ok();
    return result_fail(RESULT_INPUT, "%s: holds a public key only; the .secret file is needed here", path);
}

void key_file_check_mode(const char *path)
{
    struct stat status;
    if (stat(path, &status) == 0 && (status.st_mode & (S_IROTH | S_IWOTH | S_IWGRP)) != 0)
        log_warning("%s holds a secret key, and other users can %s it: chmod 600 it", path,
                    (status.st_mode & (S_IWOTH | S_IWGRP)) != 0 ? "change" : "read");
}

result_t key_file_read_open(const char *path, char key[KEY_TEXT + 1])
{
    key_pair_t pair;
    TRY(read_file(path, &pair));
    memcpy(key, pair.open, KEY_TEXT + 1);
    key_pair_forget(&pair);
    return result_ok();
}

/* ---- writing key files --------------------------------------------------------------------------------- */

/* Writes a file that must not exist yet. */
static result_t write_new(const char *path, mode_t mode, const char *text)
{
    int descriptor = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, mode);
    if (descriptor < 0 && errno == EEXIST)
        return result_fail(RESULT_INPUT,
                           "%.300s is there already, and keys are never written over: choose another "
                           "name, or move it away",
                           path);
    if (descriptor < 0) return result_fail(RESULT_IO, "cannot write %.300s: %s", path, strerror(errno));
    bool written = file_write_all(descriptor, text, strlen(text)) && fsync(descriptor) == 0;
    int error = errno;
    close(descriptor);
    if (written) return result_ok();
    unlink(path);
    return result_fail(RESULT_IO, "cannot write %.300s: %s", path, strerror(error));
}

static result_t write_pair(const char *open_path, const char *secret_path, const key_pair_t *pair)
{
    if (access(open_path, F_OK) == 0)
        return result_fail(RESULT_INPUT,
                           "%.300s is there already, and keys are never written over: choose another "
                           "name, or move it away",
                           open_path);
    char *secret = mem_printf(
        "# A secret key of Lightmill. Whoever has it can pass for its owner: keep it to yourself.\n"
        "public %s\n"
        "secret %s\n",
        pair->open, pair->secret);
    char *open_text = mem_printf("# A public key of Lightmill. It may be given to anyone.\n%s\n", pair->open);
    result_t result = write_new(secret_path, 0600, secret);
    if (result.code == RESULT_OK) {
        result = write_new(open_path, 0644, open_text);
        if (result.code != RESULT_OK) unlink(secret_path);
    }
    sodium_memzero(secret, strlen(secret));
    free(secret);
    free(open_text);
    return result;
}

/* True for names that make good file names and list entries. */
static bool is_good_name(const char *name)
{
    size_t length = strlen(name);
    return length > 0 && length <= KEY_MAX_NAME && name[0] != '.' && name[0] != '-' &&
           strspn(name, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._@-") == length;
}

result_t key_files_make(const char *directory, const char *name, key_pair_t *pair)
{
    if (!is_good_name(name))
        return result_fail(RESULT_USAGE, "'%.100s' is no name for a key: 1 to %d letters, digits and ._@-",
                           name, KEY_MAX_NAME);
    TRY(key_pair_new(pair));
    TRY(directory_make(directory, 0700));
    char *open_path = mem_printf("%s/%s.key", directory, name);
    char *secret_path = mem_printf("%s/%s.secret", directory, name);
    result_t result = write_pair(open_path, secret_path, pair);
    free(open_path);
    free(secret_path);
    return result;
}

char *key_default_directory(void)
{
    const char *config = getenv("XDG_CONFIG_HOME"), *home = getenv("HOME");
    if (config != NULL && config[0] == '/') return mem_printf("%s/lightmill", config);
    if (home != NULL && home[0] == '/') return mem_printf("%s/.config/lightmill", home);
    return NULL;
}
