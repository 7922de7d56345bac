/* atomic_file: see atomic_file.h. */
#include "common/atomic_file.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static result_t write_error(const char *path, int error)
{
    return result_fail(RESULT_IO, "%s: cannot be written: %s", path, strerror(error));
}

/* Uses open rather than mkstemp, so that the umask decides who of `mode` may read the result. */
static result_t open_temporary(atomic_file_t *file, const char *path, mode_t mode)
{
    *file = (atomic_file_t){.descriptor = -1};
    for (int attempt = 0; attempt < 1000; attempt++) {
        char *temporary = mem_printf("%s.%ld-%d.part", path, (long)getpid(), attempt);
        int descriptor = open(temporary, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode);
        if (descriptor >= 0) {
            *file =
                (atomic_file_t){.path = mem_strdup(path), .temporary = temporary, .descriptor = descriptor};
            return result_ok();
        }
        free(temporary);
        if (errno != EEXIST) break;
    }
    return write_error(path, errno);
}

result_t atomic_file_open(atomic_file_t *file, const char *path)
{
    return open_temporary(file, path, 0666);
}

bool atomic_file_write_at(atomic_file_t *file, const void *data, size_t size, uint64_t offset)
{
    const uint8_t *bytes = data;
    while (size > 0 && file->error == 0) {
        ssize_t n = pwrite(file->descriptor, bytes, size, (off_t)offset);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) {
            file->error = n < 0 ? errno : ENOSPC;
            break;
        }
        bytes += n;
        size -= (size_t)n;
        offset += (uint64_t)n;
    }
    return file->error == 0;
}

/* Makes a rename durable. A file system that cannot flush a directory is no reason to fail. */
static void flush_directory(const char *path)
{
    char *copy = mem_strdup(path);
    int directory = open(dirname(copy), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (directory >= 0) {
        (void)fsync(directory);
        close(directory);
    }
    free(copy);
}

result_t atomic_file_commit(atomic_file_t *file)
{
    if (file->error == 0 && !file->fleeting && fsync(file->descriptor) != 0) file->error = errno;
    if (close(file->descriptor) != 0 && file->error == 0) file->error = errno;
    file->descriptor = -1;
    if (file->error == 0 && rename(file->temporary, file->path) != 0) file->error = errno;
    if (file->error != 0) {
        result_t result = write_error(file->path, file->error);
        atomic_file_abort(file);
        return result;
    }
    if (!file->fleeting) flush_directory(file->path);
    free(file->temporary);
    file->temporary = NULL;
    atomic_file_abort(file);
    return result_ok();
}

void atomic_file_abort(atomic_file_t *file)
{
    if (file->descriptor >= 0) close(file->descriptor);
    if (file->temporary != NULL) unlink(file->temporary);
    free(file->temporary);
    free(file->path);
    *file = (atomic_file_t){.descriptor = -1};
}

static result_t write_whole(const char *path, mode_t mode, const void *data, size_t size)
{
    atomic_file_t file;
    TRY(open_temporary(&file, path, mode));
    atomic_file_write_at(&file, data, size, 0);
    return atomic_file_commit(&file);
}

result_t file_write_atomic(const char *path, const void *data, size_t size)
{
    return write_whole(path, 0666, data, size);
}

result_t file_write_private(const char *path, const void *data, size_t size)
{
    char *copy = mem_strdup(path);
    result_t result = directory_make(dirname(copy), 0700);
    free(copy);
    return result.code == RESULT_OK ? write_whole(path, 0600, data, size) : result;
}
