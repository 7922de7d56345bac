/* options: see options.h. Here: a command line read by a command's table. */
#include "common/options/options.h"

#include "common/options/completion.h"
#include "common/options/guess.h"
#include "common/options/help.h"

#include <ctype.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const option_t standard_rows[] = {
    OPTION(standard_options_t, help, "help", NULL, "print this", .letter = 'h'),
    OPTION(standard_options_t, man, "man", NULL, "print it as a manual page, for man -l -"),
    OPTION(standard_options_t, version, "version", NULL, "print the version"),
};
const option_group_t standard_options = OPTION_GROUP(NULL, standard_rows);

/* ---- finding a row ------------------------------------------------------------------------------------- */

const char *command_word(const command_t *command)
{
    const char *blank = strrchr(command->name, ' ');
    return blank != NULL ? blank + 1 : command->name;
}

const command_t *command_find(const command_t *command, const char *word)
{
    const command_t *const *at = command->subcommands;
    while (at != NULL && *at != NULL && strcmp(command_word(*at), word) != 0) at++;
    return at != NULL ? *at : NULL;
}

const option_group_t *command_group(const command_t *command, size_t index)
{
    size_t count = 0;
    while (count < COMMAND_MAX_GROUPS && command->groups[count].group != NULL) count++;
    return index < count ? command->groups[index].group : index == count ? &standard_options : NULL;
}

const option_t *command_option(const command_t *command, size_t index, size_t *group)
{
    const option_group_t *at;
    for (size_t g = 0; (at = command_group(command, g)) != NULL; g++) {
        if (group != NULL) *group = g;
        if (index < at->count) return &at->rows[index];
        index -= at->count;
    }
    return NULL;
}

/* What a command line has said so far. */
typedef struct {
    call_t call;
    standard_options_t standard;
    const option_t *many; /* the option that takes the next word too; NULL: none */
    void *many_field;
} reading_t;

/* An option of a reading; `row` NULL: none. */
typedef struct {
    const option_t *row;
    void *field;
} found_t;

/* The row at an index of command_option, and where its value goes. */
static found_t option_at(reading_t *reading, size_t index)
{
    const command_t *command = reading->call.command;
    size_t group;
    const option_t *row = command_option(command, index, &group);
    if (row == NULL) return (found_t){0};
    bool standard = command_group(command, group) == &standard_options;
    char *base =
        standard ? (char *)&reading->standard : (char *)reading->call.values + command->groups[group].offset;
    return (found_t){row, base + row->offset};
}

static found_t find_letter(reading_t *reading, char letter)
{
    size_t i = 0;
    found_t found;
    while ((found = option_at(reading, i)).row != NULL && found.row->letter != letter) i++;
    return found;
}

static result_t unknown(const reading_t *reading, const char *word)
{
    char name[100];
    snprintf(name, sizeof name, "%.*s", (int)strcspn(word, "="), word);
    guess_t guess = {.wrong = name + strspn(name, "-")};
    const option_t *row;
    for (size_t i = 0; (row = command_option(reading->call.command, i, NULL)) != NULL; i++)
        guess_offer(&guess, row->name);
    if (guess.nearest == NULL)
        return result_fail(RESULT_USAGE, "unknown option %s; see %s --help", name,
                           reading->call.command->name);
    return result_fail(RESULT_USAGE, "unknown option %s; did you mean --%s?", name, guess.nearest);
}

/* Finds "name", or the one name that begins so. */
static result_t find_name(reading_t *reading, const char *word, size_t length, found_t *found)
{
    const option_t *other = NULL;
    *found = (found_t){0};
    found_t at;
    for (size_t i = 0; (at = option_at(reading, i)).row != NULL; i++) {
        if (strncmp(at.row->name, word + 2, length) != 0) continue;
        other = found->row;
        *found = at;
        if (at.row->name[length] == '\0') return result_ok();
    }
    if (other != NULL)
        return result_fail(RESULT_USAGE, "%.100s may be --%s or --%s", word, other->name, found->row->name);
    return found->row != NULL ? result_ok() : unknown(reading, word);
}

/* ---- reading ------------------------------------------------------------------------------------------- */

/* Gives an option its value: what follows its name, or else the next word, which is then used up. */
static result_t take_value(reading_t *reading, found_t found, const char *value, char ***next)
{
    if (found.row->argument == NULL && value != NULL)
        return result_fail(RESULT_USAGE, "--%s takes no value; see %s --help", found.row->name,
                           reading->call.command->name);
    if (value == NULL) value = found.row->implied;
    if (found.row->argument != NULL && value == NULL) {
        if (**next == NULL)
            return result_fail(RESULT_USAGE, "--%s needs a value, %s; see %s --help", found.row->name,
                               found.row->argument, reading->call.command->name);
        value = *(*next)++;
    }
    reading->many = found.row->many ? found.row : NULL;
    reading->many_field = found.field;
    return found.row->parse(found.row, value, found.field);
}

static result_t take_option(reading_t *reading, const char *word, char ***next)
{
    found_t found;
    if (word[1] != '-') {
        found = find_letter(reading, word[1]);
        if (found.row == NULL) return unknown(reading, word);
        return take_value(reading, found, word[2] != '\0' ? word + 2 : NULL, next);
    }
    size_t length = strcspn(word + 2, "=");
    TRY(find_name(reading, word, length, &found));
    return take_value(reading, found, word[2 + length] == '=' ? word + 2 + length + 1 : NULL, next);
}

