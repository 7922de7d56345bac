/* base: results, log, clocks, memory, hashing and whole-file input and output (see base.h). */
#include "common/base.h"

#include "common/plain_text.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sodium.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

result_t result_ok(void)
{
    return (result_t){.code = RESULT_OK};
}

result_t result_fail(result_code_t code, const char *format, ...)
{
    result_t result = {.code = code};
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(result.message, sizeof result.message, format, arguments);
    va_end(arguments);
    return result;
}

int result_exit_code(result_t result)
{
    return (int)result.code;
}

/* The log's own state: set once before threads start, then only read. */
static struct {
    char name[64];
    log_level_t least;
} log_state = {.name = "lightmill", .least = LOG_INFO};

void log_init(const char *name, log_level_t least)
{
    snprintf(log_state.name, sizeof log_state.name, "%s", name);
    log_state.least = least;
}

/* ISO 8601 with the offset from UTC: unambiguous in every time zone, and on the night when clocks go back. */
static void format_time(char text[64])
{
    time_t now = time(NULL);
    struct tm local;
    localtime_r(&now, &local);
    int minutes = (int)(local.tm_gmtoff / 60);
    size_t used = strftime(text, 64, "%Y-%m-%dT%H:%M:%S", &local);
    snprintf(text + used, 64 - used, "%c%02d:%02d", minutes < 0 ? '-' : '+', abs(minutes) / 60,
             abs(minutes) % 60);
}

void log_write(log_level_t level, const char *format, ...)
{
    static const char *const names[] = {"debug", "info", "warning", "error"};
    if (level < log_state.least) return;
    char text[1024], when[64];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    plain_text_clean(text); /* names come from strangers */
    format_time(when);
    /* One call, so that lines of threads and processes do not mix. */
    fprintf(stderr, "%s %s %s: %s\n", when, log_state.name, names[level], text);
}

static double clock_read(clockid_t id)
{
    struct timespec now;
    clock_gettime(id, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

double clock_now(void)
{
    return clock_read(CLOCK_MONOTONIC);
}

double clock_wall(void)
{
    return clock_read(CLOCK_REALTIME);
}

static void *checked(void *memory, size_t size)
{
    if (memory == NULL && size > 0) {
        fprintf(stderr, "lightmill: out of memory (%zu bytes wanted)\n", size);
        exit(RESULT_LIMIT);
    }
    return memory;
}

void *mem_alloc(size_t size)
{
    return checked(malloc(size), size);
}

void *mem_zalloc(size_t count, size_t size)
{
    return checked(calloc(count, size), size);
}

void *mem_realloc(void *old, size_t size)
{
    return checked(realloc(old, size), size);
}

char *mem_strdup(const char *text)
{
    return checked(strdup(text), strlen(text));
}

char *mem_printf(const char *format, ...)
{
    char *text = NULL;
    va_list arguments;
    va_start(arguments, format);
    if (vasprintf(&text, format, arguments) < 0) text = NULL;
    va_end(arguments);
    return checked(text, strlen(format));
}

hash_t hash_bytes(const void *data, size_t size)
{
    hash_t hash;
    crypto_generichash(hash.bytes, HASH_BYTES, data, size, NULL, 0);
    return hash;
}

bool hash_is_zero(const hash_t *hash)
{
    return hash_equal(hash, &(hash_t){{0}});
}

bool hash_equal(const hash_t *a, const hash_t *b)
{
    return memcmp(a->bytes, b->bytes, HASH_BYTES) == 0;
}

void hash_to_hex(const hash_t *hash, char text[2 * HASH_BYTES + 1])
{
    sodium_bin2hex(text, 2 * HASH_BYTES + 1, hash->bytes, HASH_BYTES);
}

bool hash_from_hex(const char *text, size_t length, hash_t *hash)
{
    return length == 2 * HASH_BYTES &&
           sodium_hex2bin(hash->bytes, HASH_BYTES, text, length, NULL, NULL, NULL) == 0;
}

result_t file_open(const char *path, int *descriptor, struct stat *about)
{
    /* Opening a FIFO would wait for its other end. */
    *descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
    if (*descriptor < 0) return result_fail(RESULT_INPUT, "%s: cannot be opened: %s", path, strerror(errno));
    if (fstat(*descriptor, about) == 0 && S_ISREG(about->st_mode)) return result_ok();
    close(*descriptor);
    *descriptor = -1;
    return result_fail(RESULT_INPUT, "%s: is not a regular file", path);
}

result_t file_read(const char *path, size_t limit, uint8_t **data, size_t *size)
{
    *data = NULL;
    *size = 0;
    int file;
    struct stat about;
    TRY(file_open(path, &file, &about));
    result_t result = result_ok();
    if ((uint64_t)about.st_size > limit)
        result = result_fail(RESULT_INPUT, "%s: %lld bytes is over the limit of %zu", path,
                             (long long)about.st_size, limit);
    if (result.code == RESULT_OK) {
        size_t want = (size_t)about.st_size, got = 0;
        uint8_t *bytes = malloc(want + 1);
        if (bytes == NULL) result = result_fail(RESULT_LIMIT, "%s: no memory for %zu bytes", path, want);
        while (bytes != NULL && got < want) {
            ssize_t n = read(file, bytes + got, want - got);
            if (n < 0 && errno == EINTR) continue;
            if (n <= 0) break;
            got += (size_t)n;
        }
        if (bytes != NULL && got < want) {
            result = result_fail(RESULT_INPUT, "%s: cannot be read to its end: %s", path, strerror(errno));
            free(bytes);
        } else if (bytes != NULL) {
            bytes[want] = 0;
            *data = bytes;
            *size = want;
        }
    }
    close(file);
    return result;
}

result_t directory_make(const char *path, unsigned permissions)
{
    char *copy = mem_strdup(path);
    result_t result = result_ok();
    for (char *slash = copy + (*copy == '/'); result.code == RESULT_OK; slash++) {
        char end = *slash;
        if (end != '/' && end != '\0') continue;
        *slash = '\0';
        if (mkdir(copy, permissions) != 0 && errno != EEXIST)
            result = result_fail(RESULT_IO, "cannot make the directory %.300s: %s", copy, strerror(errno));
        *slash = end;
        if (end == '\0') break;
    }
    free(copy);
    return result;
}
