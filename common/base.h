/* base: the result type that every fallible call returns, the log, the clock, checked allocation, the hash.
 *
 * Errors travel as values. A function that can fail returns a result_t; its message is for people and names
 * the file, the line and the cure where there is one. Nothing that a peer sent or a user wrote may reach an
 * assert: asserts guard our own invariants only.
 */
#ifndef LIGHTMILL_BASE_H
#define LIGHTMILL_BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LIGHTMILL_VERSION "0.1.0"

typedef enum {
    RESULT_OK = 0,
    RESULT_USAGE,       /* the command line is wrong */
    RESULT_INPUT,       /* a user's file is wrong: missing, truncated, malformed, out of limits */
    RESULT_IO,          /* the operating system refused: disk full, no permission, broken socket */
    RESULT_PROTOCOL,    /* a peer broke the protocol */
    RESULT_LIMIT,       /* a hard limit was exceeded, or memory ran out */
    RESULT_UNREACHABLE, /* no answer from a peer in time */
    RESULT_CANCELLED,   /* a user or a signal ended it */
    RESULT_MISMATCH,    /* a comparison failed */
    RESULT_DENIED       /* a key is missing, unknown, or lacks the right */
} result_code_t;

typedef struct {
    result_code_t code;
    char message[500]; /* one line for people, without a final dot or newline; empty when code is RESULT_OK */
} result_t;

/* The successful result. */
result_t result_ok(void);
/* A failed result with a printf-style message; code must not be RESULT_OK. */
result_t result_fail(result_code_t code, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* The exit code of a process that ends with this result: 0 for success, distinct small numbers otherwise
 * (documented in `lightmill --help`). */
int result_exit_code(result_t result);

/* Returns from the calling function with the result of `call` if it failed. */
#define TRY(call)                                                                                            \
    do {                                                                                                     \
        result_t try_result_ = (call);                                                                       \
        if (try_result_.code != RESULT_OK) return try_result_;                                               \
    } while (0)

typedef enum { LOG_DEBUG, LOG_INFO, LOG_WARNING, LOG_ERROR } log_level_t;

/* Names the process in every line ("master", "worker 3") and sets the least level that is written. Call
 * before threads start. `name` is copied. */
void log_init(const char *name, log_level_t least);
/* Writes one line "2026-01-31T09:05:00+01:00 name level: text", the time that of the machine's zone, to
 * stderr; thread-safe. What must not be shown (plain_text.h) becomes '?'. */
void log_write(log_level_t level, const char *format, ...) __attribute__((format(printf, 2, 3)));
#define log_debug(...) log_write(LOG_DEBUG, __VA_ARGS__)
#define log_info(...) log_write(LOG_INFO, __VA_ARGS__)
#define log_warning(...) log_write(LOG_WARNING, __VA_ARGS__)
#define log_error(...) log_write(LOG_ERROR, __VA_ARGS__)

/* Seconds on a clock that never jumps (CLOCK_MONOTONIC). */
double clock_now(void);
/* Seconds since 1970. */
double clock_wall(void);

/* malloc, calloc and realloc that end the process with a message when memory runs out: for sizes that our own
 * code chose. A size that came from a peer or a file is checked against a limit first. */
void *mem_alloc(size_t size);
void *mem_zalloc(size_t count, size_t size);
void *mem_realloc(void *old, size_t size);
char *mem_strdup(const char *text);
/* A printf-style string in fresh memory; the caller frees it. */
char *mem_printf(const char *format, ...) __attribute__((format(printf, 1, 2)));

#define HASH_BYTES 32
typedef struct {
    uint8_t bytes[HASH_BYTES];
} hash_t;

/* BLAKE2b-256 (RFC 7693, libsodium) of `size` bytes. */
hash_t hash_bytes(const void *data, size_t size);
bool hash_equal(const hash_t *a, const hash_t *b);
/* All zero: where that stands for none. */
bool hash_is_zero(const hash_t *hash);
/* Writes 64 lower-case hex digits and a NUL to `text`. */
void hash_to_hex(const hash_t *hash, char text[2 * HASH_BYTES + 1]);

/* The reverse, of exactly 64 hex digits; false when the text is none such. */
bool hash_from_hex(const char *text, size_t length, hash_t *hash);

struct stat;
/* Opens a file to read it; the caller closes *descriptor. RESULT_INPUT at once, and -1, for what is no
 * regular file: a folder, a FIFO, a device. */
result_t file_open(const char *path, int *descriptor, struct stat *about);
/* Reads a whole file into fresh memory (the caller frees *data), with a zero byte behind it. A file over
 * `limit` bytes is an error. */
result_t file_read(const char *path, size_t limit, uint8_t **data, size_t *size);
/* Makes a directory and its parents where they are missing, with these permissions. */
result_t directory_make(const char *path, unsigned permissions);

#define ARRAY_LENGTH(a) (sizeof(a) / sizeof((a)[0]))

static inline int int_min(int a, int b)
{
    return a < b ? a : b;
}
static inline int int_max(int a, int b)
{
    return a > b ? a : b;
}

#endif
