/* file_io: see file_io.h. */
#include "common/file_io.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <unistd.h>

bool file_write_all(int descriptor, const void *data, size_t size)
{
    for (const uint8_t *bytes = data; size > 0;) {
        ssize_t written = write(descriptor, bytes, size);
        if (written < 0 && errno == EINTR) continue;
        if (written <= 0) return false;
        bytes += written;
        size -= (size_t)written;
    }
    return true;
}

bool file_read_all(int descriptor, void *data, size_t size, uint64_t offset)
{
    for (uint8_t *bytes = data; size > 0;) {
        ssize_t got = pread(descriptor, bytes, size, (off_t)offset);
        if (got < 0 && errno == EINTR) continue;
        if (got == 0) errno = 0;
        if (got <= 0) return false;
        bytes += got;
        offset += (uint64_t)got;
        size -= (size_t)got;
    }
    return true;
}

void directory_clear(const char *path)
{
    DIR *directory = opendir(path);
    for (const struct dirent *entry; directory != NULL && (entry = readdir(directory)) != NULL;)
        unlinkat(dirfd(directory), entry->d_name, 0); /* fails for directories, "." and ".." too */
    if (directory != NULL) closedir(directory);
}
