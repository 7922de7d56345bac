/* unblosc: bytes packed by Blosc (version 1), through libblosc, which runs confined (confined.h). */
#ifndef LIGHTMILL_UNBLOSC_H
#define LIGHTMILL_UNBLOSC_H

#include "client/import/packed/confined.h"

/* Unpacks what must become `size` bytes. RESULT_INPUT when the data are damaged, or become more or less;
 * RESULT_LIMIT as confined_run. The caller frees *out by confined_free; on failure there is nothing to free.
 */
result_t unblosc(const uint8_t *data, size_t packed, size_t size, confined_result_t *out);

#endif
