/* completion: the command that prints what teaches a shell to complete our command lines. The script asks the
 * program that is to be run (common/options/completion.h), so it knows nothing of options itself. */
#include "client/commands/commands.h"

#include <stdio.h>
#include <string.h>

static const char bash[] =
    "# What Lightmill's programs take, for bash: source this, or install it as a file of bash-completion.\n"
    "_lightmill() {\n"
    "    local IFS=$'\\n'\n"
    "    COMPREPLY=($(\"$1\" --complete \"${COMP_WORDS[@]:1:COMP_CWORD}\" 2>/dev/null))\n"
    "}\n"
    "complete -o default -F _lightmill lightmill lightmill-master lightmill-worker lightmill-relay\n";

static result_t run(const call_t *call)
{
    if (strcmp(call->arguments[0], "bash") != 0)
        return result_fail(RESULT_USAGE, "there is a script for bash only, not for '%.100s'",
                           call->arguments[0]);
    fputs(bash, stdout);
    return result_ok();
}

const command_t completion_command = {
    .name = "lightmill completion",
    .arguments = "SHELL",
    .summary = "a script for the shell, to complete our command lines",
    .about =
        "Prints a script that lets a shell complete the options of all Lightmill programs when you press "
        "Tab. SHELL is bash. For this shell alone:\n\n"
        "source <(lightmill completion bash)",
    .run = run};
