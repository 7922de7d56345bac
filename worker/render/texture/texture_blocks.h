/* texture_blocks: reads images that may not fit into memory, piece by piece.
 *
 * DESIGN. Texels lie in the blob, which is a mapped file: the kernel keeps of it what there is room for. Left
 * alone it reads the wrong amount: megabytes about each place that is looked up, most of which has to make
 * room before it is looked up itself; or one page after the other, a wait for the disk each. So when a scene
 * has many texels it is told to read blocks of 64 KiB, each when something in it is looked up and was not of
 * late. A table of recent blocks says so: a block's slot is its number modulo the number of slots, and holds
 * the one that was read last. The table covers a part of the memory only, so that what it knows is there.
 *
 * It decides when something is read ahead, never what a texel is: that is read from the mapping in any case.
 * So threads share the table without locks, and what one of them overwrites costs another a call at most.
 */
#ifndef LIGHTMILL_TEXTURE_BLOCKS_H
#define LIGHTMILL_TEXTURE_BLOCKS_H

#include "common/scene/scene_blob.h"

#include <stdatomic.h>

enum { TEXTURE_BLOCK_BITS = 16 };

typedef struct {
    const uint8_t *start;    /* of the page in which the texels begin */
    const uint8_t *end;      /* of the texels */
    _Atomic uint32_t *slots; /* 1 + the number of a block, or 0 */
    uint32_t mask;           /* the number of slots is a power of 2; mask is one less */
} texture_blocks_t;

/* The number of slots for so many bytes of texels in a process that may use `limit` bytes of memory; 0: the
 * kernel needs no help. */
uint32_t texture_blocks_slots(uint64_t texels, uint64_t limit);
/* NULL when the blob's texels are few, or no mapped file. */
texture_blocks_t *texture_blocks_new(const scene_blob_t *blob);
void texture_blocks_free(texture_blocks_t *blocks);
/* Has the kernel read a block. */
void texture_blocks_read(texture_blocks_t *blocks, uint32_t block);

/* To be called before what lies at an address in the texels is read. */
static inline void texture_blocks_touch(texture_blocks_t *blocks, const void *address)
{
    uint32_t block = (uint32_t)((uint64_t)((const uint8_t *)address - blocks->start) >> TEXTURE_BLOCK_BITS);
    if (atomic_load_explicit(&blocks->slots[block & blocks->mask], memory_order_relaxed) != block + 1)
        texture_blocks_read(blocks, block);
}

#endif
