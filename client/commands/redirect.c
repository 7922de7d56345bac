/* redirect: see redirect.h. */
#include "client/commands/redirect.h"

#include "common/atomic_file.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { STALE_SECONDS = 60 };

/* Also true for what a killed process has left of writing one. */
static bool is_redirect(const char *name)
{
    int length = 0;
    return sscanf(name, "open-%*[0-9].html%n", &length) == 0 && length > 0;
}

static void remove_stale(const char *directory)
{
    DIR *list = opendir(directory);
    if (list == NULL) return;
    for (struct dirent *entry; (entry = readdir(list)) != NULL;) {
        struct stat status;
        if (is_redirect(entry->d_name) &&
            fstatat(dirfd(list), entry->d_name, &status, AT_SYMLINK_NOFOLLOW) == 0 &&
            time(NULL) - status.st_mtime > STALE_SECONDS)
            unlinkat(dirfd(list), entry->d_name, 0);
    }
    closedir(list);
}

static result_t write_page(const char *path, const char *address)
{
    char *page = mem_printf("<!doctype html><meta charset=\"utf-8\"><title>Lightmill</title>\n"
                            "<meta http-equiv=\"refresh\" content=\"0; url=%s\">\n"
                            "<a href=\"%s\">The page of the master</a>\n",
                            address, address);
    result_t result = file_write_private(path, page, strlen(page));
    sodium_memzero(page, strlen(page));
    free(page);
    return result;
}

result_t redirect_write(const char *directory, const char *address, char **path)
{
    if (strpbrk(address, "\"'<>& ;") != NULL)
        return result_fail(RESULT_INPUT, "'%.200s' is no address of a page", address);
    char *folder = realpath(directory, NULL);
    if (folder == NULL) return result_fail(RESULT_IO, "%.300s: %s", directory, strerror(errno));
    remove_stale(folder);
    char *page = mem_printf("%s/open-%ld.html", folder, (long)getpid());
    free(folder);
    result_t result = write_page(page, address);
    if (result.code == RESULT_OK)
        *path = page;
    else
        free(page);
    return result;
}
