/* gunzip: gzip files (RFC 1952) in memory, by zlib. */
#ifndef LIGHTMILL_GUNZIP_H
#define LIGHTMILL_GUNZIP_H

#include "common/base.h"

/* Decompresses `size` bytes at `data`, the contents of the file `path`, which may be several gzip members one
 * behind the other, into fresh memory that the caller frees. RESULT_INPUT when the data are damaged or
 * truncated, or would take more than `limit` bytes; RESULT_LIMIT when memory runs out. */
result_t gunzip(const char *path, const uint8_t *data, size_t size, size_t limit, uint8_t **out,
                size_t *out_size);

/* Reads a file of at most `limit` bytes, decompressed where it is gzip, whatever it is called: then up to 4
 * GiB. The caller frees *data. Errors as of file_read and gunzip. */
result_t gunzip_read_file(const char *path, size_t limit, uint8_t **data, size_t *size);

#endif
