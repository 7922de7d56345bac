/* files: see files.h. */
#include "client/import/pbrt/files.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "client/import/files/gunzip.h"

static const size_t largest_file = (size_t)1 << 34;

/* ---- a bound on how often files are included ----------------------------------------------------------- */

/* Few files may include one another very often. A scene may include FREE_INCLUDES files, and one more for
 * every Include that its bytes have room for, as far as they are of different files. */
enum { FREE_INCLUDES = 1 << 16, SHORTEST_INCLUDE = sizeof "Include\"a\"" };

static result_t count_file(pbrt_t *p, const struct stat *about, position_t at)
{
    char name[2 * 16 + 2]; /* what tells files apart */
    size_t before = p->seen.count;
    int length = snprintf(name, sizeof name, "%jx:%jx", (uintmax_t)about->st_dev, (uintmax_t)about->st_ino);
    intern_add(&p->seen, name, (size_t)length);
    if (p->seen.count > before) p->seen_bytes += (uint64_t)about->st_size;
    uint64_t most = FREE_INCLUDES + p->seen_bytes / SHORTEST_INCLUDE;
    if (p->file_count < most) return result_ok();
    return error_at(at, "more than %zu files are included", p->file_count - 1);
}

/* ---- opening ------------------------------------------------------------------------------------------- */

static result_t read_source(pbrt_t *p, const char *path, const char *label)
{
    uint8_t *data;
    size_t size;
    TRY(gunzip_read_file(path, largest_file, &data, &size));
    source_t *source = mem_alloc(sizeof *source);
    *source = (source_t){.path = mem_strdup(path), .label = mem_strdup(label), .data = data, .size = size};
    p->files = grow(p->files, &p->file_capacity, p->file_count + 1, sizeof(source_t *));
    p->files[p->file_count++] = p->sources[p->open_sources++] = p->source = source;
    p->builder->source_bytes += size;
    return result_ok();
}

/* Makes the lexer stand at the beginning of the innermost file. */
static void start(pbrt_t *p)
{
    source_t *source = p->source;
    lexer_t outer = p->lexer;
    p->lexer = lexer_begin(source->path, (const char *)source->data, source->size);
    p->lexer.forgiving = outer.forgiving;
    source->outer = outer;
}

result_t pbrt_open_main(pbrt_t *p, const char *path, const char *label)
{
    struct stat about = {0};
    (void)stat(path, &about); /* opening it says what is wrong */
    TRY(read_source(p, path, label));
    TRY(count_file(p, &about, (position_t){.path = p->source->path}));
    start(p);
    return result_ok();
}

static result_t check_cycle(const pbrt_t *p, const struct stat *about, const char *path, position_t at)
{
    struct stat open;
    for (int i = 0; i < p->open_sources; ++i)
        if (stat(p->sources[i]->path, &open) == 0 && open.st_dev == about->st_dev &&
            open.st_ino == about->st_ino)
            return error_at(at, "%s includes itself", path);
    return result_ok();
}

static result_t enter_path(pbrt_t *p, const char *path, const char *label, bool apart, position_t at)
{
    struct stat about;
    if (stat(path, &about) != 0) return error_at(at, "%s cannot be included: %s", path, strerror(errno));
    TRY(check_cycle(p, &about, path, at));
    TRY(count_file(p, &about, at));
    TRY(read_source(p, path, label));
    start(p);
    if (!apart) p->lexer.outer = &p->source->outer;
    return result_ok();
}

result_t pbrt_enter(pbrt_t *p, const char *name, bool apart, position_t at)
{
    if (p->open_sources == MAX_INCLUDES)
        return error_at(at, "files include one another deeper than %d", MAX_INCLUDES);
    char *path = pbrt_resolve(p, name);
    bool missing = pbrt_is_missing(path) && p->dialect.dialect == DIALECT_V3;
    result_t result =
        missing ? pbrt_slip(p, at, "it is left out", "%.300s cannot be included: %s", path, strerror(ENOENT))
                : enter_path(p, path, name, apart, at);
    free(path);
    return result;
}

/* ---- leaving ------------------------------------------------------------------------------------------- */

static void drop_innermost(pbrt_t *p)
{
    p->bytes_done += p->source->size;
    free(p->source->data);
    p->source->data = NULL;
    --p->open_sources;
    p->source = p->open_sources > 0 ? p->sources[p->open_sources - 1] : NULL;
}

void pbrt_leave_apart(pbrt_t *p, int depth)
{
    while (p->open_sources > depth + 1) drop_innermost(p);
    p->lexer = p->source->outer;
    drop_innermost(p);
}

void pbrt_drop_left_files(pbrt_t *p)
{
    while (p->open_sources > 1 && p->source->path != p->lexer.path) drop_innermost(p);
}

void pbrt_tell_progress(pbrt_t *p)
{
    enum { STEP = 1 << 16 };
    uint64_t done = p->bytes_done + (uint64_t)(p->lexer.cursor - p->lexer.data);
    if (done < p->bytes_told + STEP) return;
    p->bytes_told = done;
    report_progress(p->report, fmin((double)done / (double)p->builder->source_bytes, 1));
}
