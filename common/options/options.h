/* options: the command line of all programs and subcommands.
 *
 * DESIGN. A command is a constant: its name, what it is for, and tables with one row for an option. From
 * these rows come the parser (options.c), --help and the manual page (help.c) and what a shell completes
 * (completion.c), so that none of them can lack an option. A row knows by its offset where its value belongs
 * in a struct; several commands share a table by holding such a struct in theirs.
 *
 * What is accepted: --name VALUE, --name=VALUE, -o VALUE, -oVALUE (an option whose value may be missing takes
 * it with the equals sign only), options and arguments in any order, "--"
 * before arguments that begin with a dash (negative numbers need none), and beginnings of names that fit one
 * option only, as getopt_long takes them. The last of several values counts.
 */
#ifndef LIGHTMILL_OPTIONS_H
#define LIGHTMILL_OPTIONS_H

#include "common/base.h"

/* ---- rows ---------------------------------------------------------------------------------------------- */

typedef struct option option_t;

/* Reads the text of a value (NULL for an option that takes none; kept, not copied) into the field that it is
 * for. RESULT_USAGE names the option, what it takes and the text. */
typedef result_t (*option_parser_t)(const option_t *option, const char *text, void *field);

struct option {
    const char *name;     /* without its dashes */
    const char *argument; /* what help calls the value; NULL: the option takes none */
    const char *help;     /* one paragraph; help breaks its lines */
    option_parser_t parse;
    size_t offset;              /* of the field in the table's struct */
    double least, most;         /* of a number */
    const char *const *choices; /* the texts that are taken, NULL at the end; NULL: any */
    const char *environment;    /* a variable that stands in for the option; NULL: none */
    char letter;                /* "-o"; 0: none */
    bool many;                  /* takes all words up to the next option */
    const char *implied; /* the value when none is given: it is given as --name=VALUE only; NULL: none */
};

/* Takes a flag: the field is a bool. */
result_t option_flag(const option_t *option, const char *text, void *field);
/* Keeps the text, one of the row's choices where there are any: the field is a const char *. */
result_t option_text(const option_t *option, const char *text, void *field);
/* Whole numbers from `least` to `most`. */
result_t option_int32(const option_t *option, const char *text, void *field);
result_t option_uint32(const option_t *option, const char *text, void *field);
result_t option_uint64(const option_t *option, const char *text, void *field);
/* A number from `least` to `most`: the field is a double. */
result_t option_real(const option_t *option, const char *text, void *field);
/* A share from 0 to 1, "0.01" or "1%": the field is a double. */
result_t option_share(const option_t *option, const char *text, void *field);
/* Gigabytes from `least` to `most`: the field is a uint64_t and gets bytes. */
result_t option_gigabytes(const option_t *option, const char *text, void *field);
/* One of the choices: the field is an enum whose values count them from 1. */
result_t option_choice(const option_t *option, const char *text, void *field);
/* Texts one after the other: the field is an option_list_t. */
typedef struct {
    const char **texts; /* freed when the command has run; each is kept */
    size_t count;
} option_list_t;
result_t option_list(const option_t *option, const char *text, void *field);

/* A row for a field of a struct; the field's type chooses the parser. Further fields of the row follow. */
#define OPTION(type, field, name_, argument_, help_, ...)                                                    \
    OPTION_BY(OPTION_PARSER(((type *)0)->field), type, field, name_, argument_, help_, __VA_ARGS__)
/* The same with a parser of its own. */
#define OPTION_BY(parser, type, field, name_, argument_, help_, ...)                                         \
    {                                                                                                        \
        .name = name_, .argument = argument_, .help = help_, .parse = parser,                                \
        .offset = offsetof(type, field), __VA_ARGS__                                                         \
    }
#define OPTION_PARSER(field)                                                                                 \
    _Generic((field),                                                                                        \
        bool: option_flag,                                                                                   \
        const char *: option_text,                                                                           \
        int32_t: option_int32,                                                                               \
        uint32_t: option_uint32,                                                                             \
        uint64_t: option_uint64,                                                                             \
        double: option_real,                                                                                 \
        option_list_t: option_list)
#define OPTION_RANGE(least_, most_) .least = least_, .most = most_

/* ---- commands ------------------------------------------------------------------------------------------ */

/* A table of options that belong together. */
typedef struct {
    const char *title; /* over them in help; NULL: none */
    const option_t *rows;
    size_t count;
} option_group_t;
#define OPTION_GROUP(title_, rows_)                                                                          \
    {                                                                                                        \
        .title = title_, .rows = rows_, .count = ARRAY_LENGTH(rows_)                                         \
    }

enum { COMMAND_MAX_GROUPS = 8 };

/* A program or a subcommand. Of its texts blank lines part paragraphs, and help breaks the lines. */
typedef struct command command_t;
typedef struct call call_t;
struct command {
    const char *name;      /* "lightmill render" */
    const char *arguments; /* a word for each: "SCENE"; one in brackets may be missing, "JOB..." are one or
                              more; NULL: none */
    const char *summary;   /* what it does, in one line without a final dot */
    const char *about;     /* before the options */
    const char *after;     /* after them; NULL: nothing */
    struct {
        const option_group_t *group; /* NULL: the end */
        size_t offset;               /* of its struct in the command's values */
    } groups[COMMAND_MAX_GROUPS + 1];
    const command_t *const *subcommands; /* NULL at the end: one of them is run; NULL: this one */
    size_t size;                         /* of the values */
    void (*begin)(void *values);         /* sets the values that no option has changed yet; NULL: all zero */
    result_t (*run)(const call_t *call); /* does it */
};

/* A command with what its command line says. */
struct call {
    const command_t *command;
    void *values;
    char **arguments;
    int count; /* of the arguments */
};

/* Reads a command line (argv[0] is skipped) and runs the command, or does what --help, --man, --version or
 * the question of a shell (completion.h) asks for. RESULT_USAGE when the line is wrong. */
result_t command_run(const command_t *command, int argc, char **argv);
/* The main function of a program: runs it, prints the message of a failure, returns the exit code. */
int command_main(const command_t *command, int argc, char **argv);
/* The last word of the name: "render". */
const char *command_word(const command_t *command);
/* The subcommand of this name; NULL when there is none. */
const command_t *command_find(const command_t *command, const char *word);

/* The options that each command has: they print something instead of running it. */
typedef struct {
    bool help, man, version;
} standard_options_t;
extern const option_group_t standard_options;
/* The groups of a command in the order of help, the standard ones last; NULL after them. */
const option_group_t *command_group(const command_t *command, size_t index);
/* The rows of all its groups in this order; NULL after them. *group, unless NULL, becomes the group's index.
 */
const option_t *command_option(const command_t *command, size_t index, size_t *group);

#endif
