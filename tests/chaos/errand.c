/* errand: see errand.h. */
#include "tests/chaos/errand.h"

#include "tests/chaos/process.h"

#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

void errand_start(errand_t *errand, const char *output, const char *const *arguments, bool background)
{
    char *program = process_program("lightmill");
    unlink(output);
    free(errand->output);
    errand->output = mem_strdup(output);
    const process_setup_t setup = {
        .program = program, .arguments = arguments, .log = output, .network = -1, .background = background};
    errand->process = process_start(&setup);
    errand->started = clock_now();
    free(program);
}

errand_state_t errand_poll(errand_t *errand, double now, double limit)
{
    int how;
    if (errand->process == 0) return ERRAND_NONE;
    if (!process_ended(errand->process, &how)) {
        if (now < errand->started + limit) return ERRAND_RUNS;
        process_kill(errand->process);
        how = PROCESS_SIGNALLED + SIGKILL;
    }
    errand->process = 0;
    errand->how = how;
    return how == 0 ? ERRAND_DONE : ERRAND_FAILED;
}

char *errand_said(const errand_t *errand)
{
    uint8_t *bytes = NULL;
    size_t size = 0;
    if (file_read(errand->output, 1 << 24, &bytes, &size).code != RESULT_OK) return mem_strdup("");
    char *text = mem_zalloc(1, size + 1);
    memcpy(text, bytes, size);
    free(bytes);
    return text;
}

void errand_end(errand_t *errand)
{
    if (errand->process) process_kill(errand->process);
    free(errand->output);
    *errand = (errand_t){0};
}
