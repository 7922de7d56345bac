/* workers: the commands for who may work and who no longer is to: drain, purge, allow, exclude.
 *
 * DESIGN. The first two are orders to the master, which any client may give, as it may cancel jobs. The list
 * of keys is changed on the master's machine alone: who may write the file may let in keys, and nobody else.
 * A client that has gone bad, or its stolen key, can then neither let in others nor lock out those who could
 * stop it. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "proto/serve/allow_edit.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Gives one order for each of the words, or one without any, and says what was done. */
static result_t order_each(worker_order_t kind, const call_t *call, const char *done)
{
    remote_t *remote;
    result_t first = result_ok();
    TRY(master_connect(call->values, &remote));
    for (int i = 0; i < (call->count > 0 ? call->count : 1) && first.code != RESULT_UNREACHABLE; i++) {
        uint32_t count = 0;
        const char *who = call->count > 0 ? call->arguments[i] : "";
        result_t result = remote_order_workers(remote, kind, who, &count);
        if (result.code == RESULT_OK)
            printf("%u worker%s %s\n", count, count == 1 ? "" : "s", done);
        else if (first.code == RESULT_OK)
            first = result;
        else
            log_error("%s", result.message);
    }
    remote_close(&remote);
    return first;
}

static result_t run_drain(const call_t *call)
{
    return order_each(WORKERS_DRAIN, call, "asked to leave");
}

const command_t drain_command = {
    .name = "lightmill drain",
    .arguments = "WORKER...",
    .summary = "let workers deliver what they have, and leave",
    .about =
        "Drains workers: they are given nothing more, finish and deliver what they hold, and end with exit "
        "code 0. WORKER is a name as lightmill status --workers shows it, or a host, which means all its "
        "workers.\n\n"
        "What they do not finish within their --grace goes to others. Nothing is lost or counted twice.",
    .after = "A supervisor that starts ended processes again brings a worker back: under systemd say "
             "Restart=on-failure. docs/workers.md tells more.",
    .groups = {{&master_options, 0}, {&dial_options, offsetof(master_option_t, dial)}},
    .size = sizeof(master_option_t),
    .begin = master_option_begin,
    .run = run_drain};

static result_t run_purge(const call_t *call)
{
    return order_each(WORKERS_PURGE, call, "forgotten");
}

const command_t purge_command = {
    .name = "lightmill purge",
    .summary = "forget the workers that are gone",
    .about =
        "Takes the workers that are gone from the list of lightmill status --workers. The master does so by "
        "itself an hour after they were last heard of, or five minutes if they never delivered anything. "
        "Those that are put aside stay on the list.",
    .groups = {{&master_options, 0}, {&dial_options, offsetof(master_option_t, dial)}},
    .size = sizeof(master_option_t),
    .begin = master_option_begin,
    .run = run_purge};

/* ---- the list of keys ---------------------------------------------------------------------------------- */

typedef struct {
    const char *data_dir, *path; /* NULL: DATA/keys/allow */
} list_option_t;

static const option_t list_rows[] = {
    OPTION(list_option_t, data_dir, "data", "DIR", "the master's data directory (default: lightmill-data)"),
    OPTION(list_option_t, path, "allow", "FILE",
           "the list, where the master was told so (default: DATA/keys/allow)"),
};
static const option_group_t list_options = OPTION_GROUP(NULL, list_rows);

static void list_option_begin(void *data)
{
    *(list_option_t *)data = (list_option_t){.data_dir = "lightmill-data"};
}

/* The caller frees it. */
static char *list_path(const list_option_t *values)
{
    return values->path != NULL ? mem_strdup(values->path) : mem_printf("%s/keys/allow", values->data_dir);
}

static result_t allow_line(const char *path, const char *line)
{
    allow_entry_t entry;
    bool there;
    TRY(allow_edit_add(path, line, &entry, &there));
    const char *called = entry.name[0] != '\0' ? entry.name : entry.key;
    printf("%s %s%s\n", called, there ? "was on the list already: it " : "", wire_rights_name(entry.rights));
    return result_ok();
}

/* The words of the command line are one line: who pastes it without quotes has not lost the blanks, at least.
 */
static result_t allow_words(const char *path, const call_t *call)
{
    char line[KEY_MAX_LINE + 1] = "";
    for (int i = 0; i < call->count; i++) {
        size_t used = strlen(line);
        snprintf(line + used, sizeof line - used, "%s%s", i > 0 ? " " : "", call->arguments[i]);
    }
    return allow_line(path, line);
}

static result_t allow_input(const char *path)
{
    char line[KEY_MAX_LINE + 2];
    while (fgets(line, sizeof line, stdin) != NULL) {
        line[strcspn(line, "\r\n")] = '\0';
        size_t blank = strspn(line, " \t");
        if (line[blank] == '\0' || line[blank] == '#') continue;
        TRY(allow_line(path, line + blank));
    }
    return result_ok();
}

static result_t run_allow(const call_t *call)
{
    char *path = list_path(call->values);
    bool input = call->count == 0 || (call->count == 1 && strcmp(call->arguments[0], "-") == 0);
    result_t result = input ? allow_input(path) : allow_words(path, call);
    free(path);
    return result;
}

const command_t allow_command = {
    .name = "lightmill allow",
    .arguments = "[KEY-LINE...]",
    .summary = "let a key in, on the master's machine",
    .about =
        "Adds the line that lightmill keygen printed to the list of keys that a master lets in. Quote it "
        "with '...', since keys hold characters that a shell would take for its own; or leave it out and "
        "give it, and others, on standard input.\n\n"
        "It is called on the master's machine by who may write the list. The master reads it within a "
        "second.",
    .groups = {{&list_options, 0}},
    .after = "lightmill exclude takes a key out again. docs/security.md tells the rest.",
    .size = sizeof(list_option_t),
    .begin = list_option_begin,
    .run = run_allow};

static result_t run_exclude(const call_t *call)
{
    char *path = list_path(call->values);
    result_t result = result_ok();
    for (int i = 0; i < call->count && result.code == RESULT_OK; i++) {
        allow_entry_t entry;
        result = allow_edit_remove(path, call->arguments[i], &entry);
        if (result.code != RESULT_OK) break;
        printf("%s is excluded: line %d is a comment now\n", entry.name[0] != '\0' ? entry.name : entry.key,
               entry.line);
    }
    free(path);
    return result;
}

const command_t exclude_command = {
    .name = "lightmill exclude",
    .arguments = "KEY...",
    .summary = "let keys in no more, on the master's machine",
    .about =
        "Takes keys from the list of those that a master lets in. KEY is the key, or its name on the list, "
        "as lightmill status --workers shows it. Its line becomes a comment with the date; lightmill allow "
        "lets it in again.\n\n"
        "It is called on the master's machine by who may write the list. Within a second the master refuses "
        "every message of who has the key; what it had in hand goes to others when its lease ends. What it "
        "has delivered stays counted, unless lightmill take-out takes it out.",
    .groups = {{&list_options, 0}},
    .after = "Without keys there is nobody to exclude: a firewall keeps an address away.",
    .size = sizeof(list_option_t),
    .begin = list_option_begin,
    .run = run_exclude};
