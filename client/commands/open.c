/* open: the command that shows a master's page in a browser, with the token that opens it. */
#include "client/commands/commands.h"
#include "client/commands/redirect.h"
#include "master/http/access/tokens.h"
#include "master/http/server.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MAX_URL = 1000 };

typedef struct {
    const char *data;
    bool view, print;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, data, "data", "DIR", "the master's data directory (default: lightmill-data)"),
    OPTION(values_t, view, "view", NULL, "with the right to look only, not to give orders"),
    OPTION(values_t, print, "print", NULL, "print the address, and open nothing"),
};
static const option_group_t open_options = OPTION_GROUP(NULL, rows);

static void begin(void *values)
{
    *(values_t *)values = (values_t){.data = "lightmill-data"};
}

static result_t no_page(const char *data_dir)
{
    return result_fail(
        RESULT_INPUT,
        "no master serves a page for %.150s: start lightmill-master --data %.150s --http 7480, "
        "or name its data directory with --data",
        data_dir, data_dir);
}

/* Where the page is, as the master has written it down; fresh memory. The token goes to no address that a
 * master has left behind: another program may listen there now. */
static result_t read_url(const char *data_dir, char **url)
{
    char *path = http_url_path(data_dir), text[MAX_URL];
    int descriptor = open(path, O_RDONLY | O_CLOEXEC);
    free(path);
    if (descriptor < 0) return no_page(data_dir);
    ssize_t size = http_url_is_served(descriptor) ? read(descriptor, text, sizeof text - 1) : 0;
    close(descriptor);
    if (size <= 0) return no_page(data_dir);
    text[size] = '\0';
    *url = mem_strdup(text);
    (*url)[strcspn(*url, "\n")] = '\0';
    return result_ok();
}

/* Becomes the desktop's opener, without its messages. */
static _Noreturn void become_opener(const char *page)
{
    int nowhere = open("/dev/null", O_RDWR);
    for (int stream = STDIN_FILENO; stream <= STDERR_FILENO; stream++) dup2(nowhere, stream);
    execlp("xdg-open", "xdg-open", page, (char *)NULL);
    _exit(127);
}

/* Starts the opener and does not wait for it, since it may be the browser itself, which runs until it is
 * closed. In a session of its own it outlives this terminal. */
static void start_opener(const char *page)
{
    pid_t child = fork();
    if (child == 0) {
        setsid();
        if (fork() == 0) become_opener(page);
        _exit(0);
    }
    if (child > 0) waitpid(child, NULL, 0);
}

/* Opens the address in a browser, where there is a desktop. It is on no command line (redirect.h). */
static result_t show(const char *data_dir, const char *address)
{
    if (getenv("DISPLAY") == NULL && getenv("WAYLAND_DISPLAY") == NULL) return result_ok();
    char *directory = mem_printf("%s/keys", data_dir), *page = NULL;
    result_t result = redirect_write(directory, address, &page);
    if (result.code == RESULT_OK) start_opener(page);
    free(page);
    free(directory);
    return result;
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    char *url = NULL;
    http_tokens_t tokens;
    TRY(read_url(values->data, &url));
    result_t result = http_tokens_read(values->data, &tokens);
    if (result.code == RESULT_OK) {
        char *address = mem_printf("%s#token=%s", url, values->view ? tokens.view : tokens.operate);
        puts(address);
        fflush(stdout);
        if (!values->print) result = show(values->data, address);
        free(address);
        http_tokens_forget(&tokens);
    }
    free(url);
    return result;
}

const command_t open_command = {
    .name = "lightmill open",
    .summary = "show a master's page in the browser",
    .about =
        "Shows the page of a master on this machine, which was started with --http: prints its address, "
        "and opens it where there is a desktop. The address holds a token (DATA/keys/http) that gives the "
        "right to operate: do not pass it on. The browser is given a file that only you can read "
        "(DATA/keys/open-*.html), so that the token is on no command line. --view gives one with which jobs "
        "can be watched only.",
    .groups = {{&open_options, 0}},
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};
