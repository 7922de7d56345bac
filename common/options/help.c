/* help: see help.h. */
#include "common/options/help.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>

enum { WIDTH = 100, INDENT = 24 /* columns of a line; before the text of an option */ };

/* "-o, --output FILE". */
static void option_title(const option_t *row, char text[100])
{
    char letter[8] = "";
    if (row->letter != 0) snprintf(letter, sizeof letter, "-%c, ", row->letter);
    bool implied = row->implied != NULL;
    const char *before = implied ? "[=" : row->argument != NULL ? " " : "";
    snprintf(text, 100, "%s--%s%s%s%s", letter, row->name, before, row->argument ? row->argument : "",
             implied ? "]" : "");
}

/* The subcommands and the options: a heading (or NULL) for each group, and its items. */
static void list_items(const command_t *command, void (*heading)(const char *),
                       void (*item)(const char *title, const char *text))
{
    const option_group_t *group;
    char title[100];
    if (command->subcommands != NULL) heading("Commands");
    for (const command_t *const *at = command->subcommands; at != NULL && *at != NULL; at++) {
        snprintf(title, sizeof title, "%s%s%s", command_word(*at), (*at)->arguments ? " " : "",
                 (*at)->arguments ? (*at)->arguments : "");
        item(title, (*at)->summary);
    }
    for (size_t g = 0; (group = command_group(command, g)) != NULL; g++) {
        heading(group->title);
        for (size_t i = 0; i < group->count; i++) {
            option_title(&group->rows[i], title);
            item(title, group->rows[i].help);
        }
    }
}

/* ---- the text of --help -------------------------------------------------------------------------------- */

/* Prints a paragraph in lines of at most WIDTH columns; the first begins at `column`, the others at `indent`.
 */
static void print_paragraph(const char *text, int indent, int column)
{
    const char *word = text;
    while (*word != '\0') {
        int length = (int)strcspn(word, " \n");
        if (column > indent && column + 1 + length > WIDTH) {
            putchar('\n');
            column = 0;
        }
        if (column < indent) column += printf("%*s", indent - column, "");
        column += printf("%s%.*s", column > indent ? " " : "", length, word);
        word += length;
        if (*word == '\n') {
            putchar('\n');
            column = 0;
        }
        word += *word != '\0';
    }
    putchar('\n');
}

/* A line of a list: what it is about, and in the column beside it what there is to say. */
static void print_item(const char *title, const char *text)
{
    int column = printf("  %s", title);
    if (column >= INDENT) {
        putchar('\n');
        column = 0;
    }
    print_paragraph(text, INDENT, column);
}

static void print_heading(const char *title)
{
    putchar('\n');
    if (title != NULL) printf("%s:\n", title);
}

void help_print(const command_t *command)
{
    printf("usage: %s%s%s%s\n\n", command->name, command->arguments ? " " : "",
           command->arguments ? command->arguments : "", command->subcommands ? "" : " [options]");
    print_paragraph(command->about, 0, 0);
    list_items(command, print_heading, print_item);
    if (command->after == NULL) return;
    putchar('\n');
    print_paragraph(command->after, 0, 0);
}

/* ---- the manual page ----------------------------------------------------------------------------------- */

/* One character so that roff prints it and nothing else. */
static void put_roff(char c)
{
    if (c == '\\')
        fputs("\\e", stdout);
    else if (c == '-')
        fputs("\\-", stdout);
    else if (c == '~')
        fputs("\\(ti", stdout);
    else if (c == '^')
        fputs("\\(ha", stdout);
    else
        putchar(c);
}

/* Running text: a blank line begins a paragraph, other ends of lines stay. */
static void print_roff(const char *text)
{
    bool begins = true;
    for (; *text != '\0'; text++) {
        if (text[0] == '\n') {
            fputs(text[1] == '\n' ? "\n.PP\n" : "\n.br\n", stdout);
            text += text[1] == '\n';
            begins = true;
            continue;
        }
        if (begins && (*text == '.' || *text == '\'')) fputs("\\&", stdout);
        begins = false;
        put_roff(*text);
    }
    putchar('\n');
}

static void print_roff_heading(const char *title)
{
    if (title == NULL) return;
    fputs(".SS ", stdout);
    print_roff(title);
}

static void print_roff_item(const char *title, const char *text)
{
    fputs(".TP\n.B ", stdout);
    print_roff(title);
    print_roff(text);
}

/* Page names have a dash where commands have a blank. */
static void print_page_name(const char *name, bool capitals)
{
    for (; *name != '\0'; name++) {
        char c = *name == ' ' ? '-' : *name;
        put_roff(capitals ? (char)toupper((unsigned char)c) : c);
    }
}

void help_print_man(const command_t *command)
{
    fputs(".TH ", stdout);
    print_page_name(command->name, true);
    fputs(" 1 \"\" \"Lightmill " LIGHTMILL_VERSION "\" \"Lightmill\"\n.nh\n.SH NAME\n", stdout);
    print_page_name(command->name, false);
    fputs(" \\- ", stdout);
    print_roff(command->summary);
    fputs(".SH SYNOPSIS\n.B ", stdout);
    print_roff(command->name);
    if (command->arguments != NULL) print_roff(command->arguments);
    if (command->subcommands == NULL) puts("[options]");
    puts(".SH DESCRIPTION");
    print_roff(command->about);
    puts(".SH OPTIONS");
    list_items(command, print_roff_heading, print_roff_item);
    if (command->after == NULL) return;
    puts(".SH NOTES");
    print_roff(command->after);
}
