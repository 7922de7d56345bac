/* lightmill: the command of people; each subcommand is a file in commands/. */
#include "client/commands/commands.h"

static const command_t *const commands[] = {&render_command,   &submit_command,     &status_command,
                                            &fetch_command,    &show_command,       &pause_command,
                                            &resume_command,   &priority_command,   &change_command,
                                            &cancel_command,   &extend_command,     &retain_command,
                                            &release_command,  &delete_command,     &allow_command,
                                            &exclude_command,  &drain_command,      &purge_command,
                                            &take_out_command, &open_command,       &keygen_command,
                                            &import_command,   &info_command,       &compare_command,
                                            &mix_command,      &completion_command, NULL};

static const command_t lightmill = {
    .name = "lightmill",
    .arguments = "COMMAND [ARGUMENTS]",
    .subcommands = commands,
    .summary = "render images on one machine or on many",
    .about = "Renders images on this machine, or hands them to a master that shares them out to many. "
             "lightmill COMMAND --help tells more of a command. The other programs are lightmill-master, "
             "lightmill-worker and lightmill-relay.\n\n"
             "An option's value follows it as a word or after \"=\". A name may be cut short as long as it "
             "fits one option only; scripts should not. Words after -- are arguments.",
    .after = "Exit codes:\n"
             "0 success\n"
             "1 the command line is wrong\n"
             "2 a file is missing or malformed\n"
             "3 the operating system refused\n"
             "4 the master broke the protocol\n"
             "5 a limit was exceeded, or memory ran out\n"
             "6 the master does not answer\n"
             "7 cancelled by a user or a signal\n"
             "8 the images differ (compare)\n"
             "9 a key is missing, not accepted, or lacks the right"};

int main(int argc, char **argv)
{
    return command_main(&lightmill, argc, argv);
}
