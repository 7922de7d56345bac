/* commands: what `lightmill` can do, in the order of its help. */
#ifndef LIGHTMILL_COMMANDS_H
#define LIGHTMILL_COMMANDS_H

#include "common/options/options.h"

extern const command_t render_command, submit_command, status_command, fetch_command, show_command,
    pause_command, resume_command, priority_command, change_command, cancel_command, extend_command,
    retain_command, release_command, delete_command, drain_command, allow_command, exclude_command,
    purge_command, take_out_command, open_command, keygen_command, import_command, info_command,
    compare_command, mix_command, completion_command;

#endif
