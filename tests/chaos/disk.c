/* disk: see disk.h. */
#include "tests/chaos/disk.h"

#include "tests/chaos/process.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mount.h>
#include <unistd.h>

result_t disk_mount(const char *folder, size_t megabytes)
{
    char size[40];
    snprintf(size, sizeof size, "size=%zum", megabytes);
    if (mount("none", folder, "tmpfs", MS_NOSUID | MS_NODEV, size) == 0) return result_ok();
    return result_fail(RESULT_MISMATCH, "no file system of its own: %s", strerror(errno));
}

void disk_unmount(const char *folder)
{
    umount2(folder, MNT_DETACH);
}

static char *ballast(const char *folder)
{
    return mem_printf("%s/ballast", folder);
}

result_t disk_fill(const char *folder)
{
    static const char zeroes[4096];
    char *path = ballast(folder);
    int file = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    free(path);
    if (file < 0) return result_fail(RESULT_IO, "no ballast: %s", strerror(errno));
    while (write(file, zeroes, sizeof zeroes) > 0) {
    }
    int error = errno;
    close(file);
    return error == ENOSPC ? result_ok() : result_fail(RESULT_IO, "no ballast: %s", strerror(error));
}

void disk_free(const char *folder)
{
    char *path = ballast(folder);
    unlink(path);
    free(path);
}

result_t disk_save(const char *folder, const char *copy)
{
    return process_command(-1, (const char *[]){"cp", "-a", folder, copy, NULL});
}
