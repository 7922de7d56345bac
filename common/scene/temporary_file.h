/* temporary_file: a file without a name, for what may be too much for memory. It is gone when it is closed,
 * however the process ends. */
#ifndef LIGHTMILL_TEMPORARY_FILE_H
#define LIGHTMILL_TEMPORARY_FILE_H

#include "common/base.h"

/* Opens a new file of `size` bytes of zeroes under $TMPDIR, or /tmp, for reading and writing; the caller
 * closes *file. The disk holds room for all of it, so that writing through a mapping cannot fail. RESULT_IO
 * when there is no such room. */
result_t temporary_file(uint64_t size, int *file);
/* Makes it longer, as above. */
result_t temporary_file_grow(int file, uint64_t size);

#endif
