/* completion: see completion.h. */
#include "common/options/completion.h"

#include <stdio.h>
#include <string.h>

/* Prints a candidate if it begins with what was typed so far. */
static void offer(const char *candidate, const char *typed)
{
    if (strncmp(candidate, typed, strlen(typed)) == 0) puts(candidate);
}

/* The row that a word names: "--name" or "-o"; NULL when it names none, or brings its value with it. */
static const option_t *named(const command_t *command, const char *word)
{
    const option_t *row;
    if (word[0] != '-') return NULL;
    for (size_t i = 0; (row = command_option(command, i, NULL)) != NULL; i++) {
        if (word[1] == '-' && strcmp(word + 2, row->name) == 0) return row;
        if (row->letter != 0 && word[1] == row->letter && word[2] == '\0') return row;
    }
    return NULL;
}

static void offer_options(const command_t *command, const char *typed)
{
    const option_t *row;
    for (size_t i = 0; (row = command_option(command, i, NULL)) != NULL; i++) {
        char text[100];
        snprintf(text, sizeof text, "--%s", row->name);
        offer(text, typed);
    }
}

void completion_print(const command_t *command, int count, char **words)
{
    if (count < 1) return;
    const char *typed = words[count - 1];
    const command_t *subcommand = count > 1 ? command_find(command, words[0]) : NULL;
    if (subcommand != NULL) {
        completion_print(subcommand, count - 1, words + 1);
        return;
    }
    const command_t *const *at = command->subcommands;
    for (; at != NULL && *at != NULL; at++) offer(command_word(*at), typed);
    const option_t *before = count > 1 ? named(command, words[count - 2]) : NULL;
    if (before == NULL || before->argument == NULL || before->implied != NULL) {
        if (typed[0] == '-') offer_options(command, typed);
        return;
    }
    for (const char *const *choice = before->choices; choice != NULL && *choice != NULL; choice++)
        offer(*choice, typed);
}
