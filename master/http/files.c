/* files: see files.h. The Makefile makes the table, http_web_files, from the folder web/. */
#include "master/http/files.h"

#include <stdio.h>
#include <string.h>

typedef struct {
    const char *name; /* "app.js" */
    const uint8_t *bytes;
    uint64_t size;
} web_file_t;

/* Made by the build; ends with a name of NULL. */
extern const web_file_t http_web_files[];

static const struct {
    const char *ending, *type;
} types[] = {{".html", "text/html; charset=utf-8"},
             {".js", "text/javascript; charset=utf-8"},
             {".mjs", "text/javascript; charset=utf-8"},
             {".css", "text/css; charset=utf-8"},
             {".svg", "image/svg+xml"},
             {".png", "image/png"},
             {".ico", "image/x-icon"},
             {".json", "application/json"},
             {".txt", "text/plain; charset=utf-8"}};

static const char *type_of(const char *name)
{
    const char *ending = strrchr(name, '.');
    for (size_t i = 0; ending != NULL && i < ARRAY_LENGTH(types); i++)
        if (strcmp(ending, types[i].ending) == 0) return types[i].type;
    return "application/octet-stream";
}

static const web_file_t *find(const char *path)
{
    const char *name = strcmp(path, "/") == 0 ? "index.html" : path + 1;
    for (const web_file_t *file = http_web_files; path[0] == '/' && file->name != NULL; file++)
        if (strcmp(file->name, name) == 0) return file;
    return NULL;
}

bool http_files_have(const char *path)
{
    return find(path) != NULL;
}

bool http_files_serve(http_request_t *request)
{
    const web_file_t *file = find(request->path);
    if (file == NULL) return false;
    char hex[2 * HASH_BYTES + 1], etag[40];
    hash_t hash = hash_bytes(file->bytes, file->size);
    hash_to_hex(&hash, hex);
    snprintf(etag, sizeof etag, "\"%.32s\"", hex);
    http_reply_tagged(request, type_of(file->name), etag, file->bytes, file->size);
    return true;
}
