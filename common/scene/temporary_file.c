/* temporary_file: see temporary_file.h. */
#include "common/scene/temporary_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const char *folder(void)
{
    const char *named = getenv("TMPDIR");
    return named && named[0] ? named : "/tmp";
}

static result_t complain(const char *what, int error)
{
    return result_fail(RESULT_IO, "cannot %s a temporary file in %.300s: %s; set TMPDIR to another directory",
                       what, folder(), strerror(error));
}

/* For file systems that have no files without a name. */
static int open_and_unlink(void)
{
    char *path = mem_printf("%s/lightmill-XXXXXX", folder());
    int file = mkostemp(path, O_CLOEXEC);
    if (file >= 0) unlink(path);
    free(path);
    return file;
}

result_t temporary_file_grow(int file, uint64_t size)
{
    int error = size > 0 ? posix_fallocate(file, 0, (off_t)size) : 0;
    return error == 0 ? result_ok() : complain("make room in", error);
}

result_t temporary_file(uint64_t size, int *file)
{
    *file = open(folder(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (*file < 0) *file = open_and_unlink();
    if (*file < 0) return complain("create", errno);
    result_t result = temporary_file_grow(*file, size);
    if (result.code == RESULT_OK) return result;
    close(*file);
    *file = -1;
    return result;
}
