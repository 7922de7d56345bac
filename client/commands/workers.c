/* workers: the commands that tell a master what is to be done with its workers: drain, purge. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"

#include <stdio.h>
#include <string.h>

/* Gives one order for each of the words, or one without any, and says what was done. */
static result_t order_each(worker_order_t kind, const call_t *call, const char *done)
{
    remote_t *remote;
    result_t first = result_ok();
    TRY(master_connect(call->values, &remote));
    for (int i = 0; i < (call->count > 0 ? call->count : 1) && first.code != RESULT_UNREACHABLE; i++) {
        char said[REMOTE_SAID];
        uint32_t count = 0;
        const char *who = call->count > 0 ? call->arguments[i] : "";
        result_t result = remote_order_workers(remote, kind, who, &count, said);
        if (result.code == RESULT_OK && said[0] != '\0')
            printf("%s\n", said);
        else if (result.code == RESULT_OK)
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
        "code 0. "
        "WORKER is a name as lightmill status --workers shows it, or a host, which means all its workers.\n\n"
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
