/* command: see command.h. */
#include "tests/chaos/command.h"

#include "tests/chaos/process.h"

#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

void command_start(command_t *command, const char *output, const char *const *arguments, bool background)
{
    char *program = process_program("lightmill");
    unlink(output);
    free(command->output);
    command->output = mem_strdup(output);
    const process_setup_t setup = {
        .program = program, .arguments = arguments, .log = output, .network = -1, .background = background};
    command->process = process_start(&setup);
    command->started = clock_now();
    free(program);
}

command_state_t command_poll(command_t *command, double now, double limit)
{
    int how;
    if (command->process == 0) return COMMAND_NONE;
    if (!process_ended(command->process, &how)) {
        if (now < command->started + limit) return COMMAND_RUNS;
        process_kill(command->process);
        how = PROCESS_SIGNALLED + SIGKILL;
    }
    command->process = 0;
    command->how = how;
    return how == 0 ? COMMAND_DONE : COMMAND_FAILED;
}

char *command_said(const command_t *command)
{
    uint8_t *bytes = NULL;
    size_t size = 0;
    if (file_read(command->output, 1 << 24, &bytes, &size).code != RESULT_OK) return mem_strdup("");
    char *text = mem_zalloc(1, size + 1);
    memcpy(text, bytes, size);
    free(bytes);
    return text;
}

void command_end(command_t *command)
{
    if (command->process) process_kill(command->process);
    free(command->output);
    *command = (command_t){0};
}
