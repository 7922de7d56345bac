/* allow_edit: see allow_edit.h. */
#include "proto/serve/allow_edit.h"

#include "common/atomic_file.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* A list that is being changed; nobody else changes it meanwhile. */
typedef struct {
    char path[PATH_MAX]; /* without symbolic links: what they lead to is changed */
    int directory;       /* locked */
    char *text;
    size_t size;
    allow_list_t list;
} edit_t;

static void edit_end(edit_t *edit)
{
    allow_list_free(&edit->list);
    free(edit->text);
    if (edit->directory >= 0) close(edit->directory);
}

static result_t edit_begin(edit_t *edit, const char *path)
{
    char copy[PATH_MAX];
    *edit = (edit_t){.directory = -1};
    if (realpath(path, edit->path) == NULL)
        return result_fail(RESULT_INPUT, "%.300s: cannot be opened: %s", path, strerror(errno));
    snprintf(copy, sizeof copy, "%s", edit->path);
    edit->directory = open(dirname(copy), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (edit->directory < 0 || flock(edit->directory, LOCK_EX) != 0)
        return result_fail(RESULT_IO, "%.300s: its directory cannot be locked: %s", path, strerror(errno));
    TRY(file_read(edit->path, ALLOW_MAX_FILE, (uint8_t **)&edit->text, &edit->size));
    return allow_list_parse(edit->text, edit->size, path, &edit->list);
}

/* Puts the text in the place of the list, with its owner and its rights: the master has to read it. */
static result_t edit_write(const edit_t *edit, const char *text)
{
    atomic_file_t file;
    struct stat about;
    TRY(atomic_file_open(&file, edit->path));
    bool same = stat(edit->path, &about) == 0 && fchmod(file.descriptor, about.st_mode & 07777) == 0 &&
                fchown(file.descriptor, about.st_uid, about.st_gid) == 0;
    if (!same) {
        result_t result =
            result_fail(RESULT_IO, "%.300s: cannot be changed as this user: %s", edit->path, strerror(errno));
        atomic_file_abort(&file);
        return result;
    }
    atomic_file_write_at(&file, text, strlen(text), 0);
    return atomic_file_commit(&file);
}

/* ---- adding -------------------------------------------------------------------------------------------- */

static result_t parse_line(const char *line, allow_entry_t *entry)
{
    allow_list_t list;
    if (strchr(line, '\n') != NULL) return result_fail(RESULT_INPUT, "one line at a time, please");
    TRY(allow_list_parse(line, strlen(line), "the line", &list));
    bool one = list.count == 1;
    if (one) *entry = list.entries[0];
    allow_list_free(&list);
    return one ? result_ok() : result_fail(RESULT_INPUT, "the line holds no key");
}

static result_t add(const edit_t *edit, const char *line, const allow_entry_t *entry, bool *there)
{
    const allow_entry_t *known = allow_list_find(&edit->list, entry->key);
    *there = known != NULL && known->rights == entry->rights;
    if (*there) return result_ok();
    if (known != NULL)
        return result_fail(
            RESULT_INPUT,
            "line %d has this key with another right: it %s; exclude it first, or change that line",
            known->line, wire_rights_name(known->rights));
    bool ended = edit->size == 0 || edit->text[edit->size - 1] == '\n';
    char *text = mem_printf("%s%s%s\n", edit->text, ended ? "" : "\n", line);
    result_t result = edit_write(edit, text);
    free(text);
    return result;
}

result_t allow_edit_add(const char *path, const char *line, allow_entry_t *entry, bool *there)
{
    edit_t edit;
    *there = false;
    TRY(parse_line(line, entry));
    result_t result = edit_begin(&edit, path);
    if (result.code == RESULT_OK) result = add(&edit, line, entry, there);
    edit_end(&edit);
    return result;
}

/* ---- taking out ---------------------------------------------------------------------------------------- */

static result_t find(const allow_list_t *list, const char *path, const char *who, const allow_entry_t **found)
{
    size_t count = 0;
    *found = allow_list_find(list, who);
    if (*found != NULL) return result_ok();
    for (size_t i = 0; i < list->count; i++) {
        if (strcmp(list->entries[i].name, who) != 0) continue;
        *found = &list->entries[i];
        count++;
    }
    if (count == 1) return result_ok();
    return result_fail(RESULT_INPUT,
                       count == 0 ? "%.300s has no key \"%.60s\", nor one of that name"
                                  : "%.300s has several keys of the name \"%.60s\": say which key",
                       path, who);
}

/* The text with the line of that number made a comment; the caller frees it. */
static char *comment_out(const char *text, int number)
{
    char date[32];
    time_t now = time(NULL);
    struct tm local;
    localtime_r(&now, &local);
    strftime(date, sizeof date, "%Y-%m-%d %H:%M", &local);
    const char *line = text;
    for (int i = 1; i < number; i++) line = strchr(line, '\n') + 1;
    return mem_printf("%.*s# excluded %s: %s", (int)(line - text), text, date, line);
}

static result_t take_out(const edit_t *edit, const char *who, allow_entry_t *entry)
{
    const allow_entry_t *found;
    TRY(find(&edit->list, edit->path, who, &found));
    *entry = *found;
    char *text = comment_out(edit->text, found->line);
    result_t result = edit_write(edit, text);
    free(text);
    return result;
}

result_t allow_edit_remove(const char *path, const char *who, allow_entry_t *entry)
{
    edit_t edit;
    result_t result = edit_begin(&edit, path);
    if (result.code == RESULT_OK) result = take_out(&edit, who, entry);
    edit_end(&edit);
    return result;
}
