/* own_directory: see own_directory.h.
 *
 * Only known names are touched: somebody may say --data and mean a directory that holds other things too. */
#include "common/own_directory.h"

#include <errno.h>
#include <fnmatch.h>
#include <fts.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { OTHERS = S_IRWXG | S_IRWXO };

typedef struct {
    size_t count; /* entries that others had rights to */
    int error;    /* errno of the last that could not be changed, 0 for none */
} tightened_t;

static bool is_ours(const FTSENT *entry, const char *const *names)
{
    if (entry->fts_level != 1) return true; /* the directory itself, or below a name of ours */
    for (; *names != NULL; names++)
        if (fnmatch(*names, entry->fts_name, 0) == 0) return true;
    return false;
}

static void tighten(const FTSENT *entry, tightened_t *done)
{
    const struct stat *about = entry->fts_statp;
    bool kind = entry->fts_info == FTS_F || (entry->fts_info == FTS_D && (about->st_mode & S_ISVTX) == 0);
    if (!kind || about->st_uid != geteuid() || (about->st_mode & OTHERS) == 0) return;
    if (chmod(entry->fts_path, about->st_mode & 07777 & ~(mode_t)OTHERS) == 0)
        done->count++;
    else if (errno != ENOENT)
        done->error = errno;
}

static tightened_t tighten_all(const char *path, const char *const *names)
{
    char *const roots[] = {(char *)path, NULL};
    tightened_t done = {0};
    FTS *tree = fts_open(roots, FTS_PHYSICAL | FTS_NOCHDIR | FTS_COMFOLLOW, NULL);
    if (tree == NULL) return (tightened_t){.error = errno};
    for (FTSENT *entry; (entry = fts_read(tree)) != NULL;)
        if (is_ours(entry, names))
            tighten(entry, &done);
        else
            fts_set(tree, entry, FTS_SKIP);
    fts_close(tree);
    return done;
}

result_t own_directory_open(const char *path, const char *const *names)
{
    struct stat about;
    bool missing = stat(path, &about) != 0;
    TRY(directory_make(path, 0700));
    if (missing) return result_ok();
    tightened_t done = tighten_all(path, names);
    if (done.count > 0)
        log_info("%s: other users of this machine had rights to %zu files and directories, and have none now",
                 path, done.count);
    if (done.error != 0)
        log_warning("%s: other users of this machine may have rights to it still: %s", path,
                    strerror(done.error));
    return result_ok();
}

/* True when what stands at `at`, `length` bytes long, is the path of the directory or the beginning of one in
 * it, and no other name or word that it is a part of. */
static bool is_whole(const char *message, const char *at, size_t length)
{
    static const char around[] = " \"'(:,;";
    char after = at[length];
    bool begins = at == message || strchr(around, at[-1]) != NULL;
    return begins && (after == '/' || (*at == '/' && (after == '\0' || strchr(around, after) != NULL)));
}

bool own_directory_hide(const char *path, char *message)
{
    size_t length = path != NULL ? strlen(path) : 0;
    while (length > 0 && path[length - 1] == '/') length--;
    if (length == 0 || strcmp(path, ".") == 0) return false;
    bool found = false;
    for (char *at = message; (at = memmem(at, strlen(at), path, length)) != NULL;) {
        if (!is_whole(message, at, length)) {
            at++;
            continue;
        }
        const char *rest = at + length;
        rest += strspn(rest, "/");
        memmove(at, rest, strlen(rest) + 1);
        found = true;
    }
    return found;
}
