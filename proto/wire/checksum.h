/* checksum: CRC-32C (Castagnoli), which finds what was damaged on its way: every burst of up to 32 bits, and
 * all but one in 2^32 of longer ones. It is no help against a forger; keys are. */
#ifndef LIGHTMILL_CHECKSUM_H
#define LIGHTMILL_CHECKSUM_H

#include <stddef.h>
#include <stdint.h>

/* The checksum of `size` bytes that follow those whose checksum is `before`, 0 for none. */
uint32_t checksum_add(uint32_t before, const void *bytes, size_t size);

#endif
