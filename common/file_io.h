/* file_io: whole reads and writes on open files, and what is done to all files of a directory. */
#ifndef LIGHTMILL_FILE_IO_H
#define LIGHTMILL_FILE_IO_H

#include "common/base.h"

/* Writes all of `size` bytes where the file stands; on false errno says why. */
bool file_write_all(int descriptor, const void *data, size_t size);
/* Reads exactly `size` bytes at a byte offset; on false errno says why, 0: the file ends before. */
bool file_read_all(int descriptor, void *data, size_t size, uint64_t offset);
/* Deletes the files of a directory, but no directory in it. What cannot be deleted stays. */
void directory_clear(const char *path);

#endif