static bool is_option(const char *word)
{
    return word[0] == '-' && word[1] != '\0' && !isdigit((unsigned char)word[1]);
}

static result_t read_words(reading_t *reading, char **next)
{
    bool arguments_only = false;
    while (*next != NULL) {
        char *word = *next++;
        if (!arguments_only && strcmp(word, "--") == 0) {
            arguments_only = true;
            reading->many = NULL;
        } else if (!arguments_only && is_option(word)) {
            TRY(take_option(reading, word, &next));
            const standard_options_t *asked = &reading->standard;
            if (asked->help || asked->man || asked->version) return result_ok();
        } else if (reading->many != NULL) {
            TRY(reading->many->parse(reading->many, word, reading->many_field));
        } else {
            reading->call.arguments[reading->call.count++] = word;
        }
    }
    return result_ok();
}

/* What the environment says, before the command line says otherwise. */
static result_t read_environment(reading_t *reading)
{
    found_t at;
    for (size_t i = 0; (at = option_at(reading, i)).row != NULL; i++) {
        const char *value = at.row->environment != NULL ? getenv(at.row->environment) : NULL;
        if (value != NULL && value[0] != '\0') TRY(at.row->parse(at.row, value, at.field));
    }
    return result_ok();
}

static result_t no_subcommand(const reading_t *reading)
{
    const command_t *command = reading->call.command;
    guess_t guess = {.wrong = reading->call.count > 0 ? reading->call.arguments[0] : ""};
    for (const command_t *const *at = command->subcommands; *at != NULL; at++)
        guess_offer(&guess, command_word(*at));
    if (reading->call.count == 0)
        return result_fail(RESULT_USAGE, "no command given; see %s --help", command->name);
    if (guess.nearest == NULL)
        return result_fail(RESULT_USAGE, "'%.100s' is no command; see %s --help", guess.wrong, command->name);
    return result_fail(RESULT_USAGE, "'%.100s' is no command; did you mean %s?", guess.wrong, guess.nearest);
}

/* How many arguments a command takes, from what help says of them. */
static void count_arguments(const char *words, int *least, int *most)
{
    *least = *most = 0;
    while (words != NULL && *words != '\0') {
        size_t length = strcspn(words, " ");
        *least += words[0] != '[';
        *most = strstr(words, "...") != NULL ? INT_MAX : *most + 1;
        words += length + strspn(words + length, " ");
    }
}

static result_t check_arguments(const reading_t *reading)
{
    const command_t *command = reading->call.command;
    if (command->subcommands != NULL) return no_subcommand(reading);
    int least, most;
    count_arguments(command->arguments, &least, &most);
    if (reading->call.count < least)
        return result_fail(RESULT_USAGE, "%s expects %s; see %s --help", command_word(command),
                           command->arguments, command->name);
    if (reading->call.count > most)
        return result_fail(RESULT_USAGE, "one argument too many: '%.100s'; see %s --help",
                           reading->call.arguments[most], command->name);
    return result_ok();
}

static result_t read_line(reading_t *reading, char **words)
{
    const standard_options_t *asked = &reading->standard;
    TRY(read_environment(reading));
    TRY(read_words(reading, words));
    if (asked->help)
        help_print(reading->call.command);
    else if (asked->man)
        help_print_man(reading->call.command);
    else if (asked->version)
        printf("%s " LIGHTMILL_VERSION "\n", reading->call.command->name);
    else {
        TRY(check_arguments(reading));
        return reading->call.command->run(&reading->call);
    }
    return result_ok();
}

static void free_lists(reading_t *reading)
{
    found_t at;
    for (size_t i = 0; (at = option_at(reading, i)).row != NULL; i++)
        if (at.row->parse == option_list) free(((option_list_t *)at.field)->texts);
}

/* "lightmill help [COMMAND]" */
static result_t command_help(const command_t *command, const char *word)
{
    const command_t *subcommand = word != NULL ? command_find(command, word) : command;
    if (subcommand == NULL)
        return result_fail(RESULT_USAGE, "'%.100s' is no command; see %s --help", word, command->name);
    help_print(subcommand);
    return result_ok();
}

result_t command_run(const command_t *command, int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "--complete") == 0) {
        completion_print(command, argc - 2, argv + 2);
        return result_ok();
    }
    const command_t *subcommand = argc > 1 ? command_find(command, argv[1]) : NULL;
    if (subcommand != NULL) return command_run(subcommand, argc - 1, argv + 1);
    if (argc > 1 && command->subcommands != NULL && strcmp(argv[1], "help") == 0)
        return command_help(command, argc > 2 ? argv[2] : NULL);
    reading_t reading = {.call.command = command};
    call_t *call = &reading.call;
    call->values = mem_zalloc(1, command->size + 1);
    call->arguments = mem_zalloc((size_t)argc + 1, sizeof *call->arguments);
    if (command->begin != NULL) command->begin(call->values);
    result_t result = read_line(&reading, argv + 1);
    free_lists(&reading);
    free(call->arguments);
    free(call->values);
    return result;
}

int command_main(const command_t *command, int argc, char **argv)
{
    log_init(command->name, LOG_WARNING);
    result_t result = command_run(command, argc, argv);
    if (result.code != RESULT_OK && result.message[0] != '\0')
        fprintf(stderr, "%s: %s\n", command->name, result.message);
    return result_exit_code(result);
}
