/* keys: the CURVE keys by which masters, workers and clients know one another, and the files that hold them.
 *
 * A key is 32 bytes, written as the 40 characters of Z85, which has neither quotes nor blanks. A pair lies in
 * two files, whose lines may also be comments that begin with '#' (no key of ours does):
 *
 *     NAME.key          KEY               the public half, which may be given to anyone
 *
 *     NAME.secret       public KEY        both halves; nobody else may read it
 *                       secret KEY
 */
#ifndef LIGHTMILL_KEYS_H
#define LIGHTMILL_KEYS_H

#include "common/base.h"

enum {
    KEY_TEXT = 40,           /* characters of a key in Z85 */
    KEY_MAX_FILE = 64 << 10, /* bytes of a key file */
    KEY_MAX_LINE = 1000,     /* characters of a line in it, and in a list of keys */
    KEY_MAX_NAME = 63
};

typedef struct {
    char open[KEY_TEXT + 1];   /* the public half */
    char secret[KEY_TEXT + 1]; /* empty when only the public half is known */
} key_pair_t;

/* True for 40 characters of Z85 that stand for 32 bytes. */
bool key_valid(const char *text);
/* A new pair from the system's random numbers. */
result_t key_pair_new(key_pair_t *pair);
/* The pair of a secret half. */
result_t key_pair_complete(const char *secret, key_pair_t *pair);
/* Overwrites the secret half. */
void key_pair_forget(key_pair_t *pair);

/* The next line of a text, without blanks at its ends and without comments that begin it; empty lines are
 * left out. False at the end of the text. *number counts lines from 1 and starts at 0. RESULT_INPUT, with
 * `path` and the number, for lines that are too long or hold control characters. */
result_t key_next_line(const char **text, const char *end, const char *path, int *number,
                       char line[KEY_MAX_LINE + 1], bool *found);

/* The keys in the bytes of a key file; the secret half is empty when there is none. Errors name `path` and
 * the line. */
result_t key_file_parse(const char *text, size_t size, const char *path, key_pair_t *pair);
/* Reads a .secret file. */
result_t key_file_read_secret(const char *path, key_pair_t *pair);
/* Warns when other users can read or change a file with a secret key. */
void key_file_check_mode(const char *path);
/* Reads the public half from a .key (or .secret) file. */
result_t key_file_read_open(const char *path, char key[KEY_TEXT + 1]);
/* Makes a pair and writes DIR/NAME.secret (mode 0600) and DIR/NAME.key; the directory is made when missing.
 * RESULT_INPUT when there is such a file: keys are never written over. */
result_t key_files_make(const char *directory, const char *name, key_pair_t *pair);

/* $XDG_CONFIG_HOME/lightmill or ~/.config/lightmill in fresh memory; NULL when neither is known. */
char *key_default_directory(void);

#endif
